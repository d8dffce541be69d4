"""iFacialMocap's datagrams (UDP 49983): text, a frame each.

    mouthSmile_R-12|…|=head#x,y,z,px,py,pz|rightEye#x,y,z|leftEye#x,y,z|        (or & in place of -)

Coefficients in percent, `_L` and `_R` for Left and Right; Euler angles in degrees for Unity (about z, then x, then y).
"""

from __future__ import annotations

import re

import numpy as np
from avatarrex_studio.live.received import APPLE, Received, finite, from_unity
from scipy.spatial.transform import Rotation

HELLO = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719|sendDataVersion=v2"
"""What the phone waits for before it sends, at the same port."""
_ENTRY = re.compile(r"([A-Za-z]+(?:_[LR])?)[-&](-?[\d.]+)")
_SIDES = {"L": "Left", "R": "Right"}


def decode(data: bytes) -> Received:
    """What a datagram says. Raises `ValueError` for anything else."""
    text = data.decode("ascii")
    shapes, _, bones = text.partition("=")
    weights: dict[str, float] = {}
    for entry in filter(None, shapes.split("|")):
        match = _ENTRY.fullmatch(entry)
        if match is None:
            raise ValueError("name-number expected")
        stem, _, side = match[1].partition("_")
        name = APPLE.get((stem + _SIDES.get(side, "")).lower())
        if name:
            weights[name] = float(finite(np.array([float(match[2])]), 1000.0)[0]) / 100
    head = None
    for entry in filter(None, bones.split("|")):
        bone, _, numbers = entry.partition("#")
        angles = finite(np.array([float(number) for number in numbers.split(",")]), 1e4)
        if bone == "head" and len(angles) >= 3:
            x, y, z = angles[:3]
            head = from_unity(Rotation.from_euler("YXZ", [y, x, z], degrees=True).as_quat())
    if not weights and head is None:
        raise ValueError("a face expected")
    return Received(weights, head=head)
