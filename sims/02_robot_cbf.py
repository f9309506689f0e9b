"""The robots behind the object keep clear of obstacles too, with and without their barriers."""

import sys

from jaxlocomanip.cli import experiment

RUNS = {
    "robot_cbf": ["robot_cbf"],
    "without_robot_cbf": ["robot_cbf", "--without", "robot-cbf"],
}

if __name__ == "__main__":
    sys.exit(experiment(__doc__, "out/02_robot_cbf", RUNS))
