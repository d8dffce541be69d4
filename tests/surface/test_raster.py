"""Pictures of a surface: against a z-buffer in NumPy, and what stays where in memory."""

import gc
from dataclasses import replace

import moderngl
import numpy as np
import pytest
import torch
from surface.template_surface import template_surface

from avatarrex.camera import Camera
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.counters import Counters
from avatarrex.fields.light import Irradiance
from avatarrex.gl import current_context, gl_context, use_context
from avatarrex.gl.context import NoContext
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.surface import raster
from avatarrex.surface.extent import Extent
from avatarrex.surface.look import KINDS, Look, shaded
from avatarrex.surface.pose import PosedSurface, pose_surface
from avatarrex.surface.raster import TILE, Placed, draw_surface, draw_surfaces, surface_geometry
from avatarrex.surface.surface import Surface
from avatarrex.surface.upload import z_order
from avatarrex.templates.person import load_person

PERSON = load_person()
HARMONICS = np.random.default_rng(0).normal(size=(2, 8, 3)) * 0.15
"""On body and hands, on the face."""
WAVE = Signals.rest().replace(body_pose=named_pose("wave"), expression=np.eye(52)[17] * 0.8)
SIZE = 192
DARK = np.zeros((2, 8, 3))


def camera(azimuth: float = 25, distance: float = 2.6, size: int = SIZE) -> Camera:
    return Camera.orbit(azimuth, 10, distance, target=(0, -0.1, 0), width=size, height=size)


@pytest.fixture(scope="module")
def posed() -> PosedSurface:
    return pose_surface(template_surface(), PERSON, WAVE)


