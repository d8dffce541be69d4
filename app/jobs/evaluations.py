"""What `evaluate` found about the avatars of runs, as rows to compare. A run keeps it in `RUN/evaluations/NAME.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avatarrex_studio.jobs.run_view import RunView
from avatarrex_studio.jobs.task import Task

from avatarrex.errors import InputError
from avatarrex.files.json_text import SMALL, read_json

FOLDER = "evaluations"
MEASURES = {
    "psnr_matte": ("PSNR", "{:.2f}"),
    "ssim_matte": ("SSIM", "{:.3f}"),
    "iou": ("IoU", "{:.3f}"),
    "sharpness": ("Sharp", "{:.2f}"),
}
"""Name and form of what is compared, by key of the file; inside the matte, of the test's pictures."""


@dataclass(frozen=True)
class Row:
    """One subject of one evaluation."""

    run: str
    step: str
    """Of the checkpoint."""
    subject: str
    """`avatar`, or a baseline."""
    values: Mapping[str, str]
    """As text by the names in `MEASURES`; an en dash where there is none."""
    pictures: int


def evaluating(view: RunView, avatar: Path, baselines: bool) -> Task:
    """The task that evaluates an avatar of a run against the capture that it was trained on, on what was kept from training."""
    folder, name = view.path / FOLDER, avatar.stem
    words = [
        "evaluate", str(avatar), str(view.about.get("capture") or ""), "--frames", "held-out", "--json", str(folder / f"{name}.json"),
        "--sheet", str(folder / f"{name}.png"), *(["--baselines"] if baselines else []),
    ]  # fmt: skip
    return Task(f"Evaluate {view.name}", tuple(words), folder / f"{name}.log", (folder / f"{name}.png",))


class Evaluations:
    """Rows of files, each read once as long as it does not change."""

    def __init__(self) -> None:
        self._rows: dict[Path, tuple[int, tuple[Row, ...]]] = {}

    def of(self, view: RunView) -> tuple[Row, ...]:
        """The rows of a run, by checkpoint."""
        try:
            files = sorted((view.path / FOLDER).glob("*.json"))
            return tuple(row for file in files for row in self._read(file, view.name, file.stat().st_mtime_ns))
        except OSError:
            return ()

    def _read(self, file: Path, run: str, changed: int) -> tuple[Row, ...]:
        known = self._rows.get(file)
        if known is None or known[0] != changed:
            try:
                rows = rows_of(read_json(file, "an evaluation", SMALL), run, file.stem)
            except (InputError, TypeError, AttributeError, KeyError, ValueError):  # being written, or no evaluation
                rows = ()
            self._rows[file] = known = changed, rows
        return known[1]


def rows_of(data: Any, run: str, name: str) -> tuple[Row, ...]:
    """A row for each subject of an evaluation: the means over the test's pictures, else over all of the first split there is."""
    splits = data["splits"]
    subjects = splits.get("test") or next(iter(splits.values()))
    step = name.removeprefix("step_").lstrip("0") or "0"
    return tuple(
        Row(
            run,
            step,
            subject,
            {title: _text(form, means.get(key)) for key, (title, form) in MEASURES.items()},
            int(means["pictures"]),
        )
        for subject, means in subjects.items()
    )


def _text(form: str, value: object) -> str:
    return form.format(value) if isinstance(value, int | float) else "–"
