"""The version of the benchmark: what results must have in common to belong to one study."""

from __future__ import annotations

from typing import Final

BENCHMARK_VERSION: Final = 1
"""Stands for the version of the physics, that of the results' schema, and the algorithm version of every
teacher, student and environment that ships. A release freezes them under it: whoever changes one raises this
number with it, and a test compares it with the table of what each version stood for. It is written beside
every run and into every release; runs made before there was one have 0."""
