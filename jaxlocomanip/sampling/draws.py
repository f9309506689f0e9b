"""Random numbers that belong to a lane: a counter-based generator in plain Python.

Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", 2011) is a function of a key and a counter,
without state. The key is the seed, and the counter says which number is meant: lane, attempt, name and position. So a
lane is the same in any batch, chunk, order, machine and version of NumPy or JAX, and a parameter keeps its numbers when
another one is added to a study.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

INDEX_LIMIT = 2**31 - 1
"""largest lane number"""

_WORD = 0xFFFFFFFF
_ROUNDS = 10
_MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
_KEY_STEPS = (0x9E3779B9, 0xBB67AE85)


def philox(counter: tuple[int, int, int, int], key: tuple[int, int]) -> tuple[int, int, int, int]:
    """Philox4x32-10: four random 32-bit words."""
    a, b, c, d = counter
    k, m = key
    for _ in range(_ROUNDS):
        first, second = _MULTIPLIERS[0] * a, _MULTIPLIERS[1] * c
        a, b, c, d = (second >> 32) ^ b ^ k, second & _WORD, (first >> 32) ^ d ^ m, first & _WORD
        k, m = (k + _KEY_STEPS[0]) & _WORD, (m + _KEY_STEPS[1]) & _WORD
    return a, b, c, d


@dataclass(frozen=True)
class Draws:
    """The random numbers of one attempt at a lane."""

    seed: int
    index: int
    attempt: int = 0

    def uniform(self, name: str, item: int = 0) -> float:
        """A number in the open interval (0, 1), always the same for one name and item."""
        counter = (self.index, self.attempt, zlib.crc32(name.encode()), item)
        high, low, _, _ = philox(counter, (self.seed & _WORD, self.seed >> 32))
        return (((high << 32 | low) >> 11) + 0.5) * 2.0**-53
