"""Avatars on disk: one folder, or one `.avatar` zip.

`avatar.json` says what it is (format version, preset, template with its hash and size, provenance, licence), `weights.safetensors`
contains every parameter and buffer, `surface.safetensors`, which may be missing, the surface that was distilled from these weights
(surface/surface_file.py). Spec: `assets_spec/avatar.json`.
"""

from __future__ import annotations

import json
import logging
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from avatarrex.avatar import FORMAT, Avatar
from avatarrex.errors import InputError, plain
from avatarrex.fields import light
from avatarrex.fields.body import MAX_CLOTHING_OFFSET
from avatarrex.fields.detail_texture import packed, unpacked
from avatarrex.fields.local_frame import UNSAID
from avatarrex.fields.placement import device_named
from avatarrex.fields.presets import BASES, PRESETS
from avatarrex.fields.slide import JOINTS
from avatarrex.files.assets import DATA
from avatarrex.files.gate import decode, read_bytes, what_is, written
from avatarrex.files.json_text import SMALL, parse_json
from avatarrex.files.stamp import Stamp, stamp
from avatarrex.files.zips import open_zip, refusing, unpack
from avatarrex.parts.known_expressions import KnownExpressions
from avatarrex.surface import surface_file
from avatarrex.surface.surface import Surface
from avatarrex.surface.surface_file import read_surface, surface_bytes, weights_key
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

log = logging.getLogger(__name__)
SINCE = {"tone.": 2, "light.": 3, "body.code_network.least": 3, "body.code_network.most": 3}
"""Format since which there are weights of such names; avatars of before have the identity."""
DETAILED = ("body", "face")
"""Parts with static detail: `PART.detail.texel`, the albedo of each texel, bytes; `PART.detail.edge`, the texels along the edges of
each triangle."""
OUTGROWTH = {"body.outgrowth.first": 1, "body.outgrowth.distance": 3}
"""What an avatar with an outgrowth has, and of how many dimensions."""
HUNG, ANCHORS = "body.outgrowth.joint", "body.outgrowth.anchor"
"""What one has that hangs on a joint; in older files it has no anchors."""
FILES = {"avatar.json": SMALL, "weights.safetensors": 2**30}
"""Bytes that either file may unpack to; the paper's preset has 90 MB of weights."""
SLIDE = "body.slide.share"
"""What an avatar whose cloth slides has."""
TEXEL_HEIGHT = "body.detail_height"
"""What an avatar has whose texels lie where its clothes are; without it they lie on the skin."""
BEHIND = "face.detail_behind"
"""What an avatar has whose face's texels end beside their triangles: which of these are hidden behind closed lips, bytes."""
RELIEF = "body.relief"
"""What an avatar whose surface was registered to pictures has."""
FACE_LIGHT = "light.face"
"""What an avatar whose face was trained with a light of its own has."""
SURFACE = surface_file.FILE
WHOLE = "an avatar folder or a whole .avatar file"
LARGEST_WEIGHT = float(torch.finfo(torch.half).max)
"""What half precision, in which avatars are stored, can say: 65504."""


def load_avatar(source: str | Path = "default", device: str = "cpu") -> Avatar:
    """Read an avatar: "default" for the packaged one, an avatar folder, or an `.avatar` file.

    The networks run on `device`, any that torch has ("cpu", "cuda", …). Raises `InputError` for what is not there, not an
    avatar, of a newer format, or damaged, with file and field; and for a device that cannot be had. A surface that is damaged, or of
    other weights, is left out with a warning in the log.
    """
    device_named(device)  # what cannot be had is said before the work
    path = avatar_path(source)
    content = _read(path)
    text = decode(content["avatar.json"], f"{path}: avatar.json", "text")
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
        state = safetensors.torch.load(content["weights.safetensors"])
    except (safetensors.SafetensorError, ValueError) as error:
        raise InputError(path, "weights.safetensors", "a safetensors file", error) from None
    _expect(path, avatar, state)
    _fill(path, avatar, unpacked(state), meta["format"])
    KnownExpressions.in_meta(meta, f"{path}: avatar.json")
    avatar.meta, avatar.light.frame = meta, meta.get("light_frame", light.UNSAID)
    avatar.surface = _surface(path, avatar)
    avatar.place(device)
    return avatar


def avatar_path(source: str | Path) -> Path:
    """Where an avatar is: "default" is the packaged one."""
    return DATA / "default.avatar" if str(source) == "default" else Path(source)


def avatar_stamp(source: str | Path) -> Stamp:
    """What tells whether an avatar has changed since it was read, without reading it; empty where nothing is there."""
    return stamp(avatar_path(source))


