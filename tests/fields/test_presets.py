from functools import cache

import pytest
import torch

from avatarrex.fields.body import BodyField
from avatarrex.fields.code import kl_loss, sample_latent
from avatarrex.fields.face import FaceField
from avatarrex.fields.hand import HandField
from avatarrex.fields.presets import COMPACT, PAPER, Preset
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.templates.model import pose_template
from avatarrex.templates.person import load_person

PAPER_COUNTS = {"face geometry": 0.66e6, "face colour": 1.10e6, "body geometry": 0.98e6, "body colour": 17.57e6}
"""Differences of the paper's table of training statistics, as read in the design notes."""


@cache
def body_field(preset: Preset) -> BodyField:
    torch.manual_seed(0)
    return BodyField(load_person().body, preset)


def count(parameters) -> int:
    return sum(p.numel() for p in parameters)


def counts(preset: Preset) -> dict[str, int]:
    person, body = load_person(), body_field(preset)
    hand, face = HandField(person.left_hand, preset), FaceField(person.face, preset)
    geometry = count(face.geometry.parameters())
    return {
        "face geometry": geometry,
        "face colour": count(face.parameters()) - geometry,
        "body geometry": count(body.geometry_parameters()),
        "body colour": count(body.colour_parameters()) + 2 * count(hand.parameters()),
    }


def test_paper_preset_meets_the_papers_counts(capsys):
    found = counts(PAPER)
    with capsys.disabled():
        for name, number in found.items():
            print(f"\n  {name}: {number / 1e6:.3f} M (paper {PAPER_COUNTS[name] / 1e6:.2f} M)", end="")
    for name, number in found.items():
        assert 0.9 < number / PAPER_COUNTS[name] < 1.1, name


def test_every_body_parameter_is_counted_once():
    field = body_field(COMPACT)
    assert count(field.parameters()) == count(field.geometry_parameters()) + count(field.colour_parameters())


def test_compact_avatar_fits_in_16_megabytes():
    found = counts(COMPACT)
    print({name: f"{number / 1e6:.2f} M" for name, number in found.items()})
    assert 2 * sum(found.values()) < 16e6, "two bytes each"
    assert count(body_field(COMPACT).parameters()) < 5e6


@pytest.mark.parametrize("preset", [PAPER, COMPACT], ids=lambda p: p.name)
def test_every_parameter_receives_a_gradient(preset):
    """One point at every node reaches all local networks; the encoder through the latent and the KL term."""
    field = body_field(preset)
    model = field.template
    generator = torch.Generator().manual_seed(0)
    pose = torch.zeros(len(model.parents), 3)
    pose[1:22] = 0.2 * torch.randn(21, 3, generator=generator)
    rotation = matrix_from_rotvec(pose[1:22])
    posed = pose_template(model, pose, torch.zeros(10), torch.zeros(model.expression_dirs.shape[2]))
    mean, log_variance = field.code_network.posterior(rotation, torch.randn(preset.body.latent, generator=generator))
    frame = field.frame(posed, field.code(rotation, sample_latent(mean, log_variance)))
    points = frame.node_position.detach() + 0.03 * torch.randn(20, len(frame.node_position), 3, generator=generator)
    points = points.reshape(-1, 3)
    view = torch.nn.functional.normalize(points, dim=-1)
    colour = field.colour(frame, field.patches(frame), points, view)
    loss = field.sdf(frame, points).square().sum() + colour.square().sum() + kl_loss(mean, log_variance)
    field.zero_grad()
    loss.backward()
    for name, parameter in field.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
        assert parameter.grad.abs().max() > 0, name
    field.zero_grad()
