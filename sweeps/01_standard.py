"""How often two robots arrive, and touch nothing, over the scenarios that the planner is judged on."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "standard", "out/sweeps/standard"))
