"""The light on a head that turns is divided out of its points' colours."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.face_light import without_light
from avatarrex.capture.fit.paint import Points, Seen
from avatarrex.fields.light import LIGHT_FRAMES, Irradiance
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.model import EYES
from avatarrex.templates.person import Person, load_person

COUNT, SKIN = 600, 500
"""Points; the first of them on skin."""
TURNS = np.radians([-30, -15, 0, 15, 30])
WHOLE = np.radians([20, -20, 0, 20, -20])
"""Radians of head and root."""
FACING = 0.3


def on_face(person: Person) -> Points:
    """Most on the face's skin, the rest on eyeballs."""
    body, rng = person.body, np.random.default_rng(0)
    faces, ball = body.faces.numpy(), body.of_groups(EYES).numpy()
    skin = np.flatnonzero(np.isin(faces, person.face.body_vertex_ids.numpy()).all(1) & ~ball[faces].any(1))
    chosen = np.concatenate([rng.choice(skin, SKIN), rng.choice(np.flatnonzero(ball[faces].all(1)), COUNT - SKIN)])
    return Points(chosen, rng.dirichlet(np.ones(3), COUNT), np.zeros(COUNT, int))


def pictures(
    person: Person, points: Points, albedo: np.ndarray, lamp: Irradiance, frame: str
) -> tuple[list[Signals], list[list[Seen]]]:
    """What a camera in front sees of a head that turns before a lamp that stands still in `frame`."""
    signals, seen = [], []
    for turn, whole in zip(TURNS, WHOLE):
        neck = np.zeros((21, 3))
        neck[JOINT_NAMES.index("neck") - 1, 1] = turn
        signals.append(Signals.rest().replace(global_orient=np.array([0, whole, 0]), body_pose=neck))
        vertices = torch.from_numpy(template_surface(person, signals[-1])[0])
        corners = vertex_normals(vertices, person.body.faces)[person.body.faces[points.face]]
        normal = torch.nn.functional.normalize((torch.from_numpy(points.share)[..., None] * corners).sum(1), dim=-1)
        row = np.flatnonzero(normal[:, 2] > FACING)
        back = torch.from_numpy(Rotation.from_rotvec([0, whole, 0]).as_matrix())  # v @ R is Rᵀ v
        lit = normal if frame == "world" else normal @ back
        gain = lamp(lit[row].float()).double().numpy()
        colour = albedo[row] * np.where(row[:, None] < SKIN, gain, gain**-2)  # of a ball, which reflects another lamp
        seen.append([(row, normal[row, 2].numpy(), colour, np.repeat(colour[..., None], 3, -1))])
    return signals, seen


def spread(seen: list[list[Seen]], rows: np.ndarray) -> float:
    """By how much colours of the same point differ between pictures, in the mean over the points `rows`: a logarithm."""
    colours = np.full((len(seen), COUNT, 3), np.nan)
    for number, ((row, _, colour, _),) in enumerate(seen):
        colours[number, row] = np.log(colour)
    often = rows[np.isfinite(colours[:, rows, 0]).sum(0) > 2]
    return float(np.nanstd(colours[:, often], axis=0).mean())


@pytest.mark.parametrize("frame", LIGHT_FRAMES)
def test_colours_and_slopes_are_those_of_an_even_light_but_on_eyeballs(frame: str) -> None:
    person = load_person()
    points = on_face(person)
    albedo = np.random.default_rng(1).uniform(0.3, 0.6, (COUNT, 3))
    lamp = torch.zeros(8, 3)
    lamp[0], lamp[2] = torch.tensor([0.25, 0.2, 0.15]), 0.1
    signals, seen = pictures(person, points, albedo, Irradiance(lamp), frame)
    skin, balls = np.arange(SKIN), np.arange(SKIN, COUNT)
    found = without_light(person, points, signals, seen, frame)
    assert spread(seen, skin) > 0.04
    assert spread(found, skin) < 0.005
    other = next(each for each in LIGHT_FRAMES if each != frame)
    assert spread(without_light(person, points, signals, seen, other), skin) > 0.01
    for ((row, cosine, colour, slope),), ((row2, cosine2, colour2, slope2),) in zip(seen, found):
        np.testing.assert_array_equal(row2, row)
        np.testing.assert_array_equal(cosine2, cosine)
        np.testing.assert_allclose(slope2, slope * (colour2 / colour)[..., None])
        ball = np.isin(row, balls)
        assert ball.any()
        np.testing.assert_array_equal(colour2[ball], colour[ball])
