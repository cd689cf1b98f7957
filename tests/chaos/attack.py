"""Chaos test of campaigns: all kinds of faults, injected at random times.

python tests/chaos/attack.py                          # three injections of each kind: half an hour or more
python tests/chaos/attack.py --injections 20          # a night
python tests/chaos/attack.py --kinds gcs,s3 --seed 7

Prints the losses; exits with 1 if there are any, or if an attack did not finish.
"""

import argparse
import random
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

HERE = Path(__file__).parent

if __name__ == "__main__":
    sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "runs"), str(HERE.parents[1])]

from faults import Fault, Site, private_environment, table, undisturbed_files  # noqa: E402  # from above
from kinds import KINDS, WIDTHS, Scene  # noqa: E402
from nodes import Nodes  # noqa: E402

INJECTIONS, SEED = 3, 0
"""Default number of injections of each kind, and default seed of times and victims."""

MOST_PER_CAMPAIGN = 3
"""Number of faults per campaign: after more lost processes, a run fails."""


def attack(kind: str, injections: int, chance: random.Random, site: Site, nodes: Nodes) -> Iterator[Fault]:
    """Inject faults into as many campaigns as needed; yield the losses of each."""
    expected = undisturbed_files(width=WIDTHS.get(kind, 0))
    for number, first in enumerate(range(0, injections, MOST_PER_CAMPAIGN)):
        while len(nodes.living) < 2:
            nodes.add()
        scene = Scene(site.at(f"{kind}-{number}"), nodes, chance)
        with closing(scene):
            KINDS[kind](scene, min(MOST_PER_CAMPAIGN, injections - first))
        yield scene.site.compare(kind, len(scene.times), expected, scene.times)


def merged(faults: list[Fault]) -> Fault:
    return Fault(
        faults[0].name,
        sum(fault.injected for fault in faults),
        sum(fault.rows_lost for fault in faults),
        sum(fault.bytes_different for fault in faults),
        [seconds for fault in faults for seconds in fault.recovery_seconds],
    )


@contextmanager
def private_site() -> Iterator[tuple[Site, Nodes]]:
    """Context manager with a cluster and a folder for campaigns."""
    with (
        tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as place,
        tempfile.TemporaryDirectory(prefix="campaigns") as folder,
    ):
        environment = private_environment(Path(place))
        with Nodes(environment) as nodes:
            yield Site(Path(folder), environment, nodes.address), nodes


def say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--injections", type=int, default=INJECTIONS, help="of each kind (default: 3)")
    parser.add_argument("--seed", type=int, default=SEED, help="of instants and victims (default: 0)")
    parser.add_argument("--kinds", default=",".join(KINDS), help="which (default: %(default)s)")
    options = parser.parse_args()
    faults: list[Fault] = []
    unfinished: list[str] = []
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # lets context managers clean up
    with private_site() as (site, nodes):
        for kind in options.kinds.split(","):
            chance = random.Random(f"{options.seed} {kind}")
            try:
                faults.append(merged(list(attack(kind, options.injections, chance, site, nodes))))
            except AssertionError as error:  # continue with other kinds
                unfinished.append(kind)
                say(f"{kind}: {error}")
            else:
                say(table(faults[-1:]))
    say(table(faults))
    if unfinished:
        say(f"not finished: {', '.join(unfinished)}")
    return int(bool(unfinished) or any(fault.rows_lost or fault.bytes_different for fault in faults))


if __name__ == "__main__":
    raise SystemExit(main())
