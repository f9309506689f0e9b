"""The team pushes on among walking people, and without protection walks into them."""

import sys

from jaxlocomanip.cli import experiment

RUNS = {
    "people": ["people"],
    "without_protection": ["people", "--without", "robot-cbf", "--without", "object-cbf"],
}

if __name__ == "__main__":
    sys.exit(experiment(__doc__, "out/05_people", RUNS))
