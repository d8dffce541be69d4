"""The mesh at rest on which the body's texels lie: the template, raised to where its clothes are, with its folds drawn flat. Ours.

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
from avatarrex.templates.model import TemplateModel

EVEN = 6
"""How often heights and normals are averaged with those next to them: a raised mesh must not fold in an armpit."""


def texel_mesh(template: TemplateModel, height: Float[Tensor, " v"] | None) -> Float[Tensor, "v 3"]:
    """The vertices, each `height` along its evened normal; None of avatars whose texels lie on the skin."""
    place = template.v_template.double()
    if height is not None:
        normal = torch.nn.functional.normalize(_evened(template, template.normals.double()), dim=-1)
        place = place + height.double()[:, None] * normal
    return membrane(place, template.faces)


def texel_height(template: TemplateModel, clothing_offset: Float[Tensor, " v"]) -> Float[Tensor, " v"]:
    """How high the texels lie above a template that wears clothes so thick; none lies below it."""
    height: Tensor = _evened(template, clothing_offset.clamp_min(0).double()[:, None])[:, 0].to(clothing_offset)
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
