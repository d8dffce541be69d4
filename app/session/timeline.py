"""The timeline of a session: layers that drive the avatar over time, the playhead and what is played; plain values, JSON in and out.

The playhead counts frames of `Timeline.fps`; keys and offsets are seconds, so that another rate moves nothing. Layers lie one over
the other, the first at the bottom: each leads what it drives (`parts`) from what is below it towards its own by its `weight`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from avatarrex_studio.session import time_warp
from avatarrex_studio.session.keys import Track

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.joints import BODY_GROUPS, EXPRESSION_NAMES, HAND_JOINTS

MOUTH = tuple(name for name in EXPRESSION_NAMES if name.startswith(("jaw", "mouth", "tongue", "cheekPuff")))
"""The coefficients that speech moves."""
LIDS = ("eyeBlinkLeft", "eyeBlinkRight")
"""Those of a blink, which a motion of the body has, too."""
PARTS: dict[str, tuple[str, ...]] = {
    "root": ("pelvis", "translation"),
    "torso": BODY_GROUPS["torso"],
    "left arm": BODY_GROUPS["left arm"],
    "right arm": BODY_GROUPS["right arm"],
    "legs": (*BODY_GROUPS["left leg"], *BODY_GROUPS["right leg"]),
    "head": BODY_GROUPS["head"],
    "left hand": tuple(f"left_{name}" for name in HAND_JOINTS),
    "right hand": tuple(f"right_{name}" for name in HAND_JOINTS),
    "lids": LIDS,
    "upper face": tuple(name for name in EXPRESSION_NAMES if name not in (*MOUTH, *LIDS)),
    "mouth": MOUTH,
    "jaw": ("jaw",),
    "eyes": ("left_eye", "right_eye"),
}
"""What a layer can drive, and the joints and coefficients of each."""
BODY = ("torso", "left arm", "right arm", "legs")
FORMER_PARTS = {"body": BODY, "expression": ("lids", "upper face")}
"""Parts by the names that sessions of earlier versions have."""
GROUPS: dict[str, tuple[str, ...]] = {
    "root": PARTS["root"],
    **BODY_GROUPS,
    "left hand": PARTS["left hand"],
    "right hand": PARTS["right hand"],
    "face": (*PARTS["lids"], *PARTS["upper face"], *PARTS["mouth"], *PARTS["jaw"], *PARTS["eyes"]),
}
"""What all layers together can be muted on, or have a weight on."""
EMPTY_SECONDS = 10.0
"""Length of a timeline without a motion."""
MOST_LAYERS = 64
RATES = (1e-6, 1000.0)
"""Frames a second."""
MOST_FRAMES = 1_000_000
Time = TypeVar("Time", float, np.ndarray)
Feeds = tuple[tuple[str, Signals, float], ...]
"""What live sources sent last: name of the layer, signals, presence."""
LONGEST_SMOOTHING = 1.0
"""Seconds."""


@dataclass(frozen=True)
class Clip:
    """A motion file as a layer shows it."""

    path: str
    name: str
    frames: int
    fps: float
    options: ImportOptions = field(default_factory=ImportOptions)
    """What was chosen instead of guessed when it was read."""

    def __post_init__(self) -> None:
        if not (isinstance(self.frames, int) and self.frames >= 1):
            raise InputError(self.path, "frames", "1 or more", self.frames)
        check(self.path, "fps", self.fps, RATES)

    @property
    def seconds(self) -> float:
        """From its first frame to when one more would be due."""
        return self.frames / self.fps

    def to_json(self) -> dict[str, Any]:
        """Plain values; options without a choice are left out."""
        options = self.options.to_json()
        return {
            **{key: value for key, value in vars(self).items() if key != "options"},
            **({"options": options} if options else {}),
        }

    @classmethod
    def from_json(cls, data: dict[str, Any], source: str = "clip") -> Clip:
        """From `to_json`'s entries. Raises `InputError`."""
        return cls(**{**data, "options": ImportOptions.from_json(data.get("options", {}), source)})


@dataclass(frozen=True)
class Feed:
    """What a live source sent last, and how much of it still counts: 1 while it sends, then less to 0."""

    source: str
    signals: Signals = field(default_factory=Signals.rest)
    presence: float = 0.0
    key: str = ""
    """What it is listened for as, where another figure has a live layer of the same name."""

    def __post_init__(self) -> None:
        check("live", "presence", self.presence, (0.0, 1.0))

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        content = {**vars(self), "signals": self.signals.to_json()}
        return content if self.key else {name: value for name, value in content.items() if name != "key"}

    @classmethod
    def from_json(cls, data: dict[str, Any], source: str = "live") -> Feed:
        """From `to_json`'s entries. Raises `InputError`."""
        return cls(**{**data, "signals": Signals.from_json(data.get("signals", {}), source)})