def wanted(posed: PosedSurface, view: Camera) -> tuple[np.ndarray, ...]:
    """Hit, depth, position, normal, colour without texture filter, and share of parts, by NumPy."""
    surface = posed.surface
    face, bary, depth = visible_faces(posed.vertices.astype(np.float64), surface.faces, view)
    hit = face >= 0
    corners, weight = surface.faces[face], bary[..., None]

    def at(values: np.ndarray) -> np.ndarray:
        return np.where(hit[..., None], (values[corners] * weight).sum(2), 0)

    normal = at(posed.normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    body, face = (Irradiance(one.float()) for one in torch.from_numpy(HARMONICS))
    towards = torch.from_numpy(normal).reshape(-1, 3).float()
    on_body, on_face = (light(towards).numpy().reshape(normal.shape) for light in (body, face))
    lit = at(surface.lit[:, None])
    h, w = surface.albedo.shape[:2]
    uv = at(surface.uv) * [w, h] - 0.5
    x, y = (np.clip(uv[..., i], 0, side - 1) for i, side in ((0, w), (1, h)))
    column, row = np.minimum(x.astype(int), w - 2), np.minimum(y.astype(int), h - 2)
    u, v = (x - column)[..., None], (y - row)[..., None]
    texel = surface.albedo / 255 * surface.albedo_scale
    above = texel[row, column] * (1 - u) + texel[row, column + 1] * u
    below = texel[row + 1, column] * (1 - u) + texel[row + 1, column + 1] * u
    colour = np.clip((above * (1 - v) + below * v + at(posed.tint)) * ((1 - lit) * on_face + lit * on_body), 0, 1)
    part = at((surface.part[:, None] == [1, 2, 3]).astype(float))
    return hit, np.where(hit, depth, 0), at(posed.vertices.astype(np.float64)), normal, colour, part


def inside(mask: np.ndarray) -> np.ndarray:
    """Pixels whose eight neighbours are in the mask, too."""
    near = np.pad(mask, 1)
    h, w = mask.shape
    return np.all([near[y : y + h, x : x + w] for y in range(3) for x in range(3)], 0)


def test_geometry_is_the_z_buffer_s(posed):
    view = camera()
    hit, depth, position, normal, _, part = wanted(posed, view)
    found = surface_geometry(posed, view)
    flips = (found.hit != hit).sum()
    assert flips <= 0.002 * hit.sum(), "a triangle's edge through a pixel's centre"
    both = found.hit & hit
    off = np.abs(found.depth - depth)[both]
    assert np.median(off) < 1e-6
    same = both & (np.abs(found.depth - depth) < 1e-4)
    assert same.sum() > 0.998 * both.sum(), "where two triangles meet either is seen"
    assert np.abs(found.position - position)[same].max() < 2e-4
    assert np.quantile(np.abs(found.normal - normal)[same], 0.995) < 2e-3
    assert np.quantile(np.abs(found.part - part)[same], 0.995) < 1e-2
    assert not any(values[~found.hit].any() for values in (found.position, found.normal, found.depth, found.part))


def test_colours_are_texture_tint_and_light(posed):
    view = camera()
    hit, *_, colour, _ = wanted(posed, view)
    image = draw_surface(posed, HARMONICS, view, samples=1).read()
    same = inside(hit)
    assert np.median(np.abs(image[..., :3] - colour)[same]) < 1.5 / 255
    assert np.quantile(np.abs(image[..., :3] - colour)[same], 0.95) < 5 / 255, "coarser mip levels"
    assert (image[..., 3] != hit).sum() <= 0.002 * hit.sum()
    face = same & (surface_geometry(posed, view).part[..., 2] > 0.99)
    assert face.sum() > 50
    assert np.median(np.abs(image[..., :3] - colour)[face]) < 1.5 / 255, "which has its own tone"


def test_a_tint_is_lit_as_the_albedo_is(posed):
    tinted = replace(posed, tint=np.full_like(posed.tint, 0.15))
    hit, *_, colour, _ = wanted(tinted, camera())
    image = draw_surface(tinted, HARMONICS, camera(), samples=1).read()
    assert np.median(np.abs(image[..., :3] - colour)[inside(hit)]) < 1.5 / 255


def test_the_albedo_is_scaled_before_it_is_clipped(posed):
    scaled = replace(posed.surface, albedo_scale=1.7)
    again = replace(posed, surface=scaled)
    hit, *_, colour, _ = wanted(again, camera())
    image = draw_surface(again, HARMONICS, camera(), samples=1).read()
    assert np.median(np.abs(image[..., :3] - colour)[inside(hit)]) < 1.5 / 255


@pytest.mark.parametrize("samples", [2, 4])
def test_coverage_is_the_share_of_samples_and_colours_are_premultiplied(posed, samples):
    view = camera()
    fine = wanted(posed, camera(size=8 * SIZE))[0].reshape(SIZE, 8, SIZE, 8).mean((1, 3))
    image = draw_surface(posed, HARMONICS, view, samples).read()
    alpha = image[..., 3]
    assert np.allclose(alpha * samples, np.rint(alpha * samples), atol=0.01)
    assert abs(alpha.mean() - fine.mean()) < 2e-3 * fine.mean() + 1e-4
    edge = (fine > 0) & (fine < 1)
    assert np.abs(alpha - fine)[edge].mean() < {2: 0.2, 4: 0.12}[samples]
    assert (alpha[fine == 1] == 1).mean() > 0.995
    assert (image[..., :3] <= alpha[..., None] + 1 / 255).all(), "premultiplied"
    assert (image[..., :3].sum(-1)[alpha > 0] > 0).mean() > 0.99


def test_the_first_row_is_the_top(posed):
    view = camera(0)
    found, image = surface_geometry(posed, view), draw_surface(posed, DARK, view).read()
    rows, columns = np.nonzero(found.hit)
    at = found.position[rows, columns]
    assert np.corrcoef(rows, at[:, 1])[0, 1] < -0.99
    assert np.corrcoef(columns, at[:, 0])[0, 1] > 0.99
    assert (image[..., 3] > 0).any(1).argmax() == pytest.approx(found.hit.any(1).argmax(), abs=1)


def test_backs_are_not_drawn():
    sheet = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    for azimuth, drawn in ((0, True), (180, False)):
        view = Camera.orbit(azimuth, 0, 4, width=32, height=32)
        assert surface_geometry(_of(sheet, np.array([[0, 1, 2], [0, 2, 3]], np.int32)), view).hit[16, 16] == drawn
    closed = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    at = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32) - 0.25
    for azimuth in (0, 70, 200, 300):
        view = Camera.orbit(azimuth, 20, 4, width=64, height=64)
        found = surface_geometry(_of(at, closed), view)
        assert (found.hit == (visible_faces(at.astype(float), closed, view)[0] >= 0)).mean() > 0.999


def _of(at: np.ndarray, faces: np.ndarray) -> PosedSurface:
    """A posed surface of given vertices."""
    v, base = len(at), template_surface()
    cut = {name: getattr(base, name)[:v] for name in ("joint", "weight", "template_face", "barycentric", "part", "lit")}
    correction = replace(base.correction, group=base.correction.group[:v], basis=base.correction.basis[:v])
    none = {"morph_vertex": np.zeros(0, np.int32), "morph": np.zeros((52, 0, 3), np.float32)}
    surface = replace(
        base, vertices=at, faces=faces, uv=np.zeros((v, 2), np.float32), uv_vertex=np.arange(v, dtype=np.int32),
        uv_faces=faces, correction=correction, morph_colour=none["morph"], **none, **cut,
    )  # fmt: skip
    rest = pose_surface(surface, PERSON, Signals.rest())
    return replace(rest, vertices=at)


