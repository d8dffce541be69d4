"""What an avatar has to beat: the template of the captured person, skinned, with colours from the training pictures.

- **textured mesh**: per texel the median of the colours seen there (per channel), over the training pictures in which the
  posed texel is visible: nearest surface under its pixel, facing the camera by less than 72 degrees, inside the matte.
  A texel never seen has the colour of the nearest seen one at rest.
- **mean-colour mesh**: one colour, the matte-weighted mean of the foreground over the same pictures.

Texels lie on a lattice of each triangle, `EDGE` to an edge (about 4 mm apart on the default person) or as many as the cameras
resolve (`resolved_edge`), and are interpolated linearly. The mesh is the whole template: fingers and face move with φ and ψ.
The template is `NAKED` as it is, `FITTED` with its skin on the mattes. Letters: f faces, t texels of a face, p points, h w
pixels. Metres; colours sRGB-encoded in [0, 1].
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from avatarrex.camera import Camera
from avatarrex.capture.fit.capture_fit import fit_geometry
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.paint import DEPTH_TOLERANCE
from avatarrex.capture.fit.photo import FACING, OPAQUE
from avatarrex.capture.readers.rigs import Capture
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.errors import check
from avatarrex.metrics.drawing import Drawing
from avatarrex.metrics.mesh import Surface
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person

EDGE = 3
"""Texels along an edge are EDGE + 1; the default person's edges are 12 mm, a pixel of 512² on a whole person 4 mm."""
FINEST_EDGE = 8
"""At most: a megabyte of colours a picture and channel."""
NAKED, FITTED, FINE, FACED, MEAN = (
    "naked textured mesh",
    "fitted textured mesh",
    "fitted mesh, fine texels",
    "fitted mesh, own face",
    "mean-colour mesh",
)
"""Names of the kinds."""
PIXEL_SAMPLES = 2
"""Samples along each side of a pixel when a mesh is drawn."""


@dataclass(frozen=True, eq=False)
class Observation:
    """One training picture."""

    signals: Signals
    camera: Camera
    image: np.ndarray
    """(h, w, 3) sRGB bytes."""
    matte: np.ndarray
    """(h, w) bytes."""

    @classmethod
    def of(cls, signals: Signals, camera: Camera, picture: Float[np.ndarray, "h w 4"]) -> Observation:
        """Of a premultiplied picture."""
        straight = picture[..., :3] / np.maximum(picture[..., 3:], 1e-6)
        layers = (np.rint(255 * np.clip(layer, 0, 1)).astype(np.uint8) for layer in (straight, picture[..., 3]))
        return cls(signals, camera, *layers)


