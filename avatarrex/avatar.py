"""An avatar: a person's templates and the fields that were learned on them. Read and written: `avatar_file.py`."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import torch
from torch import Tensor, nn

from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.fields.body import BodyField
from avatarrex.fields.face import FaceField
from avatarrex.fields.hand import HandField
from avatarrex.fields.light import Light
from avatarrex.fields.limbs import Ownership
from avatarrex.fields.placement import device_named, place
from avatarrex.fields.presets import BASES, PRESETS
from avatarrex.fields.tone import ToneMap
from avatarrex.parts.face import Face
from avatarrex.parts.hand import Hand
from avatarrex.parts.known_expressions import KnownExpressions
from avatarrex.parts.part import Part
from avatarrex.signals.driving import Signals
from avatarrex.surface.surface import Surface
from avatarrex.templates.parts import HANDS, PARTS
from avatarrex.templates.person import Person
from avatarrex.templates.posed import pose_person

FORMAT = 4
"""Version of the folder layout; a reader refuses a newer one by name."""


@dataclass
class Avatar:
    """A person with fields for body, hands and face, on which `render` draws.

    `load` reads one, `Avatar.create` makes an untrained one, `save` writes it; `meta` is its `avatar.json`.
    """

    person: Person
    body: BodyField
    left_hand: HandField
    right_hand: HandField
    face: FaceField
    tone: ToneMap
    light: Light
    meta: dict[str, Any] = field(default_factory=dict)
    device: str = "cpu"
    """Where the networks run."""
    surface: Surface | None = None
    """Distilled from the fields; what level `live` draws."""
    versions: dict[str, int] = field(default_factory=dict)
    """Of the fields of `body` and of parts, by name: a volume of another version is not reused. 0 unless said."""

    @classmethod
    def create(cls, person: Person, preset: str, seed: int = 0, local_frame: str = "turned") -> Avatar:
        """Untrained fields on `person`; preset `paper` or `compact`, or `PRESET/VARIANT` (fields/presets.py)."""
        if preset not in PRESETS:
            raise InputError("avatar", "preset", " or ".join(BASES), preset)
        torch.manual_seed(seed)
        widths = PRESETS[preset]
        avatar = cls(
            person,
            BodyField(person.body, widths, seed, local_frame, person.hand_weight == 1),
            HandField(person.left_hand, widths),
            HandField(person.right_hand, widths),
            FaceField(person.face, widths),
            ToneMap(widths),
            Light(),
            {"format": FORMAT, "preset": preset, "local_frame": local_frame, "seed": seed},
        )
        for module in avatar.modules().values():
            module.requires_grad_(False).eval()
        return avatar

    @cached_property
    def parts(self) -> dict[str, Part[Any]]:
        """Hands and face with their templates and fields, in the order of `PARTS`."""
        hands = {name: Hand.of(name, self.hand(name)) for name in HANDS}
        return {**hands, "face": Face.of(self.face, self.person.face, self.tone, self.known_expressions)}

    @property
    def known_expressions(self) -> KnownExpressions | None:
        """What the face was trained on, where `meta` says so. Raises `InputError` where that cannot be read."""
        return KnownExpressions.in_meta(self.meta, "avatar.json")

    def hand(self, name: str) -> HandField:
        """The field of `left_hand` or `right_hand`."""
        return {"left_hand": self.left_hand, "right_hand": self.right_hand}[name]

    def modules(self) -> dict[str, nn.Module]:
        """The fields by name, the tone mapping and the light."""
        return {
            "body": self.body,
            "left_hand": self.left_hand,
            "right_hand": self.right_hand,
            "face": self.face,
            "tone": self.tone,
            "light": self.light,
        }

    def place(self, device: str) -> None:
        """Bring the networks to a device that torch has, once. Raises `InputError`."""
        where = device_named(device)
        for module in self.modules().values():
            place(module, where)
        self.device = str(where)

    def frozen_copy(self) -> Avatar:
        """The fields as they are now, without gradients; later training does not change them."""
        copies = {name: copy.deepcopy(module).requires_grad_(False) for name, module in self.modules().items()}
        return Avatar(self.person, meta=self.meta, device=self.device, **copies)  # type: ignore[arg-type]

    @property
    def hidden(self) -> frozenset[str]:
        """Parts that were never trained: they are not drawn. In the face's place the body's field shows; hands are missing."""
        return frozenset(self.meta.get("untrained", ()))

    def measure_clothing_offset(self) -> None:
        """Let the body field find how far its surface stands off the template; after every change of its weights."""
        posed = pose_person(self.person, Signals.rest(), Counters(), None)
        self.body.measure_clothing_offset(posed.body, self.body.code(posed.body_rotation))

    @cached_property
    def embedding_effect(self) -> float:
        """Metres that a unit of the body's embedding counts; of the weights as they are at first use."""
        posed = pose_person(self.person, Signals.rest(), Counters(), None)
        return self.body.embedding_effect(posed.body, self.body.code(posed.body_rotation))

    @cached_property
    def ownership(self) -> dict[str, Ownership]:
        """Which nodes and vertices are each part's own at rest."""
        rest = self.person.body.v_template.float()
        weight = self.person.blend_weight
        return {
            name: Ownership.of(self.body.node_rest.float(), rest, rest[weight[:, column] > 0.5])
            for column, name in enumerate(PARTS)
        }

    def state(self) -> dict[str, Tensor]:
        """Every parameter and buffer, named `part.name`."""
        return {
            f"{part}.{name}": value.cpu().contiguous()
            for part, module in self.modules().items()
            for name, value in module.state_dict().items()
        }
