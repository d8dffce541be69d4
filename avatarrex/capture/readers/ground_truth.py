"""What a capture knows exactly: posed meshes, joints, and where it was rendered with them depth and normals.

`ground_truth.npz` of a rig: `vertices` (t, v, 3), `faces` (f, 3), optional `joints` (t, 55, 3), `tpose_joints` (55, 3),
world metres; `<camera>/truth/%08d.npz` of some frames: `depth` (h, w) camera z, `normal` (h, w, 3) world, both 0 on the
background; optional `face_material` (f,) into the names `materials`: one called opacity is of cards that are mostly
transparent, and no part of the surface. Letters: t frames, v vertices, f faces, h w pixels.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.layout import RigFiles
from avatarrex.errors import InputError
from avatarrex.files.assets import require


class RigTruth:
    """Exact meshes of one rig (and where there are any, depth and normals), read at first use."""

    def __init__(
        self, files: RigFiles, scale: float = 1.0, frames: int | None = None, lenses: tuple[Lens, ...] = ()
    ) -> None:
        name = files.ground_truth
        if name is None:
            raise InputError(files.archive.path, files.name("ground_truth.npz"), "the file to be there", "nothing")
        self._files, self._name, self.scale, self.frames = files, name, scale, frames
        self._lenses = lenses

    def __getstate__(self) -> dict[str, Any]:
        """Without what was read: another process reads its own."""
        kept = {"_files", "_name", "scale", "frames", "_lenses"}
        return {name: value for name, value in self.__dict__.items() if name in kept}

    @property
    def place(self) -> str:
        """What an error calls the file."""
        return self._files.archive.place(self._name)

    def array(self, key: str, shape: tuple[int | None, ...]) -> np.ndarray | None:
        """An array, checked, or None where the file has none of that name."""
        arrays = self._files.archive.arrays(self._name, (key,))
        return require(arrays, self.place, key, shape) if key in arrays else None

    @cached_property
    def vertices(self) -> np.ndarray:
        """(t, v, 3) float32, metres."""
        found = self.array("vertices", (self.frames, None, 3))
        if found is None:
            raise InputError(self.place, "vertices", "the key to be there", "none")
        return (found * np.float32(self.scale)).astype(np.float32)

    @cached_property
    def faces(self) -> np.ndarray:
        """(f, 3) int64."""
        found = self.array("faces", (None, 3))
        count = self.vertices.shape[1]
        if found is None or not found.size or found.min() < 0 or found.max() >= count:
            raise InputError(
                self.place, "faces", f"triangles of {count} vertices", "none" if found is None else found.shape
            )
        return np.asarray(found[self._opaque(len(found))].astype(np.int64))

    def _opaque(self, count: int) -> np.ndarray:
        """(count,) bool: faces that a picture shows as surface."""
        material = self.array("face_material", (count,))
        names = self.array("materials", (None,))
        if material is None or names is None:
            return np.ones(count, dtype=bool)
        clear = [index for index, name in enumerate(names) if "opacity" in str(name).lower()]
        return ~np.isin(material, clear)

    @cached_property
    def joints(self) -> np.ndarray | None:
        """(t, 55, 3) metres."""
        found = self.array("joints", (self.frames, 55, 3))
        return None if found is None else found.astype(np.float64) * self.scale

    def depth(self, view: int, frame: int) -> np.ndarray | None:
        """(h, w) float32 camera z in metres, 0 on the background, or None where the capture has none."""
        found = self._geometry(view, frame, "depth", ())
        return None if found is None else found * np.float32(self.scale)

    def normal(self, view: int, frame: int) -> np.ndarray | None:
        """(h, w, 3) float32 unit world normals, 0 on the background, or None."""
        return self._geometry(view, frame, "normal", (3,))

    def _geometry(self, view: int, frame: int, key: str, channels: tuple[int, ...]) -> np.ndarray | None:
        name = self._files.name(self._lenses[view].name, "truth", f"{frame:08d}.npz")
        if not self._files.archive.exists(name):
            return None
        camera = self._lenses[view].camera
        arrays, shape = self._files.archive.arrays(name, (key,)), (camera.height, camera.width, *channels)
        if key not in arrays:
            return None
        return require(arrays, self._files.archive.place(name), key, shape).astype(np.float32)
