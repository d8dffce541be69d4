"""The pictures of the synthetic capture: albedo lattice, rasteriser and ambient occlusion against other routes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import trimesh

from avatarrex.camera import Camera
from avatarrex.capture.synthetic.albedo_lattice import bake, lattice_points
from avatarrex.capture.synthetic.cameras import body_ring, face_arc, fitted
from avatarrex.capture.synthetic.occlusion import Occlusion, sphere_directions
from avatarrex.capture.synthetic.rasteriser import Rasteriser, draw_reference
from avatarrex.capture.synthetic.subject import PosedSubject, Subject, load_subject
from avatarrex.gl.context import current_context, gl_unavailable
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_pose

needs_gl = pytest.mark.skipif(gl_unavailable() is not None, reason=str(gl_unavailable()))


def unpack(words: np.ndarray) -> np.ndarray:
    """(s, 3) in [0, 1] of packed samples."""
    return np.stack([words & 1023, words >> 10 & 1023, words >> 20], 1) / 1023


@lru_cache(maxsize=1)
def laughing() -> PosedSubject:
    """A pose with arms bent and an open mouth; shared."""
    signals = Signals.rest().replace(body_pose=named_pose("wave"), expression=named_expression("laugh"))
    return load_subject().pose(signals)


class Triangles(Subject):
    """Four loose triangles whose albedo is the rest position."""

    vertices = np.random.default_rng(5).random((12, 3))  # type: ignore[assignment]
    faces = np.arange(12).reshape(4, 3)  # type: ignore[assignment]

    def albedo(self, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
        return np.einsum("pk,pkc->pc", bary, self.vertices[self.faces[face]])


def test_a_linear_albedo_is_stored_exactly() -> None:
    """At every sample of lattices of several sizes, to half a step of ten bits."""
    loose = object.__new__(Triangles)
    object.__setattr__(loose, "openness", np.ones(12))
    stored = bake(loose, np.array([9.0, 0.4, 0.11, 0.02]))
    sides = stored.lattice[:, 1].tolist()
    assert sides[0] == 1
    assert len(set(sides)) == 4
    for face, (start, n) in enumerate(stored.lattice.tolist()):
        points = lattice_points(n)
        exact = loose.albedo(np.full(len(points), face), points)
        np.testing.assert_allclose(unpack(stored.samples[start : start + len(points)]), exact, atol=0.51 / 1023)
    assert len(stored.samples) == sum((n + 1) * (n + 2) // 2 for n in sides)


@needs_gl
@pytest.mark.parametrize("view", ["body", "face"])
def test_the_rasteriser_agrees_with_the_reference(view: str) -> None:
    """Coverage up to flips on edges, colour to the lattice's resolution; a light from elsewhere does not pass."""
    posed = laughing()
    openness = np.linspace(0.2, 1, len(posed.vertices))
    camera = (
        Camera.orbit(20, 5, 3.0, 36, (0, 0, 0), 72, 96)
        if view == "body"
        else Camera.orbit(-30, 0, 1.0, 17, (0, 0.7, 0), 72, 96)
    )
    spacing = np.full(len(posed.faces), 0.004)  # about the sleeves' knit: the mean difference is its
    if view == "face":
        spacing[:] = 0.02
        spacing[posed.subject.faces_of("face", "hair")] = 0.0015
    rasteriser = Rasteriser(posed.faces, bake(posed.subject, spacing), 3)
    rasteriser.pose(posed, openness)
    drawn, expected = rasteriser.draw(camera).colour, draw_reference(posed, openness, camera, 3).colour
    assert drawn[..., 3].mean() > 0.08
    assert (np.abs(drawn[..., 3] - expected[..., 3]) > 1e-6).mean() < 0.002
    difference = np.abs(drawn - expected)[drawn[..., 3] > 0]
    assert difference.mean() < 0.008
    assert np.quantile(difference, 0.99) < 0.06
    with current_context():
        rasteriser.lit["u_key"] = (0.0, -1.0, 0.0)
    assert np.abs(rasteriser.draw(camera).colour - expected)[drawn[..., 3] > 0].mean() > 0.03


