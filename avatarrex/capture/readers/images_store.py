"""Images and mattes of a rig, decoded at first use and kept within a budget of bytes. Letters: h w pixels."""

from __future__ import annotations

import io
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from avatarrex.capture.readers.archive import PICTURE_BYTES, Archive
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.undistort import source_pixels, undistort
from avatarrex.errors import InputError
from avatarrex.files.whole_picture import check_whole
from avatarrex.files.zips import refusing


class ByteCache:
    """The most recently used arrays of at most `budget` bytes together; safe for threads. A pickled one starts empty."""

    def __init__(self, budget: int) -> None:
        self.budget, self.stored = budget, 0
        self._lock = threading.Lock()
        self._items: OrderedDict[Hashable, np.ndarray] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {"budget": self.budget}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def get(self, key: Hashable, make: Callable[[], np.ndarray]) -> np.ndarray:
        """The array of `key`, made outside the lock where it is not stored; read-only."""
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key]
        value = make()
        value.setflags(write=False)
        with self._lock:
            if key not in self._items and value.nbytes <= self.budget:
                self._items[key] = value
                self.stored += value.nbytes
                while self.stored > self.budget:
                    self.stored -= self._items.popitem(last=False)[1].nbytes
        return value


def has_alpha(archive: Archive, name: str) -> bool:
    """Whether a picture's header announces an alpha channel; one that cannot be read has none here and is refused later."""
    try:
        return bool(Image.open(io.BytesIO(archive.read(name, PICTURE_BYTES))).has_transparency_data)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False


def times(image: UInt8[np.ndarray, "h w 3"], gain: Float[np.ndarray, " 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """An sRGB image with each channel multiplied, rounded; what is brighter than white is white."""
    brighter: np.ndarray = np.rint(np.clip(image * gain, 0, 255)).astype(np.uint8)
    return brighter


class Pictures:
    """Decoded, undistorted pictures of one rig by (view, frame)."""

    def __init__(
        self,
        archive: Archive,
        lenses: tuple[Lens, ...],
        images: tuple[dict[int, str], ...],
        mattes: tuple[dict[int, str], ...],
        cache: ByteCache,
    ) -> None:
        self._archive, self._lenses, self._cache = archive, lenses, cache
        self._names = {"image": images, "matte": mattes}
        self._whole: set[str] = set()
        """Files that have been found to be whole; a black PNG is unpacked for it, which takes up to as long as decoding."""

    def get(self, kind: str, view: int, frame: int) -> np.ndarray:
        """An `image`, sRGB bytes (h, w, 3) times its camera's gain, or a `matte`, foreground from 0 to 255 (h, w); read-only.

        Raises `InputError` for a damaged file or another size than the calibration's.
        """
        return self._cache.get((kind, self._names[kind][view][frame]), lambda: self._decode(kind, view, frame))

    def check_size(self, view: int, frame: int) -> None:
        """Raise `InputError` where a picture's header gives another size than the calibration; decodes nothing."""
        for kind in self._names:
            self._open(kind, view, frame)

    def _alpha(self, view: int, frame: int) -> bool:
        """Whether the matte is the image's own alpha channel."""
        return self._names["matte"][view][frame] == self._names["image"][view][frame]

    def _decode(self, kind: str, view: int, frame: int) -> np.ndarray:
        content, picture = self._open(kind, view, frame)
        own = kind == "matte" and self._alpha(view, frame)
        if own and not picture.has_transparency_data:
            expected = "an alpha channel, as the camera's first picture has, or a matte"
            raise InputError(self._place(kind, view, frame), "", expected, picture.mode)
        place, name = self._place(kind, view, frame), self._names[kind][view][frame]
        with refusing(place, "", "a whole picture", (OSError, ValueError, SyntaxError, EOFError)):
            if name not in self._whole:
                check_whole(content, np.asarray(picture), place)
                self._whole.add(name)
            chosen = picture.convert("RGBA").getchannel("A") if own else picture
            pixels = np.array(chosen.convert("RGB" if kind == "image" else "L"))
        lens = self._lenses[view]
        if lens.distorts:
            pixels = undistort(pixels, self._cache.get(("pixels", lens), lambda: source_pixels(lens)))
        return times(pixels, np.array(lens.gain)) if kind == "image" and set(lens.gain) != {1.0} else pixels

    def _open(self, kind: str, view: int, frame: int) -> tuple[bytes, Image.Image]:
        """A picture's file, and the picture before it is decoded."""
        place = self._place(kind, view, frame)
        try:
            content = self._archive.read(self._names[kind][view][frame], PICTURE_BYTES)
            picture = Image.open(io.BytesIO(content))
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(place, "", "a JPEG or PNG picture", error) from None
        camera = self._lenses[view].camera
        if picture.size != (camera.width, camera.height):
            expected = f"{camera.width}x{camera.height} pixels, as the calibration says"
            raise InputError(place, "", expected, f"{picture.size[0]}x{picture.size[1]}")
        if picture.mode not in ("1", "L", "LA", "P", "RGB", "RGBA"):
            raise InputError(place, "", "8 bits a channel, grey or RGB", f"mode {picture.mode}")
        return content, picture

    def _place(self, kind: str, view: int, frame: int) -> str:
        return self._archive.place(self._names[kind][view][frame])
