"""The rig: what formats pose, against the whole surface; light and texture in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from export_surface import seamed_surface

from avatarrex.distil.texels import texels
from avatarrex.export.rig import rig_of
from avatarrex.export.texture import baked_texture, light_on, spread, vertex_colours
from avatarrex.fields.light import Irradiance, Light
from avatarrex.signals.driving import Signals


def test_without_corrections_the_rig_is_the_surface(source, moving):
    source = replace(source, surface=seamed_surface(0.0))
    rig = rig_of(source.surface, source.person, np.ones_like(source.surface.vertices))
    for signals in (moving.sequence[0], moving.sequence[-1]):
        whole = source.world(source.posed(signals), signals)
        # single precision, and morphs below 1e-5 m left out
        assert np.abs(rig.moved(signals) - whole).max() < 3e-5


def test_it_stands_on_the_floor_and_faces_z(rig):
    assert abs(rig.vertices[:, 1].min()) < 1e-7
    assert np.allclose(rig.moved(Signals.rest()), rig.vertices, atol=1e-6)
    nose = rig.vertices[rig.vertices[:, 1] > 1.5].max(0)
    assert nose[2] > 0.08
    left = rig.places[16]  # the left shoulder
    assert left[0] > 0.1


def test_four_joints_keep_the_strongest_and_sum_to_one(rig):
    four = rig.limited(4)
    assert four.joint.shape[1] == 4
    assert np.abs(four.weight.sum(1, dtype=np.float64) - 1).max() < 1e-6
    assert (np.diff(four.weight, axis=1) <= 1e-6).all()
    strong = rig.weight[:, 4:].sum(1) == 0
    assert np.abs(four.weight[strong] - rig.weight[strong, :4]).max() < 1e-6


def test_unused_weights_have_joint_0(rig):
    assert (rig.joint[rig.weight == 0] == 0).all()


def test_values_reach_every_texel(source):
    surface = source.surface
    ones = np.ones((len(surface.vertices), 2))
    picture = spread(texels(surface.uv, surface.uv_faces, 32, 48), surface, ones)
    assert picture.shape == (32, 48, 2)
    assert np.abs(picture - 1).max() < 1e-6


def test_light_is_baked_where_it_follows_the_normal(source):
    surface, v = source.surface, len(source.surface.vertices)
    harmonics = torch.zeros(8, 3)
    harmonics[1] = -0.5  # E(up) = 0.5
    light = Irradiance(harmonics)
    up = torch.tensor([[0.0, 1.0, 0.0]]).expand(v, 3)
    all_lit, none_lit = (replace(surface, lit=np.full(v, share, np.float32)) for share in (1, 0))
    dark = baked_texture(all_lit, light_on(all_lit, up, light))
    assert np.abs(dark - 0.5 * surface.albedo).max() <= 0.5
    assert np.array_equal(baked_texture(none_lit, light_on(none_lit, up, light)), surface.albedo)
    faces = light_on(none_lit, up, Irradiance(torch.zeros(8, 3), harmonics))
    assert np.allclose(faces, 0.5), "the face's own light"
    tint = np.full((v, 3), 0.1, np.float32)
    tinted = baked_texture(surface, light_on(surface, up, Irradiance(torch.zeros(8, 3))), tint)
    assert np.abs(tinted - np.minimum(surface.albedo + 25.5, 255)).max() <= 0.51


def test_the_light_of_several_poses_is_their_mean(source, moving):
    first, last = moving.sequence[0], moving.sequence[-1]
    one, other = (source.factor(source.posed(signals), signals) for signals in (first, last))
    assert np.allclose(source.mean_factor([first, last]), (one + other) / 2, atol=1e-6)
    assert np.abs(one - other).max() > 0.1


def test_who_turns_is_lit_from_where_the_lamps_are(source):
    """A light of the world; one that turns along says the same of both poses."""
    light = Light("world")
    light.load_state_dict(source.light.state_dict())
    world, rest = replace(source, light=light), Signals.rest()
    about = rest.replace(global_orient=np.array([0.0, np.pi / 2, 0.0]))
    posed = source.posed(rest)
    turned = posed.normals @ posed.world_from_root(about)[:3, :3].T.astype(np.float32)
    wanted = light_on(source.surface, torch.from_numpy(turned), source.light.over(np.eye(4)))
    assert np.allclose(world.factor(posed, about), wanted, atol=1e-5)
    assert np.abs(wanted - source.factor(posed, about)).max() > 0.1
    assert np.array_equal(source.factor(posed, about), source.factor(posed, rest))


def test_vertex_colours_are_the_texture_s(source):
    """Under the same light everywhere; the stand-in's atlas has front and back on top of each other."""
    surface, v = source.surface, len(source.surface.vertices)
    surface = replace(surface, lit=np.ones(v, np.float32))
    normals = torch.tensor([[0.6, 0.8, 0.0]]).expand(v, 3)
    factor = light_on(surface, normals, source.light.over(np.eye(4)))
    texture = baked_texture(surface, factor)
    colours = vertex_colours(surface, factor, np.zeros((v, 3), np.float32))
    last = np.zeros(v, int)
    last[surface.uv_vertex] = np.arange(len(surface.uv))
    x, y = np.clip((surface.uv[last] * [128, 128]).astype(int), 0, 127).T
    assert np.abs(255 * colours - texture[y, x]).max() <= 0.51
