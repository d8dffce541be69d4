"""Live Link Face's datagrams (UDP 11111): 52 coefficients, head and eyes.

    uint8 version, FString device, FString subject, int32 frame, float sub-frame, int32 rate, int32 denominator, uint8 count, float[count]

Big-endian; an FString is an int32 length and so many bytes. The values are in the order of Unreal's EARFaceBlendShape: Apple's, then yaw,
pitch and roll of head, left eye and right eye, radians. Signs as in recordings (`avatarrex/signals/livelink.py`).
"""

from __future__ import annotations

import struct

import numpy as np
from avatarrex_studio.live.received import Received, finite
from scipy.spatial.transform import Rotation

from avatarrex.signals.joints import EXPRESSION_NAMES

_SWAPPED = {"jawRight": "jawLeft", "jawLeft": "jawRight", "mouthRight": "mouthLeft", "mouthLeft": "mouthRight"}
NAMES = tuple(_SWAPPED.get(name, name) for name in EXPRESSION_NAMES)
"""Unreal's order: left before right, also of jaw and mouth."""
COUNT = 61
_TIME, _LENGTH = struct.Struct(">ifii"), struct.Struct(">i")


def decode(data: bytes) -> Received | None:
    """What a datagram says; None for one without a face. Raises `ValueError` for anything else."""
    place = 1
    for _ in range(2):
        (length,) = _LENGTH.unpack(data[place : place + 4])
        if not 0 <= length <= 256:
            raise ValueError("a name of at most 256 bytes expected")
        place += 4 + length
    place += _TIME.size
    if len(data) <= place:
        return None
    count = data[place]
    if count != COUNT or len(data) != place + 1 + 4 * COUNT:
        raise ValueError(f"{COUNT} values expected")
    values = finite(np.frombuffer(data, ">f4", COUNT, place + 1).astype(np.float64), 100.0)
    head = Rotation.from_euler("YXZ", values[52:55]).as_rotvec()
    return Received(dict(zip(NAMES, values[:52].tolist())), head=head)


def encode(
    weights: dict[str, float], head: tuple[float, float, float] = (0.0, 0.0, 0.0), subject: str = "iPhone"
) -> bytes:
    """A datagram as the app sends it: `head` is yaw, pitch and roll, radians."""
    device, name = b"0123-device", subject.encode()
    values = [weights.get(each, 0.0) for each in NAMES] + [*head, *[0.0] * 6]
    texts = _LENGTH.pack(len(device)) + device + _LENGTH.pack(len(name)) + name
    return bytes([6]) + texts + _TIME.pack(1, 0.0, 60, 1) + bytes([COUNT]) + struct.pack(f">{COUNT}f", *values)
