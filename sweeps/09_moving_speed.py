"""Success by the speed of moving obstacles."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "moving_speed", "out/sweeps/moving_speed"))
