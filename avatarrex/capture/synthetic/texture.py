"""Procedural colours of the clothed subject: sharp functions of the rest surface point, never a bitmap.

Each solid's function takes rest positions (p, 3) in metres, rest normals (p, 3) and the named masks (p,) of
`Subject.masks`, and returns unlit sRGB-encoded colour (p, 3). Edges are a millimetre wide: what a colour network must
learn. The places (eyes at y = 0.724, mouth at 0.653, …) are those of the default person, which the packaged subject
names by its hash.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

Masks = dict[str, np.ndarray]
Texture = Callable[[np.ndarray, np.ndarray, Masks], np.ndarray]

SKIN, BLUSH, LIPS, GUM = np.array([[0.845, 0.660, 0.555], [0.82, 0.47, 0.41], [0.72, 0.38, 0.37], [0.46, 0.17, 0.17]])
LASH, BROW, HAIR = np.array([[0.15, 0.10, 0.09], [0.26, 0.175, 0.125], [0.30, 0.195, 0.125]])
NAVY, ECRU, RED = np.array([[0.13, 0.19, 0.36], [0.93, 0.915, 0.87], [0.84, 0.26, 0.17]])
YELLOW, TEAL = np.array([[0.96, 0.70, 0.20], [0.13, 0.47, 0.50]])
WINE, GOLD = np.array([[0.47, 0.115, 0.17], [0.86, 0.68, 0.33]])
DENIM, THREAD = np.array([[0.235, 0.305, 0.43], [0.80, 0.60, 0.33]])


def albedo(solids: Sequence[str], rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """(p, 3) unlit colour in [0, 1] of points on the named `solids`."""
    colour = np.zeros_like(rest)
    names = np.asarray(solids)
    for name in np.unique(names):
        here = names == name
        own = {key: value[here] for key, value in masks.items()}
        colour[here] = TEXTURES[str(name)](rest[here], normal[here], own)
    return np.asarray(np.clip(colour, 0, 1))


def step(value: np.ndarray, width: float = 0.0009) -> np.ndarray:
    """0 below zero, 1 above, over `width` metres, smooth."""
    t = np.clip(value / width + 0.5, 0, 1)
    return t * t * (3 - 2 * t)


def line(distance: np.ndarray, half: float, width: float = 0.0009) -> np.ndarray:
    """1 within `half` metres of distance 0, 0 beyond."""
    return step(half - np.abs(distance), width)


def mix(base: np.ndarray, over: np.ndarray | tuple[float, float, float], amount: np.ndarray) -> np.ndarray:
    """`over` laid on `base` by `amount` (p,)."""
    return np.asarray(base + (over - base) * amount[:, None])


def value_noise(points: np.ndarray, scale: float) -> np.ndarray:
    """Smooth noise (p,) in [−1, 1] with features of `scale` metres."""
    q = points / scale
    cell = np.floor(q).astype(np.int64)
    t = q - cell
    t = t * t * (3 - 2 * t)
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        c = (cell + corner).astype(np.uint64)
        h = (c[:, 0] * np.uint64(73856093)) ^ (c[:, 1] * np.uint64(19349663)) ^ (c[:, 2] * np.uint64(83492791))
        h = ((h ^ (h >> np.uint64(13))) * np.uint64(1274126177)) & np.uint64(0xFFFFFFFF)
        total += np.prod(np.where(corner, t, 1 - t), axis=1) * (h.astype(np.float64) / 2147483647.5 - 1)
    return total


def shirt(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Ecru jersey, navy stripes below a plain yoke, a sun-and-hills badge, ribbed collar, stitched hems."""
    x, y, z = rest.T
    knit = 1 + 0.02 * np.sin(2 * np.pi * x / 0.0035) + 0.025 * value_noise(rest, 0.015)
    colour = ECRU * knit[:, None]
    armhole = np.where(y > 0.34, np.abs(x) - 0.205 - 0.10 * (y - 0.45), -1.0)
    sleeve = step(armhole)
    body_stripe = step(0.0075 - np.abs((y + 0.5) % 0.038 - 0.019)) * step(0.425 - y)
    sleeve_stripe = step(0.0065 - np.abs((np.abs(x) + 0.004) % 0.034 - 0.017))
    colour = mix(colour, NAVY * knit[:, None], body_stripe * (1 - sleeve) + sleeve_stripe * sleeve)
    seam = step(0.0011 - np.abs(armhole))
    colour = mix(colour, 0.8 * ECRU, seam)
    colour = _badge(colour, x, y - 0.318, (z > 0.02) & (np.abs(x) < 0.15))
    colour = _number(colour, x, y - 0.30, (z < -0.02) & (np.abs(x) < 0.15))
    edge = masks["edge"]
    collar = (y > 0.44) & (np.abs(x) < 0.17)
    rib = 0.92 + 0.08 * np.sign(np.sin(np.arctan2(x, z - 0.01) * 110))
    colour = mix(colour, NAVY * rib[:, None], step(0.017 - edge) * collar)
    stitch = step(0.0010 - np.abs(edge - 0.020)) + step(0.0010 - np.abs(edge - 0.024))
    return mix(colour, 0.62 * ECRU, np.clip(stitch, 0, 1) * ~collar * 0.8)


