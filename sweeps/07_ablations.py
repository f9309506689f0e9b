"""The planner without one of its parts at a time, all over the same scenarios."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "ablations", "out/sweeps/ablations"))
