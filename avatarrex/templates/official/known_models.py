"""The models that a user may bring: names of their files, where they are published, and what goes on without them.

A models folder has them under these names. None comes with this program: their licences are between the user and their makers.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.files.user_folder import user_folder

HAND_FILE, HEAD_FILE = "MANO_SMPLX_vertex_ids.pkl", "SMPL-X__FLAME_vertex_ids.npy"
SMPLX_SITE, MANO_SITE, FLAME_SITE = (f"https://{name}.is.tue.mpg.de" for name in ("smpl-x", "mano", "flame"))
FACEVERSE_SITE = "https://github.com/LizhenWangT/FaceVerse"


@dataclass(frozen=True)
class KnownModel:
    """A file of a models folder."""

    name: str
    title: str
    files: tuple[str, ...]
    """Names that it is published under; the first is what is looked for when none is there."""
    published: str
    without: str
    """What is used instead."""

    def find(self, folder: Path) -> Path | None:
        """The file that is used, if the folder has one."""
        return next(iter(self.every(folder)), None)

    def every(self, folder: Path) -> list[Path]:
        """All files of the folder, the one that is used first."""
        return [folder / file for file in self.files if what_is(folder / file) == "a file"]


KNOWN: tuple[KnownModel, ...] = (
    KnownModel(
        "smplx", "SMPL-X body",
        tuple(f"SMPLX_{sex}.{kind}" for sex in ("NEUTRAL", "MALE", "FEMALE") for kind in ("npz", "pkl")),
        f"{SMPLX_SITE}, Downloads, 'SMPL-X v1.1 (NPZ+PKL)'", "the default person, which has the same joints",
    ),
    KnownModel("mano_left", "MANO left hand", ("MANO_LEFT.pkl",), f"{MANO_SITE}, Downloads, 'Models & Code'", "the hand of the body"),
    KnownModel("mano_right", "MANO right hand", ("MANO_RIGHT.pkl",), f"{MANO_SITE}, Downloads, 'Models & Code'", "the hand of the body"),
    KnownModel(
        "hand_ids", "Vertices of the hands", (HAND_FILE,), f"{SMPLX_SITE}, Downloads, 'MANO and FLAME vertex indices'",
        "they are found on the meshes of SMPL-X and MANO",
    ),
    KnownModel(
        "faceverse", "Faceverse face",
        ("faceverse_simple_v2.npy", "faceverse_v2.npy", "faceverse_v3.npy", "faceverse_v3_6_s.npy",
         "faceverse_v3_1.npy", "faceverse_v4_2.npy", "faceverse_v4.npy", "faceverse_v1.npy"),
        f"{FACEVERSE_SITE}, README (version 3: exBase_52.npy beside it)", "the face is cut out of SMPL-X, and expressions do not move it",
    ),
    KnownModel(
        "flame", "FLAME head", ("generic_model.pkl", "flame2023.pkl", "flame2023_no_jaw.pkl", "FLAME_NEUTRAL.pkl"),
        f"{FLAME_SITE}, Downloads, 'FLAME 2020' or 'FLAME 2023'", "all else: nothing needs it",
    ),
    KnownModel(
        "head_ids", "Vertices of the head", (HEAD_FILE,), f"{SMPLX_SITE}, Downloads, 'MANO and FLAME vertex indices'",
        "they are found on the meshes of SMPL-X and FLAME",
    ),
)  # fmt: skip
"""In the order of the list."""
BESIDE = ("exBase_52.npy", "faceverse_expressions.csv")
"""Files that belong to another one and are added beside it."""


def files_of(folder: Path) -> list[tuple[KnownModel | None, Path]]:
    """Every file of a models folder with what it is; None for one that lies beside another."""
    beside = [folder / name for name in BESIDE if what_is(folder / name) == "a file"]
    return [(model, path) for model in KNOWN for path in model.every(folder)] + [(None, path) for path in beside]


def models_folder() -> Path:
    """`AVATARREX_MODELS`, or `avatarrex-studio/models` where the system keeps a user's data."""
    if folder := os.environ.get("AVATARREX_MODELS"):
        return Path(folder)
    return user_folder("XDG_DATA_HOME", (".local", "share"), "Application Support") / "avatarrex-studio" / "models"


def model_of(path: str | Path) -> KnownModel | None:
    """What a file is, by its name in either case; None for one that lies beside another. Raises `InputError` for no known name."""
    name = Path(path).name.lower()
    if name in map(str.lower, BESIDE):
        return None
    for model in KNOWN:
        if name in map(str.lower, model.files):
            return model
    raise InputError(
        path,
        "",
        "a name that a model is published under: " + ", ".join(model.files[0] for model in KNOWN),
        Path(path).name,
    )


def published_name(path: str | Path) -> str:
    """A file's name as its makers write it."""
    names = (*BESIDE, *(file for model in KNOWN for file in model.files))
    return next(name for name in names if name.lower() == Path(path).name.lower())
