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
# # 1. Plan one scenario and look at it
#
# Two quadrupeds push a box of unknown mass and friction to a goal. The planner believes 6 kg and knows nothing of the
# floor; the world has 8 kg.

# %%
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from jaxlocomanip import PlannerConfig, build_scenario, find_scenario, simulate
from jaxlocomanip.planner.config import Horizon
from jaxlocomanip.recording.figures import draw_figure
from jaxlocomanip.recording.rerun import write_recording

# %% tags=["parameters"]
SECONDS = 20.0
STAGES = 30

# %% [markdown]
# A scenario is a checked file (`jaxlocomanip list` names those of the library); `build_scenario` makes arrays of it.

# %%
spec = replace(find_scenario("adaptive"), duration=SECONDS)
scenario = build_scenario(spec)
print(f"start {spec.start}, goal {spec.goal.pose}, true mass {spec.truth.mass} kg, {len(spec.obstacles)} obstacles")

# %% [markdown]
# The whole closed loop of planner and world is one compiled function. The first call compiles for a minute.

# %%
config = PlannerConfig(horizon=Horizon(steps=STAGES))
result = simulate(scenario, config)
outcome = result.outcome
print(f"reached: {bool(outcome.reached)}, after {float(outcome.reach_time_s):.1f} s")
print(f"clearance of object and robots: {outcome.min_object_clearance_m:.2f} m, {outcome.min_robot_clearance_m:.2f} m")

# %% [markdown]
# What was learnt on the way: the estimates of the mass and of the floor's friction, beside the truth.

# %%
log = result.log
figure, (masses, frictions) = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
masses.plot(log.time, log.parameters[:, 0], label="estimate")
masses.axhline(float(scenario.truth.mass), color="black", linestyle="--", label="truth")
masses.set(xlabel="time, s", ylabel="mass, kg")
frictions.plot(log.time, log.parameters[:, 4])
frictions.axhline(float(scenario.truth.friction_force), color="black", linestyle="--")
frictions.set(xlabel="time, s", ylabel="sliding friction, N")
masses.legend()
plt.show()

# %% [markdown]
# The figure and the recording that `jaxlocomanip simulate adaptive` leaves; look at the latter with
# `rerun adaptive.rrd`.

# %%
folder = Path(tempfile.mkdtemp())
draw_figure(folder / "adaptive.png", spec.name, scenario, result)
write_recording(folder / "adaptive.rrd", spec.name, scenario, log)
print(*(f"{path} ({path.stat().st_size // 1000} kB)" for path in sorted(folder.iterdir())), sep="\n")
plt.figure(figsize=(12, 8))
plt.imshow(plt.imread(folder / "adaptive.png"))
plt.axis("off")
plt.show()

# %%
assert np.isfinite(log.view.pose).all() and len(log.time) == round(SECONDS / config.horizon.tick)
