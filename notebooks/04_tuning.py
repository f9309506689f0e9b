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
# # 4. Tuning with optax
#
# Weights, barrier shapes and gains of the planner, adjusted by stochastic gradient through the whole closed loop. A
# gradient costs about eight episodes, and its program takes minutes to compile, once. The command for a real run is
# `jaxlocomanip tune`.

# %%
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt

from jaxlocomanip import PlannerConfig, build_scenario, sample_scenario, stack
from jaxlocomanip.config_file import config_to_toml, load_config
from jaxlocomanip.knobs import changes, knobs_of
from jaxlocomanip.planner.config import Horizon
from jaxlocomanip.sampling.study import parse_study
from jaxlocomanip.sweep.plan import padding
from jaxlocomanip.tuning import Settings, tune

# %% tags=["parameters"]
STAGES = 15
SECONDS = 4.0
TRAIN, HELD_OUT, BATCH = 32, 16, 8
STEPS = 20

# %% [markdown]
# Random scenarios with obstacles close to a short way: some to learn from, others to choose by.

# %%
study = parse_study(
    f"""
name = "close"
extends = "standard"
duration = {SECONDS}
goal = {{ distance = {{ uniform = [1.2, 1.8] }} }}
obstacles = {{ count = 2, half_size = {{ uniform = [0.2, 0.3] }}, lateral = {{ uniform = [-0.8, 0.8] }} }}
"""
)
lanes = [build_scenario(sample_scenario(study, 0, k), k) for k in range(TRAIN + HELD_OUT)]
train, held_out = stack(lanes[:TRAIN], padding(study)), stack(lanes[TRAIN:], padding(study))

# %% [markdown]
# Settings are searched by their logarithms, so that they stay positive. The checkpoint lets a stopped run go on.

# %%
start = PlannerConfig(horizon=Horizon(steps=STAGES))
names = ("weights", "constraints.robot_cbf", "constraints.object_cbf")
folder = Path(tempfile.mkdtemp())
tuned = tune(
    start,
    train,
    held_out,
    ticks=round(SECONDS / start.horizon.tick),
    settings=Settings(names, steps=STEPS, batch=BATCH),
    checkpoint=folder / "tune.json",
    say=print,
)

# %%
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
for key, marker in (("train", "."), ("held_out", "o-")):
    rows = [row for row in tuned.history if key in row]
    axes.plot([row["step"] for row in rows], [row[key] for row in rows], marker, label=key)
axes.set(xlabel="step", ylabel="loss")
axes.legend()
plt.show()

# %% [markdown]
# The result is a file that `--config` takes: `jaxlocomanip sweep standard --config tuned.toml --out out/tuned`.

# %%
(folder / "tuned.toml").write_text(config_to_toml(tuned.config))
for name, (before, after) in changes(start, tuned.config, knobs_of(start, names)).items():
    print(f"{name:36} {before:8.4g} -> {after:8.4g}")
assert jax.tree.leaves(load_config(folder / "tuned.toml")) == jax.tree.leaves(tuned.config)
assert tuned.loss <= tuned.history[0]["held_out"]
