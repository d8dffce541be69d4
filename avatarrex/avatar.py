"""An avatar: a person's templates and the fields that were learned on them, in one folder or one `.avatar` zip.

`avatar.json` says what it is (format version, presets, template with its hash and size, provenance, licence), `weights.safetensors` holds
every parameter and buffer. Spec: `assets_spec/avatar.json`.
"""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.fields.body import BodyField
from avatarrex.fields.face import FaceField
from avatarrex.fields.hand import HandField
from avatarrex.fields.presets import PRESETS
from avatarrex.signals.signals import Signals
from avatarrex.templates.person import Person, PersonFit, load_person, resize_person
from avatarrex.templates.posed import pose_person
from avatarrex.volume.contact import Ownership

FORMAT = 1
"""Version of the folder layout; a reader refuses a newer one by name."""
DATA = Path(__file__).parent / "data"


@dataclass
class Avatar:
    """A person with fields for body, hands and face."""

    person: Person
    body: BodyField
    left_hand: HandField
    right_hand: HandField
    face: FaceField
    meta: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def create(cls, person: Person, preset: str, seed: int = 0, local_frame: str = "anchors") -> Avatar:
        """Untrained fields on `person`; preset `paper` or `compact`."""
        if preset not in PRESETS:
            raise InputError("avatar", "preset", " or ".join(PRESETS), preset)
        torch.manual_seed(seed)
        widths = PRESETS[preset]
        avatar = cls(
            person,
            BodyField(person.body, widths, seed=seed, local_frame=local_frame),
            HandField(person.left_hand, widths),
            HandField(person.right_hand, widths),
            FaceField(person.face, widths),
            {"format": FORMAT, "preset": preset, "local_frame": local_frame, "seed": seed},
        )
        for module in avatar.modules().values():
            module.requires_grad_(False).eval()
        return avatar

    def hand(self, name: str) -> HandField:
        """The field of `left_hand` or `right_hand`."""
        return {"left_hand": self.left_hand, "right_hand": self.right_hand}[name]

    def modules(self) -> dict[str, nn.Module]:
        """The four fields by name."""
        return {"body": self.body, "left_hand": self.left_hand, "right_hand": self.right_hand, "face": self.face}

    @cached_property
    def hand_weight(self) -> Tensor:
        """Painted ω of either hand on the body template, (v,)."""
        return self.person.blend_weight[:, :2].amax(-1)

    def measure_worn(self) -> None:
        """Let the body field find how far its surface stands off the template; after every change of its weights."""
        posed = pose_person(self.person, Signals.rest(), Counters(), None)
        self.body.measure_worn(posed.body, self.body.code(posed.body_rotation))

    @cached_property
    def ownership(self) -> dict[str, Ownership]:
        """Which nodes and vertices are each part's own at rest."""
        rest = self.person.body.v_template.float()
        weight = self.person.blend_weight
        return {
            name: Ownership.of(self.body.node_rest.float(), rest, rest[weight[:, column] > 0.5])
            for column, name in enumerate(("left_hand", "right_hand", "face"))
        }

    def state(self) -> dict[str, Tensor]:
        """Every parameter and buffer, named `part.name`."""
        return {
            f"{part}.{name}": value.contiguous()
            for part, module in self.modules().items()
            for name, value in module.state_dict().items()
        }


