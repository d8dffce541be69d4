"""Recipes: training schedules, how long and how each part is trained (paper table 'Training statistics' and appendix table).

    L_I  = L_rgb + 1.0 L_mask + 2.0 L_eikonal + 0.04 L_node + 0.01 L_ebd + 1e-6 L_KL     (+ our silhouette, skin and tone terms)
    L_II = L_rgb + 1.0 L_perceptual                                                     (+ our tone term)

`RECIPES` lists those that exist. Nothing here needs torch: command line and Training tab read it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, TypeVar

Sampling = Literal["near", "uniform"]
Quadrature = Literal["interval", "point"]
SCRATCH_SAMPLES = 64
"""On a ray, where no surface is known: the paper's."""
TRAINED = ("face", "body")
"""What has two passes of its own, in this order; the hands are trained with the body."""


@dataclass(frozen=True, kw_only=True)
class LossWeights:
    """Weight of every term of a pass (losses.py): the paper's unless a recipe says otherwise."""

    rgb: float = 1.0
    mask: float = 1.0
    eikonal: float = 2.0
    node: float = 0.04
    embedding: float = 0.01
    kl: float = 1e-6
    perceptual: float = 1.0
    """λ_LPIPS."""
    silhouette: float = 0.0
    """Ours."""
    skin: float = 0.0
    """Of a face's distance from its mesh, where that is the person's own; ours."""
    tone: float = 0.1
    """Of the tone mapping's deviation from the identity; ours."""


@dataclass(frozen=True, kw_only=True)
class PassOne:
    """Volume rendering on sparse pixels."""

    steps: int
    frames: int
    """Frames of a batch."""
    rays: int
    """Of the whole batch."""
    samples: int
    """On a ray: of `uniform` sampling all, of `near` those that are evaluated once γ is small."""
    rate: float
    """Learning rate at the start."""
    decay: float
    """Factor on the rate after every `decay_steps` steps, applied continuously."""
    decay_steps: int
    gamma_steps: int
    """N of γ(n)."""
    warm_steps: int
    """Steps that fit the geometry to the template before, from the packaged prior where it fits; 0 starts from scratch."""
    prior: bool = True
    """Whether that fit may begin with the packaged prior."""
    gamma_extra: float = 0.02
    """γ1, metres. With a warm start the surface is known to a centimetre: fog of two would wash it away first."""
    geometry_rate: float = 1.0
    """Of the learning rate, for the geometry: less where it only has to settle."""
    still: int = 0
    """Steps at first in which the geometry is frozen: colours that are not yet known would move it."""
    latent: bool = True
    """Whether frames have codes of their own and z is drawn; without, z = 0 as at test, and detail follows the pose alone."""
    close: float = 0.0
    """Share of the body's steps that see the face rig's pictures, where there is one: outlines of hair, neck and collar (ours)."""
    texel: float = 0.0
    """Metres between the texels of the static detail (fields/detail_texture.py; ours), painted from the pictures at the
    beginning: geometry then moves to where known colours agree; 0: none."""
    carved: bool = False
    """Whether what stands off the template farther than cloth is carved from the mattes before (fields/outgrowth.py; ours)."""
    outline: int = 0
    """Rays of the whole batch for the silhouette term besides the rendered ones, drawn about the matte's edge."""
    sampling: Sampling = "near"
    quadrature: Quadrature = "interval"
    weights: LossWeights = LossWeights()

    def __post_init__(self) -> None:
        """Raises `ValueError` for a silhouette term without rays, and for rays without the term."""
        if (self.weights.silhouette > 0) != (self.outline > 0):
            raise ValueError(f"silhouette {self.weights.silhouette} with {self.outline} rays of the outline")


@dataclass(frozen=True, kw_only=True)
class PassTwo:
    """Surface rendering of patches, geometry frozen."""

    steps: int
    patch: int = 128
    """Pixels a side."""
    rate: float
    decay: float
    decay_steps: int
    patches: int = 1
    """Of a batch, each of a picture of its own."""
    clamped: bool = True
    """Whether codes are first clamped to the middle of what the training's poses have (fields/code.py; ours)."""
    close: float = 0.0
    """Share of the body's steps that see the face rig's pictures, where there is one: several times as sharp (ours)."""
    texel: float = 0.0
    """Metres between the texels of the static detail (fields/detail_texture.py; ours), painted from the pictures at the
    beginning; 0: none."""
    texel_rate: float = 1.0
    """Of the learning rate, for the texels (core/texel_descent.py)."""
    slides: bool = False
    """Whether the texels are first registered to the pictures: cloth slides over the skin (fields/slide.py; ours)."""
    rises: bool = False
    """Whether the surface is registered, too, before anything is painted: it stands off where pass I left it
    (`BodyField.raise_surface`; ours). After that the geometry is frozen."""
    view_dropout: float = 0.0
    """Share of the patches that are shaded as if seen along a random direction: colours from where no camera looked are then
    those of all cameras (ours)."""
    weights: LossWeights = LossWeights()


