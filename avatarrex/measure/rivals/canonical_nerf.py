"""Canonical NeRF: one MLP at the rest pose of the fitted skin, drawn by volume rendering (after Animatable NeRF, Peng et al. 2021).

A point is taken to rest by the skinning of the nearest vertices, p̄ = Σ w_k (v̄_k + A_k⁻¹ (p − v_k)), and encoded there; the MLP gives
how far the surface is off the skin, and, with the direction of view, a colour. Density is that of the distance (VolSDF), with
the avatar's quadrature and samples near the surface, whose place on the renderer's grid follows what is learnt. It begins at the
fitted skin as an avatar begins at its prior. Neither pose nor frame enters the networks: colours and cloth are the same in every pose.

Letters: p points, v vertices, n voxels near the skin, r rays, s samples. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import posed_in_world
from avatarrex.capture.readers.rigs import Rig
from avatarrex.fields.template_distance import TemplateDistance
from avatarrex.measure.rivals.rival import Rival
from avatarrex.metrics.drawing import Drawing
from avatarrex.ops.closest_vertex import closest_vertices
from avatarrex.ops.encoding import channels, encode
from avatarrex.ops.skinning import blend, invert_affine
from avatarrex.pointmap.rays import RayPlane, Rays, pixel_centres
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.person import Person
from avatarrex.training.core.pixels import draw_pixels, training_pairs
from avatarrex.training.core.sampling import Walk, draw, noise_of
from avatarrex.training.core.volume_rendering import Gamma, render_weights
from avatarrex.volume.body_grid import BOX_MARGIN, lattice_around
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume

WIDTH, HIDDEN = 128, 3
"""Channels, and layers before and after the skip."""
PLACES, DIRECTIONS = 11, 4
"""Octaves of the encodings (Mildenhall et al. 2020): the shortest waves are of 6 mm, 1.5 pixels of 512² on a whole person."""
UNIT = 0.01
"""Metres of an offset of 1: rates are those of colours, which are of this order."""
NEAR = 0.06
"""Metres about the skin in which the stored distance has the offset."""
NEIGHBOURS = 4
"""Vertices that a rest position is blended of."""
RAYS, SAMPLES, DRAWN = 1024, 8, 16
"""Rays of a step; samples of a ray in a step and in a picture."""
CHUNK = 4096
"""Rays at a time in a picture."""
GAMMA = Gamma(extra=0.005)
SHRINKING = 1 / 6
"""Share of the training's time after which γ has its last value: both as in recipe `quick`."""
CLOSE = 0.3
"""Share of the steps that see the face rig's pictures, between those of the passes of `quick`."""
KEPT = 256
"""Posed skins that are kept, 6 MiB each."""
RENEWED = 200
"""Batches after which a pose's volume follows what was learnt since, as in `quick`."""
MATTE, STILL = 0.5, 1e-3
"""Weights of the opacity's squared error and of the squared offset in units, beside that of colours."""


@dataclass(frozen=True, eq=False)
class StoredSkin:
    """A posed skin's distance on the renderer's grid."""

    grid: BodyGrid
    near: Int[Tensor, " n"]
    """Voxels near the skin."""
    rest: Float[Tensor, "n 3"]
    """Their rest positions."""

    def volume(self, offset: Float[Tensor, " n"]) -> SdfVolume:
        """With the surface that far within the skin."""
        sdf = self.grid.sdf.flatten().index_add(0, self.near, offset)
        return SdfVolume(replace(self.grid, sdf=sdf.reshape(self.grid.sdf.shape)))


