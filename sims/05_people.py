"""The team pushes on among walking people."""

import sys

from jaxlocomanip.cli import experiment

RUNS = {
    "people": ["people"],
}

if __name__ == "__main__":
    sys.exit(experiment(__doc__, "out/05_people", RUNS))
