"""How the cost of a warm SQP iteration of the planner grows: with the batch, the horizon, robots and obstacles."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.processes import in_fresh_process

BATCH, LANES = (1, 4, 16, 64, 256, 1024), 64
"""numbers of lanes, and how many where something else is varied"""
STAGES, ROBOTS, OBSTACLES = (10, 20, 30, 40, 50), (2, 3, 4), (1, 2, 4, 6, 8)
USUAL = {"stages": 30, "robots": 2, "obstacles": 2}
SATURATED = 16
"""lanes from which on a batch keeps the cores of a CPU busy"""
FACES = ("-x", "-y", "+x", "+y")
AXES = {"lanes": "lanes", "stages": "stages N", "robots": "robots N_r", "obstacles": "obstacles N_o"}


def measure(repeats: int) -> dict[str, Any]:
    """For each of `AXES`: sizes, ms of an iteration of the whole batch, exponent and straight line."""
    points = in_fresh_process("benchmarks.scaling", str(repeats), PJRT_NPROC="16")
    return {axis: {"points": found, **fitted(axis, found)} for axis, found in points.items()}


def fitted(axis: str, points: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Exponent p of ms ~ size^p, and ms = base + slope size with the largest relative deviation from it."""
    kept = [point for point in points if axis != "lanes" or point["size"] >= SATURATED]
    size, ms = (np.array([point[name] for point in kept]) for name in ("size", "ms"))
    # Relative errors count: a small batch is as good a measurement as a large one.
    line = np.polynomial.Polynomial.fit(size, ms, 1, w=1.0 / ms).convert()
    base, slope = line.coef
    return {
        "exponent": round(float(np.polyfit(np.log(size), np.log(ms), 1)[0]), 3),
        "base_ms": round(float(base), 4),
        "slope_ms": round(float(slope), 5),
        "deviation": round(float(np.max(np.abs(line(size) / ms - 1.0))), 3),
    }


