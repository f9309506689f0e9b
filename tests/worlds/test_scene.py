"""The scene as MuJoCo sees it: the object's mechanics, where everything starts, contacts, and refused input."""

import importlib.resources

import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.locomotion.robot import JOINTS, LEGS
from jaxlocomanip.padding import stack
from jaxlocomanip.robots.model import load_robot

mujoco = pytest.importorskip("mujoco")

from jaxlocomanip.worlds import scene_shapes  # noqa: E402
from jaxlocomanip.worlds.scene import STANDOFF, build_scene, standoffs  # noqa: E402

HEXAGON = [[0.3 * np.cos(a), 0.3 * np.sin(a)] for a in np.arange(6) * np.pi / 3]
TRIANGLE = [[0.0, 0.0], [0.7, 0.0], [0.2, 0.6]]
MIXED = [{"type": t, "face": f} for t, f in (("aliengo", "-x"), ("a1", "-y"), ("go1", "+y"))]
OBSTACLES = [
    {"shape": "circle", "radius": 0.3, "position": [2.0, 1.0]},
    {"shape": "box", "size": [0.5, 0.4], "yaw": 0.5, "position": [1.0, 2.0], "velocity": [0.1, 0.0]},
    {"shape": "polygon", "vertices": TRIANGLE, "position": [2.0, 3.0]},
    {
        "shape": "circle",
        "radius": 0.2,
        "position": [3.0, 0.0],
        "motion": {"kind": "sine", "amplitude": [0, 1], "period": 4},
    },
]


