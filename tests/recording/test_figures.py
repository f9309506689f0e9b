"""Figures: a picture of the promised size with something on it, written whole or not at all."""

import dataclasses
import sys

import jax
import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.recording.figures import draw_figure, verdict

pytest.importorskip("matplotlib")


def picture(path):
    """[height, width, 3 or 4] of a PNG, in 0..1."""
    from matplotlib.image import imread

    return imread(path)


@pytest.fixture(scope="module")
def drawn(made_up, tmp_path_factory):
    folder = tmp_path_factory.mktemp("figure")
    draw_figure(folder / "made_up.png", "made_up", *made_up)
    return folder / "made_up.png"


def test_size(drawn):
    assert picture(drawn).shape[:2] == (1500, 2400)


def test_both_halves_are_drawn(drawn):
    ink = np.min(picture(drawn)[..., :3], axis=2) < 0.9
    for half in (ink[:, :1200], ink[:, 1200:]):
        assert 0.01 < half.mean() < 0.5


def test_robots_have_their_colours(drawn):
    from jaxlocomanip.recording.palette import robot_color, unit

    plan = picture(drawn)[:, :1200, :3]
    for i in range(2):
        assert np.any(np.all(np.abs(plan - np.array(unit(robot_color(i)))) < 0.02, axis=2))


def test_alone_in_its_folder(drawn):
    assert [entry.name for entry in drawn.parent.iterdir()] == ["made_up.png"]


def test_equal_episodes_give_equal_files(drawn, made_up, tmp_path):
    draw_figure(tmp_path / "again.png", "made_up", *made_up)
    assert (tmp_path / "again.png").read_bytes() == drawn.read_bytes()


def test_leaves_the_caller_settings_alone(made_up, tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    draw_figure(tmp_path / "a.png", "a", *made_up)
    assert dict(matplotlib.rcParams) == before


def test_one_tick_without_obstacles(made_up, tmp_path):
    scenario, result = made_up
    hidden = dataclasses.replace(scenario.obstacles, mask=np.zeros(2, bool))
    log = jax.tree.map(lambda leaf: leaf[:1], result.log)
    draw_figure(
        tmp_path / "a.png",
        "a",
        dataclasses.replace(scenario, obstacles=hidden),
        dataclasses.replace(result, log=log),
    )
    assert picture(tmp_path / "a.png").shape[:2] == (1500, 2400)


def test_verdict(made_up):
    outcome = dataclasses.replace(
        made_up[1].outcome,
        reached=np.array(True),
        reach_time_s=np.array(12.34),
        min_object_clearance_m=np.array(0.5),
        min_robot_clearance_m=np.array(0.25),
        min_team_clearance_m=np.array(1e3),
    )
    assert verdict(outcome) == "goal reached at 12.3 s;  least clearance: object 0.50 m, robots 0.25 m"
    failed = dataclasses.replace(
        outcome, reached=np.array(False), final_position_error_m=np.array(1.5), collided=np.array(True)
    )
    assert verdict(failed).startswith("goal not reached (1.50 m away), collided;")


def test_unwritable_place(made_up, tmp_path):
    place = tmp_path / "file"
    place.write_text("mine")
    with pytest.raises(InputError, match=r"file/a\.png: cannot be written"):
        draw_figure(place / "a.png", "a", *made_up)
    assert place.read_text() == "mine"


def test_trajectory_is_needed(made_up, tmp_path):
    scenario, result = made_up
    with pytest.raises(InputError, match="record=True"):
        draw_figure(tmp_path / "a.png", "a", scenario, dataclasses.replace(result, log=None))


def test_missing_matplotlib_names_the_extra(made_up, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r'pip install "\.\[view\]"'):
        draw_figure(tmp_path / "a.png", "a", *made_up)


def test_walking_robots(walking, drawn, tmp_path):
    draw_figure(tmp_path / "a.png", "a", *walking)
    assert picture(tmp_path / "a.png").shape[:2] == (1500, 2400)
    assert (tmp_path / "a.png").read_bytes() != drawn.read_bytes()
