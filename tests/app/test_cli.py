"""The command line: what it writes. What it refuses: test_bad_input.py."""

from __future__ import annotations

import json
import math
import struct
import subprocess
import sys
import threading
import zlib

import numpy as np
import pytest
from avatarrex_studio.cli import edits, headless, options
from avatarrex_studio.cli import main as cli
from avatarrex_studio.session.commands import (
    ApplyPose,
    SetCamera,
    SetExpression,
    SetJoint,
    SetLevel,
    SetShape,
    SetTranslation,
)
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import StudioState
from ball import ball_engine, render_ball
from PIL import Image

from avatarrex.capture.readers import choice
from avatarrex.errors import InputError
from avatarrex.files.gate import remove_unfinished, written
from avatarrex.files.images import composite, write_png
from avatarrex.files.video import video_writer
from avatarrex.signals.driving import Signals
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence


@pytest.fixture
def quick(monkeypatch):
    """The command line on the quick stand-in for the pipeline."""
    assert headless.Engine is not ball_engine, "headless must know the true class before it is replaced"
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", ball_engine)


@pytest.fixture
def motion(tmp_path):
    frames = tuple(Signals.rest().replace(body_pose=np.full((21, 3), 0.02 * k)) for k in range(12))
    write_json(tmp_path / "motion.json", SignalSequence(frames, 24.0, "motion"))
    return tmp_path / "motion.json"


def files(folder):
    return sorted(path.name for path in folder.iterdir())


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


def test_a_frame_is_written_while_the_next_is_rendered(motion, tmp_path, monkeypatch):
    second, write, rendered = threading.Event(), headless.write_png, []

    def render(*words):
        rendered.append(words)
        if len(rendered) == 2:
            second.set()
        return render_ball(*words)

    def wait_and_write(path, *words):
        assert second.wait(30), "the first picture is written before the second frame is begun"
        write(path, *words)

    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", lambda **named: ball_engine(render, **named))
    monkeypatch.setattr(headless, "write_png", wait_and_write)
    assert cli.main(["render", str(tmp_path / "out"), "--motion", str(motion), "--frames", "0:3", "--size", "16"]) == 0
    assert files(tmp_path / "out") == [f"frame_{k:06d}.png" for k in range(3)]


def test_what_cannot_be_written_ends_the_rendering(quick, motion, tmp_path, monkeypatch, capsys):
    write = headless.write_png

    def full(path, *words):
        if path.stem.endswith("1"):
            raise OSError(28, "No space left on device", str(path))
        write(path, *words)

    monkeypatch.setattr(headless, "write_png", full)
    assert cli.main(["render", str(tmp_path / "out"), "--motion", str(motion), "--size", "16"]) != 0
    assert "No space left on device" in capsys.readouterr().err
    assert files(tmp_path / "out")[0] == "frame_000000.png"
    assert len(files(tmp_path / "out")) < 8, "it went on long after"


def test_a_video(quick, motion, tmp_path):
    av = pytest.importorskip("av")
    out = tmp_path / "walk.mp4"
    assert cli.main(["render", str(out), "--motion", str(motion), "--frames", "::2", "--size", "64x48"]) == 0
    with av.open(str(out)) as video:
        stream = video.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(12)
        assert (stream.width, stream.height, sum(1 for _ in video.decode(stream))) == (64, 48, 6)
    assert files(tmp_path) == ["motion.json", "walk.mp4"]


def test_a_session_replays_to_the_same_picture(quick, tmp_path):
    journal = Journal()
    journal.do(ApplyPose("wave"))
    journal.save(tmp_path / "session.json")
    assert cli.main(["replay", str(tmp_path / "session.json"), "--size", "24"]) == 0
    view = ["--camera", "distance=3,x=0,y=-0.05,z=0"]  # the one that a session starts with
    assert cli.main(["render", str(tmp_path / "direct.png"), "--pose", "wave", "--size", "24", *view]) == 0
    pictures = [np.asarray(Image.open(tmp_path / name)) for name in ("session.png", "direct.png")]
    assert np.array_equal(*pictures)


