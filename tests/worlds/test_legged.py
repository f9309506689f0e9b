"""Robots' parameters against MuJoCo's own sums, and refusals of files that are no such robot."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

from jaxlocomanip.checked import InputError  # noqa: E402
from jaxlocomanip.robots.model import ROBOT_TYPES, load_robot  # noqa: E402
from jaxlocomanip.worlds.legged import joint_names, read_robot, robot_path  # noqa: E402

every_robot = pytest.mark.parametrize("name", ROBOT_TYPES)
LEG = ("FR", "FL", "RR", "RL")


def standing(path):
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    return model, data


@every_robot
def test_mass_inertia_and_com_are_sums_over_the_bodies(name):
    robot = read_robot(name)
    model, data = standing(robot_path(name))
    mass = model.body_mass[1:]
    com = mass @ data.xipos[1:] / mass.sum()
    inertia = np.zeros((3, 3))
    for body in range(1, model.nbody):
        axes, off = data.ximat[body].reshape(3, 3), data.xipos[body] - com
        inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += model.body_mass[body] * (off @ off * np.eye(3) - np.outer(off, off))
    assert robot.mass == pytest.approx(mass.sum()) == pytest.approx(load_robot(name).mass)
    assert robot.com == pytest.approx(com - data.body("trunk").xpos, abs=1e-6)
    assert robot.inertia == pytest.approx(inertia, abs=1e-5)


@every_robot
def test_geometry_and_limits(name):
    robot = read_robot(name)
    model, data = standing(robot_path(name))
    hips = np.array([data.joint(f"{leg}_hip_joint").xanchor for leg in LEG]) - data.body("trunk").xpos
    assert robot.hip == pytest.approx(hips, abs=1e-6)
    assert (np.sign(robot.abduction) == [-1, 1, -1, 1]).all()
    assert robot.stand_height == pytest.approx(data.body("trunk").xpos[2], abs=2e-3)
    assert robot.pusher[0] + robot.pusher_radius == pytest.approx(load_robot(name).trunk_offset, abs=1e-6)
    motors = [model.actuator(n.removesuffix("_joint")).ctrlrange[1] for n in joint_names()]
    assert np.ravel(robot.torque_max) == pytest.approx(motors)
    assert np.ravel(robot.joint_low) == pytest.approx([model.joint(n).range[0] for n in joint_names()])
    legs = np.asarray(robot.leg_inertia)
    assert legs == pytest.approx(np.swapaxes(legs, 1, 2)) and (np.linalg.eigvalsh(legs) > 0.0).all()


def test_leaves_are_arrays_of_one_precision_and_stack():
    robots = [read_robot(name) for name in ROBOT_TYPES]
    team = jax.tree.map(lambda *leaves: jnp.stack(leaves), *robots)
    assert team.hip.shape == (3, 4, 3)
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(team))


def test_a_path_works_as_well_as_a_name(tmp_path):
    copy = tmp_path / "mine.xml"
    copy.write_text(robot_path("go1").read_text(encoding="utf-8"), encoding="utf-8")
    ours, theirs = read_robot(copy), read_robot("go1")
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("", "", r"must be one of aliengo, a1, go1 or an MJCF file"),
        ("<mujoco", "<nonsense", r"not a model that MuJoCo can read"),
        ('name="FL_calf_joint"', 'name="knee"', r"not a model|hinge joint 'FL_calf_joint'"),
        ('"RR_foot"', '"RR_toe"', r"needs sphere geom 'RR_foot'"),
        ('"pusher"', '"nose"', r"needs sphere geom 'pusher'"),
        ('name="stand"', 'name="sit"', r"needs keyframe 'stand'"),
        ('type="sphere" size="0.06"', 'type="box" size="0.06 0.06 0.06"', r"'pusher' must be a sphere"),
        ('<body name="FL_calf" pos="0 0 -0.25">', '<body name="FL_calf" pos="0 0 -0.2">', r"lengths of the thighs"),
        ('"RL_thigh" pos="0 0.083 0"', '"RL_thigh" pos="0.05 0.083 0"', r"legs must have a hip axis"),
        ('<motor ctrlrange="-44.4 44.4"/>', "", r"motor of joint 'FR_calf_joint' needs a ctrlrange"),
        ('<motor name="RL_calf" class="aliengo_calf" joint="RL_calf_joint"/>', "", r"'RL_calf_joint' needs one motor"),
    ],
)  # fmt: skip
def test_refusals_name_the_file_and_what_is_needed(old, new, said, tmp_path):
    path = tmp_path / "broken.xml"
    if old:
        text = robot_path("aliengo").read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=said) as error:
        read_robot(path)
    assert "broken.xml" in str(error.value) and "\n" not in str(error.value)
