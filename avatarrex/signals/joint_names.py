"""Which of a file's joints is which of ours, by name: the dialects of `docs/signals.md`.

Names are compared in lower case, letters and digits only, without a prefix that most joints share (`mixamorig:`, `Bip01 `).
Sides are spelled left…, …left, l…, …l.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.signals.joints import FINGERS

_MIDDLE: dict[str, tuple[str, ...]] = {
    "pelvis": ("hips", "pelvis", "root", "hip", "spinebase", ""),
    "spine1": ("lowerback", "spine", "spine1", "spine01", "abdomen", "ab", "waist"),
    "spine2": ("chest", "spine1", "spine2", "spine02"),
    "spine3": ("chest2", "spine2", "spine3", "spine03", "upperchest"),
    "neck": ("neck", "neck1", "neck01", "lowerneck", "necklower", "necktwist01", "spine004"),
    "head": ("head", "spine006"),
    "jaw": ("jaw", "lowerjaw"),
}
_SIDED: dict[str, tuple[str, ...]] = {
    "hip": ("femur", "upleg", "thigh", "thighbend", "upperleg", "upperleg01", "hip"),
    "knee": ("tibia", "loleg", "shin", "lowerleg", "lowerleg01", "calf", "leg", "knee"),
    "ankle": ("ankle", "foot"),
    "foot": ("toe", "toebase", "toes", "toe0", "toe11", "ball", "foot"),
    "collar": ("collar", "clavicle", "shoulder"),
    "shoulder": ("humerus", "uparm", "uarm", "shldr", "shldrbend", "upperarm", "upperarm01", "arm", "shoulder"),
    "elbow": ("radius", "loarm", "farm", "forearm", "forearmbend", "lowerarm", "lowerarm01", "elbow"),
    "wrist": ("wrist", "hand"),
    "eye": ("eye",),
}
SPINE = ("spine1", "spine2", "spine3")
_PHALANGES = {1: ("proximal",), 2: ("intermediate", "medial", "middle"), 3: ("distal",)}
_THUMB = {1: ("metacarpal",), 2: ("proximal",), 3: ("distal", "intermediate", "medial")}
_NUMBERS = {"thumb": 1, "index": 2, "middle": 3, "ring": 4, "pinky": 5}
"""`finger2-1` of MakeHuman and MocapNET, `Finger2Proximal` of Rokoko."""
_STEMS = {"pinky": ("pinky", "little"), "middle": ("middle", "mid")}
NEEDED = ("pelvis", *(f"{s}_{p}" for s in ("left", "right") for p in ("hip", "knee", "shoulder", "elbow")))
"""Without these a file is refused; any other joint of ours follows its parent where the file has none."""
_SHARE = 0.6
"""Of a file's names that begin with a prefix, from which on it is no part of the names."""


def find(
    names: tuple[str, ...], parents: np.ndarray, path: str | Path = "skeleton", chosen: tuple[tuple[str, str], ...] = ()
) -> dict[str, int]:
    """Our joint -> index of the file's joint. `chosen`: pairs of ours and the file's that count before any name.

    Raises `InputError` for a chosen name that the file lacks.
    """
    plain = _plain(names)
    found: dict[str, int] = {}
    for ours, theirs in chosen:
        if theirs and theirs not in names:
            raise InputError(path, ours, "a joint of the file: " + ", ".join(names[:12]), theirs)
        if theirs:
            found[ours] = names.index(theirs)
    taken = {ours for ours, _ in chosen}

    def take(ours: str, spellings: list[str]) -> None:
        for spelled in spellings if ours not in taken else ():
            if spelled in plain and plain.index(spelled) not in found.values():
                found[ours] = plain.index(spelled)
                return

    for ours, spellings in _MIDDLE.items():
        take(ours, list(spellings))
    biped = any(s in plain for s in _spelled("left", "finger0"))
    for side in ("left", "right"):
        upper_arm = any(s in plain for n in _SIDED["shoulder"] if n != "shoulder" for s in _spelled(side, n))
        for part, spellings in _SIDED.items():
            # 'LeftShoulder' is a collar bone beside 'LeftArm' (Mixamo) and the upper arm beside 'LeftElbow' (CMU)
            usable = [s for s in spellings if part != "collar" or s != "shoulder" or upper_arm]
            take(f"{side}_{part}", [s for name in usable for s in _spelled(side, name)])
        for finger in FINGERS:
            for k in (1, 2, 3):
                take(f"{side}_{finger}{k}", [s for name in _knuckle(finger, k, biped) for s in _spelled(side, name)])
    spine = _spine(found, parents) if not taken & set(SPINE) else {}
    return {**{ours: k for ours, k in found.items() if not spine or ours not in SPINE}, **spine}


