"""The surface in the window: what is drawn is the level `live`, in whatever OpenGL context is in use."""

from __future__ import annotations

import numpy as np
import pytest
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.session.commands import OrbitBy, SetHidden, SetTranslation
from avatarrex_studio.session.state import StudioState
from surface.template_surface import template_surface

from avatarrex.avatar import Avatar
from avatarrex.levels import level
from avatarrex.pipeline import render_frame
from avatarrex.surface.raster import surface_geometry
from avatarrex.templates.person import load_person

SIZE = (48, 64)


def test_the_picture_is_that_of_the_level_live():
    avatar = Avatar.create(load_person("default"), "compact")
    live, state = LiveSurface(), OrbitBy(30.0, 10.0).apply(StudioState())
    assert live.draw([avatar], state, SIZE) is None
    avatar.surface = template_surface()
    picture = live.draw([avatar], state, SIZE)
    assert picture.texture.size == SIZE
    frame = render_frame(avatar, state.signals, state.view.camera(*SIZE), level("live"))
    assert np.array_equal(picture.read(), frame.image.numpy())
    assert set(live.ms) == {"surface", "raster", "total"}
    assert live.draw([avatar], state, SIZE) is picture, "nothing changed"
    hidden = live.draw([avatar], SetHidden("left_hand", True).apply(state), SIZE)
    assert not np.array_equal(hidden.read(), frame.image.numpy())


def test_the_point_under_a_pixel_is_that_of_the_whole_picture():
    avatar = Avatar.create(load_person("default"), "compact")
    avatar.surface = template_surface()
    live, state = LiveSurface(), OrbitBy(30.0, 10.0).apply(StudioState())
    state = SetTranslation((0.2, 0.0, 0.1)).apply(state)
    assert live.point(3, 4) is None
    live.draw([avatar], state, SIZE)
    frame = render_frame(avatar, state.signals, state.view.camera(*SIZE), level("live"))
    seen = surface_geometry(frame.posed, frame.view)
    world = frame.world_from_root
    for row, column in np.argwhere(seen.hit)[::97].tolist():
        expected = world[:3, :3] @ seen.position[row, column] + world[:3, 3]
        found = live.point(column, row)
        assert found.figure == 0
        assert found.point == pytest.approx(tuple(expected), abs=1e-4)
    assert live.point(0, 0) is None
