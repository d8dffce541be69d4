"""Case `agreement`: the fast implementations against their references, and float32 against float64, under driving signals.

Each tolerance has its cause beside it.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from scipy.ndimage import map_coordinates
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.measure.stress import driving
from avatarrex.measure.stress.case import Entry, Inputs, Kind
from avatarrex.measure.stress.driving import double_body, subject
from avatarrex.measure.stress.findings import Findings
from avatarrex.ops import local_mlp
from avatarrex.ops.encoding import encode, encode_reference
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.skinning import blend, joint_transforms, skin, skin_reference, skinning_matrices
from avatarrex.ops.trilinear import trilinear
from avatarrex.templates.hand import pose_hand
from avatarrex.templates.model import PosedTemplate, TemplateModel, pose_template
from avatarrex.templates.posed import pose_person
from avatarrex.volume.build import body_frame

QUERIED_POINTS, SKINNED_VERTICES = 200, 40


def draw(rng: np.random.Generator, number: int) -> Inputs:
    """Signals and a seed for points, grids and places."""
    return {**driving.inputs_of(driving.draw_signals(rng, number)), "seed": rng.integers(2**31, size=1)}


@torch.no_grad()
def check(inputs: Inputs, found: Findings) -> None:
    """All checks of the case."""
    generator = torch.Generator().manual_seed(int(inputs["seed"][0]))
    rotvec = torch.cat([torch.zeros(1, 3), torch.as_tensor(inputs["body_pose"]).float(), torch.zeros(33, 3)])
    single = _posed(subject().person.body, rotvec, inputs)
    double = _posed(_double("body"), rotvec.double(), inputs)
    # Rounding of the matrices along nine joints and 2 m of limb; many turns leave a float32 angle fewer digits.
    drift = 2e-5 + 2e-7 * float(rotvec.norm(dim=-1).max())
    found.at_most("template, float32 off float64 (m)", (single.vertices - double.vertices).abs(), drift)
    _check_skinning(double, rotvec.double(), generator, found)
    for side in ("left_hand", "right_hand"):
        hand = getattr(subject().person, side)
        pose, shape = torch.as_tensor(inputs[f"{side}_pose"]).float(), torch.as_tensor(inputs["shape"]).float()
        rotvec, nothing = torch.cat([torch.zeros(1, 3), pose]).double(), torch.zeros(0, dtype=torch.float64)
        want = pose_template(_double(side), rotvec, shape.double(), nothing).vertices
        found.at_most("hand, float32 off float64 (m)", (pose_hand(hand, pose, shape) - want).abs(), 1e-5)
    _check_body(inputs, double, generator, found)
    _check_hand(inputs, generator, found)
    _check_interpolation(generator, found)


def _check_skinning(posed: PosedTemplate, rotvec: Tensor, generator: torch.Generator, found: Findings) -> None:
    model = _double("body")
    rows = torch.randint(len(model.weights), (SKINNED_VERTICES,), generator=generator)
    rotation, joints = matrix_from_rotvec(rotvec), model.joint_template
    rest, weights = model.v_template[rows], model.weights[rows]
    skinning = skinning_matrices(joint_transforms(rotation, joints, model.parents), joints)
    want = skin_reference(rotation, joints, model.parents, weights, rest)
    found.at_most("skinning off its reference (m)", (skin(blend(skinning, weights), rest) - want).abs(), 1e-12)


def _check_body(inputs: Inputs, posed: PosedTemplate, generator: torch.Generator, found: Findings) -> None:
    person = pose_person(subject().person, driving.signals_of(inputs), Counters(), None)
    frame, body = body_frame(subject(), person), subject().body
    rows = torch.randint(len(person.body.vertices), (QUERIED_POINTS,), generator=generator)
    point = person.body.vertices[rows] + 0.01 * torch.randn(QUERIED_POINTS, 3, generator=generator)
    want = body.sdf(frame, point, impl="reference")
    found.finite("body distances finite", want)
    for impl in local_mlp.available()[1:]:
        off = (body.sdf(frame, point, impl=impl) - want).abs()
        found.at_most(f"local MLPs by {impl} off the reference (m)", off, 1e-5)  # sums of 64 terms, float32, times 5 cm
    exact = double_body()
    code = exact.code(matrix_from_rotvec(torch.as_tensor(inputs["body_pose"])))
    drift = (body.sdf(frame, point) - exact.sdf(exact.frame(posed, code), point.double())).abs()
    # Collapsed limbs stretch a rounding error eightfold and the networks again; few points fall to another anchor.
    found.at_most("body field, float32 off float64, median (m)", drift.median(), 1e-5)
    found.at_most("body field, share off float64 by a millimetre", (drift > 1e-3).double().mean(), 0.05)


def _check_hand(inputs: Inputs, generator: torch.Generator, found: Findings) -> None:
    field, shape = subject().left_hand, torch.as_tensor(inputs["shape"]).float()
    mesh = pose_hand(subject().person.left_hand, torch.as_tensor(inputs["left_hand_pose"]).float(), shape)
    rows = torch.randint(len(mesh), (QUERIED_POINTS,), generator=generator)
    point = mesh[rows] + 0.01 * torch.randn(QUERIED_POINTS, 3, generator=generator)
    off = field.sdf(mesh, point).sdf.abs() - field.sdf(mesh, point, impl="reference").sdf.abs()
    found.at_most("hand distance off brute force (m)", off.abs(), 5e-8)  # of coordinates of 30 cm in float32


def _check_interpolation(generator: torch.Generator, found: Findings) -> None:
    grid = torch.randn(5, 6, 7, 1, generator=generator)
    place = (torch.rand(500, 3, generator=generator) - 0.25) * 14
    want = map_coordinates(grid[..., 0].double().numpy(), place.flip(1).T.double().numpy(), order=1, mode="nearest")
    off = trilinear(grid, place)[:, 0].double() - torch.as_tensor(want)
    found.at_most("trilinear off scipy", off.abs(), 5e-6)  # float32 places up to 10, values up to 4
    x = 10.0 ** (torch.rand(500, 3, generator=generator) * 40 - 20)
    found.at_most("encoding off its reference", (encode(x, 6) - encode_reference(x, 6)).abs(), 5e-6)


def _posed(model: TemplateModel, rotvec: Tensor, inputs: Inputs) -> PosedTemplate:
    expression = rotvec.new_zeros(model.expression_dirs.shape[2])
    return pose_template(model, rotvec, torch.as_tensor(inputs["shape"]).to(rotvec), expression)


@cache
def _double(part: str) -> TemplateModel:
    """A template of the subject in float64."""
    template = getattr(subject().person, part)
    model: TemplateModel = template if part == "body" else template.model
    return model.double()


ENTRIES = {**driving.ENTRIES, "seed": Entry((1,), (0, 2**31 - 1))}
KIND = Kind("agreement", ENTRIES, draw, check, repeat=20, simpler=tuple(driving.ENTRIES))
