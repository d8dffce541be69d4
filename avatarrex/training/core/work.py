"""Work: one stage of a training in progress, its pass, its optimiser and the state that a checkpoint stores of them."""

from __future__ import annotations

import json
import math
import resource
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from avatarrex.avatar import Avatar
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.losses import weighted
from avatarrex.training.core.pass_one import BodyPass, FacePass, StepResult
from avatarrex.training.core.pass_two import PatchPass
from avatarrex.training.core.stage import Stage
from avatarrex.training.core.texel_descent import TexelDescent
from avatarrex.training.recipe import PassTwo

AnyPass = BodyPass | FacePass | PatchPass


def pass_of(stage: Stage, avatar: Avatar, store: FrameStore, perceptual: Perceptual, seed: int) -> AnyPass:
    """The losses of a stage."""
    if isinstance(stage.recipe, PassTwo):
        return PatchPass(avatar, store, stage.part, stage.recipe, perceptual, seed)
    return (FacePass if stage.part == "face" else BodyPass)(avatar, store, stage.recipe, seed)


class Diverged(ArithmeticError):
    """A loss that is not finite; the message names the saved batch."""


class Work:
    """A stage in progress."""

    def __init__(
        self, stage: Stage, losses: AnyPass, state: dict[str, Any] | None, kept: Iterable[nn.Parameter] = ()
    ) -> None:
        """From the stage's first step, or from a checkpoint's `state`; parameters that are `kept` are not learnt."""
        self.stage, self.losses = stage, losses
        self.step = stage.begin if state is None else int(state["step"])
        stay = {id(parameter) for parameter in kept}
        self.parameters = [parameter for parameter in losses.parameters() if id(parameter) not in stay]
        for parameter in self.parameters:
            parameter.requires_grad_(True)
        geometry, texels, others = _groups(losses.avatar, stage.part, self.parameters)
        self.optimiser = torch.optim.Adam([geometry, others], lr=stage.rate(self.step), fused=True)
        self.texels = TexelDescent(texels["params"], stage.rate(self.step)) if texels["params"] else None
        if state is not None:
            load(self.optimiser, state["optimiser"])
            if self.texels is not None:
                self.texels.load_state_dict(state["texels"])
            if isinstance(losses, BodyPass):
                losses.frame_codes.data.copy_(state["frame_codes"])

    def evaluate(self) -> tuple[StepResult, Tensor]:
        """The step's terms, of all processes, and the weighted sum of what this one has of them, which is differentiable."""
        result = self.losses.step(self.step, self.stage.gamma(self.step))
        own = weighted(result.terms, self.stage.recipe.weights)
        whole = self.losses.group.sum(torch.stack(list(result.terms.values())))
        return replace(result, terms=dict(zip(result.terms, whole))), own

    def total(self, result: StepResult) -> Tensor:
        """The weighted sum of a step's terms."""
        return weighted(result.terms, self.stage.recipe.weights)

    def descend(self, total: Tensor) -> None:
        """Change the parameters along the gradient of `total`, summed over the processes."""
        geometry, texels, others = self.stage.rates(self.step)
        rates = {self.optimiser: (geometry, others)} | ({self.texels: (texels,)} if self.texels else {})
        for optimiser, some in rates.items():
            for group, rate in zip(optimiser.param_groups, some):
                group["lr"] = rate
            optimiser.zero_grad(set_to_none=True)
        if total.requires_grad:  # else nothing of the part is seen in the patch: nothing to learn
            torch.autograd.backward(total)
        self.losses.group.add_gradients(self.parameters)
        for optimiser in rates:
            optimiser.step()

    def state(self) -> dict[str, Any]:
        """What a checkpoint within the stage stores besides the avatar."""
        codes = {"frame_codes": self.losses.frame_codes.data} if isinstance(self.losses, BodyPass) else {}
        texels = {} if self.texels is None else {"texels": self.texels.state_dict()}
        return {"optimiser": self.optimiser.state_dict(), **texels, **codes}

    def figures(self, result: StepResult, total: float, speed: float) -> dict[str, float]:
        """What is reported of a step, by tag; `speed` in steps per second."""
        values = {f"loss/{name}": float(value.detach()) for name, value in result.terms.items()}
        values |= {
            "loss/total": total,
            "schedule/gamma": self.stage.gamma(self.step),
            "schedule/lr": self.stage.rate(self.step),
            "rate/steps_per_s": speed,
            "rate/samples_per_ray": result.samples_per_ray,
            "rate/silhouette_rays": result.silhouette_rays,
            "memory/mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }
        return {f"{self.stage.part}/{name}": value for name, value in values.items()}

    def diverged(self, result: StepResult, folder: Path, seed: int) -> Diverged:
        """Save what the step was made of in the run's folder; the error to raise."""
        path, part, name = folder / "failed_step.json", self.stage.part, self.stage.name
        terms = {term: float(value.detach()) for term, value in result.terms.items()}
        content = {"part": part, "pass": name, "step": self.step, "seed": seed, "terms": terms}
        content["pictures"] = [list(pair) for pair in result.pictures]
        if self.losses.group.leads:
            path.write_text(json.dumps(content, indent=2) + "\n")
        bad = ", ".join(term for term, value in terms.items() if not math.isfinite(value))
        return Diverged(
            f"{part}, pass {name}, step {self.step}: {bad or 'the total'} is not finite; the batch is described in"
            f" {path}; --resume goes on from the last checkpoint"
        )

    def close(self) -> None:
        """Freeze the parameters."""
        for parameter in self.parameters:
            parameter.requires_grad_(False)


def load(optimiser: torch.optim.Optimizer, saved: dict[str, Any]) -> None:
    """The saved state in its parameters' own layout: checkpoints are contiguous, the U-Nets' weights channels-last, and
    the fused step reads memory in order."""
    optimiser.load_state_dict(saved)
    for parameter, state in optimiser.state.items():
        for name, value in state.items():
            if torch.is_tensor(value) and value.shape == parameter.shape:
                state[name] = torch.empty_like(parameter).copy_(value)


def _groups(avatar: Avatar, part: str, parameters: list[nn.Parameter]) -> list[dict[str, Any]]:
    """Geometry, texels, and all else."""
    field = avatar.body.geometry_parameters() if part == "body" else avatar.face.geometry.parameters()
    texels = [detail.texel for detail in (avatar.body.detail, avatar.face.detail) if detail is not None]
    kind = {id(p): number for number, some in enumerate((field, texels)) for p in some}
    return [{"params": [p for p in parameters if kind.get(id(p), 2) == number]} for number in range(3)]
