"""Bad input: one line `FILE OR OPTION: expected …, found …`, exit code 2, before anything is loaded or written.

What the command line refuses, the window refuses too: it says so in its console and stays as it was.
"""

from __future__ import annotations

import json
import os
import pickle
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli import headless as _headless  # it must know the true engine before that is replaced
from avatarrex_studio.cli import main as cli
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.session.commands import SetBackground, SetExpression
from bad_files import AVATARS, MOTIONS, SESSIONS, Payload, bvh, csv
from ball import ball_engine, render_ball
from ball_studio import InlineExact
from PIL import Image

from avatarrex.errors import InputError
from avatarrex.files.json_text import parse_json
from avatarrex.signals.read import read_motion

ERROR = "avatarrex-studio: error: "
HERE = Path(__file__).parent


def no_engine() -> Engine:
    """What stands for the engine where it must not be reached."""
    raise AssertionError(f"{_headless.__name__} was to refuse this before an avatar is loaded")


def files(folder: Path) -> list[str]:
    """What lies in a folder, hidden files too."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def refused(words: list[str], pattern: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command line that must be refused in one line that matches; returns the line."""
    try:
        code = cli.main(words)
    except SystemExit as exit:
        code = exit.code
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    assert captured.err.startswith(ERROR)
    line = captured.err.removesuffix("\n")
    assert line.isprintable(), "one line, no control characters"
    assert re.search(pattern, line), line
    return line


NUMBER, VALUE = "a finite number", "OUT|--[a-z]+: expected a value, found nothing"
OPTIONS = {
    "--size 0": "--size: expected sides of 16 to 8192 pixels, found 0", "--size 99999": "--size: expected sides",
    "--size 1e9": "--size: expected N or WxH", "--size -5": "--size: expected N or WxH", "--size axb": "found axb",
    "--shading-tolerance -1": "--shading-tolerance: expected a number from 0 to 1", "--shading-tolerance nan": NUMBER,
    "--shading-tolerance ''": "--shading-tolerance: expected a value",
    "--size 64x": "--size: expected N or WxH", "--size 9999999999x16": "--size: expected N or WxH", "--size 64x0": "found 64x0",
    "--camera zoom=3": "--camera: zoom: expected one of azimuth, elevation", "--camera azimuth": NUMBER,
    "--camera fov=nan": NUMBER, "--camera x=inf": NUMBER, "--camera distance=far": NUMBER, "--camera x=1e300": "up to 1e",
    "--camera fov=0": "camera: fov: expected a number from 1 to 170", "--camera fov=180": "from 1 to 170, found 180",
    "--camera elevation=100": "from -90 to 90", "--camera distance=0": "camera: distance: expected a number from 0.05",
    "--set body.left_elbow=0,0": "three numbers, e.g. 0,0,45deg, found 0,0", "--set body.left_elbow=0,0,nan": NUMBER,
    "--set body.left_elbow=0,0,1e20": "body_pose: expected numbers up to", "--set body.tail=0,0,1": "found tail",
    "--set face.smirk=1": "found smirk", "--set face.jawOpen=inf": NUMBER, "--set face.jawOpen": "GROUP.NAME=VALUE",
    "--set face.jawOpen=1000": "expression: expected numbers up to ±5, found 1000", "--set shape.0=2.6": "shape.0: expected ±2.5",
    "--set left_hand.index9=0,0,0": "found index9", "--set shape.12=1": "shape.0 to shape.9", "--set hat.size=3": "found hat",
    "--set root.place=1,2,3": "root.translation or root.orientation", "--set root.translation=0,0,1e9": "translation: expected",
    "--pose ballet": "pose: ballet: expected one of .*found an unknown name", "--pose None": "an unknown name",
    "--hand middle=fist": "left=NAME, right=NAME or both=NAME", "--hand left=paw": "hand: paw: expected one of",
    "--hand fist": "found fist", "--expression gurn": "expression: gurn: expected one of",
    "--background blurple": "a colour name, #rrggbb, r,g,b or transparent, found blurple", "--background 1,2": "r,g,b as integers",
    "--background 300,0,0": "found 300,0,0", "--background inf,0,0": NUMBER,
    "--aov albedo": "--aov: expected some of depth,normal,position,mask, found albedo", "--aov depth,,normal": "found nothing",
    "--frame 3": "--motion FILE with it", "--frames 0:3": "--motion FILE with it",
    "--motion {motion} --frame 3": "--frame: expected an integer from 0 to 2, found 3",
    "--motion {motion} --frame -4": "from 0 to 2, found -4", "--motion {motion} --frame x": "found x",
    "--motion {motion} --frames 0:2": "a folder or OUT.mp4 for 2 frames", "--motion {motion} --frames 1:1": "some of the 3 frames",
    "--motion {motion} --frames 7:9": "some of the 3 frames of the motion, found 7:9",
    "--motion {motion} --frames 0:3:0": "a step other than 0, found 0:3:0", "--motion {motion} --frames 1,2": "A:B or A:B:S",
    "--motion {motion} --frame 1 --frames 0:2": "not allowed with", "--nonsense": "unrecognized arguments",
    "--stats {folder}": "FILE.json", "--stats out.txt": "FILE.json", "--stats {motion} --motion {motion}": "FILE.json",
    "--stats /proc/stats.json": "a folder at /proc that can be written", "--avatar nobody": "nobody: expected an avatar folder",
    "--motion ''": VALUE, "--size ''": VALUE, "--camera ''": VALUE, "--avatar ''": VALUE, "--stats ''": VALUE,
}  # fmt: skip


