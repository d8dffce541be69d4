"""Evaluating only where the surface is: the same crossings as evaluating everything."""

import numpy as np
import pytest
import torch
from scipy.ndimage import label

from avatarrex.avatar_file import load_avatar
from avatarrex.counters import Counters
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.fields.composition import in_band
from avatarrex.fields.template_distance import AIR, TemplateDistance
from avatarrex.ops.halving import between
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_hand, named_pose
from avatarrex.templates.model import skinned_normals
from avatarrex.templates.posed import pose_person
from avatarrex.volume import narrow_band
from avatarrex.volume.body_grid import build_body_grid
from avatarrex.volume.build import body_frame
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import halved, settle, unsettled
from avatarrex.volume.part_box import build_part_box

LATTICE = Lattice(np.array([-0.5, -0.4, -0.45]), 0.05, (19, 17, 21))


def ball(position: np.ndarray) -> np.ndarray:
    return (np.linalg.norm(position, axis=-1) - 0.3).astype(np.float32)


def everywhere(lattice: Lattice) -> np.ndarray:
    return ball(lattice.position(np.arange(np.prod(lattice.shape)))).reshape(lattice.shape)


def crossed(inside: np.ndarray) -> np.ndarray:
    """Flat indices of all corners of cells in which the sign changes."""
    return unsettled(inside, np.zeros(inside.shape, dtype=bool))


def test_corners_of_crossed_cells_are_listed() -> None:
    inside = np.zeros((4, 4, 4), dtype=bool)
    inside[1, 1, 1] = True
    assert len(crossed(inside)) == 27
    assert len(unsettled(inside, inside)) == 26
    assert len(unsettled(~np.zeros_like(inside), inside)) == 0


@pytest.mark.parametrize("error", [0.0, 0.04, 0.12])
def test_a_wrong_guess_is_followed_to_the_surface(error: float) -> None:
    true, queried = everywhere(LATTICE), []

    def evaluate(index: np.ndarray) -> np.ndarray:
        queried.append(index)
        return true.reshape(-1)[index]

    guess = true + np.float32(error) * np.sin(40 * true)
    first = np.flatnonzero(np.abs(guess) < 0.02)
    sdf = settle(guess, first, evaluate)[0]
    corners = crossed(true < 0)
    assert np.array_equal(sdf < 0, true < 0)
    assert np.array_equal(sdf.reshape(-1)[corners], true.reshape(-1)[corners])
    listed = np.concatenate(queried)
    assert len(np.unique(listed)) == len(listed) < true.size


def test_known_voxels_are_not_queried() -> None:
    true = everywhere(LATTICE)
    known = np.zeros(true.shape, dtype=bool)
    known[:10] = True

    def evaluate(index: np.ndarray) -> np.ndarray:
        assert not known.reshape(-1)[index].any()
        return true.reshape(-1)[index]

    assert np.array_equal(settle(true, np.zeros(0, dtype=int), evaluate, known)[0], true)


def test_no_crossing_is_followed_along_voxels_that_are_unused() -> None:
    """Their values may have another sign than those beside them; what crosses on the other side of these is followed."""
    true = everywhere(LATTICE)
    unused = np.zeros(true.shape, dtype=bool)
    unused[:9] = True
    guess, queried = np.where(unused, np.float32(1), true), []

    def evaluate(index: np.ndarray) -> np.ndarray:
        assert not unused.reshape(-1)[index].any()
        queried.append(index)
        return true.reshape(-1)[index]

    sdf, known = settle(guess, np.zeros(0, dtype=int), evaluate, unused=unused)
    assert (sdf[:9] == 1).all()
    assert known[:9].all()
    corners = unsettled(true < 0, np.zeros_like(unused), unused)
    assert np.array_equal(np.sort(np.concatenate(queried)), np.setdiff1d(corners, np.flatnonzero(unused)))
    middle = np.ravel_multi_index((9, 8, 10), true.shape)
    assert true.reshape(-1)[middle] < 0
    assert middle not in corners


def test_the_halved_lattice_keeps_every_voxel_and_interpolates_between() -> None:
    fine = halved(LATTICE)
    index = np.arange(np.prod(fine.shape)).reshape(fine.shape)
    kept = index[::2, ::2, ::2].ravel()
    np.testing.assert_allclose(fine.position(kept), LATTICE.position(np.arange(np.prod(LATTICE.shape))), atol=1e-12)
    linear = LATTICE.position(np.arange(np.prod(LATTICE.shape))).reshape(*LATTICE.shape, 3)
    np.testing.assert_allclose(between(linear).reshape(-1, 3), fine.position(index.ravel()), atol=1e-12)


