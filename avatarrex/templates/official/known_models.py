"""The models that a user may bring: names of their files, where they are published, and what goes on without them.

A models folder has them under these names. Torch is taken for reading one alone. None comes with this program: their licences are between the user and their makers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is

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
        """The file, if the folder has one."""
        return next((folder / file for file in self.files if what_is(folder / file) == "a file"), None)


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
        ("faceverse_simple_v2.npy", "faceverse_v2.npy", "faceverse_v3.npy", "faceverse_v4_2.npy", "faceverse_v4.npy", "faceverse_v1.npy"),
        f"{FACEVERSE_SITE}, README (version 3: exBase_52.npy beside it)", "the default person's face, which has the same 52 expressions",
    ),
    KnownModel(
        "flame", "FLAME head", ("generic_model.pkl", "flame2023.pkl", "flame2023_no_jaw.pkl", "FLAME_NEUTRAL.pkl"),
        f"{FLAME_SITE}, Downloads, 'FLAME 2020' or 'FLAME 2023'", "nothing else needs it",
    ),
    KnownModel(
        "head_ids", "Vertices of the head", (HEAD_FILE,), f"{SMPLX_SITE}, Downloads, 'MANO and FLAME vertex indices'",
        "they are found on the meshes of SMPL-X and FLAME",
    ),
)  # fmt: skip
"""In the order of the list."""
BESIDE = ("exBase_52.npy",)
"""Files that belong to another one and are added beside it."""


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


def describe(model: KnownModel | None, path: Path) -> str:
    """Read a file and say what it is. Raises `InputError`."""
    return _TOLD[model.name](path) if model else _told_beside(path)


def check_together(folder: Path) -> list[str]:
    """What is only seen with several files: the left hand's fault, and vertices that do not belong to the body. Raises `InputError`."""
    from avatarrex.templates.official import correspondence as ids
    from avatarrex.templates.official.flame import read_flame
    from avatarrex.templates.official.mano import read_hands
    from avatarrex.templates.official.smplx import read_smplx

    found = {model.name: path for model in KNOWN if (path := model.find(folder))}
    said = []
    body = read_smplx(found["smplx"]).model if "smplx" in found else None
    if {"mano_left", "mano_right"} <= set(found):
        hands = read_hands(found["mano_left"], found["mano_right"])
        fault = (
            "has the right's shape directions: mirrored when read"
            if hands["left"].repaired
            else "is mirrored as it should be"
        )
        said.append(f"MANO: the left hand {fault}")
        if body is not None:
            file = found.get("hand_ids")
            for side, hand in hands.items():
                if file is None:
                    ids.find_hand_ids(hand.model, body, side)
                else:
                    ids.check_ids(ids.read_hand_ids(file)[side], hand.model, body, file)
            said.append(
                f"hands: their vertices are SMPL-X's, {'found on the meshes' if file is None else f'by {file.name}'}"
            )
    if body is not None and "flame" in found:
        head, file = read_flame(found["flame"]), found.get("head_ids")
        if file is None:
            ids.find_head_ids(head, body)
        else:
            ids.check_ids(ids.read_head_ids(file), head, body, file)
        said.append(f"head: its vertices are SMPL-X's, {'found on the meshes' if file is None else f'by {file.name}'}")
    return said


def _smplx(path: Path) -> str:
    from avatarrex.templates.official.smplx import read_smplx

    found = read_smplx(path)
    hands = "hands with components and mean" if len(found.hands) == 2 else "no hand components"
    head = ", locked head" if found.locked_head else ""
    poses = "" if found.model.posedirs is not None else ", no pose blend shapes"
    return f"SMPL-X, {found.version} directions{head}{poses}, {hands}"


def _mano(side: str) -> Callable[[Path], str]:
    def told(path: Path) -> str:
        from avatarrex.templates.official.mano import read_hand

        return f"MANO, {side} hand, wrist closed with {len(read_hand(path, side).model.faces) - 1538} triangles"

    return told


def _flame(path: Path) -> str:
    from avatarrex.templates.official.flame import read_flame

    found = read_flame(path)
    return f"FLAME, {found.shapedirs.shape[2]} + {found.expression_dirs.shape[2]} directions"


def _faceverse(path: Path) -> str:
    from avatarrex.templates.official.faceverse import read_faceverse

    found = read_faceverse(path)
    axes = "axes as here" if found.turned == (1, 1, 1) else f"axes turned (signs {found.turned})"
    count = found.model.expression_dirs.shape[2]
    names = "with Apple's names" if found.model.expression_names else "without names"
    return f"Faceverse {found.version}, {len(found.model.v_template)} vertices, in {found.unit}, {axes}, {count} expressions {names}"


def _hand_ids(path: Path) -> str:
    from avatarrex.templates.official.correspondence import read_hand_ids

    return f"vertices of {' and '.join(read_hand_ids(path))} hand"


def _head_ids(path: Path) -> str:
    from avatarrex.templates.official.correspondence import read_head_ids

    return f"{len(read_head_ids(path))} vertices of the head"


def _told_beside(path: Path) -> str:
    from avatarrex.files.arrays import read_array

    return f"52 expressions of Faceverse 3, numbers {read_array(path).shape}"


_TOLD: dict[str, Callable[[Path], str]] = {
    "smplx": _smplx, "mano_left": _mano("left"), "mano_right": _mano("right"), "flame": _flame, "faceverse": _faceverse,
    "hand_ids": _hand_ids, "head_ids": _head_ids,
}  # fmt: skip
