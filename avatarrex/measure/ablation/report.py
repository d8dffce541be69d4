"""What an ablation study found: a table, the differences that answer its questions, JSON, a plot.

Figures are means over held-out poses inside the matte, then mean ± standard deviation (n − 1) over seeds. Differences are
taken seed by seed. Spec: docs/ablations.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.gate import written
from avatarrex.measure.ablation.study import Study
from avatarrex.measure.ablation.variants import ARMS, QUESTIONS, Arm

MEASURES = {
    "psnr_matte": ("PSNR", 2), "ssim_matte": ("SSIM", 3), "ms_ssim_matte": ("MS-SSIM", 3), "lpips_matte": ("LPIPS", 3),
    "iou": ("IoU", 3), "sharpness": ("sharpness", 2),
}  # fmt: skip
"""Heads and decimals."""
COSTS = {
    "parameters": ("M par.", 2), "steps": ("steps", 0), "minutes": ("min", 1), "cpu_minutes": ("CPU min", 1),
    "samples_per_ray": ("samples/ray", 1), "seconds_per_picture": ("s/picture", 2), "pictures": ("pictures", 0),
}  # fmt: skip
PLOTTED = ("psnr_matte", "ms_ssim_matte", "lpips_matte", "sharpness")


@dataclass
class Row:
    """An arm or a baseline: values by measure, one per seed."""

    name: str
    what: str
    seeds: list[int]
    values: dict[str, list[float]] = field(default_factory=dict)
    same: dict[str, list[float]] = field(default_factory=dict)
    """Of the arm it redraws, on the same pictures."""


def rows(study: Study, arms: list[Arm], seeds: list[int]) -> list[Row]:
    """Baselines, then every arm of which a seed is done."""
    found = []
    for name, means in study.baselines()["subjects"].items():
        found.append(Row(name, "baseline", [], {key: [value] for key, value in means.items() if value is not None}))
    for arm in arms:
        done = {seed: data for seed in seeds if (data := study.evaluation(arm, seed)) is not None}
        if done:
            row = Row(arm.name, arm.what, list(done))
            for data in done.values():
                *before, means = data["subjects"].values()
                _add(row.values, {**means, **_costs(data)})
                for other in before:
                    _add(row.same, other)
            found.append(row)
    return found


def _costs(data: dict[str, Any]) -> dict[str, float | None]:
    return {
        "parameters": data["parameters"] / 1e6,
        "steps": sum(data["steps"]),
        "minutes": data["seconds"] / 60,
        "cpu_minutes": data["cpu_seconds"] / 60,
        "samples_per_ray": data["samples_per_ray"],
    }


def _add(values: dict[str, list[float]], more: dict[str, float | None]) -> None:
    for key, value in more.items():
        if value is not None:
            values.setdefault(key, []).append(value)


@dataclass(frozen=True)
class Answer:
    """A question, and the first arm's figures minus the second's, one per seed."""

    question: str
    first: str
    second: str
    differences: dict[str, list[float]]


def answers(found: list[Row]) -> list[Answer]:
    """To every question whose two arms are there, over the seeds that both have."""
    by_name, given = {row.name: row for row in found}, []
    for question, first, second in QUESTIONS:
        if first in by_name and second in by_name:
            a, b = by_name[first], by_name[second]
            both = [seed for seed in a.seeds if seed in b.seeds]
            mine = b.same if ARMS[second].redraws == first else a.values
            seeds = b.seeds if ARMS[second].redraws == first else a.seeds
            differences = {
                key: [mine[key][seeds.index(seed)] - b.values[key][b.seeds.index(seed)] for seed in both]
                for key in MEASURES
                if len(mine.get(key, ())) == len(seeds) and len(b.values.get(key, ())) == len(b.seeds)
            }
            if both:
                given.append(Answer(question, first, second, differences))
    return given


def table(study: Study, found: list[Row]) -> str:
    """Everything, to read."""
    columns = MEASURES | COSTS
    lines = [["", "seeds", *(head for head, _ in columns.values())]]
    for row in found:
        seeds = str(len(row.seeds)) if row.seeds else "–"
        lines.append([row.name, seeds, *(_cell(row.values.get(key), digits) for key, (_, digits) in columns.items())])
    text = _aligned(lines)
    given = answers(found)
    if given:
        heads = [["question", "", *(head for head, _ in MEASURES.values())]]
        differences = [
            [a.question, f"{a.first} − {a.second}",
             *(_cell(a.differences.get(key), digits, "+") for key, (_, digits) in MEASURES.items())]
            for a in given
        ]  # fmt: skip
        text += ["", *_aligned([*heads, *differences])]
    baselines = study.baselines()
    width, height = baselines["size"]
    text += ["", f"{study.part} of {study.capture.path}, recipe {study.base.name}, {study.about['minutes'] or 'its'} "
                 f"{'minutes an arm' if study.minutes else 'steps'}; held-out frames {_listed(baselines['frames'])} from "
                 f"{len(baselines['views'])} cameras at {width}x{height}, inside the matte"]  # fmt: skip
    text += [f"{name.upper()}: n/a (no weights: {files})" for name, files in baselines["missing"].items()]
    return "\n".join(text)


def to_json(study: Study, found: list[Row], seeds: list[int]) -> dict[str, Any]:
    """Rows with every seed's figures, answers, and what was studied."""
    evaluations = {
        arm.name: {str(seed): data for seed in seeds if (data := study.evaluation(arm, seed)) is not None}
        for arm in ARMS.values()
    }
    return {
        **study.about,
        "rows": [
            {"name": row.name, "what": row.what, "seeds": row.seeds, "values": row.values, "mean": _means(row.values)}
            for row in found
        ],
        "answers": [{**vars(answer), "mean": _means(answer.differences)} for answer in answers(found)],
        "evaluations": {name: data for name, data in evaluations.items() if data},
        "baselines": study.baselines(),
    }


