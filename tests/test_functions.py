"""Functions fit the eye: at most 50 lines and 6 parameters. Compiled loops are exempt: their arrays are their parameters."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST_LINES, MOST_PARAMETERS = 50, 6
COMPILED = ("native", "native.native", "borrowing", "native.borrowing")
EXCEPTIONS = {
    "avatarrex/camera.py:orbit": "seven numbers that a person sets, each with a default",
    "avatarrex/capture/readers/rigs.py:_rig": "what a rig is made of, read one after the other in `open_capture`",
    "avatarrex/capture/synthetic/wrinkles.py:add": "one fold, as numbers",
    "avatarrex/fields/body.py:colour": "pairs, implementation and light are optional",
    "avatarrex/fields/face.py:__init__": "widths of one network",
    "avatarrex/fields/template_distance.py:of": "three of seven are optional",
    "avatarrex/pointmap/surface.py:visible_surface": "the frame before is optional",
    "avatarrex/ops/closest_point.py:closest_point": "the mesh, the points, and what of it has been prepared",
    "avatarrex/ops/closest_point.py:_signed_distance": "as `closest_point`",
    "tools/convert_person.py:main": "the steps of a conversion that runs once, one after the other",
}
"""File and function, and why it may be larger."""


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    for folder in ("avatarrex", "app", "tools"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef):
                    yield f"{path.relative_to(ROOT)}:{node.name}", node


def compiled(function: ast.FunctionDef) -> bool:
    return any(ast.unparse(decorator).split("(")[0] in COMPILED for decorator in function.decorator_list)


def parameters(function: ast.FunctionDef) -> int:
    listed = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
    return sum(argument.arg not in ("self", "cls") for argument in listed)


def too_large() -> dict[str, tuple[int, int]]:
    """Lines and parameters of functions over a limit."""
    found = {}
    for name, function in functions():
        lines, count = (function.end_lineno or 0) - function.lineno + 1, parameters(function)
        if not compiled(function) and (lines > MOST_LINES or count > MOST_PARAMETERS):
            found[name] = lines, count
    return found


def test_functions_fit_the_eye() -> None:
    assert {name: size for name, size in too_large().items() if name not in EXCEPTIONS} == {}


def test_no_exception_is_out_of_date() -> None:
    assert set(EXCEPTIONS) <= set(too_large())


@pytest.mark.parametrize(("text", "count"), [("def f(self, a, *, b): ...", 2), ("def f(a, b, /, c): ...", 3)])
def test_parameters_are_counted(text: str, count: int) -> None:
    function = ast.parse(text).body[0]
    assert isinstance(function, ast.FunctionDef)
    assert parameters(function) == count
