"""`auto` from figures alone: what it falls to in a drag, what it climbs to at rest, what it forgets."""

from __future__ import annotations

import pytest
from avatarrex_studio.engine.auto_level import MEMORY, ORDER, PICTURE_MS, AutoLevel, Change
from avatarrex_studio.engine.resolution import Activity
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.session.commands import SetExpression, SetLevel
from ball import ball_engine, render_ball

from avatarrex.levels import level

PIXELS = 100 * 100


def known(**costs):
    """Levels that have each been measured: a first picture that does not count, then `(view and pose, level)` ms."""
    auto = AutoLevel()
    for name, (of_change, of_level) in costs.items():
        auto.measured(name, Change.POSE, PIXELS, 1e6, 1e6)
        for change in (Change.POSE, Change.VIEW):
            auto.measured(name, change, PIXELS, of_change, 0)
        auto.measured(name, Change.LEVEL, PIXELS, of_level, 0)
    return auto


def climb(auto, current, motion=Activity.FULL):
    """Where the choices end, one picture after the other."""
    seen = [current]
    while (following := auto.choose(seen[-1], Change.VIEW, motion, PIXELS)) != seen[-1]:
        seen.append(following)
        assert len(seen) < 9
    return seen


def test_nothing_known_starts_at_fast_and_tries_a_level_at_a_time_at_rest():
    assert climb(AutoLevel(), "fast") == ["fast", "balanced", "fine", "quality"]
    assert climb(AutoLevel(), "fast", Activity.STILL) == ["fast"]
    assert climb(AutoLevel(), "fast", Activity.MOVING) == ["fast"]
    assert climb(AutoLevel(), "paper") == ["paper", "balanced", "fine", "quality"]


def test_rest_ends_at_the_most_exact_level_within_the_idle_budget():
    assert climb(known(fast=(50, 50), balanced=(200, 400), fine=(400, 900), quality=(900, 1900)), "fast") == [
        "fast",
        "quality",
    ]
    assert climb(known(fast=(50, 50), balanced=(200, 400), fine=(400, 900), quality=(900, 2100)), "fast") == [
        "fast",
        "fine",
    ]
    assert climb(known(fast=(50, 50), balanced=(200, 2100), fine=(400, 2100), quality=(900, 2100)), "fast") == ["fast"]


def test_a_still_takes_what_fits_its_smaller_budget():
    auto = known(fast=(50, 50), balanced=(200, 400), fine=(400, 900), quality=(900, 1900))
    assert auto.choose("fast", Change.VIEW, Activity.STILL, PIXELS) == "balanced"
    assert PICTURE_MS[Activity.MOVING] < PICTURE_MS[Activity.STILL] < PICTURE_MS[Activity.FULL]


@pytest.mark.parametrize(("costs", "expected"), [((40, 60, 80, 90), "quality"), ((40, 60, 80, 110), "fine"), ((40, 60, 105, 110), "balanced"),
                                                 ((40, 110, 110, 110), "fast"), ((110, 120, 125, 130), "fast")])  # fmt: skip
def test_a_drag_falls_to_the_first_level_within_its_budget(costs, expected):
    auto = known(**{name: (cost, 300) for name, cost in zip(ORDER, costs)})
    assert auto.choose("quality", Change.POSE, Activity.MOVING, PIXELS) == expected
    assert auto.choose("fast", Change.POSE, Activity.MOVING, PIXELS) == "fast", "a drag does not climb"


def test_a_cost_grows_with_the_raster_and_follows_the_newest_pictures():
    auto = known(fast=(1, 1))
    auto.measured("balanced", Change.VIEW, PIXELS, 0, 0)
    auto.measured("balanced", Change.VIEW, PIXELS, 20, 60)
    assert auto.cost("balanced", Change.VIEW, PIXELS) == pytest.approx(80)
    assert auto.cost("balanced", Change.VIEW, 2 * PIXELS) == pytest.approx(140)
    assert auto.choose("balanced", Change.VIEW, Activity.MOVING, PIXELS) == "balanced"
    assert auto.choose("balanced", Change.VIEW, Activity.MOVING, 2 * PIXELS) == "fast"
    for _ in range(20):
        auto.measured("balanced", Change.VIEW, PIXELS, 200, 60)
    assert auto.cost("balanced", Change.VIEW, PIXELS) == pytest.approx(260, rel=0.01)


def test_a_first_picture_does_not_count_and_old_figures_are_forgotten():
    auto = AutoLevel()
    auto.measured("quality", Change.LEVEL, PIXELS, 9000, 0)
    assert auto.cost("quality", Change.LEVEL, PIXELS) is None
    auto.measured("quality", Change.LEVEL, PIXELS, 9000, 0)
    auto.measured("fast", Change.POSE, PIXELS, 1, 0)
    assert auto.choose("fine", Change.VIEW, Activity.FULL, PIXELS) == "fine"
    for _ in range(MEMORY + 1):
        auto.measured("fast", Change.POSE, PIXELS, 1, 0)
    assert auto.choose("fine", Change.VIEW, Activity.FULL, PIXELS) == "quality"


MS = {"fast": 10.0, "balanced": 150.0, "fine": 300.0, "quality": 700.0}
"""Of the volume, whatever changed."""


@pytest.fixture
def levels(clock):
    """A studio whose levels cost `MS`, and the level of every picture."""
    drawn = []

    def render(avatar, signals, camera, settings, previous=None):
        frame = render_ball(avatar, signals, camera, settings, previous)
        name = next(name for name in MS if level(name).bricks == settings.bricks
                    and level(name).part_voxel == settings.part_voxel)  # fmt: skip
        drawn.append(name)
        ms = {"templates": 0.0, "volume": MS[name], "pointmap": 1.0, "shading": 1.0}
        object.__setattr__(frame, "ms", {**ms, "total": sum(ms.values())})
        return frame

    studio = Studio(ball_engine(render), clock=clock)
    return studio, drawn


def settle(studio, clock):
    for _ in range(100):
        clock.now += 0.05
        studio.tick((64, 48))
        if not studio.moving:
            return
    raise AssertionError("the picture never became final")


def test_the_studio_drags_fast_and_rests_at_quality(levels, clock):
    studio, drawn = levels
    studio.do(SetLevel("auto"))
    settle(studio, clock)
    assert drawn == ["fast", "balanced", "fine", "quality"]
    for _ in range(2):  # twice: a level's first picture does not count
        for k in range(4):
            studio.do(SetExpression("jawOpen", 0.1 + 0.1 * len(drawn) % 0.8 + 0.01 * k))
            clock.now += 0.01
            studio.tick((64, 48))
        assert drawn[-1] == "fast" == studio.work.level
        settle(studio, clock)
        assert studio.level == studio.work.level == "quality"
    drawn.clear()
    for _ in range(5):
        clock.now += 1
        assert not studio.tick((64, 48))
    assert drawn == []


def test_a_fixed_level_is_kept(levels, clock):
    studio, drawn = levels
    studio.do(SetLevel("fast"))
    settle(studio, clock)
    studio.do(SetExpression("jawOpen", 0.5))
    settle(studio, clock)
    assert set(drawn) == {"fast"}
    assert len(studio.history) == len(drawn)
    studio.do(SetLevel("quality"))
    settle(studio, clock)
    assert studio.work.level == "quality"
    studio.undo()
    settle(studio, clock)
    assert studio.work.level == "fast"
