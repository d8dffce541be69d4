"""File → Export… in the window: the dialog, the question before a file is overwritten, the process, how far it is."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.jobs.export_order import Make, Order
from avatarrex_studio.jobs.exporting import Exporting
from avatarrex_studio.panels import export_progress
from avatarrex_studio.panels.export_dialog import ExportDialog
from avatarrex_studio.panels.questions import Question, Questions, nothing
from avatarrex_studio.session.clips import Clips
from avatarrex_studio.session.evaluation import state_at
from avatarrex_studio.session.notice import refusals_logged
from avatarrex_studio.session.state import StudioState

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is


class MotionFrames:
    """States along the timeline."""

    def __init__(self, state: StudioState, clips: Clips) -> None:
        self.count, self.own, self.fps = state.frames, state.timeline.frames, state.timeline.fps
        self._state, self._clips = state, clips

    def at(self, frame: int) -> StudioState:
        """The state at a frame. May be called by any thread."""
        return state_at(self._state, frame / self.fps, self._clips)


class Exports:
    """Whatever is exported from one window."""

    def __init__(self, studio: Studio, questions: Questions, make: Make) -> None:
        self.process, self.dialog = Exporting(make), ExportDialog()
        self._studio, self._questions = studio, questions
        self._thread = ThreadPoolExecutor(1, "export order")
        self._making: Future[Order] | None = None

    def open(self, viewport: tuple[int, int]) -> None:
        """Show the dialog for what is shown."""
        self.dialog.open(viewport, self._studio.state, self._frames())

    @property
    def busy(self) -> bool:
        """Whether something is exported."""
        return self._making is not None or self.process.busy

    @property
    def words(self) -> str:
        """What is under way, for the status bar; empty where nothing is."""
        progress = self.process.progress
        return "" if progress is None else f"exporting {progress.path.name}: {export_progress.words(progress)}"

    def draw(self, low: tuple[float, float], high: tuple[float, float]) -> None:
        """Draw dialog and progress, the latter into a rectangle of the screen; do what is due."""
        make = self.dialog.draw(self._studio.state, self._frames())
        if make is not None:
            self._making = self._thread.submit(make)
        if self._making is not None and self._making.done():
            making, self._making = self._making, None
            self._checked(making.result())
        self.process.poll()
        progress = self.process.progress
        if progress is not None and export_progress.draw(progress, low, high):
            self.process.cancel()

    def may_close(self, leave: Callable[[], None]) -> bool:
        """Whether the window can close; else a question is put, whose answer calls `leave`."""
        if not self.busy:
            return True
        answers = {"Wait for it": nothing, "Cancel it": leave}
        self._questions.put(
            Question("An export is at work", "Its file is not whole yet. Cancelled, nothing of it stays.", answers)
        )
        return False

    def close(self) -> None:
        """End it; no partial file stays."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        self.process.close()

    def _checked(self, order: Order) -> None:
        """Begin, after a question where a file is there; a refusal opens the dialog again."""
        try:
            there = [path for path in order.check() if what_is(path) == "a file"]
        except InputError as error:
            self.dialog.show(str(error))
            return
        if not there:
            self._start(order)
            return
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        answers = {"Overwrite": lambda: self._start(order), "Other name…": self.dialog.show, "Cancel": nothing}
        self._questions.put(Question("Overwrite the file?", f"{there[0]}{more} is there already.", answers))

    def _start(self, order: Order) -> None:
        with refusals_logged():
            self.process.start(order)

    def _frames(self) -> MotionFrames | None:
        state = self._studio.state
        moves = any(figure.timeline.layers for figure in state.figures)
        return MotionFrames(state, self._studio.clips) if moves else None
