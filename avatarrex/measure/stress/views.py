"""Cameras that look for trouble at a posed person: inside the body, grazing, 1 cm and 1 km away, fisheye and telephoto."""

from __future__ import annotations

import numpy as np

from avatarrex.camera import Camera
from avatarrex.measure.stress.case import Entry, Inputs

ENTRIES = {"intrinsics": Entry((3, 3)), "camera_from_world": Entry((4, 4))}
KINDS = ("about", "inside", "grazing", "1 cm", "1 km", "far focus", "wide", "steep")


def draw_view(rng: np.random.Generator, number: int, surface: np.ndarray, side: int) -> Camera:
    """A camera of the kind of that number, `side` pixels square, of a person with the `surface` points (v, 3), world."""
    kind = KINDS[number % len(KINDS)]
    azimuth, elevation = rng.uniform(-180, 180), rng.uniform(-60, 60)
    middle, spot = surface.mean(0), surface[rng.integers(len(surface))]
    match kind:
        case "about":
            return Camera.orbit(azimuth, elevation, 2.8, 45, middle + rng.normal(size=3) * 0.2, side, side)
        case "inside":  # the eye on the way from the middle to a point of the skin
            eye = middle + rng.uniform(0, 0.9) * (spot - middle)
            there = Camera.orbit(azimuth, elevation, 1.0, 70, (0.0, 0.0, 0.0), side, side)
            return Camera.orbit(azimuth, elevation, 1.0, 70, eye - there.centre, side, side)
        case "grazing":  # the eye level with a point of the skin, along the axes
            return Camera.orbit(90.0 * rng.integers(4), 0, 1.5, 30, spot, side, side)
        case "1 cm":
            return Camera.orbit(azimuth, elevation, 0.01, 60, spot, side, side)
        case "1 km":
            return Camera.orbit(azimuth, elevation, 1000.0, 1.0, middle, side, side)
        case "far focus":  # the narrowest image, the person fills it
            return Camera.orbit(azimuth, elevation, 100.0, 1.0, middle, side, side)
        case "wide":
            return Camera.orbit(azimuth, elevation, 1.0, 170, middle, side, side)
        case _:
            return Camera.orbit(azimuth, rng.choice([-90.0, 90.0]), 2.5, 45, middle, side, side)


def inputs_of(camera: Camera) -> Inputs:
    """The camera as inputs of a case."""
    return {"intrinsics": camera.intrinsics, "camera_from_world": camera.camera_from_world}


def camera_of(inputs: Inputs, side: int) -> Camera:
    """Back again. Raises `InputError`."""
    return Camera(inputs["intrinsics"], inputs["camera_from_world"], side, side)
