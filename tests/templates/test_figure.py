"""A figure's joints are the template's, and a point of its skin belongs to the part that a person would name."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.limits import random_signals
from avatarrex.templates.figure import Figure
from avatarrex.templates.model import pose_by_signals
from avatarrex.templates.person import load_person
from avatarrex.templates.transform import world_from_root

BODY = load_person("default").body


def test_the_joints_are_the_templates():
    rng = np.random.default_rng(2)
    signals = random_signals(rng, 0.8).replace(
        global_orient=rng.normal(size=3), translation=rng.normal(size=3), shape=rng.normal(size=10)
    )
    figure = Figure(BODY, signals)
    posed = pose_by_signals(BODY, signals)
    joints = posed.joints.double().numpy()
    root = world_from_root(signals.global_orient, signals.translation, joints[0])
    assert figure.posed.position == pytest.approx(joints @ root[:3, :3].T + root[:3, 3], abs=1e-5)
    turned = root[:3, :3] @ posed.joint_transforms[:, :3, :3].double().numpy()
    assert figure.posed.rotation == pytest.approx(turned, abs=1e-5)
    assert np.array_equal(figure.posed.position, figure.skeleton.posed(signals).position)


def test_a_part_of_the_joints_is_the_same_as_all():
    pose = random_signals(np.random.default_rng(4), 1.0).full_pose()
    skeleton = Figure(BODY, Signals.rest()).skeleton
    wrist = JOINT_NAMES.index("left_wrist")
    needed = np.flatnonzero(skeleton.carries[:, wrist]).tolist()
    whole, part = skeleton.turned(pose, np.ones(3)), skeleton.turned(pose, np.ones(3), needed)
    assert needed[0] == 0
    assert np.array_equal(part.position[wrist], whole.position[wrist])
    assert np.array_equal(part.rotation[wrist], whole.rotation[wrist])


def front(figure, x, y):
    """The foremost vertex near a place of the front view."""
    near = np.flatnonzero(np.hypot(figure.vertices[:, 0] - x, figure.vertices[:, 1] - y) < 0.006)
    return figure.vertices[near[figure.vertices[near, 2].argmax()]]


@pytest.mark.parametrize(
    ("right", "above", "region"),
    [(0.03, 0.035, "brow"), (0, -0.04, "nose"), (0.0, -0.075, "mouth"), (0.055, -0.045, "cheek"), (0, -0.115, "jaw"), (0, 0.095, "head")],
)  # fmt: skip
def test_a_point_of_the_face_belongs_to_its_region(right, above, region):
    """Metres to the person's left and above the eyes."""
    figure = Figure(BODY, Signals.rest())
    height = figure.posed.position[JOINT_NAMES.index("left_eye"), 1]
    assert figure.part_at(front(figure, right, height + above)) == region


@pytest.mark.parametrize("name", ["left_elbow", "right_knee", "left_index2", "right_thumb3", "left_pinky1", "spine3"])
def test_the_skin_half_way_down_a_bone_belongs_to_its_joint(name):
    signals = random_signals(np.random.default_rng(5), 0.4).replace(translation=np.array([2.0, 0.0, 1.0]))
    figure = Figure(BODY, signals)
    rows = figure.region(name)
    assert len(rows) > 10
    middle = figure.vertices[rows].mean(0)
    assert figure.part_at(middle) == name


def test_nobody_points_at_teeth():
    figure = Figure(BODY, Signals.rest())
    inner = figure.vertices[BODY.groups["upper_teeth"].numpy()]
    assert {figure.part_at(point) for point in inner[::20]} <= {"mouth", "jaw", "nose", "cheek", "head"}
