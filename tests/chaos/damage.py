"""Fuzzing of results roots: commands must survive randomly damaged files, and other runs stay intact.

python tests/chaos/damage.py                      # 500 damaged files: some minutes
python tests/chaos/damage.py --files 2000 --seed 7

Prints the number of damaged files by kind. Exits with 1 if a command ended in a traceback, if a run with
undamaged files was lost, if `verify` overlooked a change of a file that readers trust, if a ranking changed
without naming a damaged file, or if the tables of resumed runs differ from those of undisturbed runs.
"""

import argparse
import contextlib
import io
import itertools
import json
import os
import random
import shutil
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent

if __name__ == "__main__":
    sys.path[:0] = [str(HERE.parent / "runs"), str(HERE.parents[1])]

from small_runs import data_files, small_spec  # noqa: E402  # from above

from tma_ray.cli import main as command  # noqa: E402
from tma_ray.results import Committer, DamagedFileError, Results, ResultsRootError  # noqa: E402
from tma_ray.runs import Placement, RunSpec, run_locally  # noqa: E402

AT_ONCE = 10
"""Number of files that are damaged in one copy of the root."""

TRUSTED = ("manifests", "tables/evaluations", "tables/episodes", "tables/training")
"""Folders of files in which `verify` must detect every change."""


def _flipped(data: bytes, chance: random.Random) -> bytes:
    for _ in range(chance.randint(1, 8)):
        at = chance.randrange(len(data))
        data = data[:at] + bytes([data[at] ^ (1 << chance.randrange(8))]) + data[at + 1 :]
    return data


def _mistyped(data: bytes, chance: random.Random) -> bytes:
    """Return JSON with the type of one value changed, or random bytes if the data is not JSON."""
    try:
        content = json.loads(data)
    except ValueError:
        return chance.randbytes(len(data))
    place: Any = content
    while isinstance(place, dict | list) and place:
        key = chance.choice(list(place) if isinstance(place, dict) else range(len(place)))
        if not isinstance(place[key], dict | list) or not place[key] or chance.random() < 0.3:
            others = (None, -1, 10**30, 0.5, "x", [], {}, True, "../../secret", "\ud800")
            place[key] = chance.choice([each for each in others if each != place[key]])
            break
        place = place[key]
    return json.dumps(content).encode()


KINDS: Mapping[str, Callable[[bytes, random.Random], bytes | None]] = {
    "cut": lambda data, chance: data[: chance.randrange(len(data))],
    "flipped": _flipped,
    "empty": lambda data, chance: b"",
    "removed": lambda data, chance: None,
    "mistyped": _mistyped,
    "longer": lambda data, chance: data + chance.randbytes(chance.randint(1, 100)),
    "noise": lambda data, chance: chance.randbytes(chance.randint(1, 1000)),
}

IN_PLACE: Mapping[str, Callable[[Path], object]] = {
    "a folder": Path.mkdir,
    "a pipe": os.mkfifo,
    "a link to nowhere": lambda path: path.symlink_to("nowhere"),
    "a circle of links": lambda path: path.symlink_to(path.name),
    "holes": lambda path: (path.touch(), os.truncate(path, 300 * 2**30)),
}
"""Replacements of a file."""


@dataclass
class Damage:
    """Damaged file: its path below the root, the kind of damage, and the problems it caused."""

    path: str
    kind: str
    problems: list[str]


def damaged(files: int, chance: random.Random, place: Path) -> Iterator[Damage]:
    """Damage files in copies of a root, a few at a time, and try all commands there."""
    root, specs, expected = small_root(place)
    whole = {manifest.run.run_id for manifest in Results.open(root).runs()}
    ranking = _ended(("ranking", str(root)))[1]
    for first in range(0, files, AT_ONCE):
        copy = Path(shutil.copytree(root, place / f"copy-{first}"))
        paths = sorted(path.relative_to(copy).as_posix() for path in copy.rglob("*") if path.is_file())
        found = [
            Damage(path, chance.choice([*KINDS, *IN_PLACE]), [])
            for path in chance.sample(paths, min(AT_ONCE, files - first))
        ]
        for each in found:
            _damage(copy / each.path, each.kind, chance)
        found[0].problems += _tried(copy, whole, found, ranking) + _resumed(copy, specs, expected)
        yield from found
        shutil.rmtree(copy)


