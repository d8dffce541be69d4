"""Three orthographic renders of the face mesh, the condition of the face networks (paper sec. 3.3).

Front, left and right 256² views of a head-frame cube normalised to [−1, 1]³. Seven channels: albedo RGB (sRGB), smooth
unit normal (head frame), mask; zero outside the mesh. Row 0 is the top; the person's left is +X, up +Y, front +Z.
Letters: v vertices, f faces, h w pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.ops.rasterise import rasterise
from avatarrex.templates.mesh import vertex_normals

VIEW_NAMES = ("front", "left", "right")
VIEW_PIXELS = 256
CHANNELS = 7
AXES = (
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
)
"""Of each view: image right, image up, towards the camera. The left view looks at the person's left side from +X."""
Impl = Literal["auto", "reference"]


@dataclass(frozen=True)
class HeadBox:
    """The cube of the head frame that the views show, metres."""

    centre: Float[Tensor, " 3"]
    half: float

    @staticmethod
    def around(points: Float[Tensor, "v 3"], margin: float) -> HeadBox:
        """The smallest cube about `points` with `margin` metres to spare."""
        low, high = points.amin(0), points.amax(0)
        return HeadBox((low + high) / 2, float((high - low).max()) / 2 + margin)

    def normalise(self, position: Float[Tensor, "*p 3"]) -> Float[Tensor, "*p 3"]:
        """Head-frame metres to [−1, 1]³."""
        return (position - self.centre) / self.half


def project(position: Float[Tensor, "p 3"]) -> Float[Tensor, "3 p 2"]:
    """Π_v: normalised points to image coordinates in [−1, 1] of each view, x right and y down."""
    axes = position.new_tensor(AXES)
    return torch.stack([position @ axes[:, 0].T, -(position @ axes[:, 1].T)], -1).transpose(0, 1)


def render_views(
    vertices: Float[Tensor, "v 3"],
    faces: Int[Tensor, "f 3"],
    albedo: Float[Tensor, "v 3"],
    box: HeadBox,
    size: int = VIEW_PIXELS,
    impl: Impl = "auto",
) -> Float[Tensor, "3 7 h w"]:
    """The views of a posed face mesh (head frame, metres). Not differentiable; the same input gives the same bits.

    `auto` draws in compiled loops on the CPU, `reference` by a z-buffer in torch: the same pixels.
    """
    with torch.no_grad():
        place = box.normalise(vertices).float()
        values = torch.cat([albedo.float(), vertex_normals(vertices, faces).float()], -1)
        if impl == "reference":
            return torch.stack([_rasterise(xy, depth, faces, values, size) for xy, depth in _views(place)])
        pixel = (project(place).double() + 1) * (size / 2) - 0.5
        depth = torch.stack([depth for _, depth in _views(place)]).double()
        corners, heights, triangles, painted = (each.cpu().numpy() for each in (pixel, depth, faces, values))
        images = torch.from_numpy(rasterise(corners, heights, triangles, painted, size))
        images[:, 3:6] /= images[:, 3:6].square().sum(1, keepdim=True).sqrt().clamp_min(1e-12)
        return images.to(place.device)


