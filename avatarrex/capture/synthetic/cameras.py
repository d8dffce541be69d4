"""Cameras of the synthetic capture: a ring about the yaw axis for the body, an arc before the face.

All cameras of a rig share one focal length: the longest with which every picture of the motion keeps the subject within
a share of the picture. Letters: v vertices. World metres; pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from avatarrex.camera import Camera

BODY_DISTANCE, FACE_DISTANCE = 3.2, 1.1
BODY_ELEVATIONS = (4.0, 24.0, -6.0, 12.0)
"""Degrees, in turn about the ring: from above the head to below the knee."""
FACE_ELEVATIONS = (6.0, -8.0, 4.0, 14.0, -4.0, 8.0)
FACE_ARC = 130.0
"""Degrees from the first face camera to the last."""


def body_ring(count: int, width: int, height: int, target: np.ndarray) -> list[Camera]:
    """`count` cameras evenly about +Y through `target` (3,), the first in front."""
    return [
        Camera.orbit(360 * k / count, BODY_ELEVATIONS[k % 4], BODY_DISTANCE, 40, target, width, height)
        for k in range(count)
    ]


def face_arc(count: int, width: int, height: int, target: np.ndarray) -> list[Camera]:
    """`count` cameras from the person's right to the person's left."""
    azimuth = np.linspace(-FACE_ARC / 2, FACE_ARC / 2, count)
    return [
        Camera.orbit(float(azimuth[k]), FACE_ELEVATIONS[k % 6], FACE_DISTANCE, 20, target, width, height)
        for k in range(count)
    ]


def fitted(cameras: list[Camera], frames: Iterable[np.ndarray], margin: float) -> list[Camera]:
    """The cameras with the longest common focal length that keeps every frame's points (v, 3), world, within
    `margin` of half of every picture."""
    reach = np.zeros(2)
    for points in frames:
        for camera in cameras:
            seen = camera.seen(points)
            reach = np.maximum(reach, np.abs(seen[:, :2] / seen[:, 2:]).max(0))
    focal = round(float(min(0.5 * margin * np.array([cameras[0].width, cameras[0].height]) / reach)), 3)
    intrinsics = cameras[0].intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] = focal
    return [replace(camera, intrinsics=intrinsics) for camera in cameras]


def calibration(cameras: dict[str, Camera], distortion: Callable[[str], np.ndarray]) -> dict[str, dict[str, object]]:
    """AvatarReX's `calibration_full.json` of cameras by serial number, whose lenses have `distortion` (5,)."""
    return {
        serial: {
            "K": camera.intrinsics.ravel().tolist(),
            "R": camera.camera_from_world[:3, :3].ravel().tolist(),
            "T": camera.camera_from_world[:3, 3].tolist(),
            "distCoeff": distortion(serial).tolist(),
            "imgSize": [camera.width, camera.height],
            "rectifyAlpha": 0.0,
        }
        for serial, camera in cameras.items()
    }
