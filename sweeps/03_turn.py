"""Three or four robots turn the box to any heading on the way."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "turn", "out/sweeps/turn"))
