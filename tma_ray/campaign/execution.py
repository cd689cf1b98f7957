"""Execution of campaigns: checks, connection to Ray, scheduling."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path

from tma_ray.campaign.cluster.base import BEGUN, GRACE_SECONDS, leaving_without_head
from tma_ray.campaign.cluster.joined import connect
from tma_ray.campaign.cluster.local import OwnProcesses
from tma_ray.campaign.executors.cohorts import Cohorts, check_room, kinds_of
from tma_ray.campaign.executors.ray_executor import RayExecutor
from tma_ray.campaign.failures import StopSignals
from tma_ray.campaign.plan import CampaignSpec, Plan, lease_holder
from tma_ray.campaign.preflight import check_feasible, check_installation, check_storage_access, warm_nodes
from tma_ray.campaign.progress import ProgressView, PublishedProgress, Snapshot, View
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import Settings
from tma_ray.results import Committer, HeartbeatWriter, Lease, Store, check_usable
from tma_ray.runs.inputs import importing_plugins, plugin_sources
from tma_ray.runs.placement import check_available


def run_campaign(
    campaign: CampaignSpec,
    results: str | Path,
    settings: Settings | None = None,
    address: str | None = None,
    view: View | None = None,
) -> Snapshot:
    """Execute the runs of `campaign` that a results root lacks.

    Bad input is refused before the first step.

    Args:
        campaign: cells, seeds and budget.
        results: a folder, or a URI such as ``s3://bucket/folder``.
        settings: resources and placement.
        address: address of a Ray cluster; None starts one on this machine.
        view: display of the progress.

    Returns:
        The numbers of runs by outcome.

    Raises:
        ValueError: an unknown name, missing knowledge, impossible resources.
        ResultsRootError: the root belongs to something else or to another version.
        RootInUseError: another campaign is running on it.
        ConnectionError: no cluster answers at `address`, or an object store refuses us or a node.
        OutageError: the storage of the results was gone for too long; the same call continues.
        HeadLostError: Ray was gone for too long; the same call continues.
        RuntimeError: called by a module that is imported for its plug-in.
    """
    return execute_plan(campaign.plan(), results, settings or Settings(), address, view)


def execute_plan(
    plan: Plan, results: str | Path, settings: Settings, address: str | None, view: View | None = None
) -> Snapshot:
    """Execute the runs of `plan` that a results root lacks; see `run_campaign`."""
    if importing_plugins():
        raise RuntimeError(
            f"campaign {plan.name!r} was started by a module that was imported for its plug-in: "
            f"put the call below 'if __name__ == \"__main__\":'"
        )
    store = Store.open(results)
    check_usable(store)
    kinds = kinds_of(plan.runs) if settings.width else {}
    if address is None:
        check_available(settings.device)
    with leaving_without_head(OwnProcesses(), plan.name):
        connection = connect(address, plugin_sources(plan.runs))
    with closing(connection.head) as head:
        with leaving_without_head(head, plan.name):
            if settings.width and not settings.autoscaling:
                check_room(settings, plan.runs, kinds)
            elif not settings.autoscaling:
                check_feasible(settings.resources)
            if not connection.is_own:
                check_installation()
            check_storage_access(store)
            warm_nodes(plan.runs, connection.shipped)
        committer = Committer(store)
        with Lease(store, lease_holder(plan.name)) as lease, ExitStack() as stack:
            if plan.cell_rows:
                committer.write_cells(plan.name, plan.cell_rows)
            committer.sweep()
            progress = PublishedProgress(view or ProgressView(), HeartbeatWriter(store, lease.holder))
            cohorts = Cohorts(settings, head, plan.runs, kinds) if settings.width else None
            executor = RayExecutor(store, settings, head, cohorts)
            scheduler = Scheduler(committer, executor, settings, progress, lease.keep)

            def conclude() -> None:
                scheduler.abandon()
                lease.release()

            signals = stack.enter_context(StopSignals())
            if connection.is_own:  # a cluster is waited for
                watch = leaving_without_head(head, plan.name, BEGUN, grace=GRACE_SECONDS, conclude=conclude)
                stack.enter_context(watch)
            return scheduler.execute(plan.runs, lambda: signals.requested or lease.asked_to_stop())
