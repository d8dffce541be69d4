"""One small MLP per node, evaluated on rows that are grouped by node (paper sec. 3.1: 𝒢_i and 𝒞_i).

    h_0 = x_k,   h_{l+1} = a(W_{l,i} h_l + b_{l,i}),   y_k = W_{L,i} h_L + b_{L,i},   i = node of row k

What is constant per node and frame (the detail embedding e_i) does not enter the rows: `fold` adds its product with the
first layer's weights to the first bias. The rows may come in several blocks of channels (coordinates, patch features),
which saves joining them. The last layer is linear.

Letters: k rows sorted by node, n nodes, c input, o output channels. `offsets[i] : offsets[i+1]` are the rows of node i.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.ops.encoding import Encoding
from avatarrex.ops.local_mlp_loops import CHANNELS, OUTPUTS, chunks, forward, padded
from avatarrex.ops.native import serves, spread

CHUNKS = (16, 256)
"""Rows of one chunk of `bucket`, at least and at most: a quarter of a node's rows, as padding wastes half a chunk per node."""

FEW = 16384
"""Rows up to which `bucket` wins over `loop` on a CPU: 128 nodes take `loop` 400 calls however few the rows
(16 ms against 3 for 740 rows)."""
FEW_CHUNKS = 16
"""Chunks up to which one thread is done before others have started."""


DIFFERENTIABLE = ("reference", "loop", "bucket")
"""Implementations that gradients pass, the reference first."""


def available() -> tuple[str, ...]:
    """All implementations; `native` for float32 on a CPU."""
    return (*DIFFERENTIABLE, "native")


def fold(
    weight: Float[Tensor, "n c o"], bias: Float[Tensor, "n o"], constant: Float[Tensor, "n e"]
) -> tuple[Float[Tensor, "n r o"], Float[Tensor, "n o"]]:
    """First layer for the remaining r = c − e rows, the last e inputs being `constant` per node."""
    rows = weight.shape[1] - constant.shape[1]
    return weight[:, :rows], bias + torch.einsum("ne,neo->no", constant, weight[:, rows:])


def local_mlp(
    blocks: Sequence[Float[Tensor, "k _"] | Encoding],
    offsets: Int[Tensor, " m"],
    weights: Sequence[Float[Tensor, "n _ _"]],
    biases: Sequence[Float[Tensor, "n _"]],
    activation: str,
    impl: str = "auto",
) -> Float[Tensor, "k o"]:
    """y for every row; `activation` is `elu` or `relu`, `offsets` has n + 1 entries, `impl` is one of `available()`.

    The first of the `blocks` may be an `Encoding` of three coordinates.
    `auto` takes `native` for float32 on a CPU unless gradients are wanted; else `loop` for many rows on a CPU without gradients, and
    `bucket`. All but `native` are differentiable, twice where `elu` or `relu` is.
    """
    tensors = [block.x if isinstance(block, Encoding) else block for block in blocks]
    if impl == "auto":
        impl = "native" if serves(*tensors, *weights, *biases) else "bucket"
        if impl == "bucket" and len(tensors[0]) > FEW and tensors[0].device.type == "cpu":
            impl = "bucket" if _tracked(tensors, weights, biases) else "loop"
    if impl == "native":
        if not serves(*tensors, *weights, *biases):
            raise ValueError("native: float32 on a CPU, and no gradients")
        return _native(blocks, offsets, weights, biases, activation)
    if impl not in _IMPLEMENTATIONS:
        raise ValueError(f"impl: expected auto or one of {available()}, found {impl!r}")
    values = [block.values() if isinstance(block, Encoding) else block for block in blocks]
    return _IMPLEMENTATIONS[impl](values, offsets, weights, biases, activation)


def _reference(
    blocks: Sequence[Tensor], offsets: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor], activation: str
) -> Tensor:
    """The equation, row by row."""
    node = torch.repeat_interleave(torch.arange(len(offsets) - 1, device=offsets.device), offsets.diff())
    h = torch.cat(list(blocks), -1)
    for layer, (weight, bias) in enumerate(zip(weights, biases)):
        h = torch.einsum("kc,kco->ko", h, weight[node]) + bias[node]
        if layer + 1 < len(weights):
            h = F.elu(h) if activation == "elu" else F.relu(h)
    return h


def _loop(
    blocks: Sequence[Tensor], offsets: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor], activation: str
) -> Tensor:
    """Node by node with matrix products whose intermediates stay in cache: the fastest for many rows on a CPU."""
    act = _activation(activation, inplace=not _tracked(blocks, weights, biases))
    counts = offsets.diff().tolist()
    any_rows = any(counts)
    first = [weight.unbind(0) for weight in weights[0].split([block.shape[1] for block in blocks], 1)]
    layers = [list(zip(bias.unbind(0), weight.unbind(0))) for bias, weight in zip(biases[1:], weights[1:])]
    rows = []
    for node, parts in enumerate(zip(*(block.split(counts) for block in blocks))):
        if any_rows and not counts[node]:
            continue
        h = torch.addmm(biases[0][node], parts[0], first[0][node])
        for part, weight in zip(parts[1:], first[1:]):
            h = torch.addmm(h, part, weight[node])
        for layer in layers:
            h = act(h)
            h = torch.addmm(layer[node][0], h, layer[node][1])
        rows.append(h)
    return torch.cat(rows)


