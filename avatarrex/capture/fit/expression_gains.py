"""How far a captured person's mouth moves with each expression, in units of the template's shapes, by colours. Ours.

    v(ψ) = v_rest + Σ_e g_e ψ_e S_e

    argmin_g  Σ ω |∇c · M Σ_e (g_e − g⁰_e) ψ_e S_e − (t − c)|² / (σ_c² K)  +  Σ_e (g_e − 1)² / σ_g²

with c the colour of a point (face_fit.py) in a picture of expression ψ, its light divided out, t the mean of all pictures, which follows
from g and is eliminated, M the head's blended rotation, and g⁰ the gains of the last round. A tracker's 1 is not each person's: where the
template's mouth opens by 29 mm, that of `person_f001` opens by 15. Offsets of nodes (face_fit.py) start too far away to find that: a
lower lip that begins on the chin stays there. Gains have few unknowns, and all points about the mouth vote on them. Rest is not sought
yet: what all pictures share cannot tell a gain from a face of another rest, so that only what differs between frames is sought.
Letters: p points, e coefficients. Metres; sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

from avatarrex.capture.fit.face_light import without_light
from avatarrex.capture.fit.lips import away_from_lips, clear_of_lips
from avatarrex.capture.fit.paint import Points, Posed, Seen, missed, sights
from avatarrex.signals.driving import Signals
from avatarrex.templates.model import EYES, TEETH, TemplateModel
from avatarrex.templates.person import Person, load_person, resize_person

REACH, FROM_EYES = 0.04, 0.01
"""Metres from the teeth up to which points count, and from eyeballs from which they do: lips, chin and cheeks; lids hide eyeballs as they
move, and what is hidden costs nothing."""
BLURS = (0.01, 0.01, 0.006, 0.006, 0.004)
"""Metres, by round: Gaussians of the pictures."""
SIGMA = 0.3
"""σ_g: people's expressions differ by 10 to 30 %."""
POINTS_A_VOTE = 100.0
"""K: points are 2 mm apart in pictures blurred by 4 to 10, and other faces than the template's differ by more than noise. With 1 shapes
that hardly moved took what others left (docs/experiments.md)."""
DIFFERENT = 0.1
"""By how much a coefficient differs between frames, at least, to be sought."""
LEAST, MOST = 0.2, 2.0
"""Gains are at least and at most this."""


def fit_gains(person: Person, strewn: Points, posed: Sequence[Posed], light: str) -> np.ndarray:
    """(e,) gains of `person`, who has a fitted face, that pictures of some expressions show of the points that are `strewn` over it; as
    they are where no expression differs between frames, or on a template without teeth. `light`: the frame in which theirs is fixed. What
    reading a picture raises is raised."""
    fit, face = person.fit, person.fit.face if person.fit else None
    assert fit is not None
    assert face is not None
    base, signals = load_person(person.name), [one for one, _ in posed]
    points = strewn.chosen(_about_mouth(base.body, strewn))
    differ = np.ptp([one.expression for one in signals], axis=0) > DIFFERENT
    if not len(points.face) or not differ.any():
        return face.gains
    shapes = points.between(base.body.expression_dirs.double().numpy() * differ, base.body.faces.numpy())
    away, gains = away_from_lips(base.body, points), face.gain(len(differ))
    for blur in tqdm(BLURS, desc="fit expressions", unit="round", leave=False):
        person = resize_person(base, replace(fit, face=replace(face, gains=gains)))
        seen = [[clear_of_lips(sight, away, blur) for sight in sights(person, points, one, blur)] for one in posed]
        form, pull = _equations(person, points, shapes, signals, without_light(person, points, signals, seen, light))
        prior = np.eye(len(gains)) / SIGMA**2
        step = np.linalg.solve(form / POINTS_A_VOTE + prior, pull / POINTS_A_VOTE - (gains - 1) / SIGMA**2)
        gains = (gains + step).clip(LEAST, MOST)
    return gains


def _about_mouth(body: TemplateModel, points: Points) -> np.ndarray:
    """(p,) bool: those near the teeth and not at the eyes, at rest; none where a template has no teeth."""
    teeth, eyes = body.of_groups(TEETH).numpy(), body.of_groups(EYES).numpy()
    rest = body.v_template.double().numpy()
    place = points.between(rest, body.faces.numpy())
    if not teeth.any():
        return np.zeros(len(place), bool)
    near: np.ndarray = cKDTree(rest[teeth]).query(place)[0] < REACH
    return near & (cKDTree(rest[eyes]).query(place)[0] > FROM_EYES) if eyes.any() else near


def _equations(
    person: Person, points: Points, shapes: np.ndarray, signals: Sequence[Signals], seen: Sequence[list[Seen]]
) -> tuple[np.ndarray, np.ndarray]:
    """Form (e, e) and pull (e,) of all pictures, the points' colours eliminated; `shapes` (p, 3, e), `seen` by frame and picture."""
    count = shapes.shape[2]
    form, pull, common = np.zeros((count, count)), np.zeros(count), np.zeros((len(shapes), 3, count))
    total, missing = np.full(len(shapes), 1e-9), np.zeros((len(shapes), 3))
    for each in missed(person, points, signals, seen):
        change = each.slope @ (shapes[each.row] * each.signals.expression)
        weighed = each.weight[:, None, None] * change
        form += weighed.reshape(-1, count).T @ change.reshape(-1, count)
        pull += weighed.reshape(-1, count).T @ each.off.ravel()
        common[each.row] += weighed
        total[each.row] += each.weight
        missing[each.row] += each.weight[:, None] * each.off
    same = (common / total[:, None, None]).reshape(-1, count).T
    return form - same @ common.reshape(-1, count), pull - same @ missing.ravel()
