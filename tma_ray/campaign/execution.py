"""From a campaign to its results: refuse, connect, schedule."""

from __future__ import annotations

from pathlib import Path

from tma_ray.campaign.campaign import Campaign, lease_holder
from tma_ray.campaign.cluster import check_feasible, connect
from tma_ray.campaign.progress import ProgressView, Snapshot
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import Settings
from tma_ray.campaign.stopping import StopSignals
from tma_ray.campaign.warming import check_root_on_nodes, warm_nodes
from tma_ray.results import Committer, Lease, Store, check_usable
from tma_ray.runs.plugins import importing_plugins, plugin_sources


def run_campaign(
    campaign: Campaign,
    results: str | Path,
    settings: Settings | None = None,
    address: str | None = None,
    view: ProgressView | None = None,
) -> Snapshot:
    """Runs what is missing of `campaign` under a results root.

    Everything that can be refused is refused before a single step is played.

    Args:
        campaign: what to run.
        results: a folder, or a URI such as ``s3://bucket/folder``.
        settings: resources and placement.
        address: of a Ray cluster; None starts one on this machine.
        view: shows the progress.

    Returns:
        How many runs ended how.

    Raises:
        ValueError: an unknown name, missing knowledge, impossible resources.
        ResultsRootError: the root belongs to something else or to another version.
        RootInUseError: another campaign is running on it.
        ConnectionError: no cluster answers at `address`, or an object store refuses us or a node.
        RuntimeError: called by a module that is imported for its plug-in.
    """
    if importing_plugins():
        raise RuntimeError(
            f"campaign {campaign.name!r} was started by a module that was imported for its plug-in: "
            f"put the call below 'if __name__ == \"__main__\":'"
        )
    settings = settings or Settings()
    plan = campaign.plan()
    store = Store.open(results)
    check_usable(store)
    shipped = connect(address, plugin_sources(plan.runs))
    check_feasible(settings.resources)
    check_root_on_nodes(store)
    warm_nodes(plan.runs, shipped)
    committer = Committer(store)
    with Lease(store, lease_holder(campaign.name)) as lease:
        committer.write_cells(campaign.name, plan.cell_rows)
        committer.sweep()
        scheduler = Scheduler(committer, settings, view or ProgressView(), lease.keep)
        with StopSignals() as signals:
            return scheduler.execute(plan.runs, lambda: signals.requested)
