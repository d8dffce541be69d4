"""An evaluation of the very mesh that drew a capture: it finds no error, and puts every picture where it belongs."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from drawn_capture import CAMERAS, FRAMES, HELD_OUT_FRAME, HELD_OUT_VIEW, camera, painted, write_capture

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.files.assets import SPECS
from avatarrex.metrics.baselines import PosedMesh, mean_colour_mesh, textured_mesh
from avatarrex.metrics.drawing import AvatarDrawer, Drawing, fitted, over_black
from avatarrex.metrics.evaluate import (
    OBSERVATIONS,
    SPLITS,
    TEST,
    Choice,
    _thinned,
    captured,
    default_frames,
    evaluate,
    observations,
    split_of,
)
from avatarrex.metrics.measures import KEYS, Measured, Networks, means, measure
from avatarrex.metrics.report import contact_sheet, table, to_json
from avatarrex.signals.driving import Signals
from avatarrex.training.core.projection import PICTURES

SCHEMA = json.loads((SPECS / "metrics.json").read_text(encoding="utf-8"))
KINDS = {"object": dict, "array": list, "string": str, "number": (int, float), "null": type(None)}
NONE = Networks(None, None, {"lpips": "vgg16-397923af.pth", "fid": "pt_inception.pth"})


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return open_capture(write_capture(tmp_path_factory.mktemp("drawn")))


@pytest.fixture(scope="module")
def evaluation(capture):
    """The painted mesh, and the baselines gathered from the training pictures."""
    rig = capture.rigs["body"]
    seen = list(observations(rig))
    meshes = (textured_mesh(capture.person, seen), mean_colour_mesh(capture.person, seen))
    subjects = [painted(PosedMesh(capture.person)), *meshes]
    return evaluate(capture, rig, subjects, NONE, Choice(range(FRAMES), sheet=3))


def faults(value, rule, place="file"):
    """The part of JSON Schema that metrics.json uses; an unknown keyword is a fault of the schema."""
    if "$ref" in rule:
        return faults(value, SCHEMA["$defs"][rule["$ref"].rsplit("/", 1)[1]], place)
    known = {
        "$schema", "$defs", "title", "description", "type", "const", "required", "additionalProperties", "properties",
        "items",
    }  # fmt: skip
    found = [f"{place}: unknown keyword {key}" for key in rule.keys() - known]
    if "const" in rule:
        return found + ([] if value == rule["const"] else [f"{place}: not {rule['const']}"])
    kinds = rule["type"] if isinstance(rule["type"], list) else [rule["type"]]
    if not any(isinstance(value, KINDS[kind]) for kind in kinds) or isinstance(value, bool):
        return [*found, f"{place}: not {kinds}"]
    if isinstance(value, dict):
        found += [f"{place}: no {key}" for key in rule.get("required", ()) if key not in value]
        others = rule.get("additionalProperties", True)
        for key, item in value.items():
            own = rule.get("properties", {}).get(key, others)
            found += [f"{place}: unknown {key}"] if own is False else faults(item, own, f"{place}.{key}")
    if isinstance(value, list):
        for k, item in enumerate(value):
            found += faults(item, rule["items"], f"{place}[{k}]")
    return found


def test_who_drew_the_capture_is_without_error(evaluation):
    assert evaluation.subjects == ("painted", "naked textured mesh", "mean-colour mesh")
    own = [picture for picture in evaluation.pictures if picture.subject == "painted"]
    assert len(own) == FRAMES * len(CAMERAS)
    for picture in own:
        assert picture.values["psnr"] > 50  # bytes: 1/255 at most
        assert picture.values["ssim_matte"] > 0.995
        assert picture.values["iou"] == 1
        assert picture.values["sharpness"] == pytest.approx(1, abs=0.02)
        assert math.isnan(picture.values["lpips"])


def test_its_surface_is_the_true_one(evaluation):
    found = evaluation.surface_means()
    assert set(found) == {"train", "held-out pose"}
    for subjects in found.values():
        to, back = subjects["painted"]["to_truth"], subjects["painted"]["from_truth"]
        assert to["mean_mm"] < 0.01
        assert to["angle_deg"] < 0.1
        assert back["mean_mm"] < 4  # pixels of 23 mm
        assert back["angle_deg"] < 25


def test_every_picture_is_in_its_split(evaluation, capture):
    rig = capture.rigs["body"]
    for picture in evaluation.pictures:
        expected = ("train", *TEST)[(picture.frame == HELD_OUT_FRAME) + 2 * (picture.view == HELD_OUT_VIEW)]
        assert picture.split == expected
    found = evaluation.grouped("split")
    assert {split: subjects["painted"]["pictures"] for split, subjects in found.items()} == {
        "train": 4, "test": 5, "held-out pose": 2, "held-out view": 2, "held-out both": 1,
    }  # fmt: skip
    assert set(evaluation.grouped("view")) == set(CAMERAS)
    assert split_of(rig, 0, 0) == "train"


def test_validation_is_neither_trained_on_nor_the_test(capture):
    """A frame that the training kept for its own figures; what a held-out camera saw of it is the test's."""
    rig = replace(capture.rigs["body"], validation_frames=frozenset({0}))
    assert default_frames(rig) == tuple(range(FRAMES))
    found = evaluate(capture, rig, [painted(PosedMesh(capture.person))], NONE, Choice(size=32))
    pictures = {split: subjects["painted"]["pictures"] for split, subjects in found.grouped("split").items()}
    assert pictures == {
        "train": 2,
        "validation": 2,
        "test": 5,
        "held-out pose": 2,
        "held-out view": 2,
        "held-out both": 1,
    }
    assert list(pictures) == list(SPLITS)
    assert split_of(rig, 0, 0) == "validation"
    assert set(found.surface_means()) == {"train", "validation", "held-out pose"}
    assert {(one.signals, one.camera.key()) for one in observations(rig)} == {
        (rig.signals[1], view.camera.key()) for view in rig.views if view.name != HELD_OUT_VIEW
    }
    assert faults(json.loads(json.dumps(to_json(found, "default", "x.zip", 1.5))), SCHEMA) == []


