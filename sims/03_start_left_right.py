"""The side on which the object starts decides on which side it passes the obstacles."""

import sys

from jaxlocomanip.cli import experiment

RUNS = {
    "both": ["start_left", "start_right"],
}

if __name__ == "__main__":
    sys.exit(experiment(__doc__, "out/03_start_left_right", RUNS))