def test_a_hidden_hand_is_not_drawn(posed):
    view, counters = camera(), Counters()
    whole, without = surface_geometry(posed, view), surface_geometry(posed, view, frozenset({"left_hand"}), counters)
    assert whole.part[..., 0].sum() > 20
    assert without.part[..., 0].sum() < 0.2 * whole.part[..., 0].sum()
    assert counters["surface_triangles"] < len(posed.surface.faces)


@pytest.mark.parametrize("distance", [0.02, 0.3, 20.0, 5000.0, 1e6])
def test_any_distance_can_be_drawn(posed, distance):
    view = Camera.orbit(20, 10, distance, width=64, height=48)
    image, found = draw_surface(posed, HARMONICS, view).read(), surface_geometry(posed, view)
    assert np.isfinite(image).all()
    assert all(np.isfinite(values).all() for values in (found.position, found.normal, found.depth))
    if 0.1 < distance < 100:
        assert found.hit.any()
    if found.hit.any():
        assert abs(np.median(found.depth[found.hit]) - distance) < 1.5


def test_nothing_at_the_camera_s_back_or_beside_the_picture(posed):
    away = Camera.orbit(0, 0, 3, target=(0, 0, -9), width=64, height=64)
    aside = Camera.orbit(0, 0, 3, target=(50, 0, 0), width=64, height=64)
    for view in (away, aside):
        assert Extent.of(posed.bounds, view) is None
        assert not draw_surface(posed, HARMONICS, view).read().any()
        assert not surface_geometry(posed, view).hit.any()


def test_one_sample_a_pixel_is_drawn_from_coarser_mipmaps(posed, monkeypatch):
    """What moves fast flickers less, and is drawn sooner."""
    rng, surface = np.random.default_rng(0), posed.surface
    albedo, uv = rng.integers(0, 256, (256, 256, 3), np.uint8), 0.05 * rng.random(surface.uv.shape, np.float32)
    noisy = pose_surface(replace(surface, albedo=albedo, uv=uv), PERSON, WAVE)

    def spread():
        image = draw_surface(noisy, HARMONICS, camera(), samples=1).read()
        return image[image[..., 3] == 1, :3].std()

    coarse = spread()
    monkeypatch.setitem(raster.LOD_BIAS, 1, raster.LOD_BIAS[4])
    assert coarse < 0.8 * spread()


@pytest.mark.parametrize("samples", [1, 4])
def test_a_picture_larger_than_a_tile_is_the_same_picture(posed, samples):
    size = TILE + 200
    large = Camera.orbit(0, 0, 0.9, target=(0, 0.4, 0), width=size, height=size)
    extent = Extent.of(posed.bounds, large)
    assert len(extent.tiles(TILE)) > 1
    shifted = large.intrinsics.copy()
    shifted[:2, 2] -= TILE - 64
    part = Camera(shifted, large.camera_from_world, 128, 128)
    whole, cut = (draw_surface(posed, HARMONICS, view, samples).read() for view in (large, part))
    seam = whole[TILE - 64 : TILE + 64, TILE - 64 : TILE + 64]
    assert (np.abs(seam - cut) > 1 / 255).mean() < 2e-3


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("place", [(0.35, 0.1, -0.2), (-0.6, 0.0, -1.3)])
def test_several_hide_each_other_by_their_distance(posed, order, place):
    """One stands behind the other's arm, or far behind: each pixel is the nearer one's picture."""
    other = pose_surface(template_surface(texture=32), PERSON, Signals.rest())
    shift = np.eye(4)
    shift[:3, 3] = place
    views = camera(), camera().seen_from(shift)
    one, two = (Placed(mesh, HARMONICS, view) for mesh, view in zip((posed, other), views))
    alone = [draw_surface(placed.posed, HARMONICS, placed.view, 1).read() for placed in (one, two)]
    seen = [surface_geometry(placed.posed, placed.view) for placed in (one, two)]
    counters = Counters()
    both = draw_surfaces([one, two][::order], 1, counters).read()
    depth = np.stack([np.where(found.hit, found.depth, 1e3) for found in seen])
    nearer = np.where((depth[0] <= depth[1])[..., None], *alone)
    sure = (np.abs(depth[0] - depth[1]) > 1e-3) | ~(seen[0].hit | seen[1].hit)
    assert (seen[0].hit & seen[1].hit).sum() > 200
    hidden = (depth[0] < depth[1])[seen[0].hit & seen[1].hit].mean()
    assert hidden == 1 if place[2] < -1 else 0 < hidden < 1
    assert (np.abs(both - nearer).max(-1) > 1 / 255 + 1e-6)[sure].mean() < 2e-3
    faces = sum(len(mesh.surface.faces) for mesh in (posed, other))
    assert counters.as_dict()["surface_triangles"] == faces


