"""How far a distillation is, as one bar of text after the other."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

from tqdm import tqdm


class ProgressBars:
    """What `distil` takes as `progress`, on the terminal or in a log; `then` is told the same before."""

    def __init__(self, then: Callable[[str, int, int], None] | None = None) -> None:
        self._then = then
        self._bar: tqdm[None] | None = None
        self._what = ""

    def __call__(self, what: str, done: int, of: int) -> None:
        """`done` of `of` steps of `what`; another `what` than before says that all steps of that one are done."""
        if self._then is not None:
            self._then(what, done, of)
        if what != self._what:
            self._finish()
            self._what, self._bar = what, tqdm(total=of, desc=f"surface: {what}")
        if self._bar is not None:
            self._bar.update(done - self._bar.n)

    def __enter__(self) -> ProgressBars:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the bar; a full one only where the work has ended well."""
        if error is None:
            self._finish()
        elif self._bar is not None:
            self._bar.close()

    def _finish(self) -> None:
        if self._bar is not None:
            self._bar.update((self._bar.total or 0) - self._bar.n)
            self._bar.close()
