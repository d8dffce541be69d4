"""Pinhole cameras (OpenCV: x right, y down, z forward; pixel centres at +0.5; metres).

All transforms are float64: the difference between a far root and a far camera is taken here, once per frame, so that
everything after it is small and float32 is enough (docs/stress.md, 'far from origin').
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avatarrex.errors import InputError


@dataclass(frozen=True)
class Camera:
    """A calibrated pinhole view: OpenCV axes (x right, y down, z forward), pixel centres at +0.5, image row 0 at the top.

    `Camera.orbit` makes one that looks at the person. Raises `InputError` for another shape, for numbers that are not
    finite, and for a side beyond 1 to 16384 pixels.
    """

    intrinsics: np.ndarray
    """K, (3, 3), pixels."""
    camera_from_world: np.ndarray
    """(4, 4) rigid, metres."""
    width: int
    height: int

    def __post_init__(self) -> None:
        for name, shape in (("intrinsics", (3, 3)), ("camera_from_world", (4, 4))):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError("camera", name, f"{shape} finite numbers", f"{value.shape}")
            object.__setattr__(self, name, value)
        for name in ("width", "height"):
            if not 1 <= getattr(self, name) <= 16384:
                raise InputError("camera", name, "1 to 16384 pixels", getattr(self, name))

    @staticmethod
    def orbit(
        azimuth_deg: float = 0.0,
        elevation_deg: float = 0.0,
        distance: float = 2.6,
        fov_deg: float = 40.0,
        target: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0),
        width: int = 512,
        height: int = 512,
    ) -> Camera:
        """A camera on a sphere about `target` (world metres), +Y up, looking at it.

        Azimuth 0 sees the person's front (camera on +Z); 90 sees the person's left side (camera on +X).
        `fov_deg` spans the image height, or the width where that is smaller.
        """
        for name, value, low, high in (
            ("fov", fov_deg, 0.01, 170.0),
            ("distance", distance, 1e-3, 1e6),
            ("elevation", elevation_deg, -90.0, 90.0),
        ):
            if not (np.isfinite(value) and low <= value <= high):
                raise InputError("camera", name, f"a number from {low:g} to {high:g}", value)
        if not np.isfinite(azimuth_deg):
            raise InputError("camera", "azimuth", "a finite number of degrees", azimuth_deg)
        azimuth, elevation = np.radians([azimuth_deg, np.clip(elevation_deg, -89.9, 89.9)])
        outward = np.array(
            [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)]
        )
        right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
        rotation = np.stack([right, np.cross(-outward, right), -outward])
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = rotation
        camera_from_world[:3, 3] = -rotation @ (np.asarray(target, dtype=np.float64) + distance * outward)
        focal = 0.5 * min(width, height) / np.tan(np.radians(fov_deg) / 2)
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        return Camera(intrinsics, camera_from_world, width, height)

    def seen_from(self, world_from_root: np.ndarray) -> Camera:
        """The same camera with the root frame as its world, `world_from_root` (4, 4) float64."""
        return Camera(self.intrinsics, self.camera_from_world @ world_from_root, self.width, self.height)

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """The part of the view with (left, top) as its top left pixel."""
        shift = np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
        return Camera(self.intrinsics - shift, self.camera_from_world, width, height)

    def resized(self, width: int, height: int) -> Camera:
        """The same view on another pixel raster, (width, height)."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return Camera(scale @ self.intrinsics, self.camera_from_world, width, height)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Points (…, 3), world metres, along the camera's axes: x right, y down, z into the picture."""
        return np.asarray(points @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3])

    def pixels(self, points: np.ndarray, nearest: float = 1e-6) -> tuple[np.ndarray, np.ndarray]:
        """Where points (…, 3), world metres, are in the picture, (…, 2) column and row in pixels, and their depth z (…), metres.

        What lies nearer than `nearest` metres, or beyond the camera's back, is divided by that depth: a caller that may meet
        such points looks at their depth.
        """
        seen = self.seen(points)
        depth = seen[..., 2]
        return (seen @ self.intrinsics.T)[..., :2] / np.maximum(depth, nearest)[..., None], depth

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """(p, 2, 3) how far points (p, 3), world metres, move in the picture, pixels, as they move in the world."""
        seen = self.seen(points)
        depth, flat = seen[:, 2, None, None], np.broadcast_to(np.eye(2), (len(points), 2, 2))
        slope = np.concatenate([flat, -(seen[:, :2, None] / depth)], 2) / depth
        return np.asarray(self.intrinsics[:2, :2] @ slope @ self.camera_from_world[:3, :3])

    def point(self, pixel: tuple[float, float], depth: float) -> np.ndarray:
        """The point (3,), world metres, that is seen at a column and a row (in pixels) at `depth` z: the way back of `pixels`."""
        ray = np.linalg.solve(self.intrinsics, (*pixel, 1.0))
        rotation, translation = self.camera_from_world[:3, :3], self.camera_from_world[:3, 3]
        return np.asarray(rotation.T @ (depth * ray - translation))

    @property
    def centre(self) -> np.ndarray:
        """Camera centre in world metres, (3,)."""
        rotation, translation = self.camera_from_world[:3, :3], self.camera_from_world[:3, 3]
        return np.asarray(-rotation.T @ translation)

    def key(self) -> tuple[int, int, bytes, bytes]:
        """What a stage that depends on the camera compares."""
        return (self.width, self.height, self.intrinsics.tobytes(), self.camera_from_world.tobytes())
