"""Surfaces on disk: `surface.safetensors` in the avatar, a few MB; half precision where that is a hundredth of a millimetre.

The albedo is stored as JPEG bytes. A file that does not fit together is refused by name and field before it is used.
"""

from __future__ import annotations

import hashlib
import io
import json
import warnings
from dataclasses import fields
from typing import Any, Protocol, runtime_checkable

import numpy as np
import safetensors
import safetensors.numpy
from PIL import Image
from torch import Tensor

from avatarrex.errors import InputError, check
from avatarrex.fields.detail_texture import packed
from avatarrex.files.json_text import parse_json
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.surface.surface import INFLUENCES, Correction, Surface
from avatarrex.templates.parts import PARTS

FILE = "surface.safetensors"
LARGEST = 2**27
"""Bytes of the file."""
QUALITY = 93
"""Of the JPEG: 40 dB."""
HALVED = ("weight", "morph", "morph_colour", "correction.basis")
"""Stored in half precision."""
MOST_SIDE = 4096
"""Texels a side: twice what is distilled."""
KINDS: dict[str, type] = {
    **dict.fromkeys(("joint", "part", "albedo", "correction.group"), np.uint8),
    **dict.fromkeys(("faces", "template_face", "uv_vertex", "uv_faces", "morph_vertex", "correction.joints"), np.int32),
}
"""Of the arrays that are no floating-point numbers."""


@runtime_checkable
class Weighted(Protocol):
    """What has weights: an avatar."""

    def state(self) -> dict[str, Tensor]:
        """Tensors by name."""


def weights_key(avatar: Weighted) -> str:
    """First 16 hex digits of SHA-256 over the weights in half precision, texels as bytes, as they are stored."""
    digest = hashlib.sha256()
    for name, value in sorted(packed(avatar.state()).items()):
        stored = value.half() if value.is_floating_point() else value
        digest.update(name.encode() + stored.contiguous().numpy().tobytes())
    return digest.hexdigest()[:16]


def surface_bytes(surface: Surface) -> bytes:
    """The file's content."""
    arrays = {name: value for name, value in _arrays(surface).items() if name != "albedo"}
    packed = {name: value.astype(np.float16) if name in HALVED else value for name, value in arrays.items()}
    jpeg = io.BytesIO()
    Image.fromarray(surface.albedo).save(jpeg, "JPEG", quality=QUALITY, subsampling=0)
    packed["albedo"] = np.frombuffer(jpeg.getvalue(), np.uint8)
    contiguous = {name: np.ascontiguousarray(value) for name, value in packed.items()}
    about = {
        "albedo_scale": surface.albedo_scale, "key": surface.key, "content": _digest(contiguous), "meta": surface.meta
    }  # fmt: skip
    return safetensors.numpy.save(contiguous, {"surface": json.dumps(about)})


def read_surface(content: bytes, source: object, template_faces: int | None = None) -> Surface:
    """From `surface_bytes`. Raises `InputError` with file and field; also where it is of another template than of so many faces."""
    try:
        arrays = safetensors.numpy.load(content)
        about = parse_json(_description(content), f"{source}: {FILE}")
    except InputError:
        raise
    except (
        safetensors.SafetensorError,
        ValueError,
        TypeError,
        KeyError,
    ) as error:  # the last two: kinds that numpy has not
        raise InputError(source, FILE, "a safetensors file of a surface", error) from None
    if not isinstance(about, dict):
        raise InputError(source, FILE, "a description of the surface", type(about).__name__)
    expected = {name for name in _names() if name not in ("albedo_scale", "key", "meta")}
    if set(arrays) != expected:
        odd = sorted(set(arrays) ^ expected)[0]
        raise InputError(source, f"{FILE}: {odd}", "the arrays of a surface", "present" if odd in arrays else "missing")
    values: dict[str, Any] = {
        name: value.astype(np.float32) if value.dtype == np.float16 else value for name, value in arrays.items()
    }
    for name, value in values.items():
        kind = KINDS.get(name, np.float32)
        check(value.dtype == kind, source, f"{FILE}: {name}", f"numbers as {kind.__name__}", value.dtype)
    values["albedo"] = _image(values["albedo"], source)
    _check(values, about, source)
    _check_indices(values, template_faces, source)
    sums = values["weight"].sum(1)
    check(
        np.abs(sums - 1).max(initial=0) < 0.02, source, f"{FILE}: weight", "rows that sum to one", f"{sums.min():.3g}"
    )
    whole = about.get("content") in (None, _digest(arrays))
    check(whole, source, FILE, "the arrays that were written", "others")
    parts = {name.removeprefix("correction."): values.pop(name) for name in list(values) if "." in name}
    return Surface(
        **values,
        correction=Correction(**parts),
        albedo_scale=float(about["albedo_scale"]),
        key=str(about.get("key", "")),
        meta=about["meta"],
    )


