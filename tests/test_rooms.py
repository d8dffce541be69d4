"""The order of the rooms: a file imports from its own room or from rooms below, never upward and never in a circle.

Imports inside functions and for type checkers count, too.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = (
    ("avatarrex.errors", "avatarrex.data"),
    ("avatarrex.counters", "avatarrex.camera", "avatarrex.files", "avatarrex.ops", "avatarrex.gl"),
    ("avatarrex.signals",),
    ("avatarrex.settings", "avatarrex.levels"),
    ("avatarrex.templates",),
    ("avatarrex.fields",),
    ("avatarrex.surface",),
    ("avatarrex.parts",),
    ("avatarrex.avatar", "avatarrex.avatar_file"),
    ("avatarrex.volume",),
    ("avatarrex.pointmap",),
    ("avatarrex.shading",),
    ("avatarrex.frame",),
    ("avatarrex.live",),
    ("avatarrex.pipeline",),
    ("avatarrex.stage",),
    ("avatarrex.reference",),
    ("avatarrex.capture",),
    ("avatarrex.distil",),
    ("avatarrex.export",),
    ("avatarrex.metrics",),
    ("avatarrex.training",),
    ("avatarrex.measure",),
    ("avatarrex",),
    ("avatarrex_studio.session",),
    ("avatarrex_studio.live",),
    ("avatarrex_studio.engine",),
    ("avatarrex_studio.jobs", "avatarrex_studio.sheets"),
    ("avatarrex_studio.panels",),
    ("avatarrex_studio.window",),
    ("avatarrex_studio.cli",),
    ("avatarrex_studio.__main__",),
)
"""From the bottom up. Rooms side by side may import each other as long as no files import each other in a circle."""
FLOOR = {room: floor for floor, rooms in enumerate(ROOMS) for room in rooms}
NOT_NEEDED_BY_THE_STUDIO = "avatarrex.measure"
"""What measures the product; only its verbs on the command line know it."""


def files() -> dict[str, Path]:
    """Every module of the library and the studio."""
    found = {}
    for folder, name in (("avatarrex", "avatarrex"), ("app", "avatarrex_studio")):
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join((name, *(part for part in parts if part != "__init__")))] = path
    return found


FILES = files()


def imports(module: str) -> Iterator[str]:
    """The modules of ours that a module imports anywhere in its text."""
    for node in ast.walk(ast.parse(FILES[module].read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield full if full in FILES else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def ours(module: str) -> set[str]:
    return {name for name in imports(module) if name.split(".")[0] in ("avatarrex", "avatarrex_studio")}


def room(module: str) -> str:
    """The longest name in `FLOOR` that a module's name begins with."""
    return max((name for name in FLOOR if f"{module}.".startswith(f"{name}.")), key=len, default="")


@pytest.mark.parametrize("module", [module for module in FILES if module not in ("avatarrex", "avatarrex_studio")])
def test_nothing_imports_upward(module: str) -> None:
    assert room(module) not in ("", "avatarrex"), f"{module} stands in no room of the list"
    floor = FLOOR[room(module)]
    upward = {name for name in ours(module) if name not in FILES or FLOOR[room(name)] > floor}
    assert not upward


def test_no_files_import_each_other_in_a_circle() -> None:
    try:
        list(TopologicalSorter({module: ours(module) - {module} for module in FILES}).static_order())
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_the_studio_does_not_need_what_measures_it() -> None:
    users = {module for module in FILES if any(name.startswith(NOT_NEEDED_BY_THE_STUDIO) for name in ours(module))}
    assert {room(module) for module in users} <= {NOT_NEEDED_BY_THE_STUDIO, "avatarrex_studio.cli"}
