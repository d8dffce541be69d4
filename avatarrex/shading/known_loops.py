"""The compiled loops of `KnownAppearance` (ops/native.py): where known points are seen, and what they say about others.

What each computes is said in known_appearance.py, whose `_reference` is the same in float64. Arrays are float32 and int64.

Letters: m known points, p points of a query, c channels of an appearance. Root frame, metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped

from avatarrex.ops.native import borrowing, native

Array = Shaped[np.ndarray, "..."]

CROWDED = 100
"""Known points in nine pixels from which more are not kept: the edges of a pattern lie between any two."""
AROUND = 40
"""Known points in nine pixels from which the radius shrinks, so that a scale at which the view is coarser costs no more."""
ROOM = 64
"""Neighbours at most."""
ENOUGH = 9
"""Neighbours from which the radius shrinks further: where more is known, what is close counts."""
FEWEST = 5
"""Fewer are no evidence: a plane goes through three."""
RIDGE = np.float32(1e-3)
"""Added to the slopes' squares, in the sum of the weights: points in a line have a fit, too."""
OFF_CENTRE = np.float32(0.7)
"""Radii: where the neighbours' mean is farther off, the fit would extrapolate."""
SAME_SHEET = np.float32(0.7)
"""Least cosine between the normals of neighbours."""
SAME_POINT = np.float32(1e-5)
"""Metres: so near a known point is this one."""
UNKNOWN, TOLD, UNTOLD = 0, 1, 2
"""Answers: evaluate this point and know it from then on; it is interpolated; evaluate it, it is of no use to others."""
ZERO, ONE = np.float32(0), np.float32(1)


class KnownPoints(NamedTuple):
    """What is known, and in which pixels of a view it is."""

    place: Array
    """(m, 9) position, unit normal, colour."""
    side: Array
    """(m,)."""
    appearance: Array
    """(m, c)."""
    start: Array
    """(pixels + 1,): the points of pixel i are `order[start[i] : start[i + 1]]`."""
    order: Array
    width: int
    height: int


class QueryPoints(NamedTuple):
    """Points in covered pixels, row by row."""

    position: Array
    """(p, 3)."""
    normal: Array
    """(p, 3)."""
    side: Array
    """(p,)."""
    pixel: Array
    """(p,): row · width + column; negative outside the picture."""
    reach: Array
    """(p,) metres within which a point is a neighbour."""


class Neighbours(NamedTuple):
    """Of one point."""

    radius: Array
    """(1,) m²."""
    squared: Array
    """Distances, m²."""
    point: Array
    x: Array
    y: Array
    weight: Array
    share: Array


@native
def pixels(begin: int, end: int, place: Array, matrix: Array, eye: Array, size: tuple[int, int], pixel: Array) -> None:
    """pixel (m,) of points (m, 3 or 6: position, normal) in a view, `matrix` (3, 4); −1 outside, or turned away from the eye."""
    width, height = size
    for k in range(begin, end):
        x, y, z = place[k, 0], place[k, 1], place[k, 2]
        pixel[k] = -1
        if place.shape[1] > 3:
            facing = (x - eye[0]) * place[k, 3] + (y - eye[1]) * place[k, 4] + (z - eye[2]) * place[k, 5]
            if facing >= ZERO:
                continue
        depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
        column = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]
        row = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]
        if depth > ZERO and ZERO <= column < np.float32(width) * depth and ZERO <= row < np.float32(height) * depth:
            pixel[k] = min(int(row / depth), height - 1) * width + min(int(column / depth), width - 1)


@native
def list_by_pixel(pixel: Array, start: Array, order: Array) -> None:
    """start (pixels + 1,), zero before, and order: the points (m,) of each pixel, in their own order."""
    for k in range(len(pixel)):
        if pixel[k] >= 0:
            start[pixel[k] + 1] += 1
    for i in range(1, len(start)):
        start[i] += start[i - 1]
    for k in range(len(pixel)):
        if pixel[k] >= 0:
            order[start[pixel[k]]] = k
            start[pixel[k]] += 1
    for i in range(len(start) - 1, 0, -1):
        start[i] = start[i - 1]
    start[0] = 0


@borrowing
def _search(p: int, query: QueryPoints, known: KnownPoints, near: Neighbours) -> tuple[int, int]:
    """Put the known points around point p into `near`; their number, and that of all known points in the nine pixels. The
    radius shrinks where there are many.
    """
    place, width, height, squared, found = known.place, known.width, known.height, near.squared, near.point
    x, y, z = query.position[p, 0], query.position[p, 1], query.position[p, 2]
    nx, ny, nz = query.normal[p, 0], query.normal[p, 1], query.normal[p, 2]
    row, column = query.pixel[p] // width, query.pixel[p] % width
    left, right = max(column - 1, 0), min(column + 1, width - 1)
    low, high = max(row - 1, 0), min(row + 1, height - 1)
    around = 0
    for line in range(low, high + 1):
        around += known.start[line * width + right + 1] - known.start[line * width + left]
    radius = query.reach[p] * query.reach[p] * min(ONE, np.float32(AROUND) / np.float32(max(around, 1)))
    listed = 0
    for line in range(low, high + 1):
        for at in range(known.start[line * width + left], known.start[line * width + right + 1]):
            k = known.order[at]
            dx, dy, dz = place[k, 0] - x, place[k, 1] - y, place[k, 2] - z
            apart = dx * dx + dy * dy + dz * dz
            squared[listed], found[listed] = apart, k  # without a branch: half of them are taken
            listed = min(listed + int(apart < radius), ROOM - 1)
    if listed > ENOUGH:
        radius *= np.float32(ENOUGH) / np.float32(listed)
    count = 0
    for m in range(listed):
        k = found[m]
        along = nx * place[k, 3] + ny * place[k, 4] + nz * place[k, 5]
        if squared[m] < radius and known.side[k] == query.side[p] and along >= SAME_SHEET:
            squared[count], found[count] = squared[m], k
            count += 1
    near.radius[0] = radius
    return count, around


