"""A captured person's own face: its skin at rest, and what its expression shapes differ by from the template's, by colours. Ours.

How far the mouth moves with each expression is found first (expression_gains.py); what follows starts from those shapes.
Points are strewn over the template's face; their colours are the means of what all pictures of the face rig show there. The face with
which the pictures agree is sought, over offsets (o, d) of nodes (templates/face_offsets.py):

    argmin  Σ ω |∇c · M Σ_n w_n (o_n + Σ_k φ_k d_nk) − (t − c)|²/σ_c²  +  Σ |o|²/σ_o² + |d|²/σ_d²  +  the same of neighbours' differences

with c a point's colour in a picture, its light divided out (face_light.py), t its mean, M the head's blended rotation, and φ the frame's
expression along the directions in which the frames differ most. What one camera sees along its rays others see across them. Each round
draws the points where the last one has them, in sharper pictures. t follows from the offsets, and is eliminated; o is the face at the
frames' mean expression, and moves along the normal alone, from where what the fit of the skin slid along itself is undone. Eyeballs have
a node each, that moves every way, with their lids, and hardly with expressions; where the blur mixes lids into the visible part of one,
its points do not count. At ψ = 0 lips lie as near each other as the template's (`CLOSED`): pixels between open lips belong to no point,
so that parting them costs nothing. Points beside the line where lips touch do not count: there the blur mixes the mouth's inside, or the
other lip, into their colours. Jaw and eyes turn as the template's do; teeth and tongue lie behind the lips at rest as the template's do:
no colours move them, for what is seen of them is seen between moving lips.
Letters: p points, v vertices, n nodes, k directions and one more for rest, e coefficients. Metres; sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solve
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from tqdm import tqdm

from avatarrex.capture.fit.check import compared_frames
from avatarrex.capture.fit.expression_gains import fit_gains
from avatarrex.capture.fit.eye_fit import fit_eyes
from avatarrex.capture.fit.face_light import without_light
from avatarrex.capture.fit.lips import away_from_lips, clear_of_lips, touching
from avatarrex.capture.fit.paint import Points, Posed, Seen, missed, only, sights
from avatarrex.capture.fit.refine import shot
from avatarrex.capture.readers.drawn import light_frame
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits
from avatarrex.signals.driving import Signals
from avatarrex.templates.face_offsets import FaceOffsets, mesh_edges, node_weights
from avatarrex.templates.model import EYES, MOUTH, TEETH, TemplateModel
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import SurfaceOffsets

FRAMES, ALIKE = 16, 1e-3
"""Of the training's, the most different expressions; and how near in ψ and radians those are that count as one."""
DIRECTIONS, LEAST = 8, 0.02
"""Directions of ψ at most, and the root mean square along the least of them."""
POINT_COUNT = 20_000
"""A point each 2 mm, and more where nodes are fine."""
PATCHES = 12
"""Of points: what all of one have in common in a picture is shadow and exposure."""
LID = 0.0015
"""Metres that a point may lie beyond the first surface and be seen: less than a lid's thickness."""
SPACING, FINE, WIDEN = 0.015, 0.01, 0.5
"""Metres between the nodes, along the mesh; at lids and lips; and metres for each metre away from those."""
FEATURES = ((EYES, 0.006), (TEETH, 0.012))
"""What lids and lips lie about, and how many metres from it they end."""
BLURS = (0.006, 0.005, 0.004, 0.003, 0.002, 0.0013)
"""Metres, by round: Gaussians of the pictures. The first rounds see what lies far off."""
REST_SIGMA, MOVE_SIGMA = 0.01, 0.005
"""σ_o along the normal, and σ_d of a whole unit of ψ: metres."""
EYE_SIGMA, EYE_MOVE = 0.003, 0.0003
"""σ of o of an eyeball, each way, and of its d: expressions move lids."""
SIDE_SIGMA = 0.0005
"""σ of o across the normal: a skin that slides on itself at rest shows the same colours."""
NEIGHBOURS, TIE = 4, 4.0
"""How many differences a node has, and how much one counts."""
THICK, BEHIND, FLESH = 0.013, 0.5, 4.0
"""Metres of flesh between two nodes that are tied through it, cosine from which one is behind the other, and how many differences
such a tie counts as."""
LIDS = 20.0
"""How many differences the tie of an eyeball to a node of its lids counts as, at the mean expression: lids slide on it, and hide it when
they are closed."""
SMOOTH = 0.02
"""Metres over which normals are averaged: a lip faces every way."""
CLOSED = 2000.0
"""Weight, in units of 1/REST_SIGMA², of the squared change at rest of the way from one vertex of a lip to the one of the other lip that it
touches. Without it the mouth of `person_f001` was fitted open by 10 mm."""
LIP = 0.012
"""Metres from a row of teeth to the skin that it lies behind, whatever the face: closed lips would show it otherwise."""


