"""Every term of the losses alone: what it moves, in which direction, and how much; closed forms where there are any."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest
import torch
from training.miniature import perturbed, write_miniature

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.fields.code import BodyCode, embedding_loss, kl_loss, node_loss
from avatarrex.fields.composition import Composed
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.shading.colour import SurfaceColour
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.losses import NEARBY, eikonal_loss, mask_loss, rgb_loss, silhouette_loss, skin_loss
from avatarrex.training.core.stage import Stage
from avatarrex.training.core.work import Work, pass_of
from avatarrex.training.recipe import QUICK, LossWeights

STEPS = 6
ALONE = {
    ("I", "rgb"): ({"colour", "geometry"}, set(), 0.05),
    ("I", "mask"): ({"geometry"}, {"colour", "hands", "tone"}, 0.05),
    ("I", "silhouette"): ({"geometry"}, {"colour", "hands", "tone"}, 0.05),
    ("I", "eikonal"): ({"geometry"}, {"colour", "hands", "tone"}, 0.05),
    ("I", "node"): ({"decoder", "encoder"}, {"geometry", "colour", "hands", "tone"}, 0.20),
    ("I", "embedding"): ({"decoder", "encoder"}, {"geometry", "colour", "hands", "tone"}, 0.20),
    ("I", "kl"): ({"encoder"}, {"decoder", "geometry", "colour", "hands", "tone"}, 0.20),
    ("I", "tone"): ({"tone"}, {"decoder", "encoder", "geometry", "colour", "hands"}, 0.05),
    ("II", "rgb"): ({"colour"}, {"decoder", "encoder", "geometry"}, 0.05),
    ("II", "perceptual"): ({"colour"}, {"decoder", "encoder", "geometry"}, 0.02),
    ("II", "tone"): ({"tone"}, {"decoder", "encoder", "geometry", "colour"}, 0.05),
}
"""By pass and term: what moves, what does not, and the share of the term that a few steps on one batch take away at least."""


def test_colours_are_pulled_to_the_truth_by_their_error():
    colour = torch.tensor([[0.2, 0.5, 0.9], [0.4, 0.4, 0.4]], requires_grad=True)
    truth, weight = torch.tensor([[0.5, 0.5, 0.5], [0.1, 0.4, 0.4]]), torch.tensor([1.0, 3.0])
    loss = rgb_loss(colour, truth, weight).value
    assert float(loss.detach()) == pytest.approx((0.25 / 3 + 3 * 0.09 / 3) / 4)
    (slope,) = torch.autograd.grad(loss, colour)
    torch.testing.assert_close(slope, 2 * (colour - truth).detach() * weight[:, None] / (3 * 4))


def test_opacity_is_pulled_to_the_matte_by_one_share_a_ray():
    opacity = torch.tensor([0.2, 0.9, 0.6], requires_grad=True)
    loss = mask_loss(opacity, torch.tensor([1.0, 0.0, 1.0]), torch.tensor([1.0, 1.0, 2.0])).value
    assert float(loss.detach()) == pytest.approx((0.8 + 0.9 + 2 * 0.4) / 4)
    (slope,) = torch.autograd.grad(loss, opacity)
    torch.testing.assert_close(slope, torch.tensor([-0.25, 0.25, -0.5]))


def test_a_silhouette_is_pushed_by_what_it_lacks():
    """Outside where the person is: inwards; on the person where the background is: outwards; half way on the edge."""
    lowest = torch.tensor([0.002, -0.002, -0.001], requires_grad=True)
    matte, width = torch.tensor([1.0, 0.0, 0.5]), torch.full((3,), 0.001)
    loss = silhouette_loss(lowest, width, matte, torch.ones(3)).value
    assert float(loss.detach()) == pytest.approx((0.0025 + 0.0025 + 0.001) / 3 / NEARBY)
    (slope,) = torch.autograd.grad(loss, lowest)
    torch.testing.assert_close(slope, torch.tensor([1.0, -1.0, -1.0]) / (3 * NEARBY))


class Scaled:
    """The distance to a ball, `factor` times."""

    def __init__(self, factor: torch.Tensor) -> None:
        self.factor = factor

    def alone(self, position: torch.Tensor) -> torch.Tensor:
        return self.factor * (position.norm(dim=-1) - 0.1)

    def composed(self, position: torch.Tensor) -> Composed:
        raise NotImplementedError

    def around(self, count: int, noise: torch.Generator) -> torch.Tensor:
        raise NotImplementedError

    def paint(self) -> SurfaceColour:
        raise NotImplementedError


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.6])
def test_slopes_are_pulled_to_one(factor):
    scale = torch.tensor(factor, requires_grad=True)
    points = torch.randn(200, 3, generator=torch.Generator().manual_seed(0))
    loss = eikonal_loss(Scaled(scale), points).value
    assert float(loss.detach()) == pytest.approx((factor - 1) ** 2, abs=1e-6)
    (slope,) = torch.autograd.grad(loss, scale)
    assert float(slope) == pytest.approx(2 * (factor - 1), abs=1e-5)


def test_a_faces_surface_is_pulled_to_its_mesh_from_either_side():
    distance = torch.tensor([0.002, -0.001, 0.003, -0.002], requires_grad=True)
    loss = skin_loss(distance)
    assert float(loss.detach()) == pytest.approx(0.002 / NEARBY)
    (slope,) = torch.autograd.grad(loss, distance)
    torch.testing.assert_close(slope, torch.tensor([1.0, -1.0, 1.0, -1.0]) / (4 * NEARBY))


def test_codes_are_pulled_to_nothing():
    residual, embedding = torch.full((4, 3), 0.02, requires_grad=True), torch.full((4, 5), -0.3, requires_grad=True)
    code = BodyCode(residual, embedding)
    assert float(node_loss(code).detach()) == pytest.approx(3 * 0.02**2)
    assert float(embedding_loss(code).detach()) == pytest.approx(5 * 0.3**2)
    slopes = torch.autograd.grad(node_loss(code) + embedding_loss(code), (residual, embedding))
    torch.testing.assert_close(slopes, (torch.full((4, 3), 0.01), torch.full((4, 5), -0.15)))


def test_the_posterior_is_pulled_to_the_prior():
    mean, log_variance = torch.tensor([[1.0, -2.0]], requires_grad=True), torch.tensor([[0.0, 1.0]], requires_grad=True)
    loss = kl_loss(mean, log_variance)
    e = torch.tensor(1.0).exp()
    assert float(loss.detach()) == pytest.approx(0.5 * (1 + 4 + float(e) - 2), rel=1e-6)
    slopes = torch.autograd.grad(loss, (mean, log_variance))
    torch.testing.assert_close(slopes, (torch.tensor([[1.0, -2.0]]), torch.stack([torch.zeros(()), (e - 1) / 2])[None]))


def test_the_perceptual_term_wants_the_edges_back():
    """Of a blurred picture a few steps along its gradient give the contrast back; of the truth there is nothing to gain."""
    truth = torch.rand(1, 3, 48, 48, generator=torch.Generator().manual_seed(0))
    blurred = torch.nn.functional.avg_pool2d(truth, 3, 1, 1)
    perceptual, picture = Perceptual(None, "test"), blurred.clone().requires_grad_(True)
    assert float(perceptual(truth, truth)) == pytest.approx(0, abs=1e-6)
    before = float(perceptual(blurred, truth))
    optimiser = torch.optim.Adam([picture], lr=0.02)
    for _ in range(8):
        optimiser.zero_grad()
        perceptual(picture, truth).backward()
        optimiser.step()
    assert float(perceptual(picture.detach(), truth)) < 0.7 * before
    assert (picture.detach() - truth).square().mean() < 0.9 * (blurred - truth).square().mean()


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> tuple[Avatar, dict[str, FrameStore]]:
    """A perturbed avatar before a miniature capture."""
    folder: Path = write_miniature(tmp_path_factory.mktemp("terms"), "body")
    rig, avatar = open_capture(folder).rigs["body"], perturbed("body", 0)
    with torch.no_grad():  # a tone that is off
        for parameter in avatar.tone.parameters():
            parameter.add_(0.05)
    stores = {name: FrameStore(avatar, rig, "body", frozenset({"face"}), name == "II") for name in ("I", "II")}
    for store in stores.values():
        store.renew(0)
    return avatar, stores


def groups(avatar: Avatar) -> dict[str, list[torch.nn.Parameter]]:
    """What a term may move."""
    body, code = avatar.body, avatar.body.code_network
    return {
        "decoder": [*code.decoder.parameters()],
        "encoder": [*code.encoder.parameters()],
        "geometry": [*body.geometry_local.parameters(), *body.geometry_blend.parameters()],
        "colour": body.colour_parameters(),
        "hands": [*avatar.left_hand.parameters(), *avatar.right_hand.parameters()],
        "tone": [*avatar.tone.parameters()],
    }


@pytest.mark.parametrize(("name", "term"), ALONE)
def test_a_term_alone_moves_what_it_should(seen, name, term):
    """Downhill, and nothing else: `STEPS` steps on one batch, all other weights at 0."""
    avatar, stores = seen
    kept = {
        part: {key: value.clone() for key, value in module.state_dict().items()}
        for part, module in avatar.modules().items()
    }
    weights = LossWeights(**{field.name: float(field.name == term) for field in fields(LossWeights)})
    one, two = QUICK.body
    if name == "I":
        outline = 400 if term == "silhouette" else 0
        recipe = replace(one, rays=200, outline=outline, latent=True, geometry_rate=1.0, rate=1e-3, weights=weights)
    else:
        recipe = replace(two, patch=64, rate=1e-3, weights=weights)
    stage = Stage("body", name, recipe, 0)
    work = Work(stage, pass_of(stage, avatar, stores[name], Perceptual(None, "test"), 0), None)
    before = {group: [p.detach().clone() for p in parameters] for group, parameters in groups(avatar).items()}
    values = []
    try:
        for _ in range(STEPS + 1):
            result, total = work.evaluate()
            values.append(float(result.terms[term].detach()))
            assert float(total.detach()) == pytest.approx(values[-1], rel=1e-5), "its weight is 1, the others' 0"
            work.descend(total)
        moved = {
            group
            for group, parameters in groups(avatar).items()
            if any(not torch.equal(p, old) for p, old in zip(parameters, before[group]))
        }
    finally:
        work.close()
        for part, module in avatar.modules().items():
            module.load_state_dict(kept[part])
    moves, rests, share = ALONE[name, term]
    assert moves <= moved, f"{term} moved {moved} alone"
    assert not moved & rests, f"{term} moved {moved & rests}, too"
    assert values[-1] < (1 - share) * values[0], f"{term}: {values}"
