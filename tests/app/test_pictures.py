"""What is on screen of surface and exact pictures, on an engine and a clock that the test turns."""

from __future__ import annotations

from copy import copy

import pytest
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.pictures import AUTO_LEVELS, FADE, MOVING_SHARE, PATIENCE, REST
from avatarrex_studio.session.commands import OrbitBy, SetBackground, SetExpression, SetLevel
from avatarrex_studio.session.notice import NOTICE
from ball import render_ball
from ball_studio import FakeLive, InlineExact, ball_studio

VIEWPORT = (320, 240)
TICK = 0.02


@pytest.fixture
def live(clock):
    """A studio with a surface, and an engine that answers when it is let."""
    exact = InlineExact()
    exact.paused = True
    return ball_studio(clock, live=FakeLive(), exact=exact)


@pytest.fixture
def bare(clock):
    """A studio without a surface."""
    exact = InlineExact()
    exact.paused = True
    return ball_studio(clock, exact=exact)


def tick(studio, clock, seconds=TICK):
    """Let the clock run; whether there was something new to show at the end."""
    new = False
    for _ in range(max(1, round(seconds / TICK))):
        clock.now += TICK
        new = studio.tick(VIEWPORT)
    return new


def answer(studio, clock):
    """The engine finishes what it has."""
    exact = studio.pictures.exact
    exact.paused = False
    clock.now += TICK
    new = studio.tick(VIEWPORT)
    exact.paused = True
    return new


def levels(studio):
    return [request.state.level for request in studio.pictures.exact.begun]


def test_while_something_moves_the_surface_is_drawn_and_nothing_requested(live, clock):
    for k in range(50):
        live.do(OrbitBy(1.0, 0.0))
        assert tick(live, clock)
        assert len(live.live.drawn) == k + 1
        assert (live.weight, live.moving) == (0, True)
    assert live.pictures.exact.begun == []
    assert not tick(live, clock), "drawn once for every state"


def test_at_rest_one_exact_picture_is_requested_and_faded_in(live, clock):
    tick(live, clock)
    tick(live, clock, REST - TICK)
    assert live.pictures.exact.begun == []
    tick(live, clock, 2 * TICK)
    (request,) = live.pictures.exact.begun
    assert (request.size, request.dragged, request.state.level) == (VIEWPORT, False, "balanced")
    assert not tick(live, clock, 1.0)
    assert not live.moving
    assert live.pictures.exact.busy
    assert answer(live, clock)
    assert live.weight == 0
    weights = []
    while live.fading or not weights:
        assert tick(live, clock)
        weights.append(live.weight)
    assert weights == sorted(weights)
    assert len(weights) == pytest.approx(FADE / TICK, abs=1)
    assert weights[-1] == 1
    assert not tick(live, clock, 5.0)
    assert not live.pictures.exact.busy
    assert len(live.pictures.exact.begun) == len(live.live.drawn) == 1, "at rest nothing is done again"


def test_an_avatar_that_is_read_anew_is_rendered_anew(clock, caplog):
    """At rest, and where the old one's picture is under way; one toast for each."""
    caplog.set_level(NOTICE)
    exact = InlineExact()
    exact.paused = True
    studio = ball_studio(clock, live=FakeLive(), exact=exact)
    one = studio.avatars.get("default")
    studio.avatars = Avatars(lambda name: copy(one))
    studio.avatars.get("default")
    tick(studio, clock, 2 * REST)
    assert answer(studio, clock)
    for under_way in (False, True):
        begun = len(exact.begun)
        if under_way:
            studio.do(OrbitBy(5.0, 0.0))
            tick(studio, clock, 2 * REST)
            begun += 1
            assert len(exact.begun) == begun
        studio.avatars = Avatars(lambda name: copy(one))
        studio.avatars.get("default")
        tick(studio, clock)
        assert not studio.pictures.current
        tick(studio, clock, 2 * REST)
        assert len(exact.begun) == begun + 1
        assert answer(studio, clock)
        assert studio.pictures.current
        assert studio.pictures.exact.begun[-1].state == studio.state.change(level="balanced")
    told = [record.getMessage() for record in caplog.records if record.levelno == NOTICE]
    words = "default has changed on the disk: shown as it is now, by exact pictures alone, for it has no surface"
    assert told == [words] * 2


