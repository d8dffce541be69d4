"""Joints found by name in rigs of other makers."""

import numpy as np
import pytest

from avatarrex.signals.joint_names import NEEDED, find
from avatarrex.signals.joints import JOINT_NAMES

RIGS = {
    "mixamo": "mixamorig:Hips Spine Spine1 Spine2 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand LeftHandIndex1 "
    "RightShoulder RightArm RightForeArm LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg",
    "biped": "Bip01 Bip01_Spine Bip01_Neck Bip01_Head Bip01_L_Clavicle Bip01_L_UpperArm Bip01_L_Forearm Bip01_L_Hand "
    "Bip01_R_UpperArm Bip01_R_Forearm Bip01_L_Thigh Bip01_L_Calf Bip01_L_Foot Bip01_L_Toe0 Bip01_R_Thigh Bip01_R_Calf",
    "vrm": "hips spine chest upperChest neck head leftEye leftShoulder leftUpperArm leftLowerArm leftHand "
    "leftLittleProximal leftThumbMetacarpal rightUpperArm rightLowerArm leftUpperLeg leftLowerLeg rightUpperLeg rightLowerLeg",
    "unreal": "root pelvis spine_01 spine_02 spine_03 neck_01 head clavicle_l upperarm_l lowerarm_l hand_l pinky_03_l "
    "upperarm_r lowerarm_r thigh_l calf_l foot_l ball_l thigh_r calf_r",
    "smpl": " ".join(JOINT_NAMES),
}
EXPECTED = {
    "mixamo": {
        "spine3": "Spine2",
        "left_collar": "LeftShoulder",
        "left_shoulder": "LeftArm",
        "left_index1": "LeftHandIndex1",
    },
    "biped": {"pelvis": "Bip01", "left_collar": "Bip01_L_Clavicle", "left_foot": "Bip01_L_Toe0"},
    "vrm": {
        "spine3": "upperChest",
        "left_pinky1": "leftLittleProximal",
        "left_thumb1": "leftThumbMetacarpal",
        "left_eye": "leftEye",
    },
    "unreal": {"pelvis": "pelvis", "spine3": "spine_03", "left_pinky3": "pinky_03_l", "left_foot": "ball_l"},
    "smpl": {name: name for name in JOINT_NAMES},
}


@pytest.mark.parametrize("rig", RIGS)
def test_rigs_are_understood(rig: str) -> None:
    names = tuple(RIGS[rig].split())
    found = find(names, np.arange(len(names)) - 1)
    assert set(NEEDED) <= set(found)
    assert len(set(found.values())) == len(found), "no joint of the file is used twice"
    for ours, theirs in EXPECTED[rig].items():
        assert names[found[ours]] == theirs


def test_the_chest_is_what_both_arms_hang_from() -> None:
    names = ("Hips", "Spine", "Spine1", "Spine2", "Spine3", "LeftArm", "RightArm", "LeftUpLeg")
    found = find(names, np.array([-1, 0, 1, 2, 3, 4, 4, 0]))
    assert (found["spine1"], found["spine3"]) == (1, 4)


def test_a_shoulder_without_an_arm_is_the_upper_arm() -> None:
    names = ("Hips", "LeftShoulder", "LeftElbow")
    assert "left_collar" not in find(names, np.array([-1, 0, 1]))
    assert find(names, np.array([-1, 0, 1]))["left_shoulder"] == 1
