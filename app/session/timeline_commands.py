"""What a user does on the timeline: a command each, with what the layers gave afterwards.

`signals` (and, where a layer leads the camera, `view`) are what the layers give after the command; `evaluation.settled` fills them
in before it is done. So a journal needs no motion file, and a replay shows the same. Seconds and frames as in `timeline.py`.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, replace
from typing import Any

from avatarrex_studio.session import keys as curves
from avatarrex_studio.session.commands import Command, Setting
from avatarrex_studio.session.keys import Key, Place
from avatarrex_studio.session.state import OrbitView, StudioState
from avatarrex_studio.session.time_warp import Warp
from avatarrex_studio.session.timeline import GROUPS, PARTS, Clip, Feeds, Layer, Share, Timeline, of_clip

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.import_options import ImportOptions


class OnTimeline(Command, kind=False):
    """A command that changes the timeline."""

    _: KW_ONLY
    signals: Signals | None = None
    view: OrbitView | None = None
    others: tuple[Signals | None, ...] = ()
    """What their layers give the other figures where the playhead has moved or something was sent; None: it stays. Empty: all do."""
    sent: tuple[Feeds, ...] = ()
    """What live sources sent the other figures since. Empty: nothing."""

    def edited(self, timeline: Timeline) -> Timeline:
        """The timeline after this command. Raises `InputError`."""
        raise NotImplementedError

    def apply(self, state: StudioState) -> StudioState:
        shown = self.shown(state)
        return shown.with_others(self.others, self.sent) if self.others else shown

    def shown(self, state: StudioState) -> StudioState:
        """The selected figure, and the view, after this command. Raises `InputError`."""
        timeline = self.edited(state.timeline).with_own_sources(figure.timeline for figure in state.others)
        return state.show(timeline, self.signals, self.view)

    def to_json(self) -> dict[str, Any]:
        content = super().to_json()
        return {key: value for key, value in content.items() if value or key not in ("others", "sent")}


class LoadMotion(OnTimeline):
    """A motion was read: it takes the place of the lowest clip, other layers stay; alone it gives the timeline its rate."""

    path: str
    name: str
    frames: int
    fps: float
    options: ImportOptions = ImportOptions()
    parts: tuple[str, ...] = tuple(PARTS)
    """What it drives."""

    def edited(self, timeline: Timeline) -> Timeline:
        clip = Clip(self.path, self.name, self.frames, self.fps, self.options)
        alone = of_clip(clip, self.parts)
        before = next((layer for layer in timeline.layers if layer.clip), None)
        others = tuple(layer for layer in timeline.layers if layer is not before)
        if not others:
            return timeline.change(layers=alone.layers, fps=alone.fps, frame=0, span=None)
        place = timeline.layers.index(before) if before else 0
        named = replace(alone.layers[0], name=timeline.change(layers=others).free_name(self.name))
        return timeline.change(layers=(*others[:place], named, *others[place:]), frame=0)


class SetFrame(OnTimeline, Setting):
    """The playhead goes to a frame; live layers get what their sources sent last."""

    frame: int
    feeds: Feeds = ()

    def edited(self, timeline: Timeline) -> Timeline:
        return timeline.with_feeds(self.feeds).change(frame=self.frame)


class CloseMotion(OnTimeline):
    """The timeline is empty; what it showed stays as if it had been posed."""

    def edited(self, timeline: Timeline) -> Timeline:
        return Timeline(fps=timeline.fps, loop=timeline.loop)

    def shown(self, state: StudioState) -> StudioState:
        return state.change(timeline=self.edited(state.timeline), posed=None)


class AddLayer(OnTimeline):
    """Over all others; a name that is taken gets a number."""

    layer: Layer

    def edited(self, timeline: Timeline) -> Timeline:
        layer = replace(self.layer, name=timeline.free_name(self.layer.name))
        if not timeline.layers and layer.clip:
            timeline = of_clip(layer.clip).change(loop=timeline.loop, shares=timeline.shares)
            return timeline.change(layers=(layer,))
        return timeline.change(layers=(*timeline.layers, layer))


class RemoveLayer(OnTimeline):
    name: str

    def edited(self, timeline: Timeline) -> Timeline:
        return timeline.with_layer(self.name, None)


class MoveLayer(OnTimeline):
    """`by` places up (over others), or down where it is less than 0."""

    name: str
    by: int

    def edited(self, timeline: Timeline) -> Timeline:
        layer = timeline.layer(self.name)
        others = [each for each in timeline.layers if each is not layer]
        others.insert(max(timeline.layers.index(layer) + self.by, 0), layer)
        return timeline.change(layers=tuple(others))


class RenameLayer(OnTimeline):
    name: str
    new: str

    def edited(self, timeline: Timeline) -> Timeline:
        return timeline.with_layer(self.name, replace(timeline.layer(self.name), name=self.new.strip()))


class SetLayer(OnTimeline, Setting):
    """Some settings of a layer; None keeps one."""

    name: str
    parts: tuple[str, ...] | None = None
    weight: float | None = None
    muted: bool | None = None
    offset: float | None = None
    rate: float | None = None
    loop: bool | None = None
    smoothing: float | None = None
    warp: Warp | None = None

    def edited(self, timeline: Timeline) -> Timeline:
        changes: dict[str, Any] = {
            name: getattr(self, name)
            for name in ("weight", "muted", "offset", "rate", "loop", "smoothing", "warp")
            if getattr(self, name) is not None
        }
        if self.parts is not None:
            changes["parts"] = frozenset(self.parts)
        return timeline.with_layer(self.name, replace(timeline.layer(self.name), **changes))


class SetShare(OnTimeline, Setting):
    """How much of all layers a group follows."""

    name: str
    share: Share

    def edited(self, timeline: Timeline) -> Timeline:
        if self.name not in GROUPS:
            raise InputError("timeline", "group", ", ".join(GROUPS), self.name)
        shares = {**dict(timeline.shares), self.name: self.share}
        return timeline.change(shares=tuple((group, share) for group, share in shares.items() if share != Share()))


class SetTimeline(OnTimeline, Setting):
    """Rate, range (an empty one is all of it) and repetition; None keeps one. Another rate leaves the playhead at its time."""

    fps: float | None = None
    span: tuple[int, ...] | None = None
    loop: bool | None = None

    def edited(self, timeline: Timeline) -> Timeline:
        if self.fps is not None:
            scale = self.fps / timeline.fps
            span = timeline.span and (round(timeline.span[0] * scale), max(round(timeline.span[1] * scale), 1))
            timeline = timeline.change(fps=self.fps, frame=round(timeline.frame * scale), span=span)
        if self.loop is not None:
            timeline = timeline.change(loop=self.loop)
        return timeline if self.span is None else timeline.change(span=self.span or None)


class SetKeys(OnTimeline):
    """Keys of some tracks of a layer: track, time, value, curve. `since`: of a recording, the time of the keys before."""

    name: str
    keys: tuple[tuple[str, float, tuple[float, ...], str], ...]
    since: float | None = None

    def edited(self, timeline: Timeline) -> Timeline:
        layer = _of_keys(timeline, self.name)
        new: dict[str, list[Key]] = {}
        for track, time, value, curve in self.keys:
            new.setdefault(track, []).append(Key(time, value, curve))
        tracks = layer.tracks
        for track, entries in new.items():
            tracks = curves.with_keys(tracks, track, tuple(entries), self.since)
        return timeline.with_layer(self.name, replace(layer, tracks=tracks))


class DeleteKeys(OnTimeline):
    """The keys at some places: track and time."""

    name: str
    places: tuple[Place, ...]

    def edited(self, timeline: Timeline) -> Timeline:
        layer = _of_keys(timeline, self.name)
        return timeline.with_layer(self.name, replace(layer, tracks=curves.without(layer.tracks, self.places)))


class MoveKeys(OnTimeline, Setting):
    """The keys at some places `by` seconds later."""

    name: str
    places: tuple[Place, ...]
    by: float

    def edited(self, timeline: Timeline) -> Timeline:
        layer = _of_keys(timeline, self.name)
        return timeline.with_layer(self.name, replace(layer, tracks=curves.moved(layer.tracks, self.places, self.by)))


class SetCurve(OnTimeline, Setting):
    """How the keys at some places lead to the next."""

    name: str
    places: tuple[Place, ...]
    curve: str

    def edited(self, timeline: Timeline) -> Timeline:
        layer = _of_keys(timeline, self.name)
        return timeline.with_layer(
            self.name, replace(layer, tracks=curves.curved(layer.tracks, self.places, self.curve))
        )


def _of_keys(timeline: Timeline, name: str) -> Layer:
    """A layer of keys. Raises `InputError` for another."""
    layer = timeline.layer(name)
    if not layer.keyed:
        raise InputError("layer", name, "a layer of keys", "a motion or a live source")
    return layer
