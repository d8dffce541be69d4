import math

import torch
from arm import RADIUS, arm_model

from avatarrex.fields.nodes import (
    BENT,
    PARTS,
    anchors,
    covering_radius,
    node_normals,
    part_labels,
    plane_axes,
)
from avatarrex.ops.farthest_points import farthest_points
from avatarrex.templates.model import pose_template
from avatarrex.templates.person import load_person


def test_normals_of_a_tube_point_outwards():
    model = arm_model()
    vertex = torch.arange(12 * 10, 12 * 20)
    outward = model.v_template[vertex] * torch.tensor([0.0, 1.0, 1.0]) / RADIUS
    cosine = (node_normals(model, vertex) * outward).sum(-1)
    assert cosine.min() > 0.99


def test_plane_axes_are_a_right_handed_frame():
    normal = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    normal = torch.cat([normal, torch.eye(3), -torch.eye(3)])
    u, v = plane_axes(normal).unbind(1)
    frame = torch.stack([u, v, normal], 1)
    torch.testing.assert_close(frame @ frame.mT, torch.eye(3).expand(56, -1, -1), atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.det(frame), torch.ones(56), atol=1e-6, rtol=0)


def test_labels_by_joint_name():
    names = ("pelvis", "left_hip", "right_foot", "left_collar", "left_thumb2", "right_wrist", "jaw", "left_eye_smplhf")
    expected = ("trunk", "left_leg", "right_leg", "trunk", "left_arm", "right_arm", "head", "head")
    assert [PARTS[i] for i in part_labels(names, torch.eye(len(names)))] == list(expected)
    assert part_labels((), torch.ones(3, 2)).tolist() == [0, 0, 0], "a template without names is all trunk"


def test_nodes_of_the_default_person():
    model = load_person().body
    nodes = farthest_points(model.v_template, 128, seed=0)
    radius = covering_radius(model.v_template, model.v_template[nodes])
    assert radius < 0.11, "128 nodes cover a person to about a decimetre"
    labels = part_labels(model.joint_names, model.weights[nodes])
    assert set(labels.tolist()) == set(range(len(PARTS)))
    side = model.v_template[nodes][:, 0]
    for part, sign in (("left_arm", 1), ("right_arm", -1), ("left_leg", 1), ("right_leg", -1)):
        assert (sign * side[labels == PARTS.index(part)] > 0).all(), part
    hands = model.weights[nodes][:, 25:55].sum(1) > 0.5
    assert hands.sum() >= 4, "hands have nodes of their own"
    assert math.isclose(float(model.weights[nodes].sum(1).min()), 1, abs_tol=1e-3)


def test_anchors_stay_close_where_a_bend_stretches_the_skin():
    """No vertex of elbow or knee is far from an anchor, at rest or bent; samples of the rest pose alone leave gaps."""
    model = load_person().body
    pose = torch.zeros(len(model.parents), 3)
    for name, turn in BENT.items():
        pose[model.joint_names.index(name)] = torch.tensor(turn)
    posed = pose_template(model, pose, torch.zeros(10), torch.zeros(model.expression_dirs.shape[2])).vertices
    chosen, plain = anchors(model, 2048, seed=0), farthest_points(model.v_template, 2048, seed=0)
    gap = {"rest": gaps(model.v_template, chosen), "bent": gaps(posed, chosen), "plain": gaps(posed, plain)}
    assert len(set(chosen.tolist())) == 2048
    assert max(gap["rest"], gap["bent"]) < 0.027, gap
    assert gap["plain"] > 0.034, gap


def gaps(vertices: torch.Tensor, chosen: torch.Tensor) -> float:
    """Metres from the farthest vertex to its nearest chosen one."""
    return float(torch.cdist(vertices, vertices[chosen]).amin(1).amax())
