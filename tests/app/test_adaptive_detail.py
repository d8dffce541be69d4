"""How finely the surface is drawn while it moves: coarser while frames are slow, finer again at rest."""

from __future__ import annotations

import pytest
from avatarrex_studio.engine.adaptive_detail import DETAILS, FEW, FINEST, MANY, AdaptiveDetail, finer
from avatarrex_studio.engine.pictures import REST
from avatarrex_studio.panels.viewport import Shown, fit_picture
from avatarrex_studio.session.commands import OrbitBy
from ball_studio import FakeLive, ball_studio
from imgui_bundle import imgui

VIEWPORT = (80, 60)


def frames(adaptive, seconds, number, now=0.0):
    """So many frames with a moving picture in each; when the last one has ended."""
    for _ in range(number):
        adaptive.begin(now)
        adaptive.drawn(now)
        now += seconds
    adaptive.begin(now)
    return now


def test_slow_frames_make_pictures_coarser_step_by_step():
    adaptive = AdaptiveDetail()
    frames(adaptive, 0.045, FEW - 1)
    assert adaptive.detail == FINEST, "too few to tell"
    frames(adaptive, 0.045, 1)
    assert adaptive.detail == DETAILS[1]
    frames(adaptive, 0.045, 10 * FEW)
    assert adaptive.detail == DETAILS[-1]


def test_one_slow_frame_among_quick_ones_and_what_is_quick_enough_change_nothing():
    adaptive = AdaptiveDetail()
    for _ in range(10):
        frames(adaptive, 0.016, FEW - 1)
        frames(adaptive, 0.3, 1)
    frames(adaptive, 0.03, 200)
    assert adaptive.detail == FINEST


def test_frames_without_a_picture_do_not_count():
    """A motion of ten frames a second on a quick machine: long between pictures, and no frame is slow."""
    adaptive, now = AdaptiveDetail(), 0.0
    for k in range(300):
        adaptive.begin(now)
        if k % 6 == 0:
            adaptive.drawn(now)
        now += 1 / 60
    assert adaptive.detail == FINEST


def test_many_quick_frames_make_it_finer_and_each_fall_makes_that_rarer():
    adaptive = AdaptiveDetail()
    frames(adaptive, 0.045, FEW)
    frames(adaptive, 0.018, MANY - 1)
    assert adaptive.detail == DETAILS[1]
    frames(adaptive, 0.018, 1)
    assert adaptive.detail == FINEST
    frames(adaptive, 0.045, FEW)
    frames(adaptive, 0.018, 2 * MANY - 1)
    assert adaptive.detail == DETAILS[1]
    frames(adaptive, 0.018, 1)
    assert adaptive.detail == FINEST


@pytest.mark.parametrize("coarse", [0.019, 0.025])
def test_what_is_too_slow_when_it_is_finer_does_not_flicker(coarse):
    """A minute in which the finest takes 45 ms and all others less: ever fewer changes."""
    adaptive, now, seen = AdaptiveDetail(), 0.0, [FINEST]
    while now < 60:
        now = frames(adaptive, 0.045 if adaptive.detail == FINEST else coarse, 1, now)
        if adaptive.detail != seen[-1]:
            seen.append(adaptive.detail)
    assert len(seen) <= (20 if coarse < 0.02 else 2)


@pytest.mark.parametrize("limit", [10.0, 24.0, 30.0, 50.0])
def test_to_wait_for_a_limit_of_the_rate_is_not_slow(limit):
    """Nor is a screen of 30 Hz; what was coarse before gets finer with it, too."""
    adaptive = AdaptiveDetail()
    adaptive.limit = limit
    frames(adaptive, 1.002 / limit, 200)
    assert adaptive.detail == FINEST
    screen = AdaptiveDetail()
    frames(screen, 1 / 30 + 1e-4, 200)
    assert screen.detail == FINEST
    frames(adaptive, 2.0 / min(limit, 30), FEW)
    assert adaptive.detail == DETAILS[1], "twice as long is slow"
    frames(adaptive, 1.002 / limit, 200)
    assert adaptive.detail == FINEST


@pytest.mark.parametrize("room", [(1558, 242), (2598, 306), (605, 542), (1280, 800)])
@pytest.mark.parametrize("detail", DETAILS)
def test_the_picture_fills_its_room_however_finely_it_is_drawn(room, detail):
    """Its sides are whole pixels: that makes no border that comes and goes."""
    origin, size = imgui.ImVec2(7, 9), imgui.ImVec2(*room)
    low, high = fit_picture(origin, size, Shown(1, *detail.size(room)))
    assert (low.x, low.y, high.x, high.y) == (7, 9, 7 + room[0], 9 + room[1])


def test_a_picture_of_another_shape_keeps_it():
    low, high = fit_picture(imgui.ImVec2(0, 0), imgui.ImVec2(400, 300), Shown(1, 300, 300))
    assert (low.x, low.y, high.x, high.y) == (50, 0, 350, 300)


def test_the_raster_is_a_share_of_the_full_one():
    assert DETAILS[-1].size((605, 542)) == (454, 406)
    assert FINEST.size((605, 542)) == (605, 542)
    assert finer(DETAILS[-1]) == DETAILS[-2]
    assert finer(FINEST) == FINEST


class Sampled(FakeLive):
    """Keeps how each picture was drawn, too."""

    def draw(self, avatar, state, size, samples=4):
        self.details = [*getattr(self, "details", []), (size, samples)]
        return super().draw(avatar, state, size, samples)


def turned(studio, clock, seconds, number):
    """So many pictures of a view that turns."""
    for _ in range(number):
        studio.do(OrbitBy(1.0, 0.0))
        studio.tick(VIEWPORT)
        clock.now += seconds


def test_a_drag_on_a_slow_machine_is_drawn_coarsely_and_finely_again_when_it_rests(clock):
    live = Sampled()
    studio = ball_studio(clock, live=live)
    studio.tick(VIEWPORT)
    clock.now += 1
    turned(studio, clock, 0.05, 4 * FEW)
    assert live.details[0] == (VIEWPORT, 4), "the first picture"
    assert live.details[-1] == ((60, 45), 1)
    assert studio.moving
    drawn = len(live.details)
    clock.now += REST / 4
    studio.tick(VIEWPORT)
    clock.now += REST / 8
    studio.tick(VIEWPORT)
    assert len(live.details) == drawn, "it has only just stopped"
    clock.now += REST
    while studio.tick(VIEWPORT) and len(live.details) < drawn + 9:
        assert studio.moving or live.details[-1] == (VIEWPORT, 4), "the loop does not sleep before it is fine"
    assert live.details[drawn:] == [(VIEWPORT, 1), (VIEWPORT, 2), (VIEWPORT, 4)]
    turned(studio, clock, 0.05, 1)
    assert live.details[-1] == ((60, 45), 1), "the next drag begins where this one was"


def test_a_quick_machine_draws_all_finely(clock):
    live = Sampled()
    studio = ball_studio(clock, live=live)
    studio.tick(VIEWPORT)
    clock.now += 1
    turned(studio, clock, 1 / 60, 50)
    clock.now += 1
    studio.tick(VIEWPORT)
    assert set(live.details) == {(VIEWPORT, 4)}
    assert len(live.details) == 51