def _damage(file: Path, kind: str, chance: random.Random) -> None:
    before = file.read_bytes()
    file.unlink()
    if kind in IN_PLACE:
        IN_PLACE[kind](file)
        return
    after = KINDS[kind](before, chance)
    if after is not None:
        file.write_bytes(after if after != before else after + b"\0")


def _tried(root: Path, whole: set[str], found: list[Damage], ranking: str) -> list[str]:
    """Try all commands on a root with damaged files, and return the problems."""
    about = " and ".join(f"{each.path} ({each.kind})" for each in found)
    problems = []
    outputs = {}
    for words in ("verify", "status", "ranking", "report"):
        more = ("-o", str(root.parent / "report.html")) if words == "report" else ()
        code, said = _ended((words, str(root), *more))
        outputs[words] = said
        if "Traceback" in said or code not in (0, 1, 2):
            problems.append(f"{words}, {about}: exit code {code}: {said[-1500:]}")
    if outputs["ranking"] != ranking and not any(each.path in outputs["ranking"] for each in found):
        problems.append(f"{about}: the ranking changed without a word")
    untouched = {run for run in whole if not any(run in each.path for each in found)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with contextlib.suppress(ValueError):  # the damaged file may be root.json
            lost = untouched - {manifest.run.run_id for manifest in Results.open(root).runs()}
            problems += [f"{about}: {run} is lost" for run in lost]
    for each in found:
        if each.path.startswith(TRUSTED) and Path(each.path).stem not in outputs["verify"]:
            problems.append(f"verify overlooked {each.path} ({each.kind})")
    return problems


def _ended(words: tuple[str, ...]) -> tuple[int, str]:
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        try:
            return command(list(words)), said.getvalue()
        except BaseException as error:
            return -1, f"{said.getvalue()}\nTraceback: {error!r}"


def _resumed(root: Path, specs: Sequence[RunSpec], expected: Mapping[str, bytes]) -> list[str]:
    """Resume all runs of a damaged root, and return the problems."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for spec in specs:
                run_locally(spec, Committer.open(root), Placement(outage_seconds=1))
    except ResultsRootError as error:  # expected if root.json is damaged
        return [] if "root.json" in str(error) else [f"resume: {error!r}"]
    except DamagedFileError as error:  # expected if the message names a damaged file
        return [] if "a folder lies in its place" in str(error) else [f"resume: {error!r}"]
    except Exception:
        return [f"resume: {traceback.format_exc()[-1500:]}"]
    found = data_files(root)
    different = [path for path, data in expected.items() if found.get(path) != data]
    return [f"resume: {path} differs" for path in different]


def _cell(spec: RunSpec) -> dict[str, Any]:
    names = ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge", "seed")
    return {name: getattr(spec.record(), name) for name in ("run_id", *names)} | {"experiment": "small"}


def small_root(folder: Path) -> tuple[Path, list[RunSpec], dict[str, bytes]]:
    """Return a root of finished and interrupted runs, their specs, and their expected final tables."""
    pairs = [(student, teacher) for student in ("ppo", "sac") for teacher in ("random", "alp_gmm", "riac")]
    changes = {"steps": 600, "evaluation_interval": 300, "probe_interval": 300, "training_window": 300}
    specs = [small_spec(folder, *pair, **changes) for pair in pairs]
    root, whole = folder / "root", folder / "whole"
    for place, stopped in ((whole, 0), (root, 2)):
        committer = Committer.open(place)
        committer.write_cells("small", [_cell(spec) for spec in specs])
        for number, spec in enumerate(specs):
            episodes = itertools.count()
            early = number >= len(specs) - stopped
            run_locally(spec, committer, should_stop=lambda early=early, n=episodes: early and next(n) > 10)
    return root, specs, data_files(whole)


def main() -> int:
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--files", type=int, default=500, help="to damage (default: 500)")
    parser.add_argument("--seed", type=int, default=0, help="of files and damage (default: 0)")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    problems: list[str] = []
    with tempfile.TemporaryDirectory() as place:
        for each in damaged(options.files, random.Random(options.seed), Path(place)):
            counts[each.kind] += 1
            problems += each.problems
    sys.stdout.write("".join(f"{problem}\n" for problem in problems))
    kinds = ", ".join(f"{kind} {counts[kind]}" for kind in (*KINDS, *IN_PLACE))
    sys.stdout.write(f"{sum(counts.values())} damaged files ({kinds}): {len(problems)} problems\n")
    return int(bool(problems))


if __name__ == "__main__":
    raise SystemExit(main())