@dataclass(frozen=True)
class Layer:
    """One source of movement: a motion file (`clip`), keys (`tracks`) or a live source (`feed`)."""

    name: str
    clip: Clip | None = None
    tracks: tuple[Track, ...] = ()
    feed: Feed | None = None
    parts: frozenset[str] = frozenset(PARTS)
    weight: float = 1.0
    muted: bool = False
    offset: float = 0.0
    """Seconds of the timeline at which it begins."""
    rate: float = 1.0
    """How fast it goes: 2 is twice as fast."""
    loop: bool = False
    smoothing: float = 0.0
    """Of a clip: standard deviation of the average over neighbouring frames, seconds of the file."""
    warp: time_warp.Warp = ()
    """Of a clip: how it goes through its time."""

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name.strip()):
            raise InputError("layer", "name", "a name", repr(self.name))
        if before := self.parts & set(FORMER_PARTS):
            now = {part for name in before for part in FORMER_PARTS[name]}
            object.__setattr__(self, "parts", self.parts - before | now)
        if unknown := sorted(map(str, self.parts - set(PARTS))):
            raise InputError(f"layer {self.name}", "parts", ", ".join(PARTS), unknown[0])
        if len({track.name for track in self.tracks}) != len(self.tracks):
            raise InputError(f"layer {self.name}", "tracks", "one track of each name", "two of one name")
        ranges = {
            "weight": (0.0, 1.0), "offset": (-3600.0, 3600.0), "rate": (0.05, 20.0), "smoothing": (0.0, LONGEST_SMOOTHING),
        }  # fmt: skip
        for name, bounds in ranges.items():
            check(f"layer {self.name}", name, getattr(self, name), bounds)
        time_warp.check(f"layer {self.name}", self.warp)
        for name in ("muted", "loop"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"layer {self.name}", name, "true or false", getattr(self, name))

    @property
    def keyed(self) -> bool:
        """Whether it is a layer of keys."""
        return self.clip is None and self.feed is None

    @property
    def live(self) -> str:
        """What its live source is called among those of all figures; empty without one."""
        return (self.feed.key or self.name) if self.feed else ""

    @property
    def seconds(self) -> tuple[float, float]:
        """Where it begins and ends on the timeline, without repetitions; a clip's end is when one more frame would be due."""
        if self.clip:
            return self.offset, self.offset + self.clip.seconds / self.rate
        times = [time for track in self.tracks for time in (track.keys[0].time, track.keys[-1].time)]
        return (self.on_timeline(min(times)), self.on_timeline(max(times))) if times else (self.offset, self.offset)

    def local(self, seconds: Time) -> Time:
        """Its own time at a time of the timeline, or at an array of them; what loops begins again, and a clip follows its curve."""
        own = self._even(seconds)
        if not (self.clip and self.warp):
            return own
        made = self.clip.seconds * time_warp.warped(self.warp, own / self.clip.seconds)
        return made if isinstance(seconds, np.ndarray) else float(made)

    def _even(self, seconds: Time) -> Time:
        """The same without the curve."""
        own = (seconds - self.offset) * self.rate
        if not self.loop:
            return own
        start, end = self.seconds
        length = (end - start) * self.rate
        begin = 0.0 if self.clip else (start - self.offset) * self.rate
        # 1e-9: a time that falls on the end by rounding is the beginning
        return begin + (own - begin + 1e-9) % length if length > 1e-9 else own

    def on_timeline(self, own: float) -> float:
        """The time of the timeline at its own time, in the first round."""
        return self.offset + own / self.rate

    def track(self, name: str) -> Track | None:
        """Its track of a joint or coefficient."""
        return next((track for track in self.tracks if track.name == name), None)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            **vars(self),
            "clip": self.clip and self.clip.to_json(),
            "tracks": [track.to_json() for track in self.tracks],
            "feed": self.feed and self.feed.to_json(),
            "parts": sorted(self.parts),
            "warp": [list(point) for point in self.warp],
        }

    @classmethod
    def from_json(cls, data: Any, source: str = "layer") -> Layer:
        """From `to_json`'s dictionary. Raises `InputError`."""
        if not isinstance(data, dict):
            raise InputError(source, "layer", "an object", type(data).__name__)
        content = dict(data)
        if content.get("clip"):
            content["clip"] = Clip.from_json(content["clip"], source)
        if content.get("feed"):
            content["feed"] = Feed.from_json(content["feed"], source)
        content["tracks"] = tuple(Track.from_json(track, source) for track in content.get("tracks", ()))
        content["parts"] = frozenset(content.get("parts", PARTS))
        content["warp"] = tuple(tuple(point) for point in content.get("warp", ()))
        return cls(**content)