def test_what_has_not_changed_is_not_uploaded_again(posed):
    surface = replace(posed.surface)
    first = pose_surface(surface, PERSON, WAVE)
    counters = Counters()
    draw_surface(first, HARMONICS, camera(), counters=counters)
    assert counters["bytes_uploaded"] == 12 * len(first.vertices) + 36 * len(surface.uv)
    assert counters["surface_triangles"] == len(surface.faces)
    draw_surface(first, HARMONICS, camera(60), counters=counters)
    assert counters["bytes_uploaded"] == 12 * len(first.vertices) + 36 * len(surface.uv)
    assert counters["bytes_read_back"] == 0
    draw_surface(pose_surface(surface, PERSON, Signals.rest()), HARMONICS, camera(), counters=counters)
    assert counters["bytes_uploaded"] == 2 * (12 * len(first.vertices) + 36 * len(surface.uv))


def test_a_picture_keeps_its_texture_until_nobody_has_it(posed):
    first, second = (draw_surface(posed, HARMONICS, camera(azimuth)) for azimuth in (0, 90))
    assert first.texture is not second.texture
    before = first.read()
    draw_surface(posed, HARMONICS, camera(180))
    assert np.array_equal(first.read(), before)
    texture = second.texture
    del second
    gc.collect()
    aside = Camera.orbit(0, 0, 3, target=(50, 0, 0), width=SIZE, height=SIZE)
    again = draw_surface(posed, HARMONICS, aside)
    assert again.texture is texture
    assert not again.read().any(), "nothing of the old picture is left"


def test_the_state_of_the_context_is_given_back(posed):
    context = gl_context()
    target = context.simple_framebuffer((16, 16))
    target.use()
    draw_surface(posed, HARMONICS, camera())
    surface_geometry(posed, camera())
    assert context.fbo is target
    assert context.front_face == "ccw"


def test_two_contexts_draw_the_same(posed):
    here = draw_surface(posed, HARMONICS, camera())
    image = here.read()
    other = moderngl.create_context(standalone=True, require=430, backend="egl")
    try:
        with other:
            use_context(other)
            there = draw_surface(posed, HARMONICS, camera())
            assert np.array_equal(there.read(), image)
            with pytest.raises(NoContext):
                here.read()
    finally:
        use_context(None)
    assert np.array_equal(here.read(), image)


def test_surfaces_that_are_no_more_give_their_memory_back(posed):
    from avatarrex.surface.raster import Raster

    surface: Surface | None = replace(posed.surface)
    draw_surface(pose_surface(surface, PERSON, WAVE), HARMONICS, camera())
    with current_context() as context:
        raster = context.extra[Raster]
    count = len(raster._surfaces)
    del surface
    gc.collect()
    assert len(raster._surfaces) == count - 1
    assert raster._gone
    draw_surface(posed, HARMONICS, camera())
    assert not raster._gone


def test_triangles_that_are_near_follow_each_other():
    """On a lattice of 8³ each eighth of it comes as one run, and each cube of 2³ in that."""
    cells = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), -1).reshape(-1, 3)
    cells = cells[np.random.default_rng(0).permutation(len(cells))]
    ordered = cells[np.argsort(z_order(3.0 * cells - 1))]
    for size, side in ((8, 2), (64, 4)):
        runs = ordered.reshape(-1, size, 3)
        assert (np.ptp(runs, 1) == side - 1).all()


def test_influences_have_no_colours_of_their_own():
    with pytest.raises(ValueError, match="the caller's own"):
        Look("influence").colours(np.zeros((1, 3)), np.zeros(1), np.zeros((1, 3)), np.array([0.0, 0.0, 1.0]))


def test_one_point_and_none_have_a_place():
    assert z_order(np.zeros((1, 3))).tolist() == [0]
    assert len(z_order(np.zeros((0, 3)))) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_view_mode_has_the_colours_of_its_reference(kind):
    """Of one sample a pixel, where the geometry that is read back says what is seen."""
    posed, view, own = pose_surface(template_surface(), PERSON, Signals.rest()), camera(40), np.array([0.2, 0.5, 0.8])
    posed = replace(posed, tint=np.tile(own.astype(np.float32), (len(posed.vertices), 1)))
    look = Look(kind, 2.0, 3.0)
    image = draw_surfaces([Placed(posed, HARMONICS, view, look=look)], samples=1).read()
    found = surface_geometry(posed, view)
    normal, forward = found.normal[found.hit], view.camera_from_world[2, :3]
    expected = (
        shaded(np.tile(own, (len(normal), 1)), normal, forward)
        if kind == "influence"
        else look.colours(normal, found.depth[found.hit], found.part[found.hit], forward)
    )
    assert image[found.hit][:, :3] == pytest.approx(expected, abs=0.004)
    assert not image[~found.hit].any()
    assert len(np.unique(image.reshape(-1, 4), axis=0)) > 3
