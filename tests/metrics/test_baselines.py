"""Baselines gathered from pictures of a template of known colours."""

import numpy as np
import pytest
from drawn_capture import painted, poses

from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.metrics.baselines import (
    EDGE,
    Observation,
    PosedMesh,
    lattice,
    look_up,
    mean_colour_mesh,
    medians,
    resolved_edge,
    textured_mesh,
)
from avatarrex.metrics.mesh_surface import mesh_surface
from avatarrex.signals.driving import Signals
from avatarrex.surface.pose import pose_surface
from avatarrex.surface.raster import draw_surface
from avatarrex.templates.person import load_person


@pytest.fixture(scope="module")
def gathered():
    """The painted template, six pictures of it in two poses, and both baselines made from them."""
    mesh = PosedMesh(load_person())
    drawer, seen = painted(mesh), []
    for number, signals in enumerate(poses(2)):
        for azimuth in (20, 140, 260):
            camera = Camera.orbit(azimuth + 60 * number, 5, 2.6, 40, (0, -0.1, 0), 320, 320)
            seen.append(Observation.of(signals, camera, drawer.draw(signals, camera).image.numpy()))
    return drawer, seen, (textured_mesh(mesh.person, seen), mean_colour_mesh(mesh.person, seen))


@pytest.mark.parametrize("pictures", [1, 4, 5])
def test_medians_are_of_the_pictures_that_count(pictures):
    """Against numpy's median of the same bytes; a texel that no picture shows has none."""
    rng = np.random.default_rng(pictures)
    seen = rng.integers(0, 256, (pictures, 400, 4), np.uint8)
    seen[..., 3] *= rng.random((pictures, 400)) < 0.6
    expected = np.full((400, 3), np.nan)
    for point, counts in enumerate((seen[..., 3] > 0).T):
        if counts.any():
            expected[point] = np.median(seen[counts, point, :3], axis=0) / 255
    assert np.isnan(expected).any()
    assert not np.isnan(expected).all()
    np.testing.assert_allclose(medians(seen), expected, rtol=1e-6, equal_nan=True)


@pytest.mark.parametrize("edge", [EDGE, 8])
def test_texels_give_back_themselves_and_every_linear_colour(edge):
    rng, corners = np.random.default_rng(0), lattice(edge)
    texels = rng.random((4, len(corners), 3)).astype(np.float32)
    for k, corner in enumerate(corners):
        weight = np.tile(corner, (4, 1))
        np.testing.assert_allclose(look_up(texels, np.arange(4), weight), texels[:, k], atol=1e-5)
    slope = rng.random((3, 3))
    linear = np.broadcast_to((corners @ slope).astype(np.float32), (4, len(corners), 3))
    weight = rng.dirichlet((1, 1, 1), 500)
    np.testing.assert_allclose(look_up(linear, rng.integers(0, 4, 500), weight), weight @ slope, atol=1e-5)
    assert len(corners) == (edge + 1) * (edge + 2) // 2


def test_the_texture_is_found_again(gathered):
    drawer, seen, (textured, _) = gathered
    error = np.abs(textured.texels - drawer.texels).max((1, 2))
    assert textured.name == "naked textured mesh"
    assert np.median(error) < 0.03  # a pixel is 8 mm here, the pattern 25 cm long
    other = Camera.orbit(50, 0, 2.6, 40, (0, -0.1, 0), 160, 160)
    again, true = (who.draw(seen[0].signals, other).image.numpy() for who in (textured, drawer))
    np.testing.assert_array_equal(again[..., 3], true[..., 3])
    covered = true[..., 3] == 1
    assert np.sqrt(((again - true)[covered][:, :3] ** 2).mean()) < 0.03


def test_half_a_pixel_off_is_noticed(gathered):
    """The mutant: cameras with pixel centres at integers."""
    drawer, seen, (textured, _) = gathered
    moved = []
    for one in seen:
        intrinsics = one.camera.intrinsics.copy()
        intrinsics[:2, 2] -= 0.5
        camera = Camera(intrinsics, one.camera.camera_from_world, one.camera.width, one.camera.height)
        moved.append(Observation(one.signals, camera, one.image, one.matte))
    off = textured_mesh(textured.mesh.person, moved)
    error = [np.median(np.abs(who.texels - drawer.texels).max((1, 2))) for who in (off, textured)]
    assert error[0] > 1.5 * error[1]


