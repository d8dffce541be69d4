"""How far a captured person's mouth moves with each expression, as a share of the template's shapes, by colours. Ours.

    v(ψ) = v_rest + Σ_e g_e ψ_e S_e        argmin_g  Σ ω |∇c · M Σ_e ψ_e S_e (g_e − g⁰_e) − (t − c)|² / (σ_c² K)  +  Σ_e (g_e − 1)² / σ_g²

with c the colour of a point (face_fit.py) in a picture of expression ψ, its light divided out, t the mean of all pictures, which follows
from g and is eliminated, M the head's blended rotation, and g⁰ the gains of the last round. A tracker's 1 is not each person's: at
`jawOpen` 0.76 the template's mouth opens by 27 mm, that of `person_f001` by 14. Offsets of nodes (face_fit.py) start too far away to find
that: a lower lip that begins on the chin stays there. Gains have few unknowns, and all points about the mouth vote on them. The points of a
picture are `ALIKE` (K) to a vote, so that what hardly moved stays the template's.
Letters: p points, e coefficients. Metres; sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

from avatarrex.capture.fit.check import posed_in_world
from avatarrex.capture.fit.face_light import without_light
from avatarrex.capture.fit.lips import away_from_lips, clear_of_lips
from avatarrex.capture.fit.paint import STRENGTH, Points, Posed, Seen, mean_colours, sights, trust, without_common
from avatarrex.ops.skinning import blend
from avatarrex.signals.driving import Signals
from avatarrex.templates.model import TEETH, TemplateModel
from avatarrex.templates.person import Person, load_person, resize_person

REACH = 0.04
"""Metres from the teeth up to which points count: lips, chin and cheeks, no lids, which hide eyeballs as they move."""
BLURS = (0.01, 0.01, 0.006, 0.006, 0.004)
"""Metres, by round: Gaussians of the pictures."""
SIGMA, ALIKE = 0.3, 100.0
"""σ_g, and how many points of a picture tell no more than one."""
LEAST, MOST = 0.2, 2.0
"""Gains are at least and at most this."""


def fit_gains(person: Person, strewn: Points, posed: Sequence[Posed], light: str) -> np.ndarray:
    """(e,) gains of `person`, who has a fitted face, that pictures of some expressions show of the points that are `strewn` over it; as
    they are without expressions, or on a template without teeth. `light`: the frame in which theirs is fixed. What reading a picture
    raises is raised."""
    fit, face = person.fit, person.fit.face if person.fit else None
    assert fit is not None
    assert face is not None
    base, signals = load_person(person.name), [one for one, _ in posed]
    points = _about_mouth(base.body, strewn)
    shapes = _between(base.body.expression_dirs.double().numpy(), base.body, points)
    away, gains = away_from_lips(base.body, points), face.gain(shapes.shape[2])
    if not len(shapes) or not any(one.expression.any() for one in signals):
        return gains
    for blur in tqdm(BLURS, desc="fit expressions", unit="round", leave=False):
        person = resize_person(base, replace(fit, face=replace(face, gains=gains)))
        seen = [[clear_of_lips(sight, away, blur) for sight in sights(person, points, one, blur)] for one in posed]
        form, pull = _equations(person, points, shapes, signals, without_light(person, points, signals, seen, light))
        prior = np.eye(len(gains)) / SIGMA**2
        gains = gains + np.linalg.solve(form / ALIKE + prior, pull / ALIKE - (gains - 1) / SIGMA**2)
        gains = gains.clip(LEAST, MOST)
    return gains


def _about_mouth(body: TemplateModel, points: Points) -> Points:
    """Those within `REACH` of the teeth at rest; none where a template has no teeth."""
    teeth = body.of_groups(TEETH).numpy()
    if not teeth.any():
        return points.chosen(np.zeros(len(points.face), bool))
    rest = body.v_template.double().numpy()
    return points.chosen(cKDTree(rest[teeth]).query(_between(rest, body, points))[0] < REACH)


def _between(values: np.ndarray, body: TemplateModel, points: Points) -> np.ndarray:
    """(p, ...) at the points, of values (v, ...) at the vertices."""
    found: np.ndarray = np.einsum("pk,pk...->p...", points.share, values[body.faces.numpy()[points.face]])
    return found


def _equations(
    person: Person, points: Points, shapes: np.ndarray, signals: Sequence[Signals], seen: Sequence[list[Seen]]
) -> tuple[np.ndarray, np.ndarray]:
    """Form (e, e) and pull (e,) of all pictures, the points' colours eliminated; `shapes` (p, 3, e), `seen` by frame and picture."""
    mean, known = mean_colours(
        [(row, cosine**2, colour) for pictures in seen for row, cosine, colour, _ in pictures], len(shapes)
    )
    count = shapes.shape[2]
    form, pull, common = np.zeros((count, count)), np.zeros(count), np.zeros((len(shapes), 3, count))
    total, missed = np.full(len(shapes), 1e-9), np.zeros((len(shapes), 3))
    for one, pictures in zip(signals, seen):
        posed, world = posed_in_world(person, one)
        turn = world[:3, :3] @ blend(posed.skinning, person.body.weights)[:, :3, :3].double().numpy()
        nearest = person.body.faces.numpy()[points.face, points.share.argmax(1)]
        ways = turn[nearest] @ (shapes * one.expression)
        for row, cosine, colour, slope in pictures:
            shown = known[row]
            row, weight = row[shown], STRENGTH * cosine[shown]
            off = without_common(points.patch[row], weight, mean[row] - colour[shown])
            weight, change = weight * trust(off), slope[shown] @ ways[row]
            weighed = weight[:, None, None] * change
            form += weighed.reshape(-1, count).T @ change.reshape(-1, count)
            pull += weighed.reshape(-1, count).T @ off.ravel()
            common[row] += weighed
            total[row] += weight
            missed[row] += weight[:, None] * off
    same = (common / total[:, None, None]).reshape(-1, count).T
    return form - same @ common.reshape(-1, count), pull - same @ missed.ravel()
