"""An OpenGL context that the driver takes away: found out, so that the window is opened anew with all that was open in it.

A graphics card that is reset (it hung, its driver was replaced, a computer woke up) takes the context and everything in it; nothing can be
drawn with it again. Where the context was made robust the driver tells of it (`glGetGraphicsResetStatus`, OpenGL 4.5 or ARB_robustness);
elsewhere pictures fail, one after the other, and nothing else can be drawn in it either. Lost twice within a minute it is given up.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable
from typing import Any

import moderngl
from avatarrex_studio.window.starting import display_fault

NAMES = ("glGetGraphicsResetStatus", "glGetGraphicsResetStatusKHR", "glGetGraphicsResetStatusARB")
FAILURES = 3
"""Pictures one after the other that could not be drawn."""
TEXEL = bytes((1, 2, 3, 4))
SOON = 60.0
"""Seconds."""


def works() -> bool:
    """Whether the context that is current keeps what is written into it."""
    try:
        texture = moderngl.create_context().texture((1, 1), 4, TEXEL)
        kept = texture.read() == TEXEL
        texture.release()
        return bool(kept)
    except Exception:  # whatever it is, it is the answer
        return False


class ContextLoss:
    """One window's, through all its contexts."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.given_up = False
        self.status: Callable[[], int] = lambda: 0
        """What the driver says of the present context; 0: nothing is wrong."""
        self.works: Callable[[], bool] = works
        """Whether something can be drawn in it: pictures fail of other faults, too."""
        self._clock, self._failures, self._last = clock, 0, -math.inf

    def ask(self) -> None:
        """Before a window is made: have its driver tell of a reset, where it can."""
        import glfw  # after imgui_bundle, which brings its own library

        if not display_fault():
            glfw.window_hint(glfw.CONTEXT_ROBUSTNESS, glfw.LOSE_CONTEXT_ON_RESET)

    def open(self) -> None:
        """The window's context is there, and current."""
        import glfw  # after imgui_bundle, which brings its own library

        places: list[Any] = [place for name in NAMES if (place := glfw.get_proc_address(name))]
        self.status = ctypes.CFUNCTYPE(ctypes.c_uint)(places[0]) if places else lambda: 0
        self._failures = 0

    def found(self, drawn: bool) -> bool:
        """Once a frame, with whether its picture was `drawn`: whether the context is lost. The second time within `SOON` it is given up."""
        self._failures = 0 if drawn else self._failures + 1
        if not self.status() and (self._failures < FAILURES or self.works()):
            return False
        now = self._clock()
        self.given_up = now - self._last < SOON
        self._last, self._failures = now, 0
        return True
