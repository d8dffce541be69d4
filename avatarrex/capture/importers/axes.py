"""A world with +Y up, whatever a capture's has: the axis that the person stands along becomes ours.

Letters: t frames. Metres, rotation vectors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.capture.readers.calibration import Lens

UPRIGHT = 0.5
"""Of the mean of unit vectors along the trunk: below it somebody lies or rolls, and nothing is decided."""
TURNS = {
    "+Z": Rotation.from_euler("x", -90, degrees=True),
    "-Z": Rotation.from_euler("x", 90, degrees=True),
    "-Y": Rotation.from_euler("x", 180, degrees=True),
    "+X": Rotation.from_euler("z", 90, degrees=True),
    "-X": Rotation.from_euler("z", -90, degrees=True),
}
"""By the axis that is up, what makes it +Y."""


def up_axis(orient: np.ndarray) -> str:
    """`+Y`, `+Z`, …: the axis nearest to the trunk of somebody with the rotations `orient` (t, 3); `+Y` where none is."""
    trunk = Rotation.from_rotvec(orient.reshape(-1, 3)).apply([0.0, 1.0, 0.0]).mean(0)
    axis = int(np.abs(trunk).argmax())
    return "+Y" if abs(trunk[axis]) < UPRIGHT else f"{'-' if trunk[axis] < 0 else '+'}{'XYZ'[axis]}"


def upright(
    lenses: tuple[Lens, ...], orient: np.ndarray, pelvis: np.ndarray, notes: list[str], up: str = ""
) -> tuple[tuple[Lens, ...], np.ndarray, np.ndarray, Rotation]:
    """Cameras, rotations (t, 3) and places (t, 3) of the pelvis in a world with +Y up, and its turn; a change is said in `notes`.

    `up`: the axis that is up, where somebody has said it.
    """
    axis = up or up_axis(orient)
    if axis == "+Y":
        return lenses, orient, pelvis, Rotation.identity()
    turn = TURNS[axis]
    notes.append(f"axes: the person stands along {axis} of the file's world, turned to +Y up")
    return (
        tuple(turned(lens, turn) for lens in lenses),
        (turn * Rotation.from_rotvec(orient)).as_rotvec(),
        turn.apply(pelvis),
        turn,
    )


def upright_cameras(lenses: tuple[Lens, ...], up: str, notes: list[str]) -> tuple[Lens, ...]:
    """Cameras without a person, in a world with +Y up, where somebody has said in `up` which axis of theirs is; said in `notes`."""
    if up in ("", "+Y"):
        return lenses
    notes.append(f"axes: {up} of the file's world is up, as was said, turned to +Y")
    return tuple(turned(lens, TURNS[up]) for lens in lenses)


def turned(lens: Lens, turn: Rotation) -> Lens:
    """The camera in a world that was turned by `turn`."""
    back = np.eye(4)
    back[:3, :3] = turn.inv().as_matrix()
    return replace(lens, camera=replace(lens.camera, camera_from_world=lens.camera.camera_from_world @ back))
