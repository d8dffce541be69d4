"""What else could draw the person: volume rendering of the same avatar, and the template with a texture.

Volume rendering takes 64 samples per ray between the near and the far side of the body's box, queries the nodes within reach of each
sample by the same kernels, and colours where a sample's share shows. It is measured on fewer rays of the same picture and
scaled up; posing and its box are not counted. The meshes' textures, and the skin of the fitted one, come from pictures of the subject in
other poses.
"""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import Any

import numpy as np
import torch

from avatarrex.avatar import Avatar
from avatarrex.capture.fit.outlines import Seen, Sight
from avatarrex.capture.fit.surface_fit import fit_to_mattes
from avatarrex.capture.synthetic.subject_drawer import SubjectDrawer
from avatarrex.frame import Frame
from avatarrex.gl.context import gl_unavailable
from avatarrex.measure.bench.contest import Times, interleaved, ratio, timed
from avatarrex.measure.bench.report import FASTER, Metric
from avatarrex.measure.bench.session import SEED, Bench
from avatarrex.measure.volume_drawer import VolumeDrawer
from avatarrex.metrics.baselines import FITTED, MeshDrawer, Observation, textured_mesh
from avatarrex.metrics.drawing import AvatarDrawer, Drawer, Drawing
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.training.core.warm_start import warm_start

MARCH_SAMPLES = 64
UNSEEN = 12
"""Frame of the motion in which images are compared; the texture has seen every other pose of `SEEN`."""
SEEN = (0, 20)
COLOUR_SPACING = {"body": 0.006, "hand": 0.004, "face": 0.003}
"""Metres between the subject's colours: about a pixel of the picture that images are compared in."""
AROUND = (20, 110, 200, 290)
"""Azimuths of the pictures that the texture comes from."""


def volume_rendering(bench: Bench, size: int) -> list[Metric]:
    """How many times as long it takes as a frame in a new pose: at the paper's widths, and with the packaged networks."""
    small = _against(bench, bench.avatar, size)
    wide = _against(bench, bench.once(paper_avatar), size)
    larger = [] if bench.quick else [_against(bench, bench.once(paper_avatar), 2 * size)]
    truth = bench.once(unseen)
    if truth is not None:
        signals, picture = truth
        camera = bench.camera(len(picture))
        drawers: dict[str, Drawer] = {
            "psnr_db": AvatarDrawer(bench.avatar),
            "their_psnr_db": VolumeDrawer(bench.avatar, "body", MARCH_SAMPLES),
        }
        small |= {name: psnr(drawer.draw(signals, camera), picture) for name, drawer in drawers.items()}
    return [
        Metric("frame.vs_volume_rendering", wide["times_as_fast"], FASTER, "higher", wide, 30.0),
        *(Metric("frame.vs_volume_rendering.1024", it["times_as_fast"], FASTER, "higher", it, 50.0) for it in larger),
        Metric("frame.vs_volume_rendering.compact", small["times_as_fast"], FASTER, "higher", small),
    ]


def naked_template(bench: Bench, size: int) -> list[Metric]:
    """Time and image error of the textured template and of the avatar in a pose that the texture has not seen."""
    truth, mesh = bench.once(unseen), bench.once(mesh_drawer)
    if truth is None or mesh is None:
        bench.absent["frame.rival"] = f"the subject cannot be drawn: {gl_unavailable()}"
        return []
    signals, picture = truth
    camera, turn = bench.camera(size), iter(range(1000))

    def moved(drawer: Drawer) -> None:
        drawer.draw(bench.signals(UNSEEN + next(turn)), camera)

    drawers: dict[str, Drawer] = {"avatar": AvatarDrawer(bench.avatar), "naked_template": mesh}
    times = interleaved({name: partial(moved, drawer) for name, drawer in drawers.items()}, bench.count(5, 2))
    found = {name: psnr(one.draw(signals, bench.camera(len(picture))), picture) for name, one in drawers.items()}
    return [
        Metric(f"frame.rival.{name}.ms", times[name].ms, "ms", error={"psnr_db": found[name], "pose": "not seen"})
        for name in drawers
    ]


