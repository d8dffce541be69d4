"""Which cells of the body grid a view sees: a raycast on a raster just fine enough to meet each of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from avatarrex.camera import Camera
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast import raycast
from avatarrex.pointmap.rays import RayPlane
from avatarrex.volume.sdf_volume import SdfVolume

PITCH = 0.7
"""Body voxels between neighbouring rays, at the volume's middle."""


def visible_cells(volume: SdfVolume, camera: Camera, impl: str = "auto") -> tuple[Int[np.ndarray, " m"], PointMap]:
    """Flat indices (z, y, x) of the cells that rays of `camera` (root frame) end in, and the coarse point map.

    Of pixels closer than `PITCH` voxels only some are cast: a cell's neighbours follow by its surface (bricks.py).
    """
    footprint = RayPlane.of(camera, volume.middle).footprint * np.sqrt(2)
    fewer = max(1, int(PITCH * volume.body.voxel / footprint))
    coarse = camera.resized(-(-camera.width // fewer), -(-camera.height // fewer))
    seen = raycast(volume, coarse, impl, antialias=False)
    position = seen.position[seen.hit].double().numpy()
    cells = np.array(volume.body.sdf.shape) - 1
    place = np.floor((position - volume.body.origin) / volume.body.voxel).astype(int)[:, ::-1]
    place = place[((place >= 0) & (place < cells)).all(1)]
    return np.unique(np.ravel_multi_index(tuple(place.T), tuple(cells))), seen
