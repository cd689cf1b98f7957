"""Plug-in that prints the seed of a session's random order, to repeat it."""

import pytest
from hypothesis import settings

# Derandomised, so that failing examples can be repeated in any process and on any machine.
settings.register_profile("suite", derandomize=True, deadline=None)
settings.load_profile("suite")


def pytest_configure(config: pytest.Config) -> None:
    """Disable the seeding of global generators, which would hide their use."""
    config.option.randomly_reset_seed = False


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the command that repeats the order."""
    seed = getattr(config.option, "randomly_seed", None)
    if seed is not None and getattr(config.option, "numprocesses", None):
        terminalreporter.write_line(f"in the order of seed {seed}: make test SEED={seed}")
