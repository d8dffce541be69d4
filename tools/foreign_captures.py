"""Generated captures in every layout of the field: sound ones get no warning, faults are named, and each is trained on.

    python tools/foreign_captures.py FOLDER sound [--seeds N]     captures of N seeds, in our layout and written in each foreign one
    python tools/foreign_captures.py FOLDER faults                unit, axis, rows, half a pixel, hands, order of cameras: four layouts
    python tools/foreign_captures.py FOLDER train                 written, imported, checked, trained (smoke): the loss of the first step
    … --only LAYOUT                                               of one alone

A capture is drawn of the clothed subject (heads: of the template), written in a layout by tests/capture/foreign.py, imported and judged as
`capture check` does. Exit code 1 where a sound capture is warned of, a fault is not named or a training fails. The whole takes an hour of one
core; tests/capture/test_faults.py and test_import.py are its smallest form.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / "tests")]
from capture import foreign
from capture.clothed import Clothed
from capture.foreign import Scene

from avatarrex.camera import Camera
from avatarrex.capture.fit.verdict import judge
from avatarrex.capture.importers.import_capture import import_capture
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.errors import InputError
from avatarrex.signals.library import named_hand

LAYOUTS = {**foreign.BODIES, **foreign.FACES}
ALONE = "one camera alone"
"""What layouts of one camera are warned of, and rightly."""
COLOUR = np.array([0.8, 0.6, 0.5])


def clothed(seed: int) -> Clothed:
    """Three frames before six cameras, large enough that hands and half pixels are judged."""
    return Clothed(cameras=6, frames=3, seed=seed, size=(168, 224))


def of_clothed(one: Clothed) -> Scene:
    """The clothed subject, its hands as they are."""
    images = {place: np.uint8(matte[..., None] * COLOUR) for place, matte in one.mattes.items()}
    return Scene(list(one.motion), one.lenses, images, one.mattes)


def seen_by(one: Scene, change: Callable[[Camera], Camera]) -> Scene:
    """With other cameras in the files."""
    return replace(one, cameras={name: change(camera) for name, camera in one.cameras.items()})


def shown(one: Scene, change: Callable[[tuple[str, int], dict[tuple[str, int], np.ndarray]], np.ndarray]) -> Scene:
    """With other pictures and mattes."""
    images, mattes = ({place: change(place, kept) for place in kept} for kept in (one.images, one.mattes))
    return replace(one, images=images, mattes=mattes)


def farther(camera: Camera, times: float) -> Camera:
    """T as many times as long."""
    matrix = camera.camera_from_world.copy()
    matrix[:3, 3] *= times
    return replace(camera, camera_from_world=matrix)


def z_up(camera: Camera) -> Camera:
    """Before a world with +Z up."""
    turn = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return replace(camera, camera_from_world=camera.camera_from_world @ turn.T)


def at_integers(camera: Camera) -> Camera:
    """Pixel centres at integers."""
    return replace(camera, intrinsics=camera.intrinsics - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))


def without_mean(one: Scene) -> Scene:
    """The hands' mean pose taken away, which nothing then says."""
    mean = {f"{side}_hand_pose": 0.9 * named_hand("relaxed", side) for side in ("left", "right")}
    return replace(
        one,
        signals=[
            signals.replace(**{name: getattr(signals, name) - value for name, value in mean.items()})
            for signals in one.signals
        ],
    )


def exchanged(one: Scene) -> Scene:
    """The second camera's pictures are the third's, and the other way round."""
    names = list(one.cameras)
    other = {**dict(zip(names, names)), names[1]: names[2], names[2]: names[1]}
    return shown(one, lambda place, kept: kept[other[place[0]], place[1]])


Fault = tuple[Callable[[Scene], Scene], tuple[str, ...]]
"""What is done to a capture, and what has to be said."""
FAULTS: dict[str, Fault] = {
    "nothing": (lambda one: one, ("good",)),
    "axis": (partial(seen_by, change=z_up), ("+Z up", "stands along +Z")),
    "rows": (lambda one: shown(one, lambda place, kept: kept[place][::-1]), ("rows run from the bottom",)),
    "half a pixel": (partial(seen_by, change=at_integers), ("half a pixel",)),
    "flat_hand_mean": (without_mean, ("flat_hand_mean",)),
    "camera order": (exchanged, ("camera order",)),
}


