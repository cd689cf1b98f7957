"""``python -m tma_ray.cli`` is the command `tma-ray`."""

import sys

import tma_ray.__main__  # noqa: F401  (the current folder comes last)
from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main())