@pytest.mark.parametrize("pose", ["flat", "fist"])
def test_the_hand_box_has_the_signs_and_near_values_of_the_exact_distance(pose: str) -> None:
    avatar, counters = load_avatar(), Counters()
    vertices = pose_person(
        avatar.person, Signals.rest().replace(left_hand_pose=named_hand(pose, "left")), Counters(), None
    ).parts["left_hand"]
    hand = avatar.parts["left_hand"]
    state = hand.prepare(vertices, torch.zeros(15, 3), counters)
    box = build_part_box(hand, state, vertices, 0.005, counters)
    shape = box.field.shape
    index = np.arange(shape[0] * shape[1] * shape[2])
    lattice = Lattice(box.origin, box.voxel, (shape[0], shape[1], shape[2]))
    exact = avatar.left_hand.sdf(vertices, torch.as_tensor(lattice.position(index), dtype=torch.float32)).sdf.numpy()
    stored = box.field[..., 0].numpy().ravel()
    assert np.array_equal(stored < 0, exact < 0)
    corners = crossed((exact < 0).reshape(shape[:3]))
    np.testing.assert_allclose(stored[corners], exact[corners], atol=1e-5)  # half precision
    assert np.abs(stored - exact).max() < 0.01
    assert not in_band(box.field[..., 0].float().max())  # half of 0.025 itself would be
    assert counters.as_dict()["hand_distances"] < 0.6 * len(index)


def reachable(outside: np.ndarray) -> np.ndarray:
    """The part of `outside` (z, y, x) that hangs together with the grid's first corner, over corners of cells, too."""
    pieces, _ = label(outside, np.ones((3, 3, 3)))
    return pieces == pieces[0, 0, 0]


@pytest.mark.parametrize("pose", ["stand", "squat"])
def test_the_body_grid_crosses_where_the_whole_shell_does(pose: str) -> None:
    avatar, counters = load_avatar(), Counters()
    posed = pose_person(avatar.person, Signals.rest().replace(body_pose=named_pose(pose)), Counters(), None)
    frame = body_frame(avatar, posed)
    normals = skinned_normals(avatar.person.body, posed.body)
    arrays = (posed.body.vertices, normals, avatar.person.hand_weight, avatar.body.clothing_offset)
    skin = TemplateDistance.of(*(value.double().numpy() for value in arrays), closed=True)
    grid = build_body_grid(BodyWithoutHands(avatar.body, frame, skin, avatar.ownership), 0.02, counters)
    shape = (grid.sdf.shape[0], grid.sdf.shape[1], grid.sdf.shape[2])
    position = Lattice(grid.origin, grid.voxel, shape).position(np.arange(grid.sdf.numel()))
    here = skin.query(position)
    shell = np.flatnonzero((here.distance < 0.06) & (here.weight == 0))
    with torch.no_grad():
        all_of_it = avatar.body.sdf(frame, torch.as_tensor(position[shell], dtype=torch.float32)).numpy()
    bounds = here.guess[shell] - here.deviation[shell], here.guess[shell] + AIR * here.deviation[shell]
    all_of_it = np.clip(all_of_it, *bounds)
    stored = grid.sdf.numpy().ravel()
    truth = stored.copy()
    truth[shell] = all_of_it
    # Voids that the body encloses are not looked for; what a ray from without can reach is the same to the voxel.
    assert not ((truth < 0) & (stored >= 0)).any()
    assert np.array_equal(reachable(grid.sdf.numpy() >= 0), reachable(truth.reshape(shape) >= 0))
    corners = np.intersect1d(crossed(grid.sdf.numpy() < 0), shell, return_indices=True)[2]
    assert np.abs(all_of_it - stored[shell])[corners].max() < 1e-4
    assert counters.as_dict()["voxels_evaluated"] < 0.8 * len(shell)


def test_crossed_cells_have_corners_on_both_sides() -> None:
    inside = np.zeros((4, 3, 3), dtype=bool)
    inside[:2], inside[3, 0, 0] = True, True
    assert narrow_band.crossed(inside).tolist() == [*([1, y, x] for y in (0, 1) for x in (0, 1)), [2, 0, 0]]