Pass = TypeVar("Pass", PassOne, PassTwo)


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """All of a training."""

    name: str
    about: str = field(default="", compare=False)
    """One line for lists of recipes; not stored."""
    preset: str
    """Widths of the networks."""
    face: tuple[PassOne, PassTwo]
    body: tuple[PassOne, PassTwo]
    interval: int
    """Steps between checkpoints; the volumes that place the samples are renewed with each."""
    evaluate: int
    """Steps between held-out renderings."""
    mixed: bool = False
    """Colours in bfloat16 while training (mixed.py)."""
    scratch: bool = False
    """Nothing was known before it began (`from_scratch`)."""

    def steps(self) -> dict[str, int]:
        """Both passes' steps by part."""
        return {part: sum(stage.steps for stage in getattr(self, part)) for part in TRAINED}

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {key: value for key, value in asdict(self).items() if key != "about"}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Recipe:
        """What `to_json` gave. Raises KeyError, TypeError or ValueError."""
        passes = {part: (PassOne(**_weighted(data[part][0])), PassTwo(**_weighted(data[part][1]))) for part in TRAINED}
        return cls(**{**data, **passes})


def _weighted(stage: dict[str, Any]) -> dict[str, Any]:
    """A stored pass with its table of weights; before version 0.2 they were factors on the paper's, beside the other fields.

    Passes I of before `prior` began with it wherever they had a warm start."""
    rest = dict(stage)
    if "warm_steps" in rest:
        rest.setdefault("prior", rest["warm_steps"] > 0)
    if "weights" in rest:
        return {**rest, "weights": LossWeights(**rest["weights"])}
    weights = LossWeights(
        node=LossWeights.node * rest.pop("node", 1.0),
        silhouette=rest.pop("silhouette", 0.0),
        perceptual=rest.pop("perceptual", 1.0),
    )
    return {**rest, "weights": weights}


def _lasting(stage: Pass, steps: int, decay: float, **changes: Any) -> Pass:
    """A pass of so many steps, over all of which its learning rate falls by the factor `decay`."""
    return replace(stage, steps=steps, decay=decay, decay_steps=steps, **changes)


