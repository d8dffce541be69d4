"""A `TemplateModel` from arrays in the layout of `assets_spec/person.json`, and the hash of arrays that pose one.

Joints are explicit (`J_template`, `J_shapedirs`) or follow from a regressor, J = J_regressor · v_shaped, which is linear and so
becomes joint directions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.files.assets import check_arrays, read_spec
from avatarrex.templates.model import TemplateModel

POSING = (
    "v_template", "f", "shapedirs", "n_shape", "J_template", "J_shapedirs", "J_regressor", "J_idx", "J_w", "weights",
    "kintree_table", "posedirs", "pose_columns",
)  # fmt: skip
"""The arrays that decide where a posed vertex is, and so the person's hash."""
LARGEST_NUMBER = 1e4
"""Of a template's numbers: metres, weights and directions of a person are all far below."""


def hash_arrays(arrays: Mapping[str, np.ndarray], keys: Iterable[str] = POSING) -> str:
    """First 16 hex digits of SHA-256 over names, types, shapes and bytes of the arrays `keys`, those that pose a template."""
    digest = hashlib.sha256()
    for key in keys:
        if key in arrays:
            value = arrays[key]
            little = np.ascontiguousarray(value, value.dtype.newbyteorder("<"))
            digest.update(f"{key} {value.dtype.str[1:]} {value.shape};".encode() + little.tobytes())
    return digest.hexdigest()[:16]


def read_model(arrays: dict[str, np.ndarray], source: str | Path) -> TemplateModel:
    """A `TemplateModel` from arrays in the layout of `assets_spec/person.json`. Raises `InputError`."""
    check_arrays(arrays, source, read_spec("person"))
    _check_range(arrays, source)
    v = len(arrays["v_template"])
    faces = arrays["f"].astype(np.int64)
    if not faces.size or faces.min() < 0 or faces.max() >= v:
        raise InputError(source, "f", f"vertex indices below {v}", f"up to {faces.max()}" if faces.size else "none")
    sums = arrays["weights"].astype(np.float64).sum(1)
    # Half precision stores weights to 5e-4 each, and at most a dozen joints move a vertex.
    if arrays["weights"].min() < 0 or np.abs(sums - 1).max() > 6e-3:
        raise InputError(source, "weights", "rows ≥ 0 that sum to one", f"sums {sums.min():.3g} to {sums.max():.3g}")
    posedirs = arrays.get("posedirs")
    columns = arrays.get("pose_columns")
    n_shape = _shape_count(arrays, source)
    joint_template, joint_shapedirs, joint_expression = _joints(arrays, source, n_shape)
    groups = arrays.get("vertex_group", np.zeros(0, int))
    return TemplateModel(
        v_template=real(arrays["v_template"]),
        faces=torch.from_numpy(faces),
        shapedirs=real(arrays["shapedirs"][..., :n_shape]),
        expression_dirs=real(arrays["shapedirs"][..., n_shape:]),
        weights=real(arrays["weights"] / sums[:, None]),
        joint_template=real(joint_template),
        joint_shapedirs=real(joint_shapedirs),
        parents=_parents(arrays["kintree_table"], source),
        joint_names=tuple(map(str, arrays.get("joint_names", ()))),
        expression_names=tuple(map(str, arrays.get("expression_names", ()))),
        posedirs=None if posedirs is None else real(posedirs),
        pose_columns=None if posedirs is None or columns is None else torch.from_numpy(columns.astype(np.int64)),
        groups={
            str(name): torch.from_numpy(np.flatnonzero(groups == k))
            for k, name in enumerate(arrays.get("group_names", ()))
        },
        joint_expression_dirs=None if joint_expression is None else real(joint_expression),
    )


def _check_range(arrays: Mapping[str, np.ndarray], source: str | Path) -> None:
    """Raise `InputError` for an array that is empty, or has numbers that no template has."""
    for key in ("v_template", "weights", "shapedirs", "posedirs", "J_template", "J_shapedirs", "J_regressor", "J_w"):
        if key not in arrays:
            continue
        if not arrays[key].size and key in ("v_template", "weights"):
            raise InputError(source, key, "at least one vertex and joint", arrays[key].shape)
        largest = float(np.abs(arrays[key]).max(initial=0))
        if largest > LARGEST_NUMBER:
            raise InputError(source, key, f"numbers up to {LARGEST_NUMBER:g}", f"{largest:.4g}")


def _shape_count(arrays: Mapping[str, np.ndarray], source: str | Path) -> int:
    """How many of `shapedirs` are shape: stated, or by the official files' totals."""
    total = arrays["shapedirs"].shape[2]
    count = int(arrays["n_shape"]) if "n_shape" in arrays else {400: 300, 20: 10}.get(total, -1)
    if not 0 <= count <= total:
        raise InputError(
            source, "n_shape", f"0 to {total} (or shapedirs of 400 or 20 directions)", arrays.get("n_shape")
        )
    return count


def _joints(
    arrays: Mapping[str, np.ndarray], source: str | Path, n_shape: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Joints of the mean shape, their shape directions, their expression directions (None where explicit)."""
    joints, v = arrays["weights"].shape[1], len(arrays["v_template"])
    if "J_template" in arrays and "J_shapedirs" in arrays:
        if arrays["J_shapedirs"].shape[2] != n_shape:
            raise InputError(source, "J_shapedirs", f"{n_shape} directions", arrays["J_shapedirs"].shape)
        return arrays["J_template"], arrays["J_shapedirs"], None
    if "J_regressor" in arrays:
        regressor = arrays["J_regressor"].astype(np.float64)
    else:
        joint, vertex = arrays["J_idx"].astype(np.int64).T
        if min(joint.min(), vertex.min()) < 0 or joint.max() >= joints or vertex.max() >= v:
            raise InputError(source, "J_idx", f"joints below {joints}, vertices below {v}", "an index beyond them")
        regressor = np.zeros((joints, v))
        np.add.at(regressor, (joint, vertex), arrays["J_w"].astype(np.float64))
    directions = np.einsum("jv,vcd->jcd", regressor, arrays["shapedirs"].astype(np.float64), optimize=True)
    return regressor @ arrays["v_template"].astype(np.float64), directions[..., :n_shape], directions[..., n_shape:]


def _parents(table: np.ndarray, source: str | Path) -> tuple[int, ...]:
    """Parents by joint; the root's is −1, or 2³² − 1 as an unsigned file writes it."""
    joints = table.shape[1]
    if sorted(table[1].tolist()) != list(range(joints)):
        raise InputError(source, "kintree_table", f"row 1 to list joints 0 to {joints - 1}", table[1].tolist()[:8])
    parents = dict(zip(table[1].tolist(), table[0].tolist()))
    return tuple(-1 if parents[j] in (-1, 2**32 - 1) else int(parents[j]) for j in range(joints))


def real(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float32))
