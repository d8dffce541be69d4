"""Contact sheets of the library at level `live`: every entry from three sides, with its name.

    python tools/library_sheet.py OUT_DIR [--kind poses] [--names kneel,think] [--avatar default] [--side 220]

`--kind`: poses, hands, expressions; all unless one is named.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from avatarrex_studio.engine.framing import Outline, framed
from avatarrex_studio.session.commands import ApplyPose
from avatarrex_studio.session.state import OrbitView, StudioState
from avatarrex_studio.sheets.paper import Group, Tile, laid_out, over, sheet_width

from avatarrex import levels
from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.live import render_live
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import EXPRESSIONS, HANDS, POSES, named_expression, named_hand, named_pose
from avatarrex.templates.model import pose_by_signals

SIDES = {"poses": (0.0, 55.0, -90.0), "expressions": (0.0, 40.0, 85.0), "hands": (0.0, 90.0, 180.0)}
"""Azimuths of the three views."""
NAMES = {"poses": POSES, "hands": HANDS, "expressions": EXPRESSIONS}
ACROSS = {"poses": 3, "hands": 3, "expressions": 3}
"""Entries in a row."""


def signals(kind: str, name: str) -> Signals:
    """What an entry looks like on a person who stands at ease."""
    hands = {f"{side}_hand_pose": named_hand("relaxed", side) for side in ("left", "right")}
    standing = Signals.rest().replace(body_pose=named_pose("stand"), **hands)
    if kind == "poses":
        return ApplyPose(name).apply(StudioState(signals=standing)).signals
    if kind == "expressions":
        return standing.replace(expression=named_expression(name))
    return Signals.rest().replace(left_hand_pose=named_hand(name, "left"), right_hand_pose=named_hand(name, "right"))


def points(avatar: Avatar, kind: str, driven: Signals) -> np.ndarray:
    """World points to be framed."""
    body = avatar.person.body
    if kind == "poses":
        return Outline(body).points(driven)
    vertices = pose_by_signals(body, driven).vertices.double().numpy()
    owner = body.weights.argmax(1).numpy()
    return vertices[
        np.isin(owner, (15, 22, 23, 24))
        if kind == "expressions"
        else (owner == 20) | (owner // 15 == 5) | np.isin(owner, range(25, 40))
    ]


def tiles(avatar: Avatar, kind: str, names: Iterable[str], side: int) -> Iterable[Group]:
    """Three pictures of each entry."""
    settings = levels.level("live")
    for name in names:
        driven = signals(kind, name)
        around = points(avatar, kind, driven)
        group = []
        for azimuth in SIDES[kind]:
            elevation = 80 - azimuth if kind == "hands" else 0.0
            view = OrbitView(0.0 if kind == "hands" else azimuth, float(np.clip(elevation, -80, 80)), fov=22.0)
            view = framed(view, around, (side, side))
            picture = render_live(avatar, driven, view.camera(side, side), settings).image.numpy()
            group.append(Tile(over(picture), name if azimuth == SIDES[kind][1] else ""))
        yield group


def main() -> None:
    """Write the sheets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--kind", choices=NAMES)
    parser.add_argument("--names")
    parser.add_argument("--avatar", default="default")
    parser.add_argument("--side", type=int, default=220)
    options = parser.parse_args()
    avatar = load_avatar(options.avatar)
    for kind in [options.kind] if options.kind else NAMES:
        names = options.names.split(",") if options.names else list(NAMES[kind])
        groups = list(tiles(avatar, kind, names, options.side))
        across = ACROSS[kind]
        rows = [groups[first : first + across] for first in range(0, len(groups), across)]
        sheet = laid_out(
            f"{kind} of the library", f"{options.avatar}, level live", rows, sheet_width(across, 3, options.side)
        )
        options.out.mkdir(parents=True, exist_ok=True)
        sheet.save(options.out / f"{kind}.png")


if __name__ == "__main__":
    main()
