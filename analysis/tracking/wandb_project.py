"""Export of runs' scalars to a Weights & Biases project."""

import json
import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from analysis.tracking.points import TRACKED_TABLES, Point, Tracker
from tma_ray.results import Manifest, RunStatus, Table
from tma_ray.support.decoding import MOST_TEXT_BYTES, read_file

STEP_KEY: Final = "global_step"  # key of environment steps, as in CleanRL and openrlbenchmark
RETURN: Final = "charts/episodic_return"  # key of the training return, as in CleanRL and openrlbenchmark
SENT: Final = "published"  # prefix of the keys that hold the number of points sent from each table
LEDGER: Final = "tma_ray_sent.json"  # file with each run's number of points sent, needed offline


class WandbProject(Tracker):
    """Weights & Biases project to which the runs of a results root are sent under their own ids.

    Runs are resumed after the points that they already have. Points withdrawn by an older checkpoint stay,
    since the run reproduces them.

    Args:
        root: folder, or ``s3://`` or ``gs://`` address.
        project: name of the project.
        entity: user or team of the project; None for the logged-in user.
        folder: folder of the library's files and of `LEDGER`.
        offline: True to write to `folder` only, for ``wandb sync``.

    Raises:
        ResultsRootError: if the results root is missing or of another version.
        ValueError: if the library is not installed.
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
        if all(len(points[table]) <= sent.get(table.value, 0) for table in TRACKED_TABLES):
            return False
        run = self._begin(manifest, experiment)
        # online, the counts are in the run's summary; offline, only in the ledger
        sent = {
            table.value: max(int(run.summary.get(f"{SENT}/{table.value}", 0)), sent.get(table.value, 0))
            for table in TRACKED_TABLES
        }
        new = [
            (step, table, scalars)
            for table in TRACKED_TABLES
            for step, scalars in points[table][sent[table.value] :]
        ]
        for step, table, scalars in sorted(new, key=lambda point: point[0]):
            sent[table.value] += 1
            row = {STEP_KEY: step, **scalars, f"{SENT}/{table.value}": sent[table.value]}
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
        """Create the run of a manifest in the project, or resume it."""
        import wandb

        record, config = manifest.run, config_of(manifest)
        try:
            run = wandb.init(
                project=self._project,
                entity=self._entity,
                id=record.run_id,
                name=record.run_id,
                group=f"{config['env_id']}-{config['exp_name']}"[:128],
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
        run.define_metric(STEP_KEY)
        run.define_metric("*", step_metric=STEP_KEY)
        return run


def config_of(manifest: Manifest) -> dict[str, Any]:
    """Return the configuration of a run, with openrlbenchmark's ``env_id``, ``exp_name`` and ``seed``."""
    record = manifest.run
    return {
        "env_id": "/".join(filter(None, (record.environment, record.challenge, record.embodiment))),
        "exp_name": "-".join((record.student, record.teacher, record.expert_knowledge)),
        "seed": record.seed,
        "total_timesteps": record.steps,
        "spec": json.loads(record.spec),
        "physics_version": record.physics_version,
        "benchmark_version": record.benchmark_version,
    }


def tags_of(manifest: Manifest, experiment: str) -> list[str]:
    """Return the tags of a run (experiment, components, versions), limited to characters valid in queries."""
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
