"""How a motion was read: the options of a session, the window in which guesses are changed, the command line."""

from __future__ import annotations

import json
import re
import threading
from dataclasses import replace
from pathlib import Path

import driving
import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from avatarrex_studio.jobs import opening
from avatarrex_studio.panels.motion_import import without_options
from avatarrex_studio.session import commands, motion
from avatarrex_studio.session.clips import Clips
from avatarrex_studio.session.evaluation import go_to, settled
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import StudioState
from ball import ball_engine
from ball_studio import ball_studio
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui
from PIL import Image
from signals.dialects import DIALECTS, steps, write
from test_window import drive, rest

from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.own_motions import MOTIONS
from avatarrex.signals.read import import_motion, read_motion

LYING = "rest along another up"


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """A motion whose rest pose stands along another axis: it is read with a warning."""
    write(tmp_path / "odd.bvh", DIALECTS[LYING], steps())
    return tmp_path / "odd.bvh"


def test_options_come_back_with_the_state_and_the_journal(odd: Path) -> None:
    chosen = ImportOptions(up="+Z", fps=12.0, joints=(("head", ""),))
    state = StudioState()
    clips = Clips()
    load = settled(Motion.read(odd, chosen).loaded(), state, clips)
    assert commands.Command.from_json(json.loads(json.dumps(load.to_json()))) == load
    after = load.apply(state)
    again = StudioState.from_json(json.loads(json.dumps(after.to_json())))
    assert again == after
    assert again.timeline.motion is not None
    assert again.timeline.motion.options == chosen
    # a session that was opened reads the motion as it was read before
    clips.take(Motion.read(str(odd)))
    frame = go_to(again, 3, clips)
    assert frame is not None
    assert frame.signals == Motion.read(odd, chosen).sequence[3]


def test_the_present_motion_is_the_one_that_the_state_names(odd: Path, caplog: pytest.LogCaptureFixture) -> None:
    """After an undone option, after another session was opened; a file that went away is refused once until Play."""
    clips = Clips()
    free, chosen = (Motion.read(odd, options).loaded().apply(StudioState())
                    for options in (ImportOptions(), ImportOptions(up="+Z")))  # fmt: skip
    clips.take(Motion.read(str(odd), ImportOptions(up="+Z")))

    def options_now(state: StudioState) -> ImportOptions:
        assert state.timeline.motion is not None
        motion = clips.motion(state.timeline.motion)
        assert motion is not None
        return motion.imported.options

    assert options_now(free) == ImportOptions()
    clips.forget()
    assert options_now(chosen) == ImportOptions(up="+Z")
    text = odd.read_text()
    odd.unlink()
    assert [go_to(free, 1, clips) for _ in range(3)] == [None] * 3
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    odd.write_text(text)
    assert go_to(free, 1, clips) is None
    clips.retry()
    assert options_now(free) == ImportOptions()


