"""The figures of a session: avatars side by side, each with its own signals, timeline and place.

A place turns and moves what the timeline gives: signals, keys and motions know nothing of it. Metres, world frame; degrees.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from avatarrex_studio.session.timeline import Feeds, Timeline, check
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.templates.parts import PARTS
from avatarrex.templates.transform import world_from_root

MOST_FIGURES = 8
"""Of a session: each has a volume of some ten megabytes."""
APART = 1.0
"""Metres from a figure to one that is added beside it."""
LIMITS = {"turn": (-360.0, 360.0), "x": (-100.0, 100.0), "z": (-100.0, 100.0)}


@dataclass(frozen=True)
class Place:
    """Where a figure stands."""

    turn: float = 0.0
    """About the vertical through its pelvis at rest; 90 looks to where its left was."""
    x: float = 0.0
    z: float = 0.0

    def __post_init__(self) -> None:
        for name, bounds in LIMITS.items():
            check("place", name, getattr(self, name), bounds)

    @property
    def rotation(self) -> Rotation:
        """About the vertical."""
        return Rotation.from_rotvec([0.0, np.radians(self.turn), 0.0])

    def turned(self, step: np.ndarray) -> np.ndarray:
        """A step (3,) of the figure's as one of the world."""
        return np.asarray(self.rotation.as_matrix() @ step) if self.turn else step

    def signals(self, own: Signals) -> Signals:
        """A figure's own signals as those of the world; the very same where it has not been moved."""
        if self == Place():
            return own
        orient = (self.rotation * Rotation.from_rotvec(np.array(own.global_orient))).as_rotvec()
        moved = self.turned(own.translation) + np.array([self.x, 0.0, self.z])
        return own.replace(global_orient=orient if self.turn else own.global_orient, translation=moved)

    def world(self, pelvis: np.ndarray) -> np.ndarray:
        """(4, 4): from the figure's own frame, with its pelvis (3,) at rest, to the world."""
        return world_from_root(self.rotation.as_rotvec(), np.array([self.x, 0.0, self.z]), pelvis)


@dataclass(frozen=True)
class Figure:
    """One of them, as `StudioState` has the one that is selected."""

    avatar: str = "default"
    signals: Signals = field(default_factory=Signals.rest)
    timeline: Timeline = field(default_factory=Timeline)
    hidden: frozenset[str] = frozenset()
    posed: Signals | None = None
    place: Place = field(default_factory=Place)

    def __post_init__(self) -> None:
        check_hidden(self.hidden)

    @property
    def base(self) -> Signals:
        """What the layers of the timeline lie on."""
        return self.signals if self.posed is None else self.posed

    def at(self, seconds: float, signals: Signals | None, feeds: Feeds = ()) -> Figure:
        """While another one's timeline plays: the playhead goes along, to what the layers give; None: what is shown stays.

        `feeds`: what its live sources sent.
        """
        timeline = self.timeline.with_feeds(feeds)
        if signals is None:
            return replace(self, timeline=timeline)
        return replace(
            self, timeline=timeline.at(seconds), signals=signals.replace(shape=self.signals.shape), posed=self.base
        )

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists and numbers."""
        return {
            "avatar": self.avatar,
            "signals": self.signals.to_json(),
            "timeline": self.timeline.to_json(),
            "hidden": sorted(self.hidden),
            "place": vars(self.place),
            **({"posed": self.posed.to_json()} if self.posed else {}),
        }

    @classmethod
    def from_json(cls, data: dict[str, Any], source: str = "figure") -> Figure:
        """From `to_json`'s entries. Raises `InputError`."""
        readers: dict[str, Any] = {
            "avatar": str,
            "signals": lambda value: Signals.from_json(value, source),
            "timeline": lambda value: Timeline.from_json(value, source),
            "hidden": frozenset,
            "place": lambda value: Place(**value),
            "posed": lambda value: Signals.from_json(value, source),
        }
        if unknown := sorted(set(data) - set(readers)):
            raise InputError(source, unknown[0], "one of " + ", ".join(readers), "an unknown field")
        return cls(**{name: readers[name](value) for name, value in data.items()})


FIELDS = tuple(item.name for item in fields(Figure))
"""What a figure has, and the state of the selected one."""


def check_hidden(parts: Iterable[str]) -> None:
    """Raise `InputError` where a part is none of `PARTS`."""
    for part in parts:
        if part not in PARTS:
            raise InputError("hidden", "", " or ".join(PARTS), part)


def beside(places: Iterable[Place]) -> Place:
    """Where one more figure has room: at the left of all others, in line with the last."""
    listed = list(places)
    return Place(x=min(max(place.x for place in listed) + APART, LIMITS["x"][1]), z=listed[-1].z)


def standing() -> Signals:
    """What a new figure does: it stands, hands and face relaxed."""
    hands = {f"{side}_hand_pose": named_hand("relaxed", side) for side in ("left", "right")}
    face = named_expression("relaxed")
    return Signals.rest().replace(body_pose=named_pose("stand"), expression=face, **hands)
