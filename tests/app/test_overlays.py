"""Views of what is inside: a slice of the exact field, and what carries each place of the skin."""

from __future__ import annotations

import gc
from dataclasses import replace
from types import SimpleNamespace
from weakref import ref

import numpy as np
import pytest
import torch
from avatarrex_studio.engine import live as live_module
from avatarrex_studio.engine.field_slice import (
    DIMMED,
    OUTSIDE,
    REACH,
    STRONG,
    UNTOLD,
    evaluated,
    nearest,
    over,
    plane,
    shade,
)
from avatarrex_studio.engine.influences import NONE, WHOLE, heat, of_points, of_surface
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.engine.request import Request
from avatarrex_studio.engine.worker import answered
from avatarrex_studio.panels import cut_card, units
from avatarrex_studio.panels.cut_card import freshness
from avatarrex_studio.session.commands import (
    AddFigure,
    MoveCut,
    OrbitBy,
    RemoveFigure,
    Select,
    SetExpression,
    SetJoint,
    SetLevel,
    SetTranslation,
    ShowPicture,
)
from avatarrex_studio.session.cut import AXES, Cut
from avatarrex_studio.session.state import StudioState, Tools
from ball import BallFrame, ball_engine
from ball_studio import FakeLive, ball_studio
from imgui_bundle import imgui
from surface.template_surface import template_surface

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.figure import Figure
from avatarrex.templates.person import load_person
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume

RADIUS, VOXEL, COUNT = 0.2, 0.02, 40
MIDDLE = VOXEL * (COUNT - 1) / 2


def sphere(world=(0.0, 0.0, 0.0), known=None):
    """A frame whose volume is a sphere about the origin of its root frame, which stands at `world`."""
    z, y, x = (VOXEL * np.mgrid[0:COUNT, 0:COUNT, 0:COUNT]) - MIDDLE
    sdf = torch.from_numpy(np.sqrt(x**2 + y**2 + z**2) - RADIUS)
    grid = BodyGrid(np.full(3, -MIDDLE), VOXEL, sdf, known=known)
    root = np.eye(4)
    root[:3, 3] = world
    camera = Camera.orbit(width=64, height=48, distance=2.0)
    return BallFrame(camera=camera, world_from_root=root, volume=SimpleNamespace(sdf=SdfVolume(grid)))


def test_the_plane_is_where_the_rays_meet_it():
    camera = Camera.orbit(30.0, 20.0, 2.0, width=32, height=24)
    for axis in AXES:
        cut = Cut(axis, 0.3 if axis == "z" else 0.1)
        points, depth = plane(camera, cut)
        met = np.isfinite(depth)
        assert met.any()
        assert points[met][:, cut.row] == pytest.approx(cut.offset)
        assert camera.seen(points[met])[:, 2] == pytest.approx(depth[met])
        pixel = np.stack(np.meshgrid(np.arange(32) + 0.5, np.arange(24) + 0.5), -1).reshape(-1, 2)[met]
        assert camera.pixels(points[met])[0] == pytest.approx(pixel)
    behind = plane(camera, Cut("z", 5.0))[1]
    assert not np.isfinite(behind).any(), "the camera looks away from it"


