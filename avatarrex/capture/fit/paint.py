"""What a person's skin and clothes look like, and how far a posed template is off its pictures by that. Ours.

Points are strewn over the template, evenly by area; their paint t is a robust mean of the colours c that pictures show there. A point
of a pose that is nearly right has moved by u where

    ∇c(x) u = t − c(x) − (the same on average in the patch about it)

Light, shadow and exposure change from patch to patch; the pattern is what is left. All pictures of a moment and all points next to a
vertex are summed, Σ ω ∇cᵀ∇c and Σ ω ∇cᵀ(…), whose three axes are constraints of the pose. Outlines do not see a limb that turns
about itself, or a trunk behind arms; a pattern does. Letters: p points, k constraints, h w pixels. World metres; sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from avatarrex.capture.fit.check import posed_in_world, template_surface
from avatarrex.capture.fit.photo import Photo
from avatarrex.ops.skinning import blend
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES, JOINT_ROWS
from avatarrex.templates.person import Person, load_person

POINTS, PATCHES = 40_000, 400
"""A point each 6 mm, a patch each 6 cm on an adult."""
HAND = [
    *(JOINT_NAMES.index(f"{side}_wrist") for side in ("left", "right")),
    *range(JOINT_ROWS["left_hand_pose"].start, JOINT_ROWS["right_hand_pose"].stop),
]
"""Joints."""
BLUR = 0.005
"""Metres: about as far as the points lie apart."""
STRAY = 0.1
"""Difference in sRGB at which a picture's weight has fallen to ¼ (Geman–McClure)."""
AGAIN = 2
"""Means after the first."""
SEEN = 1e-3
"""Weight from which a point has a colour."""
STRENGTH = 100.0
"""1/σ² of a point's colour, σ = 0.1 sRGB."""
DEPTH_TOLERANCE = 0.006
"""Metres that a point may lie beyond the z-buffer's surface: a pixel's slope, less than a finger's thickness."""
FLAT = 1.0
"""Σ ω ∇cᵀ∇c, sRGB per metre, squared, below which there is no pattern along an axis."""

Posed = tuple[Signals, tuple[Photo, ...]]
"""Somebody's pose, and pictures of it."""
Seen = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Of a picture: rows of the points (p,) that it shows, cosines, colours (p, 3), slopes (p, 3, 3)."""


@dataclass(frozen=True, eq=False)
class Points:
    """Strewn over a template, hands left out: they show no pattern, and their fingers hide each other."""

    face: np.ndarray
    """(p,) the triangle of each."""
    share: np.ndarray
    """(p, 3) its barycentrics."""
    patch: np.ndarray
    """(p,) which patch it is in."""
    tolerance: float = DEPTH_TOLERANCE
    """Metres that one may lie beyond the first surface and be seen."""

    def between(self, values: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """(p, ...) at the points, of `values` (v, ...) at the vertices of triangles (f, 3)."""
        found: np.ndarray = np.einsum("pk,pk...->p...", self.share, values[faces[self.face]])
        return found

    def chosen(self, kept: np.ndarray) -> Points:
        """Those that are `kept` (p,) bool, patches as they are."""
        return replace(self, face=self.face[kept], share=self.share[kept], patch=self.patch[kept])

    @classmethod
    def of(cls, person: Person) -> Points:
        """The same for everybody of a template."""
        rng, body = np.random.default_rng(0), load_person(person.name).body
        rest, faces = body.v_template.double().numpy(), body.faces.numpy()
        a, b, c = (rest[faces[:, corner]] for corner in range(3))
        hand = body.weights.numpy()[:, HAND].sum(1)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) * (hand[faces].mean(1) < 0.5)
        face = np.sort(rng.choice(len(faces), POINTS, p=area / area.sum()))
        share = rng.dirichlet(np.ones(3), POINTS)
        place = np.einsum("pk,pkc->pc", share, rest[faces[face]])
        centres = place[rng.choice(POINTS, PATCHES, replace=False)]
        return cls(face, share, cKDTree(centres).query(place)[1])


@dataclass(frozen=True, eq=False)
class Missed:
    """What a picture shows of some points otherwise than the mean of all pictures, without what a patch of points has in common."""

    row: np.ndarray
    """(p,) which points."""
    slope: np.ndarray
    """(p, 3, 3) of the picture, by channel, along the axes of rest."""
    off: np.ndarray
    """(p, 3) the mean less the picture, sRGB."""
    weight: np.ndarray
    """(p,) ω/σ_c²."""
    signals: Signals
    """Of the frame."""


@dataclass(frozen=True, eq=False)
class Paint:
    """The colours of a person's points."""

    points: Points
    colour: np.ndarray
    """(p, 3)."""
    known: np.ndarray
    """(p,) bool: whether any picture shows it."""
    blur: float = BLUR
    """Metres, of the pictures."""

    @classmethod
    def of(cls, person: Person, posed: Iterable[Posed], blur: float = BLUR) -> Paint:
        """By pictures of some poses. What reading a picture raises is raised."""
        points = Points.of(person)
        found = (sight for one in posed for sight in sights(person, points, one, blur))
        seen = [(row, (cosine**2).astype(np.float32), colour.astype(np.float32)) for row, cosine, colour, _ in found]
        return cls(points, *mean_colours(seen, POINTS), blur)

    def pull(self, person: Person, posed: Posed) -> Pull:
        """What of a pose the pictures say otherwise. What reading a picture raises is raised."""
        curved, along = np.zeros((POINTS, 3, 3)), np.zeros((POINTS, 3))
        for row, cosine, colour, slope in sights(person, self.points, posed, self.blur):
            known = self.known[row]
            row, weight, slope = row[known], cosine[known], slope[known]
            off = without_common(self.points.patch[row], weight, self.colour[row] - colour[known])
            weight = weight * trust(off)
            curved[row] += np.einsum("p,pcx,pcy->pxy", weight, slope, slope)
            along[row] += np.einsum("p,pcx,pc->px", weight, slope, off)
        return Pull.of(person, self.points, curved, along)


