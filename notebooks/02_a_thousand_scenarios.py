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
# # 2. A thousand scenarios
#
# A study says what to draw: masses, frictions, teams, goals and obstacles. Scenario k of a seed is the same in any
# batch and on any machine. For studies that take hours there is `jaxlocomanip sweep`, which can be stopped and gone on
# with.

# %%
import dataclasses
import time

import matplotlib.pyplot as plt
import numpy as np

from jaxlocomanip import PlannerConfig, build_scenario, run_batch, sample_scenario
from jaxlocomanip.planner.config import Horizon
from jaxlocomanip.sweep.statistics import percent

# %% tags=["parameters"]
COUNT = 1000
CHUNK = 128
SECONDS = 60.0
STAGES = 30

# %%
specs = [dataclasses.replace(sample_scenario("standard", 0, k), duration=SECONDS) for k in range(COUNT)]
scenarios = [build_scenario(spec, k) for k, spec in enumerate(specs)]
print(f"{COUNT} scenarios; number 0 has {len(specs[0].obstacles)} obstacles and {specs[0].truth.mass:.1f} kg")

# %% [markdown]
# All of them in chunks through one compiled program; memory is bounded by the chunk, and several devices share it.

# %%
config = PlannerConfig(horizon=Horizon(steps=STAGES))
begun = time.perf_counter()
outcome = run_batch(scenarios, config, chunk=CHUNK, progress=lambda done, total: print(f"{done} of {total}", end="\r"))
print(f"\n{time.perf_counter() - begun:.0f} s, with the compilation")

# %% [markdown]
# Shares with exact (Clopper-Pearson) intervals, in percent.

# %%
print("reached         ", percent(int(outcome.reached.sum()), COUNT))
print("collided        ", percent(int(outcome.collided.sum()), COUNT))
print("reached, touched nothing", percent(int((outcome.reached & ~outcome.collided).sum()), COUNT))

# %%
clearance = np.minimum(outcome.min_object_clearance_m, outcome.min_robot_clearance_m)
masses = [spec.truth.mass for spec in specs]
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
left.hist(np.minimum(clearance, 1.0), bins=40)
left.set(xlabel="least clearance, m", ylabel="scenarios")
right.scatter(masses, outcome.reach_time_s, s=4)
right.set(xlabel="true mass, kg", ylabel="time to the goal, s")
plt.show()

# %% [markdown]
# The worst one, to be looked at: `build_scenario(specs[worst], worst)` and `simulate` run it again with its trajectory.

# %%
worst = int(np.argmin(clearance))
print(f"number {worst}: {clearance[worst]:.3f} m, final error {outcome.final_position_error_m[worst]:.2f} m")
assert outcome.reached.shape == (COUNT,) and outcome.nonfinite.sum() == 0
