"""Pixels between evaluated ones: interpolated where one smooth sheet lies around them, evaluated at edges of colour and of surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.frame import DeferredFrame
from avatarrex.levels import LEVELS, level, moving
from avatarrex.pipeline import render_deferred
from avatarrex.pointmap.point_map import PointMap
from avatarrex.settings import RenderSettings
from avatarrex.shading.coarse_shading import evaluated_first, interpolate
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression

HEIGHT, WIDTH = 34, 41
TOLERANCE = 0.004
Change = Callable[[dict[str, Tensor]], None]


def plane() -> dict[str, Tensor]:
    """The images of a slanted plane that fills the picture."""
    row, column = (x.float() for x in torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij"))
    normal = torch.nn.functional.normalize(torch.tensor([0.3, 0.1, 1.0]), dim=0)
    depth = -(0.3 * column + 0.1 * row)
    return {
        "position": 0.002 * torch.stack([column, row, depth], -1),
        "normal": normal.expand(HEIGHT, WIDTH, 3).clone(),
        "depth": 2 + 0.002 * depth,
        "hit": torch.ones(HEIGHT, WIDTH, dtype=torch.bool),
        "coverage": torch.ones(HEIGHT, WIDTH),
        "part_weight": torch.zeros(HEIGHT, WIDTH, 3),
        "steps": torch.zeros(HEIGHT, WIDTH),
        "side": torch.zeros(HEIGHT, WIDTH, dtype=torch.int64),
    }


def wave(length: float, height: float = 0.2) -> Tensor:
    """Colours that swing over `length` pixels."""
    row, column = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    phase = 2 * torch.pi / length * (row[..., None] * torch.tensor([1.0, 0.5, 0.0]) + column[..., None])
    return 0.5 + height * phase.sin()


def told(
    colour: Tensor, images: dict[str, Tensor], tolerance: float = TOLERANCE, impl: str = "auto"
) -> tuple[Tensor, Tensor]:
    """The picture after the first round, completed where it can be, and where."""
    pointmap, covered = PointMap(**images, renderer=""), images["coverage"] > 0
    whole = torch.cat([colour * images["coverage"][..., None], images["coverage"][..., None]], -1)
    first = evaluated_first(covered)
    image = torch.where(first[..., None], whole, 0)
    return image, interpolate(image, covered & ~first, pointmap, pointmap.side, tolerance, impl)


def inner() -> Tensor:
    """Pixels with three others on every side, not evaluated first."""
    inside = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    inside[3:-3, 3:-3] = True
    inside[::2, ::2] = False
    return inside


def test_a_quarter_is_evaluated_first() -> None:
    first = evaluated_first(torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
    assert first.sum() == -(-HEIGHT // 2) * -(-WIDTH // 2)
    assert not evaluated_first(torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)).any()


def test_cubic_colours_are_exact() -> None:
    """Along a row or a column; the error of linear interpolation is what decides."""
    column = torch.arange(WIDTH).float() / WIDTH
    colour = (column**3 - column**2 + 0.5).expand(HEIGHT, WIDTH)[..., None].expand(-1, -1, 3)
    image, here = told(colour, plane())
    assert here[inner()].all()
    torch.testing.assert_close(image[here][:, :3], colour[here], atol=2e-6, rtol=0)
    assert (image[here][:, 3] == 1).all()
    assert not (image[~here & ~evaluated_first(plane()["hit"])]).any(), "what is not told is left as it was"


@pytest.mark.parametrize("tolerance", [0.001, 0.004, 0.02])
def test_no_smooth_colour_errs_by_more_than_the_tolerance(tolerance: float) -> None:
    shares = []
    for length in (200.0, 60.0, 30.0, 15.0, 8.0):
        image, here = told(wave(length), plane(), tolerance)
        shares.append(float(here[inner()].float().mean()))
        if here.any():
            assert (image[here][:, :3] - wave(length)[here]).abs().max() < tolerance
    assert shares == sorted(shares, reverse=True)
    assert shares[0] == 1
    assert shares[-1] < 0.1


def of_right_half(name: str, change: Callable[[Tensor], Tensor]) -> Change:
    """Change one image from column 20 on."""

    def do(images: dict[str, Tensor]) -> None:
        images[name][:, 20:] = change(images[name][:, 20:])

    return do


EDGES = {
    "limb": of_right_half("side", lambda side: side + 1),
    "sheet": of_right_half("position", lambda place: place + 0.03 * torch.tensor([0.3, 0.1, 1.0])),
    "fold": of_right_half("normal", lambda normal: normal * torch.tensor([1.0, 1.0, -1.0])),
    "part": of_right_half("part_weight", lambda weight: weight + 0.5),
    "air": of_right_half("hit", torch.zeros_like),
    "silhouette": of_right_half("coverage", lambda share: 0.5 * share),
}


@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("impl", ["auto", "reference"])
def test_nothing_is_told_across_an_edge_of_the_surface(edge: str, impl: str) -> None:
    images = plane()
    EDGES[edge](images)
    _, here = told(torch.full((HEIGHT, WIDTH, 3), 0.5), images, impl=impl)
    reached = [19] if edge == "sheet" else [17, 19, 21]  # a place matters to the two pixels beside it
    assert not here[:, reached].any()
    left = inner() & (torch.arange(WIDTH) < 17)
    assert here[left].all()


def test_nothing_is_told_across_an_edge_of_colour() -> None:
    colour = torch.full((HEIGHT, WIDTH, 3), 0.5)
    colour[:, 20:, 1] += 0.1
    _, here = told(colour, plane())
    reached = (torch.arange(WIDTH) % 2 == 1) & (abs(torch.arange(WIDTH) - 19) < 3)
    assert not here[:, reached].any()
    assert here[inner() & ~reached].all()


def test_two_diagonals_that_differ_are_no_colour() -> None:
    """A saddle: along each diagonal colours are constant to the eye of second differences."""
    colour = torch.full((HEIGHT, WIDTH, 3), 0.5)
    row, column = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    colour[((row + column) // 2) % 2 == 1] += 0.1  # of even rows and columns: a checkerboard
    odd = (row % 2 == 1) & (column % 2 == 1)
    for impl in ("auto", "reference"):
        assert not told(colour, plane(), impl=impl)[1][odd].any()


@pytest.mark.parametrize("length", [60.0, 30.0, 22.0])
def test_loops_are_the_reference(length: float) -> None:
    images, random = plane(), torch.Generator().manual_seed(0)
    noise = torch.randn(HEIGHT, WIDTH, 3, generator=random)
    images["normal"] = torch.nn.functional.normalize(images["normal"] + 0.2 * noise, dim=-1)
    images["position"] += 0.0003 * noise
    images["part_weight"] = 0.06 * noise.abs()
    images["coverage"][torch.rand(HEIGHT, WIDTH, generator=random) < 0.02] = 0.4
    images["side"][20:, 30:] = 1
    mine, theirs = (told(wave(length), images, 0.01, impl) for impl in ("auto", "reference"))
    assert torch.equal(mine[1], theirs[1])
    assert 0.05 < mine[1][inner()].float().mean() < 0.95
    torch.testing.assert_close(mine[0], theirs[0], atol=1e-6, rtol=0)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar()


SETTINGS = replace(level("balanced"), part_voxel=0.01)
COARSE = replace(SETTINGS, shading_tolerance=TOLERANCE)


def seen(
    avatar: Avatar,
    settings: RenderSettings,
    before: DeferredFrame | None = None,
    azimuth: float = 10,
    expression: str | None = None,
) -> DeferredFrame:
    """The head and the chest, 2.3 mm a pixel."""
    camera = Camera.orbit(azimuth, 5, 0.8, 40, (0, 0.5, 0), 256, 256)
    signals = Signals.rest()
    if expression:
        signals = signals.replace(expression=named_expression(expression))
    return render_deferred(avatar, signals, camera, settings, before)


def psnr(one: DeferredFrame, other: DeferredFrame) -> float:
    return float(-10 * (one.image - other.image)[one.pointmap.hit][:, :3].square().mean().log10())


def test_a_frame_is_as_if_every_pixel_were_evaluated(avatar: Avatar) -> None:
    assert not any(settings.shading_tolerance for settings in LEVELS.values())
    exact, coarse = seen(avatar, SETTINGS), seen(avatar, COARSE)
    first = evaluated_first(exact.pointmap.coverage > 0)
    assert coarse.counters["pixels_shaded"] < 0.75 * exact.counters["pixels_shaded"]
    assert 52 < psnr(coarse, exact) < 80
    torch.testing.assert_close(coarse.shading.unmixed[first], exact.shading.unmixed[first], atol=2e-6, rtol=0)
    assert torch.equal(coarse.image[..., 3], exact.image[..., 3])
    for name in ("position", "normal", "depth", "coverage", "part_weight"):
        assert torch.equal(getattr(coarse.pointmap, name), getattr(exact.pointmap, name)), name
    changed = (coarse.shading.unmixed - exact.shading.unmixed).abs().amax(-1) > 1e-4
    assert not changed[exact.pointmap.coverage < 1].any(), "silhouettes are evaluated"
    assert (coarse.shading.unmixed - exact.shading.unmixed)[changed].abs().quantile(0.999) < 6 * TOLERANCE


def test_a_more_exact_frame_serves_and_a_coarser_one_does_not(avatar: Avatar) -> None:
    exact, coarse = seen(avatar, SETTINGS), seen(avatar, COARSE)
    assert torch.equal(seen(avatar, SETTINGS, coarse).image, exact.image)
    assert seen(avatar, COARSE, exact).shading is exact.shading
    assert seen(avatar, COARSE, coarse).shading is coarse.shading
    finer = seen(avatar, replace(COARSE, shading_tolerance=TOLERANCE / 4), coarse)
    assert psnr(finer, exact) > psnr(coarse, exact) + 6


def test_pixels_that_did_not_change_are_kept_and_what_did_is_interpolated_between_them(avatar: Avatar) -> None:
    before = seen(avatar, COARSE)
    smile, alone = seen(avatar, COARSE, before, expression="smile"), seen(avatar, COARSE, expression="smile")
    exact = seen(avatar, SETTINGS, expression="smile")
    assert 0 < smile.counters["pixels_shaded"] < 0.6 * alone.counters["pixels_shaded"]
    assert psnr(smile, exact) > 52
    torch.testing.assert_close(smile.image, alone.image, atol=2e-6, rtol=0)


def test_what_is_known_of_other_views_was_evaluated(avatar: Avatar) -> None:
    settings = moving(COARSE)
    frames = [seen(avatar, settings, azimuth=0)]
    for azimuth in (4, 8, 12):
        frames.append(seen(avatar, settings, frames[-1], azimuth))
    known = frames[-1].shading.known
    assert known
    assert 0 < known.count <= sum(frame.counters["body_pixels"] for frame in frames[1:])
    exact, alone = seen(avatar, SETTINGS, azimuth=12), seen(avatar, COARSE, azimuth=12)
    assert frames[-1].counters["body_pixels"] < 0.7 * alone.counters["body_pixels"]
    assert psnr(frames[-1], exact) > 50
