"""Four robots, one on each face, turn the object by 90 degrees on the way."""

import sys

from jaxlocomanip.cli import experiment

RUNS = {
    "four_robots": ["four_robots"],
}

if __name__ == "__main__":
    sys.exit(experiment(__doc__, "out/06_four_robots", RUNS))
