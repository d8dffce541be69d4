"""What is painted follows a body whose skinning weights are not the template's."""

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from avatarrex.fields.local_frame import Neighbours, Samples
from avatarrex.fields.slide import CARRIERS, JOINTS, MOST, Slide, carriers, slide_basis
from avatarrex.ops.skinning import blend, invert_affine, skin


def posed(noise: torch.Generator) -> Tensor:
    """Every joint turned by some 15° about a place of its own."""
    turn = torch.from_numpy(Rotation.from_rotvec(0.15 * torch.randn(JOINTS, 3, generator=noise).numpy()).as_matrix())
    about = 0.2 * torch.randn(JOINTS, 3, generator=noise)
    matrices = torch.eye(4).repeat(JOINTS, 1, 1)
    matrices[:, :3, :3] = turn.float()
    matrices[:, :3, 3] = about - (turn.float() @ about[:, :, None])[:, :, 0]
    return matrices


def samples_at(rest: Tensor, back: Tensor, slide: Tensor | None) -> Samples:
    return Samples(rest, rest, torch.zeros_like(rest), back, torch.zeros(len(rest), dtype=torch.long), 0.015, slide)


def test_other_weights_are_found_back() -> None:
    """A point that moved by weights w + d lies, by the template's w, where the slide by -d takes back where it was."""
    noise = torch.Generator().manual_seed(0)
    rest = 0.3 * torch.randn(40, 3, generator=noise)
    weights = torch.rand(40, JOINTS, generator=noise).softmax(1)
    share = 0.02 * torch.randn(40, JOINTS, generator=noise)
    share -= share.mean(1, keepdim=True)
    matrices = posed(noise)
    back = invert_affine(blend(matrices, weights))
    position = skin(blend(matrices, weights + share), rest)
    slide = Slide(-share)
    slide.reach = torch.eye(40)
    samples = samples_at(rest, back, slide.offset(back, matrices, rest))
    alone = Neighbours(torch.arange(40)[:, None], torch.ones(40, 1))
    off = (samples.rest_position(position, alone) - rest).norm(dim=1)
    left = (samples.painted_position(position, alone) - rest).norm(dim=1)
    assert off.mean() > 0.003
    assert left.mean() < 0.2 * off.mean()


def test_the_offset_is_the_sum_over_joints() -> None:
    noise = torch.Generator().manual_seed(2)
    rest, matrices = 0.3 * torch.randn(30, 3, generator=noise), posed(noise)
    back = invert_affine(blend(matrices, torch.rand(30, JOINTS, generator=noise).softmax(1)))
    slide = Slide(0.001 * torch.randn(30, JOINTS, generator=noise))
    slide.reach = torch.eye(30)
    wanted = (slide.share[:, :, None] * slide_basis(back, matrices, rest)).sum(1)
    assert wanted.norm(dim=1).mean() > 3e-4
    torch.testing.assert_close(slide.offset(back, matrices, rest), wanted, atol=2e-6, rtol=1e-2)


def test_nothing_slides_farther_than_cloth() -> None:
    noise = torch.Generator().manual_seed(1)
    slide = Slide(100 * torch.randn(5, JOINTS, generator=noise))
    rest = torch.randn(30, 3, generator=noise)
    slide.lay(torch.randn(5, 3, generator=noise), rest)
    offset = slide.offset(torch.eye(3, 4).expand(30, 3, 4), posed(noise), rest)
    assert offset.norm(dim=1).max() < 1.001 * MOST
    assert offset.norm(dim=1).min() > 0.9 * MOST


def test_samples_take_their_slide_along() -> None:
    rest = torch.randn(6, 3)
    back = torch.eye(3, 4).repeat(6, 1, 1)
    samples = samples_at(rest, back, torch.arange(18.0).view(6, 3))
    kept = samples.among(torch.tensor([True]))
    assert torch.equal(kept.slide, samples.slide)  # type: ignore[arg-type]
    assert samples_at(rest, back, None).among(torch.tensor([True])).slide is None


def test_a_node_is_carried_by_the_joints_beside_it() -> None:
    joints = torch.arange(55.0)[:, None].expand(-1, 3)
    chosen = carriers(torch.tensor([[4.1, 4.1, 4.1]]), joints)
    assert chosen.sum() == CARRIERS
    assert chosen[0, 4]
    assert not chosen[0, 8:].any()
