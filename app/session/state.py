"""Everything a user can set, in one frozen value: no tensors, no OpenGL, JSON in and out.

Metres, degrees in the orbit view (radians in the signals), sRGB-encoded colours in [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, SupportsFloat

import numpy as np
from avatarrex_studio.session.cut import Cut
from avatarrex_studio.session.figures import FIELDS, MOST_FIGURES, Figure, Place, check_hidden
from avatarrex_studio.session.timeline import Clip, Feeds, Timeline, of_clip

from avatarrex import levels
from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.signals.driving import SHAPES, Signals
from avatarrex.signals.handles import HANDLES
from avatarrex.signals.joints import FACE_REGIONS, JOINT_NAMES
from avatarrex.stage.stage import Stage

FORMAT, ALONE = 6, 5
"""Version of the JSON form, and of that of a lone figure at its first place; a reader refuses a newer one by name."""
AUTO = "auto"
"""The level of whoever lets the studio choose: at rest `balanced`, then `quality`."""
LIVE = "live"
"""The level of the surface alone."""
LEVELS = (AUTO, *levels.LEVELS)
SIZES = (16, 8192)
"""Smallest and largest side of an image, pixels."""
BACKGROUND = (0.145, 0.157, 0.176, 1.0)
"""A dark neutral grey."""
IMAGE = "image"
INFLUENCE, SLICE = "influence", "slice"
PICTURES = (IMAGE, "normals", "depth", "parts", "steps", INFLUENCE, SLICE)
"""What the viewport can show of the avatar."""
OVERLAYS = ("joints", "wire")
"""What it can show over that."""
SELECTABLE = frozenset((*JOINT_NAMES, *FACE_REGIONS))
FAR_FOV = 0.1
"""Degrees: the lens of an orthographic view. Two points half a metre before each other are seen 0.04 % apart in size, a fifth of a pixel
in a picture of a thousand; rays a kilometre long are as exact as short ones (avatarrex/pointmap/rays.py)."""
FARTHEST = 5e5
"""Metres."""
Colour = tuple[float, float, float, float]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class OrbitView:
    """A camera on a sphere about `target`; azimuth 0 sees the front, 90 the person's left side."""

    azimuth: float = 0.0
    elevation: float = 0.0
    distance: float = 3.0
    fov: float = 40.0
    target: Vector = (0.0, -0.05, 0.0)
    follow: bool = True
    """Whether a motion's steps over the ground carry the target along."""
    orthographic: bool = False
    """Whether it is seen without perspective, at the scale that the target has: from very far through a very narrow lens."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("azimuth", -math.inf, math.inf),
            ("elevation", -90.0, 90.0),
            ("distance", 0.05, 1e4),
            ("fov", 1.0, 170.0),
        ):
            value = getattr(self, name)
            if not (_number(value) and low <= value <= high):
                limits = f" from {low:g} to {high:g}" if math.isfinite(low) else ""
                raise InputError("camera", name, f"a number{limits}", value)
        if len(self.target) != 3 or not all(map(_number, self.target)):
            raise InputError("camera", "target", "three finite numbers", self.target)
        if not isinstance(self.orthographic, bool):
            raise InputError("camera", "orthographic", "true or false", self.orthographic)

    def camera(self, width: int, height: int) -> Camera:
        """This view on a `width` × `height` raster."""
        return _camera(self, width, height)

    @property
    def lens(self) -> tuple[float, float]:
        """Metres from the target, and degrees, of the camera itself; without perspective it stands `FARTHEST` away at most."""
        if not self.orthographic:
            return self.distance, self.fov
        half = self.distance * math.tan(math.radians(self.fov) / 2)
        distance = min(half / math.tan(math.radians(FAR_FOV) / 2), FARTHEST)
        return distance, math.degrees(2 * math.atan(half / distance))

    def moved(self, step: np.ndarray) -> OrbitView:
        """The same view `step` (3,) further on."""
        return replace(self, target=vector(np.asarray(self.target) + step))


@lru_cache(16)  # a frame needs one or two, several times
def _camera(view: OrbitView, width: int, height: int) -> Camera:
    distance, fov = view.lens
    return Camera.orbit(view.azimuth, view.elevation, distance, fov, view.target, width, height)


@dataclass(frozen=True)
class SizePolicy:
    """How large the image is: a fixed raster, or the viewport's own pixels times `scale`."""

    scale: float = 1.0
    fixed: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if not (_number(self.scale) and 0.05 <= self.scale <= 4):
            raise InputError("size", "scale", "a number from 0.05 to 4", self.scale)
        if self.fixed is not None and len(self.fixed) != 2:
            raise InputError("size", "fixed", "a width and a height", self.fixed)
        for side in self.fixed or ():
            if not (isinstance(side, int) and SIZES[0] <= side <= SIZES[1]):
                raise InputError("size", "", f"sides of {SIZES[0]} to {SIZES[1]} pixels", side)

    def pixels(self, viewport: tuple[int, int]) -> tuple[int, int]:
        """Width and height for a viewport of that many pixels."""
        if self.fixed:
            return self.fixed
        low, high = SIZES
        width, height = (min(max(round(side * self.scale), low), high) for side in viewport)
        return width, height


