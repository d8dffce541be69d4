"""OSC datagrams of the VMC protocol (UDP 39539): bones of a humanoid, its root, and blend shapes.

    /VMC/Ext/Bone/Pos (name, x, y, z, qx, qy, qz, qw)      /VMC/Ext/Root/Pos (the same)      /VMC/Ext/Blend/Val (name, value)

Rotations are local, from the T-pose, in Unity's axes; of places that of the hips is read. Blend shapes: Apple's 52 by name, or the
presets of VRM, each a macro of ours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from avatarrex_studio.live.received import APPLE, Received, finite, from_unity
from pythonosc.osc_packet import OscPacket, ParseError

from avatarrex.signals.joints import EXPRESSION_NAMES, FINGERS
from avatarrex.signals.macros import face_direction

PRESETS = {
    "a": "ah", "i": "ee", "u": "oo", "e": "eh", "o": "oh", "aa": "ah", "ih": "ee", "ou": "oo", "ee": "eh", "oh": "oh",
    "blink": "blink", "joy": "smile", "happy": "smile", "fun": "smile", "angry": "anger", "sorrow": "frown", "sad": "frown",
    "surprised": "surprise",
}  # fmt: skip
"""VRM's presets, of both of its versions, and our macros."""
_BLINKS = {
    "blink_l": "eyeBlinkLeft",
    "blink_r": "eyeBlinkRight",
    "blinkleft": "eyeBlinkLeft",
    "blinkright": "eyeBlinkRight",
}
_PHALANGES = ("Proximal", "Intermediate", "Distal")
_SIDED = {
    "UpperLeg": "hip", "LowerLeg": "knee", "Foot": "ankle", "Toes": "foot", "Shoulder": "collar", "UpperArm": "shoulder",
    "LowerArm": "elbow", "Hand": "wrist", "Eye": "eye",
}  # fmt: skip
BONES: dict[str, str] = {
    "Hips": "pelvis", "Spine": "spine1", "Chest": "spine2", "UpperChest": "spine3", "Neck": "neck", "Head": "head", "Jaw": "jaw",
    **{f"{side}{theirs}": f"{side.lower()}_{ours}" for side in ("Left", "Right") for theirs, ours in _SIDED.items()},
    **{
        f"{side}{'Little' if finger == 'pinky' else finger.capitalize()}{bone}": f"{side.lower()}_{finger}{k}"
        for side in ("Left", "Right") for finger in FINGERS for k, bone in enumerate(_PHALANGES, 1)
    },
}  # fmt: skip
"""Unity's humanoid bones and our joints."""


def decode(data: bytes) -> Received:
    """What a datagram says; empty where it says nothing of a body or a face. Raises `ValueError` for what is no OSC."""
    try:
        messages = [timed.message for timed in OscPacket(data).messages]
    except (ParseError, IndexError, OverflowError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(str(error)) from None
    received = Received()
    for message in messages:
        received = _said(message.address, message.params).over(received)
    return received


def _said(address: str, values: Sequence[object]) -> Received:
    """What one message says. Raises `ValueError`."""
    if address == "/VMC/Ext/Blend/Val":
        name, value = _named(values, 1)
        return Received(_weights(name.lower(), float(finite(value, 100.0)[0])))
    if address in ("/VMC/Ext/Bone/Pos", "/VMC/Ext/Root/Pos"):
        name, numbers = _named(values, 7)
        x, y, z = finite(numbers[:3], 1e4).tolist()
        quaternion = finite(numbers[3:], 10.0)
        if np.linalg.norm(quaternion) < 1e-3:
            raise ValueError("a quaternion expected")
        joint = "" if address.endswith("Root/Pos") else BONES.get(name, "")
        place = np.array([-x, y, z]) if joint == "pelvis" else None  # of Unity's axes, too, x is turned over
        return Received(turns={joint: from_unity(quaternion)}, place=place) if joint else Received()
    return Received()


def _named(values: Sequence[object], count: int) -> tuple[str, np.ndarray]:
    """A name and numbers; what follows them is of newer versions. Raises `ValueError`."""
    name, numbers = (values[0] if values else None), values[1 : 1 + count]
    if (
        not isinstance(name, str)
        or len(numbers) != count
        or not all(isinstance(number, int | float) for number in numbers)
    ):
        raise ValueError(f"a name and {count} numbers expected")
    return name, np.array(numbers, dtype=np.float64)


def _weights(name: str, value: float) -> dict[str, float]:
    """Apple's coefficients of a blend shape; empty for one that is not known."""
    single = APPLE.get(name) or _BLINKS.get(name)
    if single:
        return {single: value}
    if name in PRESETS:
        direction = value * face_direction(PRESETS[name])
        return {each: float(weight) for each, weight in zip(EXPRESSION_NAMES, direction) if weight}
    return {}
