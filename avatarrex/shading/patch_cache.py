"""Feature patches of one body pose, each decoded when a pixel first lies in its node's support: half of them are never seen."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.fields.patches import NoPatches, PatchNetwork


@dataclass(frozen=True, eq=False)
class PatchCache:
    """Fills up while its pose is looked at; every frame of that pose shares it."""

    network: PatchNetwork | NoPatches
    embedding: Float[Tensor, "n e"]
    value: Float[Tensor, "n c s s"]
    """Of no meaning where not decoded. In memory a texel's channels are adjacent, as they are read."""
    decoded: Bool[Tensor, " n"]

    @staticmethod
    def of(network: PatchNetwork | NoPatches, embedding: Float[Tensor, "n e"]) -> PatchCache:
        """Nothing is decoded yet."""
        count = len(embedding)
        shape = network(embedding, torch.zeros(0, dtype=torch.int64)).shape[1:]
        value = embedding.new_zeros(count, *shape).contiguous(memory_format=torch.channels_last)
        return PatchCache(network, embedding, value, torch.zeros(count, dtype=torch.bool))

    def moved(self, embedding: Float[Tensor, "n e"]) -> PatchCache:
        """The cache of another pose, with the patches of the nodes whose embedding is the same."""
        same = self.decoded & (embedding == self.embedding).all(1)
        return PatchCache(self.network, embedding, self.value.clone(), same)

    def decode(self, nodes: Int[Tensor, " k"]) -> int:
        """Make the patches of the `nodes` (repeats allowed) ready; how many were not yet."""
        wanted = torch.zeros_like(self.decoded)
        wanted[nodes] = True
        missing = torch.nonzero(wanted & ~self.decoded)[:, 0]
        if len(missing):
            with torch.no_grad():
                self.value[missing] = self.network(self.embedding, missing)
            self.decoded[missing] = True
        return len(missing)
