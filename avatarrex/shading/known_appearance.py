"""What is known of the body's surface in one pose, from the points that were coloured in earlier views of it.

A colour network's features and the light belong to a point of the surface, from wherever it is seen (`BodyField.appearance`);
what depends on the view is one small network on them. So the appearance of a point between points that are known is
interpolated, in a plane fitted to them by moving least squares (Lancaster and Salkauskas 1981), and evaluated where they do not
lie in a plane: where a pattern has its edges, and where the surface was not seen before. What is evaluated is known from then on:
the known points grow dense where it matters (as in the irradiance cache of Ward, Rubinstein and Clear 1988).

The neighbours of a point are searched among the known points that the same view sees in its pixel and the eight around it: those of
the same limb, on the same sheet (normals within 45°) and no farther than `REACH` pixels.

Letters: p points, m known points, c channels of an appearance. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.ops import native
from avatarrex.shading import known_loops
from avatarrex.shading.known_loops import KnownPoints, QueryPoints

REACH = 1.5
"""Pixels between neighbours at most: such a point is in one of the nine pixels."""
COARSEST = 0.004
"""Metres from pixel to pixel from which a picture samples the surface too coarsely: texels of the feature patches, whose edges a
plane would cut, are 6.9 mm apart."""
MOST = 1 << 20
"""Known points, 120 bytes each, beyond which those that the view at hand does not see are forgotten."""


class KnownAppearance:
    """Grows while its pose is looked at; every frame of that pose shares it. Of use to pictures finer than `COARSEST`."""

    def __init__(self, channels: int, most: int = MOST) -> None:
        self._most, self._count = most, 0
        # Memory that is not written costs nothing; to grow would take a tenth of a second amid a turn.
        self._place = np.empty((most, 9), np.float32)
        self._side = np.empty(most, np.int64)
        self._appearance = np.empty((most, channels), np.float32)

    @property
    def count(self) -> int:
        """Of known points."""
        return self._count

    def seen_by(self, view: Camera) -> SeenAppearance:
        """All that is known, sorted into the pixels of `view`; what is added later is not in it."""
        pixel = _pixels(view, self._place[: self._count])
        if self._count > self._most:
            self._keep(np.flatnonzero(pixel >= 0), 0)
            pixel = _pixels(view, self._place[: self._count])
        start = np.zeros(view.width * view.height + 1, np.int64)
        order = np.empty(len(pixel), np.int64)
        known_loops.list_by_pixel(pixel, start, order)
        known = self._place[: self._count], self._side[: self._count], self._appearance[: self._count]
        return SeenAppearance(view, KnownPoints(*known, start, order[: start[-1]], view.width, view.height))

    def add(
        self,
        position: Float[Tensor, "p 3"],
        normal: Float[Tensor, "p 3"],
        side: Int[Tensor, " p"],
        appearance: Float[Tensor, "p c"],
        colour: Float[Tensor, "p 3"],
    ) -> None:
        """Know these points, too."""
        first, last = self._count, self._count + len(position)
        if last > len(self._side):
            self._keep(np.arange(first), 2 * last)
        for column, values in enumerate((position, normal, colour)):
            self._place[first:last, 3 * column : 3 * column + 3] = values.numpy()
        self._side[first:last], self._appearance[first:last] = side.numpy(), appearance.numpy()
        self._count = last

    def _keep(self, rows: np.ndarray, room: int) -> None:
        """Only these rows, with room for `room`."""
        self._count, room = len(rows), max(len(rows), room)
        for name in ("_place", "_side", "_appearance"):
            old = getattr(self, name)
            new = np.empty((room, *old.shape[1:]), old.dtype)
            new[: len(rows)] = old[rows]
            setattr(self, name, new)


@dataclass(frozen=True)
class SeenAppearance:
    """What is known, for one view."""

    view: Camera
    """Root frame."""
    known: KnownPoints

    def interpolate(
        self,
        position: Float[Tensor, "p 3"],
        normal: Float[Tensor, "p 3"],
        side: Int[Tensor, " p"],
        tolerance: float,
        impl: str = "auto",
    ) -> tuple[Float[Tensor, "p c"], UInt8[Tensor, " p"]]:
        """Appearances of points that the view sees, row by row, and for which of them they are right (`known_loops.TOLD`): the colours
        of their neighbours are within `tolerance` of a plane, in the mean square of the worst channel. `impl`: `auto`, `reference`.
        """
        query = _query(self.view, position, normal, side)
        if impl == "reference":
            return _reference(self.known, query, tolerance)
        out = np.empty((len(position), self.known.appearance.shape[1]), np.float32)
        answer = np.empty(len(position), np.uint8)
        native.spread(known_loops.interpolate, len(position), query, self.known, np.float32(tolerance), out, answer)
        return torch.from_numpy(out), torch.from_numpy(answer)


def _pixels(view: Camera, place: np.ndarray) -> Int[np.ndarray, " p"]:
    """row · width + column of points, or of points with normals beside them that are turned to the eye; −1 outside."""
    matrix = (view.intrinsics @ view.camera_from_world[:3]).astype(np.float32)
    pixel = np.empty(len(place), np.int64)
    eye, size = view.centre.astype(np.float32), (view.width, view.height)
    native.spread(known_loops.pixels, len(place), place, matrix, eye, size, pixel)
    return pixel


def pixel_spacing(view: Camera, position: Float[Tensor, "p 3"]) -> Float[np.ndarray, " p"]:
    """Metres from pixel to pixel at the depth of root-frame points, float32."""
    axis = view.camera_from_world[2].astype(np.float32)
    focal = np.float32(abs(np.linalg.det(view.intrinsics[:2, :2])) ** 0.5)
    return np.asarray((position.numpy() @ axis[:3] + axis[3]) / focal)


def _query(view: Camera, position: Tensor, normal: Tensor, side: Tensor) -> QueryPoints:
    reach = np.float32(REACH) * pixel_spacing(view, position)
    places = position.contiguous().numpy(), normal.contiguous().numpy(), side.contiguous().numpy()
    return QueryPoints(*places, _pixels(view, places[0]), reach)


def _reference(
    known: KnownPoints, query: QueryPoints, tolerance: float
) -> tuple[Float[Tensor, "p c"], UInt8[Tensor, " p"]]:
    """`SeenAppearance.interpolate` in float64, point by point, as a least-squares problem."""
    out = np.zeros((len(query.position), known.appearance.shape[1]), np.float32)
    answer = np.full(len(out), known_loops.UNKNOWN, np.uint8)
    pixel = np.full(len(known.place), -3 * known.width)  # far from any
    pixel[known.order] = np.repeat(np.arange(len(known.start) - 1), np.diff(known.start))
    for p in np.flatnonzero(query.pixel >= 0):
        row, column = np.divmod(query.pixel[p], known.width)
        around = np.flatnonzero((abs(pixel // known.width - row) <= 1) & (abs(pixel % known.width - column) <= 1))
        place, here, normal = (
            rows.astype(np.float64) for rows in (known.place[around], query.position[p], query.normal[p])
        )
        squared = ((place[:, :3] - here) ** 2).sum(1)
        radius = float(query.reach[p]) ** 2 * min(1, known_loops.AROUND / max(len(around), 1))
        listed = int((squared < radius).sum())
        radius *= min(1, known_loops.ENOUGH / max(listed, 1))
        near = (
            (squared < radius)
            & (known.side[around] == query.side[p])
            & (place[:, 3:6] @ normal >= known_loops.SAME_SHEET)
        )
        place, squared, appearance = place[near], squared[near], known.appearance[around[near]]
        if len(place) and squared.min() <= known_loops.SAME_POINT**2:
            out[p], answer[p] = appearance[squared.argmin()], known_loops.TOLD
            continue
        if len(around) >= known_loops.CROWDED:
            answer[p] = known_loops.UNTOLD
        if len(place) < known_loops.FEWEST:
            continue
        weight, axes = (1 - squared / radius) ** 2, np.linalg.svd(normal[None])[2][1:]
        plane = np.concatenate([np.ones((len(place), 1)), (place[:, :3] - here) @ axes.T / radius**0.5], 1)
        if np.linalg.norm(weight @ plane[:, 1:]) > known_loops.OFF_CENTRE * weight.sum():
            continue
        if _fitted(plane, weight, place[:, 6:])[1].max() <= tolerance:
            out[p], answer[p] = _fitted(plane, weight, appearance)[0], known_loops.TOLD
    return torch.from_numpy(out), torch.from_numpy(answer)


def _fitted(
    plane: Float[np.ndarray, "k 3"], weight: Float[np.ndarray, " k"], values: Float[np.ndarray, "k c"]
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Ridge regression of `values` on 1, x and y: what it says at 0, and the root of the weighted mean square that is left."""
    root, total = np.sqrt(weight)[:, None], weight.sum()
    rows = np.concatenate([root * plane, np.sqrt(known_loops.RIDGE * total) * np.eye(3)[1:]])
    wanted = np.concatenate([root * values, np.zeros((2, values.shape[1]))])
    found = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    return found[0], np.sqrt(((wanted - rows @ found) ** 2).sum(0) / total)
