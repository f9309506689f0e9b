"""Measurements in processes of their own, with a device for each core."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
DEVICES = "--xla_force_host_platform_device_count"
"""flag of XLA that is about CPUs only: an accelerator's devices stay as they are"""


def in_fresh_process(module: str, *arguments: str, **settings: str) -> Any:
    """What `python -m MODULE ARGUMENTS` prints as JSON in its last line, with these environment variables."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} {DEVICES}={os.cpu_count()}"
    environment = {**os.environ, "XLA_FLAGS": flags, **settings}
    command = [sys.executable, "-m", module, *arguments]
    done = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])
