"""Pictures in a program that draws into a window of its own, made by GLFW on X (GLX, while ours comes from EGL)."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from avatarrex.gl import gl_unavailable

PROGRAM = """
import glfw, moderngl

glfw.init()
glfw.window_hint(glfw.VISIBLE, False)
window = glfw.create_window(16, 16, "theirs", None, None)
glfw.make_context_current(window)
theirs = moderngl.create_context()
kept = theirs.buffer(b"abcd")

import torch
from avatarrex.camera import Camera
from avatarrex.pointmap.raycast import raycast
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume

z, y, x = torch.meshgrid(*[torch.arange(21.0)] * 3, indexing="ij")
ball = BodyGrid((-0.2, -0.2, -0.2), 0.02, (((x - 10) ** 2 + (y - 10) ** 2 + (z - 10) ** 2).sqrt() - 8) * 0.02)
for distance in (1.0, 1.5):
    found = raycast(SdfVolume(ball), Camera.orbit(0, 0, distance, 40, (0, 0, 0), 32, 32), "gl")
    assert abs(float(found.depth[16, 16]) - (distance - 0.16)) < 0.002, found.depth[16, 16]
assert kept.read() == b"abcd" and theirs.error == "GL_NO_ERROR"
glfw.terminate()
"""


@pytest.mark.skipif(gl_unavailable() is not None, reason=str(gl_unavailable()))
@pytest.mark.skipif(not (shutil.which("xvfb-run") and shutil.which("xauth")), reason="Xvfb or xauth is not installed")
def test_a_program_with_a_window():
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    words = ["xvfb-run", "-a", sys.executable, "-c", PROGRAM]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 0, done.stderr