def plot(found: list[Row], path: Path, title: str) -> None:
    """One panel a measure, one line an arm: its seeds, their mean and standard deviation; baselines in grey."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("--plot", "", "matplotlib: pip install 'avatarrex-studio[bench]'", "none") from None
    shown = [key for key in PLOTTED if any(key in row.values for row in found)]
    figure = Figure(figsize=(3.2 * len(shown) + 1.6, 0.42 * len(found) + 1.5), layout="constrained")
    axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    for axis, key in zip(axes, shown):
        for place, row in enumerate(found):
            values = row.values.get(key)
            if values:
                colour = "0.55" if not row.seeds else "tab:blue"
                axis.errorbar(np.mean(values), place, xerr=_deviation(values), fmt="o", color=colour, capsize=3)
                axis.plot(values, [place] * len(values), "|", color=colour, alpha=0.6)
        axis.set_title(MEASURES[key][0], fontsize=10)
        axis.grid(axis="x", alpha=0.3)
        axis.tick_params(labelsize=9)
    axes[0].set_yticks(range(len(found)), [row.name for row in found])
    axes[0].set_ylim(len(found) - 0.5, -0.5)
    figure.suptitle(title, fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    with written(path) as temporary:
        figure.savefig(temporary, dpi=150, format="png")


def _means(values: dict[str, list[float]]) -> dict[str, list[float]]:
    """Mean and standard deviation by measure."""
    return {key: [float(np.mean(v)), _deviation(v)] for key, v in values.items() if v}


def _deviation(values: list[float]) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def _cell(values: list[float] | None, digits: int, sign: str = "") -> str:
    if not values:
        return "n/a"
    text = f"{np.mean(values):{sign}.{digits}f}"
    return f"{text} ± {_deviation(values):.{digits}f}" if len(values) > 1 and digits else text


def _listed(frames: list[int]) -> str:
    return ", ".join(map(str, frames))


def _aligned(lines: list[list[str]]) -> list[str]:
    """Words to the left, figures to the right."""
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return [
        "  ".join(c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(line, widths))).rstrip()
        for line in lines
    ]
