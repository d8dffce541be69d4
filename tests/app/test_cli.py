"""The command line: what it writes, and one line with exit code 2 for every wrong value, before anything is written."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from avatarrex_studio import cli, headless, options
from avatarrex_studio.commands import ApplyPose, SetExpression, SetJoint, SetShape, SetTranslation
from avatarrex_studio.journal import Journal
from ball import ball_engine
from PIL import Image

from avatarrex.errors import InputError
from avatarrex.files import written
from avatarrex.images import VideoWriter, composite
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence
from avatarrex.signals.signals import Signals


@pytest.fixture
def quick(monkeypatch):
    """The command line on the quick stand-in for the pipeline."""
    assert headless.Engine is not ball_engine, "headless must know the true class before it is replaced"
    monkeypatch.setattr("avatarrex_studio.engine.Engine", ball_engine)


@pytest.fixture
def motion(tmp_path):
    frames = tuple(Signals.rest().replace(body_pose=np.full((21, 3), 0.02 * k)) for k in range(12))
    write_json(tmp_path / "motion.json", SignalSequence(frames, 24.0, "motion"))
    return tmp_path / "motion.json"


def files(folder):
    return sorted(path.name for path in folder.iterdir())


BAD = (
    "--size 0", "--size 99999", "--size 64x", "--size x", "--size -5", "--camera zoom=3", "--camera fov=nan",
    "--camera fov=0", "--camera distance=far", "--camera azimuth", "--camera elevation=100",
    "--set body.left_elbow=0,0", "--set body.left_elbow=0,0,nan", "--set body.tail=0,0,1", "--set face.smirk=1",
    "--set face.jawOpen=inf", "--set face.jawOpen", "--set left_hand.index9=0,0,0", "--set shape.12=1",
    "--set root.place=1,2,3", "--set hat.size=3", "--pose ballet", "--hand middle=fist", "--hand left=paw",
    "--hand fist", "--expression grin", "--background blurple", "--background 1,2", "--background 300,0,0",
    "--aov albedo", "--aov depth,,normal", "--frame 3", "--frames 0:3", "--motion nowhere.bvh",
    "--motion {motion} --frame 12", "--motion {motion} --frame x", "--motion {motion} --frames 0:9",
    "--motion {motion} --frames 5:5", "--motion {motion} --frames 0:5:0", "--motion {motion} --frames 1,2",
    "--motion {motion} --frame 1 --frames 0:2", "--nonsense", "--stats {folder}",
)  # fmt: skip


@pytest.mark.parametrize("extra", BAD)
def test_bad_values_give_one_line_and_write_nothing(extra, quick, motion, tmp_path, capsys):
    target = tmp_path / "new" / "out.png"
    words = extra.format(motion=motion, folder=tmp_path).split()
    try:
        code = cli.main(["render", str(target), *words])
    except SystemExit as exit:
        code = exit.code
    captured = capsys.readouterr()
    assert code == 2
    assert captured.err.startswith("avatarrex-studio: error: ")
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert files(tmp_path) == ["motion.json"]


@pytest.mark.parametrize("out", ["out.jpg", "motion.json", "out.mp4"])
def test_bad_targets(out, quick, motion, tmp_path, capsys):
    assert cli.main(["render", str(tmp_path / out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert files(tmp_path) == ["motion.json"]


def test_an_unreadable_avatar_is_one_line(tmp_path, capsys):
    (tmp_path / "broken.avatar").write_bytes(b"not a zip")
    code = cli.main(["render", str(tmp_path / "out.png"), "--avatar", str(tmp_path / "broken.avatar")])
    assert code == 2
    assert "broken.avatar" in capsys.readouterr().err
    assert files(tmp_path) == ["broken.avatar"]


def test_an_image_with_passes_and_statistics(quick, tmp_path, capsys):
    out, stats = tmp_path / "a" / "out.png", tmp_path / "stats.json"
    words = ["--size", "40x30", "--aov", "depth,normal,position,mask", "--set", "face.jawOpen=0.6", "--alpha"]
    assert cli.main(["render", str(out), "--stats", str(stats), *words]) == 0
    assert "ball" in capsys.readouterr().err
    image = Image.open(out)
    assert (image.size, image.mode) == ((40, 30), "RGBA")
    assert image.getpixel((0, 0))[3] == 0
    passes = np.load(out.with_suffix(".npz"))
    assert {name: (passes[name].shape, passes[name].dtype.name) for name in passes} == {
        "depth": ((30, 40), "float32"),
        "normal": ((30, 40, 3), "float32"),
        "position": ((30, 40, 3), "float32"),
        "mask": ((30, 40), "float32"),
        "hit": ((30, 40), "bool"),
    }
    assert not passes["depth"][~passes["hit"]].any()
    (entry,) = json.loads(stats.read_text())
    assert set(entry) == {"frame", "ms", "counters"}
    assert {"templates", "volume", "pointmap", "shading", "total"} <= set(entry["ms"])
    assert entry["counters"]["rays"] == 1200


def test_a_folder_gets_numbered_frames(quick, motion, tmp_path):
    out = tmp_path / "frames"
    words = ["--motion", str(motion), "--frames", "0:12:4", "--size", "16", "--stats", str(tmp_path / "stats.json")]
    assert cli.main(["render", str(out), *words]) == 0
    assert files(out) == ["frame_000000.png", "frame_000004.png", "frame_000008.png"]
    entries = json.loads((tmp_path / "stats.json").read_text())
    assert [entry["frame"] for entry in entries] == [0, 4, 8]
    images = [np.asarray(Image.open(path)) for path in sorted(out.iterdir())]
    assert not np.array_equal(images[0], images[1])


def test_a_video(quick, motion, tmp_path):
    av = pytest.importorskip("av")
    out = tmp_path / "walk.mp4"
    assert cli.main(["render", str(out), "--motion", str(motion), "--frames", "::2", "--size", "64x48"]) == 0
    with av.open(str(out)) as video:
        stream = video.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(12)
        assert (stream.width, stream.height, sum(1 for _ in video.decode(stream))) == (64, 48, 6)
    assert files(tmp_path) == ["motion.json", "walk.mp4"]


@pytest.mark.parametrize("words", [["--size", "65x48"], ["--size", "64", "--alpha"]])
def test_a_video_that_cannot_be(words, quick, motion, tmp_path, capsys):
    assert cli.main(["render", str(tmp_path / "walk.mp4"), "--motion", str(motion), *words]) == 2
    assert files(tmp_path) == ["motion.json"]
    assert capsys.readouterr().err.count("\n") == 1


def test_an_interrupt_ends_cleanly(monkeypatch, motion, tmp_path, capsys):
    pytest.importorskip("av")
    calls = []

    def interrupted(*arguments):
        from ball import render_ball

        calls.append(arguments)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return render_ball(*arguments)

    monkeypatch.setattr("avatarrex_studio.engine.Engine", lambda: ball_engine(interrupted))
    assert cli.main(["render", str(tmp_path / "walk.mp4"), "--motion", str(motion), "--size", "32"]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert files(tmp_path) == ["motion.json"]


def test_a_session_replays_to_the_same_picture(quick, tmp_path):
    journal = Journal()
    journal.do(ApplyPose("wave"))
    journal.save(tmp_path / "session.json")
    assert cli.main(["replay", str(tmp_path / "session.json"), "--size", "24"]) == 0
    view = ["--camera", "distance=3,x=0,y=-0.05,z=0"]  # the one that a session starts with
    assert cli.main(["render", str(tmp_path / "direct.png"), "--pose", "wave", "--size", "24", *view]) == 0
    pictures = [np.asarray(Image.open(tmp_path / name)) for name in ("session.png", "direct.png")]
    assert np.array_equal(*pictures)


def test_inspect_says_what_a_file_is(motion, capsys):
    assert cli.main(["inspect", str(motion)]) == 0
    assert "12 frames at 24 frames a second" in capsys.readouterr().out


def test_no_display_names_the_headless_verb(monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert cli.main([]) == 2
    text = capsys.readouterr().err
    assert "render" in text
    assert text.count("\n") == 1


def test_settings_mean_what_they_say():
    assert options.setting("body.left_elbow=0,0,45deg") == SetJoint("left_elbow", (0.0, 0.0, math.radians(45)))
    assert options.setting("left_hand.index1=0,0,1") == SetJoint("left_index1", (0.0, 0.0, 1.0))
    assert options.setting("face.jawOpen=0.6") == SetExpression("jawOpen", 0.6)
    assert options.setting("root.translation=1,2,3") == SetTranslation((1.0, 2.0, 3.0))
    assert options.setting("shape.0=-2") == SetShape(0, -2.0)
    assert options.background("255,0,51") == (1.0, 0.0, 0.2, 1.0)
    assert options.background("1.0,0.5,0") == (1.0, 0.5, 0.0, 1.0)
    assert options.background("#ff0033") == (1.0, 0.0, 0.2, 1.0)
    assert list(options.frames("-4:", 12)) == [8, 9, 10, 11]
    assert options.size("640x480") == (640, 480)


def test_transparent_pixels_keep_their_straight_colour():
    import torch

    image = torch.tensor([[[0.25, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]]])
    assert composite(image, (0.0, 0.0, 0.0, 0.0)).tolist() == [[[128, 0, 0, 128], [0, 0, 0, 0]]]
    assert composite(image, (0.0, 1.0, 0.0, 1.0)).tolist() == [[[64, 128, 0, 255], [0, 255, 0, 255]]]


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), written(tmp_path / "a.bin") as temporary:
        temporary.write_bytes(b"half" * (1 // 0))
    assert files(tmp_path) == []
    (tmp_path / "flat").write_text("")
    with pytest.raises(InputError), written(tmp_path / "flat" / "a.bin"):
        pass
    with pytest.raises(InputError):
        VideoWriter(tmp_path / "a.mp4", 3, 4, 30.0)
