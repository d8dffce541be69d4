"""Exports: what each order writes, opened by other libraries; the process that writes it; nothing partial stays."""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace

import numpy as np
import pytest
from avatarrex_studio.cli import main as cli
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.jobs import export_order
from avatarrex_studio.jobs.export_look import Look
from avatarrex_studio.jobs.export_order import (
    CamerasOrder,
    LayersOrder,
    ModelOrder,
    PictureOrder,
    SignalsOrder,
    VideoOrder,
    turned,
)  # fmt: skip
from avatarrex_studio.jobs.export_picture import averaged
from avatarrex_studio.jobs.exporting import Exporting
from avatarrex_studio.panels.export_form import EXPORTED, ExportForm
from avatarrex_studio.session.state import StudioState
from ball import ball_engine, render_ball
from PIL import Image

from avatarrex.capture.readers.calibration import read_calibration
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.read import read_motion
from avatarrex.signals.sequence import SignalSequence
from avatarrex.stage.stage import PICTURE, Stage

STATE = StudioState()


def written(order):
    """Write it here; the steps that it told."""
    told = []
    order.check()
    order.write(ball_engine, told.append)
    return told


def test_pictures_have_alpha_metadata_samples_and_marks(tmp_path, capsys):
    look = Look((256, 200), 3, "balanced", True, "A label", True)
    assert written(PictureOrder(tmp_path / "a.png", STATE, look)) == [1]
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (256, 200)
        assert image.mode == "RGBA"
        pixels = np.asarray(image)
    assert pixels[:20, :20, 3].max() == 0
    assert pixels[100, 128, 3] == 255
    assert pixels[..., 3][(pixels[..., 3] > 0) & (pixels[..., 3] < 255)].size > 0, "edges are smooth"
    assert pixels[-24:, -100:, 3].max() > 150, "the label"
    assert cli.main(["inspect", str(tmp_path / "a.png")]) == 0
    told = capsys.readouterr().out
    assert "invisible mark: found" in told
    assert "level: balanced" in told
    written(PictureOrder(tmp_path / "a.jpg", STATE, Look((256, 200), marked=True)))
    with Image.open(tmp_path / "a.jpg") as image:
        image.resize((192, 150)).save(tmp_path / "b.jpg", quality=80, comment=b"")
    for name, state in (("a.jpg", True), ("b.jpg", False)):
        assert cli.main(["inspect", str(tmp_path / name)]) == 0
        told = capsys.readouterr().out
        assert "invisible mark: found" in told
        assert ("level: quality" in told) == state
    written(PictureOrder(tmp_path / "plain.png", STATE, Look((256, 200))))
    assert cli.main(["inspect", str(tmp_path / "plain.png")]) == 0
    assert "invisible mark: none" in capsys.readouterr().out


def test_a_stage_whose_picture_is_gone_is_refused_before_anything_is_written(tmp_path):
    stage = Stage(shown=True, backdrop=PICTURE, picture=str(tmp_path / "gone.png"))
    state = replace(STATE, stage=stage)
    for order in (PictureOrder, lambda path, state, look: VideoOrder(path.with_suffix(".mp4"), (state,), 12.0, look)):
        with pytest.raises(InputError, match=r"gone\.png"):
            order(tmp_path / "a.png", state, Look((64, 48), stage=True)).check()
    PictureOrder(tmp_path / "a.png", state, Look((64, 48))).check()


def test_samples_are_the_mean_of_premultiplied_pixels():
    import torch

    image = torch.arange(4 * 6 * 4.0).reshape(4, 6, 4)
    assert torch.equal(averaged(image, 2)[1, 2], image[2:4, 4:6].mean((0, 1)))


