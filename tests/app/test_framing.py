"""The framed view: every point inside the margin, one on it; the person whole in every frame of a motion."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from avatarrex_studio.cli import main as cli
from avatarrex_studio.engine.framing import FREE_SHARE, Outline, backed_off, framed
from avatarrex_studio.engine.looks import look_of
from avatarrex_studio.session.state import OrbitView, StudioState
from ball import ball_engine
from PIL import Image

from avatarrex.counters import Counters
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import POSES, named_pose
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import pose_person


def reach(view, points, size):
    """How far points lie from the picture's middle: (2,) largest and (2,) smallest shares of half its sides."""
    camera = view.camera(*size)
    pixels, depth = camera.pixels(points)
    assert (depth > 0).all()
    shares = pixels / camera.intrinsics[:2, 2] - 1
    return shares.max(0), shares.min(0)


@pytest.mark.parametrize("size", [(512, 512), (640, 360), (200, 500)])
@pytest.mark.parametrize("angles", [(0.0, 0.0), (20.0, 5.0), (-130.0, -40.0), (75.0, 89.0)])
def test_all_points_lie_inside_and_the_outermost_on_the_margin(size, angles):
    points = np.random.default_rng(3).normal(size=(200, 3)) * (0.3, 0.8, 0.5) + (4.0, -2.0, 7.0)
    view = framed(OrbitView(*angles, fov=35.0), points, size)
    high, low = reach(view, points, size)
    assert high.max() == pytest.approx(1 - FREE_SHARE)
    axis = high.argmax()
    assert low[axis] == pytest.approx(-high[axis]), "the tight axis is centred"
    assert low.min() >= -(1 - FREE_SHARE) - 1e-9
    about = backed_off(view, points, size)
    assert about.distance == pytest.approx(view.distance), "no nearer camera about the same target sees them all"
    aside = backed_off(OrbitView(*angles, target=(4.5, -2.0, 7.0)), points, size)
    assert max(*np.abs(reach(aside, points, size)).ravel()) == pytest.approx(1 - FREE_SHARE)


@pytest.mark.parametrize("size", [(512, 512), (640, 360)])
@pytest.mark.parametrize("angles", [(0.0, 0.0), (-130.0, -40.0)])
def test_a_view_without_perspective_has_all_points_inside_too(size, angles):
    points = np.random.default_rng(3).normal(size=(200, 3)) * (0.3, 0.8, 0.5) + (4.0, -2.0, 7.0)
    view = framed(OrbitView(*angles, fov=35.0, orthographic=True), points, size)
    assert view.orthographic
    high, low = reach(view, points, size)
    assert max(high.max(), -low.min()) == pytest.approx(1 - FREE_SHARE, abs=2e-3)
    about = OrbitView(*angles, fov=35.0, target=(4.0, -2.0, 7.0), orthographic=True)
    high, low = reach(backed_off(about, points, size), points, size)
    assert max(high.max(), -low.min()) == pytest.approx(1 - FREE_SHARE, abs=2e-3)


def test_the_lens_of_a_view_without_perspective():
    """The scale at the target is that with perspective, however wide; depths are shown about the target."""
    for fov, distance in ((40.0, 3.0), (40.0, 2500.0), (170.0, 1e4)):
        view = OrbitView(fov=fov, distance=distance)
        far, (lens, angle) = replace(view, orthographic=True), replace(view, orthographic=True).lens
        assert lens * np.tan(np.radians(angle) / 2) == pytest.approx(distance * np.tan(np.radians(fov) / 2))
        assert far.camera(64, 64).pixels(np.zeros((1, 3)))[1][0] > 0
    look = look_of("depth", OrbitView(orthographic=True))
    assert look is not None
    assert look.near < OrbitView(orthographic=True).lens[0] < look.far


