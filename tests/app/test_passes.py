"""What `render` writes beside a picture, with the packaged avatar: passes against the camera in closed form, statistics."""

from __future__ import annotations

import json

import numpy as np
import pytest
from avatarrex_studio.cli import main as cli
from avatarrex_studio.session.state import StudioState
from PIL import Image

STAGES = {"templates", "volume", "pointmap", "shading", "total"}
COUNTERS = {
    "templates_posed", "voxels_evaluated", "local_mlp_evaluations", "hand_distances", "face_evaluations", "patches_decoded",
    "unet_runs", "rays", "ray_steps", "pixels_shaded", "body_pixels", "hand_pixels", "face_pixels", "bytes_uploaded",
    "bytes_read_back",
}  # fmt: skip
"""The names that docs/architecture.md gives."""


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """A person who stands a step away and is turned by 40 degrees, in a picture that is not square."""
    folder = tmp_path_factory.mktemp("passes")
    words = [
        "render", str(folder / "a.png"), "--size", "64x80", "--pose", "stand", "--alpha", "--aov", "depth,normal,position,mask",
        "--set", "root.translation=1,0,2", "--set", "root.orientation=0,40,0deg", "--camera", "azimuth=30,elevation=10",
        "--stats", str(folder / "a.json"),
    ]  # fmt: skip
    assert cli.main(words) == 0
    with Image.open(folder / "a.png") as image:
        image.load()
    with np.load(folder / "a.npz") as arrays:
        return image, dict(arrays), json.loads((folder / "a.json").read_text())


def test_types_and_misses(rendered):
    _, passes, _ = rendered
    hit = passes["hit"]
    assert {name: (array.dtype.name, array.shape) for name, array in passes.items()} == {
        "hit": ("bool", (80, 64)),
        "depth": ("float32", (80, 64)), "mask": ("float32", (80, 64)),
        "normal": ("float32", (80, 64, 3)), "position": ("float32", (80, 64, 3)),
    }  # fmt: skip
    assert 0.05 < hit.mean() < 0.5
    for name in ("depth", "normal", "position"):
        assert np.isfinite(passes[name]).all()
        assert not passes[name][~hit].any(), name


def test_positions_are_world_metres_on_their_rays(rendered):
    """Each position projects to the centre of its pixel, at its depth, through the camera that the PNG names."""
    image, passes, _ = rendered
    hit, position = passes["hit"], passes["position"].astype(float)
    view = StudioState.from_json(json.loads(image.text["avatarrex"])).view
    camera = view.camera(64, 80)
    pixels, depth = camera.pixels(position[hit])
    assert np.allclose(depth, passes["depth"][hit], atol=1e-5)
    rows, columns = np.nonzero(hit)
    # one pixel is 5 cm here: 1e-3 of it is 50 micrometres, float32 at 3 metres
    assert np.abs(pixels - np.stack([columns + 0.5, rows + 0.5], -1)).max() < 2e-3
    assert np.allclose(np.median(position[hit], 0)[[0, 2]], [1, 2], atol=0.15), "where the root was put"


def test_normals_face_the_camera(rendered):
    """Unit length, world space: against the ray, and as the surface through neighbouring positions has it."""
    image, passes, _ = rendered
    hit, position, normal = passes["hit"], passes["position"].astype(float), passes["normal"].astype(float)
    assert np.allclose(np.linalg.norm(normal[hit], axis=-1), 1, atol=1e-5)
    camera = StudioState.from_json(json.loads(image.text["avatarrex"])).view.camera(64, 80)
    toward = camera.centre - position[hit]
    assert ((toward * normal[hit]).sum(-1) > -0.05).mean() > 0.99
    inner = hit[1:-1, 1:-1] & hit[:-2, 1:-1] & hit[2:, 1:-1] & hit[1:-1, :-2] & hit[1:-1, 2:]
    right, up = position[1:-1, 2:] - position[1:-1, :-2], position[:-2, 1:-1] - position[2:, 1:-1]
    flat = np.cross(right, up)[inner]
    flat /= np.linalg.norm(flat, axis=-1, keepdims=True)
    assert np.median((flat * normal[1:-1, 1:-1][inner]).sum(-1)) > 0.95


def test_the_mask_is_the_alpha(rendered):
    image, passes, _ = rendered
    assert image.mode == "RGBA"
    alpha = np.asarray(image)[..., 3] / 255
    assert np.abs(alpha - passes["mask"]).max() < 0.51 / 255
    assert passes["mask"].min() == 0
    assert passes["mask"].max() == 1
    assert ((passes["mask"] > 0) & (passes["mask"] < 1)).any(), "silhouettes are antialiased"


def test_statistics_name_every_stage_and_counter(rendered):
    _, _, (entry,) = rendered
    assert set(entry) == {"frame", "ms", "counters"}
    assert entry["frame"] == 0
    assert set(entry["ms"]) == STAGES
    assert set(entry["counters"]) >= COUNTERS
    assert all(isinstance(count, int) and count >= 0 for count in entry["counters"].values())
    assert entry["ms"]["total"] == pytest.approx(sum(entry["ms"][stage] for stage in STAGES - {"total"}))
    parts = [entry["counters"][f"{part}_pixels"] for part in ("body", "hand", "face")]
    assert entry["counters"]["pixels_shaded"] >= max(parts) > 0
