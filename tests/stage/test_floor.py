"""The floor's light: where its map lies, the drawn one against what a march through the same body says, and the figure in it."""

from dataclasses import replace

import numpy as np
import pytest
from stage.solid_volume import banded
from surface.template_surface import template_surface

from avatarrex.camera import Camera
from avatarrex.reference.solids import sphere
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.stage import lighting
from avatarrex.stage.distance import distance_grid
from avatarrex.stage.lighting import SurfaceLight, floor_light
from avatarrex.stage.stage import Stage
from avatarrex.surface.floor import MARGIN, box_corners, floor_region, span, texel_centres
from avatarrex.surface.pose import PosedSurface, pose_surface
from avatarrex.surface.raster import Placed, draw_surfaces, surface_geometry
from avatarrex.surface.shadow import SIDE, Caster, draw_shadow
from avatarrex.surface.spheres import MOST, Spheres
from avatarrex.surface.surface import Correction, Surface
from avatarrex.templates.person import load_person

LIGHT = Stage(shown=True, height=-1.2, azimuth=50.0, elevation=50.0).light
RADIUS, HEIGHT = 0.3, 0.5


@pytest.fixture(scope="module")
def ball() -> PosedSurface:
    """The template's surface, its triangles replaced by a ball of 30 cm about the origin."""
    rows, columns = 24, 48
    lean, turn = np.meshgrid(np.linspace(0, np.pi, rows), np.linspace(0, 2 * np.pi, columns), indexing="ij")
    vertices = RADIUS * np.stack([np.sin(lean) * np.sin(turn), np.cos(lean), np.sin(lean) * np.cos(turn)], -1).reshape(
        -1, 3
    )
    at = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (at[i : i - 1 or None, j : j - 1 or None].ravel() for i in (0, 1) for j in (0, 1))
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.int32)
    whole, count = template_surface(), rows * columns
    surface = Surface(
        vertices=vertices.astype(np.float32), faces=faces, joint=np.zeros((count, 8), np.uint8),
        weight=np.eye(8, dtype=np.float32)[np.zeros(count, int)], template_face=np.zeros(count, np.int32),
        barycentric=np.zeros((count, 3), np.float32), part=np.zeros(count, np.uint8), uv=np.zeros((count, 2), np.float32),
        uv_vertex=np.arange(count, dtype=np.int32), uv_faces=faces, albedo=whole.albedo, albedo_scale=1.0,
        lit=np.zeros(count, np.float32), morph_vertex=np.zeros(0, np.int32), morph=np.zeros((52, 0, 3), np.float32),
        morph_colour=np.zeros((52, 0, 3), np.float32), correction=Correction.none(count),
    )  # fmt: skip
    posed = pose_surface(whole, load_person(), Signals.rest())
    normals = (vertices / RADIUS).astype(np.float32)
    return replace(posed, surface=surface, vertices=surface.vertices, normals=normals, tint=0 * normals)


def test_the_map_contains_the_shadow():
    """A post of 1 m, lit from 45° at its left: its tip's shadow is 1 m to the right."""
    bounds = np.array([[-0.1, 0.0, -0.1], [0.1, 1.0, 0.1]])
    direction = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    x0, z0, x1, z1 = floor_region(box_corners(bounds, np.eye(4)), direction, 0.0)
    assert (x0, x1) == pytest.approx((-1.1 - MARGIN, 0.1 + MARGIN))
    assert (z0, z1) == pytest.approx((-0.1 - MARGIN, 0.1 + MARGIN))
    points = texel_centres((0.0, 10.0, 4.0, 12.0), -1.0, 4)
    assert points[0] == pytest.approx((0.5, -1.0, 10.25))
    assert points[1] == pytest.approx((1.5, -1.0, 10.25))


