"""What the planner is told, sees, asks for and remembers."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.formation import team_in
from jaxlocomanip.numerics import pytree
from jaxlocomanip.planner import adaptation, breakaway, estimation, keeping, path, reference, safety
from jaxlocomanip.planner.adaptation import ParameterEstimate
from jaxlocomanip.planner.breakaway import Breakaway
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.decision import options
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.keeping import Kept
from jaxlocomanip.planner.path import Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Formations, Goal, ObjectModel
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.sqp import Iterate


@pytree
class Task:
    """What the planner is told once: geometry, belief and goal."""

    shapes: Shapes
    """with the team in its first formation"""
    formations: Formations
    model: ObjectModel
    goal: Goal

    def in_formation(self, formation: Array) -> Task:
        """The same with the team in a formation [] int; the other ones are still told from the first."""
        team = team_in(self.shapes.team, self.formations, formation)
        return dataclasses.replace(self, shapes=dataclasses.replace(self.shapes, team=team))


@pytree
class Measurement:
    """What a world reports each tick."""

    pose: Array
    """[3] object, m and rad"""
    offset: Array
    """[N_r] m, contact offsets"""
    obstacles: Array
    """[N_o, 2] m"""
    contact: Array
    """[N_r] bool: robots that are at their face; of the others no push is believed to act"""
    formation: Array
    """[] int, that the team has, or is walking to; the offsets are those in it"""


@pytree
class Command:
    """What the planner asks of the robots until the next tick."""

    force: Array
    """[N_r] N, push along the contact normal"""
    offset_rate: Array
    """[N_r] m/s"""
    offset: Array
    """[N_r] m, contact offset at the end of the tick"""
    twist: Array
    """[3] m/s, rad/s: the velocity to which these pushes bring the object in the next stage"""
    resting: Array
    """[] bool: the object has arrived"""
    formation: Array
    """[] int, that the team shall take"""


@pytree
class PlannerState:
    """Everything the planner remembers from tick to tick."""

    object: ObjectEstimate
    obstacles: ObstacleEstimate
    parameters: ParameterEstimate
    path: Path
    origin: Array
    """[3] pose from which a straight path starts"""
    progress: Progress
    solver: Iterate
    force: Array
    """[N_r] N, push believed to act now (the command after the robots' lag)"""
    offset: Array
    """[N_r] m, contact offsets at the last tick"""
    proven: Array
    """[] N, friction that the floor has shown"""
    breakaway: Breakaway
    kept: Kept
    """room that there was between bodies and obstacles"""
    formation: Array
    """[] int, of the team at the last tick"""
    berth: Array
    """[] m, room that walks around the object keep beyond the usual: grows where there was too little"""
    walks: Array
    """[] int, walks around the object so far"""
    command: Command


def start(task: Task, measured: Measurement, config: PlannerConfig) -> PlannerState:
    """State before the first tick, at rest at the first measurement."""
    n = measured.offset.shape[0]
    first = jnp.concatenate([measured.pose, jnp.zeros(3, measured.pose.dtype), measured.offset])
    steps = config.horizon.steps
    guess = Plan(jnp.tile(first, (steps + 1, 1)), jnp.zeros((steps, 2 * n), first.dtype))
    zero = jnp.zeros(n, first.dtype)
    parameters = adaptation.start(task.model, config.adaptation)
    seen = estimation.start_object(measured.pose)
    obstacles = estimation.start_obstacles(measured.obstacles, config.estimation)
    shapes = task.in_formation(measured.formation).shapes
    return PlannerState(
        object=seen,
        obstacles=obstacles,
        parameters=parameters,
        path=path.unsearched(measured.pose, n, path.at_goal(task.goal, measured.formation)),
        origin=measured.pose,
        progress=reference.start(),
        solver=sqp.start(guess, options(config)),
        force=zero,
        offset=measured.offset,
        proven=safety.least_friction(parameters.body, config),
        breakaway=breakaway.start(measured.pose),
        kept=keeping.start(keeping.gaps_of(seen, measured.offset, obstacles, shapes, config)),
        formation=measured.formation,
        berth=jnp.zeros((), first.dtype),
        walks=jnp.zeros((), jnp.int32),
        command=Command(zero, zero, measured.offset, jnp.zeros(3, first.dtype), jnp.ones((), bool), measured.formation),
    )
