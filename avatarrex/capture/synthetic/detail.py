"""Photographic detail of the subject's colours: what a close photograph shows of skin, cloth and hair beyond flat paint.

Natural pictures have power at every scale. A pile of noise octaves from 64 to 1 mm, each weaker than the one above (1/f),
mottles everything; over it skin has pores, freckles and veins, knit its stitches, denim its diagonal yarns and wear, prints
a raster of 1.5 mm dots and cracks, hair single strands. All is a function of the rest surface point: it sticks to the
surface and is the same from every side.

Letters: p points. Rest pose, metres; colours sRGB-encoded.
"""

from __future__ import annotations

import numpy as np

from avatarrex.capture.synthetic.texture import Masks, mix, step, value_noise

OCTAVES = (0.064, 0.032, 0.016, 0.008, 0.004, 0.002, 0.001)
"""Metres."""


def detailed(solids: np.ndarray, rest: np.ndarray, normal: np.ndarray, masks: Masks, colour: np.ndarray) -> np.ndarray:
    """(p, 3) in [0, 1]: `colour` (p, 3) of points on `solids` (p,) with its detail."""
    result = colour.copy()
    for names, add in DETAILS.items():
        here = np.isin(solids, names)
        if here.any():
            own = {key: value[here] for key, value in masks.items()}
            result[here] = add(rest[here], own, colour[here])
    return np.asarray(np.clip(result, 0, 1))


def octaves(points: np.ndarray, coarsest: float = 1.0, roughness: float = 0.75) -> np.ndarray:
    """(p,) noise of all `OCTAVES` up to `coarsest` metres, each `roughness` times the one above; about ±1."""
    total, height = np.zeros(len(points)), 1.0
    for number, scale in enumerate(OCTAVES):
        if scale <= coarsest:
            total += height * value_noise(points + 0.37 * number, scale)
            height *= roughness
    return total * (1 - roughness)


