"""A face of another body shape than the trained one: the template carries what was learnt. Ours.

The networks are evaluated for the trained shape at q = p − u, where u is the way of the closest point of the skin from the trained
shape to this one, in the same expression: s(p; β) = s_F(q). β moves what is near together, so that distances stay but for its stretch,
some 5 % a standard deviation. What lies beneath the skin, eyes and teeth, goes with it: between a closed lid and its eyeball two
ways of their own would tear the lid. Head frame, metres. Letters: v vertices, f faces, p points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.search_tree import SearchTree


@dataclass(frozen=True, eq=False)
class Reshaped:
    """A mesh, its skin, and how far it is from that of the trained shape."""

    vertices: Float[Tensor, "v 3"]
    """float64."""
    skin: Int[Tensor, "f 3"]
    way: Float[Tensor, "v 3"]
    """u of each vertex, float64."""

    @cached_property
    def _tree(self) -> SearchTree:
        return SearchTree.of_triangles(self.vertices.numpy(), self.skin.numpy())

    @torch.no_grad()
    def back(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """q; of the points' type."""
        found = closest_triangle(self._tree, position.detach().double().cpu().numpy())
        face, weight = (torch.from_numpy(each) for each in found)
        return position - (weight[..., None] * self.way[self.skin[face]]).sum(1).to(position)
