"""A process that measures speeds: ``python -m tma_ray.campaign.costs.worker``, fed a pickled `Order`.

It prints a line of JSON after each compilation and for each kind of run, and then goes on with the last, so
that the machine stays as busy as in a campaign while other workers measure. It ends when it is ended.
"""

from __future__ import annotations

import json
import pickle
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tma_ray.campaign.costs.cohort_speed import measure_cohort
from tma_ray.campaign.costs.speed import Throughput, measure
from tma_ray.campaign.settings import Settings
from tma_ray.jit import count_compiled
from tma_ray.runs.inputs import REGISTRIES, import_plugins, provide
from tma_ray.runs.spec import RunSpec


@dataclass(frozen=True)
class Order:
    """Work of one process.

    Attributes:
        specs: runs whose speed to measure, by key, as `RunSpec.to_dict` has them.
        settings: how they are executed.
        files: contents of the files that they read, by SHA-256.
        search_path: where modules of plug-ins are found.
    """

    specs: Sequence[tuple[str, dict[str, Any]]]
    settings: Settings
    files: Mapping[str, bytes]
    search_path: Sequence[str]


def work(order: Order) -> None:
    """Measures what `order` names, in its order, and then its last kind for ever."""
    sys.path[:] = list(dict.fromkeys((*sys.path, *order.search_path)))
    provide(order.files)
    specs = [(key, RunSpec.from_dict(content)) for key, content in order.specs]
    count_compiled(lambda compiled, kernels: _send({"compiled": compiled, "kernels": kernels}))
    for key, spec in specs:
        import_plugins(spec, *REGISTRIES)
        throughput = asdict(measure_either(spec, order.settings))
        _send({"key": key, "throughput": throughput})
    while True:
        measure_either(specs[-1][1], order.settings)


def _send(record: dict[str, Any]) -> None:
    """Writes a line for `measuring`."""
    sys.stdout.write(json.dumps(record) + "\n")
    sys.stdout.flush()


def measure_either(spec: RunSpec, settings: Settings) -> Throughput:
    """Returns the speed of runs like `spec`, which learn in a cohort or alone."""
    return measure_cohort(spec, settings) if settings.width else measure(spec, settings)


if __name__ == "__main__":
    work(pickle.load(sys.stdin.buffer))