class PosedMesh:
    """The person's whole template under signals, in the world; remembers the last pose and the last view."""

    def __init__(self, person: Person) -> None:
        self.person = person
        self.faces = person.body.faces.numpy()
        self.surface = lru_cache(1)(self._surface)
        self._view: tuple[object, tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None

    def _surface(self, signals: Signals) -> Surface:
        """World metres."""
        return Surface.of(template_surface(self.person, signals)[0], self.faces)

    def visible(self, signals: Signals, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Face, barycentrics and camera z under each pixel centre."""
        surface, key = self.surface(signals), (signals, camera.key())
        if self._view is None or self._view[0] != key:
            self._view = key, visible_faces(surface.vertices, surface.faces, camera)
        return self._view[1]


class MeshDrawer:
    """A coloured skinned mesh, a subject of comparison."""

    def __init__(self, name: str, mesh: PosedMesh, texels: Float[np.ndarray, "f t 3"]) -> None:
        self.name, self.mesh, self.texels = name, mesh, texels

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """The mesh with `PIXEL_SAMPLES`² colours per pixel; its geometry is that of each pixel's first sample."""
        s, height, width = PIXEL_SAMPLES, camera.height, camera.width
        face, weight, _ = self.mesh.visible(signals, camera.resized(width * s, height * s))
        hit = face >= 0
        fine = np.zeros((*face.shape, 4), np.float32)
        fine[hit, :3] = look_up(self.texels, face[hit], weight[hit])
        fine[hit, 3] = 1
        image = fine.reshape(height, s, width, s, 4).mean((1, 3))
        first, at = hit[::s, ::s], (face[::s, ::s], weight[::s, ::s])
        position, normal = np.zeros((2, height, width, 3), np.float32)
        position[first], normal[first] = self.mesh.surface(signals).at(at[0][first], at[1][first])
        return Drawing(torch.from_numpy(image), position, normal, first)


def rivals(capture: Capture, fitted: Person, seen: Sequence[Observation]) -> list[MeshDrawer]:
    """The captured person's template as it is, in two kinds of colours, and its `fitted_meshes`."""
    naked = capture.person.naked
    return [textured_mesh(naked, seen), mean_colour_mesh(naked, seen), *fitted_meshes(capture, fitted, seen)]


def fitted_meshes(capture: Capture, fitted: Person, seen: Sequence[Observation]) -> list[MeshDrawer]:
    """The textured template with the skin of `fitted`, or else one that is fitted here; that once more with finer texels where
    the cameras resolve them, and then with its face, too, where that was fitted. Raises `InputError` as fitting does.
    """
    fitted = with_fitted_skin(capture, fitted)
    edge = resolved_edge(fitted, seen)
    skin = fitted.with_template_face
    found = [textured_mesh(skin, seen, FITTED)]
    if edge > EDGE:
        found.append(textured_mesh(skin, seen, FINE, edge))
    if skin is not fitted:
        found.append(textured_mesh(fitted, seen, FACED, max(edge, EDGE)))
    return found


def with_fitted_skin(capture: Capture, fitted: Person) -> Person:
    """`fitted`, or where its skin was not, the captured person with a skin that is fitted here. Raises `InputError` as fitting does."""
    return fit_geometry(capture) if fitted.fit is None or fitted.fit.surface is None else fitted


def textured_mesh(
    person: Person, observations: Iterable[Observation], name: str = NAKED, edge: int = EDGE
) -> MeshDrawer:
    """The mesh of `person` with `edge` texels to an edge. Raises `InputError` where no picture shows any of it."""
    mesh = PosedMesh(person)
    return MeshDrawer(name, mesh, _texels(mesh, [_texels_in(mesh, one, edge) for one in observations], edge))


def mean_colour_mesh(person: Person, observations: Iterable[Observation]) -> MeshDrawer:
    """The mesh of `person` in the mean colour. Raises `InputError` where no picture has a foreground."""
    mesh, colour, weight = PosedMesh(person), np.zeros(3), 0.0
    for observation in observations:
        matte = observation.matte.astype(np.float64)
        colour += (observation.image * matte[..., None]).sum((0, 1)) / 255
        weight += matte.sum()
    check(weight, "baselines", "training pictures", "some with a foreground", "none")
    mean = np.broadcast_to((colour / weight).astype(np.float32), (len(mesh.faces), *lattice(EDGE).shape))
    return MeshDrawer(MEAN, mesh, mean)


def resolved_edge(person: Person, observations: Iterable[Observation]) -> int:
    """Texels to an edge at which they lie as close as the pixels of the nearest camera, `EDGE` to `FINEST_EDGE`.

    An edge is the median one at rest; a pixel's width is that at the head or the pelvis, whichever is nearer.
    """
    rest, faces = person.body.v_template.numpy(), person.body.faces.numpy()
    length = float(np.median(np.linalg.norm(rest[faces[:, 0]] - rest[faces[:, 1]], axis=1)))
    width = min((_pixel_width(one, person) for one in observations), default=length)
    return int(np.clip(np.ceil(length / width), EDGE, FINEST_EDGE))


def _pixel_width(observation: Observation, person: Person) -> float:
    joints = template_surface(person, observation.signals)[1]
    depth = observation.camera.pixels(joints, nearest=1e-3)[1]
    seen = depth[depth > 0]
    return float(seen.min() / observation.camera.intrinsics[0, 0]) if len(seen) else np.inf


def _texels_in(mesh: PosedMesh, observation: Observation, edge: int) -> UInt8[np.ndarray, "p 4"]:
    """Colours of all texels in one picture, and whether each is visible there."""
    camera, surface = observation.camera, mesh.surface(observation.signals)
    points = _on_lattice(surface.vertices[surface.faces], edge)
    pixel, depth = camera.pixels(points, nearest=1e-3)
    column, row = np.floor(pixel).astype(np.int64).T
    inside = (depth > 0.02) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    nearest = mesh.visible(observation.signals, camera)[2][row, column]
    inside &= (depth < nearest + DEPTH_TOLERANCE) & (observation.matte[row, column] >= OPAQUE)
    inside &= np.repeat(_facing(surface, camera) > FACING, len(lattice(edge)))
    colour = np.full((len(points), 4), 255, np.uint8)
    colour[:, 3] = inside
    place = pixel[inside, ::-1].T - 0.5
    for channel in range(3):
        layer = observation.image[..., channel]
        colour[inside, channel] = map_coordinates(layer, place, order=1, mode="nearest", output=np.float32).round()
    return colour


def _texels(mesh: PosedMesh, observed: list[UInt8[np.ndarray, "p 4"]], edge: int) -> Float[np.ndarray, "f t 3"]:
    """Medians over the pictures; a texel never visible has the colour of the nearest visible one at rest."""
    check(observed, "baselines", "training pictures", "some", "none")
    middle = np.concatenate([medians(np.stack(part)) for part in zip(*(np.array_split(one, 16) for one in observed))])
    known = ~np.isnan(middle[:, 0])
    check(known.any(), "baselines", "training pictures", "some that show the template", "none")
    place = _on_lattice(mesh.person.body.v_template.double().numpy()[mesh.faces], edge)
    middle[~known] = middle[known][cKDTree(place[known]).query(place[~known])[1]]
    return middle.reshape(len(mesh.faces), -1, 3)


def medians(seen: UInt8[np.ndarray, "o p 4"]) -> Float[np.ndarray, "p 3"]:
    """The median colour of each texel over o observations, in [0, 1]; those whose last byte is 0 do not count, NaN where none does."""
    counted = seen[..., 3] > 0
    ordered = np.sort(np.where(counted[..., None], seen[..., :3], np.int16(256)), axis=0)  # what counts comes first
    count = counted.sum(0)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(seen) - 1)
    middle = sum(np.take_along_axis(ordered, k[None, :, None], 0)[0].astype(np.float32) for k in (low, high)) / 2
    return np.where(count[:, None] > 0, middle, np.nan).astype(np.float32) / np.float32(255)


def look_up(texels: Float[np.ndarray, "f t 3"], face: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(p, 3) colours at barycentrics `weight` (p, 3) of `face` (p,), linear between the three texels around.

    On the lattice a point lies in a small triangle that stands upright (fractions add to one) or on its head (to two).
    """
    edge = int(np.sqrt(2 * texels.shape[1])) - 1
    first, second, _ = (edge * lattice(edge)).round().astype(int).T
    table = np.zeros((edge + 1, edge + 1), np.int64)
    table[first, second] = np.arange(len(first))
    scaled = edge * weight
    low = np.floor(scaled + 1e-9).astype(np.int64)
    part = np.clip(scaled - low, 0, 1)
    rest = edge - low.sum(1)  # 0 at a texel, 1 upright, 2 on its head
    turned = rest == 2
    share = np.where(turned[:, None], 1 - part, part)
    colour = np.zeros((len(face), 3), np.float32)
    for axis in range(3):
        step = np.eye(3, dtype=np.int64)[axis]
        corner = np.where(turned[:, None], low + 1 - step, low + np.where(rest == 1, 1, 0)[:, None] * step)
        corner = np.clip(corner, 0, edge)
        colour += share[:, axis, None] * texels[face, table[corner[:, 0], corner[:, 1]]]
    return np.where((rest == 0)[:, None], texels[face, table[low[:, 0], low[:, 1]]], colour)


def lattice(edge: int) -> Float[np.ndarray, "t 3"]:
    """Barycentrics of a face's texels, `edge` to an edge."""
    return np.array([(i, j, edge - i - j) for i in range(edge + 1) for j in range(edge + 1 - i)]) / edge


def _on_lattice(triangles: Float[np.ndarray, "f 3 3"], edge: int) -> Float[np.ndarray, "p 3"]:
    """Places of all texels."""
    places: np.ndarray = (lattice(edge)[None, :, :, None] * triangles[:, None]).sum(2)
    return places.reshape(-1, 3)


def _facing(surface: Surface, camera: Camera) -> np.ndarray:
    """(f,) cosine between a face's normal and the way to the camera."""
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    normal, way = np.cross(b - a, c - a), camera.centre - (a + b + c) / 3
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(way, axis=1)
    cosine: np.ndarray = (normal * way).sum(1) / np.maximum(length, 1e-20)
    return cosine