def fit_face(capture: Capture) -> Person:
    """`capture.person` with its face as the training's pictures of the face rig show it, eyes by drawing them (eye_fit.py). As it is, where
    there is no such rig, where nobody tracked expressions or jaw, or the face has a mesh of its own. Raises `InputError` for a picture
    that cannot be decoded.
    """
    person, rig = capture.person, capture.rigs.get("face")
    if rig is None or person.fit is None or (person.face.body_vertex_ids < 0).any():
        return person
    frames = _different(rig, Splits.of(rig).train.frames)
    posed = [(rig.signals[frame], shot(rig, frame).photos) for frame in frames]
    return fit_eyes(fit_to_pictures(person, posed, light=light_frame(capture)), posed) if posed else person


def fit_to_pictures(
    person: Person, posed: Sequence[Posed], blurs: Sequence[float] = BLURS, light: str = "world"
) -> Person:
    """`person` with the face that pictures of some expressions show; `light`: the frame in which theirs is fixed. What reading a picture
    raises is raised."""
    assert person.fit is not None
    base, plain = load_person(person.name), replace(person.fit, face=None)
    points = _points(base)
    from_lips = away_from_lips(base.body, points)
    field = _Field(base, points, *_directions(np.stack([signals.expression for signals, _ in posed])))
    field.begin(base, person.fit.surface)
    field.gains = fit_gains(resize_person(base, replace(plain, face=field.offsets())), points, posed, light)
    person = resize_person(base, replace(plain, face=field.offsets()))
    with tqdm(total=len(blurs) * len(posed), desc="fit face", unit="frame", leave=False) as bar:
        for blur in blurs:
            seen, near = [], _near_on_eyes(base, points, blur)
            for one in posed:
                shown = sights(person, points, one, blur)
                seen.append([clear_of_lips(_clear_of_lids(sight, near), from_lips, blur) for sight in shown])
                bar.update()
            signals = [one for one, _ in posed]
            field.improve(person, signals, without_light(person, points, signals, seen, light))
            person = resize_person(base, replace(plain, face=field.offsets()))
    return person


