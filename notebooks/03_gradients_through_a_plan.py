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
# # 3. Gradients through a plan
#
# An optimal plan follows its problem smoothly. By the implicit function theorem, its derivative by anything in the
# problem is one more linear-quadratic solve, whatever number of iterations found the plan.

# %%
import dataclasses

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from jaxlocomanip import PlannerConfig, build_scenario, parse_scenario
from jaxlocomanip.planner import problem, reference
from jaxlocomanip.planner.config import Horizon
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.path import POINTS, pace, straight_poses
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.solver import implicit, sqp
from jaxlocomanip.solver.ocp import Plan

# %% tags=["parameters"]
STAGES = 30

# %% [markdown]
# A box, two robots, and an obstacle beside the straight way. The planner's optimal control problem over the next three
# seconds:

# %%
spec = parse_scenario(
    {
        "name": "beside the way",
        "object": {"size": [0.5, 0.5], "mass": 6.0, "friction": 0.3},
        "start": {"pose": [0.0, 0.0, 0.0]},
        "goal": {"pose": [3.0, 3.0, 0.0]},
        "robots": [{"type": "aliengo", "face": "-x"}, {"type": "aliengo", "face": "-y"}],
        "obstacles": [{"shape": "circle", "radius": 0.3, "position": [1.3, 0.3]}],
    }
)
scenario = build_scenario(spec)
config = jax.tree.map(jnp.asarray, PlannerConfig(horizon=Horizon(steps=STAGES)))
shapes, body = shapes_of(scenario), scenario.object.body


x0 = jnp.zeros(8)


@jax.jit
def assembled(position):
    """The problem with the obstacle at `position` [1, 2], and a first guess of its plan."""
    turn_radius = config.reference.speed / config.reference.turn_rate
    path = pace(straight_poses(scenario.start, scenario.goal.pose, POINTS), shapes, body, turn_radius)
    times = config.horizon.dt * jnp.arange(STAGES + 1.0)
    targets = reference.targets(reference.start(), path, times, config.reference)
    still = Plan(jnp.zeros((STAGES + 1, 8)), jnp.zeros((STAGES, 4)))
    obstacles = ObstacleEstimate(position, jnp.zeros((1, 2)), jnp.zeros((1, 3)))
    made = problem.assemble(targets, still, body, shapes, obstacles, config)
    return made, problem.pushing_start(made, x0)


made, guess = assembled(scenario.obstacles.position)
options = sqp.Options(tolerance=1e-4)
found = jax.jit(lambda p, x, w: implicit.solve(p, x, sqp.start(w, options), options))(made, x0, guess)
print(f"status {int(found.status)} (0: converged) after {int(found.iterations)} iterations")

# %% [markdown]
# ## How do the first pushes change with what is believed of the object?


# %%
def first_push(body):
    """[2] N, of the optimal plan for this body."""
    return implicit.plan_of(dataclasses.replace(made, body=body), x0, found.plan).us[0, :2]


push = found.plan.us[0, :2]
by_body = jax.jit(jax.jacfwd(first_push))(made.body)
print("pushes now, N:      ", np.round(push, 2))
print("per kg of mass:     ", np.round(by_body.mass, 2))
print("per N of friction:  ", np.round(by_body.friction_force, 2))
print("per cm of com, x, y:", np.round(0.01 * by_body.com, 2).tolist())

# %% [markdown]
# ## Where would the plan go if the obstacle stood elsewhere?
#
# One derivative of the whole plan, in the direction in which the obstacle moves off the way.


# %%
def plan_by_place(position):
    """The optimal plan with the obstacle at `position` [1, 2]."""
    return implicit.plan_of(assembled(position)[0], x0, found.plan)


place, aside = scenario.obstacles.position, jnp.array([[1.0, -1.0]]) / jnp.sqrt(2.0)
plan, change = jax.jit(lambda p, way: jax.jvp(plan_by_place, (p,), (way,)))(place, aside)
figure, axes = plt.subplots(figsize=(5, 5), layout="constrained")
for by in (0.0, 0.1, 0.2):
    axes.plot(*(plan.xs + by * change.xs)[:, :2].T, label=f"obstacle {100 * by:.0f} cm aside")
axes.add_patch(plt.Circle(place[0], 0.3, color="grey"))
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
axes.legend()
plt.show()

# %%
assert int(found.status) == 0
assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((by_body, change)))