@dataclass(frozen=True)
class Share:
    """How much of all layers a group of joints and coefficients follows; what it does not is as the sliders have it."""

    weight: float = 1.0
    muted: bool = False

    def __post_init__(self) -> None:
        check("group", "weight", self.weight, (0.0, 1.0))
        if not isinstance(self.muted, bool):
            raise InputError("group", "muted", "true or false", self.muted)

    @property
    def of_layers(self) -> float:
        """0 to 1."""
        return 0.0 if self.muted else self.weight


@dataclass(frozen=True)
class Timeline:
    """Layers, the lowest first, and the playhead."""

    layers: tuple[Layer, ...] = ()
    fps: float = 30.0
    frame: int = 0
    span: tuple[int, int] | None = None
    """First and last frame that are played; None: all."""
    loop: bool = True
    shares: tuple[tuple[str, Share], ...] = ()
    """Of those of `GROUPS` that do not follow the layers in full."""

    def __post_init__(self) -> None:
        names = [layer.name for layer in self.layers]
        if len(set(names)) != len(names) or len(names) > MOST_LAYERS:
            raise InputError("timeline", "layers", f"at most {MOST_LAYERS}, each with a name of its own", names)
        check("timeline", "fps", self.fps, RATES)
        if not (isinstance(self.frame, int) and 0 <= self.frame < MOST_FRAMES):
            raise InputError("timeline", "frame", "0 or more", self.frame)
        if self.span is not None and not (
            len(self.span) == 2 and all(isinstance(end, int) for end in self.span) and 0 <= self.span[0] < self.span[1]
        ):
            raise InputError("timeline", "span", "a first and a later frame", self.span)
        if not isinstance(self.loop, bool):
            raise InputError("timeline", "loop", "true or false", self.loop)
        for group, _ in self.shares:
            if group not in GROUPS:
                raise InputError("timeline", "group", ", ".join(GROUPS), group)

    @property
    def frames(self) -> int:
        """How many there are: to the end of the last clip or key."""
        return self.frames_beside(())

    def frames_beside(self, others: Iterable[Timeline]) -> int:
        """How many of its own frames last until the longest ends, of it and of others that are played with it."""
        layers = [*self.layers, *(layer for other in others for layer in other.layers)]
        ends = [layer.seconds[1] * self.fps - (0 if layer.keyed else 1) for layer in layers if layer.feed is None]
        if not any(layer.clip for layer in layers):
            ends.append(EMPTY_SECONDS * self.fps)
        # 1e-6: a clip at its own rate has its own number of frames
        return min(max(math.ceil(max(ends) - 1e-6) + 1, 1), MOST_FRAMES)

    @property
    def played(self) -> tuple[int, int]:
        """First and last frame that are played where it plays alone."""
        return self.played_of(self.frames)

    def played_of(self, frames: int) -> tuple[int, int]:
        """First and last frame that are played of so many: its range, or all."""
        last = frames - 1
        if self.span is None:
            return 0, last
        return min(self.span[0], last), min(self.span[1], last)

    @property
    def seconds(self) -> float:
        """Where the playhead is."""
        return self.frame / self.fps

    def repeated(self, seconds: Time) -> Time:
        """Its own time while another timeline plays to `seconds`, or to an array of them: in what is played, again where that repeats."""
        first, last = (frame / self.fps for frame in self.played)
        kept = np.clip(seconds, first, last)
        if self.loop and last > first:
            kept = np.where(seconds > last, first + (seconds - first) % (last - first + 1 / self.fps), kept)
        return np.asarray(kept) if isinstance(seconds, np.ndarray) else float(kept)

    def local(self, seconds: Time) -> Time:
        """Its own time where its playhead is at `seconds`, or at an array of them: the same up to its end, beyond it `repeated`."""
        end = (self.frames - 0.5) / self.fps
        own = np.where(seconds < end, seconds, self.repeated(seconds))
        return np.asarray(own) if isinstance(seconds, np.ndarray) else float(own)

    def at(self, seconds: float) -> Timeline:
        """With the playhead at the frame nearest to a time; before the first at the first, beyond the last at the last."""
        return self.change(frame=min(max(round(seconds * self.fps), 0), MOST_FRAMES - 1))

    def along(self, other: Timeline) -> Timeline:
        """With the playhead where that of another timeline is; as it is where the other's frame is that already."""
        return self if other.at(self.seconds).frame == other.frame else self.at(other.seconds)

    @property
    def key_seconds(self) -> float:
        """Where a key is set: at the playhead; beyond the end of a motion that repeats at its `local` time, which lengthens nothing."""
        return self.local(self.seconds) if self.loop and self.motion else self.seconds

    @property
    def motion(self) -> Clip | None:
        """The lowest clip: of a timeline of one layer the loaded motion."""
        return next((layer.clip for layer in self.layers if layer.clip), None)

    def layer(self, name: str) -> Layer:
        """By its name. Raises `InputError`."""
        for layer in self.layers:
            if layer.name == name:
                return layer
        raise InputError(
            "layer", "", ", ".join(layer.name for layer in self.layers) or "a layer to be added first", name
        )

    def share(self, group: str) -> Share:
        """Of one of `GROUPS`."""
        return dict(self.shares).get(group, Share())

    def change(self, **changes: Any) -> Timeline:
        """A copy with some fields changed, validated."""
        return replace(self, **changes)

    def with_layer(self, name: str, layer: Layer | None) -> Timeline:
        """With a layer in place of the one of that name, or without it. Raises `InputError` where there is none."""
        self.layer(name)
        kept = (layer if each.name == name else each for each in self.layers)
        return self.change(layers=tuple(each for each in kept if each is not None))

    def free_name(self, wanted: str) -> str:
        """`wanted`, or with a number where a layer is called so."""
        return _free(wanted, {layer.name for layer in self.layers})

    @property
    def live(self) -> frozenset[str]:
        """What its live layers are listened for as."""
        return frozenset(layer.live for layer in self.layers if layer.feed)

    def with_feeds(self, feeds: Feeds) -> Timeline:
        """With what its live sources sent last. Raises `InputError`."""
        timeline = self
        for name, signals, presence in feeds:
            layer = timeline.layer(name)
            if layer.feed is None:
                raise InputError("layer", name, "a live layer", "another")
            feed = replace(layer.feed, signals=signals, presence=presence)
            timeline = timeline.with_layer(name, replace(layer, feed=feed))
        return timeline

    def with_own_sources(self, others: Iterable[Timeline]) -> Timeline:
        """With keys for those of its live layers that are listened for as another one is: of `others`, or of its own.

        Of two of its own the one that has a key keeps it.
        """
        taken, layers = frozenset[str]().union(*(other.live for other in others)), list(self.layers)
        for layer in sorted((each for each in layers if each.feed), key=lambda each: not (each.feed and each.feed.key)):
            live = layer.live
            if layer.feed and live in taken:
                live = _free(layer.name, taken | self.live)
                layers[layers.index(layer)] = replace(layer, feed=replace(layer.feed, key=live))
            taken |= {live}
        return self.change(layers=tuple(layers))

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            **vars(self),
            "layers": [layer.to_json() for layer in self.layers],
            "shares": {group: asdict(share) for group, share in self.shares},
        }

    @classmethod
    def from_json(cls, data: Any, source: str = "timeline") -> Timeline:
        """From `to_json`'s dictionary. Raises `InputError`."""
        if not isinstance(data, dict):
            raise InputError(source, "timeline", "an object", type(data).__name__)
        content = dict(data)
        content["layers"] = tuple(Layer.from_json(layer, source) for layer in content.get("layers", ()))
        content["shares"] = tuple((group, Share(**share)) for group, share in content.get("shares", {}).items())
        if content.get("span"):
            content["span"] = tuple(content["span"])
        return cls(**content)


def of_clip(clip: Clip, parts: Iterable[str] = PARTS, frame: int = 0) -> Timeline:
    """A timeline of one motion at its own rate."""
    return Timeline((Layer(clip.name, clip, parts=frozenset(parts)),), clip.fps, frame)


def check(source: str, name: str, value: object, bounds: tuple[float, float]) -> None:
    """Raise `InputError` unless `value` is a number within `bounds`."""
    low, high = bounds
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(source, name, f"a number from {low:g} to {high:g}", value)


def _free(wanted: str, taken: Collection[str]) -> str:
    """`wanted`, or with a number where it is taken."""
    number, found = 2, wanted
    while found in taken:
        found, number = f"{wanted} {number}", number + 1
    return found
