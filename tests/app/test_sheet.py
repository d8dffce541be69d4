"""`avatarrex-studio sheet`: what is on a sheet, that every subject of it is seen alike, and what is refused."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from avatarrex_studio.cli import main as cli
from avatarrex_studio.cli.sheet import read_order
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.sheets import draw
from avatarrex_studio.sheets import pages as sheet_pages
from avatarrex_studio.sheets import paper as sheet_paper
from avatarrex_studio.sheets.captured import captured_page, framed, photograph
from avatarrex_studio.sheets.order import COLUMNS
from avatarrex_studio.sheets.pages import Artist, body_page, drawn, face_page, hands_page, motion_page
from avatarrex_studio.sheets.paper import HEADING, LINE, Tile, laid_out, over, tile_width, write_jpeg
from bad_files import bvh, csv
from capture.tiny_capture import TinyCapture
from PIL import Image

from avatarrex.capture.fit.check import iou, silhouette, template_surface
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.gl.context import gl_unavailable
from avatarrex.metrics.drawing import by_level
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import load_person

needs_gl = pytest.mark.skipif(gl_unavailable() is not None, reason=str(gl_unavailable()))


def orders(page):
    """Every order of a page in reading order."""
    return [order for row in page.rows for group in row for order in group]


def loaded(path):
    """The pixels of a sheet."""
    with Image.open(path) as image:
        return np.asarray(image)


@pytest.fixture
def walk(tmp_path):
    """Twenty frames that go 3 m to the person's left, which is where the person faces, and blink as the packaged walk does."""
    turn, lids = np.array([0, np.pi / 2, 0]), named_expression("blink")
    frames = tuple(
        Signals.rest().replace(
            global_orient=turn,
            translation=np.array([0.15 * k, 0.1, 0]),
            body_pose=np.full((21, 3), 0.01 * k),
            expression=lids * (k == 4),
        )
        for k in range(20)
    )
    write_json(tmp_path / "walk.json", SignalSequence(frames, 30.0, "walk"))
    return tmp_path / "walk.json"


@pytest.mark.parametrize("artists", [1, 2])
def test_pages_show_what_they_promise(artists):
    person = load_person()
    body, face, hands = (make(person, artists) for make in (body_page, face_page, hands_page))
    assert [page.pictures for page in (body, face, hands)] == [10 * artists, 16 * artists, 12 * artists]
    labels = [scene.label for who, scene in orders(body) if who == 0]
    assert labels[:4] == ["front", "left side", "back", "right side"]
    assert len({scene.signals for _, scene in orders(body)}) == 7, "the standing pose and six others"
    faces = [scene for who, scene in orders(face) if who == 0]
    assert len({scene.signals for scene in faces}) == 8
    assert {scene.rig for scene in faces} == {"face"}
    assert np.array_equal(faces[2].signals.expression, named_expression("smile"))
    lopsided = [
        s.signals.expression for s in faces if not np.array_equal(s.signals.expression[0], s.signals.expression[7])
    ]
    assert len(lopsided) == 2, "one expression closes one eye, from two sides"
    shown = {scene.signals for _, scene in orders(hands)}
    assert len(shown) == 6
    assert any(np.array_equal(signals.left_hand_pose, named_hand("fist", "left")) for signals in shown)


@pytest.mark.parametrize("make", [body_page, face_page, hands_page])
def test_the_truth_is_beside_each_picture_in_the_same_view(make):
    for row in make(load_person(), 2).rows:
        for group in row:
            for (first, one), (second, two) in zip(group[::2], group[1::2]):
                assert (first, second) == (0, 1)
                assert one is two


