"""Success by layout, from an empty floor to a pocket and a crowd."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "layouts", "out/sweeps/layouts"))
