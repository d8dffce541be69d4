"""An avatar: a person's templates and the fields that were learned on them, in one folder or one `.avatar` zip.

`avatar.json` says what it is (format version, presets, template with its hash and size, provenance, licence), `weights.safetensors` holds
every parameter and buffer. Spec: `assets_spec/avatar.json`.
"""

from __future__ import annotations

import copy
import json
import os
import tempfile
import zipfile
import zlib
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
from avatarrex.fields.light import Light
from avatarrex.fields.limbs import Ownership
from avatarrex.fields.local_frame import UNSAID
from avatarrex.fields.placement import device_named, place
from avatarrex.fields.presets import BASES, PRESETS
from avatarrex.fields.tone import ToneMap
from avatarrex.files.gate import parse_json, what_is
from avatarrex.parts.face import Face
from avatarrex.parts.hand import Hand
from avatarrex.parts.part import Part
from avatarrex.signals.driving import Signals
from avatarrex.templates.parts import HANDS, PARTS
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit
from avatarrex.templates.posed import pose_person

FORMAT = 3
"""Version of the folder layout; a reader refuses a newer one by name."""
SINCE = {"tone.": 2, "light.": 3, "body.code_network.least": 3, "body.code_network.most": 3}
"""Format since which there are weights of such names; avatars of before have the identity."""
FILES = ("avatar.json", "weights.safetensors")
LARGEST = 2**30
"""Bytes that either file may unpack to; the paper's preset has 90 MB of weights."""
DATA = Path(__file__).parent / "data"


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

    @property
    def parts(self) -> dict[str, Part[Any]]:
        """Hands and face with their templates and fields, in the order of `PARTS`."""
        hands = {name: Hand.of(name, self.hand(name), self.light) for name in HANDS}
        return {**hands, "face": Face.of(self.face, self.person.face.blend_weight, self.tone)}

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
        """Parts that were never trained: they are not drawn, and the body's field shows in their place."""
        return frozenset(self.meta.get("untrained", ()))

    @cached_property
    def hand_weight(self) -> Tensor:
        """Painted ω of either hand on the body template, (v,)."""
        return self.person.hand_weight

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


def load_avatar(source: str | Path = "default", device: str = "cpu") -> Avatar:
    """Read an avatar: "default" for the packaged one, an avatar folder, or an `.avatar` file.

    The networks run on `device`, any that torch has ("cpu", "cuda", …). Raises `InputError` for what is not there, not an
    avatar, of a newer format, or damaged, with file and field; and for a device that cannot be had.
    """
    device_named(device)  # what cannot be had is said before the work
    path = DATA / "default.avatar" if str(source) == "default" else Path(source)
    text, weights = _read(path)
    meta = _meta(path, parse_json(text, path, "avatar.json"))
    person = load_person(meta.get("person", "default"))
    if "person_fit" in meta:
        person = resize_person(person, PersonFit.from_json(meta["person_fit"], f"{path}: avatar.json"))
    if meta.get("person_hash") not in (None, person.hash):
        raise InputError(
            path, "avatar.json: person_hash", f"the template it was made on ({person.hash})", meta["person_hash"]
        )
    avatar = Avatar.create(person, meta["preset"], meta.get("seed", 0), meta.get("local_frame", UNSAID))
    try:
        state = safetensors.torch.load(weights)
    except (safetensors.SafetensorError, ValueError) as error:
        raise InputError(path, "weights.safetensors", "a safetensors file", error) from None
    _fill(path, avatar, state, meta["format"])
    avatar.meta = meta
    avatar.place(device)
    return avatar


def save_avatar(avatar: Avatar, path: str | Path, half: bool = True) -> None:
    """Write `avatar` to a folder, or to one file when `path` ends in `.avatar`; all or nothing.

    Floating-point weights are stored in half precision when `half` (the surface moves by less than 0.1 mm). `load` reads
    it back. Raises `OSError` where `path` cannot be written.
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
    """The text of `avatar.json` and the bytes of the weights, from a folder or a zip."""
    found, name, content = what_is(path), "", {}
    if found not in ("a file", "a folder"):
        raise InputError(path, "", "an avatar folder or an .avatar file", found)
    try:
        if found == "a folder":
            for name in FILES:
                content[name] = (path / name).read_bytes()
        else:
            with zipfile.ZipFile(path) as archive:
                for name in FILES:
                    size = archive.getinfo(name).file_size
                    if size > LARGEST:
                        raise InputError(path, name, f"at most {LARGEST >> 20} MiB", f"{size >> 20} MiB")
                    content[name] = archive.read(name)
        return content[FILES[0]].decode(), content[FILES[1]]
    except (KeyError, FileNotFoundError):
        raise InputError(path, name, "the file to be in the avatar", "nothing there") from None
    except UnicodeDecodeError:
        raise InputError(path, FILES[0], "text in UTF-8", "another encoding") from None
    # RuntimeError: an encrypted archive
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError, MemoryError) as error:
        raise InputError(path, name, "an avatar folder or a whole .avatar file", error) from None


def _meta(path: Path, meta: Any) -> dict[str, Any]:
    """`avatar.json`, checked."""
    if not isinstance(meta, dict):
        raise InputError(path, "avatar.json", "an object", type(meta).__name__)
    kinds = {
        "format": (int, None),
        "preset": (str, None),
        "seed": (int, 0),
        "person": (str, ""),
        "local_frame": (str, ""),
    }
    for key, (kind, default) in kinds.items():
        value = meta.get(key, default)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise InputError(path, f"avatar.json: {key}", "a text" if kind is str else "an integer", value)
    if not 1 <= meta["format"] <= FORMAT:
        raise InputError(path, "avatar.json: format", f"at most {FORMAT} (update the studio)", meta["format"])
    if meta["preset"] not in PRESETS:
        raise InputError(path, "avatar.json: preset", " or ".join(BASES), meta["preset"])
    if not 0 <= meta.get("seed", 0) < 2**63:
        raise InputError(path, "avatar.json: seed", "an integer from 0, below 2^63", meta["seed"])
    untrained = meta.get("untrained", [])
    if not (isinstance(untrained, list) and all(part in PARTS for part in untrained)):
        raise InputError(path, "avatar.json: untrained", "a list of " + ", ".join(PARTS), untrained)
    return meta


def _fill(path: Path, avatar: Avatar, state: dict[str, Tensor], format: int) -> None:
    """Load `state` into the fields after checking every name, shape and value."""
    expected = avatar.state()
    unknown = tuple(name for name, since in SINCE.items() if format < since)
    state = {**{name: value for name, value in expected.items() if name.startswith(unknown)}, **state}
    for name, value in expected.items():
        if name not in state:
            raise InputError(path, f"weights.safetensors: {name}", f"a tensor {tuple(value.shape)}", "missing")
        if state[name].shape != value.shape:
            raise InputError(path, f"weights.safetensors: {name}", str(tuple(value.shape)), tuple(state[name].shape))
        if state[name].is_floating_point() != value.is_floating_point() or state[name].dtype == torch.bool:
            raise InputError(path, f"weights.safetensors: {name}", f"numbers as {value.dtype}", state[name].dtype)
        vertices = len(avatar.person.body.v_template)
        if name.endswith("_vertex") and not ((state[name] >= 0) & (state[name] < vertices)).all():
            raise InputError(
                path, f"weights.safetensors: {name}", f"vertices of the template, 0 to {vertices - 1}", "others"
            )
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
