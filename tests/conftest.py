"""What all tests need of their process."""

from __future__ import annotations

import signal


def pytest_configure():
    """A shell starts what it puts in the background with Ctrl+C ignored, and so would every process that a test starts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
