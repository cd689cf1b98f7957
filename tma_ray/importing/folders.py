"""The search for seeds in a folder of results."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tma_ray.importing.errors import ImportRefusedError
from tma_ray.importing.names import OriginalExperiment, UnknownNameError, is_named, parse

HISTORY_FILE: Final = "env_params_save.pkl"
PROGRESS_FILES: Final = {"progress.txt": "sac", "progress.csv": "ppo"}
"""Students by the file that each keeps of its progress."""
IGNORED: Final = "ignore"
_SEED: Final = re.compile(r"_s(\d+)$")


@dataclass(frozen=True)
class SeedFolder:
    """One seed.

    Attributes:
        path: of its folder.
        name: the same from the source on, for messages and records.
        setting: what it is a seed of.
        student: our name.
    """

    path: Path
    name: str
    setting: OriginalExperiment
    student: str

    @property
    def progress_file(self) -> Path:
        """The file that tells how far it got."""
        names = {student: name for name, student in PROGRESS_FILES.items()}
        return self.path / names[self.student]

    @property
    def history_file(self) -> Path:
        """The pickle with what its teacher recorded."""
        return self.path / HISTORY_FILE

    @property
    def seed_of_name(self) -> int | None:
        """The seed that the folder's name ends with."""
        found = _SEED.search(self.path.name)
        return int(found[1]) if found else None


@dataclass(frozen=True)
class SeedSearch:
    """Content of a source.

    Attributes:
        seeds: in order of their names.
        ignored: folders that were passed by, as their names ask for.
        problems: of seeds that cannot be told what they are of, by name.
    """

    seeds: tuple[SeedFolder, ...]
    ignored: tuple[str, ...]
    problems: dict[str, str]


def find_seeds(source: Path) -> SeedSearch:
    """Returns the seeds of all experiments in a folder, however deep they lie.

    A seed is a folder with a progress file; what it is of, the nearest folder says that has such a name.

    Raises:
        ImportRefusedError: the folder does not exist or is empty.
    """
    if not source.is_dir():
        raise ImportRefusedError(f"{source} is not a folder: give the one that holds the experiments")
    seeds: list[SeedFolder] = []
    ignored: list[str] = []
    problems: dict[str, str] = {}
    for folder, files in _folders(source, ignored):
        name = folder.relative_to(source).as_posix()
        try:
            student = _student_of(files)
            if student is not None:
                seeds.append(SeedFolder(folder, name, _setting_of(folder, source, student), student))
        except UnknownNameError as error:
            problems[name] = str(error)
    if not seeds and not problems:
        passed = f" ({len(ignored)} folders are to be ignored by their names)" if ignored else ""
        raise ImportRefusedError(
            f"{source} holds no seed{passed}: expected folders with {' or '.join(PROGRESS_FILES)} in them"
        )
    return SeedSearch(tuple(seeds), tuple(ignored), problems)


def _folders(source: Path, ignored: list[str]) -> Iterator[tuple[Path, set[str]]]:
    for where, below, files in os.walk(source):
        folder = Path(where)
        skipped = [name for name in below if IGNORED in name.lower()]
        ignored += [(folder / name).relative_to(source).as_posix() for name in sorted(skipped)]
        below[:] = sorted(set(below) - set(skipped))
        yield folder, set(files)


def _student_of(files: set[str]) -> str | None:
    found = [student for name, student in PROGRESS_FILES.items() if name in files]
    if len(found) > 1:
        raise UnknownNameError(f"it has {' and '.join(PROGRESS_FILES)}: keep the one of its student")
    if not found and HISTORY_FILE in files:
        raise UnknownNameError(
            f"it has {HISTORY_FILE} and neither {' nor '.join(PROGRESS_FILES)}: copy the seed again"
        )
    return found[0] if found else None


def _setting_of(folder: Path, source: Path, student: str) -> OriginalExperiment:
    levels = (folder, *folder.parents)
    inside = levels[: levels.index(source) + 1]
    for level in inside:
        name = _SEED.sub("", level.resolve().name if level == source else level.name)
        if is_named(name):
            setting = parse(name)
            if setting.student and not setting.student.startswith(student):
                raise UnknownNameError(
                    f"its folder says student {setting.student}, and its progress file is that of {student}"
                )
            return setting
    raise UnknownNameError(
        "no folder around it names its experiment: expected a name as in "
        "05-03_profiling_benchmark_stumps_ALP-GMM_criteria_1_allow_expert_knowledge_no"
    )
