"""Folders in the format of the original release's results, with its quirks, made of invented numbers."""

from __future__ import annotations

import csv
import json
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

EPOCH = 500_000
EPISODE = 2_000
TESTS = 100

SAC_COLUMNS = (
    *("Epoch", "AverageEpRet", "StdEpRet", "MaxEpRet", "MinEpRet", "AverageTestEpRet", "StdTestEpRet"),
    *("MaxTestEpRet", "MinTestEpRet", "EpLen", "TestEpLen", "TotalEnvInteracts", "Time"),
)
PPO_COLUMNS = (
    *("misc/total_timesteps", "misc/serial_timesteps", "misc/nupdates", "misc/explained_variance"),
    *("misc/time_elapsed", "fps", "eprewmean", "eprewmax", "eplenmean", "eval_eprewmean", "eval_eprewmax"),
    *("eval_eplenmean", "loss/policy_loss", "loss/value_loss"),
)
STUMPS_BOUNDS = [("mu_h", [0.0, 3.0]), ("obstacle_spacing", [0.0, 6.0])]
PARKOUR_BOUNDS = [
    ("input_vector", [[-0.35, 0.05], [0.6, 1.0], [-0.1, 0.3]]),
    ("water_level", [0.0, 1.0]),
    ("creepers_width", [0.25, 0.25]),
    ("creepers_height", [0.0, 4.0]),
    ("creepers_spacing", [0.0, 5.0]),
    ("terrain_cppn_scale", [10, 10]),
]


def stumps(teacher: str, criteria: int, level: str = "no", rest: str = "", date: str = "05-03") -> str:
    """Returns the name of an experiment on Stump Tracks."""
    body = "_walker_type_" + rest if rest and not rest.startswith("_") else rest
    start = f"{date}_profiling_benchmark_stumps_{teacher}_criteria_{criteria}{body}"
    return f"{start}_allow_expert_knowledge_{level}"


def parkour(teacher: str, body: str, date: str = "07-03") -> str:
    """Returns the name of an experiment on Parkour."""
    return f"{date}_benchmark_parkour_{teacher}_walker_type_{body}"