@borrowing
def _flatten(p: int, count: int, query: QueryPoints, known: KnownPoints, near: Neighbours) -> None:
    """Where the `count` neighbours lie in the tangent plane of point p, in radii, and their weights."""
    nx, ny, nz = query.normal[p, 0], query.normal[p, 1], query.normal[p, 2]
    sign = ONE if nz >= ZERO else -ONE  # axes of the plane: Duff and others 2017
    a = -ONE / (sign + nz)
    b = nx * ny * a
    ux, uy, uz = ONE + sign * nx * nx * a, sign * b, -sign * nx
    vx, vy, vz = b, sign + ny * ny * a, -ny
    scale = ONE / np.sqrt(near.radius[0])
    for m in range(count):
        k = near.point[m]
        dx = (known.place[k, 0] - query.position[p, 0]) * scale
        dy = (known.place[k, 1] - query.position[p, 1]) * scale
        dz = (known.place[k, 2] - query.position[p, 2]) * scale
        near.x[m], near.y[m] = dx * ux + dy * uy + dz * uz, dx * vx + dy * vy + dz * vz
        weight = ONE - near.squared[m] / near.radius[0]
        near.weight[m] = weight * weight


@borrowing
def _fit(count: int, place: Array, near: Neighbours) -> np.float32:
    """The share of each neighbour in a plane that is fitted to `count` of them, at the point itself; how far their colours are
    from that plane: root of the weighted mean square of the worst channel. Infinite where there is no such plane.
    """
    sw = sx = sy = sxx = sxy = syy = ZERO
    for m in range(count):
        x, y, w = near.x[m], near.y[m], near.weight[m]
        sw += w
        sx += w * x
        sy += w * y
        sxx += w * x * x
        sxy += w * x * y
        syy += w * y * y
    if sx * sx + sy * sy > OFF_CENTRE * OFF_CENTRE * sw * sw:
        return np.float32(np.inf)
    sxx += RIDGE * sw
    syy += RIDGE * sw
    # The adjugate of the normal equations' matrix, and its determinant.
    a00, a01, a02 = sxx * syy - sxy * sxy, sy * sxy - sx * syy, sx * sxy - sy * sxx
    a11, a12, a22 = sw * syy - sy * sy, sx * sy - sw * sxy, sw * sxx - sx * sx
    determinant = sw * a00 + sx * a01 + sy * a02
    if determinant <= ZERO:
        return np.float32(np.inf)
    worst, over = ZERO, ONE / determinant
    for channel in range(6, 9):
        middle = place[near.point[0], channel]
        r = rx = ry = square = ZERO
        for m in range(count):
            off, w = place[near.point[m], channel] - middle, near.weight[m]
            r += w * off
            rx += w * off * near.x[m]
            ry += w * off * near.y[m]
            square += w * off * off
        twice = a01 * r * rx + a02 * r * ry + a12 * rx * ry
        explained = (a00 * r * r + a11 * rx * rx + a22 * ry * ry + twice + twice) * over
        worst = max(worst, square - explained)
    for m in range(count):
        near.share[m] = near.weight[m] * (a00 + a01 * near.x[m] + a02 * near.y[m]) * over
    return np.float32(np.sqrt(worst / sw))


@borrowing
def _mix(count: int, appearance: Array, near: Neighbours, out: Array) -> None:
    """out (c,): the neighbours' appearances by their shares; four at a time, which takes half the time of one."""
    for c in range(len(out)):
        out[c] = ZERO
    for first in range(0, count, 4):
        w0, a = near.share[first], appearance[near.point[first]]
        one, two, three = min(first + 1, count - 1), min(first + 2, count - 1), min(first + 3, count - 1)
        w1 = near.share[one] if first + 1 < count else ZERO
        w2 = near.share[two] if first + 2 < count else ZERO
        w3 = near.share[three] if first + 3 < count else ZERO
        b, c_, d = appearance[near.point[one]], appearance[near.point[two]], appearance[near.point[three]]
        for c in range(len(out)):
            out[c] += w0 * a[c] + w1 * b[c] + w2 * c_[c] + w3 * d[c]


@native
def interpolate(
    begin: int, end: int, query: QueryPoints, known: KnownPoints, tolerance: np.float32, out: Array, answer: Array
) -> None:
    """answer (p,) of the points `begin : end`, and out (p, c), the appearances of those that are `TOLD`."""
    room, point = np.empty((6, ROOM), np.float32), np.empty(ROOM, np.int64)
    near = Neighbours(room[0], room[1], point, room[2], room[3], room[4], room[5])
    for p in range(begin, end):
        answer[p] = UNKNOWN
        if query.pixel[p] < 0:
            continue
        count, around = _search(p, query, known, near)
        nearest = 0
        for m in range(1, count):
            if near.squared[m] < near.squared[nearest]:
                nearest = m
        if count and near.squared[nearest] <= SAME_POINT * SAME_POINT:
            out[p] = known.appearance[point[nearest]]
            answer[p] = TOLD
            continue
        if around >= CROWDED:
            answer[p] = UNTOLD
        if count >= FEWEST:
            _flatten(p, count, query, known, near)
            if _fit(count, known.place, near) <= tolerance:
                _mix(count, known.appearance, near, out[p])
                answer[p] = TOLD