def test_what_is_drawn_is_what_is_marched(ball):
    """A ball half a metre over a floor: the map drawn from its triangles, and that from its distances."""
    light = replace(LIGHT, height=-HEIGHT, softness=5.0)
    shadow = draw_shadow([Caster(ball, np.eye(4))], light.direction, light.width, light.height)
    drawn = shadow.read()
    volume = banded(sphere((0.0, 0.0, 0.0), RADIUS))
    marched = floor_light([(distance_grid(volume), np.eye(4))], light, side=64)
    points = texel_centres(marched.region, light.height, 64)
    x0, z0, x1, z1 = drawn.region
    column = np.clip((points[:, 0] - x0) / (x1 - x0) * SIDE, 0, SIDE - 1).astype(int)
    row = np.clip((points[:, 2] - z0) / (z1 - z0) * SIDE, 0, SIDE - 1).astype(int)
    inside = (points[:, 0] > x0) & (points[:, 0] < x1) & (points[:, 2] > z0) & (points[:, 2] < z1)
    apart = np.abs(drawn.values[row, column].astype(int) - marched.values.reshape(-1, 2))[inside]
    assert apart.mean(0)[0] < 5
    assert apart.mean(0)[1] < 12
    dark = marched.values.reshape(-1, 2)[inside][:, 0] < 20
    assert dark.sum() > 30
    assert (drawn.values[row, column][inside][dark][:, 0] < 100).all()


def test_a_shadow_keeps_its_map_while_it_is_there(ball):
    first = draw_shadow([Caster(ball, np.eye(4))], LIGHT.direction, LIGHT.width, LIGHT.height)
    before = first.read().values.copy()
    moved = np.eye(4)
    moved[0, 3] = 0.7
    second = draw_shadow([Caster(ball, moved), Caster(ball, np.eye(4))], LIGHT.direction, LIGHT.width, LIGHT.height)
    assert np.array_equal(first.read().values, before)
    assert (second.read().values[..., 0] < 128).sum() > 0
    glo = first.texture.glo
    del first
    third = draw_shadow([Caster(ball, np.eye(4))], LIGHT.direction, LIGHT.width, LIGHT.height)
    assert third.texture.glo == glo
    assert np.array_equal(third.read().values, before)


def test_figures_far_apart_have_shadows_as_sharp_as_one(ball):
    """Texels of a map over two are no larger than of a map over one; beyond some metres they grow."""
    alone = draw_shadow([Caster(ball, np.eye(4))], LIGHT.direction, LIGHT.width, LIGHT.height)
    texel = span(alone.region) / alone.texture.size[0]
    for metres, most in ((0.2, 1.0), (2.0, 1.0), (4.0, 1.0), (30.0, 12.0)):
        moved = np.eye(4)
        moved[0, 3] = metres
        both = draw_shadow([Caster(ball, np.eye(4)), Caster(ball, moved)], LIGHT.direction, LIGHT.width, LIGHT.height)
        assert both.texture.size[0] == both.read().values.shape[0] <= 3 * SIDE
        assert span(both.region) / both.texture.size[0] <= most * texel * 1.001
        assert both.heights.size[0] / both.texture.size[0] == pytest.approx(
            alone.heights.size[0] / alone.texture.size[0], rel=0.01
        )


def test_what_stays_as_it_is_is_not_marched_again(monkeypatch):
    """Of the same points: a figure that moves is marched anew, and what its neighbour leaves is remembered."""
    marched, march = [], lighting.visibility
    monkeypatch.setattr(lighting, "visibility", lambda grid, *rest: marched.append(grid) or march(grid, *rest))
    one, other = (distance_grid(banded(sphere((0.0, 0.0, 0.0), RADIUS))) for _ in range(2))
    points = np.random.default_rng(3).uniform((-0.5, -1.1, -0.5), (0.5, -0.1, 0.5), (200, 3))
    up, apart = np.tile([0.0, 1.0, 0.0], (200, 1)), np.eye(4)
    apart[0, 3] = 0.4

    def seen(place, of=points, light=LIGHT):
        marched.clear()
        return lighting.seen_light([(one, np.eye(4)), (other, place)], of, up, light, 0.003, "reference")

    first = seen(np.eye(4))
    assert marched == [one, other]
    assert np.array_equal(seen(np.eye(4)), first)
    assert marched == []
    moved = seen(apart)
    assert marched == [other]
    assert np.abs(moved - first).max() > 0.1
    seen(apart, points + 0.01)
    assert marched == [one, other]
    seen(apart, points, replace(LIGHT, softness=20.0))
    assert marched == [one, other]
    seen(apart, points + 0.01)
    assert marched == []
    for k in range(20):
        seen(np.eye(4), points + 0.1 * k)
    assert max(map(len, lighting._seen.values())) == 3, "two pictures and the floor"


