"""Shader sources: `#include`, injected constants, and compiler messages that name the file and line.

Files live in `shaders/` (installed as `avatarrex_shaders`). `#include "lib/ray.glsl"` is resolved from there,
recursively, once per file. Every file keeps its own line numbers through `#line line file_number`; `explain` turns the
file numbers of a compiler message back into names.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

import moderngl

VERSION = 430
"""Of GLSL, where nothing else is said."""
_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
_PLACE = re.compile(r"(?m)^(?:ERROR: )?(\d+)(:(\d+)\(\d+\)|\((\d+)\)|:(\d+))")


class ShaderError(RuntimeError):
    """A shader that the driver refused; the message names file and line."""


@dataclass(frozen=True)
class ShaderSource:
    """A flattened shader and the files that it was made of, in the order of their `#line` numbers."""

    text: str
    files: tuple[str, ...]

    def explain(self, message: str) -> str:
        """The driver's message with file names for file numbers (Mesa `0:12(3)`, NVIDIA `0(12)`, Intel `0:12`)."""

        def named(match: re.Match[str]) -> str:
            number = int(match[1])
            line = match[3] or match[4] or match[5]
            return f"shaders/{self.files[number]}:{line}" if number < len(self.files) else match[0]

        return _PLACE.sub(named, message)


def load_shader(
    name: str, constants: Mapping[str, int | float | bool] | None = None, version: int = VERSION
) -> ShaderSource:
    """Read `shaders/<name>` with its includes; `constants` become `#define`s ahead of the first line.

    Raises `ShaderError` for a missing file, naming the line that includes it.
    """
    seen: list[str] = []
    body = _flatten(name, seen, included_by="")
    defines = "".join(f"#define {key} {_literal(value)}\n" for key, value in (constants or {}).items())
    return ShaderSource(f"#version {version}\n" + defines + body, tuple(seen))


def compute_shader(
    context: moderngl.Context, name: str, constants: Mapping[str, int | float | bool] | None = None
) -> moderngl.ComputeShader:
    """Compile the compute pass `shaders/<name>`. Raises `ShaderError`."""
    source = load_shader(name, constants)
    try:
        return context.compute_shader(source.text)
    except moderngl.Error as error:
        raise ShaderError(source.explain(str(error))) from error


def draw_program(
    context: moderngl.Context,
    vertex: str,
    fragment: str,
    constants: Mapping[str, int | float | bool] | None = None,
) -> moderngl.Program:
    """Compile and link the pair `shaders/<vertex>`, `shaders/<fragment>`. Raises `ShaderError`."""
    version = min(VERSION, context.version_code)
    sources = load_shader(vertex, constants, version), load_shader(fragment, constants, version)
    try:
        return context.program(vertex_shader=sources[0].text, fragment_shader=sources[1].text)
    except moderngl.Error as error:
        blamed = sources["fragment_shader" in str(error)]
        raise ShaderError(blamed.explain(str(error))) from error


def _flatten(name: str, seen: list[str], included_by: str) -> str:
    number = len(seen)
    seen.append(name)
    try:
        text = files("avatarrex_shaders").joinpath(name).read_text(encoding="utf-8")
    except OSError as error:
        raise ShaderError(f"shaders/{name}: no such shader{included_by}") from error
    lines = [f"#line 1 {number}"]
    for line_number, line in enumerate(text.splitlines(), start=1):
        include = _INCLUDE.match(line)
        if include is None:
            lines.append(line)
        else:
            if include[1] not in seen:
                lines.append(_flatten(include[1], seen, f", included by shaders/{name}:{line_number}"))
            lines.append(f"#line {line_number + 1} {number}")
    return "\n".join(lines) + "\n"


def _literal(value: int | float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return str(value)
    text = f"{value:.9g}"
    return text if "." in text or "e" in text else text + ".0"
