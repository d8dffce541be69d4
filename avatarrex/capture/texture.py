"""Procedural colours of the clothed subject: sharp functions of the T-pose surface point, never a bitmap.

`colour(solid, rest, masks)`: (p, 3) sRGB-encoded albedo in [0, 1] of points at T-pose positions `rest` (p, 3), metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SKIN = np.array([0.80, 0.61, 0.51])
LIPS = np.array([0.69, 0.37, 0.36])
BROW = np.array([0.25, 0.17, 0.13])
HAIR = np.array([0.24, 0.16, 0.11])


def step(edge: float, value: np.ndarray, width: float = 0.0008) -> np.ndarray:
    """0 below `edge`, 1 above, over `width` metres."""
    return np.clip((value - edge) / width + 0.5, 0, 1)


def mix(base: np.ndarray, over: np.ndarray, amount: np.ndarray) -> np.ndarray:
    """`over` laid on `base` by `amount` (p,)."""
    return base + (over - base) * amount[:, None]


def value_noise(p: np.ndarray, scale: float) -> np.ndarray:
    """Smooth noise in [−1, 1] with features of `scale` metres, (p,)."""
    q = p / scale
    cell = np.floor(q).astype(np.int64)
    t = q - cell
    t = t * t * (3 - 2 * t)
    total = np.zeros(len(p))
    for corner in np.ndindex(2, 2, 2):
        c = cell + corner
        h = (c[:, 0] * 73856093) ^ (c[:, 1] * 19349663) ^ (c[:, 2] * 83492791)
        h = (h ^ (h >> 13)) * 1274126177 % 4294967296
        weight = np.prod(np.where(corner, t, 1 - t), axis=1)
        total += weight * (h / 2147483648.0 - 1)
    return total


def shirt(rest: np.ndarray, masks: dict[str, np.ndarray]) -> np.ndarray:
    """White jersey with navy stripes and a printed badge: a ring with a star, on the chest and a number on the back."""
    x, y, z = rest.T
    colour = np.tile(np.array([0.93, 0.92, 0.89]), (len(rest), 1))
    torso = np.abs(x) < 0.235
    along = np.where(torso, y, np.abs(x))
    phase = (along / 0.044) % 1.0
    stripe = step(0.0, (0.22 - np.abs(phase - 0.5)) * 0.044)
    colour = mix(colour, np.array([0.13, 0.2, 0.38]), stripe)
    front = (z > 0.02) & torso
    u, v = x, y - 0.325
    radius = np.hypot(u, v)
    plate = front * step(0.0, 0.086 - radius)
    colour = mix(colour, np.array([0.95, 0.94, 0.9]), plate)
    ring = front * step(0.0, 0.009 - np.abs(radius - 0.072))
    colour = mix(colour, np.array([0.85, 0.27, 0.16]), ring)
    angle = np.arctan2(u, v)
    spoke = np.abs(((angle / (2 * np.pi / 5) + 0.5) % 1) - 0.5) * 2
    star = front * step(0.0, 0.052 - 0.032 * spoke - radius)
    colour = mix(colour, np.array([0.92, 0.62, 0.12]), star)
    back = (z < -0.02) & torso
    bar = ((np.abs(u) < 0.055) & (np.abs(np.abs(v + 0.02) - 0.05) < 0.012)) | ((np.abs(u - 0.043) < 0.012) & (np.abs(v + 0.02) < 0.06))
    colour = mix(colour, np.array([0.85, 0.27, 0.16]), (back & bar).astype(float))
    hem = np.maximum(step(0.385, np.abs(x)), step(0.0, -0.075 - y))
    return mix(colour, np.array([0.13, 0.2, 0.38]), hem)


def trousers(rest: np.ndarray, masks: dict[str, np.ndarray]) -> np.ndarray:
    """Denim: fine weave, side seams, pockets, lighter thighs."""
    x, y, z = rest.T
    fade = 0.5 + 0.5 * value_noise(rest, 0.05)
    colour = np.array([0.2, 0.27, 0.4]) * (0.9 + 0.2 * fade[:, None])
    thigh = np.exp(-(((y + 0.28) / 0.16) ** 2)) * step(0.02, z, 0.06)
    colour = mix(colour, np.array([0.38, 0.46, 0.6]), 0.5 * thigh)
    leg = np.abs(x) - 0.095 + 0.03 * np.clip(-y, 0, 1)
    seam = step(0.0, 0.0022 - np.abs(z + 0.012)) * (leg > 0.02)
    pocket = step(0.0, 0.0022 - np.abs(np.hypot(np.abs(x) - 0.16, y - 0.02) - 0.085)) * (z > 0.02) * (y < 0.03)
    patch = (np.abs(np.abs(x) - 0.085) < 0.052) & (np.abs(y + 0.075) < 0.058) & (z < -0.03)
    inner = (np.abs(np.abs(x) - 0.085) < 0.049) & (np.abs(y + 0.075) < 0.055)
    colour = mix(colour, np.array([0.78, 0.6, 0.33]), np.maximum(seam, pocket))
    return mix(colour, np.array([0.78, 0.6, 0.33]), (patch & ~inner).astype(float))


def shoes(rest: np.ndarray, masks: dict[str, np.ndarray]) -> np.ndarray:
    """Dark canvas, white sole, toe cap and laces."""
    x, y, z = rest.T
    ground = y.min()
    colour = np.tile(np.array([0.66, 0.16, 0.15]), (len(rest), 1))
    lace = step(0.0, 0.25 - np.abs(((z / 0.018) % 1) - 0.5), 0.1) * (z > 0.0) * (z < 0.1) * (y > ground + 0.055)
    colour = mix(colour, np.array([0.93, 0.93, 0.9]), lace)
    white = np.maximum(step(0.0, ground + 0.03 - y), step(0.135, z) * step(0.0, ground + 0.06 - y))
    return mix(colour, np.array([0.93, 0.93, 0.9]), white)


def hair(rest: np.ndarray, masks: dict[str, np.ndarray]) -> np.ndarray:
    """Brown, in strands that run back from the forehead."""
    x, y, z = rest.T
    strand = value_noise(np.column_stack([x / 0.0035, (z + 0.4 * y) / 0.03, np.zeros(len(x))]), 1.0)
    lock = value_noise(np.column_stack([x / 0.012, z / 0.05, y / 0.05]), 1.0)
    return np.clip(HAIR * (1 + 0.3 * strand + 0.3 * lock)[:, None], 0, 1)


def skin(rest: np.ndarray, masks: dict[str, np.ndarray]) -> np.ndarray:
    """Skin with cheeks, lips, brows, nails, and a mouth that is dark inside."""
    x, y, z = rest.T
    tone = 1 + 0.03 * value_noise(rest, 0.02) + 0.02 * value_noise(rest, 0.005)
    colour = SKIN * tone[:, None]
    cheek = np.exp(-(((np.abs(x) - 0.042) / 0.016) ** 2) - ((y - 0.683) / 0.017) ** 2) * (z > 0.08)
    colour = mix(colour, np.array([0.83, 0.5, 0.44]), 0.45 * cheek)
    nose = np.exp(-((x / 0.012) ** 2) - ((y - 0.69) / 0.01) ** 2) * (z > 0.14)
    colour = mix(colour, np.array([0.82, 0.52, 0.45]), 0.35 * nose)
    beard = np.exp(-((y - 0.63) ** 2) / 0.03**2) * (z > 0.05)
    colour = mix(colour, np.array([0.7, 0.55, 0.48]), 0.12 * beard)
    lid = np.exp(-(((np.abs(x) - 0.031) / 0.018) ** 2) - ((y - 0.735) / 0.007) ** 2) * (z > 0.09)
    colour = mix(colour, np.array([0.66, 0.46, 0.4]), 0.5 * lid)
    colour = mix(colour, LIPS, masks["lips"])
    s = np.clip((np.abs(x) - 0.014) / 0.041, 0, 1)
    arch = 0.7545 + 0.006 * np.sin(np.pi * np.clip(s * 0.85, 0, 1)) - 0.004 * s * s
    thick = 0.0036 * (1 - 0.55 * s)
    brow = step(0.0, thick - np.abs(y - arch), 0.0012) * step(0.012, np.abs(x), 0.002) * (1 - step(0.054, np.abs(x), 0.003))
    hairs = 0.8 + 0.2 * value_noise(np.column_stack([(x + np.sign(x) * y) / 0.0015, y / 0.006, z * 0]), 1.0)
    colour = mix(colour, BROW, brow * hairs * (z > 0.08))
    colour = mix(colour, np.array([0.3, 0.11, 0.1]), masks["mouth"])
    return mix(colour, np.array([0.88, 0.7, 0.64]), masks["nails"])


def eye(rest: np.ndarray, masks: dict[str, np.ndarray]) -> np.ndarray:
    """White, iris with spokes, dark rim, pupil. `rest` is relative to the eyeball's centre, unit length."""
    x, y, z = rest.T
    radius = np.arctan2(np.hypot(x, y), z)
    colour = np.tile(np.array([0.92, 0.91, 0.9]), (len(rest), 1))
    spokes = 0.85 + 0.15 * np.sin(24 * np.arctan2(y, x))
    iris = np.array([0.25, 0.38, 0.42]) * spokes[:, None]
    colour = np.where((radius < 0.43)[:, None], iris, colour)
    colour = np.where((np.abs(radius - 0.43) < 0.05)[:, None], np.array([0.12, 0.15, 0.17]), colour)
    return np.where((radius < 0.18)[:, None], np.array([0.03, 0.03, 0.03]), colour)


def tongue(rest: np.ndarray, masks: dict[str, np.ndarray]) -> np.ndarray:
    """Plain."""
    return np.tile(np.array([0.68, 0.34, 0.34]), (len(rest), 1))


def teeth(rest: np.ndarray, masks: dict[str, np.ndarray]) -> np.ndarray:
    """White with dark gaps every 8 mm along the arch."""
    gap = step(0.0, 0.0009 - np.abs(((np.arctan2(rest[:, 0], rest[:, 2] - 0.09) * 0.036 / 0.008) % 1) - 0.5) * 0.008)
    return mix(np.tile(np.array([0.9, 0.88, 0.82]), (len(rest), 1)), np.array([0.6, 0.5, 0.45]), 0.6 * gap)


TEXTURES: dict[str, Callable[[np.ndarray, dict[str, np.ndarray]], np.ndarray]] = {
    "shirt": shirt, "trousers": trousers, "left_shoe": shoes, "right_shoe": shoes, "hair": hair, "body": skin,
    "left_eye": eye, "right_eye": eye, "tongue": tongue, "upper_teeth": teeth, "lower_teeth": teeth,
}  # fmt: skip
