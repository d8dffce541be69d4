"""The expressions that a face was trained on, a box of ψ, jaw and eyes, and the shape. Ours.

Of others the face's networks know nothing (`carried.py` and `reshaped.py` say what is done there).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.fields.face import COEFFICIENTS
from avatarrex.signals.driving import LARGEST, SHAPES, Signals
from avatarrex.signals.joints import EXPRESSION_NAMES

ROOM = 0.3
"""Share of the trained range by which coefficients may exceed it: networks go on well for so long."""
SHOWN = 0.05
"""Of a coefficient of ψ: what moved less in the pictures counts as never shown."""
DIGITS = 4


@dataclass(frozen=True, eq=False)
class KnownExpressions:
    """The least and the greatest of ψ (52), jaw (3) and both eyes (6, rotation vectors) among the trained frames."""

    least: Float[np.ndarray, " 61"]
    most: Float[np.ndarray, " 61"]
    shape: Float[np.ndarray, " 10"] = field(default_factory=lambda: np.zeros(SHAPES["shape"]))
    """β."""

    @classmethod
    def of(cls, frames: Sequence[Signals]) -> KnownExpressions:
        """What these frames show, and the face at rest."""
        shown = np.stack([np.concatenate([one.expression, one.jaw_pose, one.eye_pose.ravel()]) for one in frames])
        shape = np.mean([one.shape for one in frames], 0).round(DIGITS)
        return cls(shown.min(0).clip(max=0).round(DIGITS), shown.max(0).clip(min=0).round(DIGITS), shape)

    @classmethod
    def in_meta(cls, meta: Mapping[str, Any], file: str) -> KnownExpressions | None:
        """What an avatar's `meta`, read from `file`, says of its training; None where it says nothing. Raises `InputError`."""
        training = meta.get("training")
        if not isinstance(training, Mapping) or training.get("expressions") is None:
            return None
        return cls.from_json(training["expressions"], file)

    @classmethod
    def from_json(cls, data: object, file: str) -> KnownExpressions:
        """What `to_json` gave, read from `file`. Raises `InputError`."""
        found = data if isinstance(data, Mapping) else {}
        found = {"shape": [0.0] * SHAPES["shape"][0], **found}  # files until 2026-11-26 do not say it
        values = []
        for name, count in (("least", COEFFICIENTS), ("most", COEFFICIENTS), ("shape", SHAPES["shape"][0])):
            try:
                value = np.asarray(found.get(name), dtype=np.float64)
            except (TypeError, ValueError):
                value = np.zeros(0)
            largest = LARGEST["shape" if name == "shape" else "expression"]
            if value.shape != (count,) or not (np.abs(value) <= largest).all():
                expected = f"{count} numbers up to ±{largest:g}"
                raise InputError(file, f"training: expressions: {name}", expected, found.get(name))
            values.append(value)
        return cls(*values)

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {name: getattr(self, name).tolist() for name in ("least", "most", "shape")}

    @property
    def never_shown(self) -> tuple[str, ...]:
        """Names of the coefficients of ψ that the pictures did not show."""
        return tuple(name for name, most in zip(EXPRESSION_NAMES, self.most) if most < SHOWN)

    def nearest(self, coefficients: Float[Tensor, " 61"]) -> Float[Tensor, " 61"]:
        """What lies nearest to `coefficients` in the box and `ROOM` about it."""
        low, high = (torch.as_tensor((1 + ROOM) * limit).to(coefficients) for limit in (self.least, self.most))
        return coefficients.clamp(low, high)
