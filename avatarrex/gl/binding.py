"""Which OpenGL context is current in this thread, queried from the library that made it, and how it is made current again.

moderngl only switches contexts that it made itself; a program's own may stem from GLFW, Qt or SDL. The window systems keep
the same few values: (EGL) display, surfaces for drawing and reading, context; (GLX) the same; (WGL) device, context.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

EGL_DRAW, EGL_READ = 0x3059, 0x305A


@dataclass(frozen=True)
class WindowSystem:
    """Functions of one library."""

    queries: tuple[Callable[[], int | None], ...]
    """What `make_current` takes, as it is now; the context last, None or 0 where none is current."""
    make_current: Callable[..., int]
    """0 where it is refused."""


@dataclass(frozen=True)
class Binding:
    """A context as it is, or was, current in a thread."""

    system: WindowSystem
    handles: tuple[int, ...]

    def bind(self) -> bool:
        """Make it current in this thread; False where it is current in another one, or gone."""
        return bool(self.system.make_current(*self.handles))

    def release(self) -> None:
        """Leave this thread without a current context."""
        display = self.handles[0] if len(self.handles) > 2 else 0  # WGL takes no device for none
        self.system.make_current(display, *(0 for _ in self.handles[1:]))


def current_binding() -> Binding | None:
    """What is current in this thread; None: no context is."""
    for system in _systems():
        handles = tuple(query() or 0 for query in system.queries)
        if handles[-1]:
            return Binding(system, handles)
    return None


def switch(before: Binding | None, after: Binding | None) -> bool:
    """From `before`, which is current, to `after`; False, with `before` current again, where `after` cannot be."""
    if before == after:
        return True
    # GLX and EGL refuse a thread that is taken by the other.
    if before is not None and (after is None or after.system is not before.system):
        before.release()
    if after is None or after.bind():
        return True
    if before is not None:
        before.bind()
    return False


@contextmanager
def nothing_current() -> Iterator[None]:
    """The body may make contexts; what was current before is restored after it."""
    before = current_binding()
    switch(before, None)
    try:
        yield
    finally:
        switch(current_binding(), before)


@cache
def _systems() -> tuple[WindowSystem, ...]:
    """Those whose library is on this machine."""
    if sys.platform == "win32":
        return tuple(_opened("opengl32", ("wglGetCurrentDC", "wglGetCurrentContext"), "wglMakeCurrent"))
    egl = ("eglGetCurrentDisplay", ("eglGetCurrentSurface", EGL_DRAW), ("eglGetCurrentSurface", EGL_READ))
    glx = ("glXGetCurrentDisplay", "glXGetCurrentDrawable", "glXGetCurrentReadDrawable")
    return (
        *_opened("libEGL.so.1", (*egl, "eglGetCurrentContext"), "eglMakeCurrent"),
        *_opened("libGL.so.1", (*glx, "glXGetCurrentContext"), "glXMakeContextCurrent"),
    )


def _opened(library: str, queries: tuple[str | tuple[str, int], ...], make: str) -> Iterator[WindowSystem]:
    """Of handles as wide as pointers."""
    try:
        opened = ctypes.CDLL(library)
        make_current = opened[make]
        called = [_query(opened, query) for query in queries]
    except (OSError, AttributeError):
        return
    make_current.argtypes = [ctypes.c_void_p] * len(queries)
    make_current.restype = ctypes.c_int
    yield WindowSystem(tuple(called), make_current)


def _query(opened: ctypes.CDLL, query: str | tuple[str, int]) -> Callable[[], int | None]:
    name, *arguments = (query,) if isinstance(query, str) else query
    function = opened[name]
    function.restype = ctypes.c_void_p
    function.argtypes = [ctypes.c_int] * len(arguments)
    return lambda: function(*arguments)