def test_baselines_stand_in_order(evaluation):
    values = evaluation.grouped("split")["train"]
    assert values["painted"]["psnr_matte"] > values["naked textured mesh"]["psnr_matte"] + 3
    assert values["naked textured mesh"]["psnr_matte"] > values["mean-colour mesh"]["psnr_matte"] + 3


def test_baselines_do_not_see_what_is_held_out(capture):
    rig = capture.rigs["body"]
    seen = list(observations(rig))
    assert len(seen) == 4
    assert len({(one.signals, one.camera.key()) for one in seen}) == 4
    held_out = {rig.signals[HELD_OUT_FRAME]}
    back = next(view for view in rig.views if view.name == HELD_OUT_VIEW)
    assert not any(one.signals in held_out or one.camera.key() == back.camera.key() for one in seen)


def test_baselines_see_at_most_as_many_pictures_as_static_detail_is_registered_to():
    assert max(PICTURES.values()) == OBSERVATIONS


def test_means_are_of_what_was_measured(evaluation):
    rows = [p for p in evaluation.pictures if p.subject == "naked textured mesh" and p.split == "train"]
    for key in ("psnr", "ssim_matte", "iou", "sharpness"):
        expected = np.mean([picture.values[key] for picture in rows])
        assert evaluation.grouped("split")["train"]["naked textured mesh"][key] == pytest.approx(expected)


def test_json_meets_its_schema(evaluation):
    data = json.loads(json.dumps(to_json(evaluation, "default", "x.zip", 1.5), allow_nan=False))
    assert faults(data, SCHEMA) == []
    assert data["splits"]["train"]["painted"]["lpips"] is None
    assert data["held_out"] == {"frames": [HELD_OUT_FRAME], "views": [HELD_OUT_VIEW]}
    data["surprise"] = 1
    del data["pictures"][0]["iou"]
    data["splits"]["train"]["painted"]["psnr"] = "high"
    assert len(faults(data, SCHEMA)) == 3


def test_the_table_says_what_is_missing_and_why(evaluation):
    text = table(evaluation)
    assert "LPIPS: n/a (no weights: vgg16-397923af.pth)" in text
    assert "FID: n/a (no weights: pt_inception.pth)" in text
    for word in (
        "train",
        "test",
        *TEST,
        "painted",
        "naked textured mesh",
        "mean-colour mesh",
        "PSNR",
        "to truth mean mm",
    ):
        assert word in text
    heads = next(line for line in text.splitlines() if line.startswith("split"))
    row = next(line for line in text.splitlines() if line.startswith("train"))
    assert (
        row[: heads.index("PSNR") + 4].split()[-1] == f"{evaluation.grouped('split')['train']['painted']['psnr']:.2f}"
    )


def test_the_contact_sheet_shows_the_pictures(evaluation):
    assert len(evaluation.samples) == 3
    assert all(frame == HELD_OUT_FRAME for _, frame in evaluation.samples)
    sheet = contact_sheet(evaluation)
    assert (sheet[..., 3] == 255).all()
    assert len(np.unique(sheet[..., :3].astype(int) @ [65536, 256, 1])) > 200


def test_truth_is_premultiplied_and_averaged():
    image = np.full((4, 6, 3), 200, np.uint8)
    matte = np.zeros((4, 6), np.uint8)
    matte[:, :3] = 255
    truth = over_black(image, matte, 3, 2)
    np.testing.assert_allclose(truth.matte.numpy(), [[1, 0.5, 0]] * 2, atol=1e-6)
    np.testing.assert_allclose(truth.image.numpy()[0, :, 0], np.array([1, 0.5, 0]) * 200 / 255, atol=1e-6)


