"""``python -m tma_ray.cli`` is the command `tma-ray`."""

import sys

from tma_ray.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
