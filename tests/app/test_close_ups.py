"""Close-ups of a capture: a spot is the skin that is looked at, its picture shows it best, its box is about it, and all are drawn alike."""

from __future__ import annotations

import json

import numpy as np
import pytest
from avatarrex_studio.cli import main as cli
from avatarrex_studio.sheets import close_ups, draw
from avatarrex_studio.sheets.close_ups import LIPS, PLACES, Patch, Place, Spot, close_page
from avatarrex_studio.sheets.pages import Artist, drawn
from capture.tiny_capture import TinyCapture

from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.templates.person import load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

CHEST = Place(0.3, (Spot(("spine3",), shift=(0, 0.05, 0)),))


def standing(degrees, pose="stand", jaw=0.0):
    """Somebody turned to the left."""
    return Signals.rest().replace(
        translation=np.array([0.2, 1.0, -0.1]),
        global_orient=np.array([0, np.radians(degrees), 0]),
        body_pose=named_pose(pose),
        jaw_pose=np.array([jaw, 0, 0]),
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Cameras at 10, 130 and 250 degrees. Held out: arms crossed before the first one, and turned by 20 more with an open mouth."""
    files = TinyCapture([standing(10), standing(10, "crossed_arms"), standing(30, jaw=0.3)])
    files.add("body", load_person(), True, 3)
    files.manifest(held_out_frames={"body": [1, 2]})
    return files.zip(tmp_path_factory.mktemp("close") / "tiny.zip")


@pytest.fixture(scope="module")
def capture(path):
    return open_capture(path)


@pytest.fixture(scope="module")
def found(capture):
    """By place, with one that crossed arms hide."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(close_ups, "PLACES", PLACES | {"chest": CHEST})
        return {one.place: one for one in close_ups.close_ups(capture, capture.person)}


def test_spots_are_where_their_names_say():
    person = load_person()
    rest, joints = (values.double().numpy() for values in (person.body.v_template, person.body.joint_template))
    at = {name: Patch.of(person, place.spots[0], 0.0).point(rest) for name, place in PLACES.items()}
    joint = dict(zip(JOINT_NAMES, joints))
    assert np.linalg.norm(at["left eye"] - joint["left_eye"]) < 0.02
    assert at["left eye"][2] > joint["left_eye"][2], "its front"
    teeth = rest[person.body.groups["upper_teeth"]]
    assert np.linalg.norm(at["mouth"] - teeth[teeth[:, 2].argmax()]) < 0.025
    assert at["back of the head"][2] < joint["head"][2] - 0.08
    assert at["ear"][0] > 0.06
    assert at["back of the hand"][1] > joint["left_middle1"][1] > at["palm"][1]
    assert at["inner elbow"][2] > joint["left_elbow"][2]
    assert at["back of the knee"][2] < joint["left_knee"][2] - 0.03
    assert at["sole"][1] < joint["left_foot"][1] < at["foot"][1] + 0.05
    assert at["armpit"][1] < joint["left_shoulder"][1] - 0.04
    right = Patch.of(person, PLACES["palm"].spots[1], 0.0).point(rest)
    np.testing.assert_allclose(right, at["palm"] * [-1, 1, 1], atol=0.002)
    assert Patch.of(person, Spot(("head",), shift=(0, 2, 0)), 0.0) is None, "no skin there"


def test_a_spot_faces_away_from_the_person():
    """What lies on the other side of a hand does not count."""
    person = load_person()
    rest = person.body.v_template.double().numpy()
    for name, outward in (("palm", [0, -1, 0]), ("back of the hand", [0, 1, 0]), ("back of the head", [0, 0, -1])):
        place = PLACES[name]
        assert Patch.of(person, place.spots[0], place.side).normal(rest) @ outward > 0.85


@pytest.mark.parametrize(
    ("place", "view", "frame"),
    [
        ("crotch", 0, 1),  # straight from the front, as in frame 0, which is not held out
        ("left eye", 0, 1),
        ("back of the head", 2, 2),  # at 250 degrees, 40 from behind
        ("chest", 0, 2),  # the arms are before it in frame 1
        ("mouth", 0, 2),  # open
    ],
)
def test_the_picture_shows_the_place_from_the_front(found, place, view, frame):
    assert (found[place].view, found[place].frame) == (view, frame)


def test_what_no_picture_shows_is_left_out(found):
    assert "sole" not in found
    assert list(found) == [name for name in [*PLACES, "chest"] if name in found], "in their order"


def test_boxes_are_about_their_places(capture, found):
    """In the photograph's own pixels, as wide as the place says at its distance."""
    rows = close_page(capture, list(found.values()), 1).rows
    scenes = {scene.label: scene for row in rows for ((_, scene),) in row}
    assert list(scenes) == list(found)
    for name, scene in scenes.items():
        place, one = (PLACES | {"chest": CHEST})[name], found[name]
        camera = capture.rigs["body"].views[one.view].camera
        vertices = template_surface(capture.person, scene.signals)[0]
        points = [Patch.of(capture.person, spot, 0.0).point(vertices) for spot in place.spots]
        middle = min((scene.camera.pixels(point)[0] - scene.camera.width / 2 for point in points), key=np.linalg.norm)
        assert np.abs(middle).max() < 1, name
        assert np.allclose(scene.camera.intrinsics[0, 0], camera.intrinsics[0, 0]), "its own pixels"
        depth = min(camera.pixels(point)[1] for point in points), max(camera.pixels(point)[1] for point in points)
        widths = [place.side * camera.intrinsics[0, 0] / z for z in depth]
        assert min(widths) - 1.1 < scene.camera.width < max(widths) + 1.1


def test_truth_mesh_other_avatar(monkeypatch, path, tmp_path):
    """Columns in their order, all of one scene; pictures enlarged alike; one mesh for all pages; the report says which pictures they are."""
    seen, painted = [], []
    monkeypatch.setattr(draw, "_draw", lambda order, name, page, artists, note="": seen.append((name, page, artists)))
    mesh = Artist("fitted mesh", lambda scene: scene.picture)
    monkeypatch.setattr(draw, "mesh_artist", lambda capture, rig, person: painted.append(rig.name) or mesh)
    words = ["--truth", str(path), "--mesh", "--other", "default", "--only", "body,close"]
    assert cli.main(["sheet", "default", str(tmp_path / "out"), *words]) == 0
    (_, _, on_body), (name, page, artists) = seen
    assert painted == ["body"]
    assert [artist.name for artist in on_body] == ["ground truth", "fitted mesh", "default avatar"]
    assert name == "close"
    assert [artist.name for artist in artists] == [
        "ground truth",
        "fitted mesh",
        "default avatar (2)",
        "default avatar",
    ]
    groups = [group for row in page.rows for group in row]
    assert all([who for who, _ in group] == [0, 1, 2, 3] for group in groups)
    assert all(scene is group[0][1] for group in groups for _, scene in group)
    tiles = [tile for row in drawn(page, [artists[0]] * 4) for group in row for tile in group]
    assert {tile.picture.shape for tile in tiles} == {(page.tile, page.tile, 3)}
    report = json.loads((tmp_path / "out" / "sheet.json").read_text())
    assert report["sheets"] == ["body.jpg", "close.jpg"]
    shown = {one["place"]: one for one in report["close"]}
    assert list(shown) == [scene.label for ((_, scene), *_) in groups]
    angle = shown["back of the knee"].pop("degrees")
    assert 30 < angle < 60
    camera = capture_camera(path, 2)
    assert shown["back of the knee"] == {
        "place": "back of the knee", "rig": "body", "camera": camera, "frame": 2, "split": "held-out pose",
    }  # fmt: skip


def capture_camera(path, view):
    """Its name."""
    return open_capture(path).rigs["body"].views[view].name


def test_a_capture_that_shows_no_place(capture, monkeypatch):
    monkeypatch.setattr(close_ups, "PLACES", {"sole": PLACES["sole"]})
    with pytest.raises(InputError, match="a picture that shows one of sole"):
        close_ups.close_ups(capture, capture.person)


def test_pages_beside_it_are_drawn_where_no_place_is_shown(monkeypatch, path, tmp_path):
    monkeypatch.setattr(close_ups, "PLACES", {"sole": PLACES["sole"]})
    monkeypatch.setattr(draw, "_draw", lambda *_: None)
    assert cli.main(["sheet", "default", str(tmp_path), "--truth", str(path), "--only", "body,close"]) == 0
    report = json.loads((tmp_path / "sheet.json").read_text())
    assert (report["sheets"], report["close"]) == (["body.jpg"], [])


def test_lips_are_found_on_persons_of_any_size():
    """A tall one's are farther below the eyes."""
    shape = np.eye(10)[0] * 2.5
    tall = resize_person(load_person(), PersonFit(shape, np.zeros((55, 3))))
    for person in (load_person(), tall):
        upper, lower = (Patch.of(person, spot, 0.0) for spot in LIPS)
        vertices = person.body.v_template.double().numpy()
        opened = vertices + person.body.expression_dirs[..., EXPRESSION_NAMES.index("jawOpen")].double().numpy()
        apart = [np.linalg.norm(upper.point(v) - lower.point(v)) for v in (vertices, opened)]
        assert apart[1] > apart[0] + 0.02
