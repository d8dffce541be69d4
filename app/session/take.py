"""Recording: while it is on, what a user edits becomes keys at the playhead instead."""

from __future__ import annotations

from collections.abc import Collection

from avatarrex_studio.session.commands import AmongFigures, Choice, Command
from avatarrex_studio.session.keys import CAMERA, LINEAR, SMOOTH
from avatarrex_studio.session.posing import SLOTS, differing, numbers
from avatarrex_studio.session.state import OrbitView, StudioState
from avatarrex_studio.session.timeline import Layer, Timeline
from avatarrex_studio.session.timeline_commands import AddLayer, OnTimeline, SetKeys

from avatarrex.signals.driving import Signals

NAME = "Keys"
"""Of the layer that recording makes where there is none."""
KeyList = tuple[tuple[str, float, tuple[float, ...], str], ...]


class Take:
    """Turns edits into keys of one layer."""

    def __init__(self) -> None:
        self.recording = False
        self.layer = ""
        """Name of the layer that gets the keys; of another kind or gone: the highest of keys."""
        self._gesture: object = None
        self._last = 0.0

    def target(self, timeline: Timeline) -> Layer | None:
        """The layer that gets keys."""
        layers = [layer for layer in timeline.layers if layer.keyed]
        return next((layer for layer in layers if layer.name == self.layer), layers[-1] if layers else None)

    def keyed(self, command: Command, state: StudioState, gesture: object = None) -> Command:
        """The keys that `command` becomes; itself where nothing is recorded, or it changes nothing that can have keys.

        Within one gesture keys of before go that lie between its own. Raises `InputError` as the command does.
        """
        if not self.recording or isinstance(command, OnTimeline | Choice | AmongFigures):
            return command
        layer = self.target(state.timeline)
        after = command.apply(state)
        names = [name for name in differing(state.signals, after.signals) if name != "shape"]
        if layer and any(track.name in CAMERA for track in layer.tracks):
            names += changed_settings(state.view, after.view)
        if not names:
            return command
        seconds = state.timeline.key_seconds
        since = self._last if gesture is not None and gesture == self._gesture and self._last < seconds else None
        self._gesture, self._last = gesture, seconds
        return with_keys(state, values(after, tuple(names)), layer, LINEAR if since is not None else SMOOTH, since)


Values = dict[str, tuple[float, ...]]


def values(state: StudioState, names: tuple[str, ...]) -> Values:
    """What a state shows of some joints, coefficients and settings of the camera."""
    signals = numbers(state.signals)
    return {
        name: setting(state.view, name) if name in CAMERA else tuple(signals[SLOTS[name]].tolist()) for name in names
    }


def setting(view: OrbitView, name: str) -> tuple[float, ...]:
    """A setting of the view as the numbers of a key."""
    value = getattr(view, name.removeprefix("camera."))
    return tuple(map(float, value)) if isinstance(value, tuple) else (float(value),)


def changed_settings(before: OrbitView, after: OrbitView) -> list[str]:
    """Settings that can have keys and differ."""
    return [name for name in CAMERA if setting(before, name) != setting(after, name)]


def with_keys(
    state: StudioState, found: Values, layer: Layer | None, curve: str = SMOOTH, since: float | None = None
) -> AddLayer | SetKeys:
    """The command that sets keys at the playhead, in a new layer where there is none."""
    seconds = state.timeline.key_seconds
    name, time = (layer.name, layer.local(seconds)) if layer else (NAME, seconds)
    keys: KeyList = tuple((track, time, value, curve) for track, value in found.items())
    if layer is None:
        empty = Timeline((Layer(NAME),))
        return AddLayer(SetKeys(NAME, keys).edited(empty).layers[0])
    return SetKeys(name, keys, None if since is None else layer.local(since))


def to_key(
    state: StudioState, layer: Layer | None, driven: tuple[Signals, ...], unread: Collection[str] = ()
) -> tuple[str, ...]:
    """What *Set key* keys where nothing is selected: what differs from all of `driven`, what the layers give over poses that nobody
    chose, and what has keys already. What is shown of motions that cannot be read, the names `unread`, is nobody's edit.
    """
    tracks = {track.name for track in layer.tracks} if layer else set()
    changed = set.intersection(*(set(differing(signals, state.signals)) for signals in driven)).difference(unread)
    return tuple(name for name in SLOTS if name != "shape" and (name in changed or name in tracks))
