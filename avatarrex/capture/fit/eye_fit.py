"""Lids and eyeballs of a fitted face, by drawing them. Ours.

Where a lid ends a blurred picture shows half lid, half eyeball: points alone (face_fit.py) leave lids a pixel off. Here the mesh about an
eye is drawn as a camera sees it, `SAMPLES`² samples a pixel, and offsets x of the nodes about it are sought with which it looks the same:

    min_{x,t,g}  Σ_p ω_p |c_p − g Σ_s t(s) / SAMPLES²|²

with t colours at the corners of the mesh, whose triangles are divided, g a picture's gain by channel, and x at rest: what expressions move
stays, for what is drawn right in one expression may be wrong in the next. Each round finds t, as even as neighbours may be, and g where
the surface is, then takes a step of Gauss and Newton in x, damped by |δx|² σ_c²/σ². A drawn picture I changes by −∇I · u as the surface
moves by u (Loper and Black, OpenDR, 2014); beside a lid an eyeball's pixel changes as the lid moves.

Letters: p pixels, s samples, t corners, v vertices, f triangles, n nodes. Metres; sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array, diags_array, eye_array, vstack
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from torch import Tensor
from tqdm import tqdm

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import posed_in_world
from avatarrex.capture.fit.paint import Posed, trust
from avatarrex.capture.fit.photo import OPAQUE, Photo
from avatarrex.capture.zbuffer import NEAREST_DEPTH, visible_faces
from avatarrex.ops.skinning import blend
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.face_offsets import node_weights
from avatarrex.templates.model import EYES, TemplateModel
from avatarrex.templates.person import Person, load_person, resize_person

DRAWN = 0.02
"""Metres from the middle of an eye: lids and the skin around them."""
HALVED = 2
"""Times that the edges of its triangles are halved: corners 0.8 mm apart."""
NEAR = 0.007
"""Metres from an eyeball up to which nodes move."""
SAMPLES = 2
"""Along each side of a pixel."""
BESIDE = 1.5
"""Pixels from skin up to which a pixel of an eyeball changes as that moves."""
ROUNDS = 10
PAINTED = 3
"""Times that colours, gains and weights are found in a round."""
STRENGTH = 400.0
"""1/σ_c², σ_c = 0.05 sRGB."""
SIGMA = 0.0002
"""σ of a step of x, each way."""
EVEN = 1e-3
"""Weight of the squared difference of two neighbouring corners; that of a pixel is 1 at most."""
LEAST = 30
"""Pixels of an eye in a picture that counts."""
DARKEST, BRIGHTEST = 0.5, 2.0
"""Gains are at least and at most this, before they are divided by their mean."""


def fit_eyes(person: Person, posed: Sequence[Posed]) -> Person:
    """`person`, whose face has been fitted, with the surroundings of its eyes as the pictures show them; as it is without eyeballs or such
    a face. What reading a picture raises is raised."""
    base = load_person(person.name)
    eyes = [eye for eye in EYES if eye in base.body.groups]
    if not eyes or person.fit is None or person.fit.face is None:
        return person
    shown = [(signals, [_Picture.of(photo) for photo in photos]) for signals, photos in posed]
    with tqdm(total=ROUNDS * len(eyes), desc="fit eyes", unit="round", leave=False) as bar:
        for eye in eyes:
            mesh = _Mesh.about(base.body, eye)
            near = _near(base.body, eye, person.fit.face.vertices)
            weights = mesh.share @ node_weights(base.body, person.fit.face.vertices)[:, near].toarray()
            for _ in range(ROUNDS):
                views = [view for moment in shown for view in _views(person, mesh, weights, *moment)]
                if views and len(near):
                    person = _moved(base, person, near, _step(mesh, views).reshape(-1, 3))
                bar.update()
    return person


@dataclass(frozen=True, eq=False)
class _Mesh:
    """The body, whose triangles about an eye are drawn, divided; the others may hide them."""

    share: csr_array
    """(t, v) the corners, as means of the body's vertices."""
    faces: np.ndarray
    """(f, 3) corners; those that are drawn first, then the others, by t + vertex."""
    drawn: int
    """How many are drawn."""
    ball: np.ndarray
    """(f,) of the drawn: whether they are the eyeball's."""
    uneven: csr_array
    """(t, t) whose form is Σ |t_a − t_b|² over edges."""

    @classmethod
    def about(cls, body: TemplateModel, eye: str) -> _Mesh:
        """Of the original body."""
        rest, faces, ball = body.v_template.double().numpy(), body.faces.numpy(), body.of_groups([eye]).numpy()
        away = np.linalg.norm(rest - rest[ball].mean(0), axis=1)
        inner = (away < DRAWN)[faces].all(1)
        used, fine = np.unique(faces[inner], return_inverse=True)
        share, fine = eye_array(len(rest)).tocsr()[used], fine.reshape(-1, 3)
        of_ball = ball[faces[inner]].all(1)
        for _ in range(HALVED):
            share, fine = _halved(share, fine)
            of_ball = np.tile(of_ball, 4)
        count = share.shape[0]
        whole = np.concatenate([fine, faces[~inner] + count])
        return cls(share, whole, len(fine), of_ball, _unevenness(fine, count))