def faults_of(layout: str) -> dict[str, Fault]:
    """By name; those that a layout of bodies can have."""
    per_metre = 1000 if layout == "ZJU-MoCap" else 1
    unit = partial(seen_by, change=partial(farther, times=100 / per_metre))
    found = {**FAULTS, "unit": (unit, ("centimetres",))}
    if layout == "ZJU-MoCap":
        del found["flat_hand_mean"]  # it has no fingers
    return found


def written(layout: str, one: Scene, folder: Path) -> tuple[Path, tuple[str, ...]]:
    """A scene in a layout, imported; the capture, and what the import has noted."""
    shutil.rmtree(folder, ignore_errors=True)
    LAYOUTS[layout](one, folder / "source")
    found = import_capture(folder / "source", folder / "imported")
    return folder / "imported", (*found.notes, *found.problems)


def said(path: Path) -> list[str]:
    """The verdict of `capture check`, in lines, and what was noted while the capture was opened."""
    capture, _, verdict = judge(with_validation(open_capture(path)), frames=4, exact=True)
    return [*verdict.lines(), *capture.notes]


def checked(layout: str, one: Scene, folder: Path) -> list[str]:
    """What import and check say of a scene in a layout; why the import is refused, where it is."""
    try:
        path, notes = written(layout, one, folder)
    except InputError as error:
        return [f"{error} (unusable)"]
    return [*said(path), *notes]


def warnings(lines: list[str]) -> list[str]:
    """Reasons but for the one that holds for a layout of one camera."""
    return [line.strip() for line in lines if line.endswith(("(doubtful)", "(unusable)")) and ALONE not in line]


def sound(folder: Path, seeds: int, only: str) -> Iterator[tuple[str, str, bool]]:
    """Layout, what was found, and whether that is right; each line as soon as it is known."""
    for seed in range(seeds):
        drawn, place = clothed(seed), folder / "sound"
        if only in "ours":
            shutil.rmtree(place, ignore_errors=True)
            yield f"{seed} ours", *judged(said(drawn.write(place)))
        for layout in (name for name in LAYOUTS if only in name):
            scene = of_clothed(drawn) if layout in foreign.BODIES else foreign.heads(seed)
            yield f"{seed} {layout}", *judged(checked(layout, scene, place))


def judged(lines: list[str]) -> tuple[str, bool]:
    """What a sound capture is warned of."""
    found = warnings(lines)
    return "; ".join(found) or "no warning", not found


def faults(folder: Path, _: int, only: str) -> Iterator[tuple[str, str, bool]]:
    """Each fault in each layout of bodies."""
    one = of_clothed(clothed(0))
    for layout in foreign.BODIES:
        for name, (change, words) in faults_of(layout).items():
            if only not in f"{layout}, {name}":
                continue
            lines = checked(layout, change(one), folder / "faulty")
            named = [line.strip() for line in lines if any(word in line for word in words)]
            yield f"{layout}, {name}", "; ".join(named[:1] or warnings(lines) or lines[:1]), bool(named)


def train(folder: Path, _: int, only: str) -> Iterator[tuple[str, str, bool]]:
    """Each layout to the end of its training, and the losses that were reported: of `smoke` the first step's."""
    from avatarrex_studio.cli.main import main as studio

    from avatarrex.training.runs.events import EventReader

    for layout in (name for name in LAYOUTS if only in name):
        scene = foreign.heads() if layout in foreign.FACES else foreign.scene()
        try:
            path, _ = written(layout, scene, folder / "trained")
        except InputError as error:
            yield layout, str(error), False
            continue
        run = folder / "trained" / "run"
        code = studio(["train", str(path), "--recipe", "smoke", "--no-surface", "--out", str(run)])
        reader = EventReader(run)
        while reader.poll():
            pass
        curves = {tag: reader.series(tag).values for tag in reader.tags if tag.endswith("/loss/total")}
        losses = ", ".join(f"{tag} {' '.join(f'{value:.4f}' for value in values)}" for tag, values in curves.items())
        yield layout, f"{'; '.join(warnings(said(path))) or 'no warning'}; {losses}", code == 0 and bool(curves)


def main() -> int:
    parser = argparse.ArgumentParser(description="Captures in every layout: sound, faulty, trained on.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("what", choices=("sound", "faults", "train"))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="", metavar="TEXT", help="layouts, and faults, with it in their names")
    given = parser.parse_args()
    done = wrong = 0
    acts = {"sound": sound, "faults": faults, "train": train}
    for name, found, right in acts[given.what](given.folder, given.seeds, given.only):
        done, wrong = done + 1, wrong + (not right)
        print(f"{'' if right else '!! '}{name}: {found}", flush=True)
    if not done:
        parser.error(f"nothing is called as --only says: {given.only}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