class _Field:
    """Offsets of nodes on the head's skin, and what pictures say of them."""

    def __init__(self, base: Person, points: Points, directions: np.ndarray, mean: np.ndarray) -> None:
        faces = base.body.faces.numpy()
        self.directions, self.mean, self.points = directions, mean, points
        self.at_rest = np.array([1.0, *-(directions @ mean)])  # φ where ψ = 0
        self.nodes, between = _spread(base.body, np.unique(faces[points.face]))
        eye = base.body.of_groups(EYES).numpy()[list(self.nodes)]
        self.begun = np.zeros((len(self.nodes), 3))  # what of o is not sought
        self.skin, self.place = np.unique(faces[points.face, points.share.argmax(1)], return_inverse=True)
        weights, (self.upper, self.lower) = node_weights(base.body, self.nodes), touching(base.body).T
        self.weights = weights[self.skin]
        self.across = (weights[self.upper] - weights[self.lower]).toarray()  # (c, n) of one lip against the other
        self.behind = _behind(base.body, self.nodes)
        self.now = np.zeros((len(self.nodes), 3, 1 + len(directions)))
        sigma = np.tile([REST_SIGMA, *[MOVE_SIGMA] * len(directions)], (len(self.nodes), 1))
        sigma[eye] = [EYE_SIGMA, *[EYE_MOVE] * len(directions)]
        place, normal = (each[list(self.nodes)].double().numpy() for each in (base.body.v_template, base.body.normals))
        self.sideways = (np.eye(3) - normal[:, :, None] * normal[:, None]) / SIDE_SIGMA**2
        self.sideways[eye] = 0
        tied = np.eye(len(self.nodes)) + TIE * _differences(_neighbours(between) + FLESH * _flesh(place, normal))
        self.stiffness = tied[..., None] / (sigma[:, None] * sigma)
        self.stiffness[..., 0] += TIE * LIDS / REST_SIGMA**2 * _differences(_lids(base.body, self.nodes))
        self.gains = np.ones(0)  # of expressions (expression_gains.py)
        self.parted = np.zeros((len(self.across), 3))  # what the fit of the skin moved lips apart by

    def begin(self, base: Person, surface: SurfaceOffsets | None) -> None:
        """Undo what the fit of the skin moved the face by along itself, as far as it is face: outlines say nothing of that."""
        if surface is not None:
            nodes, everywhere = list(self.nodes), surface.moved(base.body)
            self.parted = everywhere[self.upper] - everywhere[self.lower]
            moved, normal = everywhere[nodes], _outwards(base, nodes)
            slid = moved - (moved * normal).sum(1, keepdims=True) * normal
            self.begun = -slid * base.blend_weight[nodes, 2:].double().numpy()

    def improve(self, person: Person, signals: Sequence[Signals], seen: Sequence[list[Seen]]) -> None:
        """One step of Gauss and Newton from the face of `person`; `seen` by frame and picture."""
        sums = _Sums(self.place, 1 + len(self.directions))
        for each in missed(person, self.points, signals, seen):
            phi = np.array([1.0, *self.directions @ (each.signals.expression - self.mean)])
            sums.add(each.row, each.slope, each.off, each.weight, phi)
        self.now += self._solved(*sums.equations())

    def _solved(self, form: np.ndarray, pull: np.ndarray) -> np.ndarray:
        """What to add to the offsets (n, 3, k), of the skin's form (v, 3k, 3k) and pull (v, 3k)."""
        n, _, k = self.now.shape
        whole, right = np.empty((n, 3 * k, n, 3 * k)), self.weights.T @ pull
        for a in range(3 * k):
            for b in range(a, 3 * k):
                block = (self.weights.T @ self.weights.multiply(form[:, a, b, None])).toarray()
                whole[:, a, :, b], whole[:, b, :, a] = block, block
            whole[:, a, :, a] += self.stiffness[..., a % k]
            right[:, a] -= self.stiffness[..., a % k] @ self.now[:, a // k, a % k]
        each = np.arange(n)
        for i in range(3):
            for j in range(3):
                whole[each, i * k, each, j * k] += self.sideways[:, i, j]
            right[:, i * k] -= (self.sideways[:, i] * self.now[..., 0]).sum(1)
        self._close(whole, right)
        system = whole.reshape(right.size, -1).T  # symmetric, and in LAPACK's order
        found: np.ndarray = solve(system, right.ravel(), overwrite_a=True, assume_a="pos")
        return found.reshape(self.now.shape)

    def _close(self, whole: np.ndarray, right: np.ndarray) -> None:
        """Add that lips which touch stay together where ψ = 0, to the equations (n, 3k, n, 3k) and (n, 3k)."""
        tied, k = np.flatnonzero(self.across.any(0)), len(self.at_rest)
        across = self.across[:, tied]
        apart = self.across @ self._rest() + self.parted
        form = np.einsum("cn,cm,a,b->namb", across, across, self.at_rest, self.at_rest, optimize=True)
        for i in range(3):
            own = np.arange(i * k, (i + 1) * k)
            whole[np.ix_(tied, own, tied, own)] += CLOSED / REST_SIGMA**2 * form
            right[np.ix_(tied, own)] -= CLOSED / REST_SIGMA**2 * np.outer(across.T @ apart[:, i], self.at_rest)

    def _rest(self) -> np.ndarray:
        """(n, 3) metres where ψ = 0."""
        found: np.ndarray = self.begun + self.now @ self.at_rest
        return found

    def offsets(self) -> FaceOffsets:
        """What has been found; ψ = 0 is rest."""
        rest, inner = self._rest(), self.behind.any(1)
        rest[inner] = self.behind[inner] @ rest
        return FaceOffsets(self.nodes, rest, self.directions, self.now[..., 1:], eye_joints=True, gains=self.gains)


class _Sums:
    """Normal equations of all pictures, at the vertices next to the points; the points' colours are eliminated."""

    def __init__(self, place: np.ndarray, k: int) -> None:
        """`place`: (p,) which of the vertices each point is next to."""
        count = len(place)
        self.place, self.gather = place, csr_array((np.ones(count), (place, np.arange(count))))
        self.curved = np.zeros((self.gather.shape[0], 3, k, 3, k))
        self.pulled = np.zeros((len(self.curved), 3 * k))
        self.missed = np.zeros((count, 3))
        self.common, self.total = np.zeros((count, 3, 3, k)), np.full(count, 1e-9)

    def add(self, row: np.ndarray, slope: np.ndarray, off: np.ndarray, weight: np.ndarray, phi: np.ndarray) -> None:
        """A picture's: points, slopes (p, 3, 3) by channel, differences (p, 3) and weights (p,), and the frame's φ (k,)."""
        gather = self.gather[:, row]
        curved = np.einsum("p,pcx,pcy->pxy", weight, slope, slope).reshape(-1, 9)
        along = np.einsum("p,pcx,pc->px", weight, slope, off)
        self.curved += (gather @ curved).reshape(-1, 3, 1, 3, 1) * np.outer(phi, phi)[:, None]
        self.pulled += ((gather @ along)[..., None] * phi).reshape(self.pulled.shape)
        self.missed[row] += weight[:, None] * off
        self.common[row] += (weight[:, None, None] * slope)[..., None] * phi
        self.total[row] += weight

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Form (v, 3k, 3k) and pull (v, 3k). A point whose pictures all agree on a way to move is painted elsewhere, and says nothing."""
        size, flat = self.pulled.shape[1], self.common.reshape(len(self.total), 3, -1)
        mean = flat / self.total[:, None, None]
        same = np.einsum("pca,pcb->pab", flat, mean).reshape(len(flat), -1)
        form = (self.curved.reshape(len(self.curved), -1) - self.gather @ same).reshape(-1, size, size)
        return form, self.pulled - self.gather @ np.einsum("pca,pc->pa", mean, self.missed)


def _points(base: Person) -> Points:
    """Strewn over the face's skin and eyeballs, more where nodes are fine; none within the mouth."""
    body, face = base.body, base.face
    ids, faces = face.body_vertex_ids.numpy(), body.faces.numpy()
    own, inner = np.zeros(len(body.v_template), bool), np.zeros(len(body.v_template), bool)
    own[ids], inner[ids] = face.blend_weight.numpy() > 0, face.mouth.numpy()
    inner |= body.of_groups(MOUTH).numpy()
    a, b, c = (body.v_template.double().numpy()[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) * (own[faces].all(1) & ~inner[faces].any(1))
    area /= _spacing(body)[faces].mean(1) ** 2
    rng = np.random.default_rng(0)
    chosen = np.sort(rng.choice(len(faces), POINT_COUNT, p=area / area.sum()))
    share = rng.dirichlet(np.ones(3), POINT_COUNT)
    place = np.einsum("pk,pkc->pc", share, body.v_template.double().numpy()[faces[chosen]])
    centres = place[rng.choice(POINT_COUNT, PATCHES, replace=False)]
    return Points(chosen, share, cKDTree(centres).query(place)[1], LID)


def _near_on_eyes(base: Person, points: Points, radius: float) -> csr_array:
    """(p, p) 1 for two different points of eyeballs that lie within `radius` at rest, metres of the template; rows of skin are empty."""
    rest, faces = base.body.v_template.double().numpy(), base.body.faces.numpy()[points.face]
    ball = np.flatnonzero(base.body.of_groups(EYES).numpy()[faces].all(1))
    tree = cKDTree(np.einsum("pk,pkc->pc", points.share[ball], rest[faces[ball]]))
    one, other = tree.query_pairs(radius, output_type="ndarray").T
    pairs = ball[np.concatenate([one, other])], ball[np.concatenate([other, one])]
    return csr_array((np.ones(len(pairs[0])), pairs), shape=(len(points.face),) * 2)


def _clear_of_lids(sight: Seen, near: csr_array) -> Seen:
    """`sight` without points that `near` (p, p) has next to hidden ones, those that are not in `sight`: there the blur mixes lids into an
    eyeball. Where a pixel is wider than the blur (1.9 mm in the last round) it reaches farther than that."""
    hidden = np.ones(near.shape[0])
    hidden[sight[0]] = 0
    return only(sight, (near @ hidden)[sight[0]] == 0)


def _directions(expressions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k, e) in which expressions (t, e) differ most, unit, and their mean (e,)."""
    mean = expressions.mean(0)
    _, size, rows = np.linalg.svd(expressions - mean, full_matrices=False)
    return rows[:DIRECTIONS][size[:DIRECTIONS] > LEAST * np.sqrt(len(expressions))], mean


def _different(rig: Rig, frames: Sequence[int]) -> list[int]:
    """At most `FRAMES` of the frames, each as different in expression and jaw from those before as can be; where there are no more
    differences evenly spread ones. None where all are zero: then nobody tracked them, and a smile would be taken for rest.
    """
    signals = [rig.signals[frame] for frame in frames]
    driven = np.array([[*one.expression, *one.jaw_pose, *one.eye_pose.ravel()] for one in signals]).reshape(
        len(frames), -1
    )
    if not driven.any():
        return []
    chosen = [int(np.linalg.norm(driven - driven.mean(0), axis=1).argmax())]
    away = np.linalg.norm(driven - driven[chosen[0]], axis=1)
    while len(chosen) < FRAMES and away.max() > ALIKE:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(driven - driven[chosen[-1]], axis=1))
    more = [row for row in compared_frames(len(frames), FRAMES) if row not in chosen]
    return sorted(frames[row] for row in [*chosen, *more][:FRAMES])


def _spacing(body: TemplateModel) -> np.ndarray:
    """(v,) metres between nodes: less where features are small."""
    place, spacing = body.v_template.double().numpy(), np.full(len(body.v_template), SPACING)
    for names, reach in FEATURES:
        feature = body.of_groups(names).numpy()
        if feature.any():
            away = cKDTree(place[feature]).query(place)[0] - reach
            spacing = np.minimum(spacing, FINE + WIDEN * away.clip(0))
    return spacing


def _spread(body: TemplateModel, skin: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """Nodes on what moves as a whole and on the vertices `skin`, and the ways (n, n) between them along the mesh: the fronts of eyeballs,
    teeth and tongue, the tip of the nose, then each the farthest from those before, in units of the spacing there."""
    depth, spacing, edges = body.v_template.numpy()[:, 2], _spacing(body), mesh_edges(body)
    pieces = [body.of_groups([name]).numpy() for name in (*EYES, *MOUTH)]
    chosen = [int(np.where(piece, depth, -np.inf).argmax()) for piece in pieces if piece.any()]
    skin = skin[~np.any(pieces, 0)[skin]]
    chosen.append(int(skin[depth[skin].argmax()]))
    ways = [dijkstra(edges, indices=node) for node in chosen]
    away = ways[-1][skin] / spacing[skin]
    while np.where(np.isfinite(away), away, 0).max() >= 1:
        chosen.append(int(skin[np.where(np.isfinite(away), away, 0).argmax()]))
        ways.append(dijkstra(edges, indices=chosen[-1]))
        away = np.minimum(away, ways[-1][skin] / spacing[skin])
    return tuple(chosen), np.stack(ways)[:, chosen]


def _flesh(place: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n, n) 1 for two nodes with flesh between: each lies behind the other, as a cheek and the mouth's cavity, which no picture shows, do;
    lips lie before each other."""
    way = place[None] - place[:, None]
    away = np.linalg.norm(way, axis=-1)
    behind = (way * normal[:, None]).sum(-1) < -BEHIND * away
    found: np.ndarray = (behind & behind.T & (away < THICK)).astype(float)
    return found


def _lids(body: TemplateModel, nodes: tuple[int, ...]) -> np.ndarray:
    """(n, n) 1 for the node of an eyeball and one of its lids."""
    place, rows, found = body.v_template.double().numpy(), list(nodes), np.zeros((len(nodes),) * 2)
    lids, reach = ~body.of_groups(EYES).numpy()[rows], dict(FEATURES)[EYES]
    for eye in (body.of_groups([name]).numpy() for name in EYES):
        if eye.any():
            near = cKDTree(place[eye]).query(place[rows])[0] < reach
            found[np.ix_(eye[rows], near & lids)] = 1
    return found + found.T


def _behind(body: TemplateModel, nodes: tuple[int, ...]) -> np.ndarray:
    """(n, n) of a node of teeth or tongue what the skin about its row of teeth moves by, in the mean over vertices within `LIP`."""
    rest, found = body.v_template.double().numpy(), np.zeros((len(nodes),) * 2)
    rows = [body.of_groups([name]).numpy() for name in TEETH]
    if not all(row.any() for row in rows):
        return found
    weights, skin = node_weights(body, nodes), ~body.of_groups((*EYES, *MOUTH)).numpy()
    away = [cKDTree(rest[row]).query(rest)[0] for row in rows]
    for names, row, near in zip((TEETH[:1], MOUTH[1:]), rows, away):
        lip = skin & (near < LIP) & (near <= np.min(away, 0)) & (rest[:, 2] > rest[row, 2].mean())
        if lip.any():
            found[body.of_groups(names).numpy()[list(nodes)]] = weights[lip].mean(0)
    return found


def _outwards(base: Person, rows: list[int]) -> np.ndarray:
    """(n, 3) the way that the head's outer skin faces about vertices, in the mean over `SMOOTH`: lips and lids themselves face every way."""
    body, skin = base.body, base.blend_weight[:, 2].numpy() > 0
    rest, normal = body.v_template.double().numpy(), body.normals.double().numpy()
    inner = body.of_groups((*EYES, *MOUTH)).numpy()
    inner[base.face.body_vertex_ids.numpy()] |= base.face.mouth.numpy()
    outer = skin & ~inner & ((normal * (rest - rest[skin].mean(0))).sum(1) > 0)
    near = np.exp(-0.5 * cdist(rest[rows], rest[outer]) ** 2 / SMOOTH**2)
    mean = near @ normal[outer]
    found: np.ndarray = mean / np.linalg.norm(mean, axis=1, keepdims=True).clip(1e-12)
    return found


def _neighbours(ways: np.ndarray) -> np.ndarray:
    """(n, n) 1 for nodes next to each other, by `ways` (n, n) along the mesh; 2 where each is next to the other."""
    graph = np.zeros_like(ways)
    near = np.argsort(ways, 1)[:, 1 : 1 + NEIGHBOURS]
    np.put_along_axis(graph, near, np.isfinite(np.take_along_axis(ways, near, 1)).astype(float), 1)
    found: np.ndarray = graph + graph.T
    return found


def _differences(graph: np.ndarray) -> np.ndarray:
    """(n, n) whose form is Σ graph_nm (o_n − o_m)² over pairs."""
    form: np.ndarray = np.diag(graph.sum(1)) - graph
    return form
