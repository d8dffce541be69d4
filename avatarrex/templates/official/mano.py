"""MANO as it is published: a hand of 778 vertices and 16 joints, 45 pose components (docs/formats.md).

Two faults of the files are repaired. The left file's shape directions are the right's, of which x was not mirrored: then x is negated.
The wrist is open: it is closed by one vertex in the middle of its rim, the last. Letters: v vertices. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.signals.joints import HAND_JOINTS
from avatarrex.templates.hand import open_loop
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.model_arrays import hash_arrays, read_model
from avatarrex.templates.official.model_file import read_model_file

OUTWARDS = {"left": "+x", "right": "-x"}
"""Where the fingers of each hand point at rest."""
VERTICES = 778
"""Of the file; the closed hand has one more."""


@dataclass(frozen=True, eq=False)
class ManoFile:
    """What a file holds."""

    side: str
    model: TemplateModel
    """Closed: 779 vertices, and 16 joints from the wrist on."""
    hash: str
    repaired: bool = False
    """Whether the shape directions were those of the right hand."""


def read_hands(left: str | Path, right: str | Path) -> dict[str, ManoFile]:
    """Both hands by side; the left's shape directions are repaired where they are nearer to the right's than to these
    mirrored, in x. Raises `InputError`.
    """
    hands = {"left": read_hand(left, "left"), "right": read_hand(right, "right")}
    own, other = (hands[side].model.shapedirs[:VERTICES, 0] for side in ("left", "right"))
    if (own - other).norm() < (own + other).norm():
        hands["left"] = _mirrored(hands["left"])
    return hands


def read_hand(path: str | Path, side: str) -> ManoFile:
    """One hand, closed, its shape directions as stored. Raises `InputError` naming file and key."""
    arrays = read_model_file(path, "mano", "a MANO")
    model = replace(read_model({**arrays, "n_shape": np.array(10)}, path), joint_names=("wrist", *HAND_JOINTS))
    towards = "+x" if model.joint_template[4, 0] > model.joint_template[0, 0] else "-x"
    if towards != OUTWARDS[side]:
        raise InputError(
            path, "v_template", f"a {side} hand, with fingers towards {OUTWARDS[side]}", f"fingers towards {towards}"
        )
    return ManoFile(side, _closed(model, path), hash_arrays(arrays))


def _closed(model: TemplateModel, path: str | Path) -> TemplateModel:
    """With a fan over the wrist: its middle moves as the rim does."""
    rim = torch.from_numpy(open_loop(model.faces.numpy(), f"{path}: wrist"))
    middle = torch.full_like(rim, len(model.v_template))
    cap = torch.stack([rim, middle, rim.roll(-1)], 1)

    def rows(values: Tensor) -> Tensor:
        return torch.cat([values, values[rim].mean(0, keepdim=True)])

    return replace(
        model,
        v_template=rows(model.v_template),
        faces=torch.cat([model.faces, cap]),
        shapedirs=rows(model.shapedirs),
        expression_dirs=rows(model.expression_dirs),
        weights=rows(model.weights),
        posedirs=None if model.posedirs is None else rows(model.posedirs),
    )


def _mirrored(hand: ManoFile) -> ManoFile:
    """With x of every shape direction negated, of the joints', too."""
    sign = torch.tensor([-1.0, 1.0, 1.0])[:, None]
    model = hand.model
    repaired = replace(model, shapedirs=model.shapedirs * sign, joint_shapedirs=model.joint_shapedirs * sign)
    return replace(hand, model=repaired, repaired=True)