def render_places(vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"], box: HeadBox) -> Float[Tensor, "3 7 h w"]:
    """The views with normalised places in the albedo's stead."""
    return render_views(vertices, faces, box.normalise(vertices).float(), box)


def front_points(
    vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"], marked: Bool[Tensor, " v"], box: HeadBox, rows: int = 1
) -> Float[Tensor, "p 3"]:
    """Points of the mesh (head frame, metres) at the front view's pixels that show `marked` vertices for more than half, of every
    `rows`-th row."""
    shown = render_views(vertices, faces, marked[:, None].expand(-1, 3).float(), box)[0, 0, ::rows] > 0.5
    place = render_places(vertices, faces, box)[0, :3, ::rows][:, shown].T
    return (box.half * place + box.centre).to(vertices)


def before(points: Float[Tensor, "p 3"], places: Float[Tensor, "3 7 h w"], box: HeadBox) -> Float[Tensor, "3 p"]:
    """Metres by which what each view shows lies before points (head frame), to a texel's slope; −∞ where it shows nothing
    there, ∞ where it does not reach. `places`: of `render_places`."""
    place, found = box.normalise(points).float(), []
    for image, xy, towards in zip(places, project(place), place.new_tensor(AXES)[:, 2]):
        column, row = ((xy + 1) * (image.shape[-1] / 2)).long().clamp(0, image.shape[-1] - 1).unbind(-1)
        gap = box.half * ((image[:3, row, column].T - place) @ towards)
        gap = torch.where(image[6, row, column] > 0, gap, -torch.inf)
        found.append(torch.where((xy.abs() < 1).all(-1), gap, torch.inf))
    return torch.stack(found)


def seen(
    vertices: Float[Tensor, "v 3"],
    faces: Int[Tensor, "f 3"],
    places: Float[Tensor, "3 7 h w"],
    box: HeadBox,
    depth: float,
) -> Bool[Tensor, " v"]:
    """Vertices (head frame) that face one of the views and that nothing hides from it by more than `depth` metres."""
    normal = vertex_normals(vertices, faces).float()
    facing = (normal @ normal.new_tensor(AXES)[:, 2].T).T > 0
    return (facing & (before(vertices, places, box) < depth)).any(0)


def _views(place: Tensor) -> list[tuple[Tensor, Tensor]]:
    """Image coordinates and depth towards the camera of the vertices in each view."""
    towards = place.new_tensor(AXES)[:, 2]
    return list(zip(project(place), (place @ towards.T).T))


def _rasterise(xy: Tensor, depth: Tensor, faces: Tensor, values: Tensor, size: int) -> Tensor:
    """Z-buffer: every (triangle, pixel centre) pair of the bounding boxes; the nearest, then the first, wins."""
    place = (xy.double() + 1) * (size / 2) - 0.5
    a, b, c = place[faces].unbind(1)
    low = torch.minimum(torch.minimum(a, b), c).ceil().long().clamp(0, size)
    high = torch.maximum(torch.maximum(a, b), c).floor().long().clamp(-1, size - 1)
    extent = (high - low + 1).clamp_min(0)
    count = extent.prod(-1)
    triangle = torch.arange(len(faces)).repeat_interleave(count)
    number = torch.arange(int(count.sum())) - (count.cumsum(0) - count)[triangle]
    column = low[triangle, 0] + number % extent[triangle, 0].clamp_min(1)
    row = low[triangle, 1] + number // extent[triangle, 0].clamp_min(1)
    pixel = torch.stack([column, row], -1).double()
    area = _cross(b - a, c - a)
    v = _cross(pixel - a[triangle], (c - a)[triangle]) / area[triangle]
    w = _cross((b - a)[triangle], pixel - a[triangle]) / area[triangle]
    weight = torch.stack([1 - v - w, v, w], -1)
    hit = torch.nonzero((weight >= 0).all(-1))[:, 0]
    weight, triangle, index = weight[hit], triangle[hit], (row * size + column)[hit]
    near = (depth.double()[faces[triangle]] * weight).sum(-1)
    front = torch.full((size * size,), -torch.inf, dtype=near.dtype).scatter_reduce(0, index, near, "amax")
    nearest = torch.nonzero(near == front[index])[:, 0]
    first = torch.full((size * size,), len(faces)).scatter_reduce(0, index[nearest], triangle[nearest], "amin")
    won = nearest[triangle[nearest] == first[index[nearest]]]
    image = values.new_zeros(size * size, CHANNELS)
    colour, normal = (values[faces[triangle[won]]] * weight[won, :, None].float()).sum(1).split(3, -1)
    mask = torch.ones_like(colour[:, :1])
    image[index[won]] = torch.cat([colour, torch.nn.functional.normalize(normal, dim=-1), mask], -1)
    return image.T.reshape(-1, size, size)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
