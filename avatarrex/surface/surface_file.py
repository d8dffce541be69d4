"""Surfaces on disk: `surface.safetensors` in the avatar, a few MB; half precision where that is a hundredth of a millimetre.

The albedo is stored as JPEG bytes. A file that does not fit together is refused by name and field before it is used.
"""

from __future__ import annotations

import hashlib
import io
import json
from dataclasses import fields
from typing import Any, Protocol

import numpy as np
import safetensors
import safetensors.numpy
from PIL import Image
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.files.json_text import parse_json
from avatarrex.surface.surface import INFLUENCES, Correction, Surface

FILE = "surface.safetensors"
LARGEST = 2**27
"""Bytes of the file."""
QUALITY = 93
"""Of the JPEG: 40 dB."""
HALVED = ("weight", "morph", "morph_colour", "correction.basis")
"""Stored in half precision."""
MOST_SIDE = 8192
"""Texels a side."""


class Weighted(Protocol):
    """What has weights: an avatar."""

    def state(self) -> dict[str, Tensor]:
        """Tensors by name."""


def weights_key(avatar: Weighted) -> str:
    """First 16 hex digits of SHA-256 over the weights in half precision, as they are stored."""
    digest = hashlib.sha256()
    for name, value in sorted(avatar.state().items()):
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
    about = {"albedo_scale": surface.albedo_scale, "key": surface.key, "meta": surface.meta}
    contiguous = {name: np.ascontiguousarray(value) for name, value in packed.items()}
    return safetensors.numpy.save(contiguous, {"surface": json.dumps(about)})


def read_surface(content: bytes, source: object) -> Surface:
    """From `surface_bytes`. Raises `InputError` with file and field."""
    try:
        arrays = safetensors.numpy.load(content)
        about = parse_json(_metadata(content).get("surface", ""), f"{source}: {FILE}")
    except (safetensors.SafetensorError, ValueError) as error:
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
    values["albedo"] = _image(values["albedo"], source)
    _check(values, about, source)
    parts = {name.removeprefix("correction."): values.pop(name) for name in list(values) if "." in name}
    return Surface(
        **values,
        correction=Correction(**parts),
        albedo_scale=float(about["albedo_scale"]),
        key=str(about.get("key", "")),
        meta=about.get("meta") or {},
    )


def _names() -> list[str]:
    own = [item.name for item in fields(Surface) if item.name != "correction"]
    return own + [f"correction.{item.name}" for item in fields(Correction)]


def _arrays(surface: Surface) -> dict[str, np.ndarray]:
    own = {name: getattr(surface, name) for name in _names() if "." not in name}
    inner = {f"correction.{item.name}": getattr(surface.correction, item.name) for item in fields(Correction)}
    return {name: value for name, value in {**own, **inner}.items() if isinstance(value, np.ndarray)}


def _metadata(content: bytes) -> dict[str, str]:
    """The description in a safetensors header, which `safetensors.numpy.load` leaves out."""
    length = int.from_bytes(content[:8], "little")
    header = parse_json(content[8 : 8 + length].decode(), FILE)
    return dict(header.get("__metadata__") or {}) if isinstance(header, dict) else {}


def _image(packed: np.ndarray, source: object) -> np.ndarray:
    try:
        with Image.open(io.BytesIO(packed.tobytes())) as image:
            if max(image.size) > MOST_SIDE:
                raise InputError(source, f"{FILE}: albedo", f"at most {MOST_SIDE} texels a side", image.size)
            return np.asarray(image.convert("RGB"))
    except OSError as error:
        raise InputError(source, f"{FILE}: albedo", "a JPEG image", error) from None


def _check(values: dict[str, np.ndarray], about: dict[str, Any], source: object) -> None:
    """Shapes, index ranges, finite numbers."""
    v, t, f, m = (len(values[name]) for name in ("vertices", "uv", "faces", "morph_vertex"))
    g, q = values["correction.joints"].shape if values["correction.joints"].ndim == 2 else (0, 0)
    r = values["correction.basis"].shape[1] if values["correction.basis"].ndim == 3 else 0
    e = len(values["morph"])
    shapes = {
        "vertices": (v, 3), "faces": (f, 3), "joint": (v, INFLUENCES), "weight": (v, INFLUENCES), "template_face": (v,),
        "barycentric": (v, 3), "part": (v,), "uv": (t, 2), "uv_vertex": (t,), "uv_faces": (f, 3), "lit": (v,),
        "morph_vertex": (m,), "morph": (e, m, 3), "morph_colour": (e, m, 3), "correction.group": (v,),
        "correction.joints": (g, q), "correction.coefficients": (g, 9 * q, r), "correction.low": (g, r),
        "correction.high": (g, r), "correction.basis": (v, r, 6),
    }  # fmt: skip
    for name, shape in shapes.items():
        if values[name].shape != shape:
            raise InputError(source, f"{FILE}: {name}", f"shape {shape}", values[name].shape)
        if values[name].dtype.kind == "f" and not np.isfinite(values[name]).all():
            raise InputError(source, f"{FILE}: {name}", "finite numbers", "NaN or Inf")
    limits = {
        "faces": v, "joint": 55, "uv_vertex": v, "uv_faces": t, "morph_vertex": v, "correction.group": g, "part": 4
    }  # fmt: skip
    for name, limit in limits.items():
        if values[name].size and not (values[name].min() >= 0 and values[name].max() < limit):
            raise InputError(source, f"{FILE}: {name}", f"indices from 0 to {limit - 1}", int(values[name].max()))
    scale = about.get("albedo_scale")
    if not isinstance(scale, (int, float)) or not 0 < scale < 1e3:
        raise InputError(source, f"{FILE}: albedo_scale", "a number from 0 to 1000", scale)
