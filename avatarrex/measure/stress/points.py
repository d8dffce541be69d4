"""Case `points`: a driving signal through the templates, the nodes and the fields at 2 000 points each.

The body is always queried; left hand, right hand and face take turns. Points lie about the posed meshes, on them, on the
nodes, and far away. Tolerances beside the checks.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.counters import Counters
from avatarrex.fields.body import CLOTH, LEAST_FILL, BodyFrame
from avatarrex.fields.code import RESIDUAL
from avatarrex.fields.composition import BAND
from avatarrex.fields.influence import RADIUS
from avatarrex.measure.stress import driving
from avatarrex.measure.stress.case import Entry, Inputs, Kind
from avatarrex.measure.stress.driving import subject
from avatarrex.measure.stress.findings import Findings
from avatarrex.ops.skinning import AMPLIFICATION
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import body_frame

COUNT = 2000
PARTS = ("left_hand", "right_hand", "face")
SPREADS = (0.0, 0.0005, 0.0075, 0.075)
"""Noise about mesh vertices, as shares of the extent."""
BODY_EXTENT, PART_EXTENT = 4.0, 0.4
"""Metres about the middle that the farthest points fill. Sparse points far from a hand are the slowest to search."""
TALLEST = 10.0
"""Metres from the root that no vertex may reach: shapes of ±5 σ at half turns come to 6."""


def draw(rng: np.random.Generator, number: int) -> Inputs:
    """Signals, the part of that number, and where the points come from."""
    return {
        **driving.inputs_of(driving.draw_signals(rng, number)),
        "part": np.array([number % len(PARTS)]),
        "point_seed": rng.integers(2**31, size=1),
        "point_row": np.arange(COUNT),
    }


@torch.no_grad()
def check(inputs: Inputs, found: Findings) -> None:
    """All checks of the case."""
    signals = driving.signals_of(inputs)
    posed = pose_person(subject().person, signals, Counters(), None)
    meshes = (posed.body.vertices, *posed.parts.values())
    found.finite("templates finite", *meshes, posed.body.joint_transforms)
    found.at_most("template reaches (m)", torch.stack([mesh.abs().max() for mesh in meshes]), TALLEST)
    turn = posed.world_from_root(signals)[:3, :3]
    found.at_most("root turns rigidly", np.abs(turn.T @ turn - np.eye(3)), 1e-12)
    frame = body_frame(subject(), posed)
    _check_nodes(frame, found)
    generator = torch.Generator().manual_seed(int(inputs["point_seed"][0]))
    rows = torch.as_tensor(inputs["point_row"])
    point = _points(posed.body.vertices, frame.node_position, BODY_EXTENT, generator)[rows]
    gaze = normalize(torch.randn(COUNT, 3, generator=generator), dim=-1)[rows]
    _check_body(frame, posed, point, gaze, found)
    name = PARTS[int(inputs["part"][0])]
    point = _points(posed.parts[name], posed.parts[name][:1], PART_EXTENT, generator)[rows]
    (_check_face if name == "face" else _check_hand)(name, posed, point, gaze, found)


def _points(vertices: Tensor, nodes: Tensor, extent: float, generator: torch.Generator) -> Tensor:
    """(COUNT, 3): most about the vertices, a tenth on the nodes, a tenth within `extent` metres of the middle."""
    near = vertices[torch.randint(len(vertices), (COUNT,), generator=generator)]
    spread = extent * torch.tensor(SPREADS)[torch.randint(len(SPREADS), (COUNT,), generator=generator)]
    point = near + spread[:, None] * torch.randn(COUNT, 3, generator=generator)
    tenth = COUNT // 10
    point[:tenth] = nodes[torch.randint(len(nodes), (tenth,), generator=generator)]
    point[tenth : 2 * tenth] = extent * (2 * torch.rand(tenth, 3, generator=generator) - 1)
    return point


def _check_nodes(frame: BodyFrame, found: Findings) -> None:
    samples = frame.samples
    assert samples is not None, "the packaged avatar's local frames have anchors"
    found.finite("nodes finite", frame.node_position, frame.node_from_rest, frame.code.embedding, frame.code.residual)
    found.finite("anchors finite", samples.position, samples.outward, samples.rest_from_posed)
    found.at_most("node residual (m)", frame.code.residual.abs(), RESIDUAL)
    found.within("embedding in −1 to 1", frame.code.embedding, -1, 1)
    linear = samples.rest_from_posed[:, :, :3].double()
    strong = linear[linear.square().sum((1, 2)) > AMPLIFICATION**2]  # the Frobenius norm bounds the stretch
    found.at_most("inverse skinning stretches", torch.linalg.matrix_norm(strong, 2), AMPLIFICATION * (1 + 1e-4))


def _check_body(frame: BodyFrame, posed: PosedPerson, point: Tensor, gaze: Tensor, found: Findings) -> None:
    field = subject().body
    sdf, colour = field.sdf(frame, point), field.colour(frame, None, point, gaze)
    found.finite("body field finite", sdf, colour)
    found.within("body colour in 0 to 1", colour, 0, 1)
    # The fill's promise: at most the distance to a surface that stands CLOTH off the template, or LEAST_FILL.
    far = point[torch.cdist(point, frame.node_position).amin(1) > RADIUS]
    true = torch.cdist(far.double(), posed.body.vertices[::8].double()).amin(1) - CLOTH
    excess = field.outside_distance(frame, far) - true.clamp_min(LEAST_FILL)
    found.at_most("body fill beyond the true distance (m)", excess, 1e-5)  # float32 at 10 m


def _check_hand(name: str, posed: PosedPerson, point: Tensor, gaze: Tensor, found: Findings) -> None:
    field = subject().hand(name)
    query = field.sdf(posed.parts[name], point)
    omega, colour = field.omega(query), field.colour(posed.parts[name], posed.coefficients[name], query)
    found.finite("hand field finite", query.sdf, query.barycentric, query.normal, omega, colour)
    found.within("hand distance in its band", query.sdf, *BAND)
    found.within("hand barycentrics in 0 to 1", query.barycentric, 0, 1)
    found.at_most("hand barycentrics sum to 1", (query.barycentric.sum(-1) - 1).abs(), 1e-6)
    found.within("hand ω in 0 to 1", omega, 0, 1, 1e-6)
    found.unit("hand normal of unit length", query.normal, 1e-5)
    found.within("hand colour in 0 to 1", colour, 0, 1)


def _check_face(name: str, posed: PosedPerson, point: Tensor, gaze: Tensor, found: Findings) -> None:
    field = subject().face
    views = field.driven(posed.parts[name], posed.coefficients[name])
    found.finite("face views finite", views)
    planes = field.geometry_planes(views), field.colour_planes(views)
    found.finite("face planes finite", *planes)
    sdf, colour = field.sdf(planes[0], point), field.colour(planes[1], point, gaze)
    found.finite("face field finite", sdf, colour, subject().tone(colour, gaze, gaze))
    found.within("face colour in 0 to 1", colour, 0, 1)


ENTRIES = {
    **driving.ENTRIES,
    "part": Entry((1,), (0, len(PARTS) - 1)),
    "point_seed": Entry((1,), (0, 2**31 - 1)),
    "point_row": Entry((-1,), (0, COUNT - 1)),
}
KIND = Kind("points", ENTRIES, draw, check, repeat=50, simpler=tuple(driving.ENTRIES), fewer=("point_row",))
