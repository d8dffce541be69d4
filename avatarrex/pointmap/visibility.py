"""Hands and face that a view does not show: off screen, or behind what it shows (docs/architecture.md, skip table).

A part changes the field in its box alone. Where no ray of a picture comes into the box before it meets something else,
the picture is the same without it, and the box need not be built. Its bounds follow from the posed mesh.

Letters: p pixels, v vertices, h w image rows and columns. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pointmap.raycast import PointMap, raycast
from avatarrex.pointmap.rays import RayPlane, Rays, slab
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.limbs import reached_by_others
from avatarrex.volume.part_box import COARSEST, FACE_BAND, HAND_MARGIN
from avatarrex.volume.sdf_volume import SdfVolume
from avatarrex.volume.template_distance import TemplateDistance

GLANCE = 96
"""Pixels of the longer side of the picture that guesses what hides a part."""
NEAREST = 0.05
"""Metres before the camera: a box that begins closer counts as seen."""
ROWS = 64
"""Rows of a picture that are looked at at once."""
CHUNK = 256
"""Rays that are held against all vertices at once."""
BESIDE = 1.0
"""Pixels around a picture, or around a ray: antialiasing looks half a pixel aside."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Where a part's box is, and where in it the part may change the field: known before it is built."""

    root_from_part: Float[np.ndarray, "4 4"]
    mesh: Float[np.ndarray, "v 3"]
    """Vertices whose ω is not 0, part frame."""
    reach: float
    """Metres from them within which the part may be blended, and by which the box may stand out at most."""
    shared: bool
    """Whether another limb may be in the box: then the body differs in all of it (contact.py)."""

    @classmethod
    def of(
        cls, avatar: Avatar, posed: PosedPerson, name: str, voxel: float, skin: TemplateDistance | None = None
    ) -> Bounds:
        """Of a hand or the face, for boxes of `voxel` metres; `skin` of the posed body tells whether it is alone there."""
        face = name == "face"
        weight = avatar.person.face.blend_weight if face else avatar.hand(name).blend_weight
        mesh = posed.parts[name][weight > 0].double().numpy()
        reach = (FACE_BAND if face else HAND_MARGIN) + COARSEST * voxel
        bounds = cls(posed.root_from_part(name), mesh, reach, True)
        if skin is None:
            return bounds
        place = np.linalg.inv(bounds.root_from_part)
        shared = reached_by_others(skin, avatar.ownership[name], place, bounds.low, bounds.high)
        return replace(bounds, shared=shared)

    @property
    def low(self) -> Float[np.ndarray, "3"]:
        """The box's least corner, part frame."""
        return self.mesh.min(0) - self.reach

    @property
    def high(self) -> Float[np.ndarray, "3"]:
        """The box's greatest corner, part frame."""
        return self.mesh.max(0) + self.reach

    def seen_from(self, camera: Camera) -> Float[np.ndarray, "8 3"]:
        """The corners in the camera's frame."""
        unit = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        pose = camera.camera_from_world @ self.root_from_part
        return (self.low + unit * (self.high - self.low)) @ pose[:3, :3].T + pose[:3, 3]

    def off_screen(self, camera: Camera) -> bool:
        """Whether one side of the view frustum has all of the box on its other side."""
        corners = self.seen_from(camera)
        x, y, z = (corners @ camera.intrinsics.T).T
        right, bottom = camera.width + BESIDE, camera.height + BESIDE
        sides = (z, x + BESIDE * z, right * z - x, y + BESIDE * z, bottom * z - y)
        return any(bool((side < 0).all()) for side in sides)

    def covered(self, pointmap: PointMap, camera: Camera) -> bool:
        """Whether every ray that comes within reach of the part has met a surface before, whole pixels of it."""
        corners = self.seen_from(camera)
        if corners[:, 2].min() < NEAREST:
            return False
        pixel = (corners @ camera.intrinsics.T)[:, :2] / corners[:, 2:]
        x0, y0 = (max(int(k) - 1, 0) for k in np.floor(pixel.min(0)))
        x1, y1 = (min(int(k) + 1, most) for k, most in zip(np.ceil(pixel.max(0)), (camera.width, camera.height)))
        aside = BESIDE * corners[:, 2].max() / min(camera.intrinsics[0, 0], camera.intrinsics[1, 1])
        plane = RayPlane.of(camera, self.root_from_part[:3, 3])
        rows = range(y0, y1, ROWS)
        return not any(self._reached(pointmap, plane, aside, (x0, x1), (y, min(y + ROWS, y1))) for y in rows)

    def _reached(
        self, pointmap: PointMap, plane: RayPlane, aside: float, columns: tuple[int, int], rows: tuple[int, int]
    ) -> bool:
        """Whether a ray of these pixels comes within reach before it meets anything; reach and box widened by `aside`."""
        y, x = torch.meshgrid(torch.arange(*rows), torch.arange(*columns), indexing="ij")
        rays = plane.rays(torch.stack([x, y], -1).reshape(-1, 2).double() + 0.5)
        block = slice(*rows), slice(*columns)
        met = ((pointmap.position[block].reshape(-1, 3).double() - rays.origin) * rays.direction).sum(-1)
        met = met.masked_fill(pointmap.coverage[block].reshape(-1) < 1 - 1e-6, torch.inf)
        turn, place = torch.as_tensor(self.root_from_part[:3, :3]), torch.as_tensor(self.root_from_part[:3, 3])
        local = Rays((rays.origin - place) @ turn, rays.direction @ turn, rays.camera)
        size = torch.as_tensor(self.high - self.low + 2 * aside)
        entry, exit = slab(local.origin - torch.as_tensor(self.low - aside), local.direction, size)
        left = torch.nonzero((entry < exit) & (met >= entry))[:, 0]
        if self.shared:
            return len(left) > 0
        return any(self._meets(local[some], met[some], self.reach + aside) for some in left.split(CHUNK))

    def _meets(self, rays: Rays, met: Float[Tensor, " p"], reach: float) -> bool:
        """Whether one of the rays (part frame) comes within `reach` of a vertex before it has gone `met`."""
        offset = torch.as_tensor(self.mesh) - rays.origin[:, None]
        along = (offset * rays.direction[:, None]).sum(-1)
        beside = (offset - along[..., None] * rays.direction[:, None]).norm(dim=-1)
        return bool(((beside < reach) & (along - reach < met[:, None])).any())


def hidden_behind(
    bounds: dict[str, Bounds], volume: SdfVolume, camera: Camera, impl: str, counters: Counters
) -> frozenset[str]:
    """Parts that seem to be behind the body's surface, by a small picture of the volume without them."""
    scale = max(1.0, max(camera.width, camera.height) / GLANCE)
    small = camera.resized(max(1, round(camera.width / scale)), max(1, round(camera.height / scale)))
    seen = raycast(volume, small, impl, antialias=False)
    counters.update(seen.counters)
    return frozenset(name for name, part in bounds.items() if part.covered(seen, small))
