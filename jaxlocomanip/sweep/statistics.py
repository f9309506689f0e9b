"""Exact confidence intervals of success rates."""

from __future__ import annotations

from typing import NamedTuple

CONFIDENCE = 0.95
"""of the intervals"""


class Rate(NamedTuple):
    """A share of trials and its confidence interval, all from 0 to 1."""

    share: float
    low: float
    high: float


def clopper_pearson(successes: int, trials: int, confidence: float = CONFIDENCE) -> Rate:
    """The exact (Clopper-Pearson) interval of a binomial proportion.

    Its ends are the proportions at which so many successes or more, or so few or fewer, have half the remaining
    probability: quantiles of beta distributions. It never covers less than the confidence, also near 0 and 1, where the
    usual approximations fail.

    Args:
      successes: from 0 to `trials`.
      trials: > 0.
      confidence: in (0, 1).
    """
    from scipy.special import betaincinv

    tail = (1.0 - confidence) / 2.0
    low = float(betaincinv(successes, trials - successes + 1, tail)) if successes else 0.0
    high = float(betaincinv(successes + 1, trials - successes, 1.0 - tail)) if successes < trials else 1.0
    return Rate(successes / trials, low, high)


def percent(successes: int, trials: int) -> str:
    """A share in percent with its interval: "98.4 [96.0, 99.6]"; "-" without trials."""
    if trials == 0:
        return "-"
    rate = clopper_pearson(successes, trials)
    share, low, high = (100.0 * value for value in rate)
    # One digit more where the interval is so narrow that one would hide it.
    digits = 1 if high - low > 1.0 else 2
    return f"{share:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
