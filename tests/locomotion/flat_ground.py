"""One robot on flat ground, with a box to push if asked for, stepped by MuJoCo's C engine."""

import dataclasses

import jax
import mujoco
import numpy as np

from jaxlocomanip.locomotion.controller import control, start
from jaxlocomanip.locomotion.robot import LEGS, BodyState, joint_torque
from jaxlocomanip.worlds.legged import joint_names, read_robot, robot_path

STEP = 0.002  # s, of the physics
control_once = jax.jit(control)
start_once = jax.jit(start)
torque_once = jax.jit(joint_torque)


@dataclasses.dataclass(frozen=True)
class Box:
    """A cube on the floor in front of the robot."""

    mass: float = 8.0
    size: float = 0.5
    friction: float = 0.4
    fixed: bool = False
    gap: float = 0.01  # m, between pusher and box at the start


@dataclasses.dataclass
class Log:
    """What happened, one row a physics step."""

    time: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    contact: np.ndarray
    box: np.ndarray
    swinging: np.ndarray
    force: np.ndarray
    foot: np.ndarray

    @property
    def tilt(self):
        """[n] rad, between the trunk's z and the vertical."""
        return np.arccos(np.clip(self.rotation[:, 2, 2], -1.0, 1.0))

    @property
    def yaw(self):
        """[n] rad, unwrapped."""
        return np.unwrap(np.arctan2(self.rotation[:, 1, 0], self.rotation[:, 0, 0]))

    def after(self, time):
        """Index of the first row at or after a time."""
        return int(np.searchsorted(self.time, time - 1e-9))

    def mean_velocity(self, since, until=None):
        """[3] m/s over an interval, along the axes of the robot's heading."""
        first, last = self.after(since), len(self.time) - 1 if until is None else self.after(until)
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        vx, vy = self.velocity[:, 0], self.velocity[:, 1]
        own = np.stack([c * vx + s * vy, -s * vx + c * vy, self.velocity[:, 2]], axis=1)
        return own[first:last].mean(axis=0)


def scene(name, box=None):
    """Compiled model: floor, robot, box, and the contact pairs between them."""
    spec = mujoco.MjSpec.from_file(str(robot_path(name)))
    spec.option.timestep = STEP
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.iterations, spec.option.ls_iterations, spec.option.impratio = 4, 8, 1.0
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[50, 50, 0.1], contype=0, conaffinity=0
    )
    bare = mujoco.MjModel.from_xml_path(str(robot_path(name)))
    for leg in LEGS:
        spec.add_pair(geomname1="floor", geomname2=f"{leg}_foot", **_like(bare.geom(f"{leg}_foot")))
    if box is not None:
        robot = read_robot(name)
        half = box.size / 2
        front = float(robot.pusher[0] + robot.pusher_radius)
        body = spec.worldbody.add_body(name="box", pos=[front + box.gap + half, 0.0, half])
        if not box.fixed:
            body.add_freejoint(name="box")
        body.add_geom(
            name="box",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[half] * 3,
            mass=box.mass,
            contype=0,
            conaffinity=0,
        )
        spec.add_pair(geomname1="pusher", geomname2="box", **_like(bare.geom("pusher")))
        mu = box.friction
        spec.add_pair(geomname1="floor", geomname2="box", condim=3, friction=[mu, mu, 0.005, 1e-4, 1e-4])
    return spec.compile()


def _like(own):
    """Contact parameters of a geom, which a pair does not inherit."""
    slide, spin, roll = own.friction
    return {
        "condim": int(own.condim[0]),
        "friction": [slide, slide, spin, roll, roll],
        "solref": own.solref,
        "solimp": own.solimp,
    }


