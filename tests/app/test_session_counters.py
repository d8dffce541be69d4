"""A recorded session through the engine: what every step works is what the skip table says (docs/architecture.md).

| what changed   | what runs                                                                      |
|----------------|--------------------------------------------------------------------------------|
| nothing        | nothing                                                                        |
| view, root     | rays and colours; patches of nodes that were not in sight before               |
| expression     | its U-Nets and box, rays, colours                                              |
| a hand         | its box alone, rays, colours; the body's voxels in the box where it meets the body |
| body pose      | body voxels and patches, rays, colours; boxes of hands and face only move      |
| a part hidden  | nothing of that part                                                           |
| a part not in sight | nothing of that part but its mesh, until it comes into sight              |
"""

from __future__ import annotations

import pytest
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.skips import WORK, skipped
from avatarrex_studio.engine.work import Work
from avatarrex_studio.session import commands
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import LEVELS, StudioState

from avatarrex.avatar_file import load_avatar
from avatarrex.errors import InputError
from avatarrex.levels import LEVELS as TABLE
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals

SIZE = (40, 40)
CAST = {"rays", "colour"}
BODY = {"templates", "body", "patches"}
FACE = {"templates", "face", "U-Nets"}
HAND = {"templates", "hands"}
STEPS = {
    "start": (commands.SetLevel("fast"), BODY | FACE | HAND | CAST),
    "idle": (None, set()),
    "body": (commands.ApplyPose("wave"), BODY | CAST),
    "one joint": (commands.SetJoint("left_knee", (0.4, 0.0, 0.0)), BODY | CAST),
    "expression": (commands.ApplyExpression("jaw_open"), FACE | CAST),
    "raised hand": (commands.SetHandPose("right", "point"), HAND | CAST),
    "hand at the thigh": (commands.SetHandPose("left", "fist"), HAND | CAST | {"body"}),
    "view": (commands.OrbitBy(40.0, 10.0), CAST),
    "root": (commands.SetTranslation((0.1, 0.0, 0.2)), CAST),
    "turned": (commands.SetJoint("pelvis", (0.0, 0.5, 0.0)), CAST),
    "background": (commands.SetBackground((1.0, 1.0, 1.0, 1.0)), set()),
    "hidden hand": (commands.SetHidden("left_hand", True), CAST),
    "a hidden hand's pose": (commands.SetHandPose("left", "spread"), {"templates"}),
    "hidden face": (commands.SetHidden("face", True), CAST),
    "a hidden face's expression": (commands.ApplyExpression("smile"), {"templates"}),
    "idle again": (None, set()),
    "shown again": (commands.SetHidden("face", False), FACE - {"templates"} | CAST),
    "close to a foot": (commands.SetCamera(distance=0.5, target=(0.1, -0.9, 0.3)), CAST),
    "off screen": (commands.ApplyExpression("jaw_open"), {"templates", "rays"}),
    "an expression off screen": (commands.ApplyExpression("neutral"), {"templates"}),
    "a hand off screen": (commands.SetHandPose("right", "fist"), {"templates", "rays"}),
    "idle off screen": (None, set()),
    "all in view": (commands.SetCamera(distance=3.5, target=(0.1, 0.0, 0.2)), FACE - {"templates"} | {"hands"} | CAST),
}
"""Step → command, and the names of `skips.WORK` whose counters then do not read zero."""
SIGHT = ("view", "root", "turned", "all in view")
"""Which nodes come into sight there depends on the avatar."""


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """The frames of the session, which is recorded, saved and read again on the way."""
    path, journal = tmp_path_factory.mktemp("session") / "session.json", Journal()
    engine = Engine(load_avatar(), settings=RenderSettings(raycast="torch"))
    frames, states = {}, {}
    for name, (command, _) in STEPS.items():
        if command:
            journal.do(command)
        states[name] = journal.state
        shot = engine.render(journal.state, SIZE)
        assert shot.error is None
        frames[name] = shot.frame
    journal.save(path)
    assert Journal.load(path).state == journal.state
    return frames, states


@pytest.mark.parametrize("name", STEPS)
def test_a_step_works_what_the_table_says(session, name):
    counters = session[0][name].counters
    worked = {kind for kind, counter in WORK.items() if counters[counter]}
    assert worked - ({"patches"} if name in SIGHT else set()) == STEPS[name][1]


def test_a_node_s_patch_is_decoded_once_a_pose(session):
    frames, _ = session
    names = list(STEPS)
    of_pose = [frames[name].counters["patches_decoded"] for name in names[names.index("one joint") :]]
    assert sum(of_pose) == int(frames[names[-1]].shading.patches.decoded.sum())
    assert sum(of_pose) > of_pose[0], "some nodes come into sight later"


def test_a_frame_of_nothing_is_the_frame_before(session):
    frames, _ = session
    names = list(STEPS)
    for idle in ("idle", "background", "idle again", "idle off screen"):
        before = frames[names[names.index(idle) - 1]]
        assert not any(frames[idle].counters.values())
        assert frames[idle].image is before.image
    for name in ("view", "root", "turned"):
        assert frames[name].volume is frames["hand at the thigh"].volume


def test_parts_that_do_not_change_are_kept(session):
    frames, _ = session
    start, raised, other = (frames[name].volume for name in ("expression", "raised hand", "hand at the thigh"))
    assert start.grid is raised.grid is other.grid
    assert start.parts["left_hand"] is raised.parts["left_hand"]
    assert start.parts["face"] is raised.parts["face"] is other.parts["face"]
    assert raised.parts["right_hand"] is other.parts["right_hand"]
    assert all(frames["body"].volume.parts[part] is box for part, box in frames["idle"].volume.parts.items())


def test_what_is_skipped_has_its_reason(session):
    frames, _ = session
    reasons = {name: skipped(Work.of([frame], "fast")) for name, frame in frames.items()}
    assert reasons["start"] == {}
    assert set(reasons["idle"]) == set(WORK)
    assert reasons["view"]["body"] == "body pose unchanged: body voxels kept"
    assert reasons["body"]["hands"] == "hand poses unchanged: boxes kept"
    assert reasons["hidden hand"]["hands"] == "right hand unchanged, the other hidden: box kept"
    assert reasons["hidden face"]["U-Nets"] == "face hidden: no box"
    assert reasons["an expression off screen"]["face"] == "face out of sight: no box"
    assert reasons["a hand off screen"]["hands"] == "both hands hidden or out of sight: no boxes"


def test_a_state_s_level_is_what_is_rendered(session):
    engine = Engine(load_avatar(), settings=RenderSettings(raycast="torch", detail_from=Signals.rest()))
    for name in LEVELS:
        settings = engine.settings(StudioState(level=name, hidden=frozenset({"face"})))
        table = TABLE["quality" if name == "auto" else name]
        traded = ("voxel", "part_voxel", "everywhere", "bricks", "march", "antialias", "polish")
        assert all(getattr(settings, field) == getattr(table, field) for field in traded)
        assert (settings.hidden, settings.raycast) == (frozenset({"face"}), "torch")
        assert settings.detail_from is not None
    assert session[0]["start"].settings.part_voxel == TABLE["fast"].part_voxel


def test_the_levels_of_the_state_are_those_of_the_library():
    assert set(LEVELS) == {"auto", *TABLE}
    with pytest.raises(InputError, match=r"level.*auto or live.*best"):
        StudioState(level="best")
