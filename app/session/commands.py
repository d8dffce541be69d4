"""One frozen dataclass per user action; what each does to a state: rules.py.

Commands carry values, never files or tensors, so a journal of them replays anywhere. `merge` folds the commands of one
gesture (a drag, a playing motion) together. Angles in degrees for the camera, radians for joints; metres.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from avatarrex_studio.session.state import Colour

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Command:
    """A user action."""


@dataclass(frozen=True)
class SetJoint(Command):
    joint: str
    rotation: Vector


@dataclass(frozen=True)
class SetTranslation(Command):
    translation: Vector


@dataclass(frozen=True)
class SetExpression(Command):
    name: str
    value: float


@dataclass(frozen=True)
class SetShape(Command):
    index: int
    value: float


@dataclass(frozen=True)
class SetHandPose(Command):
    side: str
    name: str


@dataclass(frozen=True)
class ApplyPose(Command):
    """A named body pose; hands and face stay."""

    name: str


@dataclass(frozen=True)
class ApplyExpression(Command):
    name: str


@dataclass(frozen=True)
class SetSignals(Command):
    """All signals at once: a pasted pose, a file."""

    signals: Signals


@dataclass(frozen=True)
class Randomise(Command):
    """A group within `strength` times its limits, drawn from `seed`."""

    group: str
    strength: float
    seed: int


@dataclass(frozen=True)
class Mirror(Command):
    """Left and right exchanged; the place stays."""


@dataclass(frozen=True)
class Reset(Command):
    """Pose, hands, face, shape and place at rest."""


@dataclass(frozen=True)
class ResetGroup(Command):
    group: str


@dataclass(frozen=True)
class SetLimits(Command):
    limited: bool


@dataclass(frozen=True)
class OrbitBy(Command):
    azimuth: float
    elevation: float


@dataclass(frozen=True)
class PanBy(Command):
    """Moves the target in the image plane, in shares of the view's height: right, up."""

    right: float
    up: float


@dataclass(frozen=True)
class ZoomBy(Command):
    """Multiplies the distance."""

    factor: float


@dataclass(frozen=True)
class SetCamera(Command):
    """The named entries of the view; None keeps one."""

    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    fov: float | None = None
    target: Vector | None = None
    follow: bool | None = None


@dataclass(frozen=True)
class SetBackground(Command):
    colour: Colour


@dataclass(frozen=True)
class SetSize(Command):
    scale: float = 1.0
    fixed: tuple[int, int] | None = None


@dataclass(frozen=True)
class SetHidden(Command):
    part: str
    hidden: bool


@dataclass(frozen=True)
class SetLevel(Command):
    """Run time against error: one of `state.LEVELS`."""

    level: str


@dataclass(frozen=True)
class OpenAvatar(Command):
    avatar: str


@dataclass(frozen=True)
class LoadMotion(Command):
    """A motion was read; its first frame comes with it."""

    path: str
    name: str
    frames: int
    fps: float
    signals: Signals


@dataclass(frozen=True)
class SetFrame(Command):
    """The motion stands at `frame`, whose signals come along: a journal needs no motion file."""

    frame: int
    signals: Signals


@dataclass(frozen=True)
class CloseMotion(Command):
    pass


def merge(earlier: Command, later: Command) -> Command | None:
    """`later`, where it makes `earlier` of no effect; else None."""
    same_target = all(getattr(earlier, name, None) == getattr(later, name, None) for name in ("joint", "name", "index"))
    return later if type(earlier) is type(later) and isinstance(later, _ABSOLUTE) and same_target else None


_ABSOLUTE = (
    SetJoint, SetTranslation, SetExpression, SetShape, SetSignals, SetBackground, SetSize, SetLevel, SetFrame, SetLimits
)  # fmt: skip
"""Commands of which the last alone decides."""


def to_json(command: Command) -> dict[str, Any]:
    """`{"command": name, …}`."""
    content = {item.name: getattr(command, item.name) for item in dataclasses.fields(command)}
    return {
        "command": type(command).__name__,
        **{name: value.to_json() if isinstance(value, Signals) else value for name, value in content.items()},
    }


def from_json(data: Any, source: str = "session") -> Command:
    """The command that `to_json` wrote. Raises `InputError`."""
    kinds = {kind.__name__: kind for kind in Command.__subclasses__()}
    name = data.get("command") if isinstance(data, dict) else None
    if name not in kinds:
        raise InputError(source, "command", "the name of a command", name)
    content: dict[str, Any] = {key: _read(key, value, source) for key, value in data.items() if key != "command"}
    try:
        return kinds[name](**content)
    except TypeError as error:
        raise InputError(source, name, "the fields of that command", error) from None


def _read(key: str, value: Any, source: str) -> Any:
    if key == "signals":
        return Signals.from_json(value, source)
    return tuple(value) if isinstance(value, list) else value
