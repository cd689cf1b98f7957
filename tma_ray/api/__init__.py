"""Python API of runs and campaigns, exported by `tma_ray`."""

from tma_ray.api.training import RunsFailedError, TrainedRun, run_campaign, train

__all__ = ["RunsFailedError", "TrainedRun", "run_campaign", "train"]
