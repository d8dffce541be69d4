"""Where results go: checked before any work, written whole, named on the terminal. Raises `InputError`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from avatarrex.errors import InputError
from avatarrex.files import json_text
from avatarrex.files.gate import check_writable, what_is


def output_file(text: str, form: str) -> Path:
    """A file that can be written; `form`, e.g. `OUT.png`, gives its extension."""
    path, suffix = Path(text), Path(form).suffix
    if path.suffix.lower() != suffix:
        raise InputError(path, "", form, path.suffix or "no extension")
    check_writable(path)
    return path


def output_folder(text: str, name: str) -> Path:
    """A folder, there already or not, where a file called `name` can be written."""
    found = what_is(text)
    if found not in ("a folder", "nothing there"):
        raise InputError(text, "", "a folder to write to", found)
    check_writable(Path(text) / name)
    return Path(text)


def write_json(path: str | Path, data: object) -> None:
    """Write figures as JSON and name the file."""
    json_text.write_json(path, data)
    print(path)


def print_figures(figures: Mapping[str, Any]) -> None:
    """A line for each number or word; what is deeper is left out."""
    flat = {name: value for name, value in figures.items() if isinstance(value, int | float | str)}
    width = max(map(len, flat), default=0)
    for name, value in flat.items():
        print(f"{name:{width}}  {value if isinstance(value, str) else format(value, 'g')}")


def name_files(written: Sequence[Path]) -> None:
    """Print the names of files that were written: all of a few, the first and last of many."""
    if len(written) > 6:
        print(f"{written[0]} … {written[-1]} ({len(written)} files)")
    else:
        print("\n".join(map(str, written)))
