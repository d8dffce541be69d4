"""How far would the truth itself come? A capture's own meshes, painted from the training's pictures, against those held out.

An avatar that knew the surface of every frame, and which point of the person each point of it is, but whose colours stay
the same in every pose: what it cannot reach is not to be had from better geometry. Texels are as far apart as an avatar's and
have the same robust mean (training/core/projection.py) of 120 pictures; of test frames only the meshes are read, to draw.

| subject | surface | colours |
|---|---|---|
| true mesh | the triangles, drawn as the baselines are | texels |
| true mesh, light | the same | texels times E(n), nine harmonics in the world |
| true volume, balanced | its distance on the renderer's grid, cast and antialiased: 2 cm, 2.5 mm about hands and face | texels |
| true volume, 5 mm | the same, everywhere of the body's voxels at level quality | texels |
| own colours | the volume of 5 mm | those of the very picture, where the points lie in it |
| fitted textured mesh | the baseline | its own |

Letters: p points of a surface, v vertices, f faces, h w pixels. World metres; sRGB in [0, 1].
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.readers import choice
from avatarrex.capture.readers.ground_truth import RigTruth
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.capture.readers.splits import sealed, with_validation
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.errors import check
from avatarrex.fields.detail_texture import DetailTexture, TexelPlaces
from avatarrex.fields.light import Light
from avatarrex.fields.light_fit import LitPixels, fit_light
from avatarrex.files.images import write_png
from avatarrex.files.json_text import write_json
from avatarrex.metrics.baselines import PIXEL_SAMPLES, fitted_meshes
from avatarrex.metrics.drawing import Drawer, Drawing
from avatarrex.metrics.evaluate import Choice, evaluate, observations, spread
from avatarrex.metrics.measures import Networks
from avatarrex.metrics.mesh import Surface
from avatarrex.metrics.report import contact_sheet, table, to_json
from avatarrex.parts.carried import PosedMesh
from avatarrex.pointmap.raycast import raycast
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person
from avatarrex.training.core.exposure import exposed_as
from avatarrex.training.core.pixels import training_pairs
from avatarrex.training.core.projection import FACING, OPAQUE, Projected, paint
from avatarrex.volume.body_grid import BOX_MARGIN, lattice_around
from avatarrex.volume.bricks import Bricks, grow_bricks
from avatarrex.volume.narrow_band import crossed
from avatarrex.volume.prefilter import prefiltered
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume

SPACING = {"body": 0.002, "face": 0.001}
"""Metres between texels, as recipes have it."""
NEAR_PARTS = 0.025
"""Metres about the template's hands and face in which they have their finer voxels."""
PICTURES = 120
"""Painted at most, with all their pixels."""
SHEET = 6
"""Pictures on a contact sheet."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Points of a true surface that a picture shows."""

    signals: Signals
    camera: Camera
    face: Int[np.ndarray, " p"]
    weight: Float[np.ndarray, "p 3"]
    position: Float[np.ndarray, "p 3"]
    normal: Float[np.ndarray, "p 3"]


@dataclass(frozen=True)
class Finer:
    """Cells of the body's grid that are cut."""

    side: int
    """Voxels along a side of each."""
    parts_alone: bool
    """Those about hands and face alone."""


BALANCED, FIVE_MM = Finer(8, True), Finer(4, False)
"""Of levels `balanced` and `quality`."""
Look = Callable[[Shown], Float[Tensor, "p 3"]]
"""Colours of points."""