@dataclass(frozen=True)
class Pull:
    """Constraints of a pose."""

    vertex: np.ndarray
    """(k,)."""
    axis: np.ndarray
    """(k, 3) unit, world."""
    distance: np.ndarray
    """(k,) metres along it to where the pattern is."""
    weight: np.ndarray
    """(k,) 1/σ², per square metre."""

    @classmethod
    def of(cls, person: Person, points: Points, curved: np.ndarray, along: np.ndarray) -> Pull:
        """Of points' normal equations (p, 3, 3) and (p, 3), gathered at the vertices next to them."""
        nearest = person.body.faces.numpy()[points.face, points.share.argmax(1)]
        matrix, right = np.zeros((len(person.body.v_template), 3, 3)), np.zeros((len(person.body.v_template), 3))
        np.add.at(matrix, nearest, curved)
        np.add.at(right, nearest, along)
        value, axes = np.linalg.eigh(matrix)
        vertex, which = np.nonzero(value > FLAT)
        axis, strong = axes[vertex, :, which], value[vertex, which]
        return cls(vertex, axis, (axis * right[vertex]).sum(1) / strong, STRENGTH * strong)


def mean_colours(
    seen: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Robust means (p, 3) of the colours of `count` points, and which of them any picture shows (p,); `seen` by picture: rows,
    weights, colours."""
    mean = np.zeros((count, 3))
    for again in range(1 + AGAIN):
        total = np.zeros((count, 4))
        for row, weight, colour in seen:
            if again:
                weight = weight * trust(colour - mean[row])
            total[row] += weight[:, None] * np.column_stack([np.ones(len(row)), colour])
        mean = total[:, 1:] / np.maximum(total[:, :1], 1e-12)
    return mean, total[:, 0] > SEEN


def without_common(patch: np.ndarray, weight: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Differences (p, 3) without what points of a `patch` (p,) have in common: light, shadow and exposure."""
    count = int(patch.max(initial=0)) + 1
    total = np.bincount(patch, weight, count) + 1e-6
    mean = np.stack([np.bincount(patch, weight * channel, count) / total for channel in off.T], 1)
    return np.asarray(off - mean[patch])


def sights(person: Person, points: Points, posed: Posed, blur: float) -> Iterator[Seen]:
    """What each of the pictures shows of the points (`Seen`). What reading one raises is raised."""
    signals, photos = posed
    vertices, faces = template_surface(person, signals)[0], person.body.faces.numpy()
    place = points.between(vertices, faces)
    for photo in photos:
        depth = float(np.median(photo.camera.seen(vertices)[:, 2]))
        picture = photo.blurred(max(depth, 0.1), blur)
        cosine = picture.shows(vertices, faces, points.face, place, points.tolerance)
        row = np.flatnonzero(cosine)
        yield row, cosine[row], *picture.at(place[row])


def missed(person: Person, points: Points, signals: Sequence[Signals], seen: Sequence[list[Seen]]) -> Iterator[Missed]:
    """What each picture shows otherwise than the points' means; `seen` by frame and picture."""
    everything = [(row, cosine**2, colour) for pictures in seen for row, cosine, colour, _ in pictures]
    mean, known = mean_colours(everything, len(points.face))
    nearest = person.body.faces.numpy()[points.face, points.share.argmax(1)]
    for one, pictures in zip(signals, seen):
        posed, world = posed_in_world(person, one)
        turn = world[:3, :3] @ blend(posed.skinning, person.body.weights)[:, :3, :3].double().numpy()
        for row, cosine, colour, slope in pictures:
            shown = known[row]
            row, weight = row[shown], STRENGTH * cosine[shown]
            off = without_common(points.patch[row], weight, mean[row] - colour[shown])
            yield Missed(row, slope[shown] @ turn[nearest[row]], off, weight * trust(off), one)


def only(sight: Seen, kept: np.ndarray) -> Seen:
    """The rows of `sight` that are `kept` (p,) bool."""
    row, cosine, colour, slope = sight
    return row[kept], cosine[kept], colour[kept], slope[kept]


def trust(off: np.ndarray) -> np.ndarray:
    """(p,) weights of differences (p, 3)."""
    return np.asarray((1 + np.square(off).mean(1) / STRAY**2) ** -2)