@pytest.mark.parametrize("make", [body_page, face_page, hands_page])
@pytest.mark.parametrize("artists", [1, 2])
def test_a_page_fits_its_width(make, artists):
    """Left edge, tiles and gaps fill a row; nothing is cut off at the right."""
    page = make(load_person(), artists)
    blank = Artist("blank", lambda scene: np.zeros((scene.camera.height, scene.camera.width, 4)))
    rows = drawn(page, [blank] * artists)
    made = np.asarray(laid_out(page.heading, "", rows, page.width))
    assert made.shape[1] <= 2000
    assert made.shape[0] < 2200
    ground = (made == sheet_paper.GROUND).all(-1)
    assert not ground[:, : sheet_paper.EDGE].any()
    assert not ground[:, -sheet_paper.EDGE :].any()
    tiles = sum(t.picture.shape[0] * t.picture.shape[1] for row in rows for group in row for t in group)
    assert ground.sum() == tiles, "no tile covers another"


def test_the_figure_fills_its_tile():
    """Feet and crown of the standing person are in every side's tile, and reach over most of it."""
    person = load_person()
    for _, scene in orders(body_page(person, 2))[:8]:
        points = sheet_pages.Outline(person.body).points(scene.signals)
        camera = scene.camera
        pixel, _ = camera.pixels(points)
        assert pixel.min() > 0
        assert (pixel < [camera.width, camera.height]).all()
        assert np.ptp(pixel, axis=0)[1] > 0.8 * camera.height


def test_a_motion_is_followed_over_the_ground_from_where_it_faces(walk):
    person = load_person()
    page = motion_page(person, 2, Motion.read(walk), range(0, 20, 2))
    assert [len(row) for row in page.rows] == [8, 8, 2, 2], "bands of eight frames, a row to each artist"
    first, second = page.rows[0], page.rows[1]
    assert [group[0][0] for group in first + second] == [0] * 8 + [1] * 8
    assert all(a[0][1] is b[0][1] for a, b in zip(first, second)), "both in the same views"
    assert {group[0][1].rig for group in first} == {"body"}, "seen whole, though it blinks"
    cameras = [group[0][1].camera for group in first]
    steps = np.diff([camera.centre for camera in cameras], axis=0)
    assert steps == pytest.approx(np.tile([0.3, 0, 0], (7, 1)), abs=1e-9)
    assert cameras[0].centre[0] > 2, "the person faces +X here, and so does the camera stand there"


def test_a_face_recording_is_seen_close(tmp_path):
    (tmp_path / "talk.csv").write_text(csv().replace("52,0.0", "52,0.5"))
    page = motion_page(load_person(), 1, Motion.read(tmp_path / "talk.csv"), (0, 1, 2))
    ((who, scene),) = page.rows[0][0]
    assert (who, scene.rig) == (0, "face")
    assert np.linalg.norm(scene.camera.centre) < 2.5