class TrueMeshes:
    """The captured meshes of a rig's frames, which all have the same triangles."""

    def __init__(self, truth: RigTruth, rig: Rig, person: Person) -> None:
        self._truth, self._rig, self._person = truth, rig, person
        self.faces = truth.faces
        self.closed = closed_pieces(truth.vertices[0], truth.faces)
        self.surface = lru_cache(1)(self._surface)
        self.searched = lru_cache(1)(self._searched)
        self.volume = lru_cache(2)(self._volume)

    def _surface(self, signals: Signals) -> Surface:
        """Of the frame that has these very signals."""
        frame = next(number for number, own in enumerate(self._rig.signals) if own is signals)
        return Surface.of(self._truth.vertices[frame], self.faces)

    def _searched(self, signals: Signals) -> PosedMesh:
        vertices = torch.from_numpy(self.surface(signals).vertices)
        return PosedMesh(vertices, torch.from_numpy(self.faces), torch.from_numpy(self.closed))

    def _volume(self, signals: Signals, finer: Finer) -> SdfVolume:
        """The signed distance on the body's grid, whose cells are `finer` where the surface meets them."""
        surface, mesh = self.surface(signals), self.searched(signals)
        low, high = surface.vertices.min(0) - BOX_MARGIN, surface.vertices.max(0) + BOX_MARGIN
        lattice = lattice_around(np.stack([low, high]), RenderSettings().voxel)

        def distance(position: np.ndarray) -> np.ndarray:
            points = torch.from_numpy(position)
            return mesh.distance(points, *mesh.closest(points)).numpy().astype(np.float32)

        sdf = distance(lattice.position(np.arange(np.prod(lattice.shape)))).reshape(lattice.shape)
        grid, met = BodyGrid(lattice.origin, lattice.voxel, torch.from_numpy(sdf)), crossed(sdf < 0)
        if finer.parts_alone:
            z, y, x = met.T
            centre = grid.origin + grid.voxel * (np.stack([x, y, z], 1) + 0.5)
            met = met[cKDTree(self._parts(signals)).query(centre, distance_upper_bound=NEAR_PARTS)[0] < NEAR_PARTS]
        cells = np.ravel_multi_index(tuple(met.T), tuple(side - 1 for side in sdf.shape))
        none = Bricks.none(finer.side, sdf)
        bricks = grow_bricks(sdf, grid.voxel, none, cells, lambda place: distance(grid.origin + grid.voxel * place))
        return SdfVolume(prefiltered(replace(grid, bricks=bricks)))

    def _parts(self, signals: Signals) -> Float[np.ndarray, "k 3"]:
        """Vertices of the template's hands and face."""
        vertices: np.ndarray = template_surface(self._person, signals)[0][self._person.blend_weight.numpy().any(1)]
        return vertices

    def seen(self, signals: Signals, camera: Camera) -> tuple[Bool[np.ndarray, "h w"], Shown]:
        """Pixels whose centres' rays meet the mesh, and where."""
        surface = self.surface(signals)
        face, weight, _ = visible_faces(surface.vertices, surface.faces, camera)
        hit = face >= 0
        return hit, Shown(signals, camera, face[hit], weight[hit], *surface.at(face[hit], weight[hit]))


