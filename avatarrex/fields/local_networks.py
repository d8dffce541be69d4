"""Parameters of N local MLPs and of the blending MLP that follows them (paper sec. 3.1 and appendix).

Letters: n nodes, k (point, node) pairs sorted by node, e channels that are constant per node, c channels per pair.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from avatarrex.ops import native
from avatarrex.ops.encoding import Encoding, channels
from avatarrex.ops.local_mlp import fold, local_mlp

MANY = 256
"""Rows from which compiled loops are ahead of torch: they lay out the weights at every call."""


class LocalNetworks(nn.Module):
    """N MLPs (c + e) → hidden → o of equal widths, linear at the end."""

    def __init__(
        self, nodes: int, varying: int, constant: int, hidden: Sequence[int], out: int, activation: str
    ) -> None:
        super().__init__()
        self.activation = activation
        widths = (varying + constant, *hidden, out)
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for fan_in, fan_out in itertools.pairwise(widths):
            bound = math.sqrt(3 / fan_in)
            self.weights.append(nn.Parameter(torch.empty(nodes, fan_in, fan_out).uniform_(-bound, bound)))
            self.biases.append(nn.Parameter(torch.zeros(nodes, fan_out)))

    def forward(
        self,
        blocks: Sequence[Float[Tensor, "k _"] | Encoding],
        constant: Float[Tensor, "n e"],
        offsets: Int[Tensor, " m"],
        impl: str = "auto",
    ) -> Float[Tensor, "k o"]:
        """Features of every pair from its varying inputs, in blocks of channels, and its node's constant ones."""
        first, bias = fold(self.weights[0], self.biases[0], constant)
        weights, biases = [first, *self.weights[1:]], [bias, *self.biases[1:]]
        return local_mlp(blocks, offsets, weights, biases, self.activation, impl)


class Mlp(nn.Sequential):
    """Linear layers with the same activation between them: one network for all rows, in the compiled loops of N where those serve."""

    def __init__(self, widths: Sequence[int], activation: str) -> None:
        layers: list[nn.Module] = []
        for fan_in, fan_out in itertools.pairwise(widths):
            layers += [nn.Linear(fan_in, fan_out), nn.ELU() if activation == "elu" else nn.ReLU()]
        super().__init__(*layers[:-1])
        self.activation = activation

    def forward(self, input: Float[Tensor, "*p c"]) -> Float[Tensor, "*p o"]:
        """Layer after layer."""
        rows = input.reshape(-1, input.shape[-1])
        if self._compiled(len(rows), input):
            return self._native([rows], len(rows)).reshape(*input.shape[:-1], -1)
        for layer in self:
            input = layer(input)
        return input

    def of_blocks(self, blocks: Sequence[Float[Tensor, "p _"] | Encoding]) -> Float[Tensor, "p o"]:
        """Of `blocks` of channels side by side. One may be an `Encoding`: compiled loops work it out for the rows in hand."""
        given = [block.x if isinstance(block, Encoding) else block for block in blocks]
        if self._compiled(len(given[0]), *given):
            return self._native(blocks, len(given[0]))
        values = [block.values() if isinstance(block, Encoding) else block for block in blocks]
        out: Tensor = self(torch.cat(values, -1))
        return out

    def _compiled(self, rows: int, *given: Tensor) -> bool:
        return rows >= MANY and native.serves(*given, *self.parameters())

    def _native(self, blocks: Sequence[Tensor | Encoding], rows: int) -> Tensor:
        """As the networks of a single node; the encoding comes first there, and its weights with it."""
        linear = [layer for layer in self if isinstance(layer, nn.Linear)]
        weights, biases = [layer.weight.T[None] for layer in linear], [layer.bias[None] for layer in linear]
        first = sorted(range(len(blocks)), key=lambda k: not isinstance(blocks[k], Encoding))
        if len(blocks) > 1:
            split = weights[0].split([_width(block) for block in blocks], 1)
            weights[0] = torch.cat([split[k] for k in first], 1)
        offsets = torch.tensor([0, rows])
        return local_mlp([blocks[k] for k in first], offsets, weights, biases, self.activation, "native")


def _width(block: Tensor | Encoding) -> int:
    return channels(block.octaves, block.x.shape[1]) if isinstance(block, Encoding) else block.shape[1]


def mlp(widths: Sequence[int], activation: str) -> Mlp:
    """A network of the given widths, `elu` or `relu` between its layers."""
    return Mlp(widths, activation)