def test_tiles_lie_in_rows_over_their_labels():
    red, blue = (np.full((20, 40, 3), colour, np.uint8) for colour in ((255, 0, 0), (0, 0, 255)))
    made = laid_out(
        "Heading",
        "a note that is wider than the sheet",
        [[[Tile(red, "a"), Tile(blue, "b", "who")]], [[Tile(blue, "c")]]],
        160,
    )
    pixels = np.asarray(made)
    assert pixels.shape == (HEADING + 2 * (20 + LINE) + sheet_paper.EDGE // 2, 160, 3)
    assert (pixels[HEADING : HEADING + 20, 24:64] == (255, 0, 0)).all()
    assert (pixels[HEADING : HEADING + 20, 68:108] == (0, 0, 255)).all()
    assert (pixels[HEADING + 20 + LINE : HEADING + 40 + LINE, 24:64] == (0, 0, 255)).all()
    assert pixels[:HEADING, -20:].min() > 240, "the note stays within the margins"
    assert pixels[48:66, 24:120].min() < 200, "a note"
    label = pixels[HEADING + 20 : HEADING + 20 + LINE, 24:64]
    assert label.min() < 100, "ink"
    assert (pixels[HEADING + 40 + LINE :, 70:] == sheet_paper.PAPER).all()
    assert tile_width(1, 2, 160) == (160 - 48 - 4) // 2


def test_premultiplied_pictures_lie_over_the_ground():
    image = np.array([[[0.25, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]]])
    assert over(image).tolist() == [[[180, 117, 118], list(sheet_paper.GROUND)]]


def test_a_sheet_too_heavy_is_made_smaller(tmp_path):
    noise = Image.fromarray(np.random.default_rng(0).integers(0, 255, (900, 1000, 3), dtype=np.uint8))
    write_jpeg(tmp_path / "noise.jpg", noise)
    assert (tmp_path / "noise.jpg").stat().st_size <= 700_000
    assert 500 < loaded(tmp_path / "noise.jpg").shape[1] < 1000
    assert [path.name for path in tmp_path.iterdir()] == ["noise.jpg"]


@pytest.fixture
def small(monkeypatch):
    """Sheets a fifth as wide, an albedo that is baked at once."""
    from avatarrex.capture.synthetic import subject_drawer

    monkeypatch.setattr(sheet_pages, "WIDTH", 420)
    monkeypatch.setattr(sheet_pages, "NARROW", 420)
    monkeypatch.setattr(subject_drawer, "ALBEDO_SPACING", {"body": 0.05, "hand": 0.05, "face": 0.05})


@needs_gl
def test_avatars_and_truth_follow_one_motion(small, walk, tmp_path, capsys):
    """Three rows that show the same figure: truth, the packaged avatar, and the packaged avatar again."""
    words = ["--truth", "subject", "--motion", str(walk), "--other", "default", "--frames", "0:20:10", "--samples", "1"]
    assert cli.main(["sheet", "default", str(tmp_path / "out"), "--only", "motion", *words]) == 0
    assert "motion.jpg" in capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["motion.jpg", "sheet.json"]
    report = json.loads((tmp_path / "out" / "sheet.json").read_text())
    assert report["motion"] == {"file": str(walk), "frames": [0, 10]}
    assert report["sheets"] == ["motion.jpg"]
    assert report["floaters"] is None
    made = loaded(tmp_path / "out" / "motion.jpg").astype(float)
    figure = np.abs(made - sheet_paper.GROUND).max(-1) > 40
    height = (len(made) - HEADING - sheet_paper.EDGE // 2) // 3
    across = tile_width(sheet_pages.FEWEST, 1, 420)
    left = sheet_paper.EDGE
    tops = [HEADING + k * height for k in range(3)]
    truth, avatar, again = (figure[top : top + height - LINE, left : left + across] for top in tops)
    left += across + sheet_paper.GROUPS
    later = figure[tops[1] : tops[1] + height - LINE, left : left + across]
    assert truth.any()
    assert overlap(truth, avatar) > 0.75, "the same pose in the same place, but for a white shirt's rim on light ground"
    assert overlap(truth, later) < 0.65, "another pose"
    assert (avatar ^ again).mean() < 0.006, "twice the same avatar, but for the blocks of JPEG"


def overlap(one, two):
    """Intersection over union of masks."""
    return (one & two).sum() / (one | two).sum()


@needs_gl
def test_levels_are_rows_of_one_sheet(monkeypatch, walk, tmp_path, capsys):
    """An avatar is drawn once for each level, by its settings."""
    seen = []
    monkeypatch.setattr(draw, "by_level", lambda *order: seen.append(order) or by_level(*order))
    words = ["--motion", str(walk), "--frames", "0:10:10", "--samples", "1", "--levels", "live,balanced"]
    assert cli.main(["sheet", "default", str(tmp_path / "out"), "--only", "motion", *words]) == 0
    ((name, _, levels, samples),) = seen
    assert (name, levels, samples) == ("default avatar", ("live", "balanced"), 1)
    assert json.loads((tmp_path / "out" / "sheet.json").read_text())["levels"] == ["live", "balanced"]
    made = loaded(tmp_path / "out" / "motion.jpg").astype(float)
    rows = (len(made) - HEADING - sheet_paper.EDGE // 2) // 2
    figures = (np.abs(made - sheet_paper.GROUND).max(-1) > 40)[HEADING:]
    live, balanced = (figures[k * rows : k * rows + rows - LINE] for k in (0, 1))
    assert overlap(live, balanced) > 0.9


@needs_gl
def test_floaters_are_told_and_written(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(draw, "FLOATING", ())
    monkeypatch.setattr(draw, "SILHOUETTE_PIXELS", 96)
    (tmp_path / "m.bvh").write_text(bvh())
    words = ["--only", "floaters", "--motion", str(tmp_path / "m.bvh"), "--frames", "1:2"]
    assert cli.main(["sheet", "default", str(tmp_path / "out"), *words]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^stand: .*silhouettes.*(volume in one piece|apart from the body)", out, re.M)
    entry, moved = json.loads((tmp_path / "out" / "sheet.json").read_text())["floaters"]
    assert [entry["pose"], moved["pose"]] == ["stand", "m.bvh frame 1"]
    assert set(entry) == {"pose", "views", "islands", "lumps"}
    assert entry["views"] == 26
    assert all(np.isfinite(lump["place"]).all() for lump in entry["lumps"])


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Of the default person, with a frame and a camera held out."""
    files = TinyCapture.make(scale=2).manifest(held_out_frames={"body": [1]}, held_out_cameras={"body": ["c2"]})
    return files.zip(tmp_path_factory.mktemp("sheet") / "tiny.zip")


@pytest.mark.parametrize("name", ["body", "face"])
def test_a_captures_pictures_are_seen_as_it_saw_them(capture, name):
    """Every camera of what is held out; the template in the cut camera covers what the picture does."""
    read = open_capture(capture)
    rig = read.rigs[name]
    page = captured_page(read, rig, 2)
    scenes = [scene for who, scene in orders(page) if who == 0]
    views = len(rig.views)
    assert len(scenes) == (views if rig.held_out_frames else views * rig.frames)
    assert [scene for who, scene in orders(page) if who == 1] == scenes
    assert all(("(held out)" in scene.label) == bool(rig.held_out_frames) for scene in scenes)
    faces = read.person.body.faces.numpy()
    for scene in scenes:
        shown = photograph().draw(scene)
        assert shown.shape == (scene.camera.height, scene.camera.width, 4)
        assert not shown[shown[..., 3] == 0].any()
        covered = silhouette(template_surface(read.person, scene.signals)[0], faces, scene.camera)
        beyond, covered = covered & ~scene.seen, covered & scene.seen
        assert beyond.any() == (name == "face"), "a square about the head and shoulders of an upright picture"
        white = Artist("white", lambda scene: np.ones((*scene.seen.shape, 4)))
        np.testing.assert_array_equal(framed(white).draw(scene)[..., 3], scene.seen)
        assert iou(covered, shown[..., 3] > 0.5) > 0.93
        assert covered.mean() > 0.08, "cut out about the person"


def test_the_capture_of_a_sheet_is_its_truth(monkeypatch, capture, tmp_path):
    """The avatar is drawn from the capture's cameras; where the capture has no such rig, the library's poses are shown alone."""
    drawn_pages = []
    monkeypatch.setattr(
        draw, "_draw", lambda order, name, page, artists, note="": drawn_pages.append((name, page, artists))
    )
    monkeypatch.setattr(draw, "mesh_artist", lambda *_: Artist("fitted mesh", lambda scene: scene.picture))
    words = ["--truth", str(capture), "--mesh", "--only", "body,hands"]
    assert cli.main(["sheet", "default", str(tmp_path / "out"), *words]) == 0
    (body, page, artists), (hands, plain, alone) = drawn_pages
    assert (body, hands) == ("body", "hands")
    assert [artist.name for artist in artists] == ["ground truth", "fitted mesh", "default avatar"]
    assert page.heading == "Body, as captured"
    assert [artist.name for artist in alone] == ["default avatar"]
    assert plain.heading == "Hands"
    assert json.loads((tmp_path / "out" / "sheet.json").read_text())["truth"] == str(capture)


def test_frames_unless_named():
    arguments = cli.parse(["sheet", "default", "/tmp/nowhere"])
    assert read_order(arguments).only == ("body", "face", "hands", "floaters"), "no motion sheet without a motion"
    arguments = cli.parse(["sheet", "default", "/tmp/nowhere", "--truth", __file__])
    assert read_order(arguments).only == ("body", "face", "hands", "close", "floaters"), "close-ups of a capture"


@pytest.mark.parametrize("count", [1, 3, 8, 13, 500])
def test_default_frames_are_spread(tmp_path, count):
    (tmp_path / "m.bvh").write_text(bvh(count))
    words = ["sheet", "default", str(tmp_path / "out"), "--motion", str(tmp_path / "m.bvh")]
    chosen = read_order(cli.parse(words)).frames
    assert len(chosen) == min(count, COLUMNS)
    steps = np.diff([*chosen, count])
    assert chosen[0] == 0
    assert 1 <= steps.min() >= steps.max() - 1, "as even as whole frames can be, to the end"


REFUSED = {
    "nobody {out}": "nobody: expected an avatar folder or an .avatar file, found nothing there",
    "default {file}": "flat: expected a folder to write to, found a file",
    "default {file}/deeper": "sheet.json: expected a folder at .*flat, found a file",
    "default /proc/sheets": "a folder at /proc that can be written",
    "default {out} --truth photograph": "--truth: expected subject, loose, or a capture, a folder or a .zip file, found photograph",
    "default {out} --mesh": "--mesh: expected --truth CAPTURE with it, found no truth",
    "default {out} --mesh --truth loose": "--mesh: expected --truth CAPTURE with it, found loose",
    "default {out} --only body,feet": "--only: expected some of body,face,hands,motion,close,floaters, found feet",
    "default {out} --only motion": "--only: motion: expected --motion FILE with it",
    "default {out} --other default": "--other: expected --motion FILE or --truth CAPTURE with it, and the sheet motion or close",
    "default {out} --only close": "--only: close: expected --truth CAPTURE with it, found no truth",
    "default {out} --only close --truth loose": "--only: close: expected --truth CAPTURE with it, found loose",
    "default {out} --frames 0:4": "--frames: expected --motion FILE with it, found no motion",
    "default {out} --motion {out}.bvh": "out.bvh: expected a motion file, found nothing there",
    "default {out} --motion {file}": "flat: expected a motion file: .bvh",
    "default {out} --motion {motion} --frames 0:40:0": "a step other than 0",
    "default {out} --motion {motion} --frames 0:40": "--frames: expected at most 24 frames on a sheet",
    "default {out} --motion {motion} --frames 50:60": "some of the 40 frames",
    "default {out} --motion {motion} --other nobody": "nobody: expected an avatar folder",
    "default {out} --samples 0": "--samples: expected 1 to 4, found 0",
    "default {out} --levels live,best": "--levels: expected some of live,.*, found best",
    "default {out} --samples many": "--samples: expected 1 to 4, found many",
    "default {out} --motion \0": "--motion: expected a value, found nothing",
    "default \0": "OUT_DIR: expected a value, found nothing",
    "default": "the following arguments are required: OUT_DIR",
}


@pytest.mark.parametrize("line", REFUSED)
def test_bad_input(line, monkeypatch, tmp_path, capsys):
    """One line, exit code 2, before an avatar is loaded; nothing written."""
    monkeypatch.setattr(draw, "run", lambda order: pytest.fail("this was to be refused before"))
    (tmp_path / "flat").write_text("kept")
    (tmp_path / "m.bvh").write_text(bvh(40))
    names = {"out": tmp_path / "out", "file": tmp_path / "flat", "motion": tmp_path / "m.bvh"}
    try:
        code = cli.main(["sheet", *("" if word == "\0" else word for word in line.format(**names).split(" "))])
    except SystemExit as exit:
        code = exit.code
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    said = captured.err.removesuffix("\n")
    assert said.isprintable()
    assert said.startswith("avatarrex-studio: error: ")
    assert re.search(REFUSED[line], said), said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flat", "m.bvh"]
    assert (tmp_path / "flat").read_text() == "kept"


def test_a_file_that_is_no_avatar(tmp_path, capsys):
    (tmp_path / "a.avatar").write_text("no zip")
    assert cli.main(["sheet", str(tmp_path / "a.avatar"), str(tmp_path / "out")]) == 2
    assert re.search(r"a\.avatar.*expected an avatar folder or a whole \.avatar file", capsys.readouterr().err)
    assert not (tmp_path / "out").exists()
