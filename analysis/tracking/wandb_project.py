"""Scalars of runs in a project of Weights & Biases, once or following a campaign that is under way."""

import json
import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from analysis.tracking.points import TABLES, Point, Tracker
from tma_ray.results import Manifest, RunStatus, Table
from tma_ray.support.decoding import MOST_TEXT_BYTES, read_file

STEP: Final = "global_step"
"""The horizontal axis: environment steps. CleanRL and openrlbenchmark call it so."""

RETURN: Final = "charts/episodic_return"
"""The return of training as CleanRL and openrlbenchmark name it."""

SENT: Final = "published"
"""Beginning of the names under which each row says how many points of a table were sent, it included."""

LEDGER: Final = "tma_ray_sent.json"
"""File that says how many points were sent of each run: what is offline cannot be asked."""


class WandbProject(Tracker):
    """A project of Weights & Biases that the runs of a results root are sent to, under their own IDs.

    A run is resumed there, and says itself how many of its points it has. Points that an older checkpoint
    took back stay; the run makes the same ones again.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.
        project: name of the project.
        entity: user or team that has it; None for the one who is logged in.
        folder: folder of the library's files, and of notes on points that were sent.
        offline: True if the library only writes to `folder`, for ``wandb sync``.

    Raises:
        ResultsRootError: no results root at that place, or one of another version.
        ValueError: the library is not installed.
    """

    def __init__(
        self, root: str | Path, project: str, entity: str | None, folder: Path, *, offline: bool
    ) -> None:
        if find_spec("wandb") is None:
            raise ValueError("Weights & Biases needs its library: pip install 'tma_ray[wandb]'")
        super().__init__(root)
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._project, self._entity, self._offline = folder, project, entity, offline
        self._ledger = folder / LEDGER
        self._sent: dict[str, dict[str, int]] = (
            json.loads(read_file(self._ledger, MOST_TEXT_BYTES)) if self._ledger.exists() else {}
        )

    def _write(self, manifest: Manifest, points: Mapping[Table, Sequence[Point]], experiment: str) -> bool:
        key = f"{self._entity or ''}/{self._project}/{manifest.run.run_id}"
        sent = self._sent.get(key, {})
        if all(len(points[table]) <= sent.get(table.value, 0) for table in TABLES):
            return False
        run = self._begin(manifest, experiment)
        # The run there has it in its summary; a run offline cannot be asked.
        sent = {
            table.value: max(int(run.summary.get(f"{SENT}/{table.value}", 0)), sent.get(table.value, 0))
            for table in TABLES
        }
        new = [
            (step, table, scalars) for table in TABLES for step, scalars in points[table][sent[table.value] :]
        ]
        for step, table, scalars in sorted(new, key=lambda point: point[0]):
            sent[table.value] += 1
            row = {STEP: step, **scalars, f"{SENT}/{table.value}": sent[table.value]}
            if "training/mean_return" in scalars:
                row[RETURN] = scalars["training/mean_return"]
            run.log(row)
        run.finish(exit_code=1 if manifest.status is RunStatus.FAILED else 0)
        self._sent[key] = sent
        aside = self._ledger.with_suffix(".new")
        aside.write_text(json.dumps(self._sent, indent=1))
        aside.replace(self._ledger)
        return bool(new)

    def _begin(self, manifest: Manifest, experiment: str) -> Any:
        """Return the run of that ID there, new or resumed."""
        import wandb

        record, config = manifest.run, config_of(manifest)
        try:
            run = wandb.init(
                project=self._project,
                entity=self._entity,
                id=record.run_id,
                name=record.run_id,
                group=f"{config['env_id']}-{config['exp_name']}"[
                    :128
                ],  # of those that differ in their seed alone
                job_type=experiment,
                tags=tags_of(manifest, experiment),
                config=config,
                dir=self._folder,
                resume="allow",
                mode="offline" if self._offline else None,
                settings=wandb.Settings(
                    silent=True, console="off", disable_git=True, x_disable_meta=True, x_disable_stats=True
                ),
            )
        except wandb.errors.Error as error:
            raise ValueError(
                f"Weights & Biases: {error}; log in with 'wandb login', or pass --offline"
            ) from error
        run.define_metric(STEP)
        run.define_metric("*", step_metric=STEP)
        return run


def config_of(manifest: Manifest) -> dict[str, Any]:
    """Return the configuration of a run, with the names by which openrlbenchmark finds runs.

    Those are ``env_id`` (environment, challenge and body), ``exp_name`` (student, teacher and its knowledge)
    and ``seed``.
    """
    record = manifest.run
    places = record.environment, record.challenge, record.embodiment
    names = record.student, record.teacher, record.expert_knowledge
    return {
        "env_id": "/".join(filter(None, places)),
        "exp_name": "-".join(names),
        "seed": record.seed,
        "total_timesteps": record.steps,
        "spec": json.loads(record.spec),
        "physics_version": record.physics_version,
        "benchmark_version": record.benchmark_version,
    }


def tags_of(manifest: Manifest, experiment: str) -> list[str]:
    """Return the tags of a run: its experiment, parts and versions, in letters that a query may hold."""
    record = manifest.run
    names = (
        experiment,
        record.student,
        record.teacher,
        record.expert_knowledge,
        record.challenge,
        f"benchmark-{record.benchmark_version}",
        f"physics-{record.physics_version}",
    )
    return list(dict.fromkeys(re.sub(r"[^0-9A-Za-z._=-]+", "_", name)[:64] or "unnamed" for name in names))