def test_videos_turn_and_keep_alpha(tmp_path):
    av = pytest.importorskip("av")
    states = turned([STATE] * 8, 1.0)
    assert [state.view.azimuth for state in states] == pytest.approx(np.arange(8) * 45.0)
    assert written(VideoOrder(tmp_path / "a.mp4", states, 12.0, Look((64, 48), level="balanced"))) == list(range(1, 9))
    written(VideoOrder(tmp_path / "a.webm", states, 12.0, Look((64, 48), level="balanced", clear=True)))
    for name, codec in (("a.mp4", "h264"), ("a.webm", "vp9")):
        with av.open(str(tmp_path / name)) as file:
            stream = file.streams.video[0]
            frames = list(file.decode(stream))
            assert (len(frames), stream.average_rate, stream.codec_context.name) == (8, 12, codec)
            assert (frames[0].width, frames[0].height) == (64, 48)
            if name == "a.webm":
                assert stream.metadata["alpha_mode"] == "1"
    written(VideoOrder(tmp_path / "frames", states[:3], 12.0, Look((64, 48), level="balanced")))
    assert sorted(os.listdir(tmp_path / "frames")) == [f"frame_{k:06d}.png" for k in range(3)]
    assert sorted(os.listdir(tmp_path)) == ["a.mp4", "a.webm", "frames"]


def test_layers_signals_and_cameras(tmp_path):
    library = pytest.importorskip("OpenEXR")
    written(LayersOrder(tmp_path / "a.exr", STATE, Look((40, 30), 2, "balanced")))
    with library.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        planes = {name: channel.pixels for name, channel in file.channels().items()}
    assert {plane.shape for plane in planes.values()} == {(30, 40)}
    assert planes["Z"][15, 20] == pytest.approx(np.linalg.norm(STATE.view.camera(40, 30).centre), rel=0.2)
    assert planes["N.Z"][15, 20] == 1
    assert (planes["Z"] > 0).sum() == pytest.approx((planes["A"] > 0.5).sum(), rel=0.1)
    frames = tuple(Signals.rest().replace(translation=np.array([0.0, 0.0, k])) for k in range(3))
    written(SignalsOrder(tmp_path / "a.npz", SignalSequence(frames, 24.0)))
    assert list(read_motion(tmp_path / "a.npz")) == list(frames)
    camera = STATE.view.camera(40, 30)
    written(CamerasOrder(tmp_path / "a.json", {"view": camera}))
    (lens,) = read_calibration((tmp_path / "a.json").read_text(), "a.json")
    assert np.allclose(lens.camera.camera_from_world, camera.camera_from_world)
    assert np.allclose(lens.camera.intrinsics, camera.intrinsics)


def test_models_are_opened_by_other_libraries(tmp_path):
    import pygltflib
    import trimesh

    engine = Engine()
    for name, clip in (
        ("a.ply", SignalSequence((STATE.signals,), 30.0)),
        ("a.glb", SignalSequence((STATE.signals,) * 2, 30.0, "two")),
    ):
        order = ModelOrder(tmp_path / name, "default", clip)
        order.check()
        order.write(lambda: engine, lambda done: None)
    assert len(trimesh.load(tmp_path / "a.ply").vertices) > 1000
    document = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    assert [animation.name for animation in document.animations] == ["two"]


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (PictureOrder(export_order.Path("a.bmp"), STATE, Look((64, 64))), r"\.png, \.jpg"),
        (PictureOrder(export_order.Path("a.jpg"), STATE, Look((64, 64), clear=True)), "opaque"),
        (PictureOrder(export_order.Path("a.png"), STATE, Look((4096, 64), 4)), "8192"),
        (PictureOrder(export_order.Path("a.png"), STATE, Look((128, 128), marked=True)), "192"),
        (PictureOrder(export_order.Path("/proc/a.png"), STATE, Look((64, 64))), "/proc"),
        (VideoOrder(export_order.Path("a.mp4"), (STATE,), 30.0, Look((63, 64))), "even"),
        (VideoOrder(export_order.Path("a.mp4"), (STATE,), 30.0, Look((64, 64), clear=True)), "webm"),
        (VideoOrder(export_order.Path("a.mp4"), (), 30.0, Look((64, 64))), "at least one"),
        (ModelOrder(export_order.Path("a.stl"), "default"), r"\.glb"),
    ],
)
def test_what_cannot_be_is_refused_before(order, words):
    with pytest.raises(InputError, match=words):
        order.check()


