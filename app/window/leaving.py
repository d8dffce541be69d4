"""Before the window closes: what becomes of unsaved work and of trainings; after a crash: what becomes of the work that was kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.jobs.training_process import TrainingProcesses
from avatarrex_studio.panels.questions import Question, Questions, nothing
from avatarrex_studio.session.autosave import Autosave, Recovery
from avatarrex_studio.session.notice import refusals_logged


class Leaving:
    """Puts the questions and does what their answers say."""

    def __init__(self, studio: Studio, processes: TrainingProcesses, questions: Questions, autosave: Autosave) -> None:
        self._studio, self._processes, self._questions, self._autosave = studio, processes, questions, autosave

    def now(self, save: Callable[[Callable[[], None]], None], leave: Callable[[], None]) -> bool:
        """Whether the window can close at once; else a question is put, whose answer calls `leave`. `save` writes the session and calls
        what it is given once it is written.
        """
        if not self.saved(save, lambda: self._trainings(leave)):
            return False
        if self._processes.paths:
            self._trainings(leave)
            return False
        return True

    def saved(self, save: Callable[[Callable[[], None]], None], then: Callable[[], None]) -> bool:
        """Whether the session has no unsaved work; else a question is put, whose answer calls `then`. `save` as for `now`."""
        if not self._studio.journal.unsaved:
            return True
        name = Path(self._studio.journal.path or "This session").name
        answers = {"Save": lambda: save(then), "Discard": then, "Cancel": nothing}
        self._questions.put(Question("Save your work?", f"{name} has changes that are not saved.", answers))
        return False

    def offer(self) -> None:
        """Put a question for the newest session that a crash left behind."""
        found = self._autosave.found()
        if not found:
            return
        recovery = found[0]
        answers = {"Recover": lambda: self._recover(recovery), "Discard": recovery.discard, "Later": nothing}
        text = f"The studio ended without saving. Your work of {recovery.when} was kept."
        self._questions.put(Question("Recover your work?", text, answers))

    def _recover(self, recovery: Recovery) -> None:
        with refusals_logged(opening=recovery.file):
            self._studio.go_on(recovery.read())
            recovery.file.replace(self._autosave.file)

    def _trainings(self, leave: Callable[[], None]) -> None:
        paths = self._processes.paths
        if not paths:
            leave()
            return

        def stop() -> None:
            for path in paths:
                self._processes.stop(path)
            leave()

        names = ", ".join(path.name for path in paths)
        text = (
            f"At work: {names}. It can go on without this window; `avatarrex-studio runs` shows it. "
            "Stopped, it saves first and can be continued."
        )
        answers = {"Let it go on": leave, "Stop it": stop, "Cancel": nothing}
        self._questions.put(Question("A training is running", text, answers))
