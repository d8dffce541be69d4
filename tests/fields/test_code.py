import math

import pytest
import torch
from arm import rotations

from avatarrex.fields.code import (
    RESIDUAL,
    BodyCode,
    DetailCode,
    embedding_loss,
    kl_loss,
    node_loss,
    pose_feature,
    sample_latent,
)


@pytest.fixture
def network():
    torch.manual_seed(0)
    return DetailCode(nodes=5, embedding=3, latent=2, decoder=(8,), encoder=(8,))


def test_pose_feature_is_zero_at_rest():
    assert pose_feature(torch.eye(3).expand(21, 3, 3)).abs().max() == 0
    assert pose_feature(rotations()).shape == (189,)


def test_shapes_with_and_without_a_batch(network):
    one = network(rotations())
    assert one.residual.shape == (5, 3)
    assert one.embedding.shape == (5, 3)
    batch = network(torch.stack([rotations(0), rotations(1)]), torch.zeros(2, 2))
    torch.testing.assert_close(batch.residual[0], one.residual)
    torch.testing.assert_close(batch.embedding[0], one.embedding)


def test_test_time_latent_is_zero(network):
    pose = rotations()
    torch.testing.assert_close(network(pose).embedding, network(pose, torch.zeros(2)).embedding)
    assert not torch.allclose(network(pose).embedding, network(pose, torch.ones(2)).embedding)


def test_outputs_are_bounded_for_any_pose(network):
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.mul_(1e4)
    code = network(rotations(angle=3.0))
    assert code.residual.abs().max() <= RESIDUAL
    assert code.embedding.abs().max() <= 1


def test_codes_are_clamped_to_the_middle_of_the_training_poses_until_unclamped(network):
    seen, far = torch.stack([rotations(seed, 0.3) for seed in range(11)]), rotations(99, angle=3.0)
    with torch.no_grad():
        free, before = network(seen), network(far)
        network.clamp_to(seen)
        clamped, after = network(seen), network(far)
    low, high = free.embedding.sort(0).values[[2, 8]]
    assert ((after.embedding >= low - 1e-7) & (after.embedding <= high + 1e-7)).all()
    inside = (free.embedding >= low) & (free.embedding <= high)
    assert 0.5 < inside.float().mean() < 0.8
    assert torch.equal(clamped.embedding[inside], free.embedding[inside]), "most of what was seen stays"
    assert not torch.equal(before.embedding, after.embedding), "that pose is far"
    assert (
        (after.residual - free.residual.mean(0)).abs() <= (free.residual - free.residual.mean(0)).abs().amax(0)
    ).all()
    network.unclamp()
    assert torch.equal(network(far).embedding, before.embedding)


def test_losses_in_closed_form():
    code = BodyCode(torch.tensor([[3.0, 4, 0], [0, 0, 0]]), torch.tensor([[1.0], [2.0]]))
    assert node_loss(code) == 12.5
    assert embedding_loss(code) == 2.5
    assert kl_loss(torch.zeros(4), torch.zeros(4)) == 0
    mean, variance = 0.7, 2.5
    expected = 0.5 * (mean**2 + variance - 1 - math.log(variance))
    found = kl_loss(torch.tensor([mean], dtype=torch.float64), torch.tensor([variance], dtype=torch.float64).log())
    assert math.isclose(found, expected, rel_tol=1e-12)


def test_kl_matches_torch():
    mean, log_variance = torch.randn(3, 4), torch.randn(3, 4)
    normal = torch.distributions.Normal(mean, torch.exp(log_variance / 2))
    expected = torch.distributions.kl_divergence(normal, torch.distributions.Normal(0.0, 1.0)).sum(-1).mean()
    torch.testing.assert_close(kl_loss(mean, log_variance), expected)


def test_latent_samples_have_the_posterior_moments():
    torch.manual_seed(0)
    mean, log_variance = torch.tensor([1.0, -2.0]), torch.tensor([0.0, 1.4])
    samples = sample_latent(mean.expand(40000, 2), log_variance.expand(40000, 2))
    torch.testing.assert_close(samples.mean(0), mean, atol=0.04, rtol=0)
    torch.testing.assert_close(samples.var(0).log(), log_variance, atol=0.04, rtol=0)


def test_posterior_depends_on_pose_and_frame(network):
    base = network.posterior(rotations(), torch.zeros(2))
    for other in (network.posterior(rotations(1), torch.zeros(2)), network.posterior(rotations(), torch.ones(2))):
        assert not torch.allclose(base[0], other[0])
        assert not torch.allclose(base[1], other[1])
