"""Runs in processes of this machine, without Ray: alone, or as players of a cohort."""

from tma_ray.runs.pool.cohorts import cohort
from tma_ray.runs.pool.processes import PoolReport, run_in_processes

__all__ = ["PoolReport", "cohort", "run_in_processes"]
