"""Physics in MuJoCo C: what is observed, held commands, contact forces, and the object's friction with the floor."""

import dataclasses
import itertools

import jax
import numpy as np
import pytest

from jaxlocomanip.locomotion.robot import JointCommand, joint_torque

mujoco = pytest.importorskip("mujoco")

from jaxlocomanip.worlds.physics_c import CPhysics  # noqa: E402
from jaxlocomanip.worlds.scene import build_scene  # noqa: E402

BOX = {"size": [0.5, 0.5], "height": 0.5, "mass": 8.0, "friction": 0.4}
SHAPES = {
    "box": {"size": [0.5, 0.5]},
    "triangle": {"footprint": [[0.35 * np.cos(a), 0.35 * np.sin(a)] for a in np.arange(3) * 2 * np.pi / 3]},
    "hexagon": {"footprint": [[0.35 * np.cos(a), 0.35 * np.sin(a)] for a in np.arange(6) * np.pi / 3]},
}


def hold(seen, kp=300.0, kd=8.0):
    """Springs and dampers that hold the joints where they are seen."""
    one = np.ones_like(seen.robots.joint)
    return JointCommand(seen.robots.joint, 0 * one, kp * one, kd * one, 0 * one)


def settled(physics, steps=250):
    """A state at rest and the command that keeps it."""
    state = physics.start()
    command = hold(physics.observe(state))
    return physics.advance(state, command, steps), command


def shifted(physics, state, robot, ahead):
    """The state with one robot moved forward by `ahead` m, along the x axis of its trunk."""
    rotation = physics.observe(state).robots.rotation[robot]
    qpos = state.qpos.copy()
    qpos[physics.scene.tables.trunk_qpos[robot] :][:2] += ahead * rotation[:2, 0]
    return dataclasses.replace(state, qpos=qpos)


@pytest.fixture(scope="module")
def physics(make_scenario):
    return CPhysics(build_scene(make_scenario(object=BOX), standoff=0.0))


@pytest.fixture(scope="module")
def pressing(physics):
    """One robot leans on the box, the other stands back."""
    state, command = settled(physics)
    state = shifted(physics, shifted(physics, state, 0, 0.03), 1, -0.05)
    return physics.advance(state, command, 30), command


def test_start_is_that_of_the_scenario(make_scenario):
    start = {"pose": [0.3, -0.2, 3.5]}
    seen = (physics := CPhysics(build_scene(make_scenario(start=start)))).observe(physics.start())
    assert seen.pose == pytest.approx([0.3, -0.2, 3.5]) and (seen.twist == 0.0).all()
    assert seen.lift == pytest.approx(0.0, abs=1e-9) and seen.tilt == pytest.approx(0.0, abs=1e-6)
    assert seen.robots.joint.shape == (2, 4, 3) and (seen.robots.velocity == 0.0).all()
    assert not seen.touching.any() and (seen.foot_force == 0.0).all()
    assert seen.body_position.shape == (27, 3) and seen.body_quaternion.shape == (27, 4)


