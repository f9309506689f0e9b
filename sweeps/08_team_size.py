"""Two, three and four robots."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "team_size", "out/sweeps/team_size"))
