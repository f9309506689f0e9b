"""A flood over poses (x, y, heading) on a grid, all headings of a cell at once as the bits of one word.

A pose goes on to neighbouring cells in directions that the team can push at its heading, and turns only as it moves.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.sampling.pushing import Pushing

Floats = NDArray[np.floating[Any]]
Bits = NDArray[np.uint64]

HEADINGS = 64
"""of a grid, a bit each"""
_ONE, _LAST = np.uint64(1), np.uint64(HEADINGS - 1)
_ON_THE_SPOT = 4
"""bins that a team which turns on the spot does in one round of the flood"""
_LONGEST = 8
"""steps of the longest jump along a ray; a round of the flood follows it by twice as many"""

SLACK = 0.1
"""rad by which an object that is still sliding may move beyond the directions of its pushes"""
LENGTHS = (1, 2, 5, 10, 13)
"""squared lengths of steps, in cells"""

Offset = tuple[int, int]


class Grid(NamedTuple):
    """Poses of the object's centre of mass."""

    cell: float
    """m"""
    parts: int
    """of a cell to which bodies are placed"""
    origin: Floats
    """[2] m, position of cell (0, 0)"""
    shape: tuple[int, int]
    first: float
    """rad, heading of bit 0"""
    bin: float
    """rad, from one heading to the next"""

    @property
    def headings(self) -> Floats:
        """[HEADINGS] rad."""
        return self.first + self.bin * np.arange(HEADINGS)

    @property
    def wraps(self) -> bool:
        """Whether the headings are all there are, so that the first follows the last."""
        return self.bin * HEADINGS > 2.0 * math.pi - 1e-6


class Step(NamedTuple):
    """One move of the centre of mass."""

    offset: Offset
    """cells along and across"""
    bits: np.uint64
    """headings at which the team can push that way"""


class Rules(NamedTuple):
    """How the flood spreads."""

    steps: tuple[Step, ...]
    bins: tuple[int, ...] | None
    """of heading, by which a move of each of `LENGTHS` lets the object turn; None: on the spot by any"""
    both: bool
    """whether a move that passes between two cells needs both, or either"""


def strict_rules(pushing: Pushing, grid: Grid, reach: int) -> Rules:
    """Steps in directions that the team can push exactly, and strongly enough, and turns no tighter than it can.

    `reach` cells, 1 or 2: steps to 8 or 16 neighbours. Where the directions at a heading may all lie between two of
    these, as of a robot alone, to 32, the nearest to the directions then being as good.
    """
    wide = pushing.half > math.pi / 8.0 - 1e-6
    offsets = _within(reach if wide else 3)
    beyond = _beyond(pushing, grid, np.array([math.atan2(j, i) for i, j in offsets]))
    inside = beyond <= (1e-6 if wide else np.maximum(beyond.min(axis=0), 0.0) + 1e-6)
    if wide:
        angles = np.array([math.atan2(j, i) for i, j in offsets])
        inside &= pushing.strong(angles[:, None] - grid.headings)
    return Rules(_steps(offsets, inside), _bins(grid, pushing.curvature, lambda bins: int(bins + 1e-6)), both=True)


def lenient_rules(pushing: Pushing, grid: Grid, reach: int) -> Rules:
    """Steps in so many directions that each push is close to one, give or take `SLACK`; turns rounded up.

    `reach` cells, 2 or 3: steps to 16 or 32 neighbours.
    """
    offsets = sorted(_within(reach), key=lambda o: math.atan2(o[1], o[0]))
    angles = np.array([math.atan2(j, i) for i, j in offsets])
    gaps = np.diff(angles, append=angles[0] + 2.0 * math.pi)
    # A direction stands for pushes up to halfway to the next one.
    room = 0.5 * np.maximum(gaps, np.roll(gaps, 1))[:, None]
    inside = _beyond(pushing, grid, angles) < SLACK + 0.5 * grid.bin + room
    return Rules(_steps(offsets, inside), _bins(grid, pushing.bound, math.ceil), both=False)


def _within(reach: int) -> list[Offset]:
    """Neighbours up to `reach` cells away, one in each direction."""
    ticks = range(-reach, reach + 1)
    return [(i, j) for i in ticks for j in ticks if math.gcd(i, j) == 1]


def backwards(rules: Rules) -> Rules:
    """The same moves backwards in time."""
    return rules._replace(steps=tuple(Step((-i, -j), bits) for (i, j), bits in rules.steps))


def _beyond(pushing: Pushing, grid: Grid, angles: Floats) -> Floats:
    """[n, HEADINGS] rad, by how much directions [n] are beyond those that the team can push; negative: within."""
    off = np.remainder(angles[:, None] - grid.headings - pushing.middle + math.pi, 2.0 * math.pi) - math.pi
    return np.abs(off) - pushing.half


