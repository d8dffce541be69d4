"""Dynamic feature patches (paper sec. 3.1): F_i = conv(learnable 2-D encoding, e_i), f_i = Bilinear(F_i, Π_i p_i).

Every node has its own tiny network of 3×3 convolutions with all maps 32×32. Borders are replicated, so that e_i,
constant over the map, acts through the first layer's bias alone and never becomes a map.

A patch covers ±`EXTENT` in the plane across the node's normal; beyond it the border texel is repeated. Texel centres lie at
(j + ½)·2·EXTENT/32 − EXTENT: 6.9 mm apart.

Letters: n nodes, c channels, k pairs. Plane coordinates in metres.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from avatarrex.fields import loops
from avatarrex.fields.patch_loops import SIDE, decode
from avatarrex.ops import native

PATCH_PIXELS = SIDE
FEW = 2
"""Patches up to which one thread is done before others have started."""
EXTENT = 0.11
"""Half side of a patch, metres: 90 % of the blend weight lies within 0.108 m of a node."""


class PatchNetwork(nn.Module):
    """N tiny convolutional networks and their positional encodings."""

    def __init__(self, nodes: int, embedding: int, encoding: int, hidden: Sequence[int], out: int) -> None:
        super().__init__()
        self.encoding = nn.Parameter(0.1 * torch.randn(nodes, encoding, PATCH_PIXELS, PATCH_PIXELS))
        self.kernels = nn.ParameterList()
        self.biases = nn.ParameterList()
        widths = (encoding + embedding, *hidden, out)
        for fan_in, fan_out in itertools.pairwise(widths):
            bound = math.sqrt(6 / (9 * fan_in))
            self.kernels.append(nn.Parameter(torch.empty(nodes, fan_out, fan_in, 3, 3).uniform_(-bound, bound)))
            self.biases.append(nn.Parameter(torch.zeros(nodes, fan_out)))

    def forward(
        self, embedding: Float[Tensor, "n e"], nodes: Int[Tensor, " m"] | None = None, impl: str = "auto"
    ) -> Float[Tensor, "m c s s"]:
        """Patches of all nodes, or of those listed in `nodes`. `impl`: `auto`, `torch`."""
        if nodes is not None and not len(nodes):
            return self.encoding.new_zeros(0, self.biases[-1].shape[1], PATCH_PIXELS, PATCH_PIXELS)
        chosen = torch.arange(len(embedding), device=embedding.device) if nodes is None else nodes
        channels = self.encoding.shape[1]
        constant = torch.einsum("ne,noeyx->no", embedding[chosen], self.kernels[0][:, :, channels:][chosen])
        biases = [self.biases[0][chosen] + constant, *(bias[chosen] for bias in self.biases[1:])]
        if impl == "auto" and native.serves(embedding, self.encoding, *self.kernels, *biases):
            return self._decoded(chosen, biases)
        maps, kernel = self.encoding[chosen], self.kernels[0][:, :, :channels]
        maps = _grouped(maps, kernel[chosen], biases[0])
        for kernel, bias in zip(self.kernels[1:], biases[1:]):
            maps = _grouped(F.relu(maps), kernel[chosen], bias)
        return maps

    def _decoded(self, nodes: Tensor, biases: Sequence[Tensor]) -> Tensor:
        """By compiled loops; in memory a texel's channels are adjacent."""
        out = np.empty((len(nodes), PATCH_PIXELS, PATCH_PIXELS, biases[-1].shape[1]), np.float32)
        kernels = tuple(kernel.detach().contiguous().numpy() for kernel in self.kernels)
        encoding = self.encoding.detach().contiguous().numpy()
        added = tuple(bias.detach().contiguous().numpy() for bias in biases)
        native.spread(decode, len(nodes), nodes.numpy(), encoding, kernels, added, out, few=FEW)
        return torch.from_numpy(out).permute(0, 3, 1, 2)


