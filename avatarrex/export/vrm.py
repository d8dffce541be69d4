"""VRM 1.0: a GLB with the extension VRMC_vrm, which names the humanoid's bones, its expressions and the terms of use.

https://github.com/vrm-c/vrm-specification/tree/master/specification/VRMC_vrm-1.0. The rest pose is VRM's T-pose: facing +Z, soles
on y = 0, joints without rotation. A VRM has no clips (`animations` is an unused item there), and four joints a vertex. There are
no spring bones: nothing of the avatar swings on its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from avatarrex.export.glb import MESH_NODE, Document, glb_document
from avatarrex.export.label import STRICTEST, UNSTATED, Label
from avatarrex.export.rig import Rig
from avatarrex.signals.joints import EXPRESSION_NAMES, FINGERS, JOINT_NAMES
from avatarrex.signals.library import EXPRESSIONS, coefficients

LICENCE_URL = "https://vrm.dev/licenses/1.0/"
"""The only one that VRM 1.0 knows; ours stand in `thirdPartyLicenses` and `copyrightInformation`."""
TORSO = {
    "hips": "pelvis", "spine": "spine1", "chest": "spine2", "upperChest": "spine3", "neck": "neck", "head": "head", "jaw": "jaw",
    "leftEye": "left_eye", "rightEye": "right_eye",
}  # fmt: skip
LIMBS = {
    "UpperLeg": "hip", "LowerLeg": "knee", "Foot": "ankle", "Toes": "foot",
    "Shoulder": "collar", "UpperArm": "shoulder", "LowerArm": "elbow", "Hand": "wrist",
}  # fmt: skip
PHALANGES = ("Proximal", "Intermediate", "Distal")
THUMB = ("Metacarpal", "Proximal", "Distal")
PRESETS: dict[str, Mapping[str, float]] = {
    "neutral": {},
    "happy": EXPRESSIONS["smile"],
    "angry": EXPRESSIONS["anger"],
    "sad": EXPRESSIONS["sadness"],
    "relaxed": {"mouthSmile*": 0.3, "eyeSquint*": 0.2, "browInnerUp": 0.1},
    "surprised": EXPRESSIONS["surprise"],
    "aa": {"jawOpen": 0.6},
    "ih": {"jawOpen": 0.2, "mouthStretch*": 0.5},
    "ou": {"jawOpen": 0.15, "mouthPucker": 0.7},
    "ee": {"jawOpen": 0.15, "mouthSmile*": 0.5, "mouthStretch*": 0.3},
    "oh": {"jawOpen": 0.35, "mouthFunnel": 0.6},
    "blink": {"eyeBlink*": 1.0},
    "blinkLeft": {"eyeBlinkLeft": 1.0},
    "blinkRight": {"eyeBlinkRight": 1.0},
    "lookUp": {"eyeLookUp*": 1.0},
    "lookDown": {"eyeLookDown*": 1.0},
    "lookLeft": {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0},
    "lookRight": {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0},
}
"""VRM's presets of the 52: emotions as in the pose library, the five mouth shapes by jaw and lips."""
LOOK_RANGE = {"inputMaxValue": 90.0, "outputScale": 25.0}
"""Degrees that an eye turns where the target is 90° aside."""


def vrm_document(rig: Rig, label: Label) -> Document:
    """The avatar as a VRM; `rig` has four joints a vertex."""
    document = glb_document(rig, (), label)
    document.gltf.extensionsUsed.append("VRMC_vrm")
    document.gltf.extensions["VRMC_vrm"] = {
        "specVersion": "1.0",
        "meta": _meta(label),
        "humanoid": {"humanBones": {bone: {"node": JOINT_NAMES.index(joint)} for bone, joint in human_bones().items()}},
        "firstPerson": {"meshAnnotations": [{"node": MESH_NODE, "type": "auto"}]},
        "expressions": {
            "preset": {name: _expression(coefficients(units)) for name, units in PRESETS.items()},
            "custom": {name: _expression(coefficients({name: 1.0})) for name in EXPRESSION_NAMES},
        },
        "lookAt": _look_at(rig),
    }
    return document


def human_bones() -> dict[str, str]:
    """VRM's bones and our joints: all 55 have one."""
    bones = dict(TORSO)
    for side in ("left", "right"):
        bones |= {side + limb: f"{side}_{joint}" for limb, joint in LIMBS.items()}
        for finger in FINGERS:
            theirs = "Little" if finger == "pinky" else finger.capitalize()
            for k, phalanx in enumerate(THUMB if finger == "thumb" else PHALANGES, start=1):
                bones[side + theirs + phalanx] = f"{side}_{finger}{k}"
    return bones


def _meta(label: Label) -> dict[str, Any]:
    """Name, authors and terms; what the avatar does not allow is not allowed."""
    return {
        "name": label.name,
        "authors": list(label.authors) or [UNSTATED],
        "copyrightInformation": f"licence: {label.licence}; consent: {label.consent}",
        "thirdPartyLicenses": label.licence,
        "licenseUrl": LICENCE_URL,
        **STRICTEST,
        **label.allowed_use,
    }


def _expression(values: np.ndarray) -> dict[str, Any]:
    binds = [{"node": MESH_NODE, "index": int(e), "weight": round(float(values[e]), 6)} for e in np.flatnonzero(values)]
    return {
        "isBinary": False, "overrideBlink": "none", "overrideLookAt": "none", "overrideMouth": "none",
        **({"morphTargetBinds": binds} if binds else {}),
    }  # fmt: skip


def _look_at(rig: Rig) -> dict[str, Any]:
    """Eyes turn by their joints; where they look from is between them."""
    head, left, right = (rig.places[JOINT_NAMES.index(name)] for name in ("head", "left_eye", "right_eye"))
    ways = ("HorizontalInner", "HorizontalOuter", "VerticalDown", "VerticalUp")
    offset = ((left + right) / 2 - head).round(6).tolist()
    return {"type": "bone", "offsetFromHeadBone": offset, **{f"rangeMap{way}": LOOK_RANGE for way in ways}}
