"""Stages: the passes of a training in their order, with their schedules of learning rate and γ."""

from __future__ import annotations

from dataclasses import dataclass

from avatarrex.training.core.volume_rendering import Gamma
from avatarrex.training.recipe import TRAINED, PassOne, PassTwo, Recipe


@dataclass
class Stage:
    """One pass of one part."""

    part: str
    name: str
    """`I` or `II`."""
    recipe: PassOne | PassTwo
    begin: int
    """Its first step in the count of its part."""

    @property
    def end(self) -> int:
        """The step after its last."""
        return self.begin + self.recipe.steps

    def rate(self, step: int) -> float:
        """Learning rate, exponential decay."""
        return self.recipe.rate * float(self.recipe.decay ** ((step - self.begin) / self.recipe.decay_steps))

    def rates(self, step: int) -> tuple[float, float, float]:
        """Learning rates of the geometry, of texels, and of all else."""
        rate, one = self.rate(step), self.recipe
        if not isinstance(one, PassOne):
            return rate, one.texel_rate * rate, rate
        return (0.0 if step - self.begin < one.still else one.geometry_rate * rate), rate, rate

    def gamma(self, step: int) -> float:
        """γ(n) of pass I; its last value in pass II."""
        one = self.recipe
        return Gamma(extra=one.gamma_extra, steps=one.gamma_steps).at(step) if isinstance(one, PassOne) else Gamma.last


def stages(recipe: Recipe, parts: tuple[str, ...]) -> list[Stage]:
    """All passes that have steps, in order."""
    found = []
    for part in (part for part in TRAINED if part in parts):
        one, two = getattr(recipe, part)
        found += [Stage(part, "I", one, 0), Stage(part, "II", two, one.steps)]
    return [stage for stage in found if stage.recipe.steps]
