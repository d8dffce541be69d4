"""What all tests need of their process."""

from __future__ import annotations

import signal


def pytest_configure():
    """A shell starts what it puts in the background with Ctrl+C ignored, and so would every process that a test starts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items):
    """Files with slow tests come first: processes that share the tests then end together, with what is quick."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
