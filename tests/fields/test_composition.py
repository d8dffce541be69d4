"""Composition: the printed equations, the union rule (no carving, any order), effective weights, step bound."""

import itertools

import torch
from torch import Tensor

from avatarrex.fields.composition import (
    BAND,
    EMPTIED,
    blend_literal,
    compose,
    compose_colour,
    emptied,
    in_band,
    step_bound,
)

FAR = torch.tensor(torch.inf, dtype=torch.float64)


def one(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def random_parts(count: int = 400, parts: int = 3) -> dict[str, Tensor]:
    """Points in up to three overlapping boxes, some with contact."""
    generator = torch.Generator().manual_seed(4)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=generator, dtype=torch.float64)

    contact = uniform(0, 1, count, parts) < 0.5
    return {
        "body": uniform(-0.1, 0.1, count),
        "inside": uniform(0, 1, count, parts) < 0.6,
        "part_sdf": uniform(-0.08, 0.05, count, parts),
        "omega": uniform(0, 1, count, parts).round(decimals=1),
        "own": uniform(-0.1, 0.1, count, parts),
        "others": torch.where(contact, uniform(-0.1, 0.1, count, parts), FAR),
    }


def scene(x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A slab x < 0 (a thigh), and a ball of 3 cm whose flesh begins 1 cm inside it (a hand resting on the thigh)."""
    slab = x
    ball = (x - 0.02).abs() - 0.03
    return slab, ball, torch.ones_like(x), torch.full_like(x, EMPTIED)


def test_equation_13_at_every_branch() -> None:
    omega, s, body = one(0.25, 0.25, 0.25, 0.25), one(0.01, 0.025, -0.05, -0.06), one(0.1, 0.1, 0.1, 0.1)
    torch.testing.assert_close(blend_literal(omega, s, s, body), one(0.25 * 0.01 + 0.75 * 0.1, 0.1, 0.1, 0.1))


def test_equation_14_blends_colours_with_the_same_weights() -> None:
    part, body = torch.eye(3, dtype=torch.float64)[:1], torch.eye(3, dtype=torch.float64)[1:2]
    torch.testing.assert_close(blend_literal(one(0.25), one(0.0), part, body), one(0.25, 0.75, 0)[None])
    torch.testing.assert_close(blend_literal(one(0.25), one(0.03), part, body), body)


def test_one_part_without_contact_is_the_printed_equation() -> None:
    values = random_parts(parts=1)
    values["others"] = torch.full_like(values["others"], torch.inf)
    values["inside"] = torch.ones_like(values["inside"])
    values["own"] = values["body"][:, None]
    want = blend_literal(values["omega"][:, 0], values["part_sdf"][:, 0], values["part_sdf"][:, 0], values["body"])
    torch.testing.assert_close(compose(**values).sdf, want)


def test_outside_every_box_it_is_the_body() -> None:
    values = random_parts()
    values["inside"] = torch.zeros_like(values["inside"])
    have = compose(**values)
    torch.testing.assert_close(have.sdf, values["body"])
    assert have.part_weight.abs().max() == 0


def test_any_order_of_the_parts_gives_the_same() -> None:
    values = random_parts()
    want = compose(**values)
    for order in itertools.permutations(range(3)):
        turned = {k: v if k == "body" else v[:, list(order)] for k, v in values.items()}
        have = compose(**turned)
        assert torch.equal(have.sdf, want.sdf)
        assert torch.equal(have.part_weight, want.part_weight[:, list(order)])


def test_parts_that_tie_share_the_colour() -> None:
    """Clasped hands: two equal sheets."""
    have = compose(
        one(0.5), torch.ones(1, 2, dtype=torch.bool), one(0.01, 0.01)[None], one(1, 1)[None], one(0.2, 0.2)[None],
        torch.full((1, 2), torch.inf, dtype=torch.float64),
    )  # fmt: skip
    torch.testing.assert_close(have.part_weight, one(0.5, 0.5)[None])


def test_the_union_carves_nothing_where_the_printed_equation_does() -> None:
    """Ball on slab: literally the ball's outside replaces the slab's inside, and flesh is carved around the hand."""
    x = torch.linspace(-0.06, 0.08, 281, dtype=torch.float64)
    slab, ball, omega, own = scene(x)
    truth = torch.minimum(slab, ball)
    literal = blend_literal(omega, ball, ball, slab)
    carved = (truth < -1e-9) & (literal > 0)
    assert carved.any(), "the scene must provoke the fault"
    have = compose(
        slab, torch.ones(len(x), 1, dtype=torch.bool), ball[:, None], omega[:, None], own[:, None], slab[:, None]
    )
    assert not ((truth < -1e-9) & (have.sdf > 0)).any()
    torch.testing.assert_close(have.sdf.sign()[truth.abs() > 1e-9], truth.sign()[truth.abs() > 1e-9])


def test_a_point_on_the_other_limb_takes_no_part_colour() -> None:
    x = one(-0.02, 0.04)
    slab, ball, omega, own = scene(x)
    have = compose(slab, torch.ones(2, 1, dtype=torch.bool), ball[:, None], omega[:, None], own[:, None], slab[:, None])
    torch.testing.assert_close(have.part_weight[:, 0], one(0, 1))
    colour = compose_colour(
        have.part_weight, torch.ones(2, 1, 3, dtype=torch.float64), torch.zeros(2, 3, dtype=torch.float64)
    )
    torch.testing.assert_close(colour[:, 0], one(0, 1))


def test_the_ramp_is_continuous_and_ends_in_either_field() -> None:
    omega = torch.linspace(0, 1, 1001, dtype=torch.float64)
    s, own = torch.full_like(omega, 0.004), torch.full_like(omega, -0.006)
    c = compose(
        own,
        torch.ones(1001, 1, dtype=torch.bool),
        s[:, None],
        omega[:, None],
        own[:, None],
        torch.full_like(own, torch.inf)[:, None],
    )
    assert c.sdf[0] == own[0]
    assert c.sdf[-1] == s[-1]
    assert c.sdf.diff().abs().max() < 1.1e-5
    torch.testing.assert_close(c.part_weight[:, 0], omega)


def test_emptied_hand_leaves_the_rest() -> None:
    body = one(-0.03, -0.03, 0.01, 0.05)
    torch.testing.assert_close(emptied(body, one(0, 1, 1, 1)), one(-0.03, EMPTIED, EMPTIED, 0.05))
    torch.testing.assert_close(emptied(body, one(0.5, 0, 0, 0))[:1], one(-0.005))


def test_step_never_passes_the_surface() -> None:
    """Two sheets 2 cm apart, blended half and half: the surface lies between them, nearer than either."""
    x = torch.linspace(-0.02, 0.02, 401, dtype=torch.float64)
    s, own, others = x - 0.004, x + 0.016, torch.full_like(x, torch.inf)
    inside = torch.ones(len(x), 1, dtype=torch.bool)
    omega = torch.full_like(x, 0.5)
    terms = inside, s[:, None], omega[:, None], own[:, None], others[:, None]
    sdf = compose(own, *terms).sdf
    true = (x + 0.006).abs()
    torch.testing.assert_close(
        step_bound(sdf, inside, s[:, None], own[:, None], others[:, None]).clamp(0, 1) <= true + 1e-12, inside[:, 0]
    )
    terms_alone = torch.minimum(s.abs(), own.abs())
    assert (terms_alone > true + 1e-3).any(), "without |s| the bound passes the surface"


def test_step_in_a_box_regards_every_term() -> None:
    inside = torch.tensor([[True, True], [True, False], [False, False]])
    part, own = one(0.04, 0.01).expand(3, 2), one(0.03, 0.02).expand(3, 2)
    others = one(0.05, torch.inf).expand(3, 2)
    torch.testing.assert_close(step_bound(one(0.5, -0.5, -0.5), inside, part, own, others), one(0.01, 0.03, 0.5))


def test_the_band_is_open() -> None:
    assert in_band(one(BAND[0], BAND[0] + 1e-9, BAND[1] - 1e-9, BAND[1])).tolist() == [False, True, True, False]
