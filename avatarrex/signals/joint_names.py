"""Which of a file's joints is which of ours, by name: CMU, MakeHuman, Mixamo, Biped, Perception Neuron, VRM, Unreal, SMPL.

Names are compared in lower case, letters and digits only, without a prefix that all joints share (`mixamorig:`, `Bip01 `).
Sides are spelled left…, …left, l…, …l.
"""

from __future__ import annotations

import re
from itertools import takewhile

import numpy as np

from avatarrex.signals.joints import FINGERS

_MIDDLE: dict[str, tuple[str, ...]] = {
    "pelvis": ("hips", "pelvis", "root", ""),
    "spine1": ("lowerback", "spine", "spine1", "spine01", "abdomen"),
    "spine2": ("chest", "spine1", "spine2", "spine02"),
    "spine3": ("chest2", "spine2", "spine3", "spine03", "upperchest"),
    "neck": ("neck", "neck1", "neck01", "lowerneck"),
    "head": ("head",),
    "jaw": ("jaw",),
}
_SIDED: dict[str, tuple[str, ...]] = {
    "hip": ("hip", "upleg", "thigh", "upperleg"),
    "knee": ("knee", "loleg", "leg", "shin", "lowerleg", "calf"),
    "ankle": ("ankle", "foot"),
    "foot": ("toe", "toebase", "toes", "toe0", "ball", "foot"),
    "collar": ("collar", "clavicle", "shoulder"),
    "shoulder": ("shoulder", "uparm", "arm", "upperarm"),
    "elbow": ("elbow", "loarm", "forearm", "lowerarm"),
    "wrist": ("wrist", "hand"),
    "eye": ("eye",),
}
_VRM = {1: "proximal", 2: "intermediate", 3: "distal"}
NEEDED = ("pelvis", *(f"{s}_{p}" for s in ("left", "right") for p in ("hip", "knee", "shoulder", "elbow")))
"""Without these a file is refused; any other joint of ours follows its parent where the file has none."""


def find(names: tuple[str, ...], parents: np.ndarray) -> dict[str, int]:
    """Our joint -> index of the file's joint."""
    plain = _plain(names)
    found: dict[str, int] = {}

    def take(ours: str, spellings: list[str]) -> None:
        for spelled in spellings:
            if spelled in plain and plain.index(spelled) not in found.values():
                found[ours] = plain.index(spelled)
                return

    for ours, spellings in _MIDDLE.items():
        take(ours, list(spellings))
    for side in ("left", "right"):
        upper_arm = any(s in plain for name in ("arm", "uparm", "upperarm") for s in _spelled(side, name))
        for part, spellings in _SIDED.items():
            # 'LeftShoulder' is a collar bone beside 'LeftArm' (Mixamo) and the upper arm beside 'LeftElbow' (CMU)
            usable = [s for s in spellings if part != "collar" or s != "shoulder" or upper_arm]
            take(f"{side}_{part}", [s for name in usable for s in _spelled(side, name)])
        for finger in FINGERS:
            for k in (1, 2, 3):
                take(f"{side}_{finger}{k}", [s for name in _knuckle(finger, k) for s in _spelled(side, name)])
    _chest(found, parents)
    return found


def _plain(names: tuple[str, ...]) -> list[str]:
    """Names as they are compared; helper joints (`__Eye_L`, end sites) get one that nothing matches."""
    spelled = [re.sub(r"[^a-z0-9]", "", re.sub(r"^.*:", "", name).lower()) for name in names]
    helper = [name.startswith("__") or " end" in name for name in names]
    letters = zip(*(s for s, odd in zip(spelled, helper) if not odd))
    shared = len(list(takewhile(lambda column: len(set(column)) == 1, letters)))
    cut = shared if shared >= 3 else 0
    return ["?" if odd else s[cut:] for s, odd in zip(spelled, helper)]


def _spelled(side: str, name: str) -> list[str]:
    letter = side[0]
    return [f"{side}{name}", f"{name}{side}", f"{name}{letter}", f"{letter}{name}"]


def _knuckle(finger: str, k: int) -> list[str]:
    stems = [finger, "little"] if finger == "pinky" else [finger]
    numbers = [f"{k}", f"0{k}", _VRM[k] if finger != "thumb" else {1: "metacarpal", 2: "proximal", 3: "distal"}[k]]
    return [f"{before}{stem}{number}" for stem in stems for number in numbers for before in ("", "hand", "f")]


def _chest(found: dict[str, int], parents: np.ndarray) -> None:
    """The joint that both arms hang from is our chest, however many spine joints lie below it."""
    if "left_shoulder" not in found or "right_shoulder" not in found:
        return
    left, right = (ancestors(found[f"{side}_shoulder"], parents) for side in ("left", "right"))
    common = next((k for k in left if k in right), -1)
    if common >= 0 and common not in found.values():
        found["spine3"] = common


def ancestors(k: int, parents: np.ndarray) -> list[int]:
    """The joints that k hangs from, the nearest first."""
    chain = []
    while parents[k] >= 0:
        k = int(parents[k])
        chain.append(k)
    return chain
