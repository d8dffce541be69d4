"""Region masks on the default person's skin, (v, m) in [0, 1]: what a procedural skin paints by.

Lips, nails, eyelids, ears, face and the inside of the mouth are MakeHuman's painted 2048² masks (CC0), read where a
vertex lies in the texture; brows and scalp have no mask and are placed by the eyes.

Letters: v vertices, f faces, m regions, t texture coordinates. Metres, T-pose, +Y up, facing +Z.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import maximum_filter

PAINTED = {
    "lips": "lips", "fingernails": "fingernails", "toenails": "toenails", "eyelids": "eyelids", "ears": "ears",
    "face": "face", "mouth_inside": "inside-mouth", "areolae": "aureolae",
}  # fmt: skip
MASK_TEXELS = 3
"""Texels: nails are as small as the mesh's triangles, so a vertex takes the brightest texel this near."""
BROW = (0.020, 0.0045, 0.021, 0.005)
"""Metres: height above the eye's centre, half thickness, half length, and how much the ends sink."""
HAIR_LINE = (
    (-0.12, -0.075), (-0.06, -0.060), (-0.035, -0.02), (-0.012, 0.0), (0.012, 0.012), (0.03, 0.045), (0.05, 0.062),
    (0.11, 0.068),
)  # fmt: skip
"""Where hair begins: (z − z of the head joint, y − y of the eyes), from the nape over the temples to the forehead."""
SOFT = 0.004
"""Metres over which brows and scalp fade."""


def region_masks(
    folder: Path, place: np.ndarray, skin: np.ndarray, v_template: np.ndarray, joints: dict[str, np.ndarray]
) -> tuple[np.ndarray, list[str]]:
    """The masks (v, m) and their names, from texture coordinates `place` (v, 2); zero off the `skin` (v,) bool."""
    painted = [read_mask(folder / f"mpfb_{name}.jpg", place) for name in PAINTED.values()]
    masks = np.stack([*painted, brows(v_template, joints), scalp(v_template, joints)], 1)
    masks[:, -1] *= 1 - masks[:, list(PAINTED).index("ears")]
    masks[:, list(PAINTED).index("areolae")] *= v_template[:, 1] < joints["neck"][1]
    return masks * skin[:, None], [*PAINTED, "brows", "scalp"]


def read_mask(path: Path, place: np.ndarray) -> np.ndarray:
    """A grey image, 0 to 1, at texture coordinates (v, 2), v up."""
    image = maximum_filter(np.asarray(Image.open(path).convert("L")), 2 * MASK_TEXELS + 1) / 255.0
    height, width = image.shape
    column = np.clip((place[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1 - place[:, 1]) * height).astype(int), 0, height - 1)
    mask = image[row, column]
    mask[mask < 0.1] = 0
    return mask


def brows(vertices: np.ndarray, joints: dict[str, np.ndarray]) -> np.ndarray:
    """Two arches above the eyes."""
    height, thickness, length, sink = BROW
    mask = np.zeros(len(vertices))
    for side in ("left", "right"):
        eye = joints[f"{side}_eye"]
        along = (vertices[:, 0] - eye[0]) / length
        over = np.abs(vertices[:, 1] - (eye[1] + height - sink * along**2))
        arch = np.clip((thickness + SOFT - over) / SOFT, 0, 1) * np.clip((1 - np.abs(along)) * length / SOFT + 1, 0, 1)
        mask = np.maximum(mask, arch * (vertices[:, 2] > eye[2]))
    return mask


def scalp(vertices: np.ndarray, joints: dict[str, np.ndarray]) -> np.ndarray:
    """All of the head above the hair line."""
    line = np.interp(vertices[:, 2] - joints["head"][2], *np.transpose(HAIR_LINE))
    above = vertices[:, 1] - joints["left_eye"][1] - line
    near = (np.abs(vertices[:, 0]) < 0.12) & (vertices[:, 1] > joints["neck"][1])
    return np.clip(above / SOFT + 0.5, 0, 1) * near
