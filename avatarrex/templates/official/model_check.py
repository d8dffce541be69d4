"""What the files of a models folder are: read one by one, then together."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from avatarrex.templates.model import TemplateModel
from avatarrex.templates.official import expression_matrix
from avatarrex.templates.official.correspondence import hand_ids, head_ids, read_hand_ids, read_head_ids
from avatarrex.templates.official.faceverse import read_faceverse, read_fifty_two
from avatarrex.templates.official.flame import read_flame
from avatarrex.templates.official.known_models import KNOWN, KnownModel
from avatarrex.templates.official.mano import read_hand, read_hands
from avatarrex.templates.official.parts import driven_body, face_of
from avatarrex.templates.official.smplx import read_smplx


def describe(model: KnownModel | None, path: Path) -> str:
    """Read a file and say what it is. Raises `InputError`."""
    return _TOLD[model.name](path) if model else _told_beside(path)


def check_together(folder: Path) -> list[str]:
    """What is only seen with several files: the left hand's fault, and what does not belong to the body. Raises `InputError`."""
    found = {model.name: path for model in KNOWN if (path := model.find(folder))}
    file = read_smplx(found["smplx"]) if "smplx" in found else None
    body = None if file is None else file.model
    said = _hands_together(found, body)
    if body is not None and "flame" in found:
        head_ids(read_flame(found["flame"]), body, found.get("head_ids"))
        said.append(f"head: its vertices are SMPL-X's, {_source(found.get('head_ids'))}")
    if file is not None and "faceverse" in found:
        face_of(read_faceverse(found["faceverse"]), driven_body(file), file)
        said.append("face: laid on SMPL-X's head by its landmarks")
    return said


def _hands_together(found: dict[str, Path], body: TemplateModel | None) -> list[str]:
    said = []
    if len(alone := {"mano_left", "mano_right"} & set(found)) == 1:
        said.append(f"MANO: the {alone.pop().removeprefix('mano_')} hand alone is not used: the other is missing")
    if {"mano_left", "mano_right"} <= set(found):
        hands = read_hands(found["mano_left"], found["mano_right"])
        fault = "has the right's shape directions: mirrored when read"
        said.append(f"MANO: the left hand {fault if hands['left'].repaired else 'is mirrored as it should be'}")
        if body is not None:
            file = found.get("hand_ids")
            for side, hand in hands.items():
                hand_ids(hand.model, body, side, file)
            said.append(f"hands: their vertices are SMPL-X's, {_source(file)}")
    return said


def _source(file: Path | None) -> str:
    return "found on the meshes" if file is None else f"by {file.name}"


def _smplx(path: Path) -> str:
    found = read_smplx(path)
    hands = "hands with components and mean" if found.hand_components else "no hand components"
    head = ", locked head" if found.locked_head else ""
    poses = "" if found.model.posedirs is not None else ", no pose blend shapes"
    return f"SMPL-X, {found.version} directions{head}{poses}, {hands}"


def _mano(side: str) -> Callable[[Path], str]:
    def told(path: Path) -> str:
        return f"MANO, {side} hand, wrist closed with {len(read_hand(path, side).model.faces) - 1538} triangles"

    return told


def _flame(path: Path) -> str:
    found = read_flame(path)
    return f"FLAME, {found.shapedirs.shape[2]} + {found.expression_dirs.shape[2]} directions"


def _faceverse(path: Path) -> str:
    found = read_faceverse(path)
    axes = "axes as here" if found.turned == (1, 1, 1) else f"axes turned (signs {found.turned})"
    count = found.model.expression_dirs.shape[2]
    names = "with Apple's names" if found.model.expression_names else "without names"
    return f"Faceverse {found.version}, {len(found.model.v_template)} vertices, in {found.unit}, {axes}, {count} expressions {names}"


def _hand_ids(path: Path) -> str:
    return f"vertices of {' and '.join(read_hand_ids(path))} hand"


def _head_ids(path: Path) -> str:
    return f"{len(read_head_ids(path))} vertices of the head"


def _told_beside(path: Path) -> str:
    if path.name.lower() == expression_matrix.FILE:
        return f"52 expressions by {expression_matrix.read_matrix(path).shape[0]} coefficients of Faceverse"
    return f"52 expressions of Faceverse 3, {len(read_fifty_two(path))} vertices"


_TOLD: dict[str, Callable[[Path], str]] = {
    "smplx": _smplx, "mano_left": _mano("left"), "mano_right": _mano("right"), "flame": _flame, "faceverse": _faceverse,
    "hand_ids": _hand_ids, "head_ids": _head_ids,
}  # fmt: skip
