"""Evening out: texels that lie closer than they are meant to, on the small triangles of an ear drawn flat, agree in the end. Ours.

Each was seen by few pixels, and learnt alone: they are specks. So of a learnt texture each texel of a flattened fold has the mean of
those around it, by their areas.

Letters: t texels. Metres.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree
from torch import Tensor

from avatarrex.fields.detail_texture import DetailTexture, texel_count

BLUR = 0.002
"""Standard deviation of the mean: a body's texel."""
WIDE = 2.5
"""Of these, how far texels count."""
MOVED = 0.003
"""How far a vertex was moved to lie in a fold altogether."""


@torch.no_grad()
def even_folds(detail: DetailTexture, flattened: Float[Tensor, " v"]) -> None:
    """Even out the texels on triangles whose vertices were `flattened` by so many metres (fields/membrane.py)."""
    lattice = detail.lattice
    count = texel_count(lattice.edge)
    owner = np.repeat(np.arange(len(count)), count)
    share = (flattened.double().numpy() / MOVED).clip(0, 1)[lattice.faces].mean(1)[owner]
    some = np.flatnonzero(share > 0)
    if not len(some):
        return
    corner = lattice.vertices[lattice.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    own = (area / count.clip(1))[owner]
    around = cKDTree(lattice.position[some]).sparse_distance_matrix(
        cKDTree(lattice.position), WIDE * BLUR, output_type="coo_matrix"
    )
    weight = np.exp(-0.5 * (around.data / BLUR) ** 2) * own[around.col]
    total = csr_matrix((weight, (around.row, around.col)), around.shape)
    albedo = torch.sigmoid(detail.texel).double().cpu().numpy()
    mean = (total @ albedo) / np.maximum(np.asarray(total.sum(1)), 1e-30)
    found = albedo.copy()
    found[some] += share[some, None] * (mean - albedo[some])
    detail.paint(torch.from_numpy(found).to(detail.texel))
