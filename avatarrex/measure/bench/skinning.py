"""Stage `skinning`: posing the body, its 128 nodes and both hands, against dense linear blend skinning.

The dense form blends homogeneous 4 × 4 matrices of all joints for all vertices and walks the tree joint by joint, as the
usual SMPL-X code does. One core, processor time. Judged by the same formulas in float64. Metres.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from avatarrex.measure.bench.contest import Contest, Contestant, interleaved, one_core
from avatarrex.measure.bench.report import SLOWER, Metric
from avatarrex.measure.bench.session import Bench
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.skinning import blend, joint_transforms, skin, skinning_matrices
from avatarrex.templates.hand import pose_hand
from avatarrex.templates.model import TemplateModel, pose_template, shape_template


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    contest = bench.once(contests)
    best = contest.best
    return [
        Metric("skinning.max_error_m", best.error["max_error_m"], "m", target=1e-6, error=best.error),
        Metric("skinning.vs_dense", 1 / contest.advantage("dense"), SLOWER, error=best.error),
        *contest.metrics(),
    ]


def contests(bench: Bench) -> Contest:
    """All forms."""
    person, signals = bench.avatar.person, bench.signals(5)
    model, pose = person.body, torch.tensor(signals.full_pose()).float()
    shape, expression = torch.zeros(10), torch.zeros(model.expression_dirs.shape[2])
    node = bench.avatar.body.node_vertex
    hands = {name: torch.tensor(getattr(signals, f"{name}_pose")).float() for name in ("left_hand", "right_hand")}
    runners: dict[str, Callable[[], Tensor]] = {
        "body": lambda: pose_template(model, pose, shape, expression).vertices,
        "dense": lambda: dense(model, pose, shape),
        "nodes": lambda: nodes(model, pose, shape, node),
        "hands": lambda: torch.cat([pose_hand(getattr(person, name), turn, shape) for name, turn in hands.items()]),
    }
    with one_core():
        times = interleaved(runners, bench.count(40, 15))
    exact = pose_template(model.double(), pose.double(), shape.double(), expression.double())
    onto = blend(exact.skinning, model.weights.double()[node])
    truth = {"body": exact.vertices, "dense": exact.vertices, "nodes": skin(onto, model.v_template.double()[node])}
    entries = []
    for name, run in runners.items():
        error = {} if name not in truth else {"max_error_m": float((run().double() - truth[name]).abs().max())}
        entries.append(Contestant(name, times[name], error, ours=name == "body"))
    return Contest("skinning.template", tuple(entries), cpu=True)


def dense(model: TemplateModel, pose: Tensor, shape: Tensor) -> Tensor:
    """(v, 3) by the book."""
    rotation = matrix_from_rotvec(pose)
    rest, joints = shape_template(model, shape, torch.zeros(0))
    if model.posedirs is not None:
        feature = (rotation[1:] - torch.eye(3)).reshape(-1)
        rest = rest + model.posedirs @ (feature if model.pose_columns is None else feature[model.pose_columns])
    chain: list[Tensor] = []
    for j, parent in enumerate(model.parents):
        local = torch.eye(4)
        local[:3, :3] = rotation[j]
        local[:3, 3] = joints[j] - (joints[parent] if parent >= 0 else 0)
        chain.append(local if parent < 0 else chain[parent] @ local)
    stacked = torch.stack(chain)
    homogeneous = torch.cat([joints, torch.zeros(len(joints), 1)], 1)
    back = torch.nn.functional.pad((stacked @ homogeneous[..., None]), (3, 0))
    matrices = torch.einsum("vj,jab->vab", model.weights, stacked - back)
    place = torch.cat([rest, torch.ones(len(rest), 1)], 1)
    return (matrices @ place[..., None])[:, :3, 0]


def nodes(model: TemplateModel, pose: Tensor, shape: Tensor, chosen: Tensor) -> Tensor:
    """(n, 3) rest vertices of the nodes, carried along, without the rest of the skin."""
    _, joints = shape_template(model, shape, torch.zeros(0))
    moved = skinning_matrices(joint_transforms(matrix_from_rotvec(pose), joints, model.parents), joints)
    return skin(blend(moved, model.weights[chosen]), model.v_template[chosen])
