"""The robots' numbers: published facts, and agreement of the XML reader with MuJoCo."""

import dataclasses
import importlib.resources

import pytest

from jaxlocomanip.robots.model import PUSH_FRICTION, ROBOT_TYPES, RobotModel, load_robot

TOTAL_MASS = {"aliengo": 24.638, "a1": 12.454, "go1": 12.743}  # kg, published models
STAND_HEIGHT = {"aliengo": 0.35, "a1": 0.30, "go1": 0.30}  # m
TORQUE_MAX = {"aliengo": (35.278, 35.278, 44.4), "a1": (33.5, 33.5, 33.5), "go1": (23.7, 23.7, 35.55)}  # Nm
LEGS = ("FR", "FL", "RR", "RL")
JOINTS = ("hip", "thigh", "calf")

every_robot = pytest.mark.parametrize("name", ROBOT_TYPES)


def standing(name):
    """MuJoCo's model and data of a robot at its stand keyframe."""
    mujoco = pytest.importorskip("mujoco")
    path = importlib.resources.files("jaxlocomanip.robots").joinpath(f"{name}.xml")
    model = mujoco.MjModel.from_xml_string(path.read_text(encoding="utf-8"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    return model, data


def box_extent(model, data, geom):
    """Half-extents [3] of a geom's box along the world's axes, from MuJoCo's oriented bounding box."""
    half = model.geom_aabb[geom, 3:]
    return abs(data.geom_xmat[geom].reshape(3, 3)) @ half


@every_robot
def test_total_mass_is_the_published_one(name):
    assert load_robot(name).mass == pytest.approx(TOTAL_MASS[name], abs=1e-3)


@every_robot
def test_rectangle_is_plausible(name):
    robot = load_robot(name)
    assert 0.5 < 2 * robot.half_length < 0.75
    assert 0.28 < 2 * robot.half_width < 0.36
    assert robot.reach == robot.half_length
    assert robot.reach < robot.trunk_offset < 2 * robot.reach  # the trunk's origin lies behind the centre, inside


@every_robot
def test_push_limits_belong_to_the_robot(name):
    robot = load_robot(name)
    assert robot.push_force_max == pytest.approx(PUSH_FRICTION * TOTAL_MASS[name] * 9.81, rel=1e-4)
    assert 0.0 < robot.slide_speed_max < robot.push_speed_max


def test_fields_are_plain_and_frozen():
    robot = load_robot("go1")
    values = [getattr(robot, f.name) for f in dataclasses.fields(RobotModel) if f.name != "name"]
    assert all(type(v) is float for v in values)
    with pytest.raises(dataclasses.FrozenInstanceError):
        robot.mass = 1.0
    assert load_robot("go1") is robot


@pytest.mark.parametrize(("given", "nearest"), [("Go2", "go1"), ("alien", "aliengo"), ("A1", "a1"), ("", None)])
def test_unknown_type_names_value_choices_and_nearest(given, nearest):
    with pytest.raises(ValueError, match="robot type") as error:
        load_robot(given)
    message = str(error.value)
    assert repr(given) in message
    assert ", ".join(ROBOT_TYPES) in message
    assert nearest is None or message.endswith(f"did you mean {nearest!r}?")


@every_robot
def test_mass_and_rectangle_agree_with_mujoco(name):
    model, data = standing(name)
    robot = load_robot(name)
    assert robot.mass == pytest.approx(float(model.body_mass.sum()), abs=1e-9)

    pusher = model.geom("pusher").id
    front = data.geom_xpos[pusher, 0] + model.geom_size[pusher, 0]
    assert robot.trunk_offset == pytest.approx(front - data.body("trunk").xpos[0], abs=1e-9)

    bodies = [model.body(b).name for b in model.geom_bodyid]
    low = data.geom_xpos - [box_extent(model, data, g) for g in range(model.ngeom)]
    high = data.geom_xpos + [box_extent(model, data, g) for g in range(model.ngeom)]
    rear = min(low[g, 0] for g, b in enumerate(bodies) if b == "trunk" or b.endswith("_hip"))
    assert 2 * robot.half_length == pytest.approx(front - rear, abs=1e-6)
    # Nothing of the standing robot sticks out of the rectangle sideways, or past the pusher in front.
    assert robot.half_width == pytest.approx(high[:, 1].max(), abs=1e-6)
    assert robot.half_width == pytest.approx(-low[:, 1].min(), abs=1e-6)
    assert high[:, 0].max() == pytest.approx(front, abs=1e-6)


@every_robot
def test_stands_on_its_feet(name):
    model, data = standing(name)
    assert data.body("trunk").xpos[2] == pytest.approx(STAND_HEIGHT[name])
    for leg in LEGS:
        foot = model.geom(f"{leg}_foot").id
        assert data.geom_xpos[foot, 2] - model.geom_size[foot, 0] == pytest.approx(0.0, abs=2e-3)
        assert data.geom_xpos[foot, 0] == pytest.approx(data.body(f"{leg}_hip").xpos[0], abs=1e-3)
    limits = model.jnt_range[1:]
    assert ((limits[:, 0] < data.qpos[7:]) & (data.qpos[7:] < limits[:, 1])).all()


@every_robot
def test_joints_and_motors(name):
    model, _ = standing(name)
    names = [f"{leg}_{joint}" for leg in LEGS for joint in JOINTS]
    assert (model.nq, model.nv, model.nu) == (19, 18, 12)
    assert [model.joint(j).name for j in range(1, 13)] == [f"{n}_joint" for n in names]
    assert [model.actuator(a).name for a in range(12)] == names
    assert [model.actuator_trnid[a, 0] for a in range(12)] == list(range(1, 13))
    assert model.actuator_ctrlrange[:, 1] == pytest.approx(TORQUE_MAX[name] * 4)
    assert model.actuator_ctrlrange[:, 0] == pytest.approx([-t for t in TORQUE_MAX[name] * 4])


@every_robot
def test_a_scene_decides_about_contacts(name):
    model, _ = standing(name)
    assert not model.geom_contype.any() and not model.geom_conaffinity.any()
    assert model.geom("pusher").friction[0] <= 0.05
