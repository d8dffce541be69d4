"""Training steps as the trainer takes them (losses, gradients, Adam), without its run folder: to count and to time them."""

from __future__ import annotations

import torch

from avatarrex.training.core.losses import weighted
from avatarrex.training.core.pass_one import BodyPass, FacePass, StepResult
from avatarrex.training.core.pass_two import PatchPass


class Stepper:
    """One pass of a training; its parameters take gradients from here on."""

    def __init__(self, work: BodyPass | FacePass | PatchPass, rate: float) -> None:
        """`rate`: Adam's."""
        self.work, self.parameters = work, work.parameters()
        for parameter in self.parameters:
            parameter.requires_grad_(True)
        self.optimiser = torch.optim.Adam(self.parameters, lr=rate, fused=True)

    def step(self, number: int, gamma: float) -> tuple[StepResult, float]:
        """One step, and its loss."""
        result = self.work.step(number, gamma)
        loss = weighted(result.terms, self.work.recipe.weights)
        self.optimiser.zero_grad(set_to_none=True)
        if loss.requires_grad:
            loss.backward()
            self.optimiser.step()
        return result, float(loss.detach())
