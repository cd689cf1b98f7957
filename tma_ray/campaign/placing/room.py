"""Room for cohorts on the nodes of a cluster."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from tma_ray.campaign.cluster.connection import offers
from tma_ray.campaign.cluster.head import living_nodes
from tma_ray.campaign.placing.kinds import Kind
from tma_ray.campaign.settings import GIB, Resources, Settings
from tma_ray.runs.spec import RunSpec

PROCESS_GIB = {"cpu": 1.0, "cuda": 4.0}
"""Memory of a learner's process without replay, GiB."""

ROW_BYTES = 4.2
"""Of a stored transition for each of its numbers, of which observations are stored once."""


class Room(NamedTuple):
    """Room of one node.

    Attributes:
        learners: that it holds.
        players: that it holds beside each.
    """

    learners: int
    players: int


def learner_resources(settings: Settings, specs: Iterable[RunSpec], kinds: Mapping[str, Kind]) -> Resources:
    """Returns what the learner of a full cohort of `specs` occupies: on a GPU the whole GPU."""
    replays = [_replay_bytes(spec, kinds[spec.run_id]) for spec in specs]
    device = settings.device.partition(":")[0]
    copies = 1 if device == "cuda" else 2  # a checkpoint's, and the learner's own where that is no GPU's
    replay = copies * settings.width * max(replays, default=0.0) / GIB
    return Resources(1.0, float(device == "cuda"), PROCESS_GIB[device] + replay)


def room_of(node: Mapping[str, float], settings: Settings, learner: Resources) -> Room:
    """Returns the room of a node with these resources for cohorts: full ones, or fewer players on few cores.

    Args:
        node: Ray's amount of each resource.
        settings: of the campaign.
        learner: resources of each learner.
    """
    player = settings.player
    whole = Resources(
        learner.cpus + settings.width * player.cpus,
        memory_gib=learner.memory_gib + settings.width * player.memory_gib,
    )
    least = Resources(learner.cpus + player.cpus, learner.gpus, learner.memory_gib + player.memory_gib)
    learners = least.fit_into(node)
    if not learner.gpus:
        learners = min(learners, max(1, whole.fit_into(node)))
    if not learners:
        return Room(0, 0)
    cores = node.get("CPU", 0.0) / learners - learner.cpus
    memory = node.get("memory", 0.0) / learners / GIB - learner.memory_gib
    by_memory = memory / player.memory_gib if player.memory_gib else math.inf
    return Room(learners, int(min(settings.width, cores / player.cpus + 1e-9, by_memory + 1e-9)))


def _replay_bytes(spec: RunSpec, kind: Kind) -> float:
    size = min(int(spec.student_hyperparameters.get("buffer_size", 0)), spec.schedule.steps)
    return ROW_BYTES * size * (kind.observation + kind.action + 2)


def check_room(settings: Settings, specs: Sequence[RunSpec], kinds: Mapping[str, Kind]) -> None:
    """Refuses cohorts that no node can hold: Ray would let them wait forever.

    Args:
        settings: of the campaign.
        specs: its runs.
        kinds: of `kinds_of` these.

    Raises:
        ValueError: what a learner and a run need, and what the nodes have.
    """
    learner = learner_resources(settings, specs, kinds)
    nodes = [node["Resources"] for node in living_nodes()]
    if any(room_of(node, settings, learner).players for node in nodes):
        return
    raise ValueError(
        f"no node can hold the learner of a cohort, of {learner.cpus:g} CPUs, {learner.gpus:g} GPUs and "
        f"{learner.memory_gib:.1f} GiB, and a run of {settings.player.cpus:g} CPUs and "
        f"{settings.player.memory_gib:g} GiB beside it: the nodes have {offers(nodes)}; give '--cohort "
        f"off' or a smaller number, add larger nodes, or give '--autoscaling' if the cluster adds them"
    )