def test_the_mean_colour_is_that_of_the_foreground(gathered):
    _, seen, (_, mean) = gathered
    colour = np.concatenate([one.image[one.matte == 255] for one in seen]).mean(0) / 255
    assert mean.name == "mean-colour mesh"
    np.testing.assert_allclose(mean.texels[0, 0], colour, atol=0.01)
    assert np.ptp(mean.texels.reshape(-1, 3), axis=0).max() == 0


def test_its_geometry_is_the_posed_template(gathered):
    drawer, seen, _ = gathered
    camera = seen[0].camera
    drawing = drawer.draw(seen[0].signals, camera)
    surface = drawer.mesh.surface(seen[0].signals)
    pelvis = drawer.mesh.person.body.joint_template[0].numpy()
    centre = surface.vertices.mean(0) - (pelvis + seen[0].signals.translation)
    assert np.linalg.norm(centre) < 0.4
    pixel, _ = camera.pixels(drawing.position[drawing.hit])
    rows, columns = np.nonzero(drawing.hit)
    np.testing.assert_allclose(pixel, np.stack([columns, rows], 1) + 0.25, atol=1e-3)  # first of 2 x 2 samples


def test_nothing_to_gather_is_refused():
    person = load_person()
    with pytest.raises(InputError, match="training pictures"):
        textured_mesh(person, [])
    black = np.zeros((32, 32, 3), np.uint8)
    empty = Observation(poses(1)[0], Camera.orbit(width=32, height=32), black, black[..., 0])
    with pytest.raises(InputError, match="training pictures"):
        textured_mesh(person, [empty])
    with pytest.raises(InputError, match="training pictures"):
        mean_colour_mesh(person, [empty])


def test_opengl_draws_what_the_software_draws(gathered):
    """A pose with hands, jaw and an expression: the same outline, the same colours within a texel."""
    textured = gathered[2][0]
    surface, person = mesh_surface(textured, 512), textured.mesh.person
    signals = poses(2)[1].replace(expression=0.5 * np.eye(52)[17], jaw_pose=np.array([0.2, 0, 0]))
    camera = Camera.orbit(40, 5, 2.6, 40, (0, -0.1, 0), 200, 200)
    posed = pose_surface(surface, person, signals)
    world = posed.world_from_root(signals)
    placed = posed.vertices @ world[:3, :3].T + world[:3, 3]
    apart = np.abs(placed - textured.mesh.surface(signals).vertices).max()
    assert 1e-3 < apart < 6e-3, "it lacks the template's pose directions, and nothing else"
    talking = Signals.rest().replace(expression=0.5 * np.eye(52)[17], left_hand_pose=signals.left_hand_pose)
    bent = pose_surface(surface, person, talking).vertices
    assert np.abs(bent - textured.mesh.surface(talking).vertices).max() < 1e-4
    view = camera.seen_from(world)
    ours = draw_surface(posed, np.zeros((2, 8, 3)), view).read()
    theirs = textured.draw(signals, camera).image.numpy()
    both = (ours[..., 3] == 1) & (theirs[..., 3] == 1)
    assert both.sum() > 1500
    assert np.abs(ours[..., 3] - theirs[..., 3]).mean() < 0.01
    assert np.sqrt(np.square(ours - theirs)[both].mean()) < 0.04


def test_texels_are_as_fine_as_the_nearest_camera_resolves(gathered):
    """A millimetre at the head: as many as 8 to an edge of 12 mm; 8 mm: no fewer than `EDGE`."""
    person, seen = gathered[0].mesh.person, gathered[1]
    assert resolved_edge(person, seen) == EDGE
    near = Camera.orbit(20, 0, 0.6, 40, (0, 0.6, 0), 512, 512)
    close = Observation(seen[0].signals, near, np.zeros((512, 512, 3), np.uint8), np.zeros((512, 512), np.uint8))
    assert EDGE < resolved_edge(person, [*seen, close]) <= 8


def test_finer_texels_carry_a_finer_pattern(gathered):
    """Pictures of 1 mm: a pattern of 12 mm is lost between texels 4 mm apart, and found by finer ones."""
    mesh = gathered[0].mesh
    fine = painted(mesh, 8, wave=500.0)
    signals, errors = poses(1)[0], []
    view = Camera.orbit(20, 0, 0.8, 14, (0, 0.3, 0), 216, 216)
    true = fine.draw(signals, view).image.numpy()
    seen = [Observation.of(signals, view, true)]
    for edge in (EDGE, 8):
        drawn = textured_mesh(mesh.person, seen, edge=edge).draw(signals, view).image.numpy()
        errors.append(np.sqrt(np.square(drawn - true)[true[..., 3] == 1].mean()))
    assert errors[1] < 0.7 * errors[0], errors