def cells(points: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Distance (p,) in metres to the nearest of seeds scattered one to a cube of `scale`, and a number in [0, 1) of that seed."""
    cell = np.floor(points / scale).astype(np.int64)
    nearest, number = np.full(len(points), np.inf), np.zeros(len(points))
    for corner in np.ndindex(3, 3, 3):
        at = cell + corner - 1
        random = np.stack([_hash(at, axis) for axis in range(4)], 1)
        away = np.linalg.norm((at + random[:, :3]) * scale - points, axis=1)
        closer = away < nearest
        nearest[closer], number[closer] = away[closer], random[closer, 3]
    return nearest, number


def _hash(cell: np.ndarray, salt: int) -> np.ndarray:
    """(p,) in [0, 1)."""
    c = cell.astype(np.uint64)
    h = (c[:, 0] * np.uint64(73856093)) ^ (c[:, 1] * np.uint64(19349663)) ^ (c[:, 2] * np.uint64(83492791))
    h = (h + np.uint64(2654435761 * (salt + 1))) & np.uint64(0xFFFFFFFF)
    h = ((h ^ (h >> np.uint64(15))) * np.uint64(2246822519)) & np.uint64(0xFFFFFFFF)
    h = ((h ^ (h >> np.uint64(13))) * np.uint64(3266489917)) & np.uint64(0xFFFFFFFF)
    return np.asarray((h ^ (h >> np.uint64(16))).astype(np.float64) / 2.0**32)


def _skin(rest: np.ndarray, masks: Masks, colour: np.ndarray) -> np.ndarray:
    """Blotches of blood and tan, freckles of 2 mm, pores of 0.5 mm, fine creases, veins below."""
    blood = octaves(rest, 0.032)
    colour = colour * (1 + 0.10 * octaves(rest + 3.1)[:, None])
    colour = colour * (1 + np.outer(blood, [0.02, -0.07, -0.06]))
    spot, kind = cells(rest, 0.009)
    freckle = step(0.0006 + 0.0012 * kind - spot, 0.0012) * (kind > 0.45)
    colour = mix(colour, colour * [0.74, 0.62, 0.55], 0.55 * freckle)
    mole, rare = cells(rest, 0.045)
    colour = mix(colour, np.array([0.24, 0.13, 0.10]), step(0.0014 - mole, 0.0008) * (rare > 0.5))
    pore, _ = cells(rest, 0.0016)
    colour = colour * (1 - 0.16 * step(0.00035 - pore, 0.0005))[:, None]
    crease = step(0.05 - np.abs(octaves(rest * [1, 0.5, 1], 0.008)), 0.05)
    colour = colour * (1 - 0.07 * crease)[:, None]
    vein = step(0.03 - np.abs(value_noise(rest, 0.028)), 0.04)
    return np.asarray(colour * (1 - np.outer(0.05 * vein, [1.0, 0.3, 0.1])))


def _cloth(rest: np.ndarray, masks: Masks, colour: np.ndarray) -> np.ndarray:
    """Jersey: courses of stitches, heathered yarn, lint; prints are dots that let the cloth through, with cracks."""
    x, y, z = rest.T
    around = np.hypot(x, z) * np.arctan2(x, z)
    stitch = np.abs(np.sin(np.pi * around / 0.0016)) * np.abs(np.sin(np.pi * y / 0.0013))
    yarn = value_noise(np.stack([around / 8, y, 0 * y], 1), 0.0013)
    tone = 1 + 0.16 * octaves(rest) + 0.13 * (stitch - 0.4) + 0.10 * yarn
    colour = colour * tone[:, None]
    vivid = np.ptp(colour, axis=1) > 0.22
    dot = np.hypot((x + y) % 0.0015 - 0.00075, (x - y) % 0.0015 - 0.00075)
    colour = mix(colour, np.array([0.90, 0.89, 0.85]), 0.22 * step(dot - 0.0007, 0.0004) * vivid)
    crack = step(0.02 - np.abs(octaves(rest + 1.7, 0.016)), 0.015) * vivid
    colour = mix(colour, np.array([0.90, 0.89, 0.85]), 0.6 * crack)
    lint, kind = cells(rest, 0.03)
    return mix(colour, np.array([0.8, 0.8, 0.8]), 0.6 * step(0.0007 - lint, 0.0006) * (kind > 0.6))


def _denim(rest: np.ndarray, masks: Masks, colour: np.ndarray) -> np.ndarray:
    """Twill of dark and bare yarns, slubs along the warp, wear in patches, creases that whitened."""
    x, y, z = rest.T
    around = np.hypot(x - 0.13 * np.sign(x), z) * np.arctan2(x - 0.13 * np.sign(x), z)
    twill = np.sin(2 * np.pi * (around + 1.7 * y) / 0.0021)
    slub = value_noise(np.stack([around, y / 14, 0 * y], 1), 0.0012)
    colour = colour * (1 + 0.11 * twill + 0.17 * slub + 0.20 * octaves(rest))[:, None]
    crease = step(0.045 - np.abs(octaves(rest * [1, 2.2, 1] + 5.3, 0.064)), 0.06)
    faded = np.clip(0.35 * crease * (0.5 + 0.5 * value_noise(rest, 0.05)), 0, 1)
    return mix(colour, np.array([0.62, 0.66, 0.72]), faded)


def _canvas(rest: np.ndarray, masks: Masks, colour: np.ndarray) -> np.ndarray:
    """Shoes: plain weave, dust towards the sole, scuffs."""
    x, y, z = rest.T
    weave = np.sin(2 * np.pi * x / 0.0017) * np.sin(2 * np.pi * (y + z) / 0.0017)
    colour = colour * (1 + 0.10 * weave + 0.16 * octaves(rest))[:, None]
    dust = np.clip((-0.90 - y) / 0.05, 0, 1) * np.clip(0.4 + octaves(rest + 2.2), 0, 1)
    return mix(colour, np.array([0.45, 0.40, 0.33]), 0.45 * dust)


def _hair(rest: np.ndarray, masks: Masks, colour: np.ndarray) -> np.ndarray:
    """Single strands and locks of other tones."""
    x, y, z = rest.T
    along = np.stack([x + 0.25 * z, 0.06 * y, 0.06 * z], 1)
    strand, lock = value_noise(along, 0.0009), value_noise(along, 0.006)
    return colour * (1 + 0.40 * strand + 0.30 * lock + 0.15 * octaves(rest))[:, None]


def _moist(rest: np.ndarray, masks: Masks, colour: np.ndarray) -> np.ndarray:
    """Eyes, teeth and tongue: faint blotches."""
    return colour * (1 + 0.08 * octaves(rest, 0.008))[:, None]


DETAILS = {
    ("body",): _skin, ("shirt", "tunic"): _cloth, ("trousers",): _denim, ("left_shoe", "right_shoe"): _canvas,
    ("hair",): _hair, ("left_eye", "right_eye", "upper_teeth", "lower_teeth", "tongue"): _moist,
}  # fmt: skip
"""By solids."""
