"""Files that the program wrote before its rooms were moved load, and mean what they meant.

Written once by the program at commit `87ca6f7` and never again: a session of the studio, the run folder of `tests/tiny_run.py`, a
capture of `tests/capture/tiny_capture.py` (its exact mesh cut to 300 vertices), and the numbers and 32×32 pictures it made of them. The
packaged avatar is its own fixture: when it is trained anew, `avatar_numbers.json`, `avatar.png` and `session.png` are made anew.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import tiny_run
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import OrbitView, StudioState
from PIL import Image

from avatarrex.avatar_file import load_avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.files.images import composite
from avatarrex.gl.context import NoContext, gl_context, renderer_name
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.events import EventReader

HERE = Path(__file__).parent
LEVELS = 1.0
"""Largest mean difference of two pictures, of 255; a shift by one pixel makes more than four times as much."""


def stored(name: str) -> dict[str, np.ndarray]:
    """The numbers beside a file."""
    with np.load(HERE / f"{name}_numbers.npz") as arrays:
        return dict(arrays)


def as_before(state: StudioState, name: str) -> None:
    """Fail where the picture of `state` is not the stored one; skip where it is not drawn by the same rays."""
    try:
        renderer = renderer_name(gl_context())
    except NoContext as error:
        pytest.skip(f"pictures are compared on Mesa llvmpipe; here is no OpenGL: {error}")
    if "llvmpipe" not in renderer:
        pytest.skip(f"pictures are compared on Mesa llvmpipe; here is {renderer}")
    shot = Engine().render(state, (32, 32))
    assert shot.error is None, shot.error
    assert shot.frame is not None
    with Image.open(HERE / f"{name}.png") as image:
        before = np.asarray(image.convert("RGB")).astype(int)
    now = composite(shot.frame.image, state.background)[..., :3]
    assert np.abs(now - before).mean() < LEVELS
    assert np.abs(now - np.roll(before, 1, 1)).mean() > 4 * LEVELS, (
        "a picture that a pixel's shift leaves alone shows nothing"
    )


def test_a_session() -> None:
    state = Journal.load(HERE / "session.json").state
    now, then = json.loads(json.dumps(state.to_json())), json.loads((HERE / "session_state.json").read_text())
    assert then.pop("format") <= now.pop("format")
    motion = then.pop("motion")
    assert now["view"].pop("orthographic") is False, "views of before have perspective"
    assert {name: now[name] for name in then} == then
    clip = state.timeline.motion
    assert clip is not None
    assert clip.to_json() | {"frame": state.timeline.frame} == motion
    assert state.timeline.frame == 2
    as_before(state, "session")


def test_the_packaged_avatar() -> None:
    avatar, before = load_avatar("default"), json.loads((HERE / "avatar_numbers.json").read_text())
    tensors = [tensor.double() for tensor in avatar.state().values()]
    assert avatar.person.hash == before["hash"]
    assert len(tensors) == before["tensors"]
    total, absolute = (sum(float(part.sum()) for part in parts) for parts in (tensors, [one.abs() for one in tensors]))
    assert total == pytest.approx(before["sum"], rel=1e-10), (
        "what is computed while reading rounds otherwise on other processors"
    )
    assert absolute == pytest.approx(before["absolute"], rel=1e-10)
    signals = Signals.rest().replace(body_pose=named_pose("stand"))
    view = OrbitView(azimuth=30.0, distance=2.75)
    as_before(StudioState(signals=signals, view=view, background=(0.3, 0.45, 0.6, 1.0)), "avatar")


def test_a_capture() -> None:
    capture, before = open_capture(HERE / "capture.zip"), stored("capture")
    assert capture.ground_truth.keys() == capture.rigs.keys()
    assert capture.notes == ()
    assert [view.name for rig in capture.rigs.values() for view in rig.views] == before["names"].tolist()
    for name, rig in capture.rigs.items():
        cameras = [view.camera for view in rig.views]
        now = {
            "pose": [frame.full_pose() for frame in rig.signals],
            "translation": [frame.translation for frame in rig.signals],
            "expression": [frame.expression for frame in rig.signals],
            "shape": rig.signals[0].shape,
            "intrinsics": [camera.intrinsics for camera in cameras],
            "camera_from_world": [camera.camera_from_world for camera in cameras],
            "image": rig.image(0, 1),
            "matte": rig.matte(0, 1),
            "vertices": capture.ground_truth[name].vertices[1],
            "held out": [sorted(rig.held_out_frames), sorted(rig.held_out_views)],
        }
        for key, value in now.items():
            np.testing.assert_allclose(np.asarray(value), before[f"{name} {key}"], rtol=0, atol=1e-12, err_msg=key)


def test_a_run_goes_on(tmp_path: Path) -> None:
    """Its checkpoint is the state that was saved, its numbers are read, and three more steps lead where they led."""
    run, before = tmp_path / "run", stored("run")
    shutil.copytree(HERE / "run", run)
    saved = checkpoint.read(run / "checkpoints" / "step_00000006")["model"]
    for name, value in saved.items():
        assert np.array_equal(value.numpy(), before[f"saved {name}"])
    reader = EventReader(run)
    while reader.poll():
        pass
    events = json.loads((HERE / "run_events.json").read_text())
    assert {
        tag: [reader.series(tag).steps.tolist(), reader.series(tag).values.tolist()] for tag in reader.tags
    } == events
    tiny_run.fit(run, steps=9, every=3)
    resumed = checkpoint.read(run / "checkpoints" / "step_00000009")["model"]
    for name, value in resumed.items():
        np.testing.assert_allclose(value.numpy(), before[f"resumed {name}"], atol=1e-5, err_msg=name)
        assert np.abs(value.numpy() - before[f"saved {name}"]).max() > 1e-3 or name == "waves"
