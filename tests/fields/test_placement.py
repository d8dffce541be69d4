"""Networks on another device than the rest: a stand-in for a GPU, and a GPU where there is one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from avatarrex_studio.cli.main import main
from capture.tiny_capture import TinyCapture
from elsewhere import DEVICE, Elsewhere, There
from tiny_recipe import TINY

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.errors import InputError
from avatarrex.fields.placement import networks
from avatarrex.levels import level
from avatarrex.measure.bench import frame
from avatarrex.measure.bench.session import Bench
from avatarrex.ops.native import one_thread
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_hand, named_pose
from avatarrex.training.core import trainer as train_module
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.losses import weighted
from avatarrex.training.core.pass_one import BodyPass, FacePass
from avatarrex.training.core.trainer import Trainer
from avatarrex.training.recipe import SMOKE
from avatarrex.training.runs.events import EventReader
from avatarrex.training.runs.folder import Run

CAMERA = Camera.orbit(20, 5, 2.4, 40, (0, -0.05, 0), 48, 48)
SETTINGS = RenderSettings(voxel=0.03, part_voxel=0.01, raycast="torch")
GPU = pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"))
DEVICES = [pytest.param("meta", id="stand-in"), GPU]


@contextmanager
def machine(device: str) -> Iterator[None]:
    """One that has the device."""
    if device == "cuda":
        yield
    else:
        with one_thread(), Elsewhere():  # torch's modes are of one thread
            yield


def there(module: torch.nn.Module, device: str) -> bool:
    """Whether all networks are."""
    return all(p.device.type == device for network in networks(module) for p in network.parameters())


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
def test_a_frame_is_the_same_wherever_its_networks_run(device: str) -> None:
    signals = Signals.rest().replace(body_pose=named_pose("wave"), right_hand_pose=named_hand("fist", "right"))
    want = render_frame(load_avatar(), signals, CAMERA, SETTINGS)
    with machine(device):
        avatar = load_avatar(device=device)
        found = render_frame(avatar, signals, CAMERA, SETTINGS)
    assert all(there(module, device) for module in avatar.modules().values())
    assert (want.device, found.device.split(":")[0]) == ("cpu", device)
    assert type(found.image) is torch.Tensor
    assert torch.equal(found.pointmap.hit, want.pointmap.hit)
    torch.testing.assert_close(found.image, want.image, atol=2e-4, rtol=0)


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
def test_the_bench_measures_frames_there(device: str, monkeypatch) -> None:
    """The errors of one level will do: of all, test_bench_stages.py tells."""
    monkeypatch.setattr(frame, "DEFERRED_LEVELS", {frame.EVERYDAY: level(frame.EVERYDAY)})
    with machine(device):
        bench = Bench(quick=True, scale=0.03, device=device)
        found = {metric.name: metric for metric in frame.of_a_gpu(bench)}
    view = found["frame.view_1024_fps"]
    assert view.error is not None
    assert view.error["networks"].split(":")[0] == device
    assert view.error["pixels"] > 3
    assert view.target == (300 if device == "cuda" else None)
    assert not any(there(module, device) for module in bench.avatar.modules().values() if networks(module)), (
        "the oracle's"
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture."""
    return TinyCapture.make(("body", "face")).folder(tmp_path_factory.mktemp("placed") / "capture")


@pytest.fixture(scope="module")
def rig(folder: Path) -> dict[str, Rig]:
    """Its rigs."""
    return dict(open_capture(folder).rigs)


def gradients(avatar: Avatar, rig: Rig, part: str) -> dict[str, torch.Tensor]:
    """Of one step of pass I."""
    store = FrameStore(avatar, rig, part, frozenset())
    store.renew(0)
    kind = {"body": BodyPass, "face": FacePass}[part]
    work = kind(avatar, store, getattr(SMOKE, part)[0], 0)
    for parameter in work.parameters():
        parameter.requires_grad_(True)
    weighted(work.step(3, 0.01).terms, work.recipe.weights).backward()
    named = avatar.modules()[part].named_parameters()
    return {name: p.grad.cpu() for name, p in named if p.grad is not None}


