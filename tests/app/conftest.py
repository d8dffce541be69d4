"""A display of our own for window tests, and the studio on a quick stand-in for the pipeline."""

from __future__ import annotations

import os
import shutil
import subprocess
import time

import pytest
from avatarrex_studio.studio import Studio
from ball import ball_engine


class Clock:
    """A clock that a test turns."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def studio(clock):
    return Studio(ball_engine(), clock=clock)


@pytest.fixture(scope="session")
def display():
    """A free X display: the one that is there, or an Xvfb of our own."""
    program = shutil.which("Xvfb")
    if program is None:
        pytest.skip("Xvfb is not installed")
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
