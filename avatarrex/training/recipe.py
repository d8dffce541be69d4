"""Recipes: how long and how each part is trained (paper table 'Training statistics' and appendix table).

`paper` is the paper's schedule; `quick` trains `compact` fields on two cores within the hour, `long` in two or three;
`refine` goes on from such an avatar (`train --start`): colours are good by then, and tell the geometry more; `smoke` is
for tests.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from avatarrex.training.core.volume_rendering import Quadrature

Sampling = Literal["near", "uniform"]


@dataclass(frozen=True)
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
    """Steps that fit the geometry to the template before; 0 starts from scratch."""
    gamma_extra: float = 0.02
    """γ1, metres. With a warm start the surface is known to a centimetre: fog of two would wash it away first."""
    geometry_rate: float = 1.0
    """Of the learning rate, for the geometry: less where it only has to settle."""
    still: int = 0
    """Steps at first in which the geometry stands still: colours that are not yet known would move it."""
    latent: bool = True
    """Whether frames have codes of their own and z is drawn; without, z = 0 as at test, and detail follows the pose alone."""
    silhouette: float = 0.0
    """Weight of the silhouette term (losses.py); the paper has none."""
    outline: int = 0
    """Rays of the whole batch that it has besides the rendered ones, drawn about the matte's edge."""
    node: float = 1.0
    """Of the paper's weight of L_node, under which nodes drift by centimetres."""
    sampling: Sampling = "near"
    quadrature: Quadrature = "interval"

    def __post_init__(self) -> None:
        """Raises `ValueError` for a silhouette term without rays: recipes of older runs have none of their own."""
        if (self.silhouette > 0) != (self.outline > 0):
            raise ValueError(f"silhouette {self.silhouette} with {self.outline} rays of the outline")


@dataclass(frozen=True)
class PassTwo:
    """Surface rendering of patches, geometry frozen."""

    steps: int
    patch: int
    """Pixels a side."""
    rate: float
    decay: float
    decay_steps: int
    perceptual: float = 1.0
    """λ_LPIPS."""


@dataclass(frozen=True)
class Recipe:
    """All of a training."""

    name: str
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

    def steps(self) -> dict[str, int]:
        """Both passes' steps by part."""
        return {part: sum(stage.steps for stage in getattr(self, part)) for part in ("face", "body")}

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Recipe:
        """What `to_json` gave."""
        passes = {part: (PassOne(**data[part][0]), PassTwo(**data[part][1])) for part in ("face", "body")}
        return cls(**{**data, **passes})


PAPER = Recipe(
    "paper",
    "paper",
    face=(PassOne(200_000, 4, 400, 64, 5e-4, 0.8, 20_000, 100_000, 2000), PassTwo(100_000, 128, 1e-4, 0.8, 20_000)),
    body=(PassOne(300_000, 4, 400, 64, 5e-4, 0.8, 20_000, 100_000, 4000), PassTwo(100_000, 128, 1e-4, 0.8, 20_000)),
    interval=2000,
    evaluate=10_000,
)  # fmt: skip
QUICK = Recipe(
    "quick",
    "compact",
    face=(
        PassOne(
            400, 1, 400, 5, 1.5e-3, 0.05, 400, 1, 60, gamma_extra=0.0, geometry_rate=0.1, still=250, silhouette=0.3,
            outline=400,
        ),
        PassTwo(1000, 128, 3e-3, 0.05, 1000),
    ),
    body=(
        PassOne(
            1200, 1, 400, 5, 4e-3, 0.05, 1200, 600, 60, gamma_extra=0.005, geometry_rate=0.15, latent=False,
            silhouette=1.0, outline=2000, node=25.0,
        ),
        PassTwo(2400, 128, 3e-3, 0.03, 2400),
    ),
    interval=200,
    evaluate=400,
)  # fmt: skip
LONG = Recipe(
    "long",
    "compact",
    face=(
        PassOne(
            600, 1, 400, 5, 1.5e-3, 0.03, 600, 1, 60, gamma_extra=0.0, geometry_rate=0.1, still=350, silhouette=0.3,
            outline=400,
        ),
        PassTwo(2500, 128, 3e-3, 0.02, 2500),
    ),
    body=(
        PassOne(
            4000, 1, 600, 5, 4e-3, 0.02, 4000, 600, 60, gamma_extra=0.005, geometry_rate=0.15, latent=False,
            silhouette=1.0, outline=2000, node=25.0,
        ),
        PassTwo(4000, 128, 3e-3, 0.02, 4000),
    ),
    interval=200,
    evaluate=1000,
)  # fmt: skip
REFINE = Recipe(
    "refine",
    "compact",
    face=(
        PassOne(
            300, 1, 400, 5, 1e-3, 0.1, 300, 1, 0, gamma_extra=0.0, geometry_rate=0.1, silhouette=0.3, outline=400,
        ),
        PassTwo(800, 128, 2e-3, 0.05, 800),
    ),
    body=(
        PassOne(
            1000, 1, 800, 5, 1e-3, 0.1, 1000, 1, 0, gamma_extra=0.0, geometry_rate=0.15, latent=False,
            silhouette=1.0, outline=2000, node=25.0,
        ),
        PassTwo(1600, 128, 2e-3, 0.05, 1600),
    ),
    interval=200,
    evaluate=400,
)  # fmt: skip
SMOKE = Recipe(
    "smoke",
    "compact",
    face=(PassOne(6, 1, 64, 6, 2e-3, 0.5, 10, 10, 6, silhouette=0.3, outline=32), PassTwo(3, 32, 1e-3, 0.5, 10)),
    body=(PassOne(12, 2, 96, 6, 2e-3, 0.5, 20, 20, 12, silhouette=1.0, outline=64), PassTwo(4, 32, 1e-3, 0.5, 10)),
    interval=5,
    evaluate=1000,
)
RECIPES = {recipe.name: recipe for recipe in (PAPER, QUICK, LONG, REFINE, SMOKE)}
