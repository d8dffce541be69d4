"""What an ablation study found: a table, the differences that answer its questions, JSON, a plot.

Figures are means over held-out poses inside the matte, then mean ± standard deviation (n − 1) over seeds. Differences are
taken seed by seed. Spec: docs/ablations.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.measure.ablation.study import Study
from avatarrex.measure.ablation.variants import QUESTIONS, VARIANTS, Variant
from avatarrex.measure.plotting import axes_beside, save
from avatarrex.metrics.table import aligned

MEASURES = {
    "psnr_matte": ("PSNR", 2), "ssim_matte": ("SSIM", 3), "ms_ssim_matte": ("MS-SSIM", 3), "lpips_matte": ("LPIPS", 3),
    "iou": ("IoU", 3), "sharpness": ("sharpness", 2),
}  # fmt: skip
"""Heads and decimals."""
COSTS = {
    "parameters": ("M par.", 2), "file_mib": ("MiB", 1), "steps": ("steps", 0), "minutes": ("min", 1),
    "cpu_minutes": ("CPU min", 1), "samples_per_ray": ("samples/ray", 1), "seconds_per_picture": ("s/picture", 2),
    "cpu_seconds_per_picture": ("CPU s/picture", 2), "pictures": ("pictures", 0),
}  # fmt: skip
"""The same; `n/a` where there is no such cost, or none was counted yet when it was measured."""
Values = dict[str, list[float]]
"""By measure, one per seed."""
PLOTTED = ("psnr_matte", "ms_ssim_matte", "lpips_matte", "sharpness")


@dataclass
class Row:
    """A variant or a baseline: values by measure, one per seed."""

    name: str
    what: str
    seeds: list[int]
    values: Values
    same: Values = field(default_factory=dict)
    """Of the variant it redraws, on the same pictures."""


def rows(study: Study, variants: list[Variant], seeds: list[int]) -> list[Row]:
    """Baselines, then every variant of which a seed is done."""
    baselines = study.baselines()["subjects"]
    found = [Row(name, "baseline", [], _by_measure([means])) for name, means in baselines.items()]
    for variant in variants:
        done = {seed: data for seed in seeds if (data := study.evaluation(variant, seed)) is not None}
        if done:
            drawn = [list(data["subjects"].values()) for data in done.values()]
            values = _by_measure({**one[-1], **_costs(data)} for one, data in zip(drawn, done.values()))
            same = _by_measure(other for one in drawn for other in one[:-1])
            found.append(Row(variant.name, variant.what, list(done), values, same))
    return found


def _costs(data: dict[str, Any]) -> dict[str, float | None]:
    size = data.get("file_bytes")
    return {
        "parameters": data["parameters"] / 1e6,
        "file_mib": None if size is None else size / 2**20,
        "steps": sum(data["steps"]),
        "minutes": data["seconds"] / 60,
        "cpu_minutes": data["cpu_seconds"] / 60,
        "samples_per_ray": data["samples_per_ray"],
    }


def _by_measure(figures: Iterable[dict[str, float | None]]) -> Values:
    values: Values = {}
    for key, value in (item for one in figures for item in one.items()):
        if value is not None:
            values.setdefault(key, []).append(value)
    return values


@dataclass(frozen=True)
class Answer:
    """A question, and the first variant's figures minus the second's, one per seed."""

    question: str
    first: str
    second: str
    differences: Values


def answers(found: list[Row]) -> list[Answer]:
    """To every question of which both variants are there, over the seeds that both have."""
    by_name, given = {row.name: row for row in found}, []
    for question, first, second in QUESTIONS:
        if first in by_name and second in by_name:
            a, b = by_name[first], by_name[second]
            both = [seed for seed in a.seeds if seed in b.seeds]
            mine = b.same if VARIANTS[second].redraws == first else a.values
            seeds = b.seeds if VARIANTS[second].redraws == first else a.seeds
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
    seeds = ((row, str(len(row.seeds)) if row.seeds else "–") for row in found)
    text = _rows(("", "seeds"), MEASURES | COSTS, [(row.name, count, row.values) for row, count in seeds])
    if given := [(a.question, f"{a.first} − {a.second}", a.differences) for a in answers(found)]:
        text += ["", *_rows(("question", ""), MEASURES, given, "+")]
    baselines = study.baselines()
    width, height = baselines["size"]
    text += ["", f"{study.part} of {study.capture.path}, recipe {study.base.name}, {study.about['minutes'] or 'its'} "
                 f"{'minutes a variant' if study.minutes else 'steps'}; held-out frames {', '.join(map(str, baselines['frames']))} from "
                 f"{len(baselines['views'])} cameras at {width}x{height}, inside the matte"]  # fmt: skip
    text += [f"{name.upper()}: n/a (no weights: {files})" for name, files in baselines["missing"].items()]
    return "\n".join(text)


def _rows(
    heads: tuple[str, str], columns: dict[str, tuple[str, int]], found: list[tuple[str, str, Values]], sign: str = ""
) -> list[str]:
    """Lines of two words and of the values under `columns`."""
    lines = [[*heads, *(head for head, _ in columns.values())]]
    for name, what, values in found:
        lines.append([name, what, *(_cell(values.get(key), digits, sign) for key, (_, digits) in columns.items())])
    return aligned(lines, range(1, len(lines[0])))


def to_json(study: Study, found: list[Row], seeds: list[int]) -> dict[str, Any]:
    """Rows with every seed's figures, answers, and what was studied."""
    evaluations = {
        variant.name: {str(seed): data for seed in seeds if (data := study.evaluation(variant, seed)) is not None}
        for variant in VARIANTS.values()
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


def plot(found: list[Row], path: Path, title: str) -> Path:
    """One panel a measure, one line a variant: its seeds, their mean and standard deviation; baselines in grey."""
    shown = [key for key in PLOTTED if any(key in row.values for row in found)]
    axes, figure = axes_beside(len(shown), (3.2 * len(shown) + 1.6, 0.42 * len(found) + 1.5), sharey=True)
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
    return save(figure, path, 150)


def _means(values: Values) -> Values:
    """Mean and standard deviation by measure."""
    return {key: [float(np.mean(v)), _deviation(v)] for key, v in values.items() if v}


def _deviation(values: list[float]) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def _cell(values: list[float] | None, digits: int, sign: str = "") -> str:
    if not values:
        return "n/a"
    text = f"{np.mean(values):{sign}.{digits}f}"
    return f"{text} ± {_deviation(values):.{digits}f}" if len(values) > 1 and digits else text
