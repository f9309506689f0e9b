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
# # 5. Breaking the planner
#
# Random scenarios miss what is rare. Falsification starts from them, puts obstacles where the object went, and follows
# the gradient of the closest approach: by mass, friction, centre of mass, noise, and the places and motions of
# obstacles, within bounds. The command is `jaxlocomanip falsify`; `docs/falsification.md` says what it found.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from jaxlocomanip import PlannerConfig, build_scenario, load_scenario, simulate
from jaxlocomanip.falsification import Search, falsify
from jaxlocomanip.planner.config import Horizon
from jaxlocomanip.random_worst import sample_worst
from jaxlocomanip.recording.figures import draw_figure
from jaxlocomanip.sampling.study import parse_study
from jaxlocomanip.scenario_file import scenario_to_toml

# %% tags=["parameters"]
STAGES = 15
SECONDS = 4.0
SCREENED, AIMED, LANES, ROUNDS = 32, 16, 8, 1

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
config = PlannerConfig(horizon=Horizon(steps=STAGES))
search = Search(screened=SCREENED, aimed=(AIMED,) * 2, lanes=LANES, rounds=ROUNDS)
print(f"{search.episodes} episodes")
found = falsify(study, config, seed=0, search=search, say=print)

# %% [markdown]
# Random sampling within the same bounds, with as many episodes.

# %%
random = sample_worst(study, config, search.episodes, seed=0, keep=LANES)
print(f"least clearance: {found.worst[0].clearance:.3f} m by search, {random.worst[0].clearance:.3f} m at random")

# %% [markdown]
# What was found is an ordinary scenario file, and runs again with the seed of its noise.

# %%
folder, worst = Path(tempfile.mkdtemp()), found.worst[0]
(folder / "worst.toml").write_text(scenario_to_toml(worst.spec))
print(scenario_to_toml(worst.spec))
scenario = build_scenario(load_scenario(folder / "worst.toml"))
result = simulate(scenario, config, seed=worst.seed)
draw_figure(folder / "worst.png", worst.spec.name, scenario, result)
plt.figure(figsize=(12, 8))
plt.imshow(plt.imread(folder / "worst.png"))
plt.axis("off")
plt.show()

# %%
clearance = min(result.outcome.min_object_clearance_m, result.outcome.min_robot_clearance_m)
# Rounding differs outside of a batch.
assert abs(float(clearance) - worst.clearance) < 0.02