def save_avatar(avatar: Avatar, path: str | Path, half: bool = True) -> None:
    """Write `avatar` to a folder, or to one file when `path` ends in `.avatar`; all or nothing.

    Floating-point weights are stored in half precision when `half` (the surface moves by less than 0.1 mm). A surface of other
    weights than the avatar has by now is left out. `load` reads it back. Raises `InputError` where `path` cannot be written.
    """
    state = {
        name: value.half() if half and value.is_floating_point() else value
        for name, value in packed(avatar.state()).items()
    }
    meta = {**avatar.meta, "format": FORMAT, "person": avatar.person.name, "person_hash": avatar.person.hash}
    meta["light_frame"] = avatar.light.frame
    meta.pop("person_fit", None)
    if avatar.person.fit is not None:
        meta["person_fit"] = avatar.person.fit.to_json()
    text = json.dumps(meta, indent=2, ensure_ascii=False) + "\n"
    content = {"weights.safetensors": safetensors.torch.save(state), "avatar.json": text.encode()}
    if avatar.surface is not None and avatar.surface.key == weights_key(avatar):
        content[SURFACE] = surface_bytes(avatar.surface)
    _write(Path(path), content)
    if SURFACE not in content and Path(path).is_dir():
        (Path(path) / SURFACE).unlink(missing_ok=True)


def store_surface(source: str | Path, surface: Surface, target: str | Path | None = None) -> None:
    """Write the avatar at `source` with `surface` to `target`, or in its place; weights and `avatar.json` stay byte for byte.

    Raises `InputError` where `source` cannot be read or `target` not be written.
    """
    path = avatar_path(source)
    content = {**_read(path), SURFACE: surface_bytes(surface)}
    if target is None and path.is_dir():
        content = {SURFACE: content[SURFACE]}
    _write(path if target is None else Path(target), content)