class FlatGround:
    """A running simulation of one robot under its controller."""

    def __init__(self, name, settings, box=None, hold=0.005, solve_every=0.025):
        self.robot, self.settings = read_robot(name), settings
        self.model = scene(name, box)
        self.data = mujoco.MjData(self.model)
        key = mujoco.MjModel.from_xml_path(str(robot_path(name))).key("stand").qpos
        self.data.qpos[:19] = key
        self.box, self.hold, self.solve_every = box, hold, solve_every
        joints = [self.model.joint(n) for n in joint_names()]
        self.qpos = np.array([int(j.qposadr[0]) for j in joints])
        self.qvel = np.array([int(j.dofadr[0]) for j in joints])
        motor = {int(self.model.actuator_trnid[a, 0]): a for a in range(self.model.nu)}
        self.motor = np.array([motor[j.id] for j in joints])
        self.trunk = self.model.body("trunk").id
        self.foot = [self.model.geom(f"{leg}_foot").id for leg in LEGS]
        mujoco.mj_forward(self.model, self.data)
        self.state = start_once(self.robot, settings, self.measure())
        self.command = None
        self.next_call = self.next_solve = 0.0
        self.rows = []

    def measure(self):
        """The robot's state, exact."""
        data, f = self.data, np.float32
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
        rotation = rotation.reshape(3, 3)
        return BodyState(
            position=f(data.qpos[:3]),
            rotation=f(rotation),
            velocity=f(data.qvel[:3]),
            angular_velocity=f(rotation @ data.qvel[3:6]),  # MuJoCo has it in body axes
            joint=f(data.qpos[self.qpos].reshape(4, 3)),
            joint_rate=f(data.qvel[self.qvel].reshape(4, 3)),
        )

    def pusher_force(self):
        """[] N, of the pusher on the box along x, all contacts together."""
        if self.box is None:
            return 0.0
        total, wrench = 0.0, np.zeros(6)
        pusher, box = self.model.geom("pusher").id, self.model.geom("box").id
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            if {contact.geom1, contact.geom2} == {pusher, box}:
                mujoco.mj_contactForce(self.model, self.data, i, wrench)
                sign = 1.0 if contact.geom1 == pusher else -1.0
                total += sign * float(wrench[:3] @ contact.frame.reshape(3, 3)[:, 0])
        return total

    def box_pose(self):
        """x, y, yaw of the box."""
        if self.box is None:
            return np.zeros(3)
        x, y, _ = self.data.body("box").xpos
        rotation = self.data.body("box").xmat.reshape(3, 3)
        return np.array([x, y, np.arctan2(rotation[1, 0], rotation[0, 0])])

    def run(self, duration, ask):
        """Step for `duration` s; `ask(ground, body, time)` gives the Motion at each call. Stops at a fall."""
        for _ in range(round(duration / STEP)):
            time = self.data.time
            if time >= self.next_call - 1e-9:
                body = self.measure()
                solve = time >= self.next_solve - 1e-9
                motion = ask(self, body, time)
                self.state, self.command = control_once(
                    self.state, self.robot, self.settings, body, motion, np.float32(time), np.bool_(solve)
                )
                self.next_call += self.hold
                self.next_solve += self.solve_every * bool(solve)
            self._physics()
            if self.fallen():
                break
        return self.log()

    def _physics(self):
        data = self.data
        joint, rate = data.qpos[self.qpos].reshape(4, 3), data.qvel[self.qvel].reshape(4, 3)
        torque = np.asarray(torque_once(self.command, np.float32(joint), np.float32(rate), self.robot.torque_max))
        data.ctrl[self.motor] = torque.reshape(-1)
        mujoco.mj_step(self.model, data)
        self.rows.append(
            (
                data.time,
                data.qpos[:3].copy(),
                data.xmat[self.trunk].reshape(3, 3).copy(),
                data.qvel[:3].copy(),
                torque,
                self.pusher_force(),
                self.box_pose(),
                np.asarray(self.state.gait.swinging),
                np.asarray(self.state.force),
                data.geom_xpos[self.foot].copy(),
            )
        )

    def fallen(self):
        """Whether the base is below 60 % of its height or tilted by more than 0.5 rad."""
        low = self.data.qpos[2] < 0.6 * float(self.robot.stand_height)
        return low or self.data.xmat[self.trunk][8] < np.cos(0.5)

    def log(self):
        """All rows so far."""
        return Log(*(np.array(column) for column in zip(*self.rows, strict=True)))