def test_a_change_cancels_what_is_under_way_and_takes_the_picture_from_the_screen(live, clock):
    tick(live, clock, 2 * REST)
    live.do(OrbitBy(5.0, 0.0))
    assert tick(live, clock)
    assert live.pictures.exact.cancelled
    tick(live, clock)
    assert not live.pictures.exact.busy
    assert live.pictures.picture is None
    tick(live, clock, 2 * REST)
    answer(live, clock)
    tick(live, clock, 2 * FADE)
    assert live.weight == 1
    live.do(OrbitBy(5.0, 0.0))
    assert tick(live, clock)
    assert live.weight == 0, "the picture of another state is not shown over this one"


def test_a_picture_that_a_change_has_overtaken_is_not_shown(live, clock):
    tick(live, clock, 2 * REST)
    live.do(OrbitBy(5.0, 0.0))
    live.pictures.exact.cancel = lambda: None  # it was too late
    answer(live, clock)
    assert live.pictures.picture is None
    assert live.weight == 0


def test_another_level_is_requested_at_once_and_a_background_is_no_change(live, clock):
    tick(live, clock, 2 * REST)
    answer(live, clock)
    tick(live, clock, 2 * FADE)
    live.do(SetBackground((1.0, 1.0, 1.0, 1.0)))
    tick(live, clock)
    assert levels(live) == ["balanced"]
    live.do(SetLevel("fine"))
    tick(live, clock)
    assert levels(live) == ["balanced", "fine"]
    assert live.weight == 1, "the picture stays until the better one is there"
    assert answer(live, clock)
    assert live.weight == 1, "and is not faded in again"


def test_auto_refines_once(live, clock):
    live.do(SetLevel("auto"))
    for _ in range(6):
        tick(live, clock, 2 * REST)
        answer(live, clock)
    assert levels(live) == list(AUTO_LEVELS)
    assert live.pictures.picture.work.level == AUTO_LEVELS[-1]
    live.do(SetLevel("balanced"))
    tick(live, clock)
    answer(live, clock)
    live.do(SetLevel("auto"))
    tick(live, clock)
    assert levels(live) == ["balanced", "quality", "balanced", "quality"], "it goes on from what is there"


def test_auto_gives_up_what_takes_too_long_and_does_not_try_it_again(live, clock):
    live.do(SetLevel("auto"))
    tick(live, clock, 2 * REST)
    answer(live, clock)
    tick(live, clock, PATIENCE)
    assert not live.pictures.exact.cancelled
    tick(live, clock, 4 * TICK)
    assert not live.pictures.exact.busy
    assert levels(live) == ["balanced", "quality"]
    live.do(OrbitBy(5.0, 0.0))
    for _ in range(4):
        tick(live, clock, 2 * REST)
        answer(live, clock)
    assert levels(live) == ["balanced", "quality", "balanced"]
    live.do(SetLevel("quality"))
    tick(live, clock)
    tick(live, clock, 2 * PATIENCE)
    assert live.pictures.exact.busy, "who chooses it gets it"


def test_a_failed_picture_is_not_tried_again_until_something_changes(clock, caplog):
    def render(avatar, signals, camera, settings, previous=None):
        if signals.expression.any():
            raise RuntimeError("no such face")
        return render_ball(avatar, signals, camera, settings, previous)

    studio = ball_studio(clock, render, FakeLive())
    studio.do(SetExpression("jawOpen", 0.5))
    tick(studio, clock, 4.0)
    assert "no such face" in studio.pictures.error
    assert len(studio.pictures.exact.begun) == 1
    studio.do(OrbitBy(5.0, 0.0))
    tick(studio, clock)
    assert studio.pictures.error is None, "the surface shows this state"
    tick(studio, clock, 4.0)
    assert len(studio.pictures.exact.begun) == 2
    studio.undo()
    studio.undo()
    tick(studio, clock, 4.0)
    assert studio.pictures.error is None
    assert studio.weight == 1


def test_a_surface_that_cannot_be_drawn_leaves_the_exact_pictures(clock, caplog):
    class Faulty(FakeLive):
        def draw(self, avatar, state, size, samples=4):
            super().draw(avatar, state, size, samples)
            raise RuntimeError("no such triangle")

    studio = ball_studio(clock, live=Faulty())
    tick(studio, clock, 1.0)
    assert studio.surface is None
    assert studio.weight == 1
    assert len(studio.live.drawn) == 1
    assert "no such triangle" in caplog.text