def test_velocities_are_mujocos_own(physics):
    """Of the body frames' origins and about the world's axes, for a tilted, moving state."""
    rng = np.random.default_rng(3)
    state = physics.start()
    qpos, qvel = state.qpos + 0.1 * rng.normal(size=state.qpos.size), rng.normal(size=state.qvel.size)
    seen = physics.observe(dataclasses.replace(state, qpos=qpos, qvel=qvel))
    data = mujoco.MjData(physics.model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(physics.model, data)
    tables, velocity = physics.scene.tables, np.zeros(6)

    def measured(body):
        mujoco.mj_objectVelocity(physics.model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
        return velocity[:3].copy(), velocity[3:].copy()

    for i, body in enumerate(tables.trunk_body):
        angular, linear = measured(body)
        assert seen.robots.angular_velocity[i] == pytest.approx(angular)
        assert seen.robots.velocity[i] == pytest.approx(linear)
        assert seen.robots.position[i] == pytest.approx(data.xpos[body])
        assert seen.robots.rotation[i].ravel() == pytest.approx(data.xmat[body])
    angular, linear = measured(tables.object_body)
    assert seen.twist == pytest.approx([linear[0], linear[1], angular[2]])
    axis = data.xmat[tables.object_body].reshape(3, 3)[:, 2]
    assert seen.tilt == pytest.approx(np.arccos(axis[2])) and seen.lift == pytest.approx(data.body("object").xpos[2])
    assert seen.body_position == pytest.approx(data.xpos[list(tables.bodies)])
    assert seen.body_quaternion == pytest.approx(data.xquat[list(tables.bodies)])


def test_torques_are_those_of_the_held_command(physics):
    """Anew in every physics step, and clipped to the motors' limits."""
    rng = np.random.default_rng(1)
    state = settled(physics, 20)[0]
    seen = physics.observe(state)
    shape = seen.robots.joint.shape
    command = JointCommand(*(scale * rng.normal(size=shape) for scale in (1.0, 2.0, 0.0, 0.0, 25.0)))
    command = dataclasses.replace(command, kp=np.full(shape, 20.0), kd=np.full(shape, 0.7))
    limit = physics.model.actuator_ctrlrange[np.ravel(physics.scene.tables.actuator), 1].reshape(shape)
    clipped = 0
    for _ in range(3):
        expected = np.asarray(joint_torque(command, seen.robots.joint, seen.robots.joint_rate, limit))
        state = physics.advance(state, command, 1)
        applied = physics.data.ctrl[np.ravel(physics.scene.tables.actuator)].reshape(shape)
        assert applied == pytest.approx(expected, rel=1e-4, abs=1e-3)
        clipped += int((np.abs(expected) >= limit - 1e-6).sum())
        seen = physics.observe(state)
    assert clipped > 0


def test_steps_add_up_and_states_may_alternate(physics, pressing):
    state, command = pressing
    whole = physics.advance(state, command, 7)
    part = physics.advance(state, command, 3)
    other = physics.advance(physics.start(), command, 5)
    physics.observe(other)
    rest = physics.advance(part, command, 4)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(rest), strict=True):
        assert (a == b).all()


def test_contact_forces_are_mujocos_own(physics, pressing):
    state, command = pressing
    seen = physics.observe(physics.advance(state, command, 3))
    data, tables = physics.data, physics.scene.tables
    feet, push, force = np.zeros((8, 3)), np.zeros(2), np.zeros(6)
    for i in range(data.ncon):
        first, second = data.contact.geom[i]
        mujoco.mj_contactForce(physics.model, data, i, force)
        if second in np.ravel(tables.foot_geom):
            feet[list(np.ravel(tables.foot_geom)).index(second)] += force[:3] @ data.contact.frame[i].reshape(3, 3)
        if first in tables.pusher_geom:
            push[tables.pusher_geom.index(first)] += force[0]
    assert seen.foot_force.reshape(8, 3) == pytest.approx(feet) and (feet[:, 2] > 10.0).all()
    assert seen.push_force == pytest.approx(push) and push[0] > 5.0 and push[1] == 0.0
    assert seen.touching.tolist() == [True, False]


@pytest.mark.parametrize("shape", ["box", "hexagon"])
def test_a_mixed_team_stands(make_scenario, shape):
    sizes = {"box": {"size": [0.8, 1.0]}, "hexagon": {"footprint": 2.0 * np.array(SHAPES["hexagon"]["footprint"])}}
    faces = ["-x", "-y", "+y"] if shape == "box" else [0, 2, 4]
    robots = [{"type": t, "face": f} for t, f in zip(("aliengo", "a1", "go1"), faces, strict=True)]
    body = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in sizes[shape].items()}
    physics = CPhysics(build_scene(make_scenario(object={**body, "mass": 6.0, "friction": 0.3}, robots=robots)))
    seen = physics.observe(settled(physics, 500)[0])
    weights = 9.81 * np.array([24.638, 12.454, 12.743])
    assert seen.foot_force[..., 2].sum(axis=1) == pytest.approx(weights, rel=1e-2)
    assert (seen.robots.rotation[:, 2, 2] > 0.995).all() and np.abs(seen.robots.velocity).max() < 0.01
    assert np.abs(seen.twist).max() < 1e-3 and abs(seen.lift) < 1e-3 and seen.tilt < 1e-3