@dataclass(frozen=True, eq=False)
class PosedSkin:
    """The fitted skin under one pose."""

    rest: Float[Tensor, "v 3"]
    vertices: Float[Tensor, "v 3"]
    to_rest: Float[Tensor, "v 3 3"]
    """Linear part of the inverse skinning."""
    distance: TemplateDistance
    world_from_root: Float[np.ndarray, "4 4"]

    @classmethod
    def of(cls, person: Person, signals: Signals) -> PosedSkin:
        """Of the whole template, with hands and face."""
        posed, world = posed_in_world(person, signals)
        at = posed.vertices.double().numpy()
        normals, nothing = vertex_normals(posed.vertices, person.body.faces).double().numpy(), np.zeros(len(at))
        distance = TemplateDistance.of(at, normals, nothing, nothing)
        to_rest = invert_affine(blend(posed.skinning, person.body.weights))[:, :, :3]
        return cls(person.body.v_template, posed.vertices, to_rest, distance, world)

    def at_rest(self, position: Float[Tensor, "p 3"]) -> tuple[Float[Tensor, "p 3"], Float[Tensor, " p"]]:
        """Rest positions, and signed distances to the skin."""
        points = position.double().numpy()
        apart, nearest = closest_vertices(self.distance.closest, points, NEIGHBOURS)
        guess = self.distance.of_nearest(points, apart[:, 0], nearest[:, 0]).guess
        weight = torch.from_numpy(1 / (apart**2 + 1e-6)).float()
        rows = torch.from_numpy(nearest)
        off = (self.to_rest[rows] @ (position[:, None] - self.vertices[rows])[..., None])[..., 0]
        rest = (weight[..., None] * (self.rest[rows] + off)).sum(1) / weight.sum(1, keepdim=True)
        return rest, torch.from_numpy(guess).float()

    @cached_property
    def stored(self) -> StoredSkin:
        """On voxels of the renderer's size."""
        at = self.distance.vertices
        lattice = lattice_around(np.stack([at.min(0) - BOX_MARGIN, at.max(0) + BOX_MARGIN]), RenderSettings().voxel)
        place = lattice.position(np.arange(np.prod(lattice.shape)))
        guess = torch.from_numpy(self.distance.query(place).guess).float()
        near = torch.nonzero(guess.abs() < NEAR)[:, 0]
        grid = BodyGrid(lattice.origin, lattice.voxel, guess.reshape(lattice.shape))
        return StoredSkin(grid, near, self.at_rest(torch.from_numpy(place[near.numpy()]).float())[0])


@dataclass(frozen=True)
class Marched:
    """What rays found."""

    colour: Float[Tensor, "r 3"]
    """Premultiplied."""
    opacity: Float[Tensor, " r"]
    depth: Float[Tensor, " r"]
    """t at which the light ends on average."""
    offset: Float[Tensor, " p"]
    """Metres, of the samples that were evaluated."""


