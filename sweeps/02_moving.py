"""The same with one to three obstacles that move."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "moving", "out/sweeps/moving"))
