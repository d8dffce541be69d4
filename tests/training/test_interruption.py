"""Ctrl+C: the first requests a stop, the second ends at once, and afterwards everything is as before."""

from __future__ import annotations

import signal
import threading

import pytest

from avatarrex.training.runs.interruption import Interruption


def test_a_first_press_requests_and_a_second_ends() -> None:
    interruption, before = Interruption(), signal.getsignal(signal.SIGINT)
    with interruption.handled():
        assert not interruption.requested
        signal.raise_signal(signal.SIGINT)
        assert interruption.requested
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_the_handler_of_before_is_back_after_an_error() -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(RuntimeError, match="broken"), Interruption().handled():
        raise RuntimeError("broken")
    assert signal.getsignal(signal.SIGINT) is before


def test_other_threads_have_no_presses() -> None:
    """Signals are the main thread's; a training in another is stopped by its control.json alone."""
    done = []

    def work() -> None:
        with Interruption().handled():
            done.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]
