"""The team pushes a box heavier than believed over unknown friction, with and without adaptation."""

import sys

from jaxlocomanip.cli import experiment

RUNS = {
    "adaptive": ["adaptive"],
    "without_adaptation": ["adaptive", "--without", "adaptation"],
}

if __name__ == "__main__":
    sys.exit(experiment(__doc__, "out/01_adaptive", RUNS))