def draw(path: Path, measured: Mapping[str, Any]) -> None:
    """A figure for each axis, with the straight lines, in one file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, places = pyplot.subplots(1, len(AXES), figsize=(12, 3), layout="constrained")
    for place, (axis, label) in zip(places, AXES.items(), strict=True):
        found = measured[axis]
        size, ms = (np.array([point[name] for point in found["points"]]) for name in ("size", "ms"))
        along = np.linspace(0.0, size.max(), 100)[1:] if axis != "lanes" else np.geomspace(SATURATED, size.max(), 100)
        line = found["base_ms"] + found["slope_ms"] * along
        place.plot(along, line, "-", color="0.6", lw=1, label="straight line, fitted")
        place.plot(size, ms, "o", ms=4, label="measured")
        if axis == "lanes":
            place.set_xscale("log", base=2)
            place.set_yscale("log")
        else:
            place.set_xlim(left=0.0)
            place.set_ylim(bottom=0.0)
        place.set_xlabel(label)
        off = f"off the line by {100 * found['deviation']:.0f} % at most"
        place.set_title(off if axis == "lanes" else f"{LANES} lanes, {off}", fontsize=9)
    places[0].set_ylabel("one iteration of all lanes [ms]")
    places[0].legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def run(repeats: int) -> dict[str, list[dict[str, float]]]:
    """Points of all axes."""
    sizes = {"lanes": BATCH, "stages": STAGES, "robots": ROBOTS, "obstacles": OBSTACLES}
    return {
        axis: [{"size": size, "ms": _iteration({**USUAL, "lanes": LANES, axis: size}, repeats)} for size in values]
        for axis, values in sizes.items()
    }


def _iteration(sizes: Mapping[str, int], repeats: int) -> float:
    """ms of a warm iteration of all lanes, shared out over the devices; the least of several."""
    import jax
    from jax.sharding import Mesh, NamedSharding, PartitionSpec

    from benchmarks.reference_problem import GROUP
    from jaxlocomanip.batch import cpu_options
    from jaxlocomanip.solver import sqp

    lanes, options = sizes["lanes"], sqp.Options()
    devices = jax.devices()[: min(lanes, jax.device_count())]
    spread = PartitionSpec("lanes")
    mesh = Mesh(np.array(devices), ("lanes",))
    given = jax.device_put(_lanes(sizes), NamedSharding(mesh, spread))
    group = min(GROUP, -(-lanes // mesh.size)) if devices[0].platform == "cpu" else -(-lanes // mesh.size)

    def share(*held: Any) -> Any:
        def lane(one: tuple[Any, ...]) -> Any:
            problem, x0, iterate = one
            return sqp.solve(problem, x0, iterate, options)

        return jax.lax.map(lane, held, batch_size=group)

    shares = jax.shard_map(share, mesh=mesh, in_specs=spread, out_specs=spread, check_vma=False)
    program = jax.jit(shares).lower(*given).compile(compiler_options=cpu_options(devices))
    warm, taken = given[2], []
    for k in range(5 + repeats):
        start = time.perf_counter()
        warm = jax.block_until_ready(program(*given[:2], warm))
        if k >= 5:
            taken.append(time.perf_counter() - start)
    return round(1e3 * min(taken), 4)


def _lanes(sizes: Mapping[str, int]) -> tuple[Any, Any, Any]:
    """Problems on the straight line past obstacles that each lane has elsewhere, first states and cold iterates."""
    import jax
    import jax.numpy as jnp

    from jaxlocomanip import PlannerConfig, build_scenario, find_scenario
    from jaxlocomanip.loop import task_of
    from jaxlocomanip.planner import adaptation, problem, reference, state
    from jaxlocomanip.planner.path import POINTS, pace, straight_poses
    from jaxlocomanip.worlds.planar import PlanarWorld

    spec, n = find_scenario("adaptive"), sizes["robots"]
    # To both sides of the line, from one end of the horizon to the other.
    places = [
        (1.5 + 0.35 * (k // 2) + aside, 1.5 + 0.35 * (k // 2) - aside)
        for k in range(sizes["obstacles"])
        for aside in (0.85 * (-1) ** k,)
    ]
    circles = tuple(dataclasses.replace(spec.obstacles[0], position=place, velocity=(0.0, 0.0)) for place in places)
    robots = tuple(dataclasses.replace(spec.robots[0], face=face) for face in FACES[:n])
    scenario = build_scenario(dataclasses.replace(spec, robots=robots, obstacles=circles))
    base = PlannerConfig()
    config = dataclasses.replace(base, horizon=dataclasses.replace(base.horizon, steps=sizes["stages"]))
    task, world = task_of(scenario), PlanarWorld()
    view = world.view(world.start(scenario), scenario)
    measured = state.Measurement(view.pose, view.offset, scenario.obstacles.position, view.contact, view.formation)

    def one(moved: Any) -> tuple[Any, Any, Any]:
        seen = dataclasses.replace(measured, obstacles=measured.obstacles + moved)
        held = state.start(task, seen, config)
        body = adaptation.start(scenario.object, config.adaptation).body
        line = straight_poses(seen.pose, scenario.goal.pose, POINTS)
        path = pace(line, task.shapes, body, config.reference.turn_radius)
        times = config.horizon.dt * jnp.arange(config.horizon.steps + 1.0)
        targets = reference.targets(held.progress, path, times, config.reference)
        made = problem.assemble(targets, held.solver.plan, body, task.shapes, held.obstacles, config)
        return made, held.solver.plan.xs[0], held.solver

    moved = np.random.default_rng(0).uniform(-0.3, 0.3, (sizes["lanes"], *measured.obstacles.shape))
    return jax.jit(jax.vmap(one))(jnp.asarray(moved, view.pose.dtype))


if __name__ == "__main__":
    print(json.dumps(run(int(sys.argv[1]))))