def slow_ball(avatar, signals, camera, settings, previous=None, between=None):
    time.sleep(0.05)
    return render_ball(avatar, signals, camera, settings, previous, between)


def slow_engine():
    return ball_engine(slow_ball)


class Refusing:
    """An order that finds out late that it cannot be."""

    path, steps = export_order.Path("none"), 1

    def check(self):
        return []

    def write(self, make, tell):
        raise InputError("none", "field", "another file", "this")


def until(process, ready, seconds=60.0):
    end = time.monotonic() + seconds
    while not ready():
        process.poll()
        assert time.monotonic() < end
        time.sleep(0.02)


def test_the_process_tells_cancels_and_refuses(tmp_path, caplog):
    caplog.set_level(0, "avatarrex_studio")
    process = Exporting(slow_engine)
    process.start(VideoOrder(tmp_path / "long", (STATE,) * 2000, 30.0, Look((64, 48), level="balanced")))
    process.start(SignalsOrder(tmp_path / "a.json", SignalSequence((STATE.signals,), 30.0)))
    until(process, lambda: process.progress and process.progress.done > 5)
    progress = process.progress
    assert progress.waiting == 1
    assert 0 < progress.seconds < 1000
    assert not (tmp_path / "long").exists(), "nothing has the final name before it is whole"
    process.cancel()
    until(process, lambda: process.progress is None or process.progress.path.name == "a.json")
    until(process, lambda: not process.busy)
    assert os.listdir(tmp_path) == ["a.json"], "nothing of the cancelled one stays"
    assert json.loads((tmp_path / "a.json").read_text())["fps"] == 30
    process.start(Refusing())
    until(process, lambda: not process.busy)
    assert caplog.records[-1].args[0].expected == "another file", "a refusal crosses whole"
    assert process.written == [tmp_path / "a.json"]
    process.start(VideoOrder(tmp_path / "long", (STATE,) * 2000, 30.0, Look((64, 48), level="balanced")))
    until(process, lambda: process.progress.done > 0)
    process.close()
    assert os.listdir(tmp_path) == ["a.json"], "nor of one that the window's end cuts off"


class Steps:
    """A motion of 100 frames at 50 a second, whose frame is its azimuth."""

    count, own, fps = 100, 100, 50.0

    def at(self, frame):
        return STATE.change(view=STATE.view.__class__(azimuth=float(frame)))


def test_the_stage_is_at_first_as_the_window_has_it_then_as_it_was_left():
    form = ExportForm()
    form.begin((64, 48), replace(STATE, stage=Stage(shown=True)), None)
    assert form.stage
    form.stage = False
    form.begin((64, 48), replace(STATE, stage=Stage(shown=True)), None)
    assert not form.stage


def test_the_form_makes_the_frames_of_a_range_at_a_rate(tmp_path):
    form = ExportForm(kind="Video", folder=str(tmp_path), name="clip", samples=2)
    form.begin((301, 201), STATE, Steps())
    assert (form.first, form.last, form.rate, form.size) == (0, 99, 50.0, (300, 200))
    form.first, form.last, form.rate = 10, 29, 25.0
    order = form.order(STATE, Steps())()
    assert order.path == tmp_path / "clip.mp4"
    assert [state.view.azimuth for state in order.states] == [10, 12, 14, 16, 18, 20, 22, 24, 26, 28]
    form.moving, form.seconds, form.turns = False, 2.0, 1.0
    turning = form.order(STATE, Steps())()
    assert turning.steps == form.count(Steps()) == 50
    assert turning.states[25].view.azimuth == pytest.approx(180)
    form.take(str(tmp_path / "other.webm"))
    assert form.path == tmp_path / "other.webm"
    for kind in EXPORTED:
        form.kind = kind
        assert form.path.suffix == EXPORTED[kind][0] or kind == "Video"
    form.kind, form.moving = "Camera", True
    assert list(form.order(STATE, Steps())().cameras) == [f"frame_{k:06d}" for k in range(20)]
