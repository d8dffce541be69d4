"""Questions and news that wait for an answer: a modal dialog with a button for each answer, one after the other.

Enter gives the first answer, Esc none: nothing happens then.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from avatarrex_studio.panels import theme, widgets
from imgui_bundle import imgui

TITLE = "###question"
WIDTH = 460.0
BUTTON = 132.0


def nothing() -> None:
    """What an answer does that changes nothing."""


@dataclass(frozen=True)
class Question:
    """What is to be decided, and what each answer does."""

    title: str
    text: str
    answers: Mapping[str, Callable[[], None]] = field(default_factory=lambda: {"Close": nothing})


class Questions:
    """Those that have no answer yet; the first is on the screen."""

    def __init__(self) -> None:
        self.waiting: deque[Question] = deque()
        self._open: Question | None = None

    def put(self, question: Question) -> None:
        """Show it after those that wait; one that waits already is not put twice."""
        if not any(other.title == question.title and other.text == question.text for other in self.waiting):
            self.waiting.append(question)

    def draw(self) -> None:
        """Draw the first; do what its answer says."""
        if not self.waiting:
            return
        question = self.waiting[0]
        name = question.title + TITLE
        if self._open is not question:
            imgui.open_popup(name)
            self._open = question
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing, (0.5, 0.5))
        imgui.set_next_window_size((WIDTH, 0))
        if not imgui.begin_popup_modal(name, None, imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_saved_settings)[
            0
        ]:
            self._end(nothing)  # closed by Esc
            return
        widgets.paragraph(question.text, theme.TEXT)
        imgui.spacing()
        entered = imgui.is_key_pressed(imgui.Key.enter, False) and not imgui.is_window_appearing()
        chosen = next(iter(question.answers)) if entered else None  # the key that put the question does not answer it
        for answer in widgets.in_rows(question.answers):
            if imgui.button(answer, (BUTTON, 0)):
                chosen = answer
        if chosen:
            imgui.close_current_popup()
        imgui.end_popup()
        if chosen:
            self._end(question.answers[chosen])

    def _end(self, effect: Callable[[], None]) -> None:
        self.waiting.popleft()
        self._open = None
        effect()