def test_without_a_surface_small_pictures_follow_the_motion_one_after_the_other(bare, clock):
    exact = bare.pictures.exact
    for k in range(9):
        bare.do(OrbitBy(1.0, 0.0))
        tick(bare, clock)
        if k % 3 == 2:
            assert answer(bare, clock)
            assert bare.weight == 1
    assert len(exact.begun) == 4, "one at a time"
    assert all((request.state.level, request.dragged) == ("balanced", True) for request in exact.begun)
    shares = [request.size[0] * request.size[1] / (VIEWPORT[0] * VIEWPORT[1]) for request in exact.begun]
    low, high = MOVING_SHARE
    assert all(0.95 * low < share < 1.05 * high for share in shares)
    assert exact.begun[-1].state.view.azimuth == bare.state.view.azimuth, "the newest state, no queue"
    answer(bare, clock)
    tick(bare, clock, 2 * REST)
    last = exact.begun[-1]
    assert (last.state.level, last.dragged, last.size) == ("balanced", False, VIEWPORT)
    answer(bare, clock)
    assert not tick(bare, clock, 3.0)
    assert exact.begun[-1] is last


def test_the_size_while_moving_follows_from_what_a_pixel_took(clock):
    def sized(milliseconds):
        def render(*arguments):
            frame = render_ball(*arguments)
            object.__setattr__(frame, "ms", {**frame.ms, "pointmap": milliseconds, "shading": 0.0})
            return frame

        studio = ball_studio(clock, render)
        for _ in range(4):
            studio.do(OrbitBy(1.0, 0.0))
            tick(studio, clock)
        return studio.pictures.exact.begun[-1].size[0] / VIEWPORT[0]

    low, high = MOVING_SHARE
    assert sized(1.0) == pytest.approx(high**0.5, abs=0.01)
    assert sized(1e4) == pytest.approx(low**0.5, abs=0.01)


def test_the_level_live_requests_nothing_at_rest_where_there_is_a_surface(live, bare, clock):
    for studio in (live, bare):
        studio.do(SetLevel("live"))
        tick(studio, clock, 1.0)
        answer(studio, clock)
        tick(studio, clock, 1.0)
    assert live.pictures.exact.begun == []
    assert levels(bare)[-1] == "fast"
    assert not bare.pictures.exact.begun[-1].dragged


def test_the_level_live_takes_the_exact_picture_away(live, clock):
    tick(live, clock, 2 * REST)
    answer(live, clock)
    tick(live, clock, 2 * FADE)
    assert live.weight == 1
    live.do(SetLevel("live"))
    assert tick(live, clock), "another picture is shown"
    assert live.weight == 0
    assert not live.moving
    live.undo()
    assert tick(live, clock)
    assert live.weight == 1, "it is there yet"


def test_files_are_written_beside_pictures_and_survive_a_change(live, clock, tmp_path, caplog):
    caplog.set_level("INFO")
    tick(live, clock, 2 * REST)
    live.save_image(tmp_path / "a.png", (32, 24))
    live.save_image("/proc/b.png", (32, 24))
    live.do(OrbitBy(5.0, 0.0))
    for _ in range(4):
        tick(live, clock)
    assert not (tmp_path / "a.png").exists()
    assert live.pictures.exact.busy
    for _ in range(4):
        answer(live, clock)
    assert (tmp_path / "a.png").stat().st_size > 100
    assert f"Picture written: {tmp_path / 'a.png'}" in caplog.text
    assert any(r.levelname == "ERROR" and r.getMessage().startswith("/proc/b.png:") for r in caplog.records)


def test_a_picture_that_waits_for_a_file_and_is_dropped_is_requested_again(live, clock, tmp_path):
    tick(live, clock)
    live.save_image(tmp_path / "a.png", VIEWPORT)
    tick(live, clock, 2 * REST)
    live.do(OrbitBy(5.0, 0.0))
    tick(live, clock)
    for _ in range(3):
        answer(live, clock)
    tick(live, clock, 2 * REST)
    answer(live, clock)
    assert live.pictures.current
