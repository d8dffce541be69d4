"""Nothing that a panel or a command does ends the program: what fails becomes text with its cause, and the window goes on.

A failure is a fault of ours (what a user's input can cause is an `InputError`, which is said where it is met). It is told once, with its
details to copy; a panel that failed is not drawn again until somebody wants that.
"""

from __future__ import annotations

import logging
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from avatarrex_studio.panels import curves, theme, widgets
from imgui_bundle import imgui

from avatarrex.errors import InputError, plain

log = logging.getLogger(__name__)
Answer = TypeVar("Answer")
RETRY = "Try again"
COPY = "Copy details"


@dataclass(frozen=True)
class Failure:
    """What failed, why, and the trace."""

    place: str
    cause: str
    details: str
    source: tuple[str, str, int] = field(default=("", "", 0), compare=False)
    """Kind of the exception, file and line that raised it: a cause may be worded otherwise each time."""

    @classmethod
    def of(cls, place: str, error: Exception) -> Failure:
        """From an exception that was caught."""
        last = traceback.extract_tb(error.__traceback__)[-1]
        source = type(error).__name__, last.filename, last.lineno or 0
        return cls(place, plain(f"{source[0]}: {error}"), "".join(traceback.format_exception(error)), source)

    @property
    def text(self) -> str:
        """For a dialog."""
        return (
            f"{self.cause}\n\nThis is a fault of the program. Nothing of your work is lost: save the session (Ctrl+S), go on, "
            "and send the details to whoever maintains it."
        )


class Guard:
    """Runs what may fail."""

    def __init__(self, tell: Callable[[Failure], None]) -> None:
        """`tell` shows a failure; it is called once for each cause at a place."""
        self.failed: dict[str, Failure] = {}
        """The last failure of each place."""
        self._tell = tell
        self._told: set[tuple[str, tuple[str, str, int]]] = set()

    def run(self, place: str, call: Callable[[], Answer]) -> Answer | None:
        """The answer of `call`; None where it failed. What it began of the interface is ended then."""
        within = imgui.get_current_context().within_frame_scope
        before = imgui.internal.ErrorRecoveryState()
        if within:
            imgui.internal.error_recovery_store_state(before)
        try:
            return call()
        except InputError as error:  # said nowhere else
            log.error("%s", error)
        except Exception as error:
            self._take(Failure.of(place, error))
        if within:
            _recover(before)
        return None

    def panel(self, title: str, draw: Callable[[], None]) -> None:
        """Draw a panel, or say that it failed, with a button that tries again."""
        failure = self.failed.get(title)
        if failure is None:
            self.run(title, draw)
            return
        widgets.paragraph(f"{title} failed.", theme.ERROR)
        widgets.paragraph(failure.cause)
        if imgui.button(f"{RETRY}##{title}"):
            del self.failed[title]
        imgui.same_line()
        if imgui.button(f"{COPY}##{title}"):
            imgui.set_clipboard_text(failure.details)

    def _take(self, failure: Failure) -> None:
        self.failed[failure.place] = failure
        key = failure.place, failure.source
        if key not in self._told:
            self._told.add(key)
            log.error("%s failed: %s", failure.place, failure.cause)
            log.info("%s", failure.details)
            self._tell(failure)


def _recover(before: imgui.internal.ErrorRecoveryState) -> None:
    """End windows, groups, tables and styles that were begun since `before`."""
    io = imgui.get_io()
    kept = io.config_error_recovery_enable_assert, io.config_error_recovery_enable_debug_log
    io.config_error_recovery_enable_assert = io.config_error_recovery_enable_debug_log = False
    curves.close()  # a plot that was begun cannot be ended: the library's context is made anew
    imgui.internal.error_recovery_try_to_recover_state(before)
    io.config_error_recovery_enable_assert, io.config_error_recovery_enable_debug_log = kept