@dataclass(frozen=True)
class Tools:
    """What is selected and what the viewport shows of it: no part of what undo brings back, as in other programs."""

    selected: str | None = None
    """A joint, or a region of the face."""
    pins: frozenset[str] = frozenset()
    """Handles that stay where they are while another is pulled, or a slider or ring turns what carries them."""
    overlays: frozenset[str] = frozenset()
    """Of `OVERLAYS`."""
    shows: str = IMAGE
    """One of `PICTURES`."""
    cut: Cut = field(default_factory=Cut)
    """The plane of `SLICE`."""

    def __post_init__(self) -> None:
        for name, allowed in (("pins", tuple(HANDLES)), ("overlays", OVERLAYS)):
            if unknown := sorted(map(str, getattr(self, name) - set(allowed))):
                raise InputError("tools", name, " or ".join(allowed), unknown[0])
        if self.selected is not None and self.selected not in SELECTABLE:
            raise InputError("tools", "selected", "a joint or a region of the face", self.selected)
        if self.shows not in PICTURES:
            raise InputError("tools", "shows", " or ".join(PICTURES), self.shows)

    def to_json(self) -> dict[str, Any]:
        """Plain lists and words."""
        cut = {} if self.cut == Cut() else {"cut": asdict(self.cut)}
        others = {name: value for name, value in vars(self).items() if name != "cut"}
        return {**others, "pins": sorted(self.pins), "overlays": sorted(self.overlays), **cut}

    @classmethod
    def read(
        cls, pins: Iterable[str] = (), overlays: Iterable[str] = (), cut: Mapping[str, Any] | None = None, **others: Any
    ) -> Tools:
        """From `to_json`'s entries. Raises `InputError`."""
        return cls(pins=frozenset(pins), overlays=frozenset(overlays), cut=Cut(**cut or {}), **others)


