"""Hits that stay while a box changes: what is joined is what casting all gives, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.pointmap.kept_hits import IMAGES, KeptHits
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast import available, raycast
from avatarrex.pointmap.rays import box_window
from avatarrex.volume.sdf_volume import BodyGrid, PartBox, SdfVolume

FRONT = Camera.orbit(20, 10, 2.6, 40, (0, -0.05, 0), 149, 131)
BESIDE = Camera.orbit(75, -20, 0.7, 45, (0.6, 0.3, 0.02), 96, 80)
WITHIN = Camera.orbit(0, 0, 0.05, 60, (0.6, 0.3, 0.02), 40, 40)
"""From inside a box: it is everywhere in the picture."""


def changed(man: SdfVolume, name: str, shift: float) -> SdfVolume:
    """The box of a part is moved, and its surface grown by 8 mm."""

    def of(box: PartBox) -> PartBox:
        matrix, field = box.box_from_root.copy(), box.field.clone()
        matrix[:3, 3] += shift
        field[..., 0] -= 0.008
        return replace(box, box_from_root=matrix, field=field)

    return replace(man, parts=tuple(of(box) if box.name == name else box for box in man.parts))


@pytest.fixture(autouse=True)
def needs_opengl() -> None:
    if "gl" not in available():
        pytest.skip("no OpenGL 4.3 here")


def assert_same(one: PointMap, other: PointMap) -> None:
    for name in IMAGES[:-1]:
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    orders = one.edges.pixel.argsort(), other.edges.pixel.argsort()
    for mine, theirs in zip(vars(one.edges).values(), vars(other.edges).values()):
        assert torch.equal(mine[orders[0]], theirs[orders[1]])


def again(then: SdfVolume, now: SdfVolume, camera: Camera) -> tuple[KeptHits, PointMap]:
    kept = KeptHits.of(raycast(then, camera), then, now, camera)
    assert kept
    return kept, kept.joined(raycast(now, camera, only=kept.anew))


@pytest.mark.parametrize("camera", [FRONT, BESIDE, WITHIN])
@pytest.mark.parametrize(("name", "shift"), [("left_hand", 0.0), ("left_hand", 0.03), ("face", -0.02)])
def test_what_is_joined_is_what_casting_all_gives(man: SdfVolume, camera: Camera, name: str, shift: float) -> None:
    now = changed(man, name, shift)
    kept, joined = again(man, now, camera)
    whole = raycast(now, camera)
    assert_same(joined, whole)
    if camera is not WITHIN:
        assert len(whole.edges.among(kept.anew).pixel)
        assert len(whole.edges.pixel) > 10
    if camera is FRONT:
        assert len(whole.edges.among(~kept.anew).pixel)
        assert kept.anew.float().mean() < 0.2
        assert not torch.equal(whole.position, kept.pointmap.position)


def test_a_box_that_goes_or_comes(man: SdfVolume) -> None:
    without = replace(man, parts=man.parts[1:])
    for then, now in ((man, without), (without, man)):
        assert_same(again(then, now, FRONT)[1], raycast(now, FRONT))


def test_a_pixel_beside_the_window_is_cast_anew(man: SdfVolume) -> None:
    """Its coverage looks at whether the pixel in the window is hit."""
    kept, _ = again(man, changed(man, "right_hand", 0.0), FRONT)
    hand = next(box for box in man.parts if box.name == "right_hand")
    x0, y0, x1, y1 = box_window(hand, FRONT)
    rows, columns = (torch.nonzero(kept.anew.any(axis))[:, 0] for axis in (1, 0))
    assert rows[0] < np.floor(y0)
    assert columns[0] < np.floor(x0)
    assert rows[-1] >= np.ceil(y1)
    assert columns[-1] >= np.ceil(x1)


def test_only_what_is_chosen_for_is_cast(man: SdfVolume) -> None:
    whole = raycast(man, FRONT, "gl")
    only = torch.zeros_like(whole.hit)
    only[20, 30] = True  # a corner of a tile: its neighbours are those of three
    some = raycast(man, FRONT, "gl", only=only)
    assert 64 <= some.counters["rays"] <= 3 * 64 + 16 * 3 * 64
    assert some.counters["ray_steps"] < 0.1 * whole.counters["ray_steps"]
    nothing = raycast(man, FRONT, "gl", only=torch.zeros_like(only))
    assert nothing.counters["rays"] == nothing.counters["ray_steps"] == 0
    assert not nothing.hit.any()
    assert_same(raycast(man, FRONT, "gl"), whole)


def test_a_box_that_a_ray_misses_says_nothing_about_it(man: SdfVolume) -> None:
    """Not even where steps end: a hand far away must not change a digit."""
    now = changed(man, "left_hand", 0.01)
    one, other = raycast(man, FRONT, "gl"), raycast(now, FRONT, "gl")
    kept = KeptHits.of(one, man, now, FRONT)
    assert kept
    for name in IMAGES[:-1]:
        mine, theirs = getattr(one, name), getattr(other, name)
        assert torch.equal(mine[~kept.anew], theirs[~kept.anew]), name


def test_another_body_keeps_nothing(man: SdfVolume) -> None:
    def body_of(sdf: Tensor) -> SdfVolume:
        return replace(man, body=BodyGrid(man.body.origin, man.body.voxel, sdf))

    seen = raycast(man, FRONT, "torch", antialias=False)
    assert KeptHits.of(seen, man, body_of(man.body.sdf.clone()), FRONT) is None
    same = KeptHits.of(seen, man, body_of(man.body.sdf), FRONT)
    assert same
    assert not same.anew.any()


@pytest.mark.parametrize("slope", [1, 3])
def test_pixels_beside_what_is_chosen_for_are_cast_too(man: SdfVolume, slope: float) -> None:
    """A pixel at a tile's rim is covered in part where the next tile's is hit: every other tile is as if all were cast. Where a
    field is steep no ray grazes, and nothing else tells."""
    steep = replace(man, body=replace(man.body, sdf=slope * man.body.sdf))
    whole = raycast(steep, FRONT)
    row, column = torch.meshgrid(torch.arange(FRONT.height) // 8, torch.arange(FRONT.width) // 8, indexing="ij")
    only = (row + column) % 2 == 0
    some = raycast(steep, FRONT, only=only)
    for name in IMAGES[:-1]:
        assert torch.equal(getattr(some, name)[only], getattr(whole, name)[only]), name
