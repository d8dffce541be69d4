"""AvatarReX Studio's library: expressive full-body avatars on one signed distance field.

    import avatarrex as ax

    avatar = ax.load("default")
    signals = ax.Signals.rest().replace(body_pose=ax.named_pose("wave"), expression=ax.named_expression("smile"))
    frame = ax.render(avatar, signals, ax.Camera.orbit(azimuth_deg=20))
    frame.image, frame.pointmap.depth, frame.ms, frame.counters

These names are the public API; everything else may move between versions. Each is imported on first use, so that
`import avatarrex` is light: a wrong option is refused before torch is loaded.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from avatarrex.avatar import Avatar
    from avatarrex.avatar_file import load_avatar as load
    from avatarrex.avatar_file import save_avatar as save
    from avatarrex.camera import Camera
    from avatarrex.errors import InputError
    from avatarrex.frame import Frame
    from avatarrex.levels import level
    from avatarrex.pipeline import render_frame as render
    from avatarrex.settings import RenderSettings
    from avatarrex.signals.driving import Signals
    from avatarrex.signals.library import named_expression, named_hand, named_pose
    from avatarrex.signals.read import read_motion
    from avatarrex.signals.read import write_json as write_motion
    from avatarrex.signals.sequence import SignalSequence

__all__ = [
    "Avatar",
    "Camera",
    "Frame",
    "InputError",
    "RenderSettings",
    "SignalSequence",
    "Signals",
    "level",
    "load",
    "named_expression",
    "named_hand",
    "named_pose",
    "read_motion",
    "render",
    "save",
    "write_motion",
]

_HOMES = {
    "Avatar": ("avatar", "Avatar"),
    "Camera": ("camera", "Camera"),
    "Frame": ("frame", "Frame"),
    "InputError": ("errors", "InputError"),
    "RenderSettings": ("settings", "RenderSettings"),
    "SignalSequence": ("signals.sequence", "SignalSequence"),
    "Signals": ("signals.driving", "Signals"),
    "level": ("levels", "level"),
    "load": ("avatar_file", "load_avatar"),
    "named_expression": ("signals.library", "named_expression"),
    "named_hand": ("signals.library", "named_hand"),
    "named_pose": ("signals.library", "named_pose"),
    "read_motion": ("signals.read", "read_motion"),
    "render": ("pipeline", "render_frame"),
    "save": ("avatar_file", "save_avatar"),
    "write_motion": ("signals.read", "write_json"),
}
"""Module and name there. A test holds it to the imports above."""


def __getattr__(name: str) -> object:
    """Import a name of `__all__` on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, its_name = _HOMES[name]
    value = globals()[name] = getattr(import_module(f"{__name__}.{module}"), its_name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
