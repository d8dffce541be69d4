"""The OpenGL context (4.3: compute shaders) that draws and casts rays, made once and on first use.

Linux makes a standalone EGL context, which needs no display; where EGL is missing (Windows) a hidden GLFW window
carries it. Inside the studio's window the window's own context is lent by `use_context`. Where none can be had,
`NoContext` says why and the callers fall back to torch. `AVATARREX_GL` = `off`, `egl` or `glfw` forces a choice.

A program may have contexts of its own: all OpenGL work here runs inside `current_context()`, which makes this context
current and gives the thread back as it was. Threads take turns.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import moderngl

from avatarrex.errors import InputError
from avatarrex.gl.binding import Binding, current_binding, nothing_current, switch

REQUIRED = 430
"""OpenGL 4.3, the first with compute shaders; Mesa llvmpipe stops at 4.5."""
DEVICES = 4
"""EGL device indices that are tried: a machine with several graphics cards numbers them from 0."""
CHOICES = ("auto", "egl", "glfw", "off")
SOFTWARE = ("llvmpipe", "softpipe", "swiftshader", "software", "basic render", "gdi generic")
"""Parts of the names of renderers without a graphics card, small letters."""
Made = TypeVar("Made")


class NoContext(RuntimeError):
    """No OpenGL 4.3 context can be made or used here; the message says what was tried."""


@dataclass(frozen=True)
class _Known:
    """A context and how it becomes current."""

    context: moderngl.Context
    binding: Binding | None


_made: _Known | None = None
_reason: str | None = None
_lent: _Known | None = None
_turn = threading.RLock()


@contextmanager
def current_context() -> Iterator[moderngl.Context]:
    """The context in use, current inside the `with`; what was current before (or nothing) is restored after it.

    Also a decorator. Raises `NoContext` with the cause, where another thread keeps the context current, too.
    """
    with _turn:
        known, before = _known(), current_binding()
        if not switch(before, known.binding):
            raise NoContext("the OpenGL context is current in another thread")
        try:
            yield known.context
        finally:
            switch(known.binding, before)


def gl_context() -> moderngl.Context:
    """The context in use: the lent one, else one made on the first call, and current where no other is.

    For who owns the process; a library's own work takes `current_context`. Raises `NoContext` with the cause.
    """
    known = _known()
    if current_binding() is None:
        switch(None, known.binding)
    return known.context


def use_context(context: moderngl.Context | None) -> None:
    """Lend a window's context, `moderngl.create_context(require=430)`, current in this thread; None takes it back."""
    global _lent
    _lent = None if context is None else _Known(context, current_binding())


def gl_unavailable() -> str | None:
    """Why there is no OpenGL here; None where there is."""
    try:
        _known()
    except NoContext as error:
        return str(error)
    return None


@current_context()
def renderer_name(context: moderngl.Context) -> str:
    """GL_RENDERER, e.g. `llvmpipe (LLVM 15.0.6, 256 bits)`."""
    return str(context.info["GL_RENDERER"])


def in_software(renderer: str) -> bool:
    """Whether GL_RENDERER is that of a renderer without a graphics card."""
    return any(part in renderer.lower() for part in SOFTWARE)


def per_context(context: moderngl.Context, key: object, make: Callable[[], Made]) -> Made:
    """What `make` made for this context under `key`: programs and textures belong to one context."""
    if context.extra is None:
        context.extra = {}
    if key not in context.extra:
        context.extra[key] = make()
    made: Made = context.extra[key]
    return made


def _known() -> _Known:
    """Lent or made, current or not."""
    global _made, _reason
    choice = _choice()
    if choice == "off":
        raise NoContext("OpenGL is switched off by AVATARREX_GL=off")
    if _lent is not None:
        return _lent
    with _turn:
        if _made is None and _reason is None:
            with nothing_current():
                _made, _reason = _make(choice)
    if _made is None:
        raise NoContext(_reason)
    return _made


def _choice() -> str:
    choice = os.environ.get("AVATARREX_GL", "").lower() or "auto"
    if choice not in CHOICES:
        raise InputError("AVATARREX_GL", "", " | ".join(CHOICES), choice)
    return choice


def _make(choice: str) -> tuple[_Known | None, str]:
    """A context and the causes of the attempts that failed before it."""
    causes: dict[str, None] = {}
    for attempt in _attempts(choice):
        try:
            return _Known(attempt(), current_binding()), ""
        except Exception as error:  # glcontext, ctypes and glfw raise their own kinds; each cause is kept
            causes[str(error)] = None
    return None, "no OpenGL 4.3 context: " + "; ".join(causes)


def _attempts(choice: str) -> Iterator[Callable[[], moderngl.Context]]:
    if choice in ("auto", "egl") and os.name == "posix":
        yield _egl
        # Without the -dev packages only the versioned names exist.
        names = {"libgl": "libGL.so.1", "libegl": "libEGL.so.1"}
        for device in range(DEVICES):
            yield partial(_egl, device_index=device, **names)
    if choice in ("auto", "glfw"):
        yield _hidden_window


def _egl(**settings: Any) -> moderngl.Context:
    options: dict[str, Any] = {"backend": "egl", **settings}
    return moderngl.create_context(standalone=True, require=REQUIRED, **options)


def _hidden_window() -> moderngl.Context:
    import glfw  # kept out of the headless path: it loads the display libraries

    if not glfw.init():
        raise NoContext("GLFW finds no display")
    glfw.window_hint(glfw.VISIBLE, False)
    glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, REQUIRED // 100)
    glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, REQUIRED // 10 % 10)
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
    window = glfw.create_window(16, 16, "AvatarReX", None, None)
    if not window:
        raise NoContext("GLFW cannot make a hidden OpenGL 4.3 window")
    glfw.make_context_current(window)
    return moderngl.create_context(require=REQUIRED)