def test_distances_are_those_of_the_volume_where_voxels_were_evaluated():
    known = np.zeros((COUNT,) * 3, bool)
    known[:, :, : COUNT // 2] = True  # x < 0
    points = np.array([[-0.1, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.1, 0.0, 0.0], [-2.0, 0.0, 0.0]])
    found = nearest([sphere(known=known)], points)
    assert found[:2] == pytest.approx([-0.1, 0.1], abs=0.003)
    assert found[2:].tolist() == [-np.inf, np.inf], "inside, where a bound is stored; and outside the grid"
    assert evaluated(sphere().volume.sdf, torch.from_numpy(points)).tolist() == [True, True, True, False]
    two = [sphere(), sphere((0.3, 0.0, 0.0))]
    assert nearest(two, np.array([[0.3, 0.0, 0.0]]))[0] == pytest.approx(-RADIUS, abs=0.02), "the nearer one"


def test_colours_tell_side_distance_and_each_centimetre():
    pixel = np.full(6, 0.0005)
    colour, alpha = shade(np.array([-0.105, 0.0, 0.015, 0.02, 0.2, -np.inf]), pixel)
    assert colour[0][0] > colour[0][2]
    assert colour[2][2] > colour[2][0]
    assert colour[1] == pytest.approx(1.0)
    assert colour[3].sum() < 0.6 * colour[2].sum(), "a line at 2 cm, none at 1.5 cm"
    assert alpha == pytest.approx(
        [STRONG, STRONG, STRONG * (1 - 0.015 / REACH), STRONG * (1 - 0.02 / REACH), 0.0, STRONG]
    )
    assert colour[5] == pytest.approx(UNTOLD)
    far = shade(np.array([0.02]), np.array([0.004]))[0]
    assert far[0] == pytest.approx(OUTSIDE * (1 - 0.35 * 0.02 / REACH)), "from far each 5 cm"


def test_the_plane_lies_over_the_dimmed_picture():
    frame, picture = sphere(), np.ones((48, 64, 4), np.float32)
    made = over([frame], picture, Cut())
    assert made[0, 0] == pytest.approx([DIMMED, DIMMED, DIMMED, 1.0])
    assert made[24, 32, 0] > made[24, 32, 2], "inside"
    radius = RADIUS / 2.0 * frame.camera.intrinsics[0, 0]
    row = made[24, :, 0] - made[24, :, 2]
    orange = np.flatnonzero(row > 0.1)
    assert np.ptp(orange) == pytest.approx(2 * (radius - 1.8), abs=1.5), "but for the white line about it"


def test_a_slice_is_requested_at_live_and_follows_the_plane(clock):
    """And says how fresh it is."""
    studio = ball_studio(clock, live=FakeLive())

    def rest():
        for _ in range(4):
            clock.now += 1.0
            studio.tick((32, 24))

    studio.do(SetLevel("live"))
    rest()
    assert not studio.pictures.exact.begun
    studio.do(ShowPicture("slice"))
    assert "comes with the next" in freshness(studio)
    rest()
    assert [request.state.level for request in studio.pictures.exact.begun] == ["fast"]
    assert studio.weight == 1
    assert "Distance to the skin (level fast): blue outside, orange inside" in freshness(studio)
    studio.do(MoveCut("x", 0.1))
    studio.tick((32, 24))
    assert "comes with the next" in freshness(studio)
    rest()
    assert studio.pictures.exact.begun[-1].state.tools.cut == Cut("x", 0.1)
    studio.do(OrbitBy(5.0, 0.0))
    studio.tick((32, 24))
    assert studio.weight == 0


def test_a_slice_across_another_axis_goes_through_the_selected_figure(clock, monkeypatch):
    """Wherever it stands; the slider reaches as far to either side of its pelvis."""
    studio, reach = ball_studio(clock, live=FakeLive()), []
    for command in (ShowPicture("slice"), AddFigure("default")):
        studio.do(command)
    studio.do(SetTranslation((3.0, 0.5, -2.0)))
    body = studio.figure.vertices @ studio.world[:3, :3].T + studio.world[:3, 3]
    monkeypatch.setattr(imgui, "radio_button", lambda title, on: "##y" in title or "##x" in title)
    monkeypatch.setattr(imgui, "slider_float", lambda *of: reach.append(of[2:4]) or (False, 0.0))
    context = imgui.create_context()
    imgui.get_io().display_size = imgui.ImVec2(400, 300)
    imgui.get_io().set_ini_filename("")
    imgui.get_io().backend_flags |= imgui.BackendFlags_.renderer_has_textures
    imgui.new_frame()
    commands = list(cut_card.draw(studio, (0, 0), (400, 300)))
    imgui.end_frame()
    imgui.destroy_context(context)
    for command in commands:
        row = "xyz".index(command.axis)
        assert command.offset == pytest.approx(body[:, row].mean(), abs=0.4)
    assert {command.axis for command in commands} == {"x", "y"}
    assert np.mean(reach[0]) / units.length().factor == pytest.approx(body[:, 2].mean(), abs=0.2)
    assert np.ptp(reach[0]) / units.length().factor == pytest.approx(2 * cut_card.REACH)


def test_an_avatar_is_looked_for_by_influences_alone():
    wanted, engine = [], ball_engine()
    real = engine.avatar
    engine.avatar = lambda name: wanted.append(name) or real(name)
    for shows in ("normals", "slice", "influence"):
        wanted.clear()
        engine.render(ShowPicture(shows).apply(StudioState()), (32, 24))
        made = len(wanted)
        answered(engine, Request(ShowPicture(shows).apply(StudioState()), (32, 24)))
        assert len(wanted) - 2 * made == (shows == "influence")


def test_the_plane_is_kept_and_one_that_was_never_moved_is_not_written():
    assert "cut" not in Tools().to_json()
    state = StudioState(tools=Tools(shows="slice", cut=Cut("y", -0.25)))
    assert StudioState.from_json(state.to_json()) == state


@pytest.fixture(scope="module")
def avatar():
    made = Avatar.create(load_person(), "compact")
    made.surface = template_surface()
    return made


def test_a_joint_s_influence_is_its_weight(avatar):
    joint, surface = JOINT_NAMES.index("left_elbow"), avatar.surface
    colours = of_surface(avatar, surface, "left_elbow")
    share = np.linalg.norm(colours - NONE, axis=1) / np.linalg.norm(WHOLE - NONE)
    dense = np.zeros((len(surface.vertices), len(JOINT_NAMES)))
    np.put_along_axis(dense, surface.joint.astype(int), surface.weight, 1)
    assert share == pytest.approx(dense[:, joint], abs=1e-6)
    assert share.max() > 0.9
    body, signals = avatar.person.body, Signals.rest().replace(translation=np.array([0.3, 0.0, 0.1]))
    points = Figure(body, signals).vertices.astype(float)[::97]
    assert of_points(avatar, signals, points, "left_elbow") == pytest.approx(heat(body.weights[::97, joint].numpy()))


def test_without_a_joint_each_place_has_the_colour_of_its_nearest_node(avatar):
    rest = avatar.surface.vertices
    nodes = avatar.body.node_rest.numpy()
    nearest_node = np.linalg.norm(rest[:, None] - nodes[None], axis=2).argmin(1)
    for selected in (None, "mouth"):
        colours = of_surface(avatar, avatar.surface, selected)
        of_node = {}
        for node, colour in zip(nearest_node, colours):
            assert of_node.setdefault(node, tuple(colour)) == tuple(colour)
        assert len(set(of_node.values())) > 0.9 * len(of_node)


def test_the_surface_shows_influences_until_something_else_is_chosen(avatar):
    live, state = LiveSurface(), StudioState()
    plain = live.draw([avatar], state, (48, 48)).read()
    shown = ShowPicture("influence").apply(state)
    first = live.draw([avatar], shown, (48, 48))
    assert live.draw([avatar], shown, (48, 48)) is first, "nothing changed"
    arm = live.draw([avatar], Select("left_elbow").apply(shown), (48, 48)).read()
    assert len(np.unique(first.read().reshape(-1, 4), axis=0)) > 100
    assert np.abs(arm - first.read()).max() > 0.2
    again = replace(state, tools=Tools())
    assert np.array_equal(live.draw([avatar], again, (48, 48)).read(), plain)


def test_influences_are_found_once_for_all_poses_and_let_go_with_their_figure(avatar, monkeypatch):
    found = []
    monkeypatch.setattr(live_module, "of_surface", lambda *of: found.append(of[2]) or of_surface(*of))
    live, other = LiveSurface(), replace(avatar, surface=replace(avatar.surface))
    state = ShowPicture("influence").apply(AddFigure("default").apply(StudioState()))
    live.draw([avatar, other], state, (48, 48))
    live.draw([avatar, other], SetExpression("jawOpen", 0.7).apply(state), (48, 48))
    bent = SetJoint("left_elbow", (0.0, -0.6, 0.0)).apply(state)
    moved = live.draw([avatar, other], bent, (48, 48)).read()
    assert found == [None, None]
    assert np.array_equal(moved, LiveSurface().draw([avatar, other], bent, (48, 48)).read())
    live.draw([avatar, other], Select("left_elbow").apply(bent), (48, 48))
    assert found[4:] == ["left_elbow"] * 2
    gone, other = ref(other.surface), None
    found.clear()
    live.draw([avatar], RemoveFigure(1).apply(bent), (48, 48))
    gc.collect()
    assert gone() is None
