"""The Fréchet distance in closed form, and the network by its published size and names."""

import numpy as np
import pytest
import torch

from avatarrex.errors import InputError
from avatarrex.metrics.fid import INCEPTION_FILE, Inception, frechet_distance, load_inception


def frechet_reference(mean_a: np.ndarray, cov_a: np.ndarray, mean_b: np.ndarray, cov_b: np.ndarray) -> float:
    """The formula on means (d,) and covariances (d, d): squared Wasserstein-2 distance of two normal distributions."""
    value, vector = np.linalg.eigh(cov_a)
    root = (vector * np.sqrt(np.maximum(value, 0))) @ vector.T
    between = np.linalg.eigvalsh(root @ cov_b @ root)
    spread = np.trace(cov_a) + np.trace(cov_b) - 2 * np.sqrt(np.maximum(between, 0)).sum()
    return float(((mean_a - mean_b) ** 2).sum() + max(spread, 0.0))


def test_normals_that_differ_in_mean_and_scale():
    """Along common axes: |Δμ|² + Σ (σ₁ − σ₂)²."""
    a, b = np.array([1.0, 2.0, 0.0]), np.array([0.5, 2.0, 3.0])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    shift = np.array([0.3, -0.4, 1.2])
    found = frechet_reference(np.zeros(3), turn * a**2 @ turn.T, shift, turn * b**2 @ turn.T)
    assert found == pytest.approx((shift**2).sum() + ((a - b) ** 2).sum(), rel=1e-6)


def test_it_is_symmetric_unmoved_by_rotation_and_zero_for_equal_sets():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(20, 30)), rng.normal(1, 2, (25, 30))  # fewer than features: singular
    turn = np.linalg.qr(rng.normal(size=(30, 30)))[0]
    assert frechet_distance(a, b) == pytest.approx(frechet_distance(b, a))
    assert frechet_distance(a @ turn, b @ turn) == pytest.approx(frechet_distance(a, b))
    assert frechet_distance(a, a) == pytest.approx(0, abs=1e-6)
    assert frechet_distance(a, a + 0.5) == pytest.approx(30 * 0.25, abs=1e-6)


@pytest.mark.parametrize("count", [2, 12, 60])
def test_it_is_the_formula_on_covariances(count):
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(count, 20)), rng.normal(0.5, 1.5, (40, 20)) @ rng.normal(size=(20, 20))
    expected = frechet_reference(a.mean(0), np.cov(a, rowvar=False), b.mean(0), np.cov(b, rowvar=False))
    assert frechet_distance(a, b) == pytest.approx(expected, rel=1e-6)


def test_one_picture_has_no_spread():
    with pytest.raises(InputError, match="at least two"):
        frechet_distance(np.zeros((1, 4)), np.zeros((3, 4)))


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return Inception().eval()


def test_the_network_has_the_published_size_and_names(network):
    assert (
        sum(parameter.numel() for parameter in network.parameters()) == 21_785_568
    )  # Inception v3 without classifiers
    names = set(network.state_dict())
    for name in (
        "Conv2d_1a_3x3.conv.weight", "Mixed_5d.branch5x5_2.bn.running_mean", "Mixed_6a.branch3x3.conv.weight",
        "Mixed_6e.branch7x7dbl_5.conv.weight", "Mixed_7a.branch7x7x3_4.bn.bias", "Mixed_7c.branch3x3dbl_3b.conv.weight",
    ):  # fmt: skip
        assert name in names
    assert network.state_dict()["Mixed_6c.branch7x7_2.conv.weight"].shape == (160, 160, 1, 7)


def test_features_of_pictures_of_any_size(network):
    with torch.no_grad():
        features = network(torch.rand(2, 3, 64, 48, generator=torch.Generator().manual_seed(0)))
    assert features.shape == (2, 2048)
    assert (features >= 0).all()
    assert features.std() > 0


def test_weights_by_path_and_none(network, tmp_path, monkeypatch):
    monkeypatch.delenv("AVATARREX_INCEPTION", raising=False)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    assert load_inception() is None
    file = tmp_path / INCEPTION_FILE
    state = {name: value for name, value in network.state_dict().items() if "num_batches" not in name}
    torch.save({**state, "fc.weight": torch.zeros(1008, 4)}, file)
    loaded = load_inception(file)
    x = torch.rand(1, 3, 32, 32)
    torch.testing.assert_close(loaded(x), network(x))
    state.pop("Mixed_7b.branch1x1.bn.weight")
    torch.save(state, file)
    with pytest.raises(InputError, match=r"Mixed_7b\.branch1x1\.bn\.weight"):
        load_inception(file)
