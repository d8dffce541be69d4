"""A capture in our layout, said in the parameters of an SMPL-X body: as AvatarReX' are published."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from avatarrex.templates.person import Person


def in_smplx(folder: Path, person: Person) -> Path:
    """The folder, its `shape10` written as the `betas` of a person whose shape directions are the default's."""
    for path in folder.glob("*/smpl_params.npz"):
        with np.load(io.BytesIO(path.read_bytes())) as file:
            arrays = dict(file)
        shape = arrays.pop("shape10")
        arrays |= {"betas": shape[None], "transl": arrays["transl"] - person.pelvis(shape)}
        np.savez(path, **arrays)
    return folder