@pytest.mark.parametrize("part", ["body", "face"])
@pytest.mark.parametrize("device", DEVICES)
def test_a_training_step_has_the_same_gradients(device: str, part: str, rig: dict[str, Rig]) -> None:
    want = gradients(load_avatar(), rig[part], part)
    with machine(device):
        found = gradients(load_avatar(device=device), rig[part], part)
    assert set(found) == set(want)
    for name, value in want.items():
        scale = float(value.abs().max())
        assert (found[name] - value).abs().max() <= 0.02 * scale + 1e-9, name


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.filterwarnings(
    "ignore:.*copying from a non-meta parameter.*:UserWarning"
)  # it has the numbers all the same
def test_both_passes_train_there_and_go_on_from_a_checkpoint(device: str, folder: Path, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("avatarrex.training.core.held_out.PICTURES", 1)
    monkeypatch.setattr(train_module, "REPORT", 1)
    if device == "meta":  # which has no fused steps
        adam = torch.optim.Adam
        monkeypatch.setattr(torch.optim, "Adam", lambda *given, **named: adam(*given, **{**named, "fused": False}))
    config = {"part": "face,body", "preset": "tiny", "capture": str(folder), "seed": 0, "steps": TINY.steps()}
    with machine(device):
        with Run.create(tmp_path / "run", config) as run:
            trainer = Trainer(open_capture(folder), TINY, run, device=device)
            trainer.interruption.requested = True
            assert not trainer.train()
        with Run.open(tmp_path / "run") as run:
            trainer = Trainer(open_capture(folder), TINY, run, device=device)
            assert trainer.train()
        assert all(there(module, device) for module in trainer.avatar.modules().values())
    events = EventReader(tmp_path / "run")
    while events.poll():
        pass
    assert {f"{part}/loss/{name}" for part in ("face", "body") for name in ("rgb", "perceptual")} <= set(events.tags)
    last = sorted((tmp_path / "run" / "checkpoints").iterdir())[-1]
    assert load_avatar(last / "avatar.avatar").meta["origin"].startswith("trained from images")


def test_a_device_that_is_not_there_is_refused_in_one_line(capsys, tmp_path, monkeypatch) -> None:
    absent = "mps" if torch.cuda.is_available() else "cuda"
    for name in ("warp", "cuda:77", "meta", "hpu", "mkldnn", "cpu:1", "", absent):
        with pytest.raises(InputError, match=r"--device: expected what this torch can use here: cpu"):
            load_avatar(device=name)
    for verb in (["render", "a.png"], ["train", "capture", "--out", "run"], ["evaluate", "default", "c"], ["open"], []):
        for name in ("warp", "meta", "cpu:1", ""):
            with pytest.raises(SystemExit, match="2"):
                main([*verb, "--device", name])
            said = capsys.readouterr().err.strip()
            assert said.endswith(f"expected cpu, cuda, cuda:1, mps or xpu, found {name or 'nothing'}")
            assert len(said.splitlines()) == 1
    monkeypatch.chdir(tmp_path)
    assert main(["render", "a.png", "--device", absent]) == 2
    assert main(["train", "capture", "--out", "run", "--device", absent]) == 2
    assert [line.count("what this torch can use here") for line in capsys.readouterr().err.strip().splitlines()] == [
        1,
        1,
    ]
    assert not list(tmp_path.iterdir())


def test_what_was_trained_there_can_be_read_anywhere(tmp_path) -> None:
    with Elsewhere():
        avatar = load_avatar(device="meta")
        save_avatar(avatar, tmp_path / "there.avatar")
    found, want = load_avatar(tmp_path / "there.avatar").state(), load_avatar().state()
    assert set(found) == set(want)
    assert all(torch.equal(value, want[name]) for name, value in found.items())


def test_the_stand_in_fails_as_a_gpu_does() -> None:
    with Elsewhere():
        one = torch.ones(3).to(DEVICE)
        assert isinstance(one + 1, There)
        assert (one + 1).cpu().tolist() == [2, 2, 2]
        with pytest.raises(RuntimeError, match="tensors of two devices"):
            one + torch.ones(3)
        with pytest.raises(RuntimeError, match="numpy"):
            one.numpy()