_PAPER_ONE = PassOne(
    steps=200_000, frames=4, rays=400, samples=64, rate=5e-4, decay=0.8, decay_steps=20_000, gamma_steps=100_000,
    warm_steps=0, prior=False, sampling="uniform", quadrature="point", weights=LossWeights(tone=0.0),
)  # fmt: skip
_PAPER_TWO = PassTwo(
    steps=100_000, rate=1e-4, decay=0.8, decay_steps=20_000, patches=4, clamped=False, weights=LossWeights(tone=0.0)
)
PAPER = Recipe(
    name="paper", about="the paper's schedule and networks to the letter, for a GPU", preset="paper", interval=2000,
    evaluate=10_000, face=(_PAPER_ONE, _PAPER_TWO), body=(replace(_PAPER_ONE, steps=300_000), _PAPER_TWO),
)  # fmt: skip
"""Line by line against the paper: tests/training/test_paper.py."""
_PLUS_ONE: dict[str, Any] = {"prior": True, "sampling": "near", "quadrature": "interval", "weights": LossWeights()}
_PLUS_TWO = replace(_PAPER_TWO, clamped=True, weights=LossWeights())
_DETAIL: dict[str, Any] = {"texel": 0.002, "texel_rate": 4.0, "slides": True, "rises": True, "view_dropout": 0.5}
"""Of the body: what its pictures show at once, and no colours of their own for cameras that were not there."""
PAPER_PLUS = replace(
    PAPER, name="paper+", about="the paper's schedule and networks with our warm start, samples and regularisers, for a GPU",
    face=(replace(PAPER.face[0], warm_steps=2000, **_PLUS_ONE), _PLUS_TWO),
    body=(replace(PAPER.body[0], warm_steps=4000, carved=True, **_PLUS_ONE), replace(_PLUS_TWO, **_DETAIL)),
)  # fmt: skip
_FACE_TEXEL = 0.001
_FACE = PassOne(
    steps=400, frames=1, rays=400, samples=5, rate=1.5e-3, decay=0.05, decay_steps=400, gamma_steps=1, warm_steps=60,
    gamma_extra=0.0, texel=_FACE_TEXEL, outline=400, weights=LossWeights(silhouette=0.3, skin=0.3),
)  # fmt: skip
_BODY = PassOne(
    steps=1200, frames=1, rays=400, samples=5, rate=4e-3, decay=0.05, decay_steps=1200, gamma_steps=600, warm_steps=60,
    gamma_extra=0.005, geometry_rate=0.15, latent=False, outline=2000, carved=True,
    weights=LossWeights(silhouette=1.0, node=1.0),
)  # fmt: skip
"""Under the paper's L_node, a 25th of this, nodes drift by centimetres."""
_TWO = PassTwo(steps=1000, rate=3e-3, decay=0.05, decay_steps=1000)
_FACE_DETAIL: dict[str, Any] = {"texel": _FACE_TEXEL, "texel_rate": 8.0}
QUICK = Recipe(
    name="quick", about="compact networks within the hour on two cores", preset="compact", interval=200, evaluate=400,
    face=(_FACE, _lasting(_TWO, 800, 0.05, **_FACE_DETAIL)),
    body=(replace(_BODY, close=0.25), _lasting(_TWO, 2400, 0.03, close=0.33, **_DETAIL)),
)  # fmt: skip
LONG = replace(
    QUICK, name="long", about="a finished avatar of compact networks in two or three hours on two cores", evaluate=1000,
    face=(_lasting(_FACE, 600, 0.03), _lasting(_TWO, 2500, 0.02, **_FACE_DETAIL)),
    body=(_lasting(_BODY, 4000, 0.02, rays=600, close=0.25), _lasting(_TWO, 4000, 0.02, close=0.33, **_DETAIL)),
)  # fmt: skip
_SETTLED: dict[str, Any] = {
    "rate": 1e-3,
    "gamma_steps": 1,
    "warm_steps": 0,
    "gamma_extra": 0.0,
    "still": 0,
    "texel": 0.0,
}
REFINE = replace(
    QUICK, name="refine", about="goes on from an avatar of quick or long (--start): known colours tell the geometry more",
    face=(
        _lasting(_FACE, 300, 0.1, geometry_rate=0.1, weights=LossWeights(silhouette=0.3), **_SETTLED),
        _lasting(_TWO, 800, 0.05, rate=2e-3, texel_rate=8.0),
    ),
    body=(_lasting(_BODY, 1000, 0.1, rays=800, close=0.25, **_SETTLED), _lasting(_TWO, 1600, 0.05, rate=2e-3, texel_rate=4.0, close=0.33)),
)  # fmt: skip
_SMOKE_ONE = PassOne(
    steps=6, frames=1, rays=64, samples=6, rate=2e-3, decay=0.5, decay_steps=10, gamma_steps=10, warm_steps=6,
    outline=32, weights=LossWeights(silhouette=0.3),
)  # fmt: skip
_SMOKE_TWO = PassTwo(steps=3, patch=32, rate=1e-3, decay=0.5, decay_steps=10)
_SMOKE_BODY = replace(
    _SMOKE_ONE, steps=12, frames=2, rays=96, decay_steps=20, gamma_steps=20, warm_steps=12, outline=64,
    weights=LossWeights(silhouette=1.0), carved=True,
)  # fmt: skip
SMOKE = Recipe(
    name="smoke", about="a dozen steps, for tests", preset="compact", interval=5, evaluate=1000,
    face=(_SMOKE_ONE, _SMOKE_TWO), body=(_SMOKE_BODY, replace(_SMOKE_TWO, steps=4, **{**_DETAIL, "texel": 0.01})),
)  # fmt: skip
RECIPES = {recipe.name: recipe for recipe in (PAPER, PAPER_PLUS, QUICK, LONG, REFINE, SMOKE)}


def from_scratch(recipe: Recipe) -> Recipe:
    """The recipe with nothing known before: neither prior nor template, and the paper's fog, in which a surface is found.

    The geometry learns from the first step at the full rate, on samples all along the rays: there is no surface yet to
    place them about. Fog lasts a third of pass I, as the paper's of the body does.
    """
    face, body = (
        replace(
            one, warm_steps=0, prior=False, carved=False, still=0, texel=0.0, geometry_rate=1.0, gamma_extra=PassOne.gamma_extra,
            gamma_steps=max(one.gamma_steps, one.steps // 3), sampling="uniform", samples=max(one.samples, SCRATCH_SAMPLES),
            weights=replace(one.weights, skin=0.0),
        )
        for one, _ in (recipe.face, recipe.body)
    )  # fmt: skip
    face_two, body_two = (replace(two, texel=0.0) for _, two in (recipe.face, recipe.body))
    return replace(recipe, face=(face, face_two), body=(body, body_two), scratch=True)
