"""Package: a trained avatar as one that is given away, its held-out figures and its cost beside the weights.

    python -m avatarrex.training.package AVATAR METRICS.json OUT.avatar --name default --cost "2 h on 2 cores"

`METRICS.json`: of `avatarrex-studio evaluate AVATAR CAPTURE --baselines --json METRICS.json`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from avatarrex.avatar import load_avatar, save_avatar
from avatarrex.errors import InputError
from avatarrex.files import read_json

TERMS = {
    "licence": "weights Apache-2.0; template from MakeHuman data, CC0 (see NOTICE)",
    "consent": "synthetic person; no real person is depicted",
}
"""Of the studio's own synthetic capture."""


def package(source: Path, figures: Path, target: Path, name: str, cost: str) -> None:
    """Write the trained avatar `source` as `target`. Raises `InputError` where the figures are another avatar's."""
    avatar = load_avatar(source)
    if "training" not in avatar.meta:
        raise InputError(source, "avatar.json: training", "an avatar trained from images", avatar.meta.get("origin"))
    if avatar.person.fit is not None:
        raise InputError(source, "avatar.json: person_fit", "the studio's own person", avatar.person.name)
    found = read_json(figures)
    if Path(str(found.get("avatar"))).resolve() != source.resolve():
        raise InputError(figures, "avatar", str(source), found.get("avatar"))
    avatar.meta |= {"name": name, "cost": cost, "held_out": held_out(found), **TERMS}
    save_avatar(avatar, target)


def held_out(found: dict[str, Any]) -> dict[str, Any]:
    """Of an evaluation's JSON what was not trained on: means by split and subject, and distances to the true surface."""
    figures = {
        part: {split: subjects for split, subjects in found[part].items() if split.startswith("held-out")}
        for part in ("splits", "surface")
    }
    return {"capture": Path(found["capture"]).name, "frames": found["frames"], "views": found["views"], **figures}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("avatar", type=Path, help="a training's avatar")
    parser.add_argument("figures", type=Path, help="of `evaluate --json`")
    parser.add_argument("out", type=Path, help="OUT.avatar")
    parser.add_argument("--name", required=True)
    parser.add_argument("--cost", required=True, help="time and machine that the training took")
    options = parser.parse_args()
    package(options.avatar, options.figures, options.out, options.name, options.cost)


if __name__ == "__main__":
    main()
