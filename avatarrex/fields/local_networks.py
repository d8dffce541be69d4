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

from avatarrex.ops.encoding import Encoding
from avatarrex.ops.local_mlp import fold, local_mlp


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


def mlp(widths: Sequence[int], activation: str) -> nn.Sequential:
    """Linear layers of the given widths with activations between them."""
    layers: list[nn.Module] = []
    for fan_in, fan_out in itertools.pairwise(widths):
        layers += [nn.Linear(fan_in, fan_out), nn.ELU() if activation == "elu" else nn.ReLU()]
    return nn.Sequential(*layers[:-1])
