"""Settings as logarithms: which of them, and that they stay positive and within their ranges."""

import math
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.config_file import config_from_table, config_to_toml
from jaxlocomanip.knobs import REACH, SPAN, as_numbers, changes, knobs_of, turned
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.presets import preset
from jaxlocomanip.tuning import NAMES


def arrays(config):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), config)


def test_groups_and_single_settings_are_found():
    knobs = knobs_of(PlannerConfig(), ("weights.pose", "constraints.clf", "constraints.margin"))
    names = ("weights.pose[0]", "weights.pose[1]", "weights.pose[2]")
    assert knobs.names[:3] == names
    assert set(knobs.names[3:]) == {f"constraints.clf.{k}" for k in ("weight", "switch", "reach")} | {
        "constraints.margin"
    }


@pytest.mark.parametrize("name", ["paper", "robust"])
def test_no_turn_leaves_the_preset_as_it_is(name):
    config = preset(name)
    knobs = knobs_of(config, NAMES)
    same = turned(arrays(config), knobs, jnp.zeros(len(knobs.names)))
    for a, b in zip(jax.tree.leaves(config), jax.tree.leaves(same), strict=True):
        assert float(b) == pytest.approx(float(a), rel=1e-6)


def test_zeros_and_switches_are_not_tuned():
    paper = knobs_of(preset("paper"), NAMES)
    # The paper's planner does not adapt friction.
    assert "adaptation.gain[4]" not in paper.names and "adaptation.gain[3]" in paper.names
    every = knobs_of(PlannerConfig(), ("weights", "constraints", "reference", "adaptation", "estimation", "safety"))
    fields = {name.partition("[")[0].rpartition(".")[2] for name in every.names}
    assert not fields & {"clf_normalised", "second_start", "change_faces", "breakaway", "on_prediction", "enabled"}
    # From 0 to 1, but no switches.
    assert {"pose_gain", "twist_gain"} <= fields


def test_some_settings_leave_zero():
    """The paper's planner has no margin, and its robots no barrier between each other."""
    start, names = preset("paper"), ("constraints.margin", "constraints.team.weight")
    knobs = knobs_of(start, names)
    assert set(knobs.names) == set(names) and all(knobs.floors)

    def values(turn):
        new = turned(arrays(start), knobs, jnp.full(2, turn)).constraints
        return jnp.stack([new.team.weight, new.margin])

    assert values(0.0) == pytest.approx([0.0, 0.0]) and values(-1.0) == pytest.approx([0.0, 0.0])
    assert values(math.log(2.0)) == pytest.approx([0.1, 0.01])
    assert values(10.0) == pytest.approx([0.9, 0.09])
    # From below the bound there is a way back.
    for turn in (0.0, -1.0):
        assert jax.jacfwd(values)(turn) == pytest.approx(np.array(knobs.floors) * math.exp(turn))


def test_any_turn_gives_a_correct_configuration():
    config = PlannerConfig()
    knobs = knobs_of(config, ("weights", "constraints", "adaptation", "estimation", "safety", "reference.speed"))
    rng = np.random.default_rng(0)
    for _ in range(5):
        turn = jnp.asarray(rng.normal(scale=2.0 * SPAN, size=len(knobs.names)), jnp.float32)
        new = as_numbers(turned(arrays(config), knobs, turn))
        read = config_from_table(tomllib.loads(config_to_toml(new)))
        assert jax.tree.leaves(read) == pytest.approx(jax.tree.leaves(new))
        for before, after in changes(config, new, knobs).values():
            assert 0.0 < after and after <= before * 10.0 * (REACH + 1e-3)
        for barrier in (new.constraints.force, new.constraints.object_cbf, new.constraints.clf):
            assert barrier.reach > barrier.switch


def test_the_derivative_is_that_of_a_logarithm():
    config = arrays(PlannerConfig())
    knobs = knobs_of(PlannerConfig(), ("weights.force",))
    slope = jax.grad(lambda x: turned(config, knobs, x).weights.force)(jnp.zeros(1))
    assert slope == pytest.approx([float(config.weights.force)])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("weight", "did you mean 'weights'"),
        ("safety.enabled", "nothing there can be tuned"),
        ("horizon.steps", "no setting has this name"),
    ],
)
def test_bad_names_are_refused(name, text):
    with pytest.raises(InputError, match=text):
        knobs_of(PlannerConfig(), (name,))


def test_a_team_sets_off_again_no_sooner_than_it_arrives():
    config = PlannerConfig()
    knobs = knobs_of(config, ("reference.arrive", "reference.leave"))
    turn = [1.0 if name == "reference.arrive" else -1.0 for name in knobs.names]
    new = as_numbers(turned(arrays(config), knobs, jnp.asarray(turn)))
    assert new.reference.leave == new.reference.arrive > config.reference.leave
    config_from_table(tomllib.loads(config_to_toml(new)))
