"""LPIPS on weights of the right shape, its files, and what stands in for it without them."""

import logging
import zipfile

import pytest
import torch
from safetensors.torch import save_file

from avatarrex.errors import InputError
from avatarrex.metrics import perceptual
from avatarrex.metrics.image import ms_ssim
from avatarrex.metrics.perceptual import BLOCKS, HEADS_FILE, VGG_FILE, Lpips, Perceptual, VggFeatures, load_lpips

CONVOLUTIONS = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
"""Where torch hub's VGG-16 has its convolutions."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Random weights under the names of the true files."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    vgg = VggFeatures().state_dict()
    vgg["classifier.0.weight"] = torch.zeros(2, 2)
    torch.save(vgg, folder / VGG_FILE)
    save_file(vgg, folder / "vgg.safetensors")
    heads = {f"lin{k}.model.1.weight": torch.rand(1, block[-1], 1, 1) for k, block in enumerate(BLOCKS)}
    torch.save(heads, folder / "vgg.pth")
    with zipfile.ZipFile(folder / "lpips-0.1.4-py3-none-any.whl", "w") as wheel:
        wheel.write(folder / "vgg.pth", HEADS_FILE)
    return folder


@pytest.fixture
def nowhere(monkeypatch, tmp_path):
    """A machine without any weights."""
    monkeypatch.delenv("AVATARREX_VGG", raising=False)
    monkeypatch.delenv("AVATARREX_LPIPS", raising=False)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(perceptual.importlib.util, "find_spec", lambda name: None)
    return tmp_path


def noise(seed, side=40):
    return torch.rand(2, 3, side, side, generator=torch.Generator().manual_seed(seed))


def test_the_network_has_torch_hubs_names_and_vggs_shapes():
    state = VggFeatures().state_dict()
    assert list(state) == [f"features.{k}.{part}" for k in CONVOLUTIONS for part in ("weight", "bias")]
    assert sum(value.numel() for value in state.values()) == 14_714_688
    shapes = [tuple(layer.shape[1:]) for layer in VggFeatures()(noise(0, 64))]
    assert shapes == [(64, 64, 64), (128, 32, 32), (256, 16, 16), (512, 8, 8), (512, 4, 4)]


@pytest.mark.parametrize("vgg", [VGG_FILE, "vgg.safetensors"])
@pytest.mark.parametrize("heads", ["vgg.pth", "lpips-0.1.4-py3-none-any.whl"])
def test_equal_pictures_are_at_distance_zero_and_others_apart(files, vgg, heads):
    lpips = load_lpips(files / vgg, files / heads)
    a, b = noise(1), noise(2)
    assert lpips(a, a).tolist() == [0, 0]
    assert (lpips(a, b) > 1e-3).all()
    torch.testing.assert_close(lpips(a, b), lpips(b, a))


def test_the_heads_weigh_squared_differences_of_unit_features(files):
    lpips = load_lpips(files / VGG_FILE, files / "vgg.pth")
    a, b = noise(1), noise(2)
    shift, scale = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.450])
    expected = 0
    pairs = zip(*(lpips.network((2 * x - 1 - shift.view(3, 1, 1)) / scale.view(3, 1, 1)) for x in (a, b)))
    for (x, y), head in zip(pairs, lpips.heads.parameters()):
        x, y = (torch.nn.functional.normalize(f, dim=1) for f in (x, y))
        expected = expected + torch.einsum("bchw,c->bhw", (x - y) ** 2, head.flatten()).mean((1, 2))
    torch.testing.assert_close(lpips(a, b), expected, rtol=1e-4, atol=1e-7)


def test_a_mask_sees_only_its_half(files):
    lpips = load_lpips(files / VGG_FILE, files / "vgg.pth")
    a = noise(1, 128)
    b = a.clone()
    b[..., :16] = noise(2, 128)[..., :16]
    right = torch.zeros(2, 128, 128)
    right[..., 112:] = 1
    whole = lpips(a, b)
    torch.testing.assert_close(lpips(a, b, torch.ones(2, 128, 128)), whole)
    assert (lpips(a, b, right) < 0.1 * whole).all()


def test_gradients_flow_into_the_picture_and_not_into_the_weights(files, nowhere):
    loss = Perceptual.load(files / VGG_FILE, files / "vgg.pth")
    assert loss.name == "lpips-vgg"
    black = torch.zeros(1, 3, 32, 32, requires_grad=True)  # silent cells: no NaN
    loss(black, noise(2, 32)[:1]).backward()
    assert torch.isfinite(black.grad).all()
    assert black.grad.abs().max() > 0
    assert not any(parameter.requires_grad for parameter in loss.parameters())


def test_gradient_agrees_with_finite_differences(files):
    lpips = load_lpips(files / VGG_FILE, files / "vgg.pth").double()
    a, b = noise(1, 16)[:1].double().requires_grad_(), noise(2, 16)[:1].double()
    (slope,) = torch.autograd.grad(lpips(a, b).sum(), a)
    direction = torch.randn(a.shape, dtype=a.dtype, generator=torch.Generator().manual_seed(4))
    step = 1e-6
    with torch.no_grad():
        rise = (lpips(a + step * direction, b) - lpips(a - step * direction, b)) / (2 * step)
    assert rise.item() == pytest.approx((slope * direction).sum().item(), rel=1e-4)


def test_without_weights_ms_ssim_stands_in_and_says_so(nowhere, caplog):
    with caplog.at_level(logging.WARNING):
        loss = Perceptual.load()
    assert loss.name == "ms-ssim"
    assert VGG_FILE in caplog.text
    a, b = noise(1, 128), noise(2, 128)
    torch.testing.assert_close(loss(a, b), 1 - ms_ssim(a, b).mean())
    assert loss(a, a).item() == pytest.approx(0, abs=1e-6)


def test_weights_are_found_in_torch_hubs_folder_and_by_variable(files, nowhere, monkeypatch):
    (nowhere / "checkpoints").symlink_to(files)
    assert "lpips" in Perceptual.load().note  # no heads yet
    monkeypatch.setenv("AVATARREX_LPIPS", str(files))
    assert Perceptual.load().name == "lpips-vgg"
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(nowhere / "none"))
    assert Perceptual.load().name == "ms-ssim"
    monkeypatch.setenv("AVATARREX_VGG", str(files / "vgg.safetensors"))
    assert Perceptual.load().name == "lpips-vgg"


def test_named_files_must_be_there_and_whole(files, nowhere, monkeypatch):
    with pytest.raises(InputError, match="nothing at"):
        Perceptual.load(nowhere / "none.pth")
    torn = nowhere / "torn.pth"
    torn.write_bytes((files / VGG_FILE).read_bytes()[:10_000])
    with pytest.raises(InputError, match="a file of tensors"):
        Perceptual.load(torn, files / "vgg.pth")
    with pytest.raises(InputError, match=r"features\.0\.weight"):
        Perceptual.load(files / "vgg.pth", files / "vgg.pth")
    with pytest.raises(InputError, match=r"lin0\.model\.1\.weight"):
        Perceptual.load(files / VGG_FILE, files / VGG_FILE)
    broken = dict(VggFeatures().state_dict())
    broken["features.5.weight"] = broken["features.5.weight"] * float("nan")
    torch.save(broken, nowhere / "nan.pth")
    with pytest.raises(InputError, match=r"features\.5\.weight: expected .* finite"):
        Perceptual.load(nowhere / "nan.pth", files / "vgg.pth")
    monkeypatch.setenv("AVATARREX_VGG", str(nowhere / "gone"))
    with pytest.raises(InputError, match="AVATARREX_VGG"):
        Perceptual.load()


def test_a_pickled_program_is_not_run(files, nowhere):
    class Evil:
        def __reduce__(self):
            return (exec, ("raise SystemExit",))

    torch.save({"features.0.weight": Evil()}, nowhere / "evil.pth")
    with pytest.raises(InputError, match="a file of tensors"):
        Perceptual.load(nowhere / "evil.pth", files / "vgg.pth")


def test_small_pictures_are_refused():
    with pytest.raises(InputError, match="at least 16 pixels"):
        Lpips()(noise(1, 15), noise(2, 15))