def paper_avatar(bench: Bench) -> Avatar:
    """Networks as wide as the paper's, fitted to the template for some steps so that there is a person to draw."""
    avatar = Avatar.create(bench.avatar.person, "paper", SEED)
    avatar.meta["untrained"] = sorted({"face", *bench.avatar.hidden})
    poses = tuple(map(bench.signals, range(16)))
    warm_start(avatar, poses, "body", bench.count(60, 20), SEED)
    avatar.measure_clothing_offset()
    return avatar


def unseen(bench: Bench) -> tuple[Signals, np.ndarray] | None:
    """A pose and the subject's picture (h, w, 4) in it; None without OpenGL."""
    drawer = bench.once(subject_drawer)
    if drawer is None:
        return None
    signals, size = bench.signals(UNSEEN), bench.side(192, 96)
    return signals, drawer.draw(signals, bench.camera(size))


def subject_drawer(bench: Bench) -> SubjectDrawer | None:
    """None without OpenGL."""
    return None if gl_unavailable() is not None else SubjectDrawer(bench.subject, COLOUR_SPACING, samples=2)


def mesh_drawer(bench: Bench) -> MeshDrawer | None:
    """The textured template; None without OpenGL."""
    seen = bench.once(observed)
    return textured_mesh(bench.subject.person, seen) if seen else None


def fitted_mesh(bench: Bench) -> MeshDrawer | None:
    """The same with its skin moved onto the mattes of those pictures, as training does it; None without OpenGL."""
    seen = bench.once(observed)
    if not seen:
        return None
    sides: dict[Signals, list[Sight]] = {}
    for one in seen:
        sides.setdefault(one.signals, []).append((one.camera, partial(np.asarray, one.matte)))
    person = fit_to_mattes(bench.subject.person, [Seen(signals, tuple(found)) for signals, found in sides.items()])
    return textured_mesh(person, seen, FITTED)


def observed(bench: Bench) -> list[Observation]:
    """Pictures of the subject that textures and skins come from; none without OpenGL."""
    drawer, size = bench.once(subject_drawer), bench.side(512, 256)
    if drawer is None:
        return []
    pairs = product(
        map(bench.signals, SEEN[:1] if bench.quick else SEEN), (bench.camera(size, turn) for turn in AROUND)
    )
    return [Observation.of(signals, camera, drawer.draw(signals, camera)) for signals, camera in pairs]


def psnr(drawing: Drawing, picture: np.ndarray) -> float:
    """dB of premultiplied colours over the pixels that the picture's person covers."""
    inside = picture[..., 3] > 0
    error = (np.asarray(drawing.image)[..., :3] - picture[..., :3])[inside]
    return float(-10 * np.log10(np.mean(error**2)))


@torch.no_grad()
def _against(bench: Bench, avatar: Avatar, size: int) -> dict[str, Any]:
    """Times of both, interleaved, and what was scaled."""
    few = bench.side(128, 64)
    camera, fewer = bench.camera(size), bench.camera(few)
    drawer = VolumeDrawer(avatar, "body", MARCH_SAMPLES)
    deferred, marched = Times(), Times()
    previous: Frame | None = None
    for k in range(bench.count(3, 1) + 1):
        signals = bench.signals(2 * k)
        previous, ours = timed(render_frame, avatar, signals, camera, None, previous)
        drawer.draw(signals, fewer)  # poses; what follows only marches
        _, theirs = timed(drawer.draw, signals, fewer)
        if k:
            deferred.add(ours)
            marched.add(theirs.scaled((size / few) ** 2))
    return {
        "times_as_fast": ratio(marched, deferred),
        "ms": deferred.ms,
        "their_ms": marched.ms,
        "preset": str(avatar.meta["preset"]),
        "note": f"{few}² of {size}² rays marched, scaled",
    }
