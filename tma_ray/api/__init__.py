"""Python API of runs and campaigns, exported by `tma_ray`."""
