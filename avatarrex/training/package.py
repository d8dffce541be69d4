"""Package: the avatar of a finished training as one that is given away, its held-out figures and its cost beside the weights.

    python -m avatarrex.training.package RUN METRICS.json OUT.avatar --name default --cost "2 h on 2 cores"

`METRICS.json`: of `avatarrex-studio evaluate RUN/checkpoints/step_…/avatar.avatar CAPTURE --baselines --json METRICS.json`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.files.json_text import read_json
from avatarrex.training.runs.folder import read_about

TERMS: dict[str, Any] = {
    "licence": "weights Apache-2.0; template from MakeHuman data, CC0 (see NOTICE)",
    "consent": "synthetic person; no real person is depicted",
    "authors": ["AvatarReX Studio"],
    "allowed_use": {
        "avatarPermission": "everyone",
        "commercialUsage": "corporation",
        "creditNotation": "required",
        "modification": "allowModificationRedistribution",
        "allowRedistribution": True,
    },
}
"""Of the studio's own synthetic capture. The uses are what Apache-2.0 grants, its notice kept; on violent, sexual, political or
hateful content it says nothing, and nothing is stated."""
FIELDS = ("avatar", "capture", "rig", "frames", "views", "held_out", "splits", "surface")
"""Of an evaluation's JSON that are read here."""


def package(run: Path, figures: Path, target: Path, name: str, cost: str) -> None:
    """Write the last avatar of `run` as `target`. Raises `InputError`: the run is to be finished, its person the studio's
    own, and the figures those of this avatar, on the capture, frames and cameras that the run held out."""
    about = read_about(run)
    if about["state"] != "finished":
        raise InputError(run, "run.json: state", "a finished training", about["state"])
    source = max(run.glob("checkpoints/step_*/avatar.avatar"), default=None)
    if source is None:
        raise InputError(run, "checkpoints", "a checkpoint with an avatar", "none")
    avatar, found = load_avatar(source), _checked(figures, source, about["config"])
    if not avatar.person.packaged:
        raise InputError(source, "avatar.json: person_fit", "the studio's own person", avatar.person.name)
    avatar.meta |= {"name": name, "cost": cost, "held_out": found, **TERMS}
    save_avatar(avatar, target)


def _checked(figures: Path, source: Path, config: dict[str, Any]) -> dict[str, Any]:
    """Of the figures those of what the run held out: means by split and subject, and distances to the true surface."""
    found = read_json(figures)
    for key in FIELDS:
        if not isinstance(found, dict) or key not in found:
            raise InputError(figures, key, "a field that `evaluate --json` writes", "nothing")
    for key, wanted in (("avatar", source), ("capture", Path(config["capture"]))):
        if Path(str(found[key])).resolve() != wanted.resolve():
            raise InputError(figures, key, str(wanted), found[key])
    kept, rig = config["held_out"][found["rig"]], open_capture(config["capture"]).rigs[found["rig"]]
    held_out = {"frames": kept["frames"], "views": [rig.views[view].name for view in kept["views"]]}
    if found["held_out"] != held_out:
        raise InputError(figures, "held_out", f"{held_out}, as in the training", found["held_out"])
    splits = {
        part: {split: subjects for split, subjects in found[part].items() if split.startswith("held-out")}
        for part in ("splits", "surface")
    }
    if not splits["splits"]:
        raise InputError(figures, "splits", "pictures that were held out", ", ".join(found["splits"]))
    return {"capture": Path(config["capture"]).name, "frames": found["frames"], "views": found["views"], **splits}


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a finished training")
    parser.add_argument("figures", type=Path, help="of `evaluate --json`")
    parser.add_argument("out", type=Path, help="OUT.avatar")
    parser.add_argument("--name", required=True)
    parser.add_argument("--cost", required=True, help="time and machine that the training took")
    options = parser.parse_args()
    try:
        package(options.run, options.figures, options.out, options.name, options.cost)
    except InputError as error:
        print(f"package: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
