"""Episodes and gradients of places, in batches."""

import jax
import numpy as np
import pytest

from jaxlocomanip import trials
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.random_worst import random_places
from jaxlocomanip.sampling.study import parse_study
from jaxlocomanip.trials import Trials
from jaxlocomanip.variation import Bounds, vary


@pytest.fixture(scope="module")
def study(breaking):
    return parse_study(breaking)


def test_gradients_are_those_of_their_places(study, monkeypatch):
    """Three places in batches of two; `test_approach` holds gradients against differences."""
    box = Bounds()
    places = list(random_places(study, 1, 3, box))

    def slopes(coordinates, scenarios, config, seeds, bounds, memory, *, ticks, window):
        assert (ticks, window) == (50, 5) and float(memory) == pytest.approx(0.1)
        moved = jax.vmap(vary, (0, 0, None))(scenarios, coordinates, bounds)
        return np.array(coordinates) * np.array(moved.truth.mass)[:, None] + np.array(seeds, float)[:, None]

    monkeypatch.setattr(trials, "_slopes", slopes)
    rows = Trials(study, PlannerConfig(), box, 2, 5, 0.1).gradients(places)
    for row, place in zip(rows, places, strict=True):
        assert row == pytest.approx(place.coordinates * place.spec.truth.mass + place.seed, rel=1e-6)

    def broken(coordinates, *_, **__):
        values = np.array(coordinates)
        values[0, 0] = np.nan
        return values

    monkeypatch.setattr(trials, "_slopes", broken)
    rows = Trials(study, PlannerConfig(), box, 2, 5, 0.1).gradients(places)
    assert [bool(row.any()) for row in rows] == [False, True, False]
