"""Plug-ins of the test suite: costs of cases, distribution over processes, isolation, order."""
