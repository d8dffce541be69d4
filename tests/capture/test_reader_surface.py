"""The template's skin moves onto the mattes; its joints stay, and what is held out is not looked at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from capture.tiny_capture import TinyCapture
from scipy.spatial import cKDTree

from avatarrex.capture.fit import surface_fit
from avatarrex.capture.fit.check import iou, silhouette, template_surface
from avatarrex.capture.fit.surface_fit import fit_surface, turned_over
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.model import EYES, MOUTH
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit, SurfaceOffsets


@pytest.fixture(scope="module")
def stout() -> Person:
    """The default person with 3 cm more on the trunk, and less elsewhere."""
    body = load_person().body
    rest = body.v_template.double().numpy()
    nodes = np.arange(0, len(rest), 40)
    out = vertex_normals(body.v_template, body.faces).double().numpy()[nodes]
    amount = 0.03 * np.exp(-((rest[nodes, 1] - 0.2) ** 2) / 0.15) * (np.abs(rest[nodes, 0]) < 0.3)
    return resize_person(
        load_person(),
        PersonFit(np.zeros(10), np.zeros((55, 3)), SurfaceOffsets(tuple(nodes.tolist()), out * amount[:, None])),
    )


def away(person: Person, other: Person) -> float:
    """Mean metres of the other's skin, where it has moved, from the person's."""
    skin, ours = other.body.v_template.numpy(), load_person().body.v_template.numpy()
    moved = np.linalg.norm(skin - ours, axis=1) > 0.01
    return float(cKDTree(person.body.v_template.numpy()).query(skin[moved])[0].mean())


@pytest.mark.slow
def test_the_skin_moves_onto_the_mattes(stout: Person, tmp_path: Path) -> None:
    files = TinyCapture.make(("body",), person=stout, scale=4)
    files.manifest(held_out_frames={"body": [2]}, held_out_cameras={"body": ["c2"]})
    for name in ("body/c0/00000002.jpg", "body/c0/mask/pha/00000002.jpg", "body/c2/mask/pha/00000001.jpg"):
        files.files[name] = files.files[name][:-400]  # whoever decodes it fails
    capture = open_capture(files.zip(tmp_path / "a.zip"))
    person = fit_surface(capture, count=2)
    assert person.fit is not None
    assert person.fit.surface is not None
    before, after = away(capture.person, stout), away(person, stout)
    assert before > 0.01
    assert person.fit.surface.eyes_stay
    assert after < 0.5 * before  # two cameras a third of a turn apart do not see all of it
    torch.testing.assert_close(person.body.joint_template, capture.person.body.joint_template, atol=1e-6, rtol=0)
    rig, faces = capture.rigs["body"], person.body.faces.numpy()
    camera, inside = rig.views[2].camera, rig.matte(2, 0) > 128  # neither fitted to
    found = [
        iou(silhouette(template_surface(p, rig.signals[0])[0], faces, camera), inside) for p in (capture.person, person)
    ]
    assert found[1] > found[0] + 0.02
    with pytest.raises(InputError):
        rig.matte(0, 2)


@pytest.mark.slow
def test_a_template_that_fits_stays(tmp_path: Path) -> None:
    capture = open_capture(TinyCapture.make(("body",), scale=4).zip(tmp_path / "a.zip"))
    person = fit_surface(capture, count=1)
    moved = (person.body.v_template - load_person().body.v_template).norm(dim=-1)
    assert moved.mean() < 0.002  # a pixel is 12 mm here


def test_surface_offsets_are_part_of_the_fit(stout: Person) -> None:
    assert stout.fit is not None
    again = resize_person(load_person(), PersonFit.from_json(stout.fit.to_json(), "avatar.json"))
    assert again.hash == stout.hash != load_person().hash
    assert torch.equal(again.body.v_template, stout.body.v_template)
    broken = stout.fit.to_json()
    broken["surface"]["vertices"][0] = 10**6
    with pytest.raises(InputError, match=r"surface\.vertices"):
        resize_person(load_person(), PersonFit.from_json(broken, "avatar.json"))
    broken["surface"] = {"vertices": [1, 2]}
    with pytest.raises(InputError, match=r"avatar\.json: person_fit"):
        PersonFit.from_json(broken, "avatar.json")


def test_a_triangle_that_faces_the_other_way_is_found() -> None:
    body = load_person().body
    assert not turned_over(body, body).any()
    skin = int(np.flatnonzero(~body.of_groups((*EYES, *MOUTH)).numpy()[body.faces.numpy()].any(1))[100])
    eye = int(np.flatnonzero(body.of_groups(EYES).numpy()[body.faces.numpy()].all(1))[5])
    moved = body.v_template.clone()
    for face in (skin, eye):
        a, b, c = (int(vertex) for vertex in body.faces[face])
        moved[a] = body.v_template[b] + body.v_template[c] - body.v_template[a]  # mirrored across its edge
    found = turned_over(replace(body, v_template=moved), body)
    assert found[skin]
    assert not found[eye]


@pytest.mark.slow
@pytest.mark.parametrize("turns", [0, 1, 9])
def test_a_skin_that_turns_over_is_fitted_more_stiffly(
    turns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As often as a triangle faces the other way, and no more often than there are stiffnesses."""
    capture = open_capture(TinyCapture.make(("body",), scale=4).zip(tmp_path / "a.zip"))
    tried: list[float] = []
    monkeypatch.setattr(surface_fit, "_fitted", lambda person, fit, seen, sigma: tried.append(sigma) or person)
    monkeypatch.setattr(surface_fit, "turned_over", lambda body, before: np.array([len(tried) <= turns]))
    fit_surface(capture, count=1)
    assert tried == list(surface_fit.NEIGHBOUR_SIGMA[: turns + 1])
    assert tried == sorted(tried, reverse=True)
