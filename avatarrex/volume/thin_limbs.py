"""Thin limbs: forearms and wrists are stored in bricks whatever a view meets (`RenderSettings.thin`).

Between voxels of side h a limb of radius R is up to h²/8R too thin, h²/12R on average: 2.5 and 1.7 mm of a wrist of 2 cm by voxels of
2 cm, a quarter of that by half of them. The prefilter (prefilter.py) takes the average away. Which cells are cut depends on the body alone:
a turned view finds them there, and pass II, distillation and metrics see the same. Levels that cut cells where a view meets them (`fine`,
`quality`) have those alone.

Letters: v template vertices, c cells. Root frame, metres.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from avatarrex.counters import Counters
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.ops.closest_vertex import closest_vertex
from avatarrex.volume.body_grid import refined
from avatarrex.volume.bricks import Bricks
from avatarrex.volume.narrow_band import crossed
from avatarrex.volume.sdf_volume import BodyGrid

RINGS = 1
"""How many cells the bricks follow the surface into cells that the grid has none in. Each is a round of evaluations."""


def with_thin_limbs(
    body: BodyWithoutHands, grid: BodyGrid, thin: Bool[np.ndarray, " v"], side: int, counters: Counters
) -> BodyGrid:
    """`grid` with bricks of side³ voxels where it holds surface nearest to `thin` vertices; itself where it holds none."""
    cell = crossed(grid.sdf.numpy() < 0)
    centre = grid.origin + grid.voxel * (cell[:, ::-1] + 0.5)
    cell = cell[thin[closest_vertex(body.skin.closest, centre)[1]]]
    if not len(cell):
        return grid
    seen = np.ravel_multi_index(tuple(cell.T), tuple(n - 1 for n in grid.sdf.shape))
    return refined(body, grid, seen, Bricks.none(side, grid.sdf.numpy()), counters, RINGS)
