"""Local networks by vmap, by one batched product per layer, by a loop of `torch.nn.functional`, and by onnxruntime.

All take equal numbers of rows per node, which favours those that cannot take others. Letters: n nodes, k rows of a node.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from avatarrex.measure.bench.contest import Peers


@dataclass(frozen=True, eq=False)
class Networks:
    """One small MLP per node, and rows for each."""

    rows: Tensor
    """(n, k, c) float32."""
    weights: list[Tensor]
    """Per layer (n, c, o)."""
    biases: list[Tensor]
    """Per layer (n, o)."""
    activation: str

    @property
    def act(self) -> Callable[[Tensor], Tensor]:
        """`elu` or `relu`."""
        return F.elu if self.activation == "elu" else F.relu

    @cached_property
    def flops(self) -> int:
        """Multiplications and additions of the products; activations come on top."""
        return 2 * self.rows.shape[0] * self.rows.shape[1] * sum(w.shape[1] * w.shape[2] for w in self.weights)

    def through(
        self, rows: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor], layer: Callable[..., Tensor]
    ) -> Tensor:
        """The rows after all layers, each a `layer(rows, weight, bias)` with the activation after all but the last."""
        for k, (weight, bias) in enumerate(zip(weights, biases)):
            rows = layer(rows, weight, bias)
            rows = self.act(rows) if k + 1 < len(weights) else rows
        return rows


def vmap(net: Networks) -> Callable[[], Tensor]:
    """`torch.func.vmap` over the nodes."""
    together = torch.func.vmap(partial(net.through, layer=lambda rows, weight, bias: F.linear(rows, weight.T, bias)))
    return lambda: together(net.rows, net.weights, net.biases)


def batched(net: Networks) -> Callable[[], Tensor]:
    """`torch.baddbmm`, a layer at once."""
    biases = [bias[:, None] for bias in net.biases]
    return lambda: net.through(net.rows, net.weights, biases, lambda rows, w, bias: torch.baddbmm(bias, rows, w))


def per_node(net: Networks) -> Callable[[], Tensor]:
    """What a list of `nn.Sequential` does."""
    weights = [[w[i].T.contiguous() for w in net.weights] for i in range(len(net.rows))]
    biases = list(zip(*net.biases))
    return lambda: torch.stack([net.through(*node, F.linear) for node in zip(net.rows, weights, biases)])


def onnx_runtime(net: Networks) -> Callable[[], np.ndarray]:
    """Batched matrix products on one thread, all optimisations on."""
    import onnx
    import onnxruntime
    from onnx import TensorProto, helper, numpy_helper

    nodes, constants, last = [], [], "x"
    for k, (weight, bias) in enumerate(zip(net.weights, net.biases)):
        constants.append(numpy_helper.from_array(weight.numpy(), f"w{k}"))
        constants.append(numpy_helper.from_array(bias[:, None].numpy(), f"b{k}"))
        nodes.append(helper.make_node("MatMul", [last, f"w{k}"], [f"m{k}"]))
        nodes.append(helper.make_node("Add", [f"m{k}", f"b{k}"], [f"a{k}"]))
        last = f"a{k}"
        if k + 1 < len(net.weights):
            nodes.append(helper.make_node("Elu" if net.activation == "elu" else "Relu", [last], [f"h{k}"]))
            last = f"h{k}"
    shape = [len(net.rows), net.rows.shape[1]]
    given = helper.make_tensor_value_info("x", TensorProto.FLOAT, [*shape, net.rows.shape[2]])
    wanted = helper.make_tensor_value_info(last, TensorProto.FLOAT, [*shape, net.weights[-1].shape[2]])
    graph = helper.make_graph(nodes, "local", [given], [wanted], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    rows = net.rows.numpy()
    return lambda: np.asarray(session.run(None, {"x": rows})[0])


PEERS: Peers = {
    "vmap": ((), vmap),
    "batched": ((), batched),
    "per_node": ((), per_node),
    "onnxruntime": (("onnxruntime", "onnx"), onnx_runtime),
}
