"""Warm start: the geometry of body and face is fitted to a guess at the template's signed distance before pass I.

Not in the paper, which starts from scratch: supervised distances take seconds where volume rendering takes hours to find
the rough shape. Where the packaged prior (prior.py) has the shape of the avatar's networks, the fit goes on from there: on another
template each of its nodes lies on the vertex nearest to where it lay, once the default person has that template's joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.capture.fit.person_fit import fit_person
from avatarrex.fields.body import SDF_UNIT
from avatarrex.files.assets import DATA
from avatarrex.files.tensors import read_safetensors
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person, load_person
from avatarrex.training.core.losses import distance_loss
from avatarrex.training.core.supervision import Draw, supervision

WARM_FRAMES = 16
RATE = 2e-3
KNOWN_RATE = 5e-4
"""Where the prior has been loaded: only the person's own shape is left to find."""
PRIOR = DATA / "prior.safetensors"
CLEAR = 0.05
"""Metres: at the first γ of the paper a ray through a node's sphere then loses a third."""
KNOWN = {
    "body": (
        "code_network.decoder.",
        "code_network.encoder.",
        "geometry_local.",
        "geometry_blend.",
        "node_vertex",
        "anchor_vertex",
    ),
    "face": ("geometry.",),
    "face_colour": ("colour_net.",),
}
"""Weights and nodes of each part of the prior."""


def module_of(part: str) -> str:
    """Name of the avatar's module that a part of the prior belongs to."""
    return part.removesuffix("_colour")


def known_state(state: Mapping[str, Tensor], part: str) -> dict[str, Tensor]:
    """The prior's `part` of a module's state, named `module.name`."""
    return {f"{module_of(part)}.{name}": value for name, value in state.items() if name.startswith(KNOWN[part])}


def read_prior(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and description of a prior. Raises `InputError`."""
    return read_safetensors(path, "a prior's tensors")


def prior_of(avatar: Avatar, part: str) -> dict[str, Tensor] | None:
    """A part of the packaged prior by `module.name`, its nodes on the avatar's template; None where the networks are others."""
    own = known_state(avatar.modules()[module_of(part)].state_dict(), part)
    tensors, about = read_prior(PRIOR)
    prior = {name: tensors[name] for name in own if name in tensors}
    if {name: value.shape for name, value in own.items()} != {name: value.shape for name, value in prior.items()}:
        return None
    if part == "body" and int(about["vertices"]) != len(avatar.person.body.v_template):
        prior["body.node_vertex"] = carried_nodes(prior["body.node_vertex"], avatar.person)
        prior["body.anchor_vertex"] = own["body.anchor_vertex"]  # they carry no weights
    return prior


def carried_nodes(vertex: Tensor, person: Person) -> Tensor:
    """Vertices (n,) of the default person on another's body: nearest to where they are once it has that one's joints."""
    joints = person.body.joint_template.double().numpy()
    default = fit_person(load_person("default"), joints - joints[0], person.name).body.v_template
    moved = default.numpy()[vertex.numpy()] + joints[0]
    return torch.from_numpy(cKDTree(person.body.v_template.numpy()).query(moved)[1])


def load_prior(avatar: Avatar, part: str) -> bool:
    """Take a part of the packaged prior; False, and nothing changed, where it is of other networks."""
    prior = prior_of(avatar, part)
    if prior is None:
        return False
    module = avatar.modules()[module_of(part)]
    taken = {name.removeprefix(f"{module_of(part)}."): value for name, value in prior.items()}
    module.load_state_dict({**module.state_dict(), **taken})
    return True


class Fit:
    """Parameters that are fitted to what `draw` supervises, by Adam."""

    def __init__(
        self, parameters: list[nn.Parameter], draw: Draw, loss: Callable[[Tensor, Tensor], Tensor] = distance_loss
    ) -> None:
        self.parameters, self.draw, self.loss = parameters, draw, loss
        for parameter in parameters:
            parameter.requires_grad_(True)
        self.optimiser = torch.optim.Adam(parameters, fused=True)

    def step(self, rng: np.random.Generator, rate: float) -> float:
        """One step at a learning rate; the mean error before it. Raises FloatingPointError for a loss that is not finite."""
        self.optimiser.param_groups[0]["lr"] = rate
        predicted, truth = self.draw(rng)
        loss = self.loss(predicted, truth)
        if not torch.isfinite(loss):
            raise FloatingPointError("the loss is not finite")
        self.optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        self.optimiser.step()
        return float((predicted - truth).detach().abs().mean())


@torch.no_grad()
def clear_space(avatar: Avatar) -> None:
    """Take an untrained body away from before the face: everywhere `CLEAR` from its surface, where its nodes reach.

    As networks begin, distances are a few millimetres of either sign: fog about the whole person, which hides a face that
    is trained first. The face's own fog is where it is looked for.
    """
    *_, last = avatar.body.geometry_blend.parameters()
    last.fill_(CLEAR / SDF_UNIT)


def warm_start(avatar: Avatar, poses: Sequence[Signals], part: str, steps: int, seed: int, prior: bool = True) -> float:
    """Load what is known of `body` or `face` and fit its geometry for `steps` steps on some of the training's poses.

    Without `prior` nothing is known. Returns the mean error of the last tenth, metres.
    """
    rate = KNOWN_RATE if prior and load_prior(avatar, part) else RATE
    if prior and part == "face":
        load_prior(avatar, "face_colour")
    frames = sorted(set(np.linspace(0, len(poses) - 1, WARM_FRAMES).round().astype(int).tolist()))
    rng = np.random.default_rng([seed, 17])
    fit = Fit(*supervision(avatar, [poses[index] for index in frames], part, rng))
    errors = [fit.step(rng, rate * 0.05 ** (k / steps)) for k in tqdm(range(steps), desc=f"{part}: warm start")]
    for parameter in fit.parameters:
        parameter.requires_grad_(False)
    return float(np.mean(errors[-max(1, steps // 10) :])) if errors else float("nan")
