"""The order of a session: random, and told so that it can be had again."""

from __future__ import annotations

import pytest
from hypothesis import settings

# Examples are the same in every process and on every machine: what fails can be had again.
settings.register_profile("suite", derandomize=True, deadline=None)
settings.load_profile("suite")


def pytest_configure(config: pytest.Config) -> None:
    """Leave global generators alone: nobody may draw from them, and seeding them would hide it."""
    config.option.randomly_reset_seed = False


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Tell how to have the same order again."""
    seed = getattr(config.option, "randomly_seed", None)
    if seed is not None and getattr(config.option, "numprocesses", None):
        terminalreporter.write_line(f"in the order of seed {seed}: make test SEED={seed}")