def placed(scene):
    """MuJoCo's data at the start of a scene."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos
    mujoco.mj_forward(scene.model, data)
    return data


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def object_inertia(model):
    """[3, 3] about the centre of mass, in the axes of the body."""
    body = model.body("object")
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, body.iquat)
    axes = rotation.reshape(3, 3)
    return axes @ np.diag(body.inertia) @ axes.T


@pytest.mark.parametrize(
    "shape",
    [{"size": [0.5, 0.3]}, {"footprint": HEXAGON}, {"footprint": TRIANGLE}, {"size": [0.4, 0.8], "inertia": 2.5}],
    ids=["box", "hexagon", "triangle", "given inertia"],
)
def test_object_has_the_true_mechanics(make_scenario, shape):
    robots = [{"type": "go1", "face": 0}]
    truth = {"mass": 9.0, "com": [0.15, 0.1], "friction": 0.35}
    scenario = make_scenario(object={**shape, "height": 0.4, "mass": 6.0}, truth=truth, robots=robots)
    model = build_scene(scenario).model
    body = model.body("object")
    assert body.mass[0] == pytest.approx(9.0)
    assert body.ipos == pytest.approx([0.15, 0.1, 0.2], abs=1e-6)
    inertia = object_inertia(model)
    about_p = inertia[2, 2] + 9.0 * (0.15**2 + 0.1**2)
    assert about_p == pytest.approx(float(scenario.truth.inertia), rel=1e-5)
    moments = np.linalg.eigvalsh(inertia)
    assert (moments > 0.0).all() and moments[2] < moments[0] + moments[1]
    floor = model.geom("floor").id
    under = np.flatnonzero((model.pair_geom1 == floor) & (model.geom_bodyid[model.pair_geom2] == body.id))
    assert under.size == (1 if "size" in shape else len(shape["footprint"]))
    assert model.pair_friction[under, :2] == pytest.approx(0.35, rel=1e-5)


def test_uniform_box_has_its_textbook_inertia(make_scenario):
    scenario = make_scenario(object={"size": [0.6, 0.4], "height": 0.5, "mass": 12.0})
    expected = np.diag([0.4**2 + 0.5**2, 0.6**2 + 0.5**2, 0.6**2 + 0.4**2])
    assert object_inertia(build_scene(scenario).model) == pytest.approx(expected, rel=1e-4, abs=1e-9)


def test_inertia_of_a_prism_is_that_of_its_mesh():
    """MuJoCo integrates over the triangles of a mesh; here a skew prism whose centre is not the origin."""
    corners, height = np.array(TRIANGLE), 0.4
    spec = mujoco.MjSpec()
    scene_shapes._add_prism(spec, "prism", corners, height)
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="prism", mass=5.0)
    expected = object_inertia(spec.compile())
    assert scene_shapes.solid_inertia(corners, height, 5.0, expected[2, 2]) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_rectangles_are_recognised(angle):
    corners = np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]) @ turned(angle).T + [0.1, 0.4]
    center, half, yaw = scene_shapes.as_rectangle(corners)
    assert center == pytest.approx([0.1, 0.4]) and half == pytest.approx([0.3, 0.2]) and yaw == pytest.approx(angle)
    assert scene_shapes.as_rectangle(corners + [[0, 0], [0, 0], [0.1, 0], [0, 0]]) is None
    assert scene_shapes.as_rectangle(np.array(HEXAGON)) is None


def test_padding_of_a_footprint_is_left_out(make_scenario):
    robots = [{"type": "a1", "face": 0}]
    lanes = [make_scenario(object={"footprint": f, "mass": 6.0}, robots=robots) for f in (HEXAGON, TRIANGLE)]
    padded = stack(lanes).object
    assert padded.vertices.shape == (2, 6, 2)
    shape = type(padded)(**{**vars(lanes[1].object), "vertices": padded.vertices[1]})
    assert scene_shapes.footprint(shape) == pytest.approx(np.array(TRIANGLE), abs=1e-6)


@pytest.mark.parametrize("standoff", [STANDOFF, 0.0, 0.4])
def test_robots_stand_before_their_faces(make_scenario, standoff):
    start = [0.4, -0.3, 0.7]
    robots = [{**robot, "offset": 0.05} for robot in MIXED]
    scenario = make_scenario(robots=robots, object={"size": [0.7, 0.9], "mass": 5.0}, start={"pose": start})
    scene = build_scene(scenario, standoff=standoff)
    data = placed(scene)
    assert data.body("object").xpos == pytest.approx([0.4, -0.3, 0.0], abs=1e-6) and scene.heading == pytest.approx(0.7)
    touch = np.asarray(scenario.team.contact_points(scenario.team.offset)) @ turned(0.7).T + start[:2]
    ahead = np.asarray(scenario.team.normal) @ turned(0.7).T
    for i, (robot, body) in enumerate(zip(robots, scene.tables.trunk_body, strict=True)):
        front = data.xpos[body, :2] + (load_robot(robot["type"]).trunk_offset + standoff) * ahead[i]
        assert front == pytest.approx(touch[i], abs=1e-5)
        assert data.xmat[body].reshape(3, 3)[:2, 0] == pytest.approx(ahead[i], abs=1e-5)
        soles = data.geom_xpos[list(scene.tables.foot_geom[i]), 2]
        radii = scene.model.geom_size[list(scene.tables.foot_geom[i]), 0]
        assert soles == pytest.approx(radii, abs=2e-3)


def test_a_robot_with_an_obstacle_behind_it_starts_nearer_to_its_face(make_scenario):
    """As far back as leaves 5 cm of room; the other robot starts as usual."""
    scenario = make_scenario()
    rear = np.asarray(scenario.team.robot_poses(scenario.start, scenario.team.offset))[0]
    ahead = np.array([np.cos(rear[2]), np.sin(rear[2])])
    back = float(scenario.team.half_length[0])
    for gap, away in ((0.5, STANDOFF), (0.13, 0.08), (0.05, 0.0), (0.02, 0.0)):
        center = rear[:2] - (back + gap + 0.3) * ahead
        blocked = make_scenario(obstacles=[{"shape": "circle", "position": center.tolist(), "radius": 0.3}])
        found = standoffs(blocked, STANDOFF)
        assert found[0] == pytest.approx(away, abs=STANDOFF / 30.0 + 1e-6)
        assert found[1] == pytest.approx(STANDOFF)


def test_tables_follow_the_leg_order(make_scenario):
    scene = build_scene(make_scenario(robots=MIXED, object={"size": [0.7, 0.9], "mass": 5.0}))
    model, tables = scene.model, scene.tables
    names = [f"{leg}_{joint}" for leg in LEGS for joint in JOINTS]
    for i in range(3):
        for k, name in enumerate(names):
            joint = model.joint(f"r{i}/{name}_joint")
            assert (joint.qposadr[0], joint.dofadr[0]) == (tables.joint_qpos[i][k], tables.joint_dof[i][k])
            assert model.actuator_trnid[tables.actuator[i][k], 0] == joint.id
        assert [model.geom(g).name for g in tables.foot_geom[i]] == [f"r{i}/{leg}_foot" for leg in LEGS]
        assert model.geom(tables.pusher_geom[i]).name == f"r{i}/pusher"
    assert scene.body_names[0] == "object" and len(scene.body_names) == 1 + 3 * 13 == len(tables.bodies)
    assert hash(tables) == hash(
        build_scene(make_scenario(robots=MIXED, object={"size": [0.8, 0.9], "mass": 7.0})).tables
    )


def test_masses_and_limits_are_those_of_the_robots(make_scenario):
    scene = build_scene(make_scenario(robots=MIXED, object={"size": [0.7, 0.9], "mass": 5.0}))
    for i, robot in enumerate(MIXED):
        text = importlib.resources.files("jaxlocomanip.robots").joinpath(f"{robot['type']}.xml").read_text("utf-8")
        alone = mujoco.MjModel.from_xml_string(text)
        mine = [b for b, n in zip(scene.tables.bodies, scene.body_names, strict=True) if n.startswith(f"r{i}/")]
        assert scene.model.body_mass[mine].sum() == pytest.approx(alone.body_mass.sum())
        assert (scene.model.actuator_ctrlrange[list(scene.tables.actuator[i])] == alone.actuator_ctrlrange).all()


def test_only_the_named_pairs_touch(make_scenario):
    model = build_scene(make_scenario(obstacles=OBSTACLES)).model
    assert not model.geom_contype.any() and not model.geom_conaffinity.any()
    pairs = [(model.geom(a).name, model.geom(b).name) for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]
    feet = [("floor", f"r{i}/{leg}_foot") for i in range(2) for leg in LEGS]
    assert sorted(pairs) == sorted([("floor", "object"), *feet, ("object", "r0/pusher"), ("object", "r1/pusher")])
    for i, pair in enumerate(pairs):
        geom = model.geom(pair[1])
        if pair[1].startswith("r"):  # a pair inherits nothing, the scene copies
            assert model.pair_friction[i] == pytest.approx(geom.friction[[0, 0, 1, 2, 2]])
            assert model.pair_solref[i] == pytest.approx(geom.solref) and model.pair_solimp[i] == pytest.approx(
                geom.solimp
            )
        assert model.pair_dim[i] == 3
    soft = model.geom("r0/pusher")
    assert soft.solref[0] > 0.05 and soft.friction[0] <= 0.05


def test_obstacles_are_shown_where_they_are(make_scenario):
    scene = build_scene(make_scenario(obstacles=OBSTACLES))
    data = placed(scene)
    assert scene.mocap == (-1, 0, -1, 1) and scene.model.nmocap == 2
    for i, obstacle in enumerate(OBSTACLES):
        assert data.body(f"obstacle{i}").xpos == pytest.approx([*obstacle["position"], 0.0], abs=1e-6)
    assert scene.model.body_mocapid[scene.model.body("obstacle3").id] == scene.mocap[3]
    bare = build_scene(make_scenario(obstacles=OBSTACLES), scenery=False)
    assert bare.model.nmocap == 0 and bare.mocap == () and bare.model.ntex == 0
    assert (bare.qpos == scene.qpos).all() and bare.tables == scene.tables


def test_a_robot_of_ones_own(make_scenario, tmp_path):
    text = importlib.resources.files("jaxlocomanip.robots").joinpath("go1.xml").read_text("utf-8")
    path = tmp_path / "heavy.xml"
    path.write_text(text.replace('mass="5.204"', 'mass="7.204"'))
    scenario = make_scenario(robots=[{"type": "go1", "face": "-x"}])
    own, packaged = build_scene(scenario, robots=[path]), build_scene(scenario)
    assert own.model.body_mass.sum() - packaged.model.body_mass.sum() == pytest.approx(2.0)
    assert (own.qpos == packaged.qpos).all() and own.structure.robots == (str(path),)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (('name="FR_foot"', 'name="front"'), "has no geom named 'FR_foot'"),
        (('<freejoint name="root"/>', ""), "free joint"),
        (('key name="stand"', 'key name="sit"'), "has no key named 'stand'"),
        (
            ('<motor name="RL_calf" class', '<position kp="9" name="RL_calf" class'),
            "actuator 'RL_calf' must be a motor",
        ),
        (("<mujoco", "<robot"), "is not a readable MJCF"),
    ],
)
def test_odd_robots_are_refused(make_scenario, tmp_path, change, text):
    packaged = importlib.resources.files("jaxlocomanip.robots").joinpath("go1.xml").read_text("utf-8")
    changed = packaged.replace(*change)
    if "freejoint" in change[0]:
        changed = changed.replace("0 0 0.3 1 0 0 0\n", "")
    path = tmp_path / "odd.xml"
    path.write_text(changed)
    with pytest.raises(InputError, match="odd.xml") as error:
        build_scene(make_scenario(robots=[{"type": "go1", "face": "-x"}]), robots=[path])
    assert text in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"standoff": -0.1}, "standoff = -0.1: must be >= 0"),
        ({"standoff": float("nan")}, "standoff = nan: must be finite"),
        ({"timestep": 0.1}, "timestep = 0.1: must be >= 0.0001 and <= 0.005"),
        ({"robots": ["a.xml"]}, "must be 2 MJCF files"),
        ({"robots": ["missing.xml", "missing.xml"]}, "missing.xml: is not a readable MJCF"),
    ],
)
def test_bad_options_are_refused(make_scenario, options, text):
    with pytest.raises(InputError) as error:
        build_scene(make_scenario(), **options)
    assert text in str(error.value)


def test_a_batch_is_refused(make_scenario):
    with pytest.raises(InputError, match="a batch of 2: must be a single scenario"):
        build_scene(stack([make_scenario(0), make_scenario(1)]))