@dataclass(frozen=True)
class StudioState:
    """The whole of a session at one moment."""

    avatar: str = "default"
    signals: Signals = field(default_factory=Signals.rest)
    """What is shown."""
    view: OrbitView = field(default_factory=OrbitView)
    size: SizePolicy = field(default_factory=SizePolicy)
    background: Colour = BACKGROUND
    stage: Stage = field(default_factory=Stage)
    """What the figure stands on and before; off, it stands before the background alone."""
    timeline: Timeline = field(default_factory=Timeline)
    hidden: frozenset[str] = frozenset()
    limit_joints: bool = True
    """Whether a joint that is set stays within its limits."""
    level: str = "balanced"
    """One of `LEVELS`: run time against error."""
    tools: Tools = field(default_factory=Tools)
    posed: Signals | None = None
    """What sliders, handles and libraries have set, below all layers; None: it is what is shown."""
    place: Place = field(default_factory=Place)
    """Where the figure stands; its signals do not contain it."""
    others: tuple[Figure, ...] = ()
    """The figures beside the one that is selected."""
    slot: int = 0
    """The place of the selected one among all."""

    def __post_init__(self) -> None:
        if len(self.background) != 4 or not all(_number(c) and 0 <= c <= 1 for c in self.background):
            raise InputError("background", "", "red, green, blue, alpha from 0 to 1", self.background)
        check_hidden(self.hidden)
        if len(self.others) >= MOST_FIGURES:
            raise InputError("figures", "", f"at most {MOST_FIGURES}", len(self.others) + 1)
        if not (isinstance(self.slot, int) and 0 <= self.slot <= len(self.others)):
            raise InputError("figures", "slot", f"0 to {len(self.others)}", self.slot)
        if not isinstance(self.limit_joints, bool):
            raise InputError("limit_joints", "", "true or false", self.limit_joints)
        if self.level not in LEVELS:
            raise InputError("level", "", " or ".join(LEVELS), self.level)

    @property
    def figures(self) -> tuple[Figure, ...]:
        """All, in their order."""
        own = Figure(**{name: getattr(self, name) for name in FIELDS})
        return (*self.others[: self.slot], own, *self.others[self.slot :])

    def with_figures(self, figures: tuple[Figure, ...], slot: int) -> StudioState:
        """A copy with other figures, one of which is selected; nothing of it is. Raises `InputError`."""
        if not 0 <= slot < len(figures):
            raise InputError("figures", "", f"one of 0 to {len(figures) - 1}", slot)
        chosen, others = figures[slot], figures[:slot] + figures[slot + 1 :]
        tools = replace(self.tools, selected=None, pins=frozenset())
        return replace(self, **{name: getattr(chosen, name) for name in FIELDS}, others=others, slot=slot, tools=tools)

    def with_others(self, given: tuple[Signals | None, ...], sent: tuple[Feeds, ...] = ()) -> StudioState:
        """A copy where the others show what their layers give at the playhead, and have what was sent. Raises `InputError`."""
        count, seconds = len(self.others), self.timeline.seconds
        if len(given) != count:
            raise InputError("others", "", f"signals of {count} figures", len(given))
        if len(sent) not in (0, count):
            raise InputError("sent", "", f"feeds of {count} figures", len(sent))
        each = zip(self.others, given, sent or ((),) * count)
        return self.change(others=tuple(figure.at(seconds, signals, feeds) for figure, signals, feeds in each))

    @property
    def frames(self) -> int:
        """How many frames of the selected one's timeline last until the longest timeline of all figures ends."""
        return self.timeline.frames_beside(figure.timeline for figure in self.others)

    def nearest(self, frame: int) -> int:
        """A frame that there is."""
        return min(max(frame, 0), self.frames - 1)

    @property
    def played(self) -> tuple[int, int]:
        """First and last frame that are played: the selected one's range, else until the longest ends."""
        return self.timeline.played_of(self.frames)

    def each(self) -> tuple[StudioState, ...]:
        """A state of each figure alone, in their order, whose signals are those of the world."""
        if self.place == Place() and not self.others:
            return (self,)
        alone = replace(self, place=Place(), others=(), slot=0, posed=None)
        return tuple(
            replace(
                alone,
                avatar=figure.avatar,
                signals=figure.place.signals(figure.signals),
                timeline=figure.timeline,
                hidden=figure.hidden,
            )
            for figure in self.figures
        )

    @property
    def middle(self) -> tuple[float, float]:
        """x and z between all figures, metres."""
        x, _, z = np.mean([each.signals.translation for each in self.each()], axis=0).tolist()
        return x, z

    @property
    def base(self) -> Signals:
        """What the layers of the timeline lie on."""
        return self.signals if self.posed is None else self.posed

    def change(self, **changes: Any) -> StudioState:
        """A copy with some fields changed, validated. Numbers of the signals that are changed are posed, too."""
        if self.posed is not None and "signals" in changes and "posed" not in changes:
            changes["posed"] = _followed(self.posed, self.signals, changes["signals"])
        return replace(self, **changes)

    def pose(self, **changes: Any) -> StudioState:
        """A copy with some fields of the signals changed, validated."""
        return self.change(signals=self.signals.replace(**changes))

    def use(self, **changes: Any) -> StudioState:
        """A copy with some tools changed, validated."""
        return self.change(tools=replace(self.tools, **changes))

    def show(self, timeline: Timeline, signals: Signals | None = None, view: OrbitView | None = None) -> StudioState:
        """A copy with another timeline, which gives `signals` (None: those of now), the avatar's own shape.

        `view`: where the timeline leads the camera; else a view that follows moves along the ground.
        """
        if signals is None:
            return self.change(timeline=timeline, view=view or self.view)
        step = self.place.turned((signals.translation - self.signals.translation) * (1, 0, 1))
        if view is None:
            view = self.view.moved(step) if self.view.follow and step.any() else self.view
        shown = signals.replace(shape=self.signals.shape)
        posed = self.base if timeline.layers else None
        return self.change(timeline=timeline, signals=shown, view=view, posed=posed)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists and numbers."""
        alone = self.place == Place() and not self.others
        several = {"place": vars(self.place), "others": [figure.to_json() for figure in self.others], "slot": self.slot}
        return {
            "format": ALONE if alone else FORMAT,
            **{name: value for name, value in vars(self).items() if name not in ("posed", *several)},
            "view": asdict(self.view),
            "size": asdict(self.size),
            "stage": asdict(self.stage),
            "signals": self.signals.to_json(),
            "timeline": self.timeline.to_json(),
            "hidden": sorted(self.hidden),
            "tools": self.tools.to_json(),
            **({"posed": self.posed.to_json()} if self.posed else {}),
            **({} if alone else several),
        }

    @classmethod
    def from_json(cls, data: Any, source: str = "state") -> StudioState:
        """From `to_json`'s dictionary. Raises `InputError`."""
        if not isinstance(data, dict):
            raise InputError(source, "", "an object", type(data).__name__)
        data = dict(data)
        version = data.pop("format", None)
        if not isinstance(version, int) or version > FORMAT:
            raise InputError(source, "format", f"at most {FORMAT} (update the studio)", version)
        if "motion" in data:  # of formats 1 and 2
            data["timeline"] = _of_motion(data.pop("motion"), source)
        names = {item.name for item in fields(cls)}
        if unknown := sorted(set(data) - names):
            raise InputError(source, unknown[0], "one of " + ", ".join(sorted(names)), "an unknown field")
        try:
            return cls(**{name: _read(name, value, source) for name, value in data.items()})
        except (TypeError, KeyError, AttributeError) as error:
            raise InputError(source, "", "a state of the studio", error) from None


