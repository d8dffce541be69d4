"""The avatar moves until somebody does something: on the surface alone, never in the state."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from avatarrex_studio.session.commands import Mirror
from avatarrex_studio.session.greeting import EASE, LASTS, Greeting, swayed
from avatarrex_studio.session.state import StudioState
from ball_studio import FakeLive, ball_studio

from avatarrex.signals.driving import Signals
from avatarrex.signals.limits import LIMITS


def greeted(clock):
    studio = ball_studio(clock, live=FakeLive())
    studio.greet()
    studio.tick((64, 48))
    return studio


def shown(studio):
    """The signals that were drawn last."""
    return studio.live.drawn[-1][0].signals


def test_it_moves_the_picture_and_not_the_state(clock):
    studio = greeted(clock)
    before, seen = studio.state, []
    for _ in range(5):
        clock.now += 0.7
        studio.tick((64, 48))
        seen.append(shown(studio).body_pose)
    assert studio.state is before
    assert not studio.journal.steps
    assert not studio.journal.unsaved
    assert all(not np.array_equal(a, b) for a, b in pairwise(seen))
    assert studio.moving
    assert not studio.pictures.exact.begun, "no exact picture of a pose that is gone at once"


def test_it_ends_for_good_with_the_first_command(clock):
    studio = greeted(clock)
    clock.now += 2.0
    studio.do(Mirror())
    clock.now += EASE + 0.1
    studio.tick((64, 48))
    drawn = len(studio.live.drawn)
    assert shown(studio) == studio.state.signals
    clock.now += 20.0
    studio.tick((64, 48))
    studio.tick((64, 48))
    assert len(studio.live.drawn) == drawn, "nothing is drawn any more"
    assert studio.greeting is None
    assert studio.pictures.exact.begun, "and the exact picture comes"


def test_nobody_there(clock):
    """After a while it costs nothing."""
    studio = greeted(clock)
    clock.now += LASTS + EASE + 0.1
    studio.tick((64, 48))
    clock.now += 5.0
    studio.tick((64, 48))
    drawn = len(studio.live.drawn)
    clock.now += 5.0
    studio.tick((64, 48))
    assert len(studio.live.drawn) == drawn
    assert not studio.moving


def test_without_a_surface_nothing_moves(clock):
    studio = ball_studio(clock)
    studio.greet()
    clock.now += 2.0
    studio.tick((64, 48))
    clock.now += 2.0
    studio.tick((64, 48))
    assert not studio.moving


def test_it_grows_and_fades():
    greeting = Greeting(10.0)
    assert [round(greeting.strength(10 + x), 2) for x in (0.0, EASE / 2, EASE, 5.0)] == [0.0, 0.5, 1.0, 1.0]
    greeting.stop(20.0)
    greeting.stop(25.0)
    assert [round(greeting.strength(20 + x * EASE), 2) for x in (0.0, 0.5, 1.0)] == [1.0, 0.5, 0.0]
    assert not greeting.over(20.0)
    assert greeting.over(20 + EASE)
    state = StudioState()
    assert greeting.shown(state, 30.0) is state


def test_it_is_gentle():
    rest = Signals.rest()
    assert swayed(rest, 3.0, 0.0) == rest
    moved = [swayed(rest, 0.1 * k, 1.0) for k in range(300)]
    turns = np.degrees(np.abs([signals.body_pose for signals in moved]))
    assert 1.0 < turns.max() < 5.0
    steps = np.abs(np.diff([signals.body_pose for signals in moved], axis=0))
    assert np.degrees(steps.max()) < 0.5, "no jump"
    poses = np.array([signals.body_pose for signals in moved])
    assert (poses >= LIMITS[1:22, :, 0]).all()
    assert (poses <= LIMITS[1:22, :, 1]).all()
    assert max(signals.expression.max() for signals in moved) > 0.5, "it blinks"