@dataclass(frozen=True, eq=False)
class _Picture:
    """A photo at the size at which it is compared."""

    camera: Camera
    colour: np.ndarray
    """(h, w, 3) bytes."""
    solid: np.ndarray
    """(h, w) bool: where the person alone is."""

    @classmethod
    def of(cls, photo: Photo) -> _Picture:
        """What reading it raises is raised."""
        camera, colour, matte = photo.small()
        return cls(camera, colour, matte >= OPAQUE)


@dataclass(frozen=True, eq=False)
class _View:
    """What one picture shows of an eye."""

    colour: np.ndarray
    """(p, 3) of the pixels that show nothing else."""
    place: tuple[np.ndarray, np.ndarray]
    """(p,) rows and columns of the pixels, in a window of the picture."""
    shape: tuple[int, int]
    """Of the window, pixels."""
    matrix: csr_array
    """(p, t) share of each corner in a pixel's colour."""
    moves: np.ndarray
    """(p, n, 2, 3) pixels per metre: how what a pixel shows moves in the picture as a node moves."""

    def jacobian(self, drawn: np.ndarray) -> np.ndarray:
        """(p, 3, 3 n) of the `drawn` colours (p, 3): how they change as nodes move, by channel."""
        window = np.zeros((*self.shape, 3))
        window[self.place] = drawn
        inside = np.zeros(self.shape, bool)
        inside[self.place] = True
        near = distance_transform_edt(~inside, return_distances=False, return_indices=True)
        slopes = np.gradient(window[tuple(near)], axis=(1, 0))
        slope = np.stack([one[self.place] for one in slopes], -1)
        found: np.ndarray = -np.einsum("pcu,pnux->pcnx", slope, self.moves).reshape(len(drawn), 3, -1)
        return found


def _near(body: TemplateModel, eye: str, nodes: tuple[int, ...]) -> np.ndarray:
    """(n,) which of the nodes lie within `NEAR` of an eyeball."""
    rest = body.v_template.double().numpy()
    found: np.ndarray = np.flatnonzero(cKDTree(rest[body.of_groups([eye]).numpy()]).query(rest[list(nodes)])[0] < NEAR)
    return found


def _moved(base: Person, person: Person, near: np.ndarray, by: np.ndarray) -> Person:
    """`person` with some nodes of its face moved at rest by (n, 3) metres; `base`: in the template's size."""
    assert person.fit is not None
    assert person.fit.face is not None
    rest = np.array(person.fit.face.rest)
    rest[near] += by
    return resize_person(base, replace(person.fit, face=replace(person.fit.face, rest=rest)))


def _step(mesh: _Mesh, views: Sequence[_View]) -> np.ndarray:
    """x (3 n,) of one round."""
    form: np.ndarray = np.zeros(())
    pull: np.ndarray = np.zeros(())
    for one, gain, weight, colour in zip(views, *_painted(mesh, views)):
        jacobian = one.jacobian(gain * colour)
        weighed = weight[:, None, None] * jacobian
        form = form + np.einsum("pca,pcb->ab", weighed, jacobian)
        pull = pull + np.einsum("pca,pc->a", weighed, one.colour - gain * colour)
    found: np.ndarray = np.linalg.solve(STRENGTH * form + np.eye(len(form)) / SIGMA**2, STRENGTH * pull)
    return found


def _painted(mesh: _Mesh, views: Sequence[_View]) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Gains (3,) of the pictures, and weights (p,) and colours without the gain (p, 3) of their pixels."""
    gains, weights = [np.ones(3) for _ in views], [np.ones(len(one.colour)) for one in views]
    for _ in range(PAINTED):
        form, right = EVEN * mesh.uneven + 1e-6 * eye_array(len(mesh.uneven.indptr) - 1), 0
        for one, gain, weight in zip(views, gains, weights):
            form = form + one.matrix.T @ diags_array(weight) @ one.matrix
            right = right + one.matrix.T @ (weight[:, None] * one.colour / gain)
        colours = splu(form.tocsc()).solve(right)
        drawn = [one.matrix @ colours for one in views]
        gains = [_gain(*each) for each in zip(drawn, views, weights)]
        common = np.mean(gains, 0)
        gains, drawn = [gain / common for gain in gains], [common * shown for shown in drawn]
        weights = [trust(one.colour - gain * shown) for one, gain, shown in zip(views, gains, drawn)]
    return gains, weights, drawn


def _gain(drawn: np.ndarray, one: _View, weight: np.ndarray) -> np.ndarray:
    """(3,) by which `drawn` colours are nearest to the picture's."""
    found: np.ndarray = (weight @ (drawn * one.colour)) / np.maximum(weight @ drawn**2, 1e-9)
    return found.clip(DARKEST, BRIGHTEST)