def vector(values: Iterable[SupportsFloat]) -> Vector:
    """Three numbers of an array as plain ones."""
    x, y, z = values
    return float(x), float(y), float(z)


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _tuple(value: Any) -> Any:
    return tuple(map(_tuple, value)) if isinstance(value, list | tuple) else value


def _followed(posed: Signals, before: Signals, after: Signals) -> Signals:
    """`posed` with the joints and coefficients that an edit has changed."""
    changes = {}
    for name in SHAPES:
        differ = getattr(before, name) != getattr(after, name)
        if differ.any():
            if name not in ("expression", "shape"):
                differ = differ.any(-1, keepdims=True)
            changes[name] = np.where(differ, getattr(after, name), getattr(posed, name))
    return posed.replace(**changes) if changes else posed


def _of_motion(data: Any, source: str) -> dict[str, Any]:
    """The timeline of the one motion that a state of before names."""
    if not data:
        return {}
    content = dict(data)
    frame = content.pop("frame", 0)
    clip = Clip.from_json(content, source)
    if not (isinstance(frame, int) and 0 <= frame < clip.frames):
        raise InputError(clip.path, "frame", f"0 to {clip.frames - 1}", frame)
    return of_clip(clip, frame=frame).to_json()


def _read(name: str, value: Any, source: str) -> Any:
    if name in ("signals", "posed"):
        return Signals.from_json(value, source)
    if name == "timeline":
        return Timeline.from_json(value, source)
    if name == "others":
        return tuple(Figure.from_json(figure, source) for figure in value)
    if name == "slot":
        return value
    if name in _RECORDS:
        return _RECORDS[name](**{key: _tuple(entry) for key, entry in value.items()})
    return {"avatar": str, "hidden": frozenset}.get(name, _tuple)(value)


_RECORDS: dict[str, Any] = {
    "stage": Stage, "view": OrbitView, "size": SizePolicy, "tools": Tools.read, "place": Place,
}  # fmt: skip