@dataclass
class Release:
    """A folder of results; what was put into it stays known, for comparison.

    Attributes:
        root: the folder.
        evaluations: of a SAC seed; one every 500,000 steps.
        protocol: of the pickles.
        spelling: of numpy's internal package in them.
    """

    root: Path
    evaluations: int = 2
    protocol: int = 2
    spelling: str = "numpy.core"
    written: dict[str, Path] = field(default_factory=dict)

    def sac(self, experiment: str, seed: int = 0, mastered: Sequence[int] = (), **changes: Any) -> Path:
        """Writes a seed of SAC that masters so many of 100 tasks at each evaluation; returns its folder."""
        steps = [EPOCH * (number + 1) for number in range(self.evaluations)]
        history = self.history(experiment, seed, steps, mastered or [10 * (i + 1) for i in range(len(steps))])
        rows = [self._sac_row(number, history, steps) for number in range(len(steps))]
        folder = self._folder(experiment, seed)
        lines = ["\t".join(SAC_COLUMNS), *("\t".join(map(str, row)) for row in rows)]
        (folder / "progress.txt").write_text("\n".join(lines) + "\n")
        config = {"exp_name": experiment, "seed": seed, "steps_per_epoch": EPOCH, "gamma": 0.99}
        (folder / "config.json").write_text(json.dumps(config | {"env_fn": "<function>", "logger": {}}))
        self._dump(folder, history | changes)
        (folder / "simple_save").mkdir()
        return folder

    def ppo(self, experiment: str, seed: int = 0, mastered: Sequence[int] = (), **changes: Any) -> Path:
        """Writes a seed of PPO, which is evaluated after its first 20,000 steps as well."""
        steps = [20_000, *(EPOCH * (number + 1) for number in range(self.evaluations))]
        history = self.history(experiment, seed, steps, mastered or [5 * (i + 1) for i in range(len(steps))])
        folder = self._folder(experiment, seed)
        with (folder / "progress.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, PPO_COLUMNS, restval="0.5")
            writer.writeheader()
            for number, step in enumerate(steps):
                tests = np.array(history["env_test_rewards"][TESTS * number : TESTS * (number + 1)])
                mean = {"eprewmean": 50.0 + number, "eplenmean": float(EPISODE)}
                writer.writerow({"misc/total_timesteps": step, "eval_eprewmean": tests.mean()} | mean)
        (folder / "vars.pkl").write_bytes(b"never read")
        (folder / "checkpoints").mkdir()
        self._dump(folder, history | changes)
        return folder

    def history(
        self, experiment: str, seed: int, steps: Sequence[int], mastered: Sequence[int]
    ) -> dict[str, Any]:
        """Returns what a teacher records of a training that is evaluated at `steps`."""
        rng = np.random.default_rng([seed, *experiment.encode()])
        bounds = PARKOUR_BOUNDS if "parkour" in experiment else STUMPS_BOUNDS
        pairs = np.vstack([np.reshape(pair, (-1, 2)) for _, pair in bounds])
        episodes = steps[-1] // EPISODE
        tasks = rng.uniform(pairs[:, 0], pairs[:, 1], (episodes, len(pairs))).astype(np.float32)
        tests = tasks_of_tests(pairs)
        returns = np.concatenate([returns_of_tests(rng, count) for count in mastered])
        return {
            "env_params_train": list(tasks),
            "env_train_rewards": rng.normal(150, 100, episodes).tolist(),
            "env_train_len": [EPISODE] * episodes,
            "env_params_test": [task for _ in steps for task in tests],
            "env_test_rewards": returns.tolist(),
            "env_test_len": rng.integers(100, 2000, len(returns)).tolist(),
            "env_param_bounds": bounds,
            "periodical_samples": [
                np.array([]) if number == 0 else tasks[100 * number : 100 * (number + 1)]
                for number in range(steps[-1] // 250_000)
            ],
            "periodical_infos": [{"bk_index": number, "task_infos": None} for number in range(4)],
            **teacher_records(experiment, rng, episodes, len(pairs)),
        }

    def _folder(self, experiment: str, seed: int) -> Path:
        name = experiment.split("/")[-1]
        folder = self.root / experiment / f"{name}_s{seed}"
        folder.mkdir(parents=True)
        self.written[f"{experiment}/{name}_s{seed}"] = folder
        return folder

    def _sac_row(self, number: int, history: Mapping[str, Any], steps: Sequence[int]) -> list[float]:
        per_window = EPOCH // EPISODE
        train = np.array(history["env_train_rewards"][per_window * number : per_window * (number + 1)])
        tests = np.array(history["env_test_rewards"][TESTS * number : TESTS * (number + 1)])
        sides = (*_four(train), *_four(tests), float(EPISODE), 500.0, steps[number], 100.0)
        return [number + 1, *sides]

    def _dump(self, folder: Path, history: Mapping[str, Any]) -> None:
        data = pickle.dumps(dict(history), protocol=self.protocol)
        if self.protocol < 4:
            data = data.replace(b"numpy._core", self.spelling.encode())
        (folder / "env_params_save.pkl").write_bytes(data)


def _four(values: NDArray[np.float64]) -> tuple[float, float, float, float]:
    return float(values.mean()), float(values.std()), float(values.max()), float(values.min())


def tasks_of_tests(pairs: NDArray[np.float64]) -> NDArray[np.float32]:
    """Returns 100 tasks, the same for all seeds."""
    rng = np.random.default_rng(len(pairs))
    return rng.uniform(pairs[:, 0], pairs[:, 1], (TESTS, len(pairs))).astype(np.float32)


def returns_of_tests(rng: np.random.Generator, mastered: int) -> NDArray[np.float64]:
    """Returns 100 returns, `mastered` of them over 230, one of the others exactly that."""
    returns = rng.permutation(np.where(np.arange(TESTS) < mastered, rng.uniform(231, 320, TESTS), 229.0))
    if mastered < TESTS:
        returns[np.flatnonzero(returns <= 230)[0]] = 230.0
    return returns


def teacher_records(experiment: str, rng: np.random.Generator, episodes: int, size: int) -> dict[str, Any]:
    """Returns the history that teachers have besides, with three updates."""
    moments = [episodes // 4, episodes // 2, episodes]
    low, high = np.zeros(size), np.ones(size)
    if "GMM" in experiment:
        beside = 1 if "ALP" in experiment else 2
        counts = [2, 3, 2]
        alps = {"tasks_alps": rng.random(episodes).tolist()} if "ALP" in experiment else {}
        return alps | {
            "weights": [np.full(k, 1 / k) for k in counts],
            "means": [rng.random((k, size + beside)) for k in counts],
            "covariances": [np.stack([np.eye(size + beside)] * k) for k in counts],
            "tasks_lps": rng.random(episodes).tolist(),
            "tasks_origin": rng.integers(-2, 3, episodes).tolist(),
            "episodes": moments,
        }
    if "RIAC" in experiment:
        boxes = [[np.array([low, high])] * k for k in (1, 2, 3)]
        return {"all_boxes": boxes, "split_iterations": moments, "all_alps": [[0.5] * k for k in (1, 2, 3)]}
    if "ADR" in experiment:
        return {"task_space": [(low, high * k) for k in (1, 2, 3)], "episodes": moments}
    if "GoalGAN" in experiment:
        losses = {"dis_log_loss": [0.5, 0.4, 0.3], "gen_log_loss": [np.float32(1), np.float32(2), 3.0]}
        return losses | {"episodes": moments}
    if "Setter-Solver" in experiment:
        return {"judge_loss": [0.5, 0.4, 0.3], "setter_loss": [1.0, 2.0, 3.0], "episodes": moments}
    if "Self-Paced" in experiment:
        return {
            "mean": [rng.random(size) for _ in moments],
            "covariance": [np.eye(size) for _ in moments],
            "steps": [200_000, 300_000, 400_000],
            "algo_iterations": [1, 2, 3],
            "kl": [5.0, 4.0, 3.0],
        }
    return {}