def test_the_outline_is_the_posed_body():
    """Against all vertices, in three poses, turned and far from the origin; the hands flat in both."""
    person = load_person("default")
    outline = Outline(person.body)
    for name in ("stand", "squat", "arms_up"):
        signals = Signals.rest().replace(
            body_pose=named_pose(name),
            global_orient=np.array([0.1, 2.0, -0.2]),
            translation=np.array([30.0, 0.2, -9.0]),
        )
        posed = pose_person(person, signals, Counters(), None)
        root = posed.world_from_root(signals)
        full = posed.body.vertices.double().numpy() @ root[:3, :3].T + root[:3, 3]
        points = outline.points(signals)
        np.testing.assert_allclose(points.max(0), full.max(0), atol=0.03)
        np.testing.assert_allclose(points.min(0), full.min(0), atol=0.03)


def test_the_window_opens_on_the_whole_person():
    """Standing poses lie inside the first view from everywhere; Home finds the view of the others."""
    outline, size = Outline(load_person("default").body), (512, 512)
    assert {"stand", "arms_up"} <= set(POSES)
    standing, high = (outline.points(Signals.rest().replace(body_pose=named_pose(p))) for p in ("stand", "arms_up"))
    for azimuth in range(0, 360, 20):
        for elevation in (-10.0, 0.0, 20.0):
            view = OrbitView(float(azimuth), elevation)
            assert max(*np.abs(reach(view, standing, size)).ravel()) < 0.96
    assert max(*np.abs(reach(OrbitView(), high, size)).ravel()) > 1


def test_home_frames_the_person_as_it_stands(studio):
    from avatarrex_studio.session.commands import ApplyPose, SetCamera, SetTranslation

    studio.do(ApplyPose("arms_up"))
    studio.do(SetTranslation((3.0, 0.0, 8.0)))
    studio.do(SetCamera(azimuth=50.0, distance=0.5))
    studio.frame_person((400, 300))
    body = studio.avatars.get("default").person.body
    high, low = reach(studio.state.view, Outline(body).points(studio.state.signals), (400, 300))
    assert max(*high, *-low) == pytest.approx(1 - FREE_SHARE)
    assert studio.state.view.azimuth == 0
    studio.undo()
    assert studio.state.view.distance == 0.5


@pytest.mark.parametrize(
    ("camera", "follows"),
    [("", True), ("azimuth=20,elevation=5", True), ("azimuth=70,follow=0", False), ("x=1,y=0.5,z=0", False)],
)
def test_a_rendered_motion_keeps_the_person_in_every_frame(camera, follows, monkeypatch, tmp_path):
    """A walk of nine metres: the view that each picture was made with contains the body of its frame."""
    frames = tuple(
        Signals.rest().replace(
            body_pose=named_pose("arms_up" if k == 2 else "stand"), translation=np.array([k, 0, 2 * k])
        )
        for k in range(5)
    )
    write_json(tmp_path / "walk.json", SignalSequence(frames, 24.0, "walk"))
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", ball_engine)
    words = ["render", str(tmp_path / "out"), "--motion", str(tmp_path / "walk.json"), "--size", "64x48"]
    assert cli.main([*words, *(["--camera", camera] if camera else [])]) == 0
    outline, reached, distances = Outline(load_person("default").body), [], set()
    for path in sorted((tmp_path / "out").glob("*.png")):
        state = StudioState.from_json(json.loads(Image.open(path).text["avatarrex"]))
        reached.append(np.abs(reach(state.view, outline.points(state.signals), (64, 48))).max())
        distances.add(state.view.distance)
        assert state.view.follow == follows
    assert len(reached) == 5
    assert len(distances) == 1, "the scale stays"
    assert max(reached) == pytest.approx(1 - FREE_SHARE)


def test_what_the_user_gives_stays(monkeypatch, tmp_path):
    monkeypatch.setattr("avatarrex_studio.engine.engine.Engine", ball_engine)
    out = tmp_path / "out.png"
    words = ["render", str(out), "--size", "32", "--camera"]
    for given, wanted in (
        ("azimuth=30,elevation=10,distance=2.6,fov=40", {"azimuth": 30, "elevation": 10, "distance": 2.6, "fov": 40}),
        ("distance=0.75,y=0.72", {"distance": 0.75, "target": [0.0, 0.72, 0.0]}),
    ):
        assert cli.main([*words, given]) == 0
        view = json.loads(Image.open(out).text["avatarrex"])["view"]
        assert {name: view[name] for name in wanted} == wanted
