"""`avatarrex-studio models list|add|check|matrix`: the body, hand and face models that a user brings, in one folder."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from avatarrex.errors import InputError, plain
from avatarrex.files.gate import check_file, check_writable, what_is, written
from avatarrex.templates.official.known_models import models_folder

if TYPE_CHECKING:
    from avatarrex.templates.model import TemplateModel

MATRIX = {
    "faceverse": ("Faceverse", "a file of version 1, 3 or 4 (`models list`), or `models matrix flame`"),
    "flame": ("FLAME", "a file of 2020 or 2023 (`models list`)"),
}
"""Faces whose coefficients have no names, and what is expected where there is none."""
MOTIONS = "{}_motions.csv"
"""The table by which motions in a model's coefficients are read."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """Each act with its own."""
    acts = verb.add_subparsers(dest="act", metavar="ACT", required=True)
    listed = acts.add_parser("list", help="which are there, and what to do about the others", allow_abbrev=False)
    add = acts.add_parser("add", help="read files and copy them into the folder", allow_abbrev=False)
    add.add_argument("files", nargs="+", metavar="FILE", help="under the name that it is published under")
    check = acts.add_parser(
        "check", help="read every file of the folder, and those that belong together", allow_abbrev=False
    )
    what = "write tables between the 52 names and a face's unnamed coefficients, by least squares, to be edited"
    matrix = acts.add_parser("matrix", help=what, allow_abbrev=False)
    matrix.add_argument("model", nargs="?", default="faceverse", choices=MATRIX, help="whose coefficients (faceverse)")
    for act in (listed, add, check, matrix):
        act.add_argument("--folder", metavar="DIR", help="instead of the user's models folder (AVATARREX_MODELS)")


def run(arguments: argparse.Namespace) -> int:
    """List, add or check. Raises `InputError`."""
    folder = models_folder() if arguments.folder is None else Path(arguments.folder)
    if what_is(folder) not in ("a folder", "nothing there"):
        raise InputError(folder, "", "a folder of models", what_is(folder))
    if arguments.act == "add":
        return _add(arguments.files, folder)
    if arguments.act == "matrix":
        return _matrix(folder, arguments.model)
    return _list(folder) if arguments.act == "list" else _check(folder)


def _list(folder: Path) -> int:
    from avatarrex_studio.jobs.available import lines, models

    print(plain(f"models folder: {folder}"))
    print("\n".join(map(plain, lines(models(folder)))))
    return 0


def _add(files: list[str], folder: Path) -> int:
    from avatarrex.files.pickles import PICKLE_BYTES
    from avatarrex.templates.official.known_models import model_of, published_name
    from avatarrex.templates.official.model_check import describe

    known = [(Path(file), model_of(file)) for file in files]
    for path, model in known:
        check_file(path, "a model's file", PICKLE_BYTES)
        target = folder / published_name(path)
        check_writable(target)
        said = describe(model, path)
        with written(target) as temporary:
            shutil.copyfile(path, temporary)
        print(plain(f"{target}: {said}"))
    return 0


def _matrix(folder: Path, name: str) -> int:
    """`MOTIONS` of the model; of Faceverse, whose face avatars have, also the table that gives it the names."""
    from avatarrex.signals.expression_map import write_expression_map
    from avatarrex.templates.official.expression_fit import fit_expressions
    from avatarrex.templates.official.expression_matrix import FILE, write_matrix
    from avatarrex.templates.person import load_person

    own, motions = folder / FILE, folder / MOTIONS.format(name)
    wanted = [own, motions] if name == "faceverse" else [motions]
    targets = [target for target in wanted if what_is(target) == "nothing there"]
    if not targets:
        raise InputError(motions, "", "nothing there: edit it, or move it away", what_is(motions))
    for target in set(wanted) - set(targets):
        print(plain(f"{target}: kept as it is"))
    fit = fit_expressions(_unnamed(folder, name), load_person().face)
    if own in targets:
        write_matrix(own, fit.coefficients, fit.explained)
        print(
            plain(
                f"{own}: {len(fit.coefficients)} coefficients by the 52 names, nearest to the default face; to be edited"
            )
        )
    if motions in targets:
        write_expression_map(motions, fit.names, fit.explained, ordered=name == "flame")
        count = len(fit.coefficients)
        print(plain(f"{motions}: the 52 by {count} coefficients, for motions (`--expressions`); to be edited"))
    print(
        plain(
            f"of each name's motion this face shows {fit.explained.mean():.0%} in the mean; poor: {fit.poor() or 'none'}"
        )
    )
    return 0


def _unnamed(folder: Path, name: str) -> TemplateModel:
    """The folder's face whose coefficients have no names. Raises `InputError`."""
    from avatarrex.templates.official.faceverse import read_faceverse
    from avatarrex.templates.official.flame import read_flame
    from avatarrex.templates.official.known_models import KNOWN

    path = next(model for model in KNOWN if model.name == name).find(folder)
    if path is None:
        raise InputError(folder, *MATRIX[name], "nothing there")
    if name == "flame":
        return read_flame(path)
    face = read_faceverse(path).model
    if face.expression_names:
        raise InputError(path, "exp_name_list", "coefficients without names", "the 52 by their names")
    return face


def _check(folder: Path) -> int:
    """Each file in a line, and what does not fit; exit status 1 where a file is refused."""
    from avatarrex.templates.official.known_models import files_of
    from avatarrex.templates.official.model_check import check_together, describe

    found = files_of(folder)
    if not found:
        print(plain(f"{folder}: no models; `avatarrex-studio models list` says which there are"))
    unused = {path for model, path in found if model and model.find(folder) != path}
    tests = [
        lambda model=model, path=path: f"{path.name}: {describe(model, path)}" + ", not used" * (path in unused)
        for model, path in found
    ]
    refused = [said for test in tests if (said := _refusal(test))]
    if not refused:
        refused = [said for said in [_refusal(lambda: "\n".join(check_together(folder)))] if said]
    return int(bool(refused))


def _refusal(test: Callable[[], str]) -> str:
    """Print what a test says, or why it refuses, which is the result; empty where it does not."""
    try:
        said = test()
    except InputError as error:
        print(f"refused: {error}")
        return str(error)
    if said:
        print("\n".join(map(plain, said.splitlines())))
    return ""
