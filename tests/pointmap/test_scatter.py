"""From covered pixels to images: compiled loops give what torch's operations give, in any order of the pixels."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from avatarrex.camera import Camera
from avatarrex.pointmap.kept_hits import IMAGES
from avatarrex.pointmap.point_map import CoveredPixels
from avatarrex.templates.parts import PARTS

VIEW = Camera.orbit(30, 5, 2.6, 40, (0, 0, 0), 61, 83)


@pytest.fixture
def covered() -> CoveredPixels:
    """A third of the pixels, in no order; their numbers lie in columns of one table, as a raycast leaves them."""
    random = torch.Generator().manual_seed(0)
    pixel = torch.randperm(61 * 83, generator=random)[: 61 * 83 // 3]
    table = torch.randn(len(pixel), 10 + len(PARTS), generator=random)
    return CoveredPixels(
        pixel=pixel,
        position=table[:, :3],
        normal=table[:, 3:6],
        part_weight=table[:, 6 : 6 + len(PARTS)],
        hit=table[:, -3] > 0,
        coverage=table[:, -2],
        steps=table[:, -1],
    )


def test_loops_lay_out_what_torch_does(covered: CoveredPixels) -> None:
    for given in (covered, replace(covered, hit=None, coverage=None, steps=None)):
        mine, theirs = (given.scatter(VIEW, "test", {}, impl) for impl in ("auto", "torch"))
        for name in set(IMAGES) - {"side", "depth"}:
            assert torch.equal(getattr(mine, name), getattr(theirs, name)), name
        torch.testing.assert_close(mine.depth, theirs.depth, atol=0, rtol=1e-7)


@pytest.mark.parametrize("impl", ["auto", "torch"])
def test_a_pixel_without_coverage_is_empty(covered: CoveredPixels, impl: str) -> None:
    made = covered.scatter(VIEW, "test", {}, impl)
    assert covered.coverage is not None
    shown = torch.zeros(61 * 83, dtype=torch.bool)
    shown[covered.pixel[covered.coverage > 0]] = True
    assert 0 < int(shown.sum()) < len(covered.pixel)
    for name in ("position", "normal", "part_weight", "hit", "coverage", "steps", "depth"):
        value = getattr(made, name).reshape(61 * 83, -1)
        assert not value[~shown].any(), name
    assert made.coverage.view(-1)[shown].min() > 0


def test_double_precision_is_served(covered: CoveredPixels) -> None:
    """By torch, which rounds it once."""
    exact = replace(covered, position=covered.position.double() + 1e-9)
    made = exact.scatter(VIEW, "test", {})
    assert made.position.dtype == torch.float32
    assert torch.equal(made.depth, exact.scatter(VIEW, "test", {}, "torch").depth)