def test_a_level_is_kept_in_the_picture_and_by_a_session(tmp_path, monkeypatch):
    settings = []

    def spy(avatar, signals, camera, chosen, previous=None):
        settings.append(chosen)
        return render_ball(avatar, signals, camera, chosen, previous)

    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", lambda **named: ball_engine(spy, **named))
    for name in ("fast", "auto"):
        out = tmp_path / f"{name}.png"
        kept = ["--detail-from", "squat", "--shading-tolerance", "0.004"]
        assert cli.main(["render", str(out), "--size", "16", "--level", name, *kept]) == 0
        assert json.loads(Image.open(out).text["avatarrex"])["level"] == name
    assert [chosen.part_voxel for chosen in settings] == [0.005, 0.0025]
    assert [chosen.bricks for chosen in settings] == [0, 4], "auto is the most exact level where nobody waits"
    assert all(chosen.detail_from is not None and chosen.shading_tolerance == 0.004 for chosen in settings)
    journal = Journal()
    journal.do(SetLevel("paper"))
    journal.save(tmp_path / "session.json")
    assert cli.main(["replay", str(tmp_path / "session.json"), "--size", "16"]) == 0
    assert (settings[-1].march, settings[-1].shading_tolerance) == ("fixed", 0)


def test_inspect_says_what_a_file_is(motion, capsys):
    assert cli.main(["inspect", str(motion)]) == 0
    assert "12 frames at 24 frames a second" in capsys.readouterr().out


def crc(side):
    """Of the header of an RGB picture of so many pixels a side."""
    return struct.pack(">I", zlib.crc32(b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)))


def test_inspect_says_what_a_picture_shows(tmp_path, capsys):
    state = SetCamera(azimuth=30.0).apply(StudioState()).pose(translation=np.array([0.0, 0.1, 0.0]))
    pixels = np.full((16, 24, 4), 255, np.uint8)
    write_png(tmp_path / "own.png", pixels, {"avatarrex": json.dumps(state.to_json())})
    write_png(tmp_path / "other.png", pixels)
    assert cli.main(["inspect", str(tmp_path / "own.png")]) == 0
    told = capsys.readouterr().out
    for part in ("24x16 pixels", "avatar: default", "level: balanced", "azimuth 30", "not at rest: translation\n"):
        assert part in told
    assert cli.main(["inspect", str(tmp_path / "other.png")]) == 0
    assert "not rendered by the studio" in capsys.readouterr().out
    write_png(tmp_path / "state.png", pixels, {"avatarrex": json.dumps({"format": 1, "level": "ballanced"})})
    assert cli.main(["inspect", str(tmp_path / "state.png")]) == 2
    assert "ballanced" in capsys.readouterr().err
    whole = (tmp_path / "own.png").read_bytes()
    for name, content, cause in (
        ("cut.png", whole[:20], "expected a PNG"),
        ("text.png", b"no picture", "expected a PNG"),
        (
            "bomb.png",
            whole[:16] + struct.pack(">II", 60000, 60000) + whole[24:29] + crc(60000) + whole[33:],
            "expected a PNG",
        ),
        ("bits.png", whole.replace(b"translation", b"translatoin"), "expected a PNG"),
    ):
        (tmp_path / name).write_bytes(content)
        assert cli.main(["inspect", str(tmp_path / name)]) == 2
        error = capsys.readouterr().err
        assert cause in error
        assert name in error
        assert error.count("\n") == 1