def _steps(offsets: Sequence[Offset], inside: NDArray[np.bool_]) -> tuple[Step, ...]:
    words = np.packbits(inside, axis=1, bitorder="little").view("<u8")[:, 0]
    return tuple(Step(offset, bits) for offset, bits in zip(offsets, words, strict=True) if bits)


def _bins(grid: Grid, curvature: float, whole: Any) -> tuple[int, ...] | None:
    if math.isinf(curvature):
        return None
    turns = [math.sqrt(n) * grid.cell * curvature / grid.bin for n in LENGTHS]
    return tuple(min(whole(bins), HEADINGS // 2) for bins in turns)


def reaches(grid: Grid, free: Bits, begin: Bits, aim: Bits, rules: Rules, turned: bool = False) -> bool:
    """Whether the aim can be reached from the beginning: rays in all directions at once, until nothing changes.

    Args:
      grid: of the poses.
      free: [rows, columns] headings at which a cell may be entered.
      begin: poses to start from; `turned` if they may turn by the bins of a step before the first one.
      aim: poses to reach.
      rules: of motion.
      turned: see `begin`.
    """
    squares = [i * i + j * j for (i, j), _ in rules.steps]
    rays = [[_ray(free, s, rules.both) for s, m in zip(rules.steps, squares, strict=True) if m == n] for n in LENGTHS]
    while len(rays) > 1 and not rays[-1]:
        rays.pop()
    state = begin & free
    if turned and rules.bins:
        state = _spread(grid, state, free, rules.bins[len(rays) - 1])
    moved = [np.zeros_like(state) for _ in rays]
    before = np.zeros_like(state)
    while not (state & aim).any():
        if np.array_equal(state, before):
            return False
        before = state
        for new, group in zip(moved, rays, strict=True):
            for jumps in group:
                target, source, through = jumps[0]
                new[target] |= state[source] & through
                for target, source, through in jumps:
                    new[target] |= new[source] & through
        if rules.bins is None:
            state = _spread(grid, functools.reduce(np.bitwise_or, moved, state), free, _ON_THE_SPOT)
        else:
            state = state | _turned(grid, moved, free, rules.bins)
    return True


def _turned(grid: Grid, moved: Sequence[Bits], free: Bits, bins: tuple[int, ...]) -> Bits:
    """What the states reached by moves of several lengths reach by turning."""
    state = moved[-1]
    for length in range(len(moved) - 1, 0, -1):
        state = _spread(grid, state, free, bins[length] - bins[length - 1]) | moved[length - 1]
    return _spread(grid, state, free, bins[0])


def _spread(grid: Grid, state: Bits, free: Bits, bins: int) -> Bits:
    for _ in range(bins):
        new = state | (state << _ONE) | (state >> _ONE)
        if grid.wraps:
            new |= (state >> _LAST) | (state << _LAST)
        state = new & free
    return state


_Jump = tuple[tuple[slice, slice], tuple[slice, slice], Bits]


def _ray(free: Bits, step: Step, both: bool) -> list[_Jump]:
    """Jumps by 1, 2, 4, ... steps and what they may pass through."""
    i, j = step.offset
    through = free & step.bits
    # A longer move passes between pairs of cells.
    for n in range(1, max(abs(i), abs(j))):
        part = n / max(abs(i), abs(j))
        low, high = ((math.floor(part * i), math.floor(part * j)), (math.ceil(part * i), math.ceil(part * j)))
        sides = [_from(free, (i - a, j - b)) for a, b in (low, high)]
        through &= sides[0] & sides[1] if both else sides[0] | sides[1]
    jumps: list[_Jump] = []
    length = 1
    while length <= _LONGEST and length * max(abs(i), abs(j)) < max(free.shape):
        target, source = _slices((i * length, j * length), free.shape)
        if free[target].size == 0:
            break
        jumps.append((target, source, through[target].copy()))
        longer = np.zeros_like(through)
        longer[target] = through[target] & through[source]
        through, length = longer, 2 * length
    return jumps


def _from(bits: Bits, offset: Offset) -> Bits:
    """At each cell the bits of the cell that lies `offset` before it; none beyond the grid."""
    target, source = _slices(offset, bits.shape)
    moved = np.zeros_like(bits)
    moved[target] = bits[source]
    return moved


def _slices(offset: Offset, shape: Sequence[int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices (target, source) of a shift of a grid."""
    pairs = [_shift(by, n) for by, n in zip(offset, shape, strict=True)]
    return (pairs[0][0], pairs[1][0]), (pairs[0][1], pairs[1][1])


def _shift(by: int, count: int) -> tuple[slice, slice]:
    """Slices (target, source) of a shift along an axis of `count` cells."""
    if by == 0:
        return slice(None), slice(None)
    kept = max(count - abs(by), 0)
    far, near = slice(count - kept, count), slice(0, kept)
    return (far, near) if by > 0 else (near, far)
