"""Two unlike robots, a load off centre and noisy sensing, as in a laboratory."""

import sys

from jaxlocomanip.cli import experiment

RUNS = {
    "hardware": ["hardware"],
    "without_adaptation": ["hardware", "--without", "adaptation"],
}

if __name__ == "__main__":
    sys.exit(experiment(__doc__, "out/04_hardware", RUNS))