def _bucket(
    blocks: Sequence[Tensor], offsets: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor], activation: str
) -> Tensor:
    """Equal chunks of one node's rows, one batched product per layer: no loop, for a GPU, for backward passes and for few rows."""
    x = torch.cat(list(blocks), -1)
    counts = offsets.diff()
    chunk = min(max(CHUNKS[0], len(x) // (4 * len(counts))), CHUNKS[1])
    chunks = (counts + chunk - 1) // chunk
    first = torch.cumsum(chunks, 0) - chunks
    nodes = torch.arange(len(counts), device=x.device)
    node_of_row = torch.repeat_interleave(nodes, counts)
    slot = first[node_of_row] * chunk + torch.arange(len(x), device=x.device) - offsets[:-1][node_of_row]
    node_of_chunk = torch.repeat_interleave(nodes, chunks)
    h = x.new_zeros(len(node_of_chunk) * chunk, x.shape[1]).index_copy(0, slot, x)
    h = h.unflatten(0, (len(node_of_chunk), chunk))
    act = _activation(activation, inplace=False)
    for layer, (weight, bias) in enumerate(zip(weights, biases)):
        h = torch.baddbmm(bias[node_of_chunk, None], h, weight[node_of_chunk])
        if layer + 1 < len(weights):
            h = act(h)
    return h.flatten(0, 1)[slot]


def _native(
    blocks: Sequence[Tensor | Encoding],
    offsets: Tensor,
    weights: Sequence[Tensor],
    biases: Sequence[Tensor],
    activation: str,
) -> Tensor:
    """`loop` in compiled loops, without gradient: 2 to 8 times as fast as either for the work of a frame on two cores."""
    plain = [block for block in blocks if isinstance(block, Tensor)]
    rows = plain[0] if plain else torch.empty(len(blocks[0].x), 0)  # type: ignore[union-attr]
    if len(plain) > 1:
        rows = torch.cat(plain, -1)
    encoded = blocks[0] if isinstance(blocks[0], Encoding) else Encoding(rows.new_empty(len(rows), 0), 0)
    if len(plain) + isinstance(blocks[0], Encoding) < len(blocks):
        raise ValueError("blocks: an encoding that is not the first")
    width = encoded.x.shape[1] * (1 + 2 * encoded.octaves) + rows.shape[1]
    begins = len(offsets) == len(weights[0]) + 1 and int(offsets[0]) == 0 and int(offsets[-1]) == len(rows)
    if width != weights[0].shape[1] or len(encoded.x) != len(rows) or not begins or bool((offsets.diff() < 0).any()):
        raise ValueError(f"{width} channels of {len(rows)} rows for weights {tuple(weights[0].shape)}")
    for weight, bias, below in zip(weights, biases, (width, *(bias.shape[1] for bias in biases))):
        if weight.shape != (len(weights[0]), below, bias.shape[1]) or len(bias) != len(weight):
            raise ValueError(f"weights {tuple(weight.shape)} and biases {tuple(bias.shape)} above {below} channels")
    outputs = [CHANNELS] * (len(weights) - 1) + [OUTPUTS]
    packed = tuple(padded(weight.detach().numpy(), CHANNELS, each) for weight, each in zip(weights, outputs))
    chunk = chunks(offsets.numpy())
    out = np.empty((len(rows), biases[-1].shape[1]), np.float32)
    spread(
        forward,
        len(chunk),
        chunk,
        encoded.x.T.contiguous().numpy(),
        encoded.octaves,
        np.float32(encoded.limit),
        rows.contiguous().numpy(),
        packed,
        tuple(padded(bias.detach().numpy(), each) for bias, each in zip(biases, outputs)),
        activation == "elu",
        out,
        few=FEW_CHUNKS,
    )
    return torch.from_numpy(out)


def _tracked(*tensors: Sequence[Tensor]) -> bool:
    return torch.is_grad_enabled() and any(t.requires_grad for some in tensors for t in some)


def _activation(name: str, inplace: bool) -> Callable[[Tensor], Tensor]:
    if name == "elu":
        return _elu_ if inplace else F.elu
    return F.relu_ if inplace else F.relu


def _elu_(h: Tensor) -> Tensor:
    """ELU in place; torch's own takes twice as long on a CPU. e^h − 1 is never below h, and errs by 6e-8."""
    return torch.maximum(h, h.clamp(max=0).exp_().sub_(1), out=h)


_IMPLEMENTATIONS = {"reference": _reference, "loop": _loop, "bucket": _bucket}