@needs_gl
def test_tiles_make_the_same_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn in one piece and in many, up to flips of single samples."""
    from avatarrex.capture.synthetic import rasteriser as module

    posed = laughing()
    lattice = bake(posed.subject, np.full(len(posed.faces), 0.05))
    camera = Camera.orbit(20, 5, 3.0, 36, (0.3, 0.2, 0), 60, 80)
    rasteriser = Rasteriser(posed.faces, lattice, 4)
    rasteriser.pose(posed, np.ones(len(posed.vertices)))
    whole = rasteriser.draw(camera).colour
    monkeypatch.setattr(module, "TILE_SAMPLES", 96)
    parts = rasteriser.draw(camera).colour
    assert (np.abs(parts - whole).max(-1) > 0.02).mean() < 0.005


@needs_gl
def test_openness_below_a_ball() -> None:
    """A plane below a ball: 1 − (r/h)² straight under it (a ball hides (r/h)² of the cosine-weighted sky)."""
    grid = np.stack(np.meshgrid(np.linspace(-2, 2, 81), np.linspace(-2, 2, 81)), -1).reshape(-1, 2)
    cell = (np.arange(80)[:, None] * 81 + np.arange(80)).ravel()
    faces = np.concatenate([np.stack([cell, cell + 1, cell + 82], 1), np.stack([cell, cell + 82, cell + 81], 1)])
    floor = np.column_stack([grid, np.zeros(len(grid))])
    for radius, height in ((0.3, 0.5), (0.2, 0.8)):
        ball = trimesh.creation.icosphere(3, radius)
        vertices = np.concatenate([floor, ball.vertices + np.array([0, 0, height])])
        normals = np.concatenate([np.tile([0.0, 0, 1], (len(floor), 1)), ball.vertex_normals])
        both = np.concatenate([faces, ball.faces + len(floor)])
        openness = Occlusion(both, len(vertices), 600, 512).openness(vertices, normals, np.array([0, 0, 0.4]), 0.9)
        centre = 40 * 81 + 40
        assert openness[centre] == pytest.approx(1 - (radius / height) ** 2, abs=0.03)
        assert openness[40 * 81 + 26] > 0.9
        top = len(floor) + int(ball.vertices[:, 2].argmax())
        assert openness[top] > 0.99


@needs_gl
def test_openness_of_the_subject_follows_the_pose() -> None:
    """The inner upper arm is dark when the arm hangs and open when it is raised; the crown is always open."""
    subject = load_subject()
    occlusion = Occlusion(subject.faces, len(subject.vertices), 24, 384)
    names = subject.model.joint_names
    own = subject.model.weights[:, names.index("left_elbow")].numpy() > 0.9
    under = own & (subject.solid_of_vertex == 0) & (subject.normals[:, 1] < -0.8)
    crown = subject.vertices[:, 1] > subject.vertices[:, 1].max() - 0.01
    found = {}
    for name in ("stand", "arms_up"):
        posed = subject.pose(Signals.rest().replace(body_pose=named_pose(name)))
        centre = posed.vertices.mean(0)
        found[name] = occlusion.openness(posed.vertices, posed.normals, centre, 1.3)
        assert found[name][crown].mean() > 0.9
        assert (found[name] >= 0).all()
        assert (found[name] <= 1).all()
    assert found["arms_up"][under].mean() > found["stand"][under].mean() + 0.1


def test_directions_are_even() -> None:
    """Unit vectors whose mean and second moment are a uniform sphere's."""
    towards = sphere_directions(500)
    np.testing.assert_allclose(np.linalg.norm(towards, axis=1), 1)
    np.testing.assert_allclose(towards.mean(0), 0, atol=2e-3)
    np.testing.assert_allclose(towards.T @ towards / 500, np.eye(3) / 3, atol=2e-3)


def test_cameras_fit_the_subject(rng: np.random.Generator) -> None:
    """The tightest common focal length: all points within the margin, one of them on it; the arc spans 130°."""
    points = rng.uniform(-1, 1, (3, 50, 3)) * [0.5, 0.9, 0.4]
    for cameras in (body_ring(16, 384, 512, np.zeros(3)), face_arc(6, 384, 512, np.zeros(3))):
        chosen = fitted(cameras, points, 0.9)
        assert len({camera.intrinsics[0, 0] for camera in chosen}) == 1
        reach = 0.0
        for camera in chosen:
            pixel, _ = camera.pixels(points)
            reach = max(reach, float(np.abs(pixel / [192, 256] - 1).max()))
        assert reach == pytest.approx(0.9, abs=1e-4)
    arc = face_arc(6, 10, 10, np.zeros(3))
    ends = [np.degrees(np.arctan2(camera.centre[0], camera.centre[2])) for camera in arc]
    assert (ends[0], ends[-1]) == pytest.approx((-65, 65))
    ring = body_ring(16, 10, 10, np.zeros(3))
    turns = np.diff(np.unwrap([np.arctan2(camera.centre[0], camera.centre[2]) for camera in ring]))
    np.testing.assert_allclose(turns, np.pi / 8)
