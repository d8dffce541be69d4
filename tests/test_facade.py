"""The face to the outside: a dozen names, imported on first use, and pictures inside another OpenGL program."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import moderngl
import pytest
import torch

import avatarrex as ax
from avatarrex.gl.binding import current_binding, nothing_current
from avatarrex.gl.context import gl_unavailable

HEAVY = {"torch", "numpy", "numba", "moderngl", "scipy"}


def test_importing_it_loads_nothing() -> None:
    code = "import sys, avatarrex; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert HEAVY & set(done.stdout.split()) == set()


def test_settings_and_motions_need_no_torch() -> None:
    names = "ax.Signals, ax.Camera, ax.RenderSettings, ax.level, ax.named_pose, ax.read_motion"
    code = f"import sys, avatarrex as ax; {names}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "torch" not in done.stdout.split()


def test_type_checkers_see_the_same_names() -> None:
    """What `if TYPE_CHECKING` imports is what `__getattr__` finds, name by name."""
    tree = ast.parse(Path(ax.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.asname or alias.name: (node.module, alias.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert sorted(seen) == sorted(ax.__all__) == list(ax.__all__)
    for name, (module, its_name) in seen.items():
        assert module is not None
        assert getattr(ax, name) is getattr(import_module(module), its_name), name
    assert set(ax.__all__) <= set(dir(ax))


def test_every_name_is_documented() -> None:
    for name in ax.__all__:
        found = getattr(ax, name)
        text = found.__doc__ or ""
        assert len(text) > 60, name
        if inspect.isfunction(found):
            assert "Raises `" in text, f"{name} does not say what it refuses"


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'avatarrex' has no attribute 'nothing'"):
        ax.nothing  # noqa: B018


@pytest.mark.skipif(gl_unavailable() is not None, reason=str(gl_unavailable()))
def test_the_picture_is_the_same_inside_another_opengl_program() -> None:
    """Before, the face's volume was NaN, or a texture could not be made."""
    avatar, camera = ax.load("default"), ax.Camera.orbit(distance=1.0, target=(0.0, 0.6, 0.0), width=64, height=64)
    rest = ax.Signals.rest()
    smile = rest.replace(body_pose=ax.named_pose("wave"), expression=ax.named_expression("smile"))
    with nothing_current():
        ax.render(avatar, rest, camera)
        alone = ax.render(avatar, smile, camera)
        assert current_binding() is None
        other = moderngl.create_context(standalone=True, backend="egl")
        kept, theirs = other.buffer(b"abcd"), current_binding()
        within = ax.render(avatar, smile, camera)
        assert torch.equal(within.image, alone.image)
        assert within.notes == alone.notes
        assert current_binding() == theirs
        assert kept.read() == b"abcd"
        assert other.error == "GL_NO_ERROR"
        other.release()
