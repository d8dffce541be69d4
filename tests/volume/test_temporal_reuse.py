"""What hardly moves is reused: same numbers as making the frame anew from the reused state, and never far from the pose."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.template_distance import TemplateDistance
from avatarrex.frame import Frame
from avatarrex.levels import LEVELS, REUSE_TOLERANCE, level
from avatarrex.pipeline import render_frame
from avatarrex.shading.shade import shade
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.volume.body_grid import SLACK, build_body_grid
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import unsettled
from avatarrex.volume.small_components import without_small_components
from avatarrex.volume.temporal_reuse import PreviousGrid

FAST = replace(level("fast"), raycast="torch", part_voxel=0.01, reuse_tolerance=REUSE_TOLERANCE)
CAMERA = Camera.orbit(20, 5, 2.6, 40, (0, -0.05, 0), 48, 48)
STAND = named_pose("stand")
SHOULDER, HIP = 15, 0


def moved(joint: int, radians: float) -> Signals:
    pose = np.array(STAND)
    pose[joint, 2] += radians
    return Signals.rest().replace(body_pose=pose)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar()


@pytest.fixture(scope="module")
def dragged(avatar: Avatar) -> list[Frame]:
    """An arm that is lifted, the leg on the other side, and back."""
    frames: list[Frame] = []
    for signals in (*(moved(SHOULDER, 0.05 * k) for k in range(6)), moved(HIP, -0.1), moved(HIP, 0)):
        frames.append(render_frame(avatar, signals, CAMERA, FAST, frames[-1] if frames else None))
    return frames


def anew(avatar: Avatar, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """The grid made from the frame's reused state with nothing taken over."""
    volume = frame.volume
    grid = without_small_components(build_body_grid(volume.body, FAST.voxel, Counters()))
    assert np.array_equal(grid.origin, volume.grid.origin)
    assert grid.known is not None
    return grid.sdf.numpy(), grid.known


def test_the_grid_is_the_one_that_the_reused_state_gives(avatar: Avatar, dragged: list[Frame]) -> None:
    for frame in dragged[1:]:
        sdf, known = anew(avatar, frame)
        stored = frame.volume.grid.sdf.numpy()
        assert np.array_equal(stored < 0, sdf < 0)
        assert frame.volume.grid.known is not None
        corners = np.setdiff1d(unsettled(sdf < 0, np.zeros_like(known)), np.flatnonzero(~known))
        tied = Lattice(frame.volume.grid.origin, FAST.voxel, stored.shape).position(corners)[:, 0] == 0
        corners = corners[~tied]  # as near to a vertex on the left as on the right: either may be found
        assert len(corners) > 10_000
        assert frame.volume.grid.known.reshape(-1)[corners].all()
        np.testing.assert_allclose(stored.reshape(-1)[corners], sdf.reshape(-1)[corners], atol=2e-6)


def test_what_was_not_evaluated_bounds_the_distance_as_well_as_anew(avatar: Avatar, dragged: list[Frame]) -> None:
    for frame in dragged[1:]:
        grid, skin = frame.volume.grid, frame.volume.skin
        assert grid.known is not None
        excess = beyond(skin, grid.origin, grid.sdf.numpy(), grid.known)
        assert excess < max(beyond(skin, grid.origin, *anew(avatar, frame)), 0) + 1e-4


def beyond(skin: TemplateDistance, origin: np.ndarray, sdf: np.ndarray, known: np.ndarray) -> float:
    """Metres by which a stored guess exceeds the true one and its slack, at most."""
    guessed = np.flatnonzero(~known)
    here = skin.query(Lattice(origin, FAST.voxel, sdf.shape).position(guessed))
    excess = np.abs(sdf.reshape(-1)[guessed]) - np.maximum(np.abs(here.guess) + SLACK, FAST.voxel)
    return float(excess[here.weight < 1].max())


def test_colours_are_those_of_shading_every_pixel(avatar: Avatar, dragged: list[Frame]) -> None:
    for frame in dragged[1:]:
        counters = Counters()
        whole = shade(avatar, frame.surface, frame.shading.light, counters, None, FAST)
        reused = frame.volume.changed is not None
        assert (frame.counters["pixels_shaded"] < counters["pixels_shaded"]) == reused
        off = (whole.image - frame.image).abs().amax(-1)
        assert (off > 1 / 255).sum() <= 1, (
            "at most a point that lies as near to one triangle as to another: rounding decides"
        )
        assert off.max() < 4 / 255


