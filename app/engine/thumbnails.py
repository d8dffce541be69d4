"""Small pictures of library entries at level `live`, made one by one while nothing else is to be drawn, and kept on the disk.

A picture is `CACHE/thumbnails/AVATAR/CONTENT.png`: the key of the avatar's surface and a hash of what is shown, so that another
avatar or another pose is another file.
"""

from __future__ import annotations

import hashlib
import io
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from avatarrex_studio.engine.framing import framed
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.session.state import OrbitView, StudioState
from avatarrex_studio.session.user_library import cache_folder
from jaxtyping import Float32, UInt8
from PIL import Image

from avatarrex.avatar import Avatar
from avatarrex.errors import InputError
from avatarrex.files.gate import read_bytes, what_is
from avatarrex.files.images import NO_PICTURE, write_png
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.model import pose_by_signals

log = logging.getLogger(__name__)
SIDE = 128
"""Pixels."""
FILE_BYTES = 2**18
"""Of a picture on the disk."""
FACING = {
    "pose": OrbitView(18.0, 6.0, fov=20.0),
    "hand": OrbitView(25.0, -48.0, fov=20.0),
    "expression": OrbitView(10.0, fov=20.0),
}
"""Where the camera is, by kind."""
SHOWN = {
    "hand": tuple(name for name in JOINT_NAMES if name.startswith("left_") and name[-1].isdigit()),
    "expression": ("head", "jaw", "left_eye", "right_eye"),
}
"""Joints whose skin is framed; of a pose all."""
Pixels = UInt8[np.ndarray, "h w 4"]


@dataclass(frozen=True)
class Sitter:
    """What a picture shows."""

    kind: str
    signals: Signals

    @property
    def key(self) -> str:
        """Of what is shown."""
        content = b"".join(getattr(self.signals, name).tobytes() for name in vars(self.signals))
        return hashlib.sha256(f"{self.kind} {SIDE} {FACING[self.kind]}".encode() + content).hexdigest()[:16]


class Thumbnails:
    """Pictures by what they show, of the avatar that is open; those that are missing are made by `tend`, one a call."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or cache_folder() / "thumbnails"
        self._avatar: Avatar | None = None
        self._tried: set[Sitter] = set()
        self._wanted: dict[Sitter, None] = {}
        self._surface = LiveSurface()

    def want(self, sitter: Sitter) -> None:
        """Have a picture made, once."""
        if sitter not in self._tried:
            self._wanted[sitter] = None

    @property
    def waiting(self) -> bool:
        """Whether pictures are to be made."""
        return bool(self._wanted) and self._avatar is not None and self._avatar.surface is not None

    def see(self, avatar: Avatar | None) -> bool:
        """The avatar that is open; whether it is another one than before, so that every picture is to be made anew."""
        new = avatar is not self._avatar
        if new:
            self._avatar = avatar
            self.close()
        return new

    def close(self) -> None:
        """Let go of what the last picture was made of; every one is made anew, or read."""
        self._surface.forget()
        self._tried.clear()

    def tend(self) -> tuple[Sitter, Pixels] | None:
        """Read or make the picture that was wanted first: straight-alpha bytes; None where there is none to make."""
        if not self.waiting:
            return None
        sitter = next(iter(self._wanted))
        del self._wanted[sitter]
        self._tried.add(sitter)
        assert self._avatar is not None
        pixels = self._read(sitter) if self._stored(sitter) else self._draw(self._avatar, sitter)
        return None if pixels is None else (sitter, pixels)

    def forget(self) -> None:
        """What is wanted no more: the panel is hidden."""
        self._wanted.clear()

    def _path(self, sitter: Sitter) -> Path:
        assert self._avatar is not None
        assert self._avatar.surface is not None
        return self.folder / (self._avatar.surface.key or "unnamed") / f"{sitter.key}.png"

    def _stored(self, sitter: Sitter) -> bool:
        return what_is(self._path(sitter)) == "a file"

    def _read(self, sitter: Sitter) -> Pixels | None:
        """From the disk; what is no picture of that size is made again."""
        path = self._path(sitter)
        try:
            content = read_bytes(path, "a thumbnail", FILE_BYTES)
            with Image.open(io.BytesIO(content), formats=("PNG",)) as picture:
                if picture.size == (SIDE, SIDE):
                    return np.asarray(picture.convert("RGBA"))
        except (InputError, *NO_PICTURE) as error:
            log.info("%s: drawn anew: %s", path, error)
        return self._draw(self._avatar, sitter) if self._avatar else None

    def _draw(self, avatar: Avatar, sitter: Sitter) -> Pixels | None:
        view = framed(FACING[sitter.kind], _framed_points(avatar, sitter), (SIDE, SIDE))
        try:
            picture = self._surface.draw([avatar], StudioState(signals=sitter.signals, view=view), (SIDE, SIDE))
        except Exception:  # a fault of ours: its trace goes to the log, and the card has no picture
            log.exception("a thumbnail could not be drawn")
            return None
        if picture is None:
            return None
        pixels = _bytes(picture.read())
        try:
            write_png(self._path(sitter), pixels)
        except InputError as error:
            log.info("the thumbnail is not kept: %s", error)
        return pixels


def _bytes(image: Float32[np.ndarray, "h w 4"]) -> Pixels:
    """Premultiplied colour as straight-alpha bytes."""
    straight = image[..., :3] / np.maximum(image[..., 3:], 1e-6)
    return np.asarray(np.rint(255 * np.clip(np.concatenate([straight, image[..., 3:]], -1), 0, 1)), np.uint8)


def _framed_points(avatar: Avatar, sitter: Sitter) -> np.ndarray:
    """(p, 3) root frame: what is to be in the picture."""
    body = avatar.person.body
    vertices = pose_by_signals(body, sitter.signals).vertices.double().numpy()
    if sitter.kind in SHOWN:
        owner = body.weights.argmax(1).numpy()
        vertices = vertices[np.isin(owner, [JOINT_NAMES.index(name) for name in SHOWN[sitter.kind]])]
    return np.asarray(vertices[::8])
