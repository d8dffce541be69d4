"""The motions that the clips of a timeline name, read once, and smoothed where a layer says so."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.timeline import Clip, Layer, Timeline

from avatarrex.errors import InputError
from avatarrex.signals.filters import smoothed
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.sequence import SignalSequence

log = logging.getLogger(__name__)
KEPT = 16
"""Motions and smoothed ones that are kept; more of them are read again."""
Name = tuple[str, ImportOptions]


class Clips:
    """Reads the motions of clips."""

    def __init__(self, read: Callable[[str, ImportOptions], Motion] = Motion.read) -> None:
        self._read = read
        self._motions: dict[Name, Motion] = {}
        self._smoothed: dict[tuple[Name, float], tuple[Motion, SignalSequence]] = {}
        self._refused: set[Name] = set()
        """What could not be read: it is not tried again in every frame of the window."""

    def take(self, motion: Motion) -> None:
        """Have a motion that was read."""
        name = motion.path, motion.imported.options
        self._refused.discard(name)
        self._keep(self._motions, name, motion)

    def forget(self) -> None:
        """Read everything anew when it is needed, also what was refused."""
        self._motions.clear()
        self._smoothed.clear()
        self._refused.clear()

    def retry(self) -> None:
        """Try again what was refused."""
        self._refused.clear()

    def motion(self, clip: Clip) -> Motion | None:
        """The motion of a clip, read again after an undo or in a session that was opened.

        None where it cannot be read: that is logged once.
        """
        name = clip.path, clip.options
        if name in self._motions:
            return self._motions[name]
        if name in self._refused:
            return None
        try:
            motion = self._read(*name)
        except InputError as error:
            log.error("%s", error)
            self._refused.add(name)
            return None
        self._keep(self._motions, name, motion)
        return motion

    def sequence(self, layer: Layer) -> SignalSequence | None:
        """The frames of a clip's layer, smoothed as it says; None where they cannot be read."""
        motion = self.motion(layer.clip) if layer.clip else None
        if layer.clip is None or motion is None:
            return None
        if not layer.smoothing:
            return motion.sequence
        name = (layer.clip.path, layer.clip.options), layer.smoothing
        known = self._smoothed.get(name)
        if known is None or known[0] is not motion:
            self._keep(self._smoothed, name, known := (motion, smoothed(motion.sequence, layer.smoothing)))
        return known[1]

    def silent(self, timeline: Timeline) -> bool:
        """Whether nothing of a timeline that has layers can be read."""
        layers = timeline.layers
        return bool(layers) and all(layer.clip and self.motion(layer.clip) is None for layer in layers)

    def unread(self, timeline: Timeline) -> tuple[Layer, ...]:
        """Layers that are not mute and whose motions could not be read, as far as that was tried."""
        return tuple(layer for layer in timeline.layers if not layer.muted and self._refuses(layer))

    def missing(self, timeline: Timeline) -> frozenset[str]:
        """Names of the layers whose motions could not be read, as far as that was tried."""
        return frozenset(layer.name for layer in timeline.layers if self._refuses(layer))

    def _refuses(self, layer: Layer) -> bool:
        return layer.clip is not None and (layer.clip.path, layer.clip.options) in self._refused

    @staticmethod
    def _keep(kept: dict[Any, Any], name: object, value: object) -> None:
        kept.pop(name, None)
        kept[name] = value
        if len(kept) > KEPT:
            del kept[next(iter(kept))]
