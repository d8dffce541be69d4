"""Variants of the ablation: each is one recipe with one thing changed (paper sec. 5.1 and the ablation study).

    full               pass I, then pass II with the perceptual term; feature patches or tri-planes
    pass-one           its pass I alone: what pass II starts from
    no-detail          no static texels, no view dropout
    no-view-dropout    every patch of pass II seen along its rays
    no-slide           static texels that stay on the skin
    no-outgrowth       nothing carved from the mattes
    no-pass-two        pass I alone, lengthened to as many steps
    plain-one          pass I of no-patches alone
    plain              no-pass-two without feature patches: the paper's baseline
    plain-no-prior     plain without the packaged prior
    one-network        plain, geometry and colour in one local network per node, without the prior
    full-no-prior      full of the face without the prior, beside face-mlp, which has none
    uniform-64         no-pass-two on 64 uniform samples a ray, weighed as the paper does; -time: as long as no-pass-two
    image-translation, canonical-nerf    no avatars: learned rivals, for as long as full took

Schedules (learning rate, γ) are stretched with the steps they belong to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from avatarrex.errors import check
from avatarrex.training.recipe import LossWeights, PassOne, PassTwo, Recipe

Pass = TypeVar("Pass", PassOne, PassTwo)


@dataclass(frozen=True)
class Variant:
    """What differs from `full`."""

    name: str
    what: str
    parts: tuple[str, ...] = ("body", "face")
    """Of which it can be studied."""
    networks: str = ""
    """Widths of the networks, beside those of the base recipe (fields/presets.py)."""
    prior: bool = True
    """Whether it begins with the packaged prior, which knows the networks of `compact`."""
    passes: int = 2
    lengthened: bool = True
    """Whether one pass takes as many steps as two."""
    one: Mapping[str, Any] = field(default_factory=dict)
    """Fields of pass I."""
    two: Mapping[str, Any] = field(default_factory=dict)
    """Fields of pass II."""
    redraws: str = ""
    """Not trained: that variant's avatar, drawn by volume rendering."""
    rival: bool = False
    """Not an avatar: what measure/rivals has of this name, trained for the processor time of `time_of`."""
    timing_of: str = ""
    time_of: str = ""
    """As many steps as take the processor time of `time_of` at the step timing of `timing_of`, both measured."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Variants that have to be finished before."""
        return tuple(filter(None, (self.redraws, self.timing_of, self.time_of)))


