"""How what is painted on the body slides over the skin as the pose changes. Ours.

    p̄' = p̄ + Σ_j s_j(p̄) (T⁻¹ A_j p̄ − p̄)

Cloth, and the skin of a person whom nobody modelled, do not follow the joints with the template's skinning weights. Had the
template weights that are larger by −s_j, its rest positions would be p̄'. s comes from the pictures (training/core/registration.py) as
a number for every node and joint; so that a pose no picture showed has its slide, too, by the same rule of skinning. Colours are
looked up at p̄', distances at p̄: the surface does not move.

Letters: n nodes, a samples (anchors), j joints of the body. Metres at rest.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from avatarrex.ops.skinning import blend, skin

JOINTS = 22
"""Pelvis and body joints."""
CARRIERS = 6
"""Joints nearest to a node, whose weights may differ."""
SIGMA = 0.04
"""Metres: σ of a node's Gaussian."""
MOST = 0.03
"""Metres that anything slides."""


class Slide(nn.Module):
    """What the skinning weights are wrong by; it knows its samples from `lay` on."""

    share: Tensor
    """(n, j) s of the nodes."""
    reach: Tensor
    """(a, n) the nodes' weights at the samples; their sum is 1, or 0 where nothing slides."""

    def __init__(self, share: Float[Tensor, "n j"]) -> None:
        super().__init__()
        self.register_buffer("share", share)
        self.register_buffer("reach", share.new_zeros(0, len(share)), persistent=False)

    @classmethod
    def none(cls, nodes: int) -> Slide:
        """Nothing slides."""
        return cls(torch.zeros(nodes, JOINTS))

    def lay(self, nodes: Float[Tensor, "n 3"], samples: Float[Tensor, "a 3"], skin: int | None = None) -> None:
        """Let nodes and samples be there at rest; on all but the first `skin` (None: all) nothing slides."""
        squared = torch.cdist(samples, nodes).square()
        self.reach = torch.softmax(-squared / (2 * SIGMA**2), 1)
        if skin is not None:
            self.reach[skin:] = 0

    def offset(
        self, rest_from_posed: Float[Tensor, "a 3 4"], skinning: Float[Tensor, "k 4 4"], rest: Float[Tensor, "a 3"]
    ) -> Float[Tensor, "a 3"]:
        """p̄' − p̄ of the samples: `share` times `slide_basis`, the sum over joints first."""
        share = self.reach @ self.share
        moved = skin(blend(skinning[:JOINTS], share), rest)
        back = (rest_from_posed[:, :, :3] @ moved[:, :, None])[:, :, 0]
        offset = back + share.sum(1, keepdim=True) * (rest_from_posed[:, :, 3] - rest)
        bounded: Tensor = offset / (1 + (offset.norm(dim=-1, keepdim=True) / MOST).square()).sqrt()
        return bounded


def slide_basis(
    rest_from_posed: Float[Tensor, "a 3 4"], skinning: Float[Tensor, "k 4 4"], rest: Float[Tensor, "a 3"]
) -> Float[Tensor, "a j 3"]:
    """T⁻¹ A_j p̄ − p̄: where each joint alone would have taken a sample, seen from rest."""
    joints = skinning[:JOINTS]
    moved = torch.einsum("jkc,ac->jak", joints[:, :3, :3], rest) + joints[:, None, :3, 3]
    back = torch.einsum("akc,jac->ajk", rest_from_posed[:, :, :3], moved) + rest_from_posed[:, None, :, 3]
    return back - rest[:, None]


def carriers(nodes: Float[Tensor, "n 3"], joints: Float[Tensor, "k 3"]) -> Bool[Tensor, "n j"]:
    """The joints of which a node's weights may differ."""
    nearest = torch.cdist(nodes, joints[:JOINTS].to(nodes)).topk(CARRIERS, largest=False).indices
    return torch.zeros(len(nodes), JOINTS, dtype=torch.bool).scatter(1, nearest, True)
