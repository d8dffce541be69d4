"""What an evaluation found: a table to read, JSON to keep (`assets_spec/metrics.json`), a contact sheet to look at."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont, ImageOps

from avatarrex.metrics.evaluate import Evaluation, split_of
from avatarrex.metrics.table import aligned

FORMAT = 1
COLUMNS = {
    "psnr": "PSNR", "psnr_matte": "in matte", "ssim": "SSIM", "ssim_matte": "in matte", "ms_ssim": "MS-SSIM",
    "ms_ssim_matte": "in matte", "lpips": "LPIPS", "lpips_matte": "in matte", "fid": "FID", "fid_matte": "in matte",
    "iou": "IoU", "sharpness": "sharpness",
}  # fmt: skip
DIGITS = {"psnr": 2, "psnr_matte": 2, "fid": 1, "fid_matte": 1}
"""Decimals; three where not said."""
PANEL, GAP, TITLE = 360, 6, 22
"""Pixels of the contact sheet: height of a panel, space between, height of a title."""
INK, PAPER = (32, 32, 32), (250, 250, 250)


def table(evaluation: Evaluation) -> str:
    """Means by split and subject, then surfaces, then what has no value and why."""
    lines = _aligned(
        ["split", "subject", "pictures", *COLUMNS.values()],
        evaluation.grouped("split"),
        lambda values: [str(values["pictures"]), *(_cell(values[key], DIGITS.get(key, 3)) for key in COLUMNS)],
    )
    if surfaces := evaluation.surface_means():
        heads = [f"{way} {head}" for way in ("to truth", "from truth") for head in ("mean mm", "p95 mm", "normals °")]
        lines += ["", *_aligned(["surface", "subject", *heads], surfaces, _distances)]
    names = {"lpips": "LPIPS", "fid": "FID"}
    lines += [f"{names[key]}: n/a (no weights: {files})" for key, files in evaluation.missing.items()]
    return "\n".join(lines)


def to_json(evaluation: Evaluation, avatar: str, capture: str, seconds: float) -> dict[str, Any]:
    """As `assets_spec/metrics.json` says; null where a measure has no value."""
    rig = evaluation.rig
    return {
        "format": FORMAT,
        "avatar": avatar,
        "capture": capture,
        "rig": rig.name,
        "size": list(evaluation.size),
        "frames": list(evaluation.frames),
        "views": [rig.views[view].name for view in evaluation.views],
        "held_out": {
            "frames": sorted(rig.held_out_frames),
            "views": [rig.views[view].name for view in sorted(rig.held_out_views)],
        },
        "missing": evaluation.missing,
        "splits": evaluation.grouped("split"),
        "by_view": evaluation.grouped("view"),
        "by_frame": {str(frame): found for frame, found in evaluation.grouped("frame").items()},
        "surface": evaluation.surface_means(),
        "surfaces": evaluation.surfaces,
        "pictures": [
            {key: getattr(picture, key) for key in ("subject", "view", "frame", "split")}
            | {key: value if math.isfinite(value) else None for key, value in picture.values.items()}
            for picture in evaluation.pictures
        ],
        "seconds": seconds,
    }


def contact_sheet(evaluation: Evaluation, across: int = 2) -> UInt8[np.ndarray, "h w 4"]:
    """The kept pictures, `across` to a row: ground truth, every subject, and the absolute difference of the first."""
    groups = [_group(evaluation, view, frame) for view, frame in sorted(evaluation.samples)]
    rows = [groups[k : k + across] for k in range(0, len(groups), across)]
    width = max(sum(g.width + 3 * GAP for g in row) for row in rows) + GAP
    sheet = Image.new("RGB", (width, len(rows) * (groups[0].height + 2 * GAP) + GAP), PAPER)
    for number, row in enumerate(rows):
        left = GAP
        for group in row:
            sheet.paste(group, (left, GAP + number * (group.height + 2 * GAP)))
            left += group.width + 3 * GAP
    return np.dstack([np.asarray(sheet), np.full((sheet.height, sheet.width), 255, np.uint8)])


def _group(evaluation: Evaluation, view: int, frame: int) -> Image.Image:
    """One picture's panels under a line that says which it is."""
    images, rig = evaluation.samples[view, frame], evaluation.rig
    low, high = _box(images)
    panels = {"ground truth": images["truth"], **{name: image for name, image in images.items() if name != "truth"}}
    first = next(name for name in images if name != "truth")
    panels["difference" if len(panels) == 2 else f"{first}'s difference"] = np.abs(
        images[first][..., :3] - images["truth"][..., :3]
    )
    scale = PANEL / (high[0] - low[0])
    width = max(round((high[1] - low[1]) * scale), 124)
    group = Image.new("RGB", (len(panels) * (width + GAP) - GAP, PANEL + 2 * TITLE), PAPER)
    draw, font = ImageDraw.Draw(group), ImageFont.load_default(13)
    value = next(
        picture.values["psnr_matte"]
        for picture in evaluation.pictures
        if (picture.subject, picture.view, picture.frame) == (first, rig.views[view].name, frame)
    )
    title = f"frame {frame}, camera {rig.views[view].name}, {split_of(rig, view, frame)}: {value:.1f} dB in the matte"
    draw.text((0, 2), title, INK, font)
    for number, (name, image) in enumerate(panels.items()):
        left = number * (width + GAP)
        part = image[low[0] : high[0], low[1] : high[1], :3]
        picture = Image.fromarray(np.rint(255 * np.clip(part, 0, 1)).astype(np.uint8))
        group.paste(ImageOps.pad(picture, (width, PANEL), Image.Resampling.LANCZOS), (left, 2 * TITLE))
        draw.text((left, TITLE), name, INK, font)
    return group


def _box(images: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(row, column) bounds of everything that is covered in any picture, with a margin."""
    covered = np.max([image[..., 3] for image in images.values()], axis=0) > 0.05
    size = np.array(covered.shape)
    if not covered.any():
        return np.zeros(2, int), size
    place = np.argwhere(covered)
    margin = int(0.03 * size.max()) + 1
    return np.maximum(place.min(0) - margin, 0), np.minimum(place.max(0) + 1 + margin, size)


def _cell(value: float | None, digits: int) -> str:
    return "n/a" if value is None else f"{value:.{digits}f}"


def _distances(ways: dict[str, dict[str, float]]) -> list[str]:
    return [f"{value:.2f}" for way in ("to_truth", "from_truth") for value in ways[way].values()]


def _aligned(head: list[str], found: Mapping[str, Mapping[str, Any]], cells: Callable[[Any], list[str]]) -> list[str]:
    """A row for each split and subject, the split named once; words to the left, numbers to the right."""
    rows = [head]
    for split, subjects in found.items():
        for number, (subject, values) in enumerate(subjects.items()):
            rows.append(["" if number else split, subject, *cells(values)])
    return aligned(rows, right=range(2, len(head)))
