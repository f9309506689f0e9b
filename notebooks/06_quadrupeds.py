# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 6. Quadrupeds, and reading a recording
#
# The same planner, but the box is moved by robots with legs: each has its own gait, force MPC and joint control, in
# MuJoCo. What happened is kept in a Rerun recording, which is also a table that can be read back.

# %%
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from rerun.chunk import RrdReader

from jaxlocomanip import PlannerConfig, build_scenario, find_scenario, simulate
from jaxlocomanip.planner.config import Horizon
from jaxlocomanip.recording.rerun import write_recording

# %% tags=["parameters"]
SECONDS = 20.0
STAGES = 30

# %%
spec = replace(find_scenario("adaptive"), duration=SECONDS)
scenario = build_scenario(spec)
config = PlannerConfig(horizon=Horizon(steps=STAGES))
result = simulate(scenario, config, world="quadruped", backend="c")
outcome = result.outcome
print(f"reached: {bool(outcome.reached)}, fell: {bool(outcome.fell)}, largest force {outcome.max_force_n:.0f} N")

# %%
path = Path(tempfile.mkdtemp()) / "quadrupeds.rrd"
write_recording(path, spec.name, scenario, result.log)
print(f"{path}, {path.stat().st_size // 1000} kB; look at it with: rerun {path}")

# %% [markdown]
# A recording is a set of chunks, each with columns of one entity over time.

# %%
chunks = RrdReader(path).stream().to_chunks()
entities = sorted({str(chunk.entity_path) for chunk in chunks})
print(*entities, sep="\n")

# %% [markdown]
# The object's way, read from the file, beside the log that it was written from.

# %%
way = []
for chunk in chunks:
    batch = chunk.to_record_batch()
    for name in batch.schema.names:
        if str(chunk.entity_path) == "/world/object" and "translation" in name:
            way += [row[0][:2] for row in batch.column(name).to_pylist() if row]
way = np.array(way)

figure, axes = plt.subplots(figsize=(5, 5), layout="constrained")
axes.plot(*result.log.view.pose[:, :2].T, linewidth=4, alpha=0.3, label="log")
axes.plot(*way.T, "--", label="recording")
axes.plot(*spec.goal.pose[:2], "x", label="goal")
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
axes.legend()
plt.show()

# %%
assert np.abs(way[-1] - result.log.view.pose[-1, :2]).max() < 0.02
assert not bool(outcome.fell)
