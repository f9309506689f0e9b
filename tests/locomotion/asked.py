"""What the flat-ground tests ask of a robot: functions of (ground, body, time) that give its Motion."""

import dataclasses

import numpy as np

from jaxlocomanip.locomotion.robot import Motion


def motion(velocity=(0.0, 0.0), heading=0.0, yaw_rate=0.0, force=(0.0, 0.0, 0.0), point=(0.0, 0.0, 0.0), walking=True):
    """A request in single precision; standing in place by default but for `walking`."""
    f = np.float32
    return Motion(f(velocity), f(heading), f(yaw_rate), f(force), f(point), np.bool_(walking))


def stand(ground, body, time):
    """Stay, on four feet."""
    return motion(walking=False)


def heading_of(body):
    """[] rad."""
    return float(np.arctan2(body.rotation[1, 0], body.rotation[0, 0]))


def walk(*legs):
    """Stretches (begin, forward, left, turn) in s, m/s, m/s, rad/s, along the commanded heading; None: stand."""

    def ask(ground, body, time):
        heading, now = 0.0, (0.0, None)
        for leg, after in zip(legs, [*(other[0] for other in legs[1:]), np.inf], strict=True):
            if time >= leg[0] - 1e-9:
                now = leg
                heading += 0.0 if leg[1] is None else leg[3] * (min(time, after) - leg[0])
        if now[1] is None:
            return motion(heading=heading, walking=False)
        _, forward, left, turn = now
        c, s = np.cos(heading), np.sin(heading)
        return motion((c * forward - s * left, s * forward + c * left), heading, turn)

    return ask


def push(force, speed=0.3, begin=0.5):
    """Push the box ahead, tracking its face, with an expected force [] N that is ramped up."""

    def ask(ground, body, time):
        x, y, yaw = ground.box_pose()
        front = body.position + body.rotation @ np.asarray(ground.robot.pusher)
        normal, side = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        walking = time >= begin
        across = np.clip(3.0 * side @ (np.array([x, y]) - front[:2]), -0.2, 0.2)
        share = np.clip((time - begin - 0.3) / 0.5, 0.0, 1.0)
        return motion(
            velocity=walking * (speed * normal + across * side),
            heading=yaw,
            yaw_rate=walking * 2.0 * (yaw - heading_of(body)),
            force=np.append(-share * force * normal, 0.0),
            point=front + np.append(float(ground.robot.pusher_radius) * normal, 0.0),
            walking=walking,
        )

    return ask


def press(force):
    """Walk up to a box that does not move, then trot in place against it with an expected force [] N."""
    advance, touched = push(0.0, speed=0.1), []

    def ask(ground, body, time):
        asked = advance(ground, body, time)
        if ground.pusher_force() > 2.0:
            touched.append(time)
        if not touched:
            return asked
        share = min(1.0, 2.0 * (time - touched[0]))
        aside = np.array([0.0, 1.0], np.float32) * asked.velocity
        return dataclasses.replace(asked, velocity=aside, force=np.float32([-share * force, 0.0, 0.0]))

    return ask