KNOWN_PRESET = "compact"
"""Networks that have a packaged prior."""
UNKNOWN = {"prior": False, "geometry_rate": 1.0, "still": 0, "rate": 4e-3}
"""Pass I without the prior: geometry is found with the colours."""
UNKNOWN_WARM = 5
"""Times the warm start with it."""
NO_DETAIL = {"texel": 0.0, "view_dropout": 0.0}
UNIFORM = {"sampling": "uniform", "samples": 64, "quadrature": "point"}
VARIANTS = {
    variant.name: variant
    for variant in (
        Variant("full", "both passes, perceptual term, feature patches or tri-planes"),
        Variant("pass-one", "pass I of full alone", passes=1, lengthened=False),
        Variant("plain-one", "pass I alone, no feature patches", ("body",), "no-patches", passes=1, lengthened=False),
        Variant("no-pass-two", "pass I alone, as many steps", passes=1),
        Variant("no-patches", "both passes, no feature patches", ("body",), "no-patches"),
        Variant("plain", "pass I alone, no feature patches (the paper's baseline)", ("body",), "no-patches", passes=1),
        Variant("no-detail", "both passes, no static texels, nothing registered, no view dropout", ("body",), two=NO_DETAIL),
        Variant("no-view-dropout", "both passes, every patch seen along its rays", ("body",), two={"view_dropout": 0.0}),
        Variant("no-slide", "both passes, static texels that stay on the skin", ("body",), two={"slides": False}),
        Variant("no-relief", "both passes, the surface as pass I leaves it", ("body",), two={"rises": False}),
        Variant("no-outgrowth", "both passes, nothing stands off the template by more than cloth", ("body",), one={"carved": False}),
        Variant("no-perceptual", "both passes, squared error alone", two={"weights": LossWeights(perceptual=0.0)}),
        Variant("full-no-prior", "full without the packaged prior, started as face-mlp", ("face",), prior=False),
        Variant(
            "face-mlp", "both passes, an MLP on the face's coefficients in place of tri-planes; no prior", ("face",),
            "face-mlp", prior=False,
        ),
        Variant(
            "plain-no-prior", "plain without the packaged prior, started as one-network", ("body",), "no-patches", prior=False, passes=1
        ),
        Variant(
            "one-network", "pass I alone, geometry and colour in one local network, no patches; no prior", ("body",),
            "one-network", prior=False, passes=1,
        ),
        Variant("volume-test-time", "full, drawn by volume rendering, 64 uniform samples", redraws="full"),
        Variant("uniform-64", "pass I alone on 64 uniform samples, as many steps", passes=1, one=UNIFORM),
        Variant(
            "uniform-64-time", "pass I alone on 64 uniform samples, as long as no-pass-two", passes=1, one=UNIFORM,
            timing_of="uniform-64", time_of="no-pass-two",
        ),
        Variant(
            "image-translation", "a U-Net on the fitted textured mesh's picture, as long as full", ("body",),
            rival=True, time_of="full",
        ),
        Variant(
            "canonical-nerf", "one MLP at the fitted skin's rest pose, volume rendered, as long as full", ("body",),
            rival=True, time_of="full",
        ),
    )
}  # fmt: skip
"""In the order of tables."""
QUESTIONS = (
    ("feature patches, one pass", "no-pass-two", "plain"),
    ("feature patches, two passes", "full", "no-patches"),
    ("feature patches, pass I of two", "pass-one", "plain-one"),
    ("tri-planes against an MLP on coefficients, both without the prior", "full-no-prior", "face-mlp"),
    ("tri-planes and prior against an MLP on coefficients", "full", "face-mlp"),
    ("pass II after pass I", "full", "pass-one"),
    ("pass II against as many steps of pass I", "full", "no-pass-two"),
    ("static texels, registration and view dropout", "full", "no-detail"),
    ("view dropout", "full", "no-view-dropout"),
    ("sliding texels", "full", "no-slide"),
    ("relief", "full", "no-relief"),
    ("outgrowths", "full", "no-outgrowth"),
    ("perceptual term", "full", "no-perceptual"),
    ("separate networks against one, both without the prior", "plain-no-prior", "one-network"),
    ("separate networks and prior against one network", "plain", "one-network"),
    ("surface against volume rendering, test time", "full", "volume-test-time"),
    ("near samples against 64 uniform, same steps", "no-pass-two", "uniform-64"),
    ("near samples against 64 uniform, same time", "no-pass-two", "uniform-64-time"),
    ("avatar against image translation", "full", "image-translation"),
    ("avatar against a canonical NeRF", "full", "canonical-nerf"),
)
"""Each with the two variants: the difference of their figures answers it."""


def chosen_variants(names: tuple[str, ...] | None, part: str) -> list[Variant]:
    """The named variants of a part (all unless named) with those they need, in table order. Raises `InputError`."""
    known = [name for name, variant in VARIANTS.items() if part in variant.parts]
    wanted = set(known if names is None else names)
    for name in sorted(wanted):
        check(name in known, "--variants", "", f"variants of the {part}: " + ", ".join(known), name or "nothing")
    while missing := {need for name in wanted for need in VARIANTS[name].needs} - wanted:
        wanted |= missing
    return [VARIANTS[name] for name in known if name in wanted]


def recipe_of(variant: Variant, base: Recipe, part: str) -> Recipe:
    """The base recipe with the variant's change."""
    one, two = getattr(base, part)
    one, two = replace(one, **variant.one), replace(two, **variant.two)
    if not variant.prior and base.preset == KNOWN_PRESET:
        one = replace(one, **UNKNOWN, warm_steps=UNKNOWN_WARM * one.warm_steps)
    if variant.passes == 1:
        one = stretched(one, (one.steps + two.steps) / one.steps) if variant.lengthened else one
        two = replace(two, steps=0)
    preset = f"{base.preset}/{variant.networks}" if variant.networks else base.preset
    return replace(base, name=f"{base.name}/{variant.name}", preset=preset, **{part: (one, two)})  # type: ignore[arg-type]


def scaled(recipe: Recipe, part: str, factor: float) -> Recipe:
    """Both passes of a part longer or shorter, with their schedules; the warm start is as it was."""
    one, two = getattr(recipe, part)
    passes = stretched(one, factor), stretched(two, factor)
    return replace(recipe, **{part: passes})  # type: ignore[arg-type]


def stretched(stage: Pass, factor: float) -> Pass:
    """A pass of `factor` times the steps; at least one, where it has any."""
    names = [name for name in ("steps", "decay_steps", "gamma_steps", "still") if getattr(stage, name, 0)]
    return replace(stage, **{name: max(round(factor * getattr(stage, name)), 1) for name in names})
