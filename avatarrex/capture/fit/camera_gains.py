"""How much brighter or warmer each camera of a rig is than the others, by the colours of the person.

At one moment a point of the skin has one colour, whichever camera sees it, but for gloss. With c_kp the logarithm of the mean colour of
triangle and frame p as camera k sees it,

    min over t and g of  Σ ω_kp |c_kp − t_p + g_k|²,   Σ_k g_k = 0

of each channel; t is eliminated. ω falls with the residual of the round before (Geman–McClure): gloss, and triangles that are drawn beside
their place. exp g is what a camera's pictures have to be multiplied by. sRGB-encoded, where a change of exposure is nearly a factor.

Letters: k cameras, f triangles, p triangles at frames.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from avatarrex.capture.fit.check import shown_frames, template_surface
from avatarrex.capture.fit.photo import OPAQUE
from avatarrex.capture.readers.rigs import Rig
from avatarrex.capture.readers.splits import Splits
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.templates.person import Person

FRAMES = 6
"""Of the training's, spread."""
DARKEST, BRIGHTEST = 24.0, 250.0
"""Bytes as they were taken: the ratio of darker means says little, brighter ones are cut off."""
FEWEST = 100
"""Triangles at frames that a camera has to share with others to be compared with them."""
ROUNDS, STRAY = 8, 0.1
"""Solutions, and the logarithm of a ratio at which a weight has fallen to a quarter."""


def camera_gains(rig: Rig, person: Person, frames: int = FRAMES) -> Float[np.ndarray, "k 3"]:
    """What the pictures of each camera have to be multiplied by so that all are as bright; see `gains_of`. By pictures of at most
    `frames` frames of the training's split; NaN of cameras that are held out, too.
    """
    views, gains = list(Splits.of(rig).train.views), np.full((len(rig.views), 3), np.nan)
    if len(views) > 1:
        before = np.array([rig.views[view].gain for view in views])
        gains[views] = gains_of(seen_colours(rig, person, frames), before)
    return gains


def seen_colours(rig: Rig, person: Person, frames: int = FRAMES) -> Float[np.ndarray, "k p 3"]:
    """Mean bytes of the posed template's triangles in pictures of the training's split, which two of its cameras `k` or more see; NaN
    where one does not."""
    views, faces = Splits.of(rig).train.views, person.body.faces.numpy()
    seen = [np.full((len(views), 0, 3), np.nan)]
    for frame in shown_frames(rig, frames):
        vertices = template_surface(person, rig.signals[frame])[0]
        colours = np.stack([_mean_colours(rig, view, frame, vertices, faces) for view in views])
        seen.append(colours[:, np.isfinite(colours[..., 0]).sum(0) > 1])
    return np.concatenate(seen, axis=1)


def gains_of(colours: Float[np.ndarray, "k p 3"], before: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    """Of mean colours, bytes, NaN where a camera does not see a triangle; pictures are multiplied by `before` already.

    The gains of each of the `groups` have a geometric mean of 1; NaN of a camera that is alone.
    """
    low, high = DARKEST * before, BRIGHTEST * np.minimum(before, 1)
    with np.errstate(invalid="ignore"):
        seen: np.ndarray = ((colours > low[:, None]) & (colours < high[:, None])).all(-1)
    gains = np.full((len(colours), 3), np.nan)
    for cameras in groups(seen):
        if len(cameras) > 1:
            gains[cameras] = _solved(colours[cameras], seen[cameras])
    return gains


def groups(seen: Bool[np.ndarray, "k p"]) -> list[list[int]]:
    """Cameras that can be compared: those that share most are joined first, until no two groups share `FEWEST` triangles."""
    found, shown = [[camera] for camera in range(len(seen))], seen.astype(np.float32)
    common = shown @ shown.T
    np.fill_diagonal(common, 0)
    while common.max(initial=0) >= FEWEST:
        one, other = sorted(int(place) for place in np.unravel_index(common.argmax(), common.shape))
        found[one] += found.pop(other)
        shown[one] = np.maximum(shown[one], shown[other])
        shown = np.delete(shown, other, 0)
        common = np.delete(np.delete(common, other, 0), other, 1)
        common[one] = common[:, one] = shown @ shown[one]
        common[one, one] = 0
    return found


def _solved(colours: Float[np.ndarray, "k p 3"], seen: Bool[np.ndarray, "k p"]) -> Float[np.ndarray, "k 3"]:
    """Of cameras that share enough, by the colours that count."""
    shared = seen.sum(0) > 1
    seen = seen[:, shared]
    value = np.log(np.where(seen[..., None], colours[:, shared], 1.0))
    weight, gain = seen.astype(float), np.zeros((len(colours), 3))
    for _ in range(ROUNDS):
        share = weight / weight.sum(0)
        off = value - (share[..., None] * value).sum(0)
        square = np.diag(weight.sum(1)) - weight @ share.T
        gain = np.linalg.lstsq(square, -(weight[..., None] * off).sum(1), rcond=1e-9)[0]
        even = value + gain[:, None]
        even -= (share[..., None] * even).sum(0)
        weight = np.where(seen, 1 / (1 + np.square(even).mean(-1) / STRAY**2) ** 2, 0.0)
    found: np.ndarray = np.exp(gain)
    return found


def largest(gains: Float[np.ndarray, "k 3"]) -> float:
    """How far the gain farthest from 1 is away, as a share: 0.25 of 1.25 and of 0.8; those that are NaN do not count."""
    return float(np.expm1(np.nanmax(np.abs(np.log(gains)), initial=0.0)))


def colour_sums(
    rig: Rig, view: int, frame: int, vertices: Float[np.ndarray, "v 3"], faces: np.ndarray
) -> Float[np.ndarray, "f 4"]:
    """Bytes of the pixels that show each triangle of a mesh in world metres, summed, and their number."""
    face = visible_faces(vertices, faces, rig.views[view].camera)[0]
    counts = (face >= 0) & (rig.matte(view, frame) >= OPAQUE)
    values = np.concatenate([rig.image(view, frame)[counts].T, np.ones((1, counts.sum()))])
    return np.stack([np.bincount(face[counts], value, len(faces)) for value in values], axis=-1)


def mean_of(sums: Float[np.ndarray, "f 4"]) -> Float[np.ndarray, "f 3"]:
    """Bytes; NaN of triangles that no pixel shows."""
    with np.errstate(invalid="ignore"):
        mean: np.ndarray = sums[:, :3] / sums[:, 3:]
    return mean


def _mean_colours(
    rig: Rig, view: int, frame: int, vertices: Float[np.ndarray, "v 3"], faces: np.ndarray
) -> Float[np.ndarray, "f 3"]:
    """Bytes; NaN where none is seen or there is no picture."""
    if not rig.available(view, frame):
        return np.full((len(faces), 3), np.nan)
    return mean_of(colour_sums(rig, view, frame, vertices, faces))
