"""Canonical NeRF: one MLP at the rest pose of the fitted skin, drawn by volume rendering (after Animatable NeRF, Peng et al. 2021).

A point is taken to rest by the skinning of the nearest vertices, p̄ = Σ w_k (v̄_k + A_k⁻¹ (p − v_k)), and encoded there; the MLP gives
how far the surface is off the skin, and, with the direction of view, a colour. Density is that of the distance (VolSDF), with
the avatar's quadrature, schedule of γ and samples near the surface, so that it begins at the fitted skin as an avatar begins at its
prior. No pose enters the networks: colours and cloth are the same in every pose.

Letters: p points, v vertices, r rays, s samples. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
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
PLACES, DIRECTIONS = 10, 4
"""Octaves of the encodings (Mildenhall et al. 2020)."""
NEIGHBOURS = 4
"""Vertices that a rest position is blended of."""
RAYS, SAMPLES, DRAWN = 1024, 8, 16
"""Rays of a step; samples of a ray in a step and in a picture."""
CHUNK = 4096
"""Rays at a time in a picture."""
GAMMA = Gamma()
SHRINKING = 0.5
"""Share of the training's time after which γ has its last value."""
MATTE, STILL = 0.5, 0.1
"""Weights of the opacity's squared error and of the squared offset (m²), beside that of colours."""


@dataclass(frozen=True, eq=False)
class PosedSkin:
    """The fitted skin under one pose."""

    rest: Float[Tensor, "v 3"]
    vertices: Float[Tensor, "v 3"]
    to_rest: Float[Tensor, "v 3 3"]
    """Linear part of the inverse skinning."""
    distance: TemplateDistance
    volume: SdfVolume
    """Its distance on the renderer's grid, for samples."""
    world_from_root: np.ndarray

    @classmethod
    def of(cls, person: Person, signals: Signals) -> PosedSkin:
        """Of the whole template, with hands and face."""
        posed, world = posed_in_world(person, signals)
        at = posed.vertices.double().numpy()
        normals, nothing = vertex_normals(posed.vertices, person.body.faces).double().numpy(), np.zeros(len(at))
        distance = TemplateDistance.of(at, normals, nothing, nothing)
        to_rest = invert_affine(blend(posed.skinning, person.body.weights))[:, :, :3]
        box = np.stack([at.min(0) - BOX_MARGIN, at.max(0) + BOX_MARGIN])
        lattice = lattice_around(box, RenderSettings().voxel)
        guess = distance.query(lattice.position(np.arange(np.prod(lattice.shape)))).guess.astype(np.float32)
        grid = BodyGrid(lattice.origin, lattice.voxel, torch.from_numpy(guess.reshape(lattice.shape)))
        return cls(person.body.v_template, posed.vertices, to_rest, distance, SdfVolume(grid), world)

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


class CanonicalNerf(Rival):
    """Around the skin of `person`, from the pictures of `rig` that a training reads."""

    name, rate = "canonical NeRF", 1e-3

    def __init__(self, person: Person, rig: Rig) -> None:
        super().__init__()
        self._rig, self._pairs = rig, training_pairs(rig)
        self._posed = lru_cache(len(rig.signals))(lambda signals: PosedSkin.of(person, signals))
        encoded = channels(PLACES)
        self.first, self.second = _layers(encoded, HIDDEN), _layers(encoded + WIDTH, HIDDEN)
        self.offset = nn.Linear(WIDTH, 1)
        self.colour = nn.Sequential(
            nn.Linear(WIDTH + channels(DIRECTIONS), WIDTH // 2), nn.ReLU(), nn.Linear(WIDTH // 2, 3)
        )
        for values in self.offset.parameters():
            nn.init.zeros_(values)

    def loss(self, rng: np.random.Generator, progress: float) -> Float[Tensor, ""]:
        """Squared errors of premultiplied colour and opacity along rays of one picture, and the squared offset."""
        frame, view = self._pairs[rng.integers(len(self._pairs))]
        pixels = draw_pixels(self._rig, view, frame, RAYS, rng, None)
        skin, camera = self._posed(self._rig.signals[frame]), self._rig.views[view].camera
        rays = _plane(skin, camera).rays(pixels.place)
        gamma = GAMMA.last + GAMMA.extra * max(0.0, 1 - progress / SHRINKING)
        colour, opacity, offset = self._march(skin, rays, gamma, SAMPLES, noise_of(int(rng.integers(2**31))))
        errors = (colour - pixels.colour).square().mean(), (opacity - pixels.matte).square().mean()
        return errors[0] + MATTE * errors[1] + STILL * offset.square().sum() / max(len(offset), 1)

    @torch.no_grad()
    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """Colours and opacity of the rays through the pixels' centres; no surface."""
        skin = self._posed(signals)
        view = camera.seen_from(skin.world_from_root)
        rays, image = _plane(skin, camera).rays(pixel_centres(view)), torch.zeros(camera.height * camera.width, 4)
        for rows in torch.split(torch.arange(len(image)), CHUNK):
            colour, opacity, _ = self._march(skin, rays[rows], GAMMA.last, DRAWN, noise_of(0))
            image[rows] = torch.cat([colour, opacity[:, None]], -1)
        image = image.clamp(0, 1).reshape(camera.height, camera.width, 4)
        nothing = np.zeros((camera.height, camera.width, 3), np.float32)
        return Drawing(image, nothing, nothing, (image[..., 3] > 0.5).numpy())

    def _march(
        self, skin: PosedSkin, rays: Rays, gamma: float, samples: int, noise: torch.Generator
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Premultiplied colour (r, 3) and opacity (r,) of rays; offsets (p,) of the samples that were evaluated."""
        taken = draw(Walk(skin.volume, rays), "near", samples, gamma, noise)
        rows = torch.nonzero(taken.used.any(1))[:, 0]
        colour, opacity = torch.zeros(len(rays.origin), 3), torch.zeros(len(rays.origin))
        if not len(rows):
            return colour, opacity, torch.zeros(0)
        t, way = taken.t[rows], rays.direction[rows]
        place = (rays.origin[rows, None] + t[..., None] * way[:, None]).reshape(-1, 3)
        rest, distance = skin.at_rest(place)
        offset, painted = self(rest, way[:, None].expand(-1, t.shape[1], -1).reshape(-1, 3))
        weight, opaque = render_weights((distance + offset).reshape(t.shape), t, gamma)
        shaded = (weight[..., None] * painted.reshape(*t.shape, 3)).sum(1)
        return colour.index_copy(0, rows, shaded), opacity.index_copy(0, rows, opaque), offset

    def forward(
        self, rest: Float[Tensor, "p 3"], way: Float[Tensor, "p 3"]
    ) -> tuple[Float[Tensor, " p"], Float[Tensor, "p 3"]]:
        """Metres that the surface lies within the skin, and colours, at rest positions seen along `way`."""
        encoded = encode(rest, PLACES)
        inner = self.second(torch.cat([self.first(encoded), encoded], -1))
        colour = self.colour(torch.cat([inner, encode(way, DIRECTIONS)], -1))
        return self.offset(inner)[:, 0], torch.sigmoid(colour)


def _plane(skin: PosedSkin, camera: Camera) -> RayPlane:
    return RayPlane.of(camera.seen_from(skin.world_from_root), skin.volume.middle)


def _layers(channels_in: int, count: int) -> nn.Sequential:
    widths = (channels_in, *(WIDTH for _ in range(count - 1)))
    return nn.Sequential(*(layer for width in widths for layer in (nn.Linear(width, WIDTH), nn.ReLU())))
