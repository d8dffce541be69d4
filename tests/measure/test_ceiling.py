"""`python -m avatarrex.measure ceiling`: a person in its own fixed colours is drawn almost without error, from its training alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from metrics.drawn_capture import HELD_OUT_FRAME, HELD_OUT_VIEW, write_capture
from PIL import Image

from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.measure.__main__ import main
from avatarrex.measure.studies.ceiling import SPACING, Photographed, Shown, TrueMeshes, ceilings, closed_pieces, painted
from avatarrex.metrics.evaluate import Choice, evaluate
from avatarrex.metrics.measures import Networks
from avatarrex.metrics.mesh import Surface
from avatarrex.signals.driving import Signals

SIZE = 192


@pytest.fixture(scope="module", autouse=True)
def texels_as_far_apart_as_pixels():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(SPACING, "body", 0.01)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("ceiling") / "capture", SIZE)


@pytest.fixture(scope="module")
def found(folder) -> dict[str, dict[str, float]]:
    """Means over the pictures of the held-out pose by training cameras, by subject."""
    capture = open_capture(folder)
    rig, chosen = capture.rigs["body"], Choice((HELD_OUT_FRAME,), (0, 2))
    measured = evaluate(capture, rig, ceilings(capture, "body"), Networks(None, None, {}), chosen)
    return measured.grouped("split")["held-out pose"]


def test_what_does_not_change_is_drawn_almost_without_error(found):
    assert found["true mesh"]["psnr_matte"] > 25
    assert found["true mesh"]["iou"] > 0.995
    assert found["true volume, 5 mm"]["psnr_matte"] > 23
    assert abs(found["true mesh, light"]["psnr_matte"] - found["true mesh"]["psnr_matte"]) < 2, "there is no light"


def test_a_finer_grid_is_nearer_and_own_colours_are_nearest(found):
    two, five, own = (found[name] for name in ("true volume, balanced", "true volume, 5 mm", "own colours"))
    assert two["iou"] < five["iou"] < 1
    assert two["psnr_matte"] < five["psnr_matte"] < own["psnr_matte"]


@pytest.mark.slow
def test_texels_are_the_trainings_alone(folder, found, tmp_path):
    """Pictures of the held-out frame and camera in red change what is compared with, and not what is drawn."""
    again = write_capture(tmp_path / "red", SIZE)
    for picture in (again / "body").glob("*/*.png"):
        if picture.parent.name == HELD_OUT_VIEW or int(picture.stem) == HELD_OUT_FRAME:
            Image.new("RGB", (SIZE, SIZE), (255, 0, 0)).save(picture)
    first, second = (ceilings(open_capture(path), "body") for path in (folder, again))
    for drawer, other in zip(first[:2], second[:2], strict=True):
        texels = [one.look.detail.texel for one in (drawer, other)]
        torch.testing.assert_close(*texels, rtol=0, atol=0)


def test_the_light_is_found_beside_the_colours():
    """A ball in a smooth pattern, turned before a light from one side: texels alone average it away."""
    ball = trimesh.creation.icosphere(4, 0.2)
    faces, camera = np.asarray(ball.faces), Camera.orbit(0, 0, 1.0, 40, (0, 0, 0), 64, 64)
    rest = np.asarray(ball.vertices)
    pictures = []
    rng = np.random.default_rng(0)
    for angle in np.linspace(0, 2 * np.pi, 7)[:-1]:
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        face = rng.integers(len(faces), size=20_000)
        weight = rng.dirichlet(np.ones(3), len(face))
        place = np.einsum("pk,pkc->pc", weight, rest[faces[face]])
        normal = place @ turn.T / np.linalg.norm(place, axis=1, keepdims=True)
        albedo = 0.5 + 0.2 * np.sin(20 * place)
        colour = torch.from_numpy(albedo * (1 + 0.4 * normal[:, :1])).float()
        shown = Shown(Signals.rest(), camera, face, weight, place @ turn.T, normal)
        pictures.append(Photographed(shown, colour, torch.ones(len(face))))
    flat, lit = (painted(Surface.of(rest, faces), 0.004, pictures, with_light) for with_light in (False, True))
    off = [float(np.abs((look(one.shown) - one.colour).numpy()).mean()) for look in (flat, lit) for one in pictures[:1]]
    assert off[0] > 0.08
    assert off[1] < 0.02
    assert lit.light.harmonics[0].tolist() == pytest.approx([0.4] * 3, abs=0.04)
    assert float(lit.light.harmonics[1:].detach().abs().max()) < 0.04


def test_pieces_that_are_open_have_no_inside():
    """A box each side of which has its own corners, as at seams of a texture, and an open bowl."""
    box = trimesh.creation.box((1, 1, 1))
    box = trimesh.Trimesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    bowl = trimesh.creation.icosphere(2, 0.3)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0)
    faces = np.concatenate([box.faces, bowl.faces + len(box.vertices)])
    closed = closed_pieces(np.concatenate([box.vertices, bowl.vertices]), faces)
    assert closed[:12].all()
    assert not closed[12:].any()


def test_a_capture_without_meshes_is_refused(folder, tmp_path, capsys):
    again = write_capture(tmp_path / "bare")
    (again / "body" / "ground_truth.npz").unlink()
    with pytest.raises(InputError, match=r"body rig: expected ground_truth\.npz, found nothing"):
        ceilings(open_capture(again), "body")
    assert main(["ceiling", str(folder), "--rig", "face"]) == 2
    assert "a face rig" in capsys.readouterr().err


def test_only_the_very_signals_of_a_frame_have_a_mesh(folder):
    capture = open_capture(folder)
    meshes = TrueMeshes(capture.ground_truth["body"], capture.rigs["body"], capture.person)
    own = capture.rigs["body"].signals[1]
    np.testing.assert_array_equal(meshes.surface(own).vertices, capture.ground_truth["body"].vertices[1])