def _badge(colour: np.ndarray, x: np.ndarray, y: np.ndarray, on: np.ndarray) -> np.ndarray:
    """A round print of 15 cm about (0, 0): sun over two hills inside a red ring."""
    radius = np.hypot(x, y)
    colour = mix(colour, (0.97, 0.96, 0.93), step(0.078 - radius) * on)
    sky = step(0.060 - radius) * on
    colour = mix(colour, (0.62, 0.80, 0.86), sky)
    colour = mix(colour, YELLOW, step(0.020 - np.hypot(x - 0.018, y - 0.020)) * sky)
    hill = 0.012 - 0.75 * np.abs(x + 0.018)
    colour = mix(colour, TEAL, step(hill - y) * sky)
    colour = mix(colour, (0.95, 0.96, 0.95), step(hill - y) * step(y + 0.004 + 0.004 * np.cos(x * 600)) * sky)
    colour = mix(colour, 0.62 * TEAL, step(-0.010 - 0.55 * np.abs(x - 0.030) - y) * sky)
    ring = step(0.0055 - np.abs(radius - 0.0685)) * on
    return mix(colour, RED, ring)


def _number(colour: np.ndarray, x: np.ndarray, y: np.ndarray, on: np.ndarray) -> np.ndarray:
    """A red 7 on a plain field, readable from the back."""
    u = -x
    field = step(0.062 - np.maximum(np.abs(u) * 1.15, np.abs(y) * 0.80))
    colour = mix(colour, (0.97, 0.96, 0.93), field * on)
    bar = step(0.040 - np.abs(u)) * step(0.009 - np.abs(y - 0.048))
    slope = (u - 0.031) - 0.42 * (y - 0.048)
    leg = step(0.0095 - np.abs(slope)) * step(0.057 - y) * step(y + 0.057)
    return mix(colour, RED, np.maximum(bar, leg) * on)


