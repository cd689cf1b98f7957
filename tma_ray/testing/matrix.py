"""Matrices of simulated runs (teachers x challenges x knowledge levels x seeds), run in several processes."""

import itertools
import multiprocessing
import os
import threading
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.connection import Connection

import pandas as pd
from threadpoolctl import threadpool_limits

from tma_ray.support.interrupts import block_sigint, unblock_sigint
from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS, check_limits, effective_level, knows_enough
from tma_ray.testing.simulation import EVALUATIONS, SimulatedRun, simulate
from tma_ray.testing.students import SimulatedChallenge

NAMES = ("teacher", "challenge", "expert_knowledge", "seed", "effective_knowledge")  # key columns

RECOVERY = {"before_reset": 0.0, "tenth_later": 0.1, "three_tenths_later": 0.3}
"""Columns of results around the first reset, and their delays after it as shares of all episodes."""

RUN_MEASURES = ("mastered_percent", *RECOVERY)

CURVE = tuple(f"at_{100 * (point + 1) // EVALUATIONS:02}" for point in range(EVALUATIONS))
"""Columns of the learning curve."""


class ProcessLostError(RuntimeError):
    """Error raised if a process of a pool was killed; its message names the runs that may be lost."""


@dataclass(frozen=True)
class SimulatedCell:
    """Cell of a matrix, with one run per seed.

    Attributes:
        teacher: registered name, or ``module:Name``.
        effective_level: level that the teacher uses, None if the offered one does not suffice. Cells with the
            same effective level share runs.
    """

    challenge: SimulatedChallenge
    teacher: str
    level: KnowledgeLevel
    effective_level: KnowledgeLevel | None


def cells_of(
    teachers: Sequence[str], challenges: Sequence[SimulatedChallenge], levels: Sequence[KnowledgeLevel]
) -> list[SimulatedCell]:
    """Return the distinct cells of a matrix, ordered by teacher, level and challenge."""
    for teacher, challenge in itertools.product(teachers, challenges):
        check_limits(TEACHERS.get(teacher), teacher, challenge.task_space)
    cells = []
    for teacher, level in itertools.product(dict.fromkeys(teachers), dict.fromkeys(levels)):
        kind = TEACHERS.get(teacher)
        used = effective_level(kind, teacher, level) if knows_enough(kind, level) else None
        cells += [SimulatedCell(challenge, teacher, level, used) for challenge in dict.fromkeys(challenges)]
    return cells


def run_cells(
    cells: Sequence[SimulatedCell],
    seeds: Sequence[int],
    episodes: int,
    jobs: int,
    finished: Iterable[SimulatedRun] = (),
) -> Generator[SimulatedRun, None, None]:
    """Simulate the distinct runs of `cells`, except `finished` ones, and yield them as they end.

    They are started in order of their seeds, in `jobs` single-threaded processes, which end when the iterator
    is closed.

    Raises:
        ProcessLostError: if a process was killed.
    """
    done = {(run.challenge, run.teacher, run.level, run.seed) for run in finished}
    spawn = multiprocessing.get_context("spawn")
    alive, parent = spawn.Pipe(duplex=False)
    runs: dict[Future[SimulatedRun], str] = {}
    lost: set[Future[SimulatedRun]] = set()
    with alive, ProcessPoolExecutor(jobs, spawn, initializer=_settle, initargs=(alive,)) as pool:
        try:
            with block_sigint():
                for seed, (challenge, teacher, level) in itertools.product(seeds, runs_of(cells)):
                    if (challenge.name, teacher, level, seed) not in done:
                        run = pool.submit(simulate, challenge, teacher, level, seed, episodes)
                        runs[run] = f"{teacher} on {challenge.name} (expert knowledge {level}, seed {seed})"
            for run in as_completed(runs):
                if isinstance(run.exception(), BrokenProcessPool):
                    lost.add(run)
                else:
                    yield run.result()
        finally:
            parent.close()
            pool.shutdown(cancel_futures=True)
    if lost:
        begun = [name for run, name in runs.items() if run in lost][:jobs]
        raise ProcessLostError(
            f"a process was killed, perhaps for lack of memory, that played {' or '.join(begun)}"
        )


def run_count(cells: Sequence[SimulatedCell], seeds: Sequence[int]) -> int:
    """Return the number of distinct runs of `cells`."""
    return len(runs_of(cells)) * len(seeds)


def runs_of(cells: Sequence[SimulatedCell]) -> list[tuple[SimulatedChallenge, str, KnowledgeLevel]]:
    """Return the challenge, teacher and effective level of each distinct run of `cells`."""
    runs = ((c.challenge, c.teacher, c.effective_level) for c in cells if c.effective_level is not None)
    return list(dict.fromkeys(runs))


def tabulate(cells: Sequence[SimulatedCell], runs: Iterable[SimulatedRun]) -> pd.DataFrame:
    """Return one row per cell and seed, in this order; a cell that cannot run gets one row without a seed.

    The columns are

    - teacher, challenge, expert_knowledge, seed;
    - effective_knowledge: level that the teacher uses; rows that are equal up to here share a run;
    - mastered_percent: percentage of mastered test tasks at the end;
    - before_reset, tenth_later, three_tenths_later: the same just before the student's first reset and
      one tenth and three tenths of all episodes after it; empty for a student that is not reset;
    - at_05 to at_100: the same after each twentieth of the episodes.
    """
    played: dict[tuple[str, str, KnowledgeLevel], list[SimulatedRun]] = {}
    for run in sorted(runs, key=lambda run: run.seed):
        played.setdefault((run.challenge, run.teacher, run.level), []).append(run)
    rows: list[dict[str, object]] = []
    for cell in cells:
        names: dict[str, object] = {
            "teacher": cell.teacher,
            "challenge": cell.challenge.name,
            "expert_knowledge": cell.level.value,
        }
        if cell.effective_level is None:
            rows.append(names)
            continue
        for run in played[cell.challenge.name, cell.teacher, cell.effective_level]:
            row = {"seed": run.seed, "effective_knowledge": run.level.value, "mastered_percent": run.mastered}
            for name, later in RECOVERY.items() if cell.challenge.resets else ():
                row[name] = run.curve[round((cell.challenge.resets[0] + later) * EVALUATIONS) - 1]
            rows.append(names | row | dict(zip(CURVE, run.curve, strict=True)))
    return pd.DataFrame(rows, columns=[*NAMES, *RUN_MEASURES, *CURVE]).astype({"seed": "Int64"})


def _settle(alive: Connection) -> None:
    """Initialise a single-threaded worker process, which exits when the parent closes its end of `alive`."""
    unblock_sigint()
    threadpool_limits(limits=1)
    os.environ["OMP_NUM_THREADS"] = "1"

    def follow() -> None:
        alive.poll(None)
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