class NoPatches(nn.Module):
    """Patches without channels: local colours from the MLPs alone (the paper's baseline)."""

    def forward(
        self, embedding: Float[Tensor, "n e"], nodes: Int[Tensor, " m"] | None = None
    ) -> Float[Tensor, "m 0 s s"]:
        """See `PatchNetwork`."""
        return embedding.new_zeros(len(embedding) if nodes is None else len(nodes), 0, PATCH_PIXELS, PATCH_PIXELS)


def patches_reference(network: PatchNetwork | NoPatches, embedding: Float[Tensor, "n e"]) -> Float[Tensor, "n c s s"]:
    """Node by node, e_i as constant maps beside the positional encoding."""
    if isinstance(network, NoPatches):
        return network.forward(embedding)
    rows = []
    for node, code in enumerate(embedding):
        maps = torch.cat([network.encoding[node], code[:, None, None].expand(-1, PATCH_PIXELS, PATCH_PIXELS)])[None]
        for layer, (kernel, bias) in enumerate(zip(network.kernels, network.biases)):
            if layer:
                maps = F.relu(maps)
            maps = F.conv2d(F.pad(maps, (1, 1, 1, 1), mode="replicate"), kernel[node], bias[node])
        rows.append(maps[0])
    return torch.stack(rows)


def patch_features(
    patches: Float[Tensor, "n c s s"],
    node: Int[Tensor, " k"],
    axes: Float[Tensor, "n 2 3"],
    local: Float[Tensor, "k 3"],
    impl: str = "auto",
) -> Float[Tensor, "k c"]:
    """f_i where `local`, metres from the node, falls on its plane: `axes` of u (right) and v (down). `impl`: `auto`, `torch`."""
    if impl == "torch" or not (patches.shape[1] and native.serves(patches, axes, local)):
        plane = (axes.flatten(1).T.contiguous().index_select(1, node).reshape(2, 3, -1) * local.T).sum(1).T
        return sample_patches(patches, node, plane)
    out = np.empty((len(local), patches.shape[1]), np.float32)
    tables = patches.permute(0, 2, 3, 1).contiguous(), node, axes.contiguous(), local.T.contiguous()
    native.spread(loops.sample_patches, len(local), *(table.numpy() for table in tables), np.float32(EXTENT), out)
    return torch.from_numpy(out)


def sample_patches(
    patches: Float[Tensor, "n c s s"], node: Int[Tensor, " k"], plane: Float[Tensor, "k 2"]
) -> Float[Tensor, "k c"]:
    """Bilinear features at plane coordinates (u right, v down the rows), metres from the node."""
    nodes, channels, size, _ = patches.shape
    if not channels:
        return plane.new_zeros(len(plane), 0)
    texel = ((plane / EXTENT + 1) * (size / 2) - 0.5).clamp(0, size - 1)
    low = texel.detach().floor().clamp_max(size - 2)
    part = texel - low
    u, v = part.unbind(-1)
    corner = node * (size * size) + low[:, 1].long() * size + low[:, 0].long()
    index = torch.stack([corner, corner + 1, corner + size, corner + size + 1], 1)
    weight = torch.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], 1)
    table = patches.permute(0, 2, 3, 1).reshape(nodes * size * size, -1)
    return F.embedding_bag(index, table, per_sample_weights=weight, mode="sum")


def sample_patches_reference(
    patches: Float[Tensor, "n c s s"], node: Int[Tensor, " k"], plane: Float[Tensor, "k 2"]
) -> Float[Tensor, "k c"]:
    """The same with torch's own grid sampler."""
    grid = (plane / EXTENT)[:, None, None]
    return F.grid_sample(patches[node], grid, padding_mode="border", align_corners=False)[:, :, 0, 0]


def _grouped(maps: Tensor, kernel: Tensor, bias: Tensor) -> Tensor:
    """One 3×3 convolution per node."""
    padded = F.pad(maps, (1, 1, 1, 1), mode="replicate")
    out = F.conv2d(padded.flatten(0, 1)[None], kernel.flatten(0, 1), bias.flatten(), groups=len(maps))
    return out[0].reshape(len(maps), -1, *out.shape[2:])