def tunic(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Wine-red linen, woven diamonds, a buttoned placket, gold bands with a zigzag along hem and cuffs, dark inside."""
    x, y, z = rest.T
    warp, weft = np.sin(2 * np.pi * y / 0.0036), np.sin(2 * np.pi * (x + z) / 0.0036)
    slub = 1 + 0.03 * warp * weft + 0.06 * value_noise(rest, 0.012)
    colour = WINE * slub[:, None]
    sleeve = (np.abs(x) > 0.24) & (y > 0.30)
    along = np.where(sleeve, np.abs(x), y)
    around = np.where(sleeve, 0.075 * np.arctan2(y - 0.455, z - 0.01), 0.19 * np.arctan2(x, z))
    row = np.floor(along / 0.060)
    u = (around + 0.030 * (row % 2)) % 0.060 - 0.030
    v = along % 0.060 - 0.030
    diamond = np.abs(u) * 1.2 + np.abs(v)
    edge = masks["edge"]
    field = step(edge - 0.075)
    colour = mix(colour, 1.35 * WINE * slub[:, None], step(0.017 - diamond) * field)
    colour = mix(colour, GOLD, step(0.0014 - np.abs(diamond - 0.017)) * field * 0.85)
    colour = mix(colour, GOLD, step(0.005 - diamond) * field * 0.85)
    neck = (y > 0.44) & (np.abs(x) < 0.17)
    zigzag = 0.041 + 0.009 * (np.abs((around / 0.018) % 2 - 1) * 2 - 1)
    band = line(edge - 0.024, 0.0014) + line(edge - 0.058, 0.0014) + line(edge - zigzag, 0.0026)
    ground = step(0.0165 - np.abs(edge - 0.041))
    hemmed = (np.abs(x) > 0.30) | (y < 0.0)
    colour = mix(colour, 0.55 * WINE * slub[:, None], ground * hemmed)
    colour = mix(colour, GOLD * slub[:, None], np.clip(band, 0, 1) * hemmed)
    colour = mix(colour, 0.35 * WINE * slub[:, None], step(0.0004 - edge, 0.0008) * hemmed)
    rib = 0.9 + 0.1 * np.sign(np.sin(np.arctan2(x, z - 0.01) * 90))
    colour = mix(colour, GOLD * rib[:, None], step(0.014 - edge) * neck)
    front = (z > 0.03) & (y > 0.14) & ~(neck & (edge < 0.014))
    colour = mix(colour, 0.72 * WINE * slub[:, None], step(0.019 - np.abs(x)) * front)
    colour = mix(colour, GOLD, step(0.0012 - np.abs(np.abs(x) - 0.017)) * front)
    button = np.hypot(x, (y + 0.002) % 0.055 - 0.0275)
    colour = mix(colour, (0.95, 0.91, 0.80), step(0.0065 - button) * front)
    return mix(colour, 0.45 * WINE, step(0.0015 - np.abs(button - 0.0066)) * front)


def trousers(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Denim: twill, faded thighs and knees, seams with thread, front and patch pockets, fly."""
    x, y, z = rest.T
    twill = 1 + 0.05 * np.sin(2 * np.pi * (x + y + 0.5 * z) / 0.0030) + 0.07 * value_noise(rest, 0.02)
    fade = np.exp(-(((y + 0.27) / 0.15) ** 2)) * np.clip(normal[:, 2], 0, 1) ** 1.5
    knee = np.exp(-(((y + 0.44) / 0.05) ** 2)) * np.clip(normal[:, 2], 0, 1) ** 2
    light = np.array([0.46, 0.545, 0.66]) * twill[:, None]
    colour = mix(DENIM * twill[:, None], light, np.clip(0.5 * fade + 0.3 * knee, 0, 0.75))
    middle = 0.115 - 0.061 * (y + 0.01)
    outward, depth = np.abs(x) - middle, z + 0.008 + 0.042 * (y + 0.01)
    seam_line = np.abs(depth) * (y > -2)
    sides = (np.abs(outward) > 0.035) & (y < 0.08)
    colour = mix(colour, 0.55 * DENIM, step(0.0016 - seam_line) * sides)
    dashes = step(0.0018 - np.abs(y % 0.0056 - 0.0028), 0.0006)
    colour = mix(colour, THREAD, step(0.0008 - np.abs(seam_line - 0.0045)) * sides * dashes)
    front = normal[:, 2] > 0.1
    centre = step(0.0014 - np.abs(x)) * (y > -0.112)
    colour = mix(colour, 0.5 * DENIM, centre)
    back = normal[:, 2] < -0.1
    u, w = np.abs(x) - 0.088, y + 0.055
    patch = np.maximum(np.abs(u) - 0.052, np.maximum(np.abs(w) - 0.060, -w - 0.045 + 0.25 * (0.06 - np.abs(u)) - 0.012))
    colour = mix(colour, DENIM * 1.12 * twill[:, None], step(-patch) * back)
    colour = mix(colour, THREAD, (step(0.0009 - np.abs(patch + 0.001)) + step(0.0009 - np.abs(patch + 0.006))) * back)
    slant = (np.abs(x) - 0.118) * 0.8 - (y + 0.105) * 0.6 + 0.03
    pocket = front & (np.abs(x) > 0.105) & (y > -0.16)
    colour = mix(colour, THREAD, (step(0.0009 - np.abs(slant)) + step(0.0009 - np.abs(slant - 0.005))) * pocket)
    edge = masks["edge"]
    colour = mix(colour, THREAD, step(0.0010 - np.abs(edge - 0.016)) * dashes * (y < -0.5))
    return mix(colour, 0.6 * DENIM, step(0.0025 - edge, 0.003))


def shoe(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Red canvas, white sole with a navy line, rubber toe cap, laces on a tongue."""
    x, y, z = rest.T
    side = np.sign(x)
    warp, weft = np.sin(2 * np.pi * x / 0.0024), np.sin(2 * np.pi * (y + z) / 0.0024)
    weave = 1 + 0.04 * warp * weft + 0.04 * value_noise(rest, 0.01)
    colour = np.array([0.70, 0.17, 0.15]) * weave[:, None]
    across = (side * x - 0.158) - 0.22 * (z - 0.05)
    tongue = step(0.019 - np.abs(across), 0.0015) * (z > 0.005) * (normal[:, 1] > 0.1)
    reach = step(0.098 - z) * (z > 0.005)
    colour = mix(colour, (0.58, 0.13, 0.12), tongue * reach)
    row = np.abs((z - 0.35 * np.abs(across)) % 0.017 - 0.0085)
    lace = step(0.0030 - row) * step(0.026 - np.abs(across)) * reach * (z > 0.018) * (normal[:, 1] > 0.1)
    colour = mix(colour, (0.95, 0.94, 0.90), lace)
    eyelet = step(0.0024 - np.hypot(np.abs(across) - 0.027, row)) * reach * (z > 0.018) * (normal[:, 1] > 0.1)
    colour = mix(colour, (0.75, 0.74, 0.72), eyelet)
    stitch = step(0.0008 - np.abs(np.hypot(across, (z - 0.02)) - 0.068)) * (z > 0)
    colour = mix(colour, (0.93, 0.85, 0.8), stitch)
    white = np.array([0.93, 0.925, 0.90])
    cap = step(z - 0.118 + 6.0 * across**2) * step(-0.895 - y)
    colour = mix(colour, white, cap)
    floor = -0.945 + 0.010 * np.clip((z - 0.12) / 0.05, 0, 1) ** 2
    colour = mix(colour, white, step(0.0155 - (y - floor)))
    line = step(0.0016 - np.abs(y - floor - 0.0085))
    colour = mix(colour, NAVY, line)
    return mix(colour, (0.55, 0.42, 0.30), step(-0.0165 - (y - floor)))


def hair(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Brown strands combed back and to the side, darker in the grooves between locks."""
    x, y, z = rest.T
    flow = np.column_stack([x + 0.25 * z, 0.10 * y, 0.10 * z])
    strand = value_noise(flow, 0.0022) + 0.6 * value_noise(flow * [1.7, 1, 1], 0.0022)
    comb = np.column_stack([x + 0.25 * z, 0.22 * y, 0.22 * z])
    lock = np.abs(value_noise(comb, 0.011))
    gloss = np.exp(-(((y - 0.800) / 0.016) ** 2)) * np.clip(normal[:, 1], 0, 1)
    tone = 0.74 + 0.22 * strand + 0.75 * lock
    return mix(HAIR * tone[:, None], np.array([0.52, 0.37, 0.25]), 0.35 * gloss * np.clip(0.5 + strand, 0, 1))


def skin(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Skin of body and face: mottling, cheeks, nose, lids, lips, brows, nails; socks; gums inside the mouth."""
    x, y, z = rest.T
    a = np.abs(x)
    mottle = 0.020 * value_noise(rest, 0.03) + 0.018 * value_noise(rest, 0.006) + 0.014 * value_noise(rest, 0.0021)
    colour = SKIN * (1 + mottle)[:, None]
    head = z > 0.035
    colour = mix(colour, BLUSH, 0.34 * np.exp(-(((a - 0.045) / 0.017) ** 2) - ((y - 0.690) / 0.016) ** 2) * head)
    colour = mix(colour, BLUSH, 0.30 * np.exp(-((x / 0.014) ** 2) - ((y - 0.688) / 0.011) ** 2) * (z > 0.12))
    colour = mix(colour, BLUSH, 0.30 * np.exp(-(((a - 0.088) / 0.012) ** 2) - ((y - 0.70) / 0.03) ** 2) * (y > 0.6))
    stubble = np.clip(value_noise(rest, 0.0016), 0, 1) * np.exp(-(((y - 0.632) / 0.022) ** 2))
    stubble = stubble * step(masks["lip"] - 0.010, 0.01)
    colour = mix(colour, (0.52, 0.42, 0.37), 0.22 * stubble * head * (a < 0.06))
    colour = _eyes(colour, a, y, z, masks["lid"])
    colour = _mouth(colour, rest, masks["lip"])
    colour = _brows(colour, rest, head)
    colour = _hands(colour, rest, normal, masks)
    sock = step(-0.800 - y)
    rib = 0.95 + 0.05 * np.sin(np.arctan2(a - 0.165, z + 0.045) * 40)
    return mix(colour, np.array([0.90, 0.89, 0.87]) * rib[:, None], sock)


def _eyes(colour: np.ndarray, a: np.ndarray, y: np.ndarray, z: np.ndarray, lid: np.ndarray) -> np.ndarray:
    """Shadowed lids, a lash line on the rim (heavier above), dark red inside the socket."""
    near = np.clip(1 - np.abs(lid) / 0.012, 0, 1) * (z > 0.09)
    upper = step(y - 0.7225 - 0.10 * (a - 0.031), 0.002)
    colour = mix(colour, (0.70, 0.47, 0.40), near**1.5 * (0.30 + 0.25 * upper))
    crease = step(0.0008 - np.abs(lid - 0.0058), 0.001) * upper * (z > 0.09)
    colour = mix(colour, (0.55, 0.35, 0.29), 0.5 * crease)
    socket = step(-0.0014 - lid, 0.001)
    colour = mix(colour, (0.62, 0.36, 0.33), socket)
    thick = 0.0007 + 0.0009 * upper
    lash = step(thick - np.abs(lid - 0.4 * thick), 0.0007) * (z > 0.09)
    return mix(colour, LASH, lash * (0.55 + 0.4 * upper))


def _mouth(colour: np.ndarray, rest: np.ndarray, lip: np.ndarray) -> np.ndarray:
    """Lips by their distance from the mouth's rim: a cupid's bow above, fuller below; gums within."""
    x, y, z = rest.T
    a = np.abs(x)
    taper = np.sqrt(np.clip(1 - (a / 0.0265) ** 2, 0, 1))
    bow = 0.0090 + 0.0014 * np.exp(-(((a - 0.006) / 0.004) ** 2)) - 0.0010 * np.exp(-((x / 0.0028) ** 2))
    above = y > 0.6530
    width = np.where(above, bow, 0.0098) * taper
    red = step(width - lip, 0.0014) * (z > 0.11)
    grain = 1 + 0.06 * np.sin(2 * np.pi * x / 0.0019 + 2 * value_noise(rest, 0.004)) * np.exp(-((lip / 0.006) ** 2))
    tone = np.where(above, 0.90, 1.03) * grain
    colour = mix(colour, LIPS * tone[:, None], 0.88 * red)
    colour = mix(colour, (0.42, 0.18, 0.18), 0.7 * step(0.0007 - np.abs(lip), 0.0009) * (z > 0.10))
    return mix(colour, GUM, step(-0.0030 - lip, 0.003) * np.clip((0.02 - lip) / 0.02, 0, 1) * (lip < 0))


def _brows(colour: np.ndarray, rest: np.ndarray, head: np.ndarray) -> np.ndarray:
    """Two arched brows of slanted hairs, thinning outwards."""
    x, y, _ = rest.T
    a = np.abs(x)
    s = (a - 0.013) / 0.037
    inside = np.clip(s, 0, 1)
    arch = 0.7430 + 0.0075 * np.sin(np.pi * np.clip(0.15 + 0.72 * inside, 0, 1)) - 0.0065 * inside**2
    half = 0.0043 * (1 - 0.72 * inside**1.4) * np.clip((s + 0.05) / 0.15, 0, 1) * np.clip((1.06 - s) / 0.12, 0, 1)
    hairs = value_noise(np.column_stack([(a - 0.75 * (y - arch)) / 1.0, 0.12 * y, 0 * y]), 0.0007)
    cover = step(half - np.abs(y - arch) + 0.0009 * hairs, 0.0022) * (half > 0)
    return mix(colour, BROW, cover * (0.82 + 0.10 * hairs) * head)


def _hands(colour: np.ndarray, rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Paler palms, reddish knuckles, and nails with a free edge."""
    a = np.abs(rest[:, 0])
    hand = step(a - 0.700, 0.03)
    colour = mix(colour, (0.88, 0.68, 0.60), 0.35 * hand * np.clip(-normal[:, 1], 0, 1))
    crease = step(0.10 - np.abs(value_noise(rest * [0.6, 0.1, 1.0], 0.016)), 0.08) * np.clip(-normal[:, 1] - 0.3, 0, 1)
    colour = mix(colour, (0.70, 0.48, 0.42), 0.35 * crease * step(a - 0.715, 0.02) * step(0.80 - a, 0.01))
    u, v = masks["nail_u"], masks["nail_v"]
    nail = step(1 - np.abs(u) ** 2.6 - np.abs(v) ** 2.6, 0.25)
    colour = mix(colour, (0.90, 0.69, 0.64), nail * 0.9)
    colour = mix(colour, (0.95, 0.90, 0.86), nail * step(u - 0.62 + 0.25 * v**2, 0.15))
    return mix(colour, (0.93, 0.80, 0.75), nail * step(-0.62 - u - 0.3 * v**2, 0.2) * 0.7)


def eye(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """White with veins, iris with spokes and a dark rim, pupil; measured as angles about the forward axis."""
    centre = np.column_stack([0.0305 * np.sign(rest[:, 0]), np.full(len(rest), 0.7238), np.full(len(rest), 0.1140)])
    d = rest - centre
    x, y, z = (d / np.linalg.norm(d, axis=1, keepdims=True)).T
    radius, turn = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    vein = line(value_noise(np.column_stack([turn * 3, radius, 0 * turn]), 0.35), 0.05, 0.05)
    vein = vein * np.clip(radius - 0.7, 0, 1)
    colour = mix(np.tile(np.array([0.935, 0.92, 0.905]), (len(rest), 1)), np.array([0.80, 0.45, 0.42]), 0.5 * vein)
    colour = mix(colour, (0.88, 0.72, 0.68), np.clip((radius - 0.9) * 1.2, 0, 0.6))
    spokes = 0.5 + 0.3 * np.sin(31 * turn + 2 * np.sin(7 * turn)) + 0.2 * np.sin(53 * turn)
    iris = np.array([0.20, 0.34, 0.40]) + np.outer(spokes, np.array([0.14, 0.20, 0.20]))
    iris = mix(iris, (0.50, 0.38, 0.20), 0.55 * np.clip(1 - np.abs(radius - 0.22) / 0.12, 0, 1))
    colour = mix(colour, iris, step(0.44 - radius, 0.05))
    colour = mix(colour, (0.08, 0.12, 0.15), 0.9 * np.clip(1 - np.abs(radius - 0.44) / 0.07, 0, 1))
    colour = mix(colour, (0.02, 0.02, 0.02), step(0.19 - radius, 0.04))
    glint = step(0.085 - np.hypot(x - 0.14, y - 0.20), 0.04)
    return mix(colour, (1.0, 1.0, 1.0), 0.9 * glint)


def tongue(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Rose with a groove and papillae."""
    groove = np.exp(-((rest[:, 0] / 0.002) ** 2)) * np.clip(normal[:, 1], 0, 1)
    tone = 1 + 0.08 * value_noise(rest, 0.0012)
    return mix(np.array([0.74, 0.40, 0.40]) * tone[:, None], np.array([0.52, 0.24, 0.25]), 0.6 * groove)


def teeth(rest: np.ndarray, normal: np.ndarray, masks: Masks) -> np.ndarray:
    """Ivory, with dark gaps every 7.6 mm along the arch."""
    along = np.arctan2(rest[:, 0], rest[:, 2] - 0.095) * 0.036
    gap = step(0.0005 - np.abs(along % 0.0076 - 0.0038), 0.0008)
    return mix(np.tile(np.array([0.93, 0.90, 0.83]), (len(rest), 1)), np.array([0.55, 0.42, 0.37]), 0.7 * gap)


TEXTURES: dict[str, Texture] = {
    "body": skin, "shirt": shirt, "tunic": tunic, "trousers": trousers, "left_shoe": shoe, "right_shoe": shoe, "hair": hair,
    "left_eye": eye, "right_eye": eye, "upper_teeth": teeth, "lower_teeth": teeth, "tongue": tongue,
}  # fmt: skip
