"""The trot's clock: what it announces is what happens, and how it starts and stops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.locomotion import gait
from jaxlocomanip.locomotion.gait import Gait
from jaxlocomanip.locomotion.settings import TROT

PACE = Gait(jnp.float32(0.5), jnp.float32(0.6), jnp.asarray(TROT, jnp.float32))
STEP = 0.005
update = jax.jit(gait.update)
schedule = jax.jit(gait.schedule, static_argnames="steps")


def run(walking, until, begin=0.0):
    """States at every step, `walking(time)` deciding."""
    state, states = gait.start(PACE), []
    for time in np.arange(begin, until, STEP):
        state = update(state, PACE, jnp.float32(time), jnp.bool_(walking(time)))
        states.append((time, state))
    return states


def swings(states):
    return np.array([state.swinging for _, state in states])


def test_standing_never_lifts():
    assert not swings(run(lambda t: False, 2.0)).any()


def test_trot_alternates_diagonals_with_its_duty():
    states = run(lambda t: True, 5.0, begin=0.3)  # any start time
    lifted = swings(states)
    assert not lifted[:9].any()  # four feet stay down for the first tenth of a period
    assert (lifted[:, 0] == lifted[:, 3]).all() and (lifted[:, 1] == lifted[:, 2]).all()
    assert not (lifted[:, 0] & lifted[:, 1]).any()
    assert lifted[-800:].mean(axis=0) == pytest.approx(np.full(4, 0.4), abs=0.02)


def test_progress_and_touchdown_time_agree_with_what_follows():
    states = run(lambda t: True, 3.0)
    lifted = swings(states)
    for (time, state), (_, later) in zip(states[100:200], states[101:201], strict=True):
        progress, wait = gait.swing_progress(state, PACE), gait.time_to_touchdown(state, PACE)
        for leg in np.flatnonzero(state.swinging):
            assert 0.0 <= progress[leg] <= 1.0
            landing = round((time + float(wait[leg])) / STEP)
            assert lifted[landing - 2, leg] and not lifted[landing + 1, leg]
            assert not later.swinging[leg] or gait.swing_progress(later, PACE)[leg] > progress[leg]


def test_schedule_announces_what_happens():
    states, dt, steps = run(lambda t: True, 4.0), 0.05, 10
    lifted = swings(states)
    for index in range(0, 400, 7):
        _, state = states[index]
        announced = np.asarray(schedule(state, PACE, jnp.bool_(True), dt, steps=steps).contact)
        assert (announced[0] == ~lifted[index]).all()
        for j in range(1, steps):
            middle = index + (j + 0.5) * dt / STEP
            around = lifted[int(middle) - 1 : int(middle) + 3]
            settled = (around == around[0]).all(axis=0)  # not at the very moment of a change
            assert (announced[j] == ~around[0])[settled].all()


@pytest.mark.parametrize("stop", [1.0, 1.07, 1.13, 1.21, 1.31, 1.44])
def test_stops_after_the_swings_under_way_and_announces_it(stop):
    states = run(lambda t: t < stop, 3.0)
    lifted = swings(states)
    first = round(stop / STEP)
    under_way = lifted[first - 1]
    assert not (lifted[first:] & ~under_way).any()  # nobody lifts
    assert not lifted[first + 41 :].any()  # a swing lasts 0.2 s
    _, state = states[first]
    table = schedule(state, PACE, jnp.bool_(False), 0.05, steps=10)
    assert np.asarray(table.contact)[5:].all()
    assert (np.asarray(table.cycle)[-1] == lifted[first]).all()  # one more foothold for those in the air only


def test_starts_again_with_a_fresh_clock():
    lifted = swings(run(lambda t: t < 1.0 or t >= 1.63, 4.0))
    again = round(1.63 / STEP)
    assert not lifted[again - 10 : again + 9].any()
    assert lifted[again + 11][[1, 2]].all() and not lifted[again + 11][[0, 3]].any()


def test_a_leg_that_missed_its_lift_off_stays_down_until_the_next():
    # Legs lift at 0.35, 0.125, 0.025, 0.225 s for 0.15 s: others in the air keep the clock going past a missed one.
    crawl = Gait(jnp.float32(0.5), jnp.float32(0.7), jnp.asarray([0.0, 0.45, 0.65, 0.25], jnp.float32))
    state, lifted = gait.start(crawl), []
    for time in np.arange(0.0, 1.0, STEP):
        state = update(state, crawl, jnp.float32(time), jnp.bool_(not 0.21 <= time < 0.24))
        lifted.append(np.asarray(state.swinging))
        if time == pytest.approx(0.25):
            announced = np.asarray(schedule(state, crawl, jnp.bool_(True), 0.05, steps=10).contact)
    assert not np.array(lifted)[round(0.2 / STEP) : round(0.72 / STEP), 3].any()
    assert np.array(lifted)[round(0.8 / STEP), 3]
    assert announced[:9, 3].all() and not announced[9, 3]  # down until 0.725 s
