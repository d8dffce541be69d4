"""Test figures of a subject, as `release_figures.py` keeps them, as the tables of docs/results.md."""

from __future__ import annotations

from typing import Any

Figures = dict[str, Any]
Column = tuple[str, str, int]
"""Head, measure, decimals."""

SPLITS = {"held-out pose": "pose", "held-out both": "pose and camera"}
FACED, FINE, FITTED = "fitted mesh, own face", "fitted mesh, fine texels", "fitted textured mesh"
BODY: tuple[Column, ...] = (
    ("PSNR", "psnr_matte", 2), ("SSIM", "ssim_matte", 3), ("MS-SSIM", "ms_ssim_matte", 3), ("IoU", "iou", 3), ("sharpness", "sharpness", 2),
)  # fmt: skip
FACE: tuple[Column, ...] = (
    ("PSNR, whole", "psnr", 2), ("PSNR, matte", "psnr_matte", 2), ("SSIM, whole", "ssim", 3), ("SSIM, matte", "ssim_matte", 3),
    ("MS-SSIM, whole", "ms_ssim", 3), ("IoU", "iou", 3), ("sharpness", "sharpness", 2),
)  # fmt: skip
PARTS = {
    "body": ("Body, in the matte", BODY),
    "face": ("Face rig: whole pictures, hair, neck and collar with them", FACE),
    "face_alone": ("The face alone: all cut by where the fitted face is seen", FACE),
}


def tables(figures: Figures) -> str:
    """Commands, a table for each kind of pictures, and margins."""
    commands = "\n".join(f"    {command}" for command in figures["commands"])
    heading = (
        f"Trained by commit {figures['trained_by']}, seed {figures['seed']}, {figures['training_minutes']} minutes of the wall; "
        f"{figures['machine']}; {figures['date']}."
    )
    parts = [_table(figures["test"][part], *PARTS[part]) for part in PARTS]
    heading = f"{heading}\n\n{splits(figures)}"
    if figures["regions"]:
        parts.append(_regions(figures["regions"]))
    return "\n\n".join([heading, commands, *parts, margins(figures["test"]), lost(figures["test"]["body"])])


def splits(figures: Figures) -> str:
    """What the training could not read, and of which capture."""
    kept = []
    for rig, found in sorted(figures["splits"].items()):
        cameras = ", ".join(found["test"]["cameras"]) or "none"
        kept.append(
            f"{rig} rig, test frames {found['test']['frames']} and cameras {cameras}, validation frames {found['validation']['frames']}"
        )
    return f"Kept from training: {'; '.join(kept)} (A:B is without B; capture key {figures['capture_key']})."


def _table(found: Figures, title: str, columns: tuple[Column, ...]) -> str:
    """A row for each split and subject; surfaces where the capture has meshes."""
    last = ["surface, mm"] if found["surface"] else []
    heads = ["held out", "pictures", "", *(head for head, _, _ in columns), *last]
    rows = [heads, ["---"] * len(heads)]
    for split, word in SPLITS.items():
        for subject, values in found["splits"].get(split, {}).items():
            cells = [_number(values[measure], digits) for _, measure, digits in columns]
            cells[0] = f"**{cells[0]}**" if subject == "avatar" else cells[0]
            off = [_surface(found["surface"].get(split, {}), subject)] if last else []
            rows.append([word, str(values["pictures"]), subject, *cells, *off])
    return f"{title}:\n\n" + _lines(rows)


def _regions(found: Figures) -> str:
    """Where cameras of the face rig see eyes, mouth and face: PSNR, SSIM, sharpness."""
    pictures = found["pictures"]
    rows = [["", *(f"{region}: PSNR | SSIM | sharpness" for region in pictures)], ["---"] * (3 * len(pictures) + 1)]
    for subject in next(iter(pictures.values())):
        cells = [
            _number(values[subject][measure], digits)
            for values in pictures.values()
            for measure, digits in (("psnr", 2), ("ssim", 3), ("sharpness", 2))
        ]
        rows.append([subject, *cells])
    count = next(iter(next(iter(pictures.values())).values()))["pictures"]
    seen = f"By regions, where cameras of the face rig see them (`face-regions`, {count} held-out pictures):"
    return f"{seen}\n\n{_lines(rows)}"


def _lines(rows: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _surface(found: Figures, subject: str) -> str:
    """Mean / 95th percentile of the distance to the captured mesh."""
    return "{mean_mm:.1f} / {p95_mm:.1f}".format(**found[subject]["to_truth"]) if subject in found else ""


def _number(value: float | None, digits: int) -> str:
    return "n/a" if value is None else f"{value:.{digits}f}"


def _over(found: Figures, split: str, measure: str, rival: str) -> str:
    """Decibels that the avatar is above a rival."""
    values = found["splits"].get(split, {})
    if rival not in values:
        return ""
    return f"{values['avatar'][measure] - values[rival][measure]:+.2f}".replace("-", "−")


def margins(test: Figures) -> str:
    """What the avatar is above the meshes, decibels."""
    pose, both = SPLITS
    kinds = [
        ("pose", "body", pose, "psnr_matte", FITTED), ("pose and camera", "body", both, "psnr_matte", FITTED),
        ("face rig, whole", "face", pose, "psnr", FINE), ("… matte", "face", pose, "psnr_matte", FINE),
        ("face alone, whole", "face_alone", pose, "psnr", FINE), ("… matte", "face_alone", pose, "psnr_matte", FINE),
    ]  # fmt: skip
    rows = [["over", *(kind[0] for kind in kinds)], ["---"] * (len(kinds) + 1)]
    own = [_over(test[part], split, measure, FACED) for _, part, split, measure, _ in kinds]
    frozen = [_over(test[part], split, measure, rival) for _, part, split, measure, rival in kinds]
    rows += [
        [FACED, *own],
        [f"{FITTED}, of the face fine texels", *frozen],
        ["wanted over the second", "+3", "+2", "+2", "", "+2", ""],
    ]
    return "**Margins**, dB:\n\n" + _lines(rows)


def lost(body: Figures) -> str:
    """What cameras that were held out cost, of held-out poses, decibels; empty where none was."""
    pose, both = (body["splits"].get(split, {}) for split in SPLITS)
    costs = {name: pose[name]["psnr_matte"] - both[name]["psnr_matte"] for name in ("avatar", FITTED) if name in both}
    listed = ", ".join(f"{name} {cost:.2f} dB".replace("-", "−") for name, cost in costs.items())
    return listed and f"Lost at cameras that were held out, against the trained ones in the same poses: {listed}."


def written(page: str, name: str, block: str) -> str:
    """`page` with what stands between the marks of a subject replaced. Raises `ValueError` where they are not there once."""
    begin, end = (f"<!-- {slash}figures {name} -->\n" for slash in ("", "/"))
    if page.count(begin) != 1 or page.count(end) != 1:
        raise ValueError(f"docs/results.md: expected the marks {begin.strip()} and {end.strip()} once")
    before, rest = page.split(begin)
    return before + begin + "\n" + block + "\n\n" + end + rest.split(end)[1]