def test_supersamples_are_averaged():
    """On a stand-in for the pipeline: columns of coverage 1, 0, 1, 0 … become a half."""
    drawn = []

    def stripes(avatar, signals, view, settings, previous):
        drawn.append((view.width, view.height, previous))
        even = (torch.arange(view.width) % 2 == 0).float().expand(view.height, -1)
        position = torch.zeros(view.height, view.width, 3)
        points = SimpleNamespace(hit=even > 0, position=position, normal=position)
        image = even[..., None].expand(-1, -1, 4)
        return SimpleNamespace(image=image, pointmap=points, world_from_root=np.eye(4))

    whole, fine = (AvatarDrawer(object.__new__(Avatar), samples, render=stripes) for samples in (1, 2))
    small = camera(0.0, 16)
    assert set(whole.draw(Signals.rest(), small).image.unique().tolist()) == {0.0, 1.0}
    assert fine.draw(Signals.rest(), small).image.unique().tolist() == [0.5]
    assert drawn == [(16, 16, None), (32, 32, None)]


def test_a_smaller_evaluation_looks_the_same_way(capture):
    view = fitted(capture.rigs["body"].views[0].camera, 48)
    assert (view.width, view.height) == (48, 48)
    mesh = painted(PosedMesh(capture.person))
    truth = captured(capture.rigs["body"], 0, 0, view)
    values, _ = measure(mesh.draw(capture.rigs["body"].signals[0], view), truth, NONE)
    intrinsics = view.intrinsics.copy()
    intrinsics[0, 2] += 0.5
    moved = Camera(intrinsics, view.camera_from_world, 48, 48)
    off, _ = measure(mesh.draw(capture.rigs["body"].signals[0], moved), truth, NONE)
    assert values["psnr_matte"] > max(off["psnr_matte"] + 5, 25)
    assert values["iou"] > max(off["iou"] + 0.02, 0.9)
    assert fitted(view, 100) is view


def test_a_thinned_drawing_keeps_its_pixels_under_its_camera(capture, monkeypatch):
    monkeypatch.setattr("avatarrex.metrics.evaluate.SURFACE_PIXELS", 1000)
    view = camera(10.0)
    depth = np.full((96, 96), 2.0)
    x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(96) + 0.5)
    local = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(view.intrinsics).T * depth[..., None]
    position = (local - view.camera_from_world[:3, 3]) @ view.camera_from_world[:3, :3]
    drawing = Drawing(torch.zeros(96, 96, 4), position.astype(np.float32), np.zeros((96, 96, 3), np.float32), depth > 0)
    thin, through = _thinned(drawing, view)
    assert isinstance(through, Camera)
    assert thin.hit.shape == (24, 24)
    pixel, _ = through.pixels(thin.position)
    rows, columns = np.indices((24, 24))
    np.testing.assert_allclose(pixel, np.stack([columns, rows], -1) + 0.5, atol=1e-3)


def test_an_empty_picture_has_no_values_inside_the_matte():
    empty = Drawing(torch.zeros(32, 32, 4), *np.zeros((2, 32, 32, 3), np.float32), np.zeros((32, 32), bool))
    black = over_black(np.zeros((32, 32, 3), np.uint8), np.zeros((32, 32), np.uint8), 32, 32)
    values, features = measure(empty, black, NONE)
    assert features is None
    assert values["psnr"] == math.inf
    assert values["ssim"] == 1
    for key in ("psnr_matte", "ssim_matte", "ms_ssim_matte", "iou", "sharpness"):
        assert math.isnan(values[key])
    found = means([Measured("a", "v", 0, "train", values, None)])
    assert found["psnr"] is None
    assert found["ssim"] == 1
    assert set(found) == {"pictures", *KEYS, "fid", "fid_matte"}


def test_fid_is_over_the_pictures_of_a_group():
    rng = np.random.default_rng(0)
    nan = dict.fromkeys(KEYS, math.nan)
    features = rng.normal(size=(6, 4, 8))
    features[:, 0] = features[:, 1] + 2.0
    features[:, 2] = features[:, 3]
    found = means(Measured("a", "v", k, "train", nan, features[k]) for k in range(6))
    assert found["fid"] == pytest.approx(8 * 4)
    assert found["fid_matte"] == pytest.approx(0, abs=1e-6)


def test_what_the_rig_does_not_have_is_refused(capture):
    rig = capture.rigs["body"]
    mesh = painted(PosedMesh(capture.person))
    with pytest.raises(InputError, match="frame: expected 0 to 2"):
        evaluate(capture, rig, [mesh], NONE, Choice(frames=[7]))
    with pytest.raises(InputError, match="at least one"):
        evaluate(capture, rig, [mesh], NONE, Choice(views=[]))