@pytest.mark.parametrize("extra", OPTIONS)
def test_options(extra, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", no_engine)
    (tmp_path / "motion.bvh").write_text(bvh())
    words = extra.format(motion=tmp_path / "motion.bvh", folder=tmp_path).replace("''", "\0").split()
    out = tmp_path / "new" / "out.png"
    refused(["render", str(out), *("" if word == "\0" else word for word in words)], OPTIONS[extra], capsys)
    assert files(tmp_path) == ["motion.bvh"]


TARGETS = {
    "out.jpg": "OUT.png, OUT.mp4 or a folder, found .jpg", "kept": "a folder, OUT.png or OUT.mp4, found a file",
    "kept/out.png": "a folder at .*kept, found a file", "out.mp4": "--motion FILE for a video", "x" * 300 + ".png": "File name too long",
    "/proc/out.png": "a folder at /proc that can be written", "/dev/null/out.png": "a folder at /dev/null, found no plain file",
    "/dev/full": "found a file without an extension", "": "OUT: expected a value, found nothing",
}  # fmt: skip


@pytest.mark.parametrize("target", TARGETS)
def test_targets(target, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", no_engine)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kept").write_text("kept")
    refused(["render", target], TARGETS[target], capsys)
    assert files(tmp_path) == ["kept"]
    assert (tmp_path / "kept").read_text() == "kept"


@pytest.mark.parametrize(
    ("size", "option"), [("65x48", "--alpha"), ("64", "--alpha"), ("64", "--background=#ff000080")]
)
def test_videos_that_cannot_be(size, option, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", no_engine)
    (tmp_path / "m.bvh").write_text(bvh())
    words = ["render", str(tmp_path / "walk.mp4"), "--motion", str(tmp_path / "m.bvh"), "--size", size, option]
    refused(words, "an opaque background for .mp4", capsys)
    assert files(tmp_path) == ["m.bvh"]


def test_a_video_of_odd_sides(monkeypatch, tmp_path, capsys):
    pytest.importorskip("av")
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", ball_engine)
    (tmp_path / "m.bvh").write_text(bvh())
    words = ["render", str(tmp_path / "walk.mp4"), "--motion", str(tmp_path / "m.bvh"), "--size", "65x48"]
    refused(words, "size: expected even sides for a video, found 65x48", capsys)
    assert files(tmp_path) == ["m.bvh"]


def broken(table, name, folder):
    """Write the file of a table; its path and the pattern that refuses it, behind the path."""
    file, write, pattern = table[name]
    write(folder / file)
    return folder / file, rf"{re.escape(file[:100])}.*{pattern}"


@pytest.mark.parametrize("name", MOTIONS)
def test_motions(name, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", no_engine)
    path, pattern = broken(MOTIONS, name, tmp_path)
    before, memory = files(tmp_path), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused(["render", str(tmp_path / "new" / "out.png"), "--motion", str(path)], pattern, capsys)
    assert files(tmp_path) == before, "nothing written, nothing executed"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 300_000, "KiB"
    if path.suffix != ".c3d" and os.path.isfile(path):
        refused(["inspect", str(path)], pattern.replace("a JSON file", "(a JSON file|JSON)"), capsys)


@pytest.mark.parametrize("name", AVATARS)
def test_avatars(name, tmp_path, capsys):
    path, pattern = broken(AVATARS, name, tmp_path)
    before = files(tmp_path)
    refused(["render", str(tmp_path / "new" / "out.png"), "--avatar", str(path)], pattern, capsys)
    assert files(tmp_path) == before


@pytest.mark.parametrize("name", SESSIONS)
def test_sessions(name, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", no_engine)
    path, pattern = broken(SESSIONS, name, tmp_path)
    before = files(tmp_path)
    refused(["replay", str(path), str(tmp_path / "out.png")], pattern, capsys)
    assert files(tmp_path) == before


def test_a_session_of_a_lost_avatar(tmp_path, capsys):
    start = {"format": 1, "avatar": str(tmp_path / "lost.avatar")}
    (tmp_path / "s.json").write_text(json.dumps({"format": 1, "kind": "session", "start": start, "steps": []}))
    refused(
        ["replay", str(tmp_path / "s.json")], "lost.avatar: expected an avatar folder .* found nothing there", capsys
    )
    assert files(tmp_path) == ["s.json"]


def test_the_payload_of_the_pickled_files_is_live(tmp_path):
    """Without this the two pickled entries above would prove nothing."""
    pickle.loads(pickle.dumps(Payload(tmp_path / "executed")))
    assert files(tmp_path) == ["executed"]


@pytest.fixture
def unprivileged():
    """A folder of a user who is not root: what may not be read or written is then truly refused."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        root = os.geteuid() == 0
        yield Path(folder), lambda: os.seteuid(65534) if root else None
        if root:
            os.seteuid(0)
        os.chmod(folder, 0o755)


def test_what_may_not_be_read_or_written(unprivileged, monkeypatch, capsys):
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", no_engine)
    folder, drop = unprivileged
    (folder / "m.bvh").write_text(bvh())
    (folder / "closed").mkdir(mode=0o700)
    (folder / "closed" / "a.avatar").write_text("")
    for path in (folder / "m.bvh", folder / "closed"):
        path.chmod(0)
    folder.chmod(0o555)
    drop()
    refused(
        ["render", "/tmp/out.png", "--motion", str(folder / "m.bvh")], "a BVH file, found Permission denied", capsys
    )
    refused(["inspect", str(folder / "m.bvh")], "m.bvh: expected a BVH file, found Permission denied", capsys)
    refused(
        ["render", "/tmp/out.png", "--avatar", str(folder / "closed" / "a.avatar")], "found Permission denied", capsys
    )
    refused(["render", str(folder / "out.png")], "that can be written, found Permission denied", capsys)
    refused(["render", str(folder / "frames/")], "that can be written, found Permission denied", capsys)
    assert not (folder / "out.png").exists()


def test_files_that_are_merely_odd_are_read(tmp_path):
    """A byte order mark; names in Latin-1; a path in millimetres, with a notice."""
    (tmp_path / "mark.bvh").write_bytes(b"\xef\xbb\xbf" + bvh().encode())
    (tmp_path / "latin.bvh").write_bytes(bvh().replace("Head", "Tête").encode("latin-1"))
    (tmp_path / "mark.csv").write_bytes(b"\xef\xbb\xbf" + csv().encode())
    (tmp_path / "mark.json").write_bytes(b'\xef\xbb\xbf{"frames": [{}, {}, {}]}')
    for name in ("mark.bvh", "latin.bvh", "mark.csv", "mark.json"):
        assert len(read_motion(tmp_path / name)) == 3
    assert any("centimetres" in note for note in read_motion(tmp_path / "mark.bvh").notes)
    metres = np.arange(30)[:, None] * [0.0, 0.0, 0.05]
    for scale, notice in ((1, ""), (100, "like centimetres"), (1000, "like millimetres")):
        np.savez(tmp_path / "walk.npz", poses=np.zeros((30, 165)), trans=scale * metres, fps=30)
        notes = " ".join(read_motion(tmp_path / "walk.npz").notes)
        assert (notice in notes) if notice else ("the path looks" not in notes)


def test_a_timecode_that_jumps_is_not_filled(tmp_path):
    """The gap between 0 and 23 o'clock would be five million frames."""
    lines = csv(6).splitlines()
    lines[4:] = [line.replace("00:00:00:", "23:00:00:", 1) for line in lines[4:]]
    (tmp_path / "m.csv").write_text("\n".join(lines))
    motion = read_motion(tmp_path / "m.csv")
    assert len(motion) == 6
    assert any("jumps by" in note for note in motion.notes)


CHILD = """
import resource, sys, time
sys.path.insert(0, {here!r})
import avatarrex_studio.cli.headless
from avatarrex_studio.cli import main as cli
from avatarrex_studio.engine import engine
from ball import ball_engine, render_ball

def slow(*arguments):
    time.sleep({pause})
    return render_ball(*arguments)

engine.Engine = lambda **named: ball_engine(slow, **named)
if {limit}:
    sys.dont_write_bytecode = True  # modules would be cut off, too, and stay so
    resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
for line in {lines!r}:
    print("exit", cli.main(line.split()), file=sys.stderr)
"""


def child(lines, pause=0.0, limit=0):
    """A process of its own that runs command lines on the ball; no file of it may exceed `limit` bytes."""
    text = CHILD.format(here=str(HERE), pause=pause, limit=limit, lines=lines)
    return subprocess.Popen([sys.executable, "-c", text], stderr=subprocess.PIPE, text=True)


def test_a_full_disk_keeps_what_was_there(tmp_path):
    """Writes fail beyond 8000 bytes of a file: images, passes, statistics, videos."""
    pytest.importorskip("av")
    (tmp_path / "m.bvh").write_text(bvh(40))
    for name in ("a.png", "b.npz", "c.json", "d.mp4"):
        (tmp_path / name).write_text("kept")
    motion = f"--motion {tmp_path}/m.bvh"
    process = child(
        [
            f"render {tmp_path}/a.png --size 512",
            f"render {tmp_path}/b.png --size 512 --camera distance=9000 --aov depth,normal,position,mask",
            f"render {tmp_path}/frames {motion} --size 32 --stats {tmp_path}/c.json",
            f"render {tmp_path}/d.mp4 {motion} --size 512",
        ],
        limit=8000,
    )
    _, err = process.communicate(timeout=60)
    assert "Traceback" not in err
    for name in ("a.png", "b.npz", "c.json", "d.mp4"):
        assert f"{ERROR}{tmp_path}/{name}: expected a file that can be written, found File too large" in err
        assert (tmp_path / name).read_text() == "kept"
    assert re.findall("exit (.*)", err) == ["2"] * 4
    frames = sorted((tmp_path / "frames").iterdir())
    assert len(frames) == 40
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.png",
        "b.npz",
        "b.png",
        "c.json",
        "d.mp4",
        "frames",
        "m.bvh",
    ]


@pytest.mark.parametrize("out", ["frames/", "walk.mp4"])
def test_an_interrupt_leaves_whole_files(out, tmp_path):
    """Ctrl+C in the middle: images that are done stay, whole; a video that is not done vanishes; exit code 130."""
    pytest.importorskip("av")
    (tmp_path / "m.bvh").write_text(bvh(300))
    target = tmp_path / "out" / out
    process = child([f"render {target} --motion {tmp_path}/m.bvh --size 32"], pause=0.05)
    folder = target if out.endswith("/") else target.parent
    deadline = time.monotonic() + 60
    while not (folder.is_dir() and len(list(folder.iterdir())) >= (3 if out.endswith("/") else 1)):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert "exit 130" in err
    assert "Traceback" not in err
    left = files(tmp_path / "out")
    if out.endswith("/"):
        images = left[1:]
        assert 3 <= len(images) < 300
        assert images == [f"frames/frame_{k:06d}.png" for k in range(len(images))]
        for name in images:
            with Image.open(tmp_path / "out" / name) as image:
                image.load()
    else:
        assert left == []


def test_wrong_input_is_refused_before_torch_is_loaded(tmp_path):
    """Torch takes seconds to load: a typing error must not cost them."""
    (tmp_path / "m.bvh").write_text(bvh()[:-250])
    (tmp_path / "s.json").write_text("{}")
    lines = [
        "render x.png --pose ballet", "render x.png --size 0", f"render x.png --motion {tmp_path}/m.bvh",
        "render x.png --avatar nobody", f"replay {tmp_path}/s.json", f"inspect {tmp_path}/nothing", "render x.jpg",
    ]  # fmt: skip
    code = f"""
import sys
from avatarrex_studio.cli import main as cli
codes = [cli.main(line.split()) for line in {lines!r}]
sys.exit(codes != [2] * {len(lines)} or "torch" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count(ERROR) == len(lines)


def test_the_program_itself(tmp_path):
    """The installed program, not its functions."""
    (tmp_path / "out.png").write_text("kept")
    words = ["render", str(tmp_path / "out.png"), "--set", "body.left_elbow=0,0,nan"]
    program = Path(sys.executable).parent / "avatarrex-studio"
    done = subprocess.run([program, *words], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == ERROR + "--set: body.left_elbow: expected a finite number, found nan\n"
    assert (tmp_path / "out.png").read_text() == "kept"


@pytest.mark.parametrize("name", MOTIONS)
def test_the_window_refuses_a_motion_and_stays(name, studio, tmp_path, caplog):
    studio.do(SetExpression("jawOpen", 0.5))
    before, steps = studio.state, list(studio.journal.steps)
    path, pattern = broken(MOTIONS, name, tmp_path)
    studio.open_motion(str(path))
    (record,) = [record for record in caplog.records if record.levelname == "ERROR"]
    assert re.search(pattern, record.getMessage())
    assert studio.state is before
    assert studio.journal.steps == steps
    assert studio.motion is None


@pytest.mark.parametrize("name", SESSIONS)
def test_the_window_refuses_a_session_and_stays(name, studio, tmp_path, caplog):
    studio.do(SetExpression("jawOpen", 0.5))
    before, journal = studio.state, studio.journal
    path, pattern = broken(SESSIONS, name, tmp_path)
    studio.open_session(str(path))
    (record,) = [record for record in caplog.records if record.levelname == "ERROR"]
    assert re.search(pattern, record.getMessage())
    assert studio.journal is journal
    assert studio.state is before
    studio.undo()
    assert studio.state is not before


def test_the_window_keeps_its_avatar(clock, tmp_path, caplog):
    """A session whose avatar is lost does not replace the one that is open."""
    studio = Studio(InlineExact(Engine(render=render_ball)), Avatars(), clock=clock)
    avatar, before = studio.avatars.get("default"), studio.state
    start = {"format": 1, "avatar": str(tmp_path / "lost.avatar")}
    (tmp_path / "s.json").write_text(json.dumps({"format": 1, "kind": "session", "start": start, "steps": []}))
    studio.open_session(str(tmp_path / "s.json"))
    assert "lost.avatar: expected an avatar folder or an .avatar file, found nothing there" in caplog.text
    assert studio.state is before
    assert studio.avatars.get("default") is avatar
    studio.do(SetExpression("jawOpen", 0.5))
    for _ in range(3):
        clock.now += 1
        studio.tick((64, 48))
    assert studio.pictures.error is None
    assert studio.pictures.current


def test_the_window_survives_files_that_cannot_be_written(studio, caplog):
    studio.do(SetBackground((1.0, 1.0, 1.0, 1.0)))
    before = studio.state
    studio.save_image("/proc/out.png", (32, 24))
    studio.tick((32, 24))
    studio.save_session("/proc/out.json")
    errors = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert [error.split(":")[0] for error in errors] == ["/proc/out.png", "/proc/out.json"]
    assert studio.state is before


def test_the_ball_draws_what_is_right(monkeypatch, tmp_path):
    """The mutant of this file: what is right is not refused."""
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", ball_engine)
    (tmp_path / "m.bvh").write_text(bvh())
    (tmp_path / "m.csv").write_text(csv())
    for name in ("m.bvh", "m.csv"):
        assert cli.main(["render", str(tmp_path / "out.png"), "--motion", str(tmp_path / name), "--size", "16"]) == 0


@pytest.mark.parametrize(("text", "found"), [("", "nothing"), ("[1,\n x]", "no JSON in line 2, column 2")])
def test_broken_json_is_refused_in_words_of_ours(text, found):
    with pytest.raises(InputError) as refusal:
        parse_json(text, "a.json")
    assert refusal.value.found == found