class CanonicalNerf(Rival):
    """Around the skin of `person`, from the pictures of `rig` that a training reads, and of the face rig `close` in its exposure."""

    name, rate = "canonical NeRF", 1e-3

    def __init__(self, person: Person, rig: Rig, close: Rig | None = None) -> None:
        super().__init__()
        self._rigs = [(one, training_pairs(one)) for one in (rig, close) if one is not None]
        self._posed = lru_cache(KEPT)(lambda signals: PosedSkin.of(person, signals))
        self._volumes: WeakKeyDictionary[PosedSkin, tuple[int, SdfVolume]] = WeakKeyDictionary()
        self._batch = 0
        encoded = channels(PLACES)
        self.first, self.second = _layers(encoded, HIDDEN), _layers(encoded + WIDTH, HIDDEN)
        self.offset = nn.Linear(WIDTH, 1)
        self.tint = nn.Sequential(
            nn.Linear(WIDTH + channels(DIRECTIONS), WIDTH // 2), nn.ReLU(), nn.Linear(WIDTH // 2, 3)
        )
        for values in self.offset.parameters():
            nn.init.zeros_(values)

    def loss(self, rng: np.random.Generator, progress: float) -> Float[Tensor, ""]:
        """Squared errors of premultiplied colour and opacity along rays of one picture, and the squared offset."""
        rig, pairs = self._rigs[-1 if rng.random() < CLOSE else 0]
        frame, view = pairs[rng.integers(len(pairs))]
        pixels = draw_pixels(rig, view, frame, RAYS, rng, None)
        skin, camera = self._posed(rig.signals[frame]), rig.views[view].camera
        gamma = GAMMA.last + GAMMA.extra * max(0.0, 1 - progress / SHRINKING)
        volume, noise = self._learning_volume(skin), noise_of(int(rng.integers(2**31)))
        found = self._march(skin, volume, _rays(skin, camera, pixels.place), gamma, SAMPLES, noise)
        errors = (found.colour - pixels.colour).square().mean(), (found.opacity - pixels.matte).square().mean()
        return errors[0] + MATTE * errors[1] + STILL * (found.offset / UNIT).square().sum() / max(len(found.offset), 1)

    @torch.no_grad()
    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """Colours and opacity of the rays through the pixels' centres; positions are where the light ends on average, without a normal."""
        skin = self._posed(signals)
        volume, size = self._volume(skin), (camera.height, camera.width)
        rays = _rays(skin, camera, pixel_centres(camera))
        image, position = torch.zeros(len(rays.origin), 4), torch.zeros(len(rays.origin), 3)
        for rows in torch.split(torch.arange(len(image)), CHUNK):
            found = self._march(skin, volume, rays[rows], GAMMA.last, DRAWN, noise_of(0))
            image[rows] = torch.cat([found.colour, found.opacity[:, None]], -1)
            position[rows] = rays[rows].at(found.depth)
        hit = (image[:, 3] > 0.5).reshape(size).numpy()
        world = position.double().numpy() @ skin.world_from_root[:3, :3].T + skin.world_from_root[:3, 3]
        seen = np.where(hit[..., None], world.reshape(*size, 3), 0).astype(np.float32)
        return Drawing(image.clamp(0, 1).reshape(*size, 4), seen, np.zeros_like(seen), hit)

    @torch.no_grad()
    def _volume(self, skin: PosedSkin) -> SdfVolume:
        """Where the learnt surface is in this pose."""
        return skin.stored.volume(self.surface(skin.stored.rest)[0])

    def _learning_volume(self, skin: PosedSkin) -> SdfVolume:
        """The same of at most `RENEWED` batches ago."""
        self._batch += 1
        made, volume = self._volumes.get(skin, (-RENEWED, None))
        if volume is None or self._batch - made >= RENEWED:
            volume = self._volume(skin)
            self._volumes[skin] = self._batch, volume
        return volume

    def _march(
        self, skin: PosedSkin, volume: SdfVolume, rays: Rays, gamma: float, samples: int, noise: torch.Generator
    ) -> Marched:
        """`samples` of each ray that comes near the surface."""
        taken = draw(Walk(volume, rays), "near", samples, gamma, noise)
        rows = torch.nonzero(taken.used.any(1))[:, 0]
        t, way = taken.t[rows], rays.direction[rows, None].expand(-1, taken.t.shape[1], -1)
        place = rays.origin[rows, None] + t[..., None] * way
        rest, distance = skin.at_rest(place.reshape(-1, 3))
        offset, inner = self.surface(rest)
        weight, opaque = render_weights((distance + offset).reshape(t.shape), t, gamma)
        shaded = (weight[..., None] * self.colour(inner, way.reshape(-1, 3)).reshape(*t.shape, 3)).sum(1)
        nothing = torch.zeros(len(taken.t))
        return Marched(
            nothing[:, None].repeat(1, 3).index_copy(0, rows, shaded),
            nothing.index_copy(0, rows, opaque),
            nothing.index_copy(0, rows, (weight * t).sum(1) / opaque.clamp_min(1e-6)),
            offset,
        )

    def surface(self, rest: Float[Tensor, "p 3"]) -> tuple[Float[Tensor, " p"], Float[Tensor, "p c"]]:
        """Metres that the surface lies within the skin at rest positions, and what colours are made of there."""
        encoded = encode(rest, PLACES)
        inner = self.second(torch.cat([self.first(encoded), encoded], -1))
        return UNIT * self.offset(inner)[:, 0], inner

    def colour(self, inner: Float[Tensor, "p c"], way: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """Seen along unit vectors `way` of the root frame."""
        return torch.sigmoid(self.tint(torch.cat([inner, encode(way, DIRECTIONS)], -1)))


def _rays(skin: PosedSkin, camera: Camera, place: Float[Tensor, "r 2"]) -> Rays:
    """Through pixel positions of a camera in the world."""
    middle = SdfVolume(skin.stored.grid).middle
    return RayPlane.of(camera.seen_from(skin.world_from_root), middle).rays(place)


def _layers(channels_in: int, count: int) -> nn.Sequential:
    widths = (channels_in, *(WIDTH for _ in range(count - 1)))
    return nn.Sequential(*(layer for width in widths for layer in (nn.Linear(width, WIDTH), nn.ReLU())))