def _plain(names: tuple[str, ...]) -> list[str]:
    """Names as they are compared; helper joints (`__Eye_L`, end sites) get one that nothing matches."""
    spelled = [re.sub(r"[^a-z0-9]", "", re.sub(r"^.*:", "", name).lower()) for name in names]
    helper = [name.startswith("__") or " end" in name for name in names]
    own = [s for s, odd in zip(spelled, helper) if not odd]
    prefix = _prefix(own)
    return ["?" if odd else s.removeprefix(prefix) for s, odd in zip(spelled, helper)]


def _prefix(names: list[str]) -> str:
    """The longest beginning of three letters or more that most names share."""
    counts = Counter(name[:length] for name in names for length in range(3, len(name) + 1))
    shared = [start for start, count in counts.items() if count > 2 and count >= _SHARE * len(names)]
    return max(shared, key=len, default="")


def _spelled(side: str, name: str) -> list[str]:
    letter = side[0]
    return [f"{side}{name}", f"{name}{side}", f"{name}{letter}", f"{letter}{name}"]


def _knuckle(finger: str, k: int, biped: bool) -> list[str]:
    """Names of a finger's joint; `biped` counts fingers and their joints from 0: `Finger0`, `Finger01`."""
    bones = (_THUMB if finger == "thumb" else _PHALANGES)[k]
    number = _NUMBERS[finger]
    numbered = [f"finger{number}{k}", *(f"finger{number}{bone}" for bone in bones)]
    if biped:
        numbered = [f"finger{number - 1}" + (f"{k - 1}" if k > 1 else "")]
    named = [f"{stem}{n}" for stem in _STEMS.get(finger, (finger,)) for n in (f"{k}", f"0{k}", *bones)]
    return [f"{before}{name}" for name in named for before in ("", "hand", "f")] + numbered


def _spine(found: dict[str, int], parents: np.ndarray) -> dict[str, int]:
    """Our spine of the joints between hips and arms, whatever their names and number: the lowest, the middle, what the arms hang from.

    Empty where there is no such chain.
    """
    if not {"pelvis", "left_hip", "left_shoulder", "right_shoulder"} <= set(found):
        return {}
    left, right = (ancestors(found[f"{side}_shoulder"], parents) for side in ("left", "right"))
    below = {found["pelvis"], *ancestors(found["pelvis"], parents), *ancestors(found["left_hip"], parents)}
    others = {k for ours, k in found.items() if ours not in SPINE}
    shared = [k for k in left if k in right and k not in below]
    if not shared or others & set(shared):
        return {}
    chain = shared[::-1]
    picked = {1: (0,), 2: (0, 1)}.get(len(chain), (0, len(chain) // 2, len(chain) - 1))
    ours = {1: ("spine1",), 2: ("spine1", "spine3")}.get(len(chain), SPINE)
    return {name: chain[k] for name, k in zip(ours, picked)}


def ancestors(k: int, parents: np.ndarray) -> list[int]:
    """The joints that k hangs from, the nearest first."""
    chain = []
    while parents[k] >= 0:
        k = int(parents[k])
        chain.append(k)
    return chain