def _digest(arrays: dict[str, np.ndarray]) -> str:
    """First 16 hex digits of SHA-256 over the stored arrays: a byte that changed in a folder is found by nothing else."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(name.encode() + arrays[name].tobytes())
    return digest.hexdigest()[:16]


def _names() -> list[str]:
    own = [item.name for item in fields(Surface) if item.name != "correction"]
    return own + [f"correction.{item.name}" for item in fields(Correction)]


def _arrays(surface: Surface) -> dict[str, np.ndarray]:
    own = {name: getattr(surface, name) for name in _names() if "." not in name}
    inner = {f"correction.{item.name}": getattr(surface.correction, item.name) for item in fields(Correction)}
    return {name: value for name, value in {**own, **inner}.items() if isinstance(value, np.ndarray)}


def _description(content: bytes) -> str:
    """The text in a safetensors header, which `safetensors.numpy.load` has found to be in order and leaves out."""
    length = int.from_bytes(content[:8], "little")
    header = parse_json(content[8 : 8 + length].decode(), FILE)
    return str((header.get("__metadata__") or {}).get("surface", ""))


def _image(packed: np.ndarray, source: object) -> np.ndarray:
    """JPEG bytes as (h, w, 3); the size is judged by the header."""
    field = f"{FILE}: albedo"
    bomb = Image.DecompressionBombWarning
    try:
        with (
            warnings.catch_warnings(action="error", category=bomb),
            Image.open(io.BytesIO(packed.tobytes()), formats=("JPEG",)) as image,
        ):
            check(max(image.size) <= MOST_SIDE, source, field, f"at most {MOST_SIDE} texels a side", image.size)
            return np.asarray(image.convert("RGB"))
    except InputError:
        raise
    except (OSError, ValueError, SyntaxError, bomb, Image.DecompressionBombError) as error:
        raise InputError(source, field, "a JPEG image", error) from None


def _check(values: dict[str, np.ndarray], about: dict[str, Any], source: object) -> None:
    """Shapes, finite numbers, the description."""
    v, t, f, m = (len(values[name]) for name in ("vertices", "uv", "faces", "morph_vertex"))
    g, q = values["correction.joints"].shape if values["correction.joints"].ndim == 2 else (0, 0)
    n = len(values["correction.poses"])
    r = values["correction.basis"].shape[1] if values["correction.basis"].ndim == 3 else 0
    e = len(EXPRESSION_NAMES)
    shapes = {
        "vertices": (v, 3), "faces": (f, 3), "joint": (v, INFLUENCES), "weight": (v, INFLUENCES), "template_face": (v,),
        "barycentric": (v, 3), "part": (v,), "uv": (t, 2), "uv_vertex": (t,), "uv_faces": (f, 3), "lit": (v,),
        "morph_vertex": (m,), "morph": (e, m, 3), "morph_colour": (e, m, 3), "correction.group": (v,),
        "correction.poses": (n, len(JOINT_NAMES), 3), "correction.joints": (g, q), "correction.closeness": (g, q),
        "correction.weights": (g, n, r), "correction.low": (g, r), "correction.high": (g, r),
        "correction.basis": (v, r, 6),
    }  # fmt: skip
    for name, shape in shapes.items():
        check(values[name].shape == shape, source, f"{FILE}: {name}", f"shape {shape}", values[name].shape)
        if values[name].dtype.kind == "f":
            check(np.isfinite(values[name]).all(), source, f"{FILE}: {name}", "finite numbers", "NaN or Inf")
    scale, meta = about.get("albedo_scale"), about.get("meta")
    number = isinstance(scale, (int, float)) and not isinstance(scale, bool)
    check(number and 0 < scale < 1e3, source, f"{FILE}: albedo_scale", "a number from 0 to 1000", scale)  # type: ignore[operator]
    check(isinstance(meta, dict), source, f"{FILE}: meta", "an object", type(meta).__name__)


def _check_indices(values: dict[str, np.ndarray], template_faces: int | None, source: object) -> None:
    """Every index is of something, and the texture's mesh is the mesh."""
    v, t, joints = len(values["vertices"]), len(values["uv"]), len(JOINT_NAMES)
    ranges = {
        "faces": (0, v), "joint": (0, joints), "uv_vertex": (0, v), "uv_faces": (0, t), "morph_vertex": (0, v),
        "correction.group": (0, len(values["correction.joints"])), "correction.joints": (-1, joints),
        "part": (0, len(PARTS) + 1), "template_face": (0, 2**31 if template_faces is None else template_faces),
    }  # fmt: skip
    for name, (least, end) in ranges.items():
        indices = values[name]
        low, high = (int(indices.min()), int(indices.max())) if indices.size else (least, least)
        wanted = f"indices from {least} to {end - 1}"
        check(low >= least and high < end, source, f"{FILE}: {name}", wanted, low if low < least else high)
    same = np.array_equal(values["uv_vertex"][values["uv_faces"]], values["faces"])
    check(same, source, f"{FILE}: uv_faces", "the faces of the mesh", "others")