def test_a_dragged_arm_costs_a_share_of_the_frame(dragged: list[Frame]) -> None:
    """In the mean of five steps. The first moves one arm; later ones bring along what had lagged behind."""
    first, steps = dragged[0].counters, dragged[1:6]
    assert all(frame.volume.changed is not None for frame in steps)
    for counter, most in (("voxels_evaluated", 0.75), ("pixels_shaded", 0.75), ("patches_decoded", 0.4)):
        shares = [frame.counters[counter] / first[counter] for frame in steps]
        assert shares[0] < 0.4
        assert sum(shares) / len(shares) < most


def test_the_lag_stays_below_the_tolerance(avatar: Avatar, dragged: list[Frame]) -> None:
    for frame in (dragged[5], dragged[-1]):
        exact = render_frame(avatar, frame.signals, CAMERA, FAST)
        lag = (exact.volume.body_frame.node_position - frame.volume.body_frame.node_position).norm(dim=-1)
        assert lag.max() <= FAST.reuse_tolerance
        assert (
            np.linalg.norm(exact.volume.skin.vertices - frame.volume.skin.vertices, axis=1).max()
            <= FAST.reuse_tolerance
        )
        both = exact.pointmap.hit & frame.pointmap.hit
        apart = (exact.pointmap.position - frame.pointmap.position).norm(dim=-1)[both]
        assert apart.mean() < 0.15 * FAST.reuse_tolerance, float(apart.mean())
        assert apart.quantile(0.98) < 2 * FAST.reuse_tolerance
        changed = (exact.volume.body_frame.code.embedding - frame.volume.body_frame.code.embedding).abs()
        assert avatar.embedding_effect * changed.max() <= FAST.reuse_tolerance
        assert (exact.image - frame.image)[both].abs().mean() < 2 / 255
        assert (exact.pointmap.hit != frame.pointmap.hit).sum() <= 4


def test_a_jump_keeps_nothing(avatar: Avatar, dragged: list[Frame]) -> None:
    signals = Signals.rest().replace(body_pose=named_pose("squat"))
    jump, exact = (render_frame(avatar, signals, CAMERA, FAST, before) for before in (dragged[-1], None))
    assert jump.volume.changed is None
    assert torch.equal(jump.image, exact.image)


def test_without_reuse_a_frame_is_exact_whatever_was_before(avatar: Avatar, dragged: list[Frame]) -> None:
    assert not any(settings.reuse_tolerance for settings in LEVELS.values())
    settings = replace(FAST, reuse_tolerance=0.0)
    signals = moved(SHOULDER, 0.02)
    after, exact = (render_frame(avatar, signals, CAMERA, settings, before) for before in (dragged[1], None))
    assert torch.equal(after.image, exact.image)


def test_what_lagged_is_made_exact_on_request(avatar: Avatar, dragged: list[Frame]) -> None:
    settings = replace(FAST, reuse_tolerance=0.0)
    caught_up = render_frame(avatar, dragged[3].signals, CAMERA, settings, dragged[3])
    assert caught_up.volume.changed is None
    assert torch.equal(caught_up.image, render_frame(avatar, dragged[3].signals, CAMERA, settings).image)
    again = render_frame(avatar, dragged[3].signals, CAMERA, FAST, caught_up)
    assert again.volume is caught_up.volume


def test_another_view_of_a_reused_body_is_shaded_whole(avatar: Avatar, dragged: list[Frame]) -> None:
    turned = Camera.orbit(60, 5, 2.6, 40, (0, -0.05, 0), 48, 48)
    frame = render_frame(avatar, dragged[3].signals, turned, FAST, dragged[3])
    assert frame.volume is dragged[3].volume
    whole = shade(avatar, frame.surface, frame.shading.light, Counters(), None, FAST)
    assert torch.equal(whole.image, frame.image)


def test_a_lattice_that_grew_takes_nothing_over(avatar: Avatar, dragged: list[Frame]) -> None:
    frame = dragged[2]
    assert frame.volume.changed is not None
    other = replace(frame.volume.grid, voxel=0.0201, sdf=-frame.volume.grid.sdf)
    coarser = PreviousGrid(other, frame.volume.changed)
    arguments = frame.volume.body, FAST.voxel
    assert torch.equal(
        build_body_grid(*arguments, Counters(), kept=coarser).sdf, build_body_grid(*arguments, Counters()).sdf
    )


def test_every_voxel_is_evaluated_where_that_is_set_after_a_reused_grid(avatar: Avatar, dragged: list[Frame]) -> None:
    """The body has not moved, and its grid would do for a drag; but now all of it is wanted."""
    settings = replace(FAST, everywhere=True)
    whole = render_frame(avatar, dragged[3].signals, CAMERA, settings, dragged[3])
    alone = render_frame(avatar, dragged[3].signals, CAMERA, settings)
    assert torch.equal(whole.volume.grid.sdf, alone.volume.grid.sdf)
    assert whole.counters["voxels_evaluated"] > 0
