"""One network for all rows: compiled loops where they serve, torch's layers elsewhere."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from avatarrex.fields import local_networks
from avatarrex.fields.local_networks import MANY, mlp
from avatarrex.ops.encoding import Encoding


@pytest.mark.parametrize("activation", ["elu", "relu"])
@pytest.mark.parametrize("shape", [(MANY,), (20, 30), (3,)])
def test_it_is_torchs_own_sequence(activation, shape):
    torch.manual_seed(0)
    network, x = mlp((43, 32, 5, 3), activation), torch.randn(*shape, 43)
    want = nn.Sequential(*network)(x)
    torch.testing.assert_close(network(x), want, atol=0, rtol=0)
    with torch.no_grad():
        torch.testing.assert_close(network(x), want, atol=2e-6, rtol=2e-6)
    assert [type(layer) for layer in network][1] is (nn.ELU if activation == "elu" else nn.ReLU)
    assert set(network.state_dict()) == {f"{k}.{name}" for k in (0, 2, 4) for name in ("weight", "bias")}


@pytest.mark.parametrize("place", [0, 1, 2])
def test_an_encoding_may_be_any_of_the_blocks(place):
    torch.manual_seed(1)
    network, blocks = mlp((12, 9, 3), "relu"), [torch.randn(MANY, 2), torch.randn(MANY, 1)]
    blocks.insert(place, Encoding(torch.randn(MANY, 3), 1))
    want = network(torch.cat([block.values() if isinstance(block, Encoding) else block for block in blocks], 1))
    torch.testing.assert_close(network.of_blocks(blocks), want, atol=0, rtol=0)
    with torch.no_grad():
        torch.testing.assert_close(network.of_blocks(blocks), want, atol=2e-6, rtol=2e-6)


def test_compiled_loops_serve_many_rows_without_gradients(monkeypatch):
    used = []
    monkeypatch.setattr(local_networks, "local_mlp", lambda blocks, *rest: used.append(len(blocks[0])) or blocks[0])
    network, many = mlp((2, 4, 2), "elu"), torch.zeros(MANY, 2)
    network(many)
    assert not used
    network.requires_grad_(False)
    network(many)
    network(many[1:])
    network.double()(many.double())
    assert used == [MANY]
