"""What a picture did not need, and why: a counter that reads zero, and the pipeline's stage that did not run.

The pipeline does a work whenever its key changes and the part is drawn, but for what a drag hardly moves at `fast`; so the
counters, the hidden parts and whether the picture lags tell the reason.
"""

from __future__ import annotations

from avatarrex_studio.engine.work import Work

WORK = {
    "templates": "templates_posed",
    "body": "voxels_evaluated",
    "hands": "hand_distances",
    "face": "face_evaluations",
    "U-Nets": "unet_runs",
    "patches": "patches_decoded",
    "rays": "rays",
    "colour": "pixels_shaded",
}
"""What a picture may skip, and the counter that then reads zero."""


def skipped(work: Work) -> dict[str, str]:
    """Names of the work that the picture did not need, each with the reason."""
    return {name: _reason(name, work) for name, counter in WORK.items() if not work.counters[counter]}


def _reason(name: str, work: Work) -> str:
    if name == "hands" and (absent := _absent_hands(work)):
        return absent
    if name in ("face", "U-Nets") and (absent := _absence("face", work)):
        return f"face {absent}: no box"
    cast, shaded = work.counters["rays"], work.counters["pixels_shaded"]
    if work.lags and name in _WITHIN_TOLERANCE and (name == "body" or cast):
        return _WITHIN_TOLERANCE[name]
    if name == "colour" and cast:
        return "no pixel is covered"
    if name == "patches" and cast and not work.counters["body_pixels"]:
        return "no pixel of the body in view" if shaded else "no pixel is covered"
    return _UNCHANGED[name]


def _absent_hands(work: Work) -> str:
    """Which hands have no box and why; empty where both have one."""
    why = [_absence(f"{side}_hand", work) for side in ("left", "right")]
    if all(why):
        return f"both hands {' or '.join(sorted(set(why)))}: no boxes"
    if any(why):
        return f"{'left' if not why[0] else 'right'} hand unchanged, the other {why[0] or why[1]}: box kept"
    return ""


def _absence(part: str, work: Work) -> str:
    return "hidden" if part in work.hidden else "out of sight" if part in work.unseen else ""


_UNCHANGED = {
    "templates": "poses and shape unchanged: meshes kept",
    "body": "body pose unchanged: body voxels kept",
    "hands": "hand poses unchanged: boxes kept",
    "face": "expression unchanged: face box kept",
    "U-Nets": "expression unchanged: planes kept",
    "patches": "body pose unchanged: feature patches of the nodes in sight kept",
    "rays": "volume and camera unchanged: point map kept",
    "colour": "point map unchanged: colours kept",
}

_WITHIN_TOLERANCE = {
    "body": "moved by less than a millimetre: body voxels kept",
    "patches": "hardly another pose here: feature patches kept",
    "colour": "nothing in sight moved: colours kept",
}
