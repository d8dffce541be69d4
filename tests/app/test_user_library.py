"""A user's library on the disk, and what applies its entries."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from avatarrex_studio.panels.own_entries import OwnEntries
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import (
    ApplyPose,
    Blend,
    Command,
    PutOnFloor,
    ScaleGroup,
    SetExpression,
    SetFaceMacro,
    SetFingers,
    SetJoint,
)
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.user_library import Entry, UserLibrary, library_folder, parts_of, taken

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.ground import lowest
from avatarrex.signals.library import mirror, named_expression, named_hand, named_pose
from avatarrex.signals.limits import random_signals, violations
from avatarrex.signals.macros import face_value, hand_values

SIGNALS = random_signals(np.random.default_rng(3))


@pytest.fixture
def library(tmp_path):
    return UserLibrary(tmp_path / "mine")


@pytest.mark.parametrize("kind", ["pose", "hand", "expression"])
def test_what_is_saved_is_there_for_whoever_opens_the_folder(library, kind):
    entry = taken(SIGNALS, kind, "Mine 1")
    library.save(entry)
    other = UserLibrary(library.folder)
    other.read()
    assert other.entries[kind] == {"Mine 1": entry}
    assert other.refused == []
    for part, value in parts_of(entry).items():
        assert np.array_equal(value, getattr(SIGNALS, part))


def test_what_others_change_in_the_folder_is_seen(library):
    library.follow()
    other = UserLibrary(library.folder)
    other.save(taken(SIGNALS, "pose", "theirs"))
    assert "theirs" not in library.entries["pose"]
    library.follow()
    assert "theirs" in library.entries["pose"]
    kept = library.entries["pose"]
    library.follow()
    assert library.entries["pose"] is kept, "nothing has changed, nothing is read"
    shutil.rmtree(library.folder)
    library.follow()
    assert not library.entries["pose"]


def test_the_panel_looks_again_after_a_while(library, clock):
    own = OwnEntries(library, clock)
    assert not own.entries("pose")
    UserLibrary(library.folder).save(taken(SIGNALS, "pose", "theirs"))
    assert not own.entries("pose")
    clock.now += 2.5
    assert list(own.entries("pose")) == ["own:theirs"]


def test_rename_overwrite_and_delete(library):
    library.save(taken(SIGNALS, "pose", "a"))
    library.save(taken(Signals.rest(), "pose", "b"))
    with pytest.raises(InputError, match="one that is not taken, found b"):
        library.rename("pose", "a", "b")
    with pytest.raises(InputError, match="one that is not taken, found a"):
        library.save(taken(Signals.rest(), "pose", "a"))
    library.rename("pose", "a", "c")
    assert sorted(path.name for path in (library.folder / "pose").iterdir()) == ["b.json", "c.json"]
    library.save(taken(SIGNALS, "pose", "b"), overwrite=True)
    library.delete("pose", "c")
    library.read()
    assert list(library.entries["pose"]) == ["b"]
    assert np.array_equal(library.entries["pose"]["b"].signals.body_pose, SIGNALS.body_pose)


@pytest.mark.parametrize("name", ["", " a", "../up", "a/b", "a.b", "NUL", "x" * 61, "a\n", "\x00"])
def test_names_that_no_file_can_have_are_refused(library, name):
    with pytest.raises(InputError, match="name: expected 1 to 60 letters"):
        library.save(Entry("pose", name, SIGNALS))
    assert not library.folder.exists()


GOOD = taken(SIGNALS, "pose", "x").to_json()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "an entry of a library"),
        ("[" * 900, "nested"),
        ("[1]", "kind: expected pose or hand or expression, found list"),
        (json.dumps({**GOOD, "kind": "hand"}), "signals: expected an object of left_hand_pose"),
        (json.dumps({**GOOD, "format": 9}), "format: expected 1, found 9"),
        (json.dumps({**GOOD, "name": "y"}), "name: expected x, found y"),
        (json.dumps({**GOOD, "name": 5}), "name: expected 1 to 60 letters"),
        (json.dumps({**GOOD, "signals": 5}), "signals: expected an object of"),
        (json.dumps({**GOOD, "signals": [1, "a"]}), "signals: expected an object of"),
        (json.dumps({**GOOD, "kind": []}), "kind: expected pose or hand or expression"),
        (json.dumps({**GOOD, "script": "rm"}), "script: expected one of format"),
        (json.dumps({**GOOD, "signals": {**GOOD["signals"], "body_pose": [[1e9] * 3] * 21}}), "body_pose: expected numbers up to"),
        (json.dumps({**GOOD, "signals": {**GOOD["signals"], "body_pose": "a"}}), "body_pose: expected numbers"),
        (" " * 2**17, "at most"),
    ],
)  # fmt: skip
def test_a_hostile_file_is_one_line_and_the_rest_is_read(library, content, said):
    library.save(taken(SIGNALS, "pose", "good"))
    (library.folder / "pose" / "x.json").write_text(content)
    library.read()
    assert list(library.entries["pose"]) == ["good"]
    (line,) = library.refused
    assert said in line
    assert "x.json" in line
    assert "\n" not in line


def test_the_folder_can_be_named_and_follows_the_system(monkeypatch, tmp_path):
    monkeypatch.setenv("AVATARREX_LIBRARY", str(tmp_path))
    assert library_folder() == tmp_path
    monkeypatch.delenv("AVATARREX_LIBRARY")
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    assert library_folder() == tmp_path / "data" / "avatarrex-studio" / "library"


def test_a_hand_that_was_saved_from_the_right_is_put_on_either(library):
    entry = taken(SIGNALS, "hand", "grip", "right")
    both = parts_of(entry, sides=("left", "right"))
    assert np.allclose(both["right_hand_pose"], SIGNALS.right_hand_pose)
    assert np.allclose(both["left_hand_pose"], mirror(SIGNALS).left_hand_pose)


def test_a_pose_is_put_on_as_in_a_mirror(library):
    parts = parts_of(taken(SIGNALS, "pose", "p"), mirrored=True)
    assert np.allclose(parts["body_pose"], mirror(SIGNALS).body_pose)
    assert np.allclose(parts["left_hand_pose"], mirror(SIGNALS).left_hand_pose)


def blend(amount):
    return Blend("wave", Signals.rest().replace(body_pose=named_pose("wave")), ("body_pose",), amount)


def test_a_blend_goes_from_the_state_before_the_drag_and_is_one_step():
    journal = Journal(StudioState(signals=SIGNALS))
    for amount in (0.1, 0.9, 0.5):
        journal.do(blend(amount), "drag")
    half = journal.state.signals
    assert len(journal.steps) == 1
    direct = blend(0.5).apply(StudioState(signals=SIGNALS)).signals
    assert half == direct
    assert np.array_equal(half.expression, SIGNALS.expression), "only its own parts"
    assert np.allclose(blend(1.0).apply(StudioState(signals=SIGNALS)).signals.body_pose, named_pose("wave"))
    again = Journal.from_json(json.loads(json.dumps(journal.to_json())))
    assert again.state == journal.state
    assert journal.undo().signals == SIGNALS


def test_a_blend_goes_back_to_where_it_began_after_the_entry_was_applied():
    """A click applies the entry; the slider then goes from it to the state before the click."""
    before, entry = StudioState(signals=SIGNALS), blend(1.0)
    journal = Journal(before)
    journal.do(entry)
    for amount in (0.4, 0.0, 0.25):
        journal.do(replace(entry, amount=amount, start=SIGNALS), "drag")
    assert journal.state.signals == blend(0.25).apply(before).signals
    assert Journal.from_json(json.loads(json.dumps(journal.to_json()))).state == journal.state
    journal.do(replace(entry, amount=0.0, start=SIGNALS), "drag")
    assert journal.state.signals == SIGNALS, "to the bit"


def test_a_figure_is_put_on_the_floor():
    for name in ("squat", "kneel", "jump"):
        state = PutOnFloor().apply(
            StudioState(signals=SIGNALS.replace(body_pose=named_pose(name), translation=np.array([0.3, 0.9, -1.0])))
        )
        signals = state.signals
        assert abs(lowest(signals.full_pose()[None], signals.translation[None])[0]) < 1e-9
        assert list(signals.translation[[0, 2]]) == [0.3, -1.0], "its place stays"


def test_blends_that_cannot_be_are_refused():
    with pytest.raises(InputError, match=r"0 to 1, found 1.5"):
        blend(1.5).apply(StudioState())
    with pytest.raises(InputError, match="tail: expected one of"):
        Blend("x", SIGNALS, ("tail",)).apply(StudioState())


def test_linked_sides_move_together():
    state = SetJoint("left_elbow", (0.1, -0.5, 0.05), linked=True).apply(StudioState())
    assert np.allclose(mirror(state.signals).body_pose, state.signals.body_pose)
    assert posing.joint(state.signals, "right_elbow") == pytest.approx((0.1, 0.5, -0.05))
    assert not any(posing.joint(SetJoint("left_elbow", (0.1, -0.5, 0)).apply(StudioState()).signals, "right_elbow"))
    face = SetExpression("browDownRight", 0.4, linked=True).apply(StudioState()).signals
    assert np.count_nonzero(face.expression) == 2
    assert np.count_nonzero(SetExpression("jawLeft", 0.4, linked=True).apply(StudioState()).signals.expression) == 1


def test_finger_macros_keep_to_the_limits_where_they_are_on():
    state = SetFingers("left all curl", 1.0, linked=True).apply(StudioState())
    assert violations(state.signals) == ()
    assert np.allclose(mirror(state.signals).left_hand_pose, state.signals.left_hand_pose)
    free = SetFingers("left index curl", 2.0).apply(StudioState(limit_joints=False)).signals
    assert hand_values(free.left_hand_pose, "left")["index", "curl"] == pytest.approx(2.0)
    assert not free.right_hand_pose.any()
    with pytest.raises(InputError, match="left or right, found middle"):
        SetFingers("middle index curl", 1.0).apply(StudioState())


def test_a_drag_of_a_macro_is_one_step_and_replays():
    journal = Journal(StudioState(signals=Signals.rest().replace(left_hand_pose=named_hand("point", "left"))))
    for value in (0.2, 0.8, 0.4):
        journal.do(SetFingers("left middle curl", value), "drag")
    journal.do(SetFaceMacro("smile", 0.7), "face")
    assert len(journal.steps) == 2
    assert face_value(journal.state.signals.expression, "smile") == pytest.approx(0.7)
    assert Journal.from_json(journal.to_json()).state == journal.state


@pytest.mark.parametrize("command", [blend, lambda amount: ScaleGroup("mouth", 1 - amount)])
def test_a_drag_that_comes_back_leaves_nothing(command):
    """Relative commands, whose last value alone is no change of the present state."""
    laugh = StudioState(signals=SIGNALS.replace(expression=named_expression("laugh")))
    journal = Journal(laugh)
    for amount in (0.5, 1.0, 0.0):
        journal.do(command(amount), "drag")
    assert journal.state == laugh
    assert journal.steps == []
    for amount in (0.0, 1.0, 0.25):
        journal.do(command(amount), "another")
    assert journal.state == command(0.25).apply(laugh)
    assert len(journal.steps) == 1
    journal.undo()
    assert journal.state == laugh


def test_a_region_is_no_stronger_than_its_coefficients_go():
    state = StudioState(signals=Signals.rest().replace(expression=named_expression("laugh")))
    assert ScaleGroup("mouth", 2.0).apply(state).signals.expression.max() == 1.0


def test_a_region_is_made_weaker_from_what_it_was():
    journal = Journal(StudioState(signals=Signals.rest().replace(expression=named_expression("laugh"))))
    for factor in (0.2, 0.5):
        journal.do(ScaleGroup("mouth", factor), "drag")
    was, now = named_expression("laugh"), journal.state.signals.expression
    names = posing.GROUPS["mouth"]
    rows = [posing.SLOTS[name].start - 165 for name in names]
    assert np.allclose(now[rows], was[rows] / 2)
    others = np.setdiff1d(np.arange(52), rows)
    assert np.array_equal(now[others], was[others])


def test_a_pose_that_needs_its_hands_brings_them():
    start = StudioState(signals=SIGNALS)
    clasped = ApplyPose("clasped_hands").apply(start).signals
    assert not np.allclose(clasped.left_hand_pose, SIGNALS.left_hand_pose)
    assert np.array_equal(ApplyPose("squat").apply(start).signals.left_hand_pose, SIGNALS.left_hand_pose)


def test_new_commands_are_written_and_read():
    for command in (
        blend(0.5),
        SetFingers("left all curl", 0.5, True),
        SetFaceMacro("ah", 0.2),
        ScaleGroup("brow", 0.5),
    ):
        assert Command.from_json(json.loads(json.dumps(command.to_json()))) == command
