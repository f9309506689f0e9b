"""The paper's settings against the robust ones."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "presets", "out/sweeps/presets"))
