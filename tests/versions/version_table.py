"""Table of versions (``versions.json``): traces of components by version, and versions of releases.

After a change of behaviour, raise the versions of the changed components and renew the table::

    python tests/versions/version_table.py

An entry is overwritten only while no released benchmark has its version. When a benchmark version is tagged,
``python tests/versions/version_table.py --release`` freezes it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from behaviour_traces import TOLERANCE, catalogue, traces, version

from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.physics import PHYSICS_VERSION
from tma_ray.results import SCHEMA_VERSION

FILE = Path(__file__).with_name("versions.json")

RENEW = "python tests/versions/version_table.py"

Table = dict[str, Any]


def load() -> Table:
    """Return the table: "benchmarks" by version, and "traces" by part, name and version."""
    table: Table = json.loads(FILE.read_text())
    return table


def current() -> Table:
    """Return the present versions, as an entry of "benchmarks"."""
    algorithms: dict[str, dict[str, str]] = {}
    for part, name in catalogue():
        algorithms.setdefault(part, {})[name] = version(part, name)
    return {
        "released": False,
        "physics_version": PHYSICS_VERSION,
        "schema_version": SCHEMA_VERSION,
        "algorithm_versions": algorithms,
    }


def released(table: Table, part: str, name: str) -> str | None:
    """Return the version of a component in the newest released benchmark, or None."""
    frozen = [entry for _, entry in sorted(_benchmarks(table)) if entry["released"]]
    found: str | None = frozen[-1]["algorithm_versions"].get(part, {}).get(name) if frozen else None
    return found


def behaviour_problem(table: Table, part: str, name: str, found: dict[str, list[float]]) -> str | None:
    """Return a message if the traces `found` contradict the table, else None."""
    of, now = f"{part} {name!r}", version(part, name)
    pinned = table["traces"].get(part, {}).get(name)
    if pinned is None or pinned["version"] != now:
        at = "no entry" if pinned is None else f"version {pinned['version']}"
        return f"{of} has version {now}, and the table {at}: renew it with '{RENEW}'"
    changed = [key for key in {**found, **pinned["traces"]} if _differs(found, pinned["traces"], key)]
    if not changed:
        return None
    own = int(now.partition(",")[0])
    remedy = (
        f"raise algorithm_version to {own + 1} and renew the digest with '{RENEW}'"
        if released(table, part, name) == now
        else f"version {own} is in no release yet, so renew the digest with '{RENEW}'; else raise "
        f"algorithm_version to {own + 1} first"
    )
    return f"behaviour of {of} changed ({', '.join(changed)}): {remedy}"


def benchmark_problem(table: Table) -> str | None:
    """Return a message if the versions of the benchmark contradict the table, else None.

    An added teacher, student or environment changes no released run, and needs no new version of the
    benchmark; the next ``--release`` freezes its behaviour.
    """
    now, pinned = current(), dict(_benchmarks(table)).get(BENCHMARK_VERSION)
    if pinned is None:
        return f"benchmark version {BENCHMARK_VERSION} is not in the table: renew it with '{RENEW}'"
    moved = [key for key in ("physics_version", "schema_version") if now[key] != pinned[key]]
    versions = now["algorithm_versions"]
    moved += [
        f"{part} {name!r}"
        for part, named in pinned["algorithm_versions"].items()
        for name, own in named.items()
        if versions.get(part, {}).get(name) != own
    ]
    if not moved:
        return None
    remedy = (
        f"raise BENCHMARK_VERSION to {BENCHMARK_VERSION + 1}, then renew" if pinned["released"] else "renew"
    )
    return f"{', '.join(moved)} of benchmark version {BENCHMARK_VERSION} changed: {remedy} with '{RENEW}'"


def renewed(table: Table, found: dict[tuple[str, str], dict[str, list[float]]]) -> Table:
    """Return the table updated with the present versions and the traces `found` by part and name.

    Raises:
        ValueError: if traces or the benchmark differ at a released version.
    """
    for (part, name), each in found.items():
        problem = behaviour_problem(table, part, name, each)
        if problem and released(table, part, name) == version(part, name):
            raise ValueError(problem)
        if problem:
            entry = {"version": version(part, name), "traces": each}
            table["traces"].setdefault(part, {})[name] = entry
    problem = benchmark_problem(table)
    pinned = table["benchmarks"].get(str(BENCHMARK_VERSION))
    if problem and pinned and pinned["released"]:
        raise ValueError(problem)
    if problem:
        table["benchmarks"][str(BENCHMARK_VERSION)] = current()
    return table


def main(arguments: list[str]) -> None:
    """Renew the table, and freeze it with ``--release``."""
    found = {(part, name): traces(part, name) for part, name in catalogue()}
    table = renewed(load(), found)
    if arguments == ["--release"]:
        table["benchmarks"][str(BENCHMARK_VERSION)] = current() | {"released": True}
    elif arguments:
        raise SystemExit(__doc__)
    FILE.write_text(_text(table))


def _benchmarks(table: Table) -> list[tuple[int, Table]]:
    return [(int(number), entry) for number, entry in table["benchmarks"].items()]


def _differs(found: dict[str, list[float]], pinned: dict[str, list[float]], key: str) -> bool:
    if key not in found or key not in pinned:
        return True
    return any(abs(a - b) > TOLERANCE for a, b in zip(found[key], pinned[key], strict=True))


def _text(table: Table) -> str:
    """Return the table as JSON with one line per trace."""
    text = json.dumps(table, indent=1, sort_keys=True)
    lines: list[str] = []
    for line in text.splitlines():
        number = line.strip().rstrip(",").lstrip("-").replace(".", "").replace("e-", "").isdigit()
        closes = line.strip() in ("]", "],")
        if (number or closes) and lines and "[" in lines[-1]:
            lines[-1] += line.strip() + (" " if number and line.endswith(",") else "")
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.path.append(str(FILE.parents[1] / "students"))
    try:
        main(sys.argv[1:])
    except ValueError as refusal:
        raise SystemExit(str(refusal)) from refusal
