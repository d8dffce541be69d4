"""Mixed precision: colours in bfloat16 where gradients are wanted, float32 outside; distances untouched."""

from __future__ import annotations

import torch

from avatarrex.avatar import Avatar
from avatarrex.templates.person import load_person
from avatarrex.training.core.mixed import in_bfloat16


def features(avatar: Avatar) -> tuple[torch.Tensor, torch.Tensor]:
    """What two colour networks give, and the face's geometry."""
    noise = torch.Generator().manual_seed(0)
    body, face = avatar.body, avatar.face
    embedding = torch.randn(len(body.node_rest), body.widths.embedding, generator=noise)
    views = torch.rand(face.views(avatar.person.face.v_template.float()).shape, generator=noise)
    colour = torch.cat([body.patch_network(embedding).flatten(), face.colour_planes(views).flatten()])
    return colour, face.geometry_planes(views)


def test_colours_alone_are_coarser_and_only_where_gradients_are_wanted():
    avatar = Avatar.create(load_person(), "compact", seed=3)
    colour, geometry = features(avatar)
    in_bfloat16(avatar)
    with torch.no_grad():
        assert features(avatar)[0].equal(colour)
    assert features(avatar)[0].equal(colour), "frozen networks are evaluated as they are drawn"
    for parameter in (*avatar.body.parameters(), *avatar.face.parameters()):
        parameter.requires_grad_(True)
    mixed, same = features(avatar)
    assert same.equal(geometry)
    assert mixed.dtype == torch.float32
    change = float((mixed.detach() - colour.detach()).norm() / colour.norm().detach())
    assert 1e-4 < change < 0.02  # bfloat16 keeps 8 bits
    mixed.square().sum().backward()
    gradient = avatar.body.patch_network.kernels[0].grad
    assert gradient is not None
    assert gradient.dtype == torch.float32
    assert gradient.isfinite().all()
    assert gradient.any()


def test_a_forward_that_fails_leaves_precision_as_it_was():
    avatar = Avatar.create(load_person(), "compact", seed=3)
    in_bfloat16(avatar)
    try:
        avatar.face.colour_net.mlp(torch.zeros(2, 1, requires_grad=True))
    except RuntimeError:
        pass
    else:
        raise AssertionError("a wrong width went through")
    assert not torch.is_autocast_enabled("cpu")
