"""A synthetic capture as somebody would have filmed it, and what `capture prepare` makes of that against exact parameters.

    avatarrex-studio capture make CAPTURE --size small
    python tools/film_capture.py CAPTURE FILM
    avatarrex-studio capture prepare FILM/source FILM/out --train quick --held-out-frames A:B
    python tools/film_capture.py --judge FILM/out/refined FILM
    avatarrex-studio train FILM/filmed --recipe quick --out FILM/run_filmed
    avatarrex-studio evaluate FILM/out/run/checkpoints/LAST/avatar.avatar FILM/judged --frames held-out
    avatarrex-studio evaluate FILM/run_filmed/checkpoints/LAST/avatar.avatar FILM/exact --frames held-out

`FILM/source`: H.264 videos before a wall with stains, noise of 1.5 levels, the empty scenes, OpenCV's calibration, OpenPose's keypoints (2
pixels of noise, 5 % anywhere in the picture). `FILM/exact`: the body alone, as it was drawn. `FILM/judged`: exact pictures, mattes and
meshes with the cameras and parameters that were prepared; `FILM/filmed`: the film's pictures and mattes with exact cameras and parameters.
The first call prints the frames that are held out.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.capture.readers.splits import slices
from avatarrex.files.json_text import read_json, write_json

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from capture.filmed import detected, easymocap, exact_landmarks, openpose  # type: ignore[import-not-found]

GRAIN = 1.5
"""Standard deviation of a picture's noise, of 255."""
QUALITY = {"crf": "12", "preset": "medium"}
"""Of H.264."""
PIXELS, WRONG = 2.0, 0.05
"""Noise of keypoints, and the share that lies anywhere."""


def body_alone(capture: Path, out: Path) -> None:
    """The capture's body in a folder of its own, hard links, with what is held out."""
    shutil.copytree(capture / "body", out / "body", copy_function=os.link)
    said = read_json(capture / "capture.json")
    kept = {key: {"body": said[key]["body"]} for key in ("held_out_frames", "held_out_cameras")}
    write_json(out / "capture.json", {"format": said["format"], "provenance": said["provenance"], **kept})


def film(rig: Rig, out: Path) -> None:
    """Videos, empty scenes, calibration and keypoints of a rig."""
    cameras = {view.name: view.camera for view in rig.views}
    for folder in ("videos", "background"):
        (out / folder).mkdir(parents=True)
    for name, text in easymocap(cameras).items():
        (out / name).write_text(text)
    found = detected(exact_landmarks(rig.signals), list(cameras.values()), PIXELS, WRONG)
    rng = np.random.default_rng(5)
    for view, (name, camera) in enumerate(cameras.items()):
        empty = wall(rng, camera.height, camera.width)
        Image.fromarray(noisy(rng, empty)).save(out / "background" / f"{name}.png")
        write_video(out / "videos" / f"{name}.mp4", before(rng, rig, view, empty))
        (out / "keypoints" / name).mkdir(parents=True)
        for frame, triples in enumerate(found[:, view]):
            file = out / "keypoints" / name / f"{name}_{frame:012d}_keypoints.json"
            file.write_text(json.dumps(openpose(triples)))


def wall(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """(h, w, 3) a grey-green wall that is darker below, with stains and a fine grain."""
    shade = np.linspace(1.15, 0.8, height)[:, None, None] * np.array([104.0, 128.0, 112.0])
    stains = 720 * gaussian_filter(rng.standard_normal((height, width, 1)), (12, 12, 0))
    return np.asarray(shade + stains + 4 * gaussian_filter(rng.standard_normal((height, width, 3)), (1, 1, 0)))


def noisy(rng: np.random.Generator, picture: np.ndarray) -> np.ndarray:
    """Bytes (h, w, 3) of a picture, with a sensor's noise."""
    return np.asarray(np.clip(np.rint(picture + GRAIN * rng.standard_normal(picture.shape)), 0, 255), np.uint8)


def before(rng: np.random.Generator, rig: Rig, view: int, empty: np.ndarray) -> Iterator[np.ndarray]:
    """The camera's frames: its pictures, which are premultiplied, over the empty scene."""
    for frame in range(rig.frames):
        share = 1 - rig.matte(view, frame)[..., None] / 255
        yield noisy(rng, rig.image(view, frame) + share * empty)


def write_video(path: Path, pictures: Iterator[np.ndarray]) -> None:
    """Bytes (h, w, 3) as H.264 with 4:2:0 colours, 30 frames a second."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(30), options=QUALITY)
        stream.pix_fmt = "yuv420p"
        for number, pixels in enumerate(pictures):
            if not number:
                stream.height, stream.width = pixels.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())


def tracked_otherwise(pictures: Path, tracking: Path, out: Path) -> None:
    """The pictures, mattes and meshes of one capture with the cameras and parameters of another."""
    body = out / "body"
    shutil.copytree(pictures / "body", body, copy_function=os.link)
    for name in ("calibration_full.json", "smpl_params.npz"):
        (body / name).unlink()
        shutil.copyfile(tracking / "body" / name, body / name)
    shutil.copyfile(pictures / "capture.json", out / "capture.json")


def main() -> None:
    """Film a capture, or put the prepared parameters beside its exact pictures, and the exact ones beside the film's."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path, nargs="?", help="what `capture make` has made")
    parser.add_argument("film", type=Path, help="a new folder, or with --judge the one that was filmed into")
    parser.add_argument("--judge", type=Path, metavar="PREPARED", help="OUT/refined of `capture prepare`")
    options = parser.parse_args()
    if options.judge:
        tracked_otherwise(options.film / "exact", options.judge, options.film / "judged")
        tracked_otherwise(options.judge, options.film / "exact", options.film / "filmed")
        return
    body_alone(options.capture, options.film / "exact")
    rig = open_capture(options.film / "exact").rigs["body"]
    film(rig, options.film / "source")
    print(f"--held-out-frames {slices(sorted(rig.held_out_frames))}")


if __name__ == "__main__":
    main()
