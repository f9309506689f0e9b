"""Colours (red, green, blue in 0..255) that mean the same thing in every recording and every figure."""

from __future__ import annotations

RGB = tuple[int, int, int]

ROBOTS: tuple[RGB, ...] = (
    (31, 119, 180),
    (243, 129, 22),
    (128, 90, 190),
    (20, 170, 175),
    (190, 155, 20),
    (140, 86, 75),
)
"""One a robot, in the order of the team."""

OBJECT: RGB = (201, 160, 104)
OBSTACLE: RGB = (118, 126, 138)
MOVING_OBSTACLE: RGB = (206, 48, 62)
GOAL: RGB = (38, 158, 76)
TRAIL: RGB = (122, 84, 36)
PLAN: RGB = (214, 39, 150)
PATH: RGB = (84, 96, 112)
COMMAND: RGB = PLAN
"""what the planner asks for is drawn like what it plans"""
FOOT_FORCE: RGB = (250, 190, 20)
REFERENCE: RGB = (150, 110, 255)
TRUTH: RGB = (60, 66, 74)
GROUND: RGB = (226, 229, 233)
INK: RGB = (38, 42, 48)
DARK: RGB = (44, 48, 55)
"""parts of robots that do not bear their colour"""


def robot_color(index: int) -> RGB:
    """Colour of the team's robot number `index`."""
    return ROBOTS[index % len(ROBOTS)]


def unit(color: RGB) -> tuple[float, float, float]:
    """A colour in 0..1."""
    red, green, blue = color
    return red / 255.0, green / 255.0, blue / 255.0
