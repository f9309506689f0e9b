"""Success over true mass and friction, neither of which the planner knows."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "mass_friction", "out/sweeps/mass_friction"))
