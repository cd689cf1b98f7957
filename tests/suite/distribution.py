"""Plug-in that distributes cases over processes: cases of a module, or of a service, share one.

Only one process starts Ray, an S3 server or a browser, and only one makes the campaign that pages show. The
cases of these services come first, since they wait more than they compute, and run beside other modules;
other cases keep the order of the session.
"""

import pytest

ON_CLUSTERS = ("campaign", "cohorts", "preflight", "retries", "seeing")
RUN_FROM_PAGES = ("pages", "help_examples")

SERVICES: dict[str, tuple[str, ...]] = {
    "cluster": tuple(f"tests/campaign/test_{name}.py" for name in ON_CLUSTERS),
    "browser": (
        "tests/documentation/test_site_in_a_browser.py",
        "tests/analysis/test_pages_in_a_browser.py",
        "tests/playground/test_agreement.py",
        "tests/playground/test_page.py",
    ),
    "s3_server": (
        "tests/analysis/test_baselines.py",
        *(f"tests/object_stores/test_s3_{name}.py" for name in ("campaign", "runs", "store")),
    ),
    "documented": tuple(f"tests/documentation/test_{name}.py" for name in RUN_FROM_PAGES),
}
"""Modules that share a service or a campaign, by the name of its fixture, longest modules first."""

SERVICE_OF = {module: service for service, modules in SERVICES.items() for module in modules}


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Move the cases that use services to the front."""
    for item in items:
        module, needed = _module(item.nodeid), set(SERVICES) & set(getattr(item, "fixturenames", ()))
        if needed - {SERVICE_OF.get(module)}:
            raise pytest.UsageError(f"{module} uses {', '.join(needed)}: list it in suite/distribution.py")
    turns = {service: turn for turn, service in enumerate(SERVICES)}
    items.sort(key=lambda item: turns.get(scope(item.nodeid), len(turns)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Return a scheduler that runs all modules of a service in one process, if `--dist` is loadscope."""
    if config.getoption("dist") != "loadscope":
        return None
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return scope(nodeid)

    return Scheduling(config, log)


def scope(nodeid: str) -> str:
    """Return the scope of a case, which shares a process: its service, or its module."""
    module = _module(nodeid)
    return SERVICE_OF.get(module, module)


def _module(nodeid: str) -> str:
    return nodeid.partition("::")[0]