@pytest.mark.parametrize(("shape", "angle"), list(itertools.product(SHAPES, [0.0, 0.785])))
def test_object_sticks_and_slides_as_its_friction_says(make_scenario, shape, angle):
    """mu m g = 31.4 N, in all directions: below it creeps under 2 mm/s, above it slides."""
    body = {**SHAPES[shape], "height": 0.4, "mass": 8.0, "friction": 0.4}
    robots = [{"type": "a1", "face": 0}]
    physics = CPhysics(build_scene(make_scenario(object=body, robots=robots), standoff=2.0))
    rest, command = settled(physics, 100)

    def speed(force):
        """m/s, mean of the second after 0.4 s of a horizontal force in N on the centre of mass."""
        physics.data.xfrc_applied[physics.scene.tables.object_body, :2] = force * np.array(
            [np.cos(angle), np.sin(angle)]
        )
        early = physics.advance(rest, command, 200)
        late = physics.advance(early, command, 500)
        return np.linalg.norm(physics.observe(late).pose[:2] - physics.observe(early).pose[:2])

    assert speed(30.0) < 2e-3
    assert speed(31.0) < 2e-3
    assert speed(32.0) > 20e-3


def test_pushing_moves_the_object(make_scenario):
    """A robot set into the box by 8 cm is like a compressed spring; the object gives way along the push."""
    physics = CPhysics(build_scene(make_scenario(object={**BOX, "friction": 0.05}), standoff=0.0))
    state, command = settled(physics)
    state = physics.advance(shifted(physics, shifted(physics, state, 0, 0.08), 1, -0.3), command, 100)
    pose = physics.observe(state).pose
    assert pose[0] > 0.02 and abs(pose[1]) < 2e-3 and abs(pose[2]) < 0.02


def test_heading_counts_full_turns(physics):
    state = physics.start()
    qvel = state.qvel.copy()
    qvel[physics.scene.tables.object_dof + 5] = 30.0
    state = dataclasses.replace(state, qvel=qvel, heading=np.asarray(4 * np.pi))
    headings, command = [], hold(physics.observe(state))
    for _ in range(200):
        state = physics.advance(state, command, 1)
        headings.append(float(physics.observe(state).pose[2]))
    assert headings[-1] > 4 * np.pi + 3.5 and (np.abs(np.diff(headings)) < 0.1).all()
    matrix = physics.data.xmat[physics.scene.tables.object_body].reshape(3, 3)
    assert np.cos(headings[-1]) == pytest.approx(matrix[0, 0], abs=1e-3)


def test_what_is_not_a_number_stays_visible(physics, tmp_path, monkeypatch):
    """As in MJX; MuJoCo itself would go on with zeros, and leave a log file."""
    monkeypatch.chdir(tmp_path)
    state, command = settled(physics, 5)
    bad = physics.advance(state, dataclasses.replace(command, torque=np.nan * command.torque), 3)
    assert np.isnan(physics.observe(bad).pose[:2]).all() and np.isnan(bad.qvel).all()
    assert np.isnan(physics.advance(bad, command, 3).qpos).all()
    assert np.isfinite(physics.advance(state, command, 3).qpos).all() and not list(tmp_path.iterdir())


def test_moving_obstacles_are_drawn_where_they_are(make_scenario):
    still = {"shape": "circle", "radius": 0.2, "position": [2.0, 2.0]}
    moving = {"shape": "circle", "radius": 0.2, "position": [2.0, 0.0], "velocity": [0.5, 0.0]}
    physics = CPhysics(build_scene(make_scenario(obstacles=[still, moving])))
    physics.place_obstacles(np.array([[9.0, 9.0], [2.5, 0.1]]))
    physics.observe(physics.start())
    assert physics.data.body("obstacle1").xpos == pytest.approx([2.5, 0.1, 0.0])
    assert physics.data.body("obstacle0").xpos == pytest.approx([2.0, 2.0, 0.0])