def _views(
    person: Person, mesh: _Mesh, weights: np.ndarray, signals: Signals, pictures: Sequence[_Picture]
) -> list[_View]:
    """The eye in each of a moment's pictures that shows enough of it; `weights` (t, n) of the nodes at the corners."""
    posed, world = posed_in_world(person, signals)
    turn = world[:3, :3] @ blend(posed.skinning, _carried(person)).double().numpy()[:, :3, :3]
    vertices = posed.vertices.double().numpy() @ world[:3, :3].T + world[:3, 3]
    place = np.concatenate([mesh.share @ vertices, vertices])
    turns = (mesh.share @ turn.reshape(-1, 9)).reshape(-1, 3, 3)
    seen = (_view(mesh, place, weights, turns, picture) for picture in pictures)
    return [one for one in seen if one is not None]


def _carried(person: Person) -> Tensor:
    """(v, j) skinning weights by which offsets turn. An eyeball whose joint takes its offset along moves with the head, whatever its gaze."""
    weights = person.body.weights.clone()
    if person.fit is not None and person.fit.face is not None and person.fit.face.eye_joints:
        for eye in EYES:
            joint = JOINT_NAMES.index(eye)
            weights[:, int(person.body.parents[joint])] += weights[:, joint]
            weights[:, joint] = 0
    return weights


def _view(mesh: _Mesh, place: np.ndarray, weights: np.ndarray, turns: np.ndarray, picture: _Picture) -> _View | None:
    """Of a posed mesh (its `place`s, world metres) and the corners' `weights` and `turns` (t, 3, 3); None where little is seen."""
    count = len(turns)
    pixel, depth = picture.camera.pixels(place[:count])
    left, top = np.maximum(np.floor(pixel.min(0)), 0).astype(int)
    right, bottom = np.minimum(np.ceil(pixel.max(0)), (picture.camera.width, picture.camera.height)).astype(int)
    if depth.min() < NEAREST_DEPTH or right < left + 2 or bottom < top + 2:
        return None
    width, height = int(right - left), int(bottom - top)
    fine = picture.camera.cropped(int(left), int(top), width, height).resized(width * SAMPLES, height * SAMPLES)
    face, share, _ = visible_faces(place, mesh.faces, fine)
    drawn = (face >= 0) & (face < mesh.drawn)
    whole = drawn.reshape(height, SAMPLES, width, SAMPLES).all((1, 3)) & picture.solid[top:bottom, left:right]
    row, column = np.nonzero(whole)
    if len(row) < LEAST:
        return None
    at = _carriers(face, drawn, mesh.ball, row, column)
    corner, part = mesh.faces[face[at]], share[at]
    flow = fine.slopes(np.einsum("pk,pkx->px", part, place[corner])) / SAMPLES
    flow = flow @ np.einsum("pk,pkxy->pxy", part, turns[corner])
    moves = np.einsum("pk,pkn->pn", part, weights[corner])[:, :, None, None] * flow[:, None]
    colour = picture.colour[top:bottom, left:right][whole] / 255
    return _View(colour, (row, column), (height, width), _matrix(mesh, face, share, whole, count), moves)


def _carriers(
    face: np.ndarray, drawn: np.ndarray, ball: np.ndarray, row: np.ndarray, column: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The sample with which each pixel moves: the one beside its middle; where that is an eyeball's and skin is within `BESIDE`, the
    nearest of that."""
    at = row * SAMPLES + SAMPLES // 2, column * SAMPLES + SAMPLES // 2
    skin = drawn.copy()
    skin[drawn] = ~ball[face[drawn]]
    away, (y, x) = distance_transform_edt(~skin, return_indices=True)
    beside = ~skin[at] & (away[at] <= BESIDE * SAMPLES)
    return np.where(beside, y[at], at[0]), np.where(beside, x[at], at[1])


def _matrix(mesh: _Mesh, face: np.ndarray, share: np.ndarray, whole: np.ndarray, count: int) -> csr_array:
    """(p, t) of the `whole` pixels: means of their samples."""
    number = np.full(whole.shape, -1)
    number[whole] = np.arange(whole.sum())
    sample = number.repeat(SAMPLES, 0).repeat(SAMPLES, 1)
    counts = sample >= 0
    place = sample[counts].repeat(3), mesh.faces[face[counts]].ravel()
    return csr_array((share[counts].ravel() / SAMPLES**2, place), shape=(int(whole.sum()), count))


def _halved(share: csr_array, faces: np.ndarray) -> tuple[csr_array, np.ndarray]:
    """Corners (t, v) and triangles with each edge halved: the first triangles, then the others, of each of the old."""
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], -1).reshape(-1, 2)
    edges, which = np.unique(ends, axis=0, return_inverse=True)
    ab, bc, ca = (which.reshape(-1, 3) + share.shape[0]).T
    a, b, c = faces.T
    middle = 0.5 * (share[edges[:, 0]] + share[edges[:, 1]])
    divided = [np.stack(each, 1) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return vstack([share, middle]).tocsr(), np.concatenate(divided)


def _unevenness(faces: np.ndarray, count: int) -> csr_array:
    """(t, t) whose form is Σ |t_a − t_b|² over edges."""
    ends = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    graph = graph + graph.T
    return (diags_array(graph.sum(1)) - graph).tocsr()
