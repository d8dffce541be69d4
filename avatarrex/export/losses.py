"""What a format loses against the surface, measured: bones, corrections by the pose, colours, light; and what the surface itself
loses against the exact frame, as its distillation measured it.

Posed by the format's own rule (`Rig.moved`) against the whole surface (`pose_surface`), over frames of the clips that go into the
file, or over poses of the library. Millimetres; colours in steps of 8 bits.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image

from avatarrex.export.clips import Clip
from avatarrex.export.label import Losses
from avatarrex.export.rig import Rig, lifted
from avatarrex.export.texture import light_on, vertex_colours
from avatarrex.fields.light import Light
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import BODY_GROUPS, BODY_JOINTS
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.surface.pose import PosedSurface, pose_surface
from avatarrex.surface.surface import Surface
from avatarrex.templates.person import Person

FRAMES = 12
"""Most frames of the clips that are measured."""
POSES = ("stand", "wave", "walk", "run", "squat", "sit", "arms_up", "think")
"""What is measured where there are no clips; with fists and a smile."""

_LIMBS = [row for row, joint in enumerate(BODY_JOINTS) if joint not in BODY_GROUPS["head"]]


@dataclass(frozen=True, eq=False)
class Source:
    """What is exported."""

    surface: Surface
    person: Person
    light: Light

    def posed(self, signals: Signals) -> PosedSurface:
        """The whole surface."""
        return pose_surface(self.surface, self.person, signals)

    def world(self, posed: PosedSurface, signals: Signals) -> np.ndarray:
        """(v, 3): the vertices with the root's turn and place, soles on y = 0 at rest."""
        world = posed.world_from_root(signals)
        return np.asarray(posed.vertices @ world[:3, :3].T + (world[:3, 3] + lifted(self.surface)))

    def factor(self, posed: PosedSurface, signals: Signals) -> np.ndarray:
        """(v, 3): the light that falls on a pose."""
        light = self.light.over(posed.world_from_root(signals))
        return light_on(self.surface, torch.from_numpy(posed.normals), light)

    def colours(self, posed: PosedSurface, signals: Signals) -> np.ndarray:
        """(v, 3) in [0, 1]."""
        return vertex_colours(self.surface, self.factor(posed, signals), posed.tint)

    def mean_factor(self, frames: Sequence[Signals]) -> np.ndarray:
        """(v, 3): the mean light of some poses, which a texture for all of them gets."""
        return np.asarray(np.mean([self.factor(self.posed(signals), signals) for signals in frames], 0))


def frames_of(clips: Sequence[Clip]) -> list[Signals]:
    """Frames, evenly spaced over all clips; poses of the library where there is none.

    Those of a face recording, which turns the head above a T-pose, count where there are no others.
    """
    if not clips:
        fists = {f"{side}_hand_pose": named_hand("fist", side) for side in ("left", "right")}
        smile = named_expression("smile")
        return [Signals.rest().replace(body_pose=named_pose(pose), expression=smile, **fists) for pose in POSES]
    frames = [frame for clip in clips for frame in clip.sequence]
    return some_of([frame for frame in frames if frame.body_pose[_LIMBS].any()] or frames)


def some_of(frames: Sequence[Signals]) -> list[Signals]:
    """At most `FRAMES`, evenly spaced, the first and the last among them."""
    return [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, FRAMES).round().astype(int))]


def animated_losses(source: Source, rig: Rig, clips: Sequence[Clip], encoded: bytes) -> Losses:
    """Of a file with skeleton, morph targets and the texture `encoded`."""
    surface = source.surface
    dropped = 100 * surface.weight[:, rig.joint.shape[1] :].sum(1, dtype=np.float64)
    frames, none = frames_of(clips), np.zeros_like(surface.vertices)
    baked = vertex_colours(surface, source.mean_factor(frames), none)
    distance, light, whole = [], [], []
    for signals in frames:
        posed = source.posed(signals)
        distance.append(1000 * np.linalg.norm(rig.moved(signals) - source.world(posed, signals), axis=1))
        light.append(np.abs(vertex_colours(surface, source.factor(posed, signals), none) - baked))
        whole.append(np.abs(source.colours(posed, signals) - baked))
    far = np.concatenate(distance)
    return {
        **_counts(surface),
        "joints of a vertex": rig.joint.shape[1],
        "skin weight dropped, %, mean": float(dropped.mean()),
        "skin weight dropped, %, most": float(dropped.max()),
        "measured over": f"{len(frames)} frames" + ("" if clips else f": {', '.join(POSES)}; fists, smile"),
        "corrections by the pose": "dropped",
        "place against the whole surface, mm, mean": float(far.mean()),
        "place against the whole surface, mm, p99": float(np.percentile(far, 99)),
        "light": "baked: the mean of these frames",
        "colour lost by baked light, of 255": 255 * float(np.mean(light)),
        "colour lost by light and corrections, of 255": 255 * float(np.mean(whole)),
        "texture as JPEG, dB": _psnr(rig.texture, encoded),
        **_exact(surface),
    }


def still_losses(source: Source, textured: bool, frames: int) -> Losses:
    """Of posed meshes, whose vertices are the whole surface's."""
    colour = "texture with the light of the pose" if frames == 1 else "one texture with the mean light of the frames"
    return {
        **_counts(source.surface),
        "skeleton, expressions": "none: a posed mesh" if frames == 1 else f"none: {frames:,} posed meshes",
        "corrections by the pose": "in the vertices",
        "colour": colour if textured else "of vertices, with the light of the pose",
        **_exact(source.surface),
    }


def _counts(surface: Surface) -> Losses:
    return {
        "vertices": len(surface.vertices),
        "vertices split at texture seams": len(surface.uv),
        "triangles": len(surface.faces),
    }


def _exact(surface: Surface) -> Losses:
    """The surface's own errors."""
    found = {f"surface: {name}": value for name, value in _leaves(surface.meta)}
    return found or {"surface against the exact frame": "not measured"}


def _leaves(tree: object, path: str = "") -> list[tuple[str, float | str]]:
    """Numbers and words of nested objects by their path."""
    if isinstance(tree, dict):
        pairs = [pair for name, value in tree.items() for pair in _leaves(value, f"{path} {name}".strip())]
        return pairs
    return [(path, tree)] if isinstance(tree, int | float | str) and not isinstance(tree, bool) else []


def _psnr(texture: np.ndarray, encoded: bytes) -> float:
    with Image.open(io.BytesIO(encoded)) as image:
        error = np.asarray(image.convert("RGB"), np.float64) - texture
    return float(10 * np.log10(255**2 / max(np.mean(error**2), 1e-6)))
