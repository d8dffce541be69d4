"""What the layers of a timeline give at a time: one pure function of the state, the time and the motions that clips name.

From the base (what sliders have set) upwards each layer leads the joints and coefficients of its parts from what is below towards its
own: x ← slerp(x, own, weight) for rotations, linear else. Then each group goes back towards the base as its share says. Clips and
curves wait in their first value before they begin and stay in their last.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from avatarrex_studio.session.clips import Clips
from avatarrex_studio.session.keys import CAMERA
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.posing import SLOTS, numbers, of_numbers
from avatarrex_studio.session.state import OrbitView, StudioState, vector
from avatarrex_studio.session.timeline import GROUPS, PARTS, Feeds, Layer, Timeline, of_clip
from avatarrex_studio.session.timeline_commands import OnTimeline, SetFrame
from jaxtyping import Bool, Float64

from avatarrex.signals.driving import Signals
from avatarrex.signals.sequence import interpolate

Edit = TypeVar("Edit", bound=OnTimeline)
ALL = np.ones(sum(slot.stop - slot.start for slot in SLOTS.values()), dtype=bool)
LIMITS = {"camera.elevation": (-90.0, 90.0), "camera.distance": (0.05, 1e4), "camera.fov": (1.0, 170.0)}
Listened = Callable[[Timeline], Feeds]
"""What the live sources of a timeline sent last."""


def silence(timeline: Timeline) -> Feeds:
    """Where nothing is listened for."""
    return ()


@dataclass(frozen=True, eq=False)
class Given:
    """What a layer says at a time. Letter: n the numbers of a signal."""

    signals: Signals
    driven: Bool[np.ndarray, " n"]
    """Which of its numbers it drives."""
    weight: float


def layers_at(timeline: Timeline, base: Signals, seconds: float, clips: Clips) -> Signals:
    """The signals that the layers of `timeline` give at a time, over `base`; those whose motion cannot be read give nothing."""
    below = base
    for layer in timeline.layers:
        given = _given(layer, below, seconds, clips)
        if given is not None:
            below = _mixed(below, given)
    for group, share in timeline.shares:
        below = _mixed(below, Given(base, _mask(GROUPS[group]), 1 - share.of_layers))
    return below


def view_at(timeline: Timeline, view: OrbitView, seconds: float) -> OrbitView | None:
    """The view at a time, where keys lead the camera; what has no keys is as in `view`. None where none has."""
    led = None
    for layer in timeline.layers:
        if not layer.keyed or layer.muted or not any(track.name in CAMERA for track in layer.tracks):
            continue
        led = view if led is None else led
        for track in layer.tracks:
            if track.name in CAMERA:
                led = replace(led, **_setting(led, track.name, track.at(layer.local(seconds)), layer.weight))
    return led


def state_at(state: StudioState, seconds: float, clips: Clips) -> StudioState:
    """The state at a time of its timeline, playhead, signals and view: what a video renders. Seconds from the first frame.

    Every figure shows what its layers give, also at the playhead's own time: what was edited there is in no frame.

    The playhead stands at the nearest frame; signals and view are those of the time itself. What cannot be read is left out.
    """
    timeline = state.timeline.at(seconds)
    own = timeline.local(seconds)
    signals = layers_at(timeline, state.base, own, clips)
    shown = state.show(timeline, signals, view_at(timeline, state.view, own))
    return shown.with_others(others_at(state, seconds, clips)) if state.others else shown


def others_at(
    state: StudioState, seconds: float, clips: Clips, sent: tuple[Feeds, ...] = (), moved: bool = True
) -> tuple[Signals | None, ...]:
    """What their layers give the other figures at a time of the state's timeline.

    None: they have none, or none can be read, or neither has the playhead `moved` nor was anything `sent` to their live
    layers: what was edited there stays.
    """
    found = []
    for figure, feeds in zip(state.others, sent or ((),) * len(state.others)):
        timeline = figure.timeline.with_feeds(feeds)
        still = not timeline.layers or not (moved or feeds) or clips.silent(timeline)
        found.append(None if still else layers_at(timeline, figure.base, timeline.repeated(seconds), clips))
    return tuple(found)


def settled(command: Edit, state: StudioState, clips: Clips, listened: Listened = silence) -> Edit:
    """The command with what the layers give after it, and what was sent to the other figures. Raises `InputError`.

    Where no layer of the selected figure can be read, nothing is given to it. At the same time of the timeline, unless it adds a
    clip or takes the last layer away, the command changes only what its layers give otherwise than before, and the others to which
    something was sent: what else was edited there, or was shown of a clip that cannot be read any more, stays.
    """
    before, timeline = state.timeline, command.edited(state.timeline)
    moved = timeline.seconds != before.seconds
    sent = tuple(_news(figure.timeline, listened) for figure in state.others)
    others = others_at(state, timeline.seconds, clips, sent, moved)
    told = any(sent)
    command = replace(command, others=others if told or any(others) else (), sent=sent if told else ())
    if clips.silent(timeline):
        return command
    own = timeline.local(timeline.seconds)
    signals, view = layers_at(timeline, state.base, own, clips), view_at(timeline, state.view, own)
    clips_before, clips_after = (
        Counter(layer.clip for layer in each.layers if layer.clip) for each in (before, timeline)
    )
    added = clips_after - clips_before
    if timeline.layers and not moved and not added:
        own = before.local(before.seconds)
        old = layers_at(before, state.base, own, clips)
        kept = np.where(numbers(signals) == numbers(old), numbers(state.signals), numbers(signals))
        signals = of_numbers(kept)
        view = None if view == view_at(before, state.view, own) else view
    return replace(command, signals=signals, view=view)


def go_to(state: StudioState, frame: int, clips: Clips) -> SetFrame | None:
    """The command that goes to a frame, beyond the ends to the nearest; None where there are layers and none can be read."""
    if clips.silent(state.timeline):
        return None
    return settled(SetFrame(state.nearest(frame)), state, clips)


def motion_over(base: Signals, motion: Motion, frame: int) -> Signals:
    """`base` with what a motion drives at a frame."""
    clips = Clips()
    clips.take(motion)
    return layers_at(of_clip(motion.clip, motion.parts), base, frame / motion.clip.fps, clips)


def _news(timeline: Timeline, listened: Listened) -> Feeds:
    """What the live sources of a timeline sent that it does not have."""
    feeds = listened(timeline)
    return feeds if timeline.with_feeds(feeds) != timeline else ()


def _given(layer: Layer, below: Signals, seconds: float, clips: Clips) -> Given | None:
    """What a layer says at a time; None where it says nothing."""
    if layer.muted or not layer.weight:
        return None
    names = [name for part in PARTS if part in layer.parts for name in PARTS[part]]
    if layer.feed:
        return Given(layer.feed.signals, _mask(names), layer.weight * layer.feed.presence)
    if layer.clip:
        sequence = clips.sequence(layer)
        if sequence is None:
            return None
        return Given(sequence.at(layer.local(seconds)), _mask(names), layer.weight)
    values, keyed, own = numbers(below), [], layer.local(seconds)
    for track in layer.tracks:
        if track.name in names:
            values[SLOTS[track.name]] = track.at(own)
            keyed.append(track.name)
    return Given(of_numbers(values), _mask(keyed), layer.weight) if keyed else None


def _mask(names: list[str] | tuple[str, ...]) -> Bool[np.ndarray, " n"]:
    """Which numbers belong to some joints and coefficients."""
    mask = ~ALL
    for name in names:
        mask[SLOTS[name]] = True
    return mask


def _mixed(below: Signals, given: Given) -> Signals:
    """`below` led towards a layer by its weight, in what it drives."""
    if not given.weight:
        return below
    own = given.signals if given.weight == 1 else interpolate(below, given.signals, given.weight)
    values: Float64[np.ndarray, " n"] = numbers(below)
    values[given.driven] = numbers(own)[given.driven]
    return of_numbers(values)


def _setting(view: OrbitView, name: str, value: Float64[np.ndarray, " c"], weight: float) -> dict[str, Any]:
    """A setting of the view, led towards `value` by `weight`."""
    field = name.removeprefix("camera.")
    mixed = (1 - weight) * np.atleast_1d(getattr(view, field)) + weight * value
    if name in LIMITS:
        mixed = np.clip(mixed, *LIMITS[name])
    return {field: vector(mixed) if field == "target" else float(mixed[0])}