def test_no_display_names_the_headless_verb(monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert cli.main([]) == 2
    text = capsys.readouterr().err
    assert "render" in text
    assert text.count("\n") == 1


WRONG = (
    "open --device warp", "render x.jpg", "replay nothing.json", "inspect nothing", "runs nothing --text",
    "capture make x --seed -1", "capture check x --frames none", "evaluate default x --size 9", "sheet default x --samples 0",
    "train x --out y --recipe huge", "train x --out y --parts feet",
)  # fmt: skip


def test_wrong_words_need_neither_torch_nor_what_measures(tmp_path):
    """Torch takes seconds to load, and the room that measures the product is not needed to run it."""
    code = f"""
import sys
from avatarrex_studio.cli.main import main
for line in {WRONG!r}:
    try:
        assert main(line.split()) == 2, line
    except SystemExit as exit:
        assert exit.code == 2, line
sys.exit(any(name in sys.modules for name in ("torch", "avatarrex.measure")))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("avatarrex-studio: error: ") == done.stderr.count("\n") == len(WRONG), done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("verb", cli.VERBS)
def test_help_names_every_option(verb, capsys):
    with pytest.raises(SystemExit, match="0"):
        cli.main([*verb.split(), "--help"])
    text = capsys.readouterr().out
    assert text.startswith(f"usage: avatarrex-studio {verb}")
    assert "--preset" not in text
    assert "--arms" not in text


def test_old_spellings_are_accepted():
    assert cli.parse(["train", "x", "--out", "y", "--preset", "smoke"]).recipe == "smoke"
    assert cli.parse(["train", "x", "--out", "y"]).recipe == "quick"
    old = cli.parse(["bench", "ablation", "x", "--out", "y", "--preset", "long", "--arms", "full,plain"])
    assert (old.recipe, old.variants) == ("long", "full,plain")


@pytest.mark.parametrize("option", ["--preset", "--preset=nope", "--recipe"])
def test_an_error_names_an_option_as_it_was_typed(option, capsys):
    assert cli.main(["train", "x", "--out", "y", option, *(() if "=" in option else ("nope",))]) == 2
    assert capsys.readouterr().err.startswith(f"avatarrex-studio: error: {option.partition('=')[0]}: expected one of")


def test_settings_mean_what_they_say():
    assert edits.setting("body.left_elbow=0,0,45deg") == SetJoint("left_elbow", (0.0, 0.0, math.radians(45)))
    assert edits.setting("left_hand.index1=0,0,1") == SetJoint("left_index1", (0.0, 0.0, 1.0))
    assert edits.setting("face.jawOpen=0.6") == SetExpression("jawOpen", 0.6)
    assert edits.setting("root.translation=1,2,3") == SetTranslation((1.0, 2.0, 3.0))
    assert edits.setting("shape.1=-2") == SetShape(1, -2.0)
    assert edits.background("255,0,51") == (1.0, 0.0, 0.2, 1.0)
    assert edits.background("1.0,0.5,0") == (1.0, 0.5, 0.0, 1.0)
    assert edits.background("#ff0033") == (1.0, 0.0, 0.2, 1.0)
    assert choice.frames("-4:", 12) == (8, 9, 10, 11)
    assert choice.frames("0:2,8:12:2,1:3", 12) == (0, 1, 8, 10, 2)
    assert options.size("640x480") == (640, 480)


def test_transparent_pixels_keep_their_straight_colour():
    import torch

    image = torch.tensor([[[0.25, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]]])
    assert composite(image, (0.0, 0.0, 0.0, 0.0)).tolist() == [[[128, 0, 0, 128], [0, 0, 0, 0]]]
    assert composite(image, (0.0, 1.0, 0.0, 1.0)).tolist() == [[[64, 128, 0, 255], [0, 255, 0, 255]]]


def test_what_a_killed_process_was_writing_is_found(tmp_path):
    killed = (
        "import os, sys\nfrom avatarrex.files.gate import written\n"
        "with written(sys.argv[1]) as temporary:\n    temporary.write_text('half')\n    os.kill(os.getpid(), 9)\n"
    )
    for path in (tmp_path / "a.bin", tmp_path / "deep" / "b.bin"):
        assert subprocess.run([sys.executable, "-c", killed, str(path)]).returncode == -9
    (tmp_path / ".mine").write_text("")
    assert len(list(tmp_path.rglob(".*.bin"))) == 2
    remove_unfinished(tmp_path, below=False)
    assert [path.parent.name for path in tmp_path.rglob(".*.bin")] == ["deep"]
    remove_unfinished(tmp_path)
    assert not list(tmp_path.rglob(".*.bin"))
    assert (tmp_path / ".mine").exists()


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), written(tmp_path / "a.bin") as temporary:
        temporary.write_bytes(b"half" * (1 // 0))
    assert files(tmp_path) == []
    (tmp_path / "flat").write_text("")
    with pytest.raises(InputError), written(tmp_path / "flat" / "a.bin"):
        pass
    with pytest.raises(InputError, match="even sides"):
        video_writer(tmp_path / "a.mp4", 3, 4, 30.0)