def _write(path: Path, content: dict[str, bytes]) -> None:
    """The files of an avatar. In a folder each is whole; a surface beside other weights does not count."""
    if path.suffix == ".avatar" and not path.is_dir():
        with written(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in sorted(content):
                archive.writestr(name, content[name])
        return
    for name, data in content.items():
        with written(path / name) as temporary:
            temporary.write_bytes(data)


def _read(path: Path) -> dict[str, bytes]:
    """The bytes of `avatar.json` and of the weights, from a folder or a zip."""
    found = what_is(path)
    if found == "a folder":
        for name in FILES:
            if what_is(path / name) == "nothing there":
                raise InputError(path, name, "the file to be in the avatar", "nothing there")
        return {name: read_bytes(path / name, "a file", most) for name, most in FILES.items()}
    if found == "a file":
        return _members(path)
    raise InputError(path, "", "an avatar folder or an .avatar file", found)


def _members(path: Path) -> dict[str, bytes]:
    """The two files of a zip."""
    content = {}
    with open_zip(path, WHOLE) as archive:
        for name, most in FILES.items():
            if name not in archive.namelist():
                raise InputError(path, name, "the file to be in the avatar", "nothing there")
            with refusing(path, name, WHOLE):
                content[name] = bytes(unpack(archive, name, most, path, name))
    return content


def _surface(path: Path, avatar: Avatar) -> Surface | None:
    """The surface beside the weights, if there is one that fits them."""
    try:
        content = _surface_content(path)
        if content is None:
            return None
        surface = read_surface(content, path, len(avatar.person.body.faces))
        key = weights_key(avatar)
        if surface.key != key:
            raise InputError(path, f"{SURFACE}: key", f"that of these weights ({key})", surface.key or "none")
    except InputError as error:
        _warn_once(f"{error}; `avatarrex-studio distil {plain(str(path))}` makes it anew")
        return None
    return surface


@lru_cache(maxsize=256)
def _warn_once(text: str) -> None:
    """Who reads an avatar twice is told once."""
    log.warning("%s", text)


def _surface_content(path: Path) -> bytes | None:
    """The bytes of the surface; None where there is none."""
    if path.is_dir():
        if what_is(path / SURFACE) == "nothing there":
            return None
        return read_bytes(path / SURFACE, "a file", surface_file.LARGEST, SURFACE)
    with open_zip(path, WHOLE) as archive:
        if SURFACE not in archive.namelist():
            return None
        with refusing(path, SURFACE, WHOLE):
            return bytes(unpack(archive, SURFACE, surface_file.LARGEST, path, SURFACE))


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
        "light_frame": (str, ""),
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
    if meta.get("light_frame", light.UNSAID) not in light.LIGHT_FRAMES:
        raise InputError(path, "avatar.json: light_frame", " or ".join(light.LIGHT_FRAMES), meta["light_frame"])
    untrained = meta.get("untrained", [])
    if not (isinstance(untrained, list) and all(part in PARTS for part in untrained)):
        raise InputError(path, "avatar.json: untrained", "a list of " + ", ".join(PARTS), untrained)
    return meta


def _texels_in(state: dict[str, Tensor]) -> list[str]:
    """Names of tensors of texels."""
    return [name for name in (f"{part}.detail.texel" for part in DETAILED) if name in state]


def _is_below(number: Tensor, count: int) -> bool:
    """Whether it is one whole number from 0, below `count`."""
    return number.numel() == 1 and not number.is_floating_point() and 0 <= int(number) < count


def _are_points(places: Tensor) -> bool:
    """Whether they are some finite places (n, 3)."""
    return places.dim() == 2 and places.shape[1] == 3 and len(places) > 0 and bool(places.isfinite().all())


def _expect(path: Path, avatar: Avatar, state: dict[str, Tensor]) -> None:
    """Give fields and light what not every avatar has, of which tensors are in `state`, after checking what these must be."""
    body, face = (len(each.faces) for each in (avatar.person.body, avatar.person.face))
    for name, faces in (("body.detail.edge", body), ("face.detail.edge", face), (BEHIND, face)):
        if name in state and (state[name].dtype, tuple(state[name].shape)) != (torch.uint8, (faces,)):
            found = f"{state[name].dtype} {tuple(state[name].shape)}"
            raise InputError(path, f"weights.safetensors: {name}", f"a byte for each of {faces} triangles", found)
    if BEHIND in state:
        laid, hidden = (state.get(name, torch.zeros(face)) > 0 for name in ("face.detail.edge", BEHIND))
        if not (laid & ~hidden).any() or (hidden & ~laid).any():
            expected = "some of the triangles that have texels, not all"
            raise InputError(path, f"weights.safetensors: {BEHIND}", expected, f"{int(hidden.sum())} triangles")
    for name in _texels_in(state):
        if state[name].dtype != torch.uint8:
            raise InputError(path, f"weights.safetensors: {name}", "bytes", state[name].dtype)
    for name, dimensions in OUTGROWTH.items():
        if name in state and (state[name].dim() != dimensions or not state[name].numel()):
            expected = f"an array of {dimensions} dimensions"
            raise InputError(path, f"weights.safetensors: {name}", expected, tuple(state[name].shape))
    distance = state.get("body.outgrowth.distance")
    if distance is not None and not (distance <= 0).any():
        raise InputError(path, "weights.safetensors: body.outgrowth.distance", "somewhere inside", "positive numbers")
    joints = avatar.person.body.weights.shape[1]
    if HUNG in state and not _is_below(state[HUNG], joints):
        expected = f"the number of a joint, 0 to {joints - 1}"
        raise InputError(path, f"weights.safetensors: {HUNG}", expected, state[HUNG].tolist())
    if ANCHORS in state and (HUNG not in state or not _are_points(state[ANCHORS])):
        expected = f"places (o, 3) beside a {HUNG}"
        raise InputError(path, f"weights.safetensors: {ANCHORS}", expected, tuple(state[ANCHORS].shape))
    shapes = {
        SLIDE: (len(avatar.body.node_vertex), JOINTS),
        RELIEF: (len(avatar.body.anchor_vertex),),
        TEXEL_HEIGHT: (len(avatar.person.body.v_template),),
        FACE_LIGHT: (8, 3),
    }
    for name, shape in shapes.items():
        if name in state and tuple(state[name].shape) != shape:
            raise InputError(path, f"weights.safetensors: {name}", f"numbers {shape}", tuple(state[name].shape))
    height = state.get(TEXEL_HEIGHT)
    if height is not None and not ((height >= 0) & (height <= 1.01 * MAX_CLOTHING_OFFSET)).all():  # halves are rounded
        expected = f"0 to {MAX_CLOTHING_OFFSET} metres"
        raise InputError(path, f"weights.safetensors: {TEXEL_HEIGHT}", expected, "others, or no numbers")
    avatar.body.expect({name.removeprefix("body."): value for name, value in state.items()})
    avatar.face.expect({name.removeprefix("face."): value for name, value in state.items()})
    avatar.light.expect({name.removeprefix("light."): value for name, value in state.items()})


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
        if state[name].is_floating_point():
            if not torch.isfinite(state[name]).all():
                raise InputError(path, f"weights.safetensors: {name}", "finite numbers", "NaN or Inf")
            largest = float(state[name].abs().max()) if state[name].numel() else 0.0
            if largest > LARGEST_WEIGHT:
                expected_range = f"numbers up to {LARGEST_WEIGHT:g}"
                raise InputError(path, f"weights.safetensors: {name}", expected_range, f"{largest:.4g}")
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