def closed_pieces(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Triangles of pieces in which every edge is of two; vertices at one place are one."""
    corner = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    edge = np.sort(np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]]), axis=1)
    graph = coo_array((np.ones(len(edge)), (edge[:, 0], edge[:, 1])), shape=(len(vertices),) * 2)
    piece = connected_components(graph, directed=False)[1]
    known, count = np.unique(edge, axis=0, return_counts=True)
    open_ones = piece[known[(count == 1) & (known[:, 0] != known[:, 1]), 0]]
    closed: np.ndarray = ~np.isin(piece[corner[:, 0]], open_ones)
    return closed


@dataclass(frozen=True, eq=False)
class Painted:
    """Texels on the triangles, in a light that depends on the normal."""

    detail: DetailTexture
    light: Light

    @torch.no_grad()
    def __call__(self, shown: Shown) -> Float[Tensor, "p 3"]:
        """See `Look`."""
        colour: Tensor = self.albedo(shown) * self.light(torch.from_numpy(shown.normal).float())
        return colour

    def places(self, shown: Shown) -> TexelPlaces:
        """Which texels the points lie between."""
        return self.detail.places_on(shown.face, shown.weight, np.zeros_like(shown.position))

    def albedo(self, shown: Shown) -> Float[Tensor, "p 3"]:
        """Without the light."""
        return torch.sigmoid(self.detail(self.places(shown)))


@dataclass(frozen=True, eq=False)
class OwnColours:
    """What a rig's own picture has where the points lie in it."""

    rig: Rig

    def __call__(self, shown: Shown) -> Float[Tensor, "p 3"]:
        """See `Look`."""
        frame = next(number for number, own in enumerate(self.rig.signals) if own is shown.signals)
        view = next(number for number, own in enumerate(self.rig.views) if own.camera.key() == shown.camera.key())
        picture = self.rig.image(view, frame)
        place = shown.camera.pixels(shown.position)[0].T[::-1] - 0.5
        layers = [
            map_coordinates(layer, place, np.float32, order=1, mode="nearest") for layer in np.moveaxis(picture, -1, 0)
        ]
        return torch.from_numpy(np.stack(layers, -1) / np.float32(255))


@dataclass(eq=False)
class TrueMeshDrawer:
    """The true mesh with `PIXEL_SAMPLES`² colours a pixel."""

    name: str
    meshes: TrueMeshes
    look: Look

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """See `Drawer`; geometry is that of each pixel's first sample."""
        s, height, width = PIXEL_SAMPLES, camera.height, camera.width
        hit, shown = self.meshes.seen(signals, camera.resized(width * s, height * s))
        image, position, normal = np.zeros((*hit.shape, 4), np.float32), *np.zeros((2, *hit.shape, 3), np.float32)
        image[hit, :3], image[hit, 3] = self.look(shown).numpy(), 1
        position[hit], normal[hit] = shown.position, shown.normal
        averaged = image.reshape(height, s, width, s, 4).mean((1, 3))
        return Drawing(torch.from_numpy(averaged), position[::s, ::s], normal[::s, ::s], hit[::s, ::s])


@dataclass(eq=False)
class TrueVolumeDrawer:
    """The true mesh's distance on the renderer's grid, cast as an avatar is."""

    name: str
    meshes: TrueMeshes
    look: Look
    finer: Finer

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """See `Drawer`."""
        points = raycast(self.meshes.volume(signals, self.finer), camera)
        covered, mesh = points.coverage > 0, self.meshes.searched(signals)
        position = points.position[covered].double()
        face, weight = (found.numpy() for found in mesh.closest(position))
        normal = self.meshes.surface(signals).at(face, weight)[1]
        colour = self.look(Shown(signals, camera, face, weight, position.numpy(), normal))
        image, coverage = torch.zeros(*covered.shape, 4), points.coverage[covered][:, None]
        image[covered] = torch.cat([colour * coverage, coverage], -1)
        return Drawing(points.edges.blended(image), points.position.numpy(), points.normal.numpy(), points.hit.numpy())


@dataclass(frozen=True, eq=False)
class Photographed:
    """Points that a training picture shows, and what it shows there."""

    shown: Shown
    colour: Float[Tensor, "p 3"]
    share: Float[Tensor, " p"]
    """Squared cosine at which they are seen."""


def photographs(capture: Capture, meshes: dict[str, TrueMeshes], name: str) -> Iterator[Photographed]:
    """Of both rigs' training pictures, in the exposure of rig `name`."""
    known = sealed(capture, "train").rigs
    own = known[name]
    for rig in (own, *(exposed_as(rig, own, capture.person) for rig in known.values() if rig is not own)):
        if rig.name not in meshes:
            continue
        for frame, view in spread(training_pairs(rig), PICTURES // len(known)):
            hit, shown = meshes[rig.name].seen(rig.signals[frame], rig.views[view].camera)
            gaze = shown.position - shown.camera.centre
            facing = -(gaze * shown.normal).sum(1) / np.linalg.norm(gaze, axis=1)
            counts = (facing > FACING) & (rig.matte(view, frame)[hit] >= 255 * OPAQUE)
            kept = (values[counts] for values in (shown.face, shown.weight, shown.position, shown.normal))
            colour = torch.from_numpy(rig.image(view, frame)[hit][counts] / np.float32(255))
            share = torch.from_numpy(facing[counts]).float().square()
            yield Photographed(Shown(shown.signals, shown.camera, *kept), colour, share)


def painted(surface: Surface, spacing: float, pictures: list[Photographed], lit: bool) -> Painted:
    """Texels from the pictures, laid on the mesh in one pose; `lit`: beside a light that is found with them."""
    vertices, faces = torch.from_numpy(surface.vertices), torch.from_numpy(surface.faces)
    everywhere = torch.ones(len(faces), dtype=torch.bool)
    look = Painted(DetailTexture.of(vertices, faces, spacing, everywhere), Light())
    pixels = [_lit_pixels(look, one) for one in pictures]
    with torch.no_grad():
        if lit:
            look.light.harmonics.copy_(fit_light(look.light.harmonics, pixels, len(look.detail.texel)))
        projected = [Projected(p.texel, p.weight, (p.colour / look.light(p.normal)).clamp(0, 1)) for p in pixels]
    paint(look.detail, projected, "the training's pictures")
    return look


@torch.no_grad()
def _lit_pixels(look: Painted, one: Photographed) -> LitPixels:
    places = look.places(one.shown)
    normal = torch.from_numpy(one.shown.normal).float()
    return LitPixels(places.texel, places.share * one.share[:, None], one.colour, normal)


def ceilings(capture: Capture, name: str) -> list[Drawer]:
    """All but the baseline, of rig `name`. Raises `InputError` where the capture has no meshes of it."""
    check(name in capture.ground_truth, capture.path, f"{name} rig", "ground_truth.npz", "nothing")
    meshes = {
        other: TrueMeshes(truth, capture.rigs[other], capture.person) for other, truth in capture.ground_truth.items()
    }
    own = meshes[name]
    same = {key: value for key, value in meshes.items() if np.array_equal(value.faces, own.faces)}
    pictures, rig = list(photographs(capture, same, name)), capture.rigs[name]
    posed = own.surface(next(one.shown.signals for one in pictures))
    flat, lit = (painted(posed, SPACING[name], pictures, with_light) for with_light in (False, True))
    return [
        TrueMeshDrawer("true mesh", own, flat),
        TrueMeshDrawer("true mesh, light", own, lit),
        TrueVolumeDrawer("true volume, balanced", own, flat, BALANCED),
        TrueVolumeDrawer("true volume, 5 mm", own, flat, FIVE_MM),
        TrueVolumeDrawer("own colours", own, OwnColours(rig), FIVE_MM),
    ]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which capture, and what of it is held out."""
    parser.add_argument("capture", help="a folder or .zip with ground_truth.npz")
    parser.add_argument("--rig", choices=tuple(SPACING), default="body")
    parser.add_argument("--held-out-frames", metavar="A:B:S", help="instead of the capture's own")
    parser.add_argument("--held-out-views", metavar="NAMES", help="of the rig that is measured")
    parser.add_argument("--json", metavar="FILE.json", help="every figure")
    parser.add_argument("--sheet", metavar="OUT.png", type=Path, help="a contact sheet")


def run(options: argparse.Namespace) -> None:
    """Measure and print. Raises `InputError` for a capture without meshes, such a rig or held-out frames."""
    capture, name = with_validation(open_capture(options.capture)), options.rig
    check(name in capture.rigs, options.capture, "", f"a {name} rig", ", ".join(capture.rigs))
    views = {name: options.held_out_views}
    rigs = {k: choice.held_out(rig, options.held_out_frames, views.get(k)) for k, rig in capture.rigs.items()}
    capture, rig = replace(capture, rigs=rigs), rigs[name]
    check(rig.held_out_frames, options.capture, f"{name} rig", "held-out frames", "none")
    chosen = Choice(sorted(rig.held_out_frames), sheet=SHEET if options.sheet else 0)
    subjects = [*ceilings(capture, name), *fitted_meshes(capture, capture.person, list(observations(rig)))]
    found = evaluate(capture, rig, subjects, Networks.load(), chosen, progress=True)
    print(table(found))
    if options.json:
        write_json(options.json, to_json(found, "the truth", options.capture, 0.0))
    if options.sheet:
        write_png(options.sheet, contact_sheet(found))
