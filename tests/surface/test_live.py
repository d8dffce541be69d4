"""Level `live`: a frame like the others, what it does again, and how it is refused."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from surface.template_surface import template_surface

from avatarrex import live
from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.frame import DeferredFrame
from avatarrex.levels import DEFERRED_LEVELS, LEVELS, level
from avatarrex.live import LiveFrame
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.templates.person import load_person

CAMERA = Camera.orbit(20, 5, 2.6, target=(0, -0.1, 0), width=96, height=128)
WAVE = Signals.rest().replace(body_pose=named_pose("wave"))
WORK = ("surface_vertices", "surface_triangles", "bytes_uploaded")


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    made = Avatar.create(load_person(), "compact")
    made.surface = template_surface(0.001)
    with torch.no_grad():
        made.light.harmonics[1] = 0.3
    return made


def draw(avatar: Avatar, signals: Signals = WAVE, camera: Camera = CAMERA, **options) -> LiveFrame:
    frame = render_frame(avatar, signals, camera, level("live"), **options)
    assert isinstance(frame, LiveFrame)
    return frame


def test_it_is_a_frame(avatar):
    frame = draw(avatar)
    assert frame.image.shape == (128, 96, 4)
    assert set(frame.ms) == {"surface", "raster", "total"}
    assert frame.counters["surface_vertices"] == len(avatar.surface.vertices)
    assert frame.counters["voxels_evaluated"] == frame.counters["bytes_read_back"] == 0
    assert "triangles" in frame.notes[0]
    points, alpha = frame.pointmap, frame.image[..., 3]
    assert torch.equal(points.coverage, alpha)
    assert points.hit.float().mean().item() == pytest.approx(alpha.mean().item(), rel=0.02)
    seen = points.hit | (points.depth > 0)
    assert (seen & (alpha > 0)).sum() > 0.98 * (alpha > 0).sum(), "edges take a neighbour's point"
    row = frame.view.camera_from_world[2]
    depth = points.position[points.hit].double() @ torch.as_tensor(row[:3]) + row[3]
    assert (depth - points.depth[points.hit]).abs().max() < 1e-5


def test_light_is_in_it(avatar):
    dark = replace(avatar, light=type(avatar.light)())
    body = draw(avatar).pointmap.hit & (draw(avatar).pointmap.normal[..., 1] > 0.5)
    assert body.any()
    assert draw(avatar).image[body].sum() > 1.05 * draw(dark).image[body].sum()


def test_a_light_of_the_world_stays_where_it_is(avatar):
    """Who turns with the camera is seen the same, in another light."""
    world = replace(avatar, light=type(avatar.light)("world"))
    with torch.no_grad():
        world.light.harmonics[2] = 0.5  # from the front
    about = WAVE.replace(global_orient=np.array([0, np.pi / 2, 0]))
    aside = Camera.orbit(110, 5, 2.6, target=(0, -0.1, 0), width=96, height=128)
    front, side = draw(world), draw(world, about, aside, previous=draw(world))
    facing = front.pointmap.hit & (front.pointmap.normal[..., 2] > 0.9)
    assert front.image[facing].mean() > 1.2 * side.image[facing].mean()
    world.light.frame = "root"
    assert (draw(world, about, aside).image - draw(world).image).abs().max() < 0.03


def work(frame: LiveFrame) -> dict[str, int]:
    return {name: frame.counters[name] for name in WORK if frame.counters[name]}


def test_what_is_done_again(avatar):
    first, v, f = draw(avatar), len(avatar.surface.vertices), len(avatar.surface.faces)
    same = draw(avatar, previous=first)
    assert work(same) == {}
    assert same.picture is first.picture
    turned = draw(avatar, camera=Camera.orbit(50, width=96, height=128), previous=first)
    assert work(turned) == {"surface_triangles": f}
    moved = WAVE.replace(translation=np.array([0.1, 0, 0]), global_orient=np.array([0, 0.4, 0]))
    assert work(draw(avatar, moved, previous=first)) == {"surface_triangles": f}
    smile = WAVE.replace(expression=np.eye(52)[17])
    smiling = draw(avatar, smile, previous=first)
    morphed = len(avatar.surface.morph_vertex)
    assert work(smiling) == {
        "surface_triangles": f,
        "bytes_uploaded": 12 * v + 36 * len(avatar.surface.uv),
        "surface_vertices": morphed,
    }
    assert torch.equal(smiling.image, draw(avatar, smile).image)
    bent = draw(avatar, Signals.rest(), previous=smiling)
    assert 0.5 * v < bent.counters["surface_vertices"] < v, "the legs of the wave stand as at rest"
    assert torch.equal(bent.image, draw(avatar, Signals.rest()).image)


def test_another_light_or_other_parts_are_another_picture(avatar):
    first = draw(avatar)
    with torch.no_grad():
        avatar.light.harmonics[0] += 0.1
    assert draw(avatar, previous=first).picture is not first.picture
    hidden = replace(level("live"), hidden=frozenset({"left_hand"}))
    without = render_frame(avatar, WAVE, CAMERA, hidden, draw(avatar))
    assert without.counters["surface_triangles"] < len(avatar.surface.faces)


def test_a_root_far_away_gives_the_same_picture(avatar):
    far = np.array([1000.0, 0, -1000])
    there = Camera.orbit(20, 5, 2.6, target=far + np.array([0, -0.1, 0]), width=96, height=128)
    assert (draw(avatar, WAVE.replace(translation=far), there).image - draw(avatar).image).abs().max() < 0.02


def test_levels_may_follow_one_another(avatar):
    first = draw(avatar)
    exact = render_frame(avatar, WAVE, CAMERA.resized(24, 32), replace(level("fast"), raycast="torch"), first)
    assert isinstance(exact, DeferredFrame)
    assert work(draw(avatar, previous=exact)) == work(first)


def test_live_is_the_level_that_is_not_of_the_deferred_pipeline():
    assert set(LEVELS) - set(DEFERRED_LEVELS) == {"live"}
    assert [name for name, settings in LEVELS.items() if settings.surface] == ["live"]


def test_an_avatar_without_a_surface_is_refused_in_one_line(avatar):
    with pytest.raises(InputError, match=r"^level live: .*`avatarrex-studio distil AVATAR`.*$"):
        render_frame(replace(avatar, surface=None), WAVE, CAMERA, level("live"))


def test_without_opengl_it_is_refused_in_one_line(avatar, monkeypatch):
    monkeypatch.setenv("AVATARREX_GL", "off")
    with pytest.raises(InputError, match=r"^level live: expected OpenGL 4\.3, found .*AVATARREX_GL=off$"):
        draw(avatar)


def test_a_neighbour_s_point_is_its_own_before_another_s():
    hit, covered = np.zeros((2, 3), bool), np.ones((2, 3), bool)
    hit[0, 0] = hit[0, 1] = True
    assert live._nearest_hit(hit, covered).tolist() == [[0, 1, 1], [0, 1, 1]]
    assert live._nearest_hit(hit, hit).tolist() == [[0, 1, -1], [-1, -1, -1]]