def test_the_window_does_not_wait_for_blender_as_long_as_a_command(
    odd: Path, clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits = []

    def timed(path: str, options: ImportOptions | None, seconds: float) -> ImportedMotion:
        waits.append(seconds)
        return import_motion(path, options, seconds)

    monkeypatch.setattr(motion, "import_motion", timed)
    ball_studio(clock).open_motion(str(odd))
    Motion.read(odd)
    studio = ball_studio(clock)
    studio.take_journal(Journal(Motion.read(str(odd)).loaded().apply(StudioState())))
    studio.go_to(1)
    assert waits == [60.0, 300.0, 300.0, 60.0]


def test_a_session_of_before_has_no_options() -> None:
    data = StudioState().to_json() | {"motion": {"path": "a.bvh", "name": "a", "frames": 2, "fps": 30.0, "frame": 1}}
    motion = StudioState.from_json(data).timeline.motion
    assert motion is not None
    assert motion.options == ImportOptions()


@pytest.mark.parametrize("name", MOTIONS)
def test_the_program_s_motions_loop_and_stand(name: str) -> None:
    motion = Motion.read(name)
    assert not motion.imported.warnings
    poses = np.stack([frame.full_pose() for frame in motion.sequence])
    step = np.abs(np.diff(poses, axis=0)).max()
    assert np.abs(poses[0] - poses[-1]).max() < 2 * step, "the end meets the beginning"
    assert read_motion(name)[0] == motion.sequence[0]


def test_the_table_and_the_picture(odd: Path, tmp_path: Path, capsys) -> None:
    names = {"pelvis": "Hips"}
    (tmp_path / "map.json").write_text(json.dumps(names))
    words = [
        "motion",
        "check",
        str(odd),
        "--up",
        "-Z",
        "--fps",
        "15",
        "--map",
        str(tmp_path / "map.json"),
        "--unit",
        "cm",
    ]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "warning: the mean body lies" in said
    for line in (
        r"up +-Z +--up +chosen",
        r"rate +15 frames a second +--fps +chosen",
        r"unit +cm +--unit +chosen",
        "limbs +0.0",
        "left_knee +LeftLeg",
    ):
        assert re.search(line, said), line
    assert main(["motion", "check", str(odd), str(tmp_path / "seen.png"), "--frames", "0:2"]) == 0
    picture = np.asarray(Image.open(tmp_path / "seen.png"))
    blue, orange = (np.abs(picture.astype(int) - colour).max(2) < 8 for colour in ((38, 110, 190), (200, 80, 40)))
    assert blue.sum() > 100
    assert orange.sum() > 100


def test_the_table_keeps_its_columns_apart(tmp_path: Path, capsys) -> None:
    np.savez(tmp_path / "body.npz", body_pose=np.zeros((2, 63)), expression=np.ones((2, 2)))
    (tmp_path / "table.csv").write_text("name,0,1\njawOpen,0.5,0\n")
    for words, line in (
        ([], "expression +not applied +--expressions +coefficients of another face"),
        (["--expressions", str(tmp_path / "table.csv")], "expression +by 1 rows of table.csv +--expressions +chosen"),
    ):
        assert main(["motion", "check", str(tmp_path / "body.npz"), *words]) == 0
        assert re.search(line, capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["motion", "check", "none.bvh"], "none.bvh: expected a motion file, found nothing there"),
        (["motion", "check", "wave", "--up", "Z"], "--up: expected one of +X, -X"),
        (["motion", "check", "wave", "--up", "+Y", "--forward", "-Y"], "--forward: expected an axis across up"),
        (["motion", "check", "wave", "--unit", "ell"], "--unit: expected m, dm, cm"),
        (["motion", "check", "wave", "--fps", "x"], "--fps: expected a finite number"),
        (["motion", "check", "wave", "--frames", "0:2"], "--frames: expected OUT.png with it"),
        (["motion", "check", "wave", "out.jpg"], "out.jpg: expected OUT.png"),
        (["render", "out.png", "--lock-feet"], "--lock-feet: expected --motion FILE with it"),
        (["render", "out.png", "--rest", "bones"], "--rest: expected --motion FILE with it"),
    ],
)
def test_wrong_options_are_refused_in_one_line(
    words: list[str], message: str, capsys, monkeypatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_a_map_that_is_none_is_named(odd: Path, tmp_path: Path, capsys) -> None:
    for text, message in (
        ("[1]", "map.json: expected an object"),
        ('{"tail": "x"}', "map.json: expected one of pelvis"),
    ):
        (tmp_path / "map.json").write_text(text)
        assert main(["motion", "check", str(odd), "--map", str(tmp_path / "map.json")]) == 2
        assert message in capsys.readouterr().err


def read_again(test, window) -> None:
    """Let the window draw until the file has been read as chosen, and is shown."""
    test.yield_(2)
    driving.until(test, lambda: not window.opening.busy)
    test.yield_(4)


@pytest.mark.window
def test_a_guess_is_changed_in_the_window(display, odd: Path, tmp_path: Path) -> None:
    seen = {}

    def scenario(test, window):
        rest(test, window)
        studio = window.studio
        test.item_click(f"//Timeline/{icons.ICON_FA_PERSON_WALKING}  Motions##motion.own")
        test.yield_(3)
        test.item_click("//$FOCUSED/Wave: " + MOTIONS["wave"])
        test.yield_(3)
        seen["own"] = studio.state.timeline.motion
        seen["quiet"] = window.timeline.reading.shown
        studio.open_motion(str(odd))
        test.yield_(4)
        seen["warned"] = window.timeline.reading.shown
        test.set_ref("//How the motion was read")
        test.item_click("guesses/##up")
        test.yield_(2)
        test.item_click("//$FOCUSED/+Z")
        read_again(test, window)
        seen["chosen"] = studio.state.timeline.motion.options
        studio.save_session(str(tmp_path / "s.json"))
        seen["signals"] = studio.state.signals
        studio.undo()
        test.yield_(2)
        seen["undone"] = studio.state.timeline.motion.options
        test.item_click("guesses/##floor")
        test.yield_(2)
        test.item_click("//$FOCUSED/each")
        read_again(test, window)
        seen["next"] = studio.state.timeline.motion.options
        window.opening.again(str(odd), ImportOptions(fps=29.97))
        read_again(test, window)
        test.item_click("guesses/##fps")
        test.key_press(imgui.Key.enter)
        read_again(test, window)
        seen["fps"] = studio.state.timeline.motion.options
        test.item_click("guesses/Stay where they stand##lock_feet")
        read_again(test, window)
        seen["feet"] = studio.state.timeline.motion.options
        window.timeline.reading.shown = False
        studio.open_session(str(tmp_path / "s.json"))
        window.timeline.reading.open()
        test.yield_(4)
        seen["opened"] = window.timeline.reading.shown

    drive(ball_engine, scenario)
    assert seen["own"].path == "wave"
    assert not seen["quiet"]
    assert seen["warned"]
    assert seen["chosen"] == ImportOptions(up="+Z")
    assert seen["undone"] == ImportOptions()
    assert seen["next"] == ImportOptions(floor="each"), "the undone choice does not come back"
    assert seen["fps"] == ImportOptions(fps=29.97)
    assert seen["feet"] == ImportOptions(fps=29.97, lock_feet=True)
    assert seen["opened"], "a session that was opened has a motion, before it plays"
    again = Journal.load(str(tmp_path / "s.json")).state
    assert again.signals == seen["signals"]
    assert again.timeline.motion is not None
    assert again.timeline.motion.options == ImportOptions(up="+Z")


@pytest.mark.window
def test_a_file_that_is_read_again_slowly_is_waited_for_and_can_be_given_up(display, odd: Path, monkeypatch) -> None:
    """The interface goes on, the table waits; what was given up, and what another motion has overtaken, changes nothing."""
    seen, going, read = {}, threading.Event(), opening.read_motion
    monkeypatch.setattr(
        "avatarrex_studio.window.opening.read_motion",
        lambda path, options=None: going.wait(60) and read(path, options),
    )

    def scenario(test, window):
        rest(test, window)
        studio = window.studio
        studio.open_motion(str(odd))
        test.yield_(4)
        test.set_ref("//How the motion was read")

        def pick(entry: str) -> None:
            test.item_click("guesses/##up")
            test.yield_(2)
            test.item_click("//$FOCUSED/" + entry)
            test.yield_(6)

        pick("+Z")
        seen["words"], seen["waits"] = window.opening.words, studio.state.timeline.motion.options
        seen["locked"] = bool(test.item_info("guesses/##up").item_flags & int(imgui.ItemFlags_.disabled))
        test.item_click("###cancel.again")
        test.yield_(4)
        seen["free"] = not window.opening.busy
        going.set()
        test.yield_(10)
        seen["given up"] = studio.state.timeline.motion.options
        going.clear()
        pick("+Z")
        studio.open_motion("wave")
        going.set()
        read_again(test, window)
        seen["overtaken"] = studio.state.timeline.motion

    drive(ball_engine, scenario)
    assert seen["words"] == f"opening {odd.name}…"
    assert seen["waits"] == seen["given up"] == ImportOptions()
    assert seen["locked"]
    assert seen["free"]
    assert seen["overtaken"].path == "wave"


@pytest.mark.window
def test_how_hands_and_a_face_are_read_is_changed_in_the_window(display, tmp_path: Path) -> None:
    """A side and the flat hand from lists, a model and a table as files."""
    seen = {}
    mean = np.full(45, 0.1)
    np.savez(tmp_path / "hand.npz", poses=np.zeros((2, 48)), side="left", flat_hand_mean=False, hands_mean=mean)
    np.savez(tmp_path / "body.npz", body_pose=np.zeros((2, 63)), left_hand_pose=np.zeros((2, 45)),
             expression=np.ones((2, 2)))  # fmt: skip
    np.savez(tmp_path / "MANO_LEFT.npz", hands_mean=mean)
    (tmp_path / "table.csv").write_text("name,0,1\njawOpen,0.5,0\n")

    def scenario(test, window):
        rest(test, window)
        studio, reading = window.studio, window.timeline.reading

        def picks(field: str, *entry: str) -> ImportOptions:
            test.item_click(f"guesses/##{field}")
            test.yield_(2)
            test.item_click(f"//$FOCUSED/{entry[0]}")
            read_again(test, window)
            for name in entry[1:]:
                seen[f"title of {name}"] = reading.files._title
                test.key_press(
                    int(imgui.Key.tab)
                )  # out of the name's field, whose text is its own while it has the keys
                test.yield_(2)
                reading.files.name = str(tmp_path / name)
                test.yield_(2)
                test.item_click("**/###answer")
                read_again(test, window)
            return studio.state.timeline.motion.options

        def opened(name: str) -> None:
            studio.open_motion(str(tmp_path / name))
            test.yield_(2)
            reading.open()
            test.yield_(4)

        opened("hand.npz")
        test.set_ref("//How the motion was read")
        seen["side"] = picks("side", "right")
        seen["flat"] = picks("hand_mean", "flat")
        seen["guessed"] = picks("hand_mean", "guessed")
        opened("body.npz")
        seen["model"] = picks("hand_mean", "a file…", "MANO_LEFT.npz")
        seen["table"] = picks("expressions", "a file…", "table.csv")
        seen["signals"] = studio.state.signals

    drive(ball_engine, scenario)
    assert seen["side"] == ImportOptions(side="right")
    assert seen["flat"] == ImportOptions(side="right", hand_mean="flat")
    assert seen["guessed"] == ImportOptions(side="right")
    model = ImportOptions(hand_mean=str(tmp_path / "MANO_LEFT.npz"))
    assert seen["model"] == model
    assert seen["table"] == replace(model, expressions=str(tmp_path / "table.csv"))
    np.testing.assert_allclose(seen["signals"].left_hand_pose.ravel(), mean)
    assert seen["signals"].expression.max() == pytest.approx(0.5)
    assert seen["title of table.csv"] == "Open a table of expressions"


def test_the_window_does_not_name_options_of_the_command_line():
    said = "the mean body lies, 80° from upright: if it should stand, choose another up (--up +Y, +Z …)"
    assert without_options(said) == "the mean body lies, 80° from upright: if it should stand, choose another up"
    said = "another joint may be meant (--map FILE.json), or the rest pose is read wrongly (--rest bones or pose)"
    assert without_options(said) == "another joint may be meant, or the rest pose is read wrongly"
