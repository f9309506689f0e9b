"""Headings, faces and contact offsets at the start."""

import sys

from jaxlocomanip.cli import study

if __name__ == "__main__":
    sys.exit(study(__doc__, "starts", "out/sweeps/starts"))
