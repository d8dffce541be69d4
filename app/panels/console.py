"""The Console: what the studio said, newest last, errors in colour."""

from __future__ import annotations

import logging
import time
from collections import deque

from avatarrex_studio.panels import theme, widgets
from imgui_bundle import imgui

LINES = 500
COLOURS = {logging.ERROR: theme.ERROR, logging.WARNING: theme.WARNING}


class ConsolePanel(logging.Handler):
    """A log handler that draws itself."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines: deque[tuple[int, str]] = deque(maxlen=LINES)
        self._count = self._shown = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one record."""
        stamp = time.strftime("%H:%M:%S", time.localtime(record.created))
        self.lines.append((record.levelno, f"{stamp}  {record.getMessage()}"))
        self._count += 1

    def draw(self) -> None:
        """Draw the lines and scroll to a new one."""
        for level, line in self.lines:
            widgets.paragraph(line, COLOURS.get(level, theme.MUTED))
        if self._shown != self._count:
            imgui.set_scroll_here_y(1.0)
            self._shown = self._count
