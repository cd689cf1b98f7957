"""Entry point of ``python -m tma_ray``, equivalent to the command `tma-ray`."""

import sys

if sys.path[0] not in sys.path[1:]:
    sys.path.append(sys.path.pop(0))  # the current folder, whose modules must not shadow others

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main())
