"""A display of our own for window tests, and the studio on a quick stand-in for the pipeline."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import time

import pytest
from ball_studio import ball_studio


class Clock:
    """A clock that a test turns."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture(autouse=True)
def folders_of_our_own(tmp_path_factory, monkeypatch):
    """The user's library, cache and state are neither read nor written."""
    folder = tmp_path_factory.mktemp("user")
    monkeypatch.setenv("AVATARREX_LIBRARY", str(folder / "library"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def studio(clock):
    return ball_studio(clock)


@pytest.fixture(scope="session")
def last_words(pytestconfig):
    """Xlib ends the process when its server is lost: say so on the true stderr, past pytest's capture."""
    with pytestconfig.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
        stderr = os.dup(2)

    @ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
    def lost(_display):
        test = os.environ.get("PYTEST_CURRENT_TEST", "no test")
        os.write(stderr, f"\nFAILED {test}: the X server is lost, and Xlib ends this process\n".encode())
        return 0

    library = ctypes.CDLL("libX11.so.6")  # the one that GLFW opens
    library.XSetIOErrorHandler(lost)
    yield
    library.XSetIOErrorHandler(None)
    os.close(stderr)


@pytest.fixture(scope="session")
def display(request):
    """An Xvfb of our own."""
    program = shutil.which("Xvfb")
    if program is None:
        pytest.skip("Xvfb is not installed")
    request.getfixturevalue("last_words")
    read, write = os.pipe()
    server = subprocess.Popen(
        # Without -noreset the server starts anew when its last client leaves, and drops who connects meanwhile.
        [program, "-displayfd", str(write), "-screen", "0", "1920x1080x24", "-nolisten", "tcp", "-noreset"],
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    if not number:
        pytest.skip("Xvfb could not open a display")
    before = os.environ.get("DISPLAY")
    os.environ["DISPLAY"] = f":{number}"
    time.sleep(0.2)
    yield f":{number}"
    server.terminate()
    server.wait(10)
    os.environ.pop("DISPLAY")
    if before is not None:
        os.environ["DISPLAY"] = before
