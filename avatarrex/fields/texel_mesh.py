"""The mesh at rest on which the body's texels lie: the template with its folds drawn flat, raised to where its clothes are. Ours.

p̄ of cloth lies up to 3 cm off the skin. Its closest places on the skin gather on edges that are convex and jump across those that are
not, by as much as the cloth is off times the angle, so that a printed stripe was in pieces, one a triangle. On a mesh that lies in the
cloth they follow each other.

Letters: v vertices. Metres.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import csr_array, diags_array, eye_array
from torch import Tensor

from avatarrex.fields.membrane import membrane
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.model import EYES, MOUTH, TemplateModel

EVEN = 6
"""How often heights and normals are averaged with those next to them: a raised mesh must not fold in an armpit."""


def texel_mesh(template: TemplateModel, height: Float[Tensor, " v"] | None) -> Float[Tensor, "v 3"]:
    """The vertices, in folds drawn flat, each `height` along its evened normal; None of avatars whose texels lie on the skin."""
    place = membrane(template.v_template, template.faces)
    if height is None:
        return place
    normal = torch.nn.functional.normalize(_evened(template, vertex_normals(place, template.faces)), dim=-1)
    return place + height.double()[:, None] * normal


def flattened(template: TemplateModel) -> Float[Tensor, " v"]:
    """Metres that vertices are moved by as parts of a fold."""
    moved: Tensor = (membrane(template.v_template, template.faces) - template.v_template).norm(dim=1)
    return moved


def texel_height(template: TemplateModel, clothing_offset: Float[Tensor, " v"]) -> Float[Tensor, " v"]:
    """How high the texels lie above the template, of clothes `clothing_offset` thick; none lies below it. Of eyeballs, mouth and folds that
    is their depth in flesh: they count as bare.
    """
    bare = template.of_groups((*EYES, *MOUTH)) | (flattened(template) > 0)
    thick = torch.where(bare, 0, clothing_offset.clamp_min(0)).double()
    height: Tensor = _evened(template, thick[:, None])[:, 0].to(clothing_offset)
    return height


def _evened(template: TemplateModel, values: Float[Tensor, "v c"]) -> Float[Tensor, "v c"]:
    faces, count = template.faces.numpy(), len(template.v_template)
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = csr_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    beside = ((edges + edges.T) > 0).astype(float) + eye_array(count)
    mean = diags_array(1 / beside.sum(1)) @ beside
    found = values.numpy()
    for _ in range(EVEN):
        found = mean @ found
    return torch.from_numpy(found)
