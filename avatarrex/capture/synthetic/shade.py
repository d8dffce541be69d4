"""The studio light of the synthetic capture: fixed in the root frame, so that colour depends on the pose alone.

    c = albedo · (sky + key + fill) · openness · fold       (sRGB-encoded throughout, like a graded photograph)

A hemisphere of sky, a soft key light from the upper left front and a soft fill from the right; soft lights wrap
around the terminator. Ambient occlusion is baked; the valleys of wrinkles are darkened.
"""

from __future__ import annotations

import numpy as np

KEY = np.array([0.36, 0.55, 0.75]) / np.linalg.norm([0.36, 0.55, 0.75])
FILL = np.array([-0.80, 0.15, 0.45]) / np.linalg.norm([-0.80, 0.15, 0.45])
RIM = np.array([0.25, 0.35, -0.90]) / np.linalg.norm([0.25, 0.35, -0.90])
WRAP = 0.35
"""How far round the terminator soft lights reach, as a cosine."""
WARM, COOL = np.array([1.02, 1.0, 0.965]), np.array([0.965, 0.99, 1.03])


def studio_light(albedo: np.ndarray, normal: np.ndarray, openness: np.ndarray, wrinkle: np.ndarray) -> np.ndarray:
    """(p, 3) in [0, 1] from unlit colour, unit normal, openness in [0, 1] and fold height (metres)."""
    sky = 0.5 + 0.5 * normal[:, 1:2]
    light = (0.42 + 0.18 * sky) * COOL + 0.42 * _soft(normal, KEY) * WARM + 0.16 * _soft(normal, FILL) * COOL
    light = light + 0.20 * _soft(normal, RIM) * WARM
    shadow = 0.42 + 0.58 * np.clip(openness, 0, 1)
    fold = 1 + 0.16 * np.tanh(wrinkle / 0.003)
    return np.asarray(np.clip(albedo * light * (shadow * fold)[:, None] * 1.06, 0, 1))


def _soft(normal: np.ndarray, direction: np.ndarray, wrap: float = WRAP) -> np.ndarray:
    """(p, 1) in [0, 1]: a light as wide as `wrap` allows, smooth at its end."""
    lit = np.clip((normal @ direction + wrap) / (1 + wrap), 0, 1)[:, None]
    return np.asarray(lit * lit * (3 - 2 * lit) * 0.5 + lit * 0.5)