def load_avatar(source: str | Path = "default") -> Avatar:
    """Read a packaged avatar by name, an avatar folder, or an `.avatar` file. Raises `InputError`."""
    path = DATA / "default.avatar" if str(source) == "default" else Path(source)
    if not path.exists():
        raise InputError(source, "", "an avatar folder or an .avatar file", "nothing there")
    text, weights = _read(path)
    try:
        meta = json.loads(text)
    except ValueError as error:
        raise InputError(path, "avatar.json", "JSON", error) from None
    if not isinstance(meta, dict) or not isinstance(meta.get("format"), int):
        raise InputError(
            path, "avatar.json: format", "an integer", meta.get("format") if isinstance(meta, dict) else meta
        )
    if meta["format"] > FORMAT:
        raise InputError(path, "avatar.json: format", f"at most {FORMAT} (update the studio)", meta["format"])
    person = load_person(meta.get("person", "default"))
    if "person_fit" in meta:
        person = resize_person(person, PersonFit.from_json(meta["person_fit"], f"{path}: avatar.json"))
    if meta.get("person_hash") not in (None, person.hash):
        raise InputError(
            path, "avatar.json: person_hash", f"the template it was made on ({person.hash})", meta["person_hash"]
        )
    avatar = Avatar.create(person, meta.get("preset", ""), meta.get("seed", 0), meta.get("local_frame", "anchors"))
    try:
        state = safetensors.torch.load(weights)
    except (safetensors.SafetensorError, ValueError) as error:
        raise InputError(path, "weights.safetensors", "a safetensors file", error) from None
    _fill(path, avatar, state)
    avatar.meta = meta
    return avatar


def save_avatar(avatar: Avatar, path: str | Path, half: bool = True) -> None:
    """Write `avatar` to a folder, or to one file when `path` ends in `.avatar`; all or nothing.

    Floating-point weights are stored in half precision when `half` (the surface moves by less than 0.1 mm).
    """
    path = Path(path)
    state = {
        name: value.half() if half and value.is_floating_point() else value for name, value in avatar.state().items()
    }
    meta = {**avatar.meta, "format": FORMAT, "person": avatar.person.name, "person_hash": avatar.person.hash}
    meta.pop("person_fit", None)
    if avatar.person.fit is not None:
        meta["person_fit"] = avatar.person.fit.to_json()
    text = json.dumps(meta, indent=2, ensure_ascii=False) + "\n"
    weights = safetensors.torch.save(state)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".avatar":
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file, zipfile.ZipFile(file, "w") as archive:
            archive.writestr("avatar.json", text)
            archive.writestr("weights.safetensors", weights, zipfile.ZIP_DEFLATED)
        os.chmod(file.name, 0o644)
        os.replace(file.name, path)
        return
    path.mkdir(exist_ok=True)
    for name, content in (("weights.safetensors", weights), ("avatar.json", text.encode())):
        with tempfile.NamedTemporaryFile(dir=path, delete=False) as file:
            file.write(content)
        os.replace(file.name, path / name)


def _read(path: Path) -> tuple[str, bytes]:
    try:
        if path.is_dir():
            return (path / "avatar.json").read_text(), (path / "weights.safetensors").read_bytes()
        with zipfile.ZipFile(path) as archive:
            return archive.read("avatar.json").decode(), archive.read("weights.safetensors")
    except (OSError, KeyError, zipfile.BadZipFile, UnicodeDecodeError, ValueError) as error:
        raise InputError(path, "", "an avatar folder or .avatar file with avatar.json and weights", error) from None


def _fill(path: Path, avatar: Avatar, state: dict[str, Tensor]) -> None:
    """Load `state` into the fields after checking every name, shape and value."""
    expected = avatar.state()
    for name, value in expected.items():
        if name not in state:
            raise InputError(path, f"weights.safetensors: {name}", f"a tensor {tuple(value.shape)}", "missing")
        if state[name].shape != value.shape:
            raise InputError(path, f"weights.safetensors: {name}", str(tuple(value.shape)), tuple(state[name].shape))
        if state[name].is_floating_point() and not torch.isfinite(state[name]).all():
            raise InputError(path, f"weights.safetensors: {name}", "finite numbers", "NaN or Inf")
    extra = sorted(set(state) - set(expected))
    if extra:
        raise InputError(path, f"weights.safetensors: {extra[0]}", "no such tensor in this preset", "present")
    for part, module in avatar.modules().items():
        prefix = part + "."
        module.load_state_dict(
            {
                name[len(prefix) :]: value.to(expected[name].dtype)
                for name, value in state.items()
                if name.startswith(prefix)
            }
        )