def test_the_spheres_have_the_silhouette_of_what_they_stand_for(ball):
    """Cauchy: a ball's mean silhouette is a quarter of its surface."""
    spheres = Spheres.of(ball.surface)
    assert np.pi * (spheres.radius**2).sum() == pytest.approx(np.pi * RADIUS**2, rel=0.02)
    centres = spheres.centres(ball.vertices)
    assert np.abs(np.average(centres, 0, spheres.radius**2)).max() < 0.02
    person = Spheres.of(template_surface())
    assert 12 < len(person.radius) <= MOST
    assert Spheres.of(template_surface()) is person


def test_a_figure_is_darker_where_its_arm_is_before_the_light():
    """The chest behind an arm: by a light from the front it is darker than without a stage, and the cheek is not."""
    posed = pose_surface(
        template_surface(), load_person(), Signals.rest().replace(body_pose=named_pose("point_forward"))
    )
    view = Camera.orbit(0, 0, 2.6, target=(0, 0, 0), width=128, height=128)
    placed = Placed(posed, np.zeros((2, 8, 3)), view)
    plain = draw_surfaces([placed]).read()
    shine = SurfaceLight(Stage(shown=True, shadow=1.0, azimuth=0.0, elevation=60.0).light)
    shaded = draw_surfaces([replace(placed, key=shine(placed, np.eye(4)))]).read()
    inside = plain[..., 3] == 1
    ratio = (shaded[..., :3].sum(-1) / np.maximum(plain[..., :3].sum(-1), 1e-3))[inside]
    assert ratio.max() > 0.95, "in the light"
    assert 0.5 < ratio.min() < 0.82, "out of it"
    assert np.array_equal(shaded[..., 3], plain[..., 3])


def test_a_ball_s_own_lit_side_is_in_the_light(ball):
    """Up to 60° from the light: the map's texels are no steps there."""
    view = Camera.orbit(LIGHT.azimuth, LIGHT.elevation, 1.2, width=128, height=128)
    placed = Placed(ball, np.zeros((2, 8, 3)), view)
    shine = SurfaceLight(replace(LIGHT, height=-0.5))
    plain, shaded = (
        draw_surfaces([one]).read()[..., 1] for one in (placed, replace(placed, key=shine(placed, np.eye(4))))
    )
    normals = surface_geometry(ball, view).normal
    facing = (normals @ LIGHT.direction > 0.5) & (plain > 0)
    ratio = shaded[facing] / plain[facing]
    assert facing.sum() > 500
    assert ratio.min() > 0.97 * ratio.max()


def test_a_light_without_shadow_changes_no_byte():
    posed = pose_surface(template_surface(), load_person(), Signals.rest())
    view = Camera.orbit(30, 0, 2.6, target=(0, 0, 0), width=64, height=64)
    placed = Placed(posed, np.zeros((2, 8, 3)), view)
    shine = SurfaceLight(Stage(shown=True, shadow=0.0).light)
    lit = replace(placed, key=shine(placed, np.eye(4)))
    assert np.abs(draw_surfaces([lit]).read() - draw_surfaces([placed]).read()).max() <= 1 / 255


def test_the_shadow_is_drawn_anew_where_the_figure_moves(ball):
    shine, placed = SurfaceLight(LIGHT), Placed(ball, np.zeros((2, 8, 3)), Camera.orbit())
    shine(placed, np.eye(4))
    first = shine.shadow
    shine(placed, np.eye(4))
    assert shine.shadow is first
    moved = np.eye(4)
    moved[1, 3] = 0.2
    shine(placed, moved)
    assert shine.shadow is not first
    assert shine == SurfaceLight(LIGHT)
    assert shine != SurfaceLight(replace(LIGHT, azimuth=0.0))
