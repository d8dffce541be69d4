"""What a surface has to reproduce: where each vertex is on the exact surface of a pose, as a change of its rest position, and its albedo.

Letters: v vertices. Metres at rest; colours sRGB-encoded with the light divided out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.sparse import csr_array
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.avatar import Avatar
from avatarrex.distil.exact import ExactPose
from avatarrex.distil.fit import Residuals
from avatarrex.distil.follow import Followed, follow, skinning
from avatarrex.distil.gaps import filled, tension
from avatarrex.distil.onto_field import ON_SURFACE, met_from, onto_field
from avatarrex.distil.pattern import SLOPE, Pattern, neighbourhoods, sample_places, tangents
from avatarrex.distil.rest_mesh import RestMesh
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.parts import PARTS

SLIDES = 2
"""Steps of `Pattern.slide`; a third changes the albedo's error by 2 %."""
STEADYING = 2
"""Means over the neighbours, some 5 mm each on hands and face, 1.3 cm on the body."""
SOFTENINGS = 12
"""Means over the neighbours of skin weights, some 4 cm."""
SPREAD = 12
"""Triangles by which what is hidden goes with the skin around it: lips are some six deep."""
LIPS = 4
"""Triangles from the mouth to the edge of the lips, some 2 mm each."""
TRUSTED = 0.05
"""Metres that a pattern may have slid at most in a sum of steps."""


@dataclass(frozen=True)
class Observation:
    """One pose."""

    guess: Float[np.ndarray, "v 3"]
    """Change of the rest position that skinning takes to where skin or template has the vertex."""
    shift: Float[np.ndarray, "v 3"]
    """Change of the rest position that skinning takes onto the exact surface."""
    albedo: Float[np.ndarray, "v 3"]
    found: Bool[np.ndarray, " v"]


class Observer:
    """Observes an avatar's poses on one mesh; patterns are followed from the standing pose."""

    def __init__(self, avatar: Avatar, mesh: RestMesh) -> None:
        self.avatar, self.mesh = avatar, mesh
        self.faces = torch.as_tensor(mesh.faces.astype(np.int64))
        self.lit = self._lit()
        self.pattern: Pattern | None = None
        self.neutral: Observation | None = None
        self.own = mesh.part > 0
        self.smooth = neighbourhoods(mesh.faces[:0], mesh.faces.astype(np.int64), len(mesh.vertices))[1]
        self._tension = tension(mesh.faces, len(mesh.vertices))
        self._weights = self._sharp_and_soft()
        self.lips, self.eyes = self._lips(), self._eyes()
        self.pattern = self._reference()
        neutral = self.observe(Signals.rest())
        self.neutral = replace(neutral, shift=neutral.guess + self._around(neutral.shift - neutral.guess))

    def observe(self, signals: Signals) -> Observation:
        """The vertices under `signals`."""
        exact, followed = self.follow(signals)
        back = followed.matrix[:, :, :3].inverse()
        guess, shift = (
            (back @ (place - followed.skinned)[:, :, None])[:, :, 0].numpy()
            for place in (followed.start, followed.position)
        )
        if self.neutral is not None:
            shift = np.where(self.own[:, None], self._steady(guess, shift, followed.found.numpy()), shift)
        albedo = exact.colour(followed.position, followed.gaze) / self.light(followed)
        return Observation(guess, shift, albedo.numpy(), followed.found.numpy())

    def _steady(self, guess: np.ndarray, shift: np.ndarray, found: np.ndarray) -> np.ndarray:
        """The template's own motion, and how the skin's offset from it differs from the neutral pose: smooth along the skin.

        Flesh that opens or closes makes single vertices jump onto another sheet of the surface; a mean of neighbours does not.
        """
        assert self.neutral is not None
        offset = (shift - guess) - (self.neutral.shift - self.neutral.guess)
        known = found & self.neutral.found & ~self.mesh.inner
        offset = self._around(mean_of_known(offset, known, self.smooth, STEADYING))
        return np.asarray(guess + (self.neutral.shift - self.neutral.guess) + offset)

    def _around(self, offset: np.ndarray) -> np.ndarray:
        return from_skin_around(offset, self.mesh.inner, self.smooth)

    def moved(self, observation: Observation) -> np.ndarray:
        """(v, 3): how the shift of an expression differs from the neutral face's.

        The throat's skin has no template that an open jaw takes along: single vertices of the cubes go along their normals to where the
        jaw's surface happens to be, centimetres or nothing. The mean of neighbours goes with the jaw as far as the skin around does.
        """
        assert self.neutral is not None
        change = observation.shift - self.neutral.shift
        known = observation.found & self.neutral.found & ~self.mesh.inner
        return np.where(self.own[:, None], change, mean_of_known(change, known, self.smooth, STEADYING))

    def tinted(self, observation: Observation) -> np.ndarray:
        """(v, 3): how the albedo differs from the neutral face's, mean of the neighbours that were found in both.

        0 where none was; on eyes, whose texture turns with them; in the mouth, whose texture is that of the open one; and on the
        lips, which open wider or less than those of the template: what is seen at a lip's vertex may be skin or teeth.
        """
        assert self.neutral is not None
        known = observation.found & self.neutral.found & ~self.mesh.inner
        tint = mean_of_known(observation.albedo - self.neutral.albedo, known, self.smooth, 1)
        return np.where((self.lips | self.mesh.inner)[:, None], 0, tint)

    def residuals(self, signals: list[Signals], seen: list[Observation], albedo: Float[np.ndarray, "v 3"]) -> Residuals:
        """What skinning with the texture's `albedo` misses; places of hands and face are always known, by their templates.

        Eyes and mouth have no other colours than the texture's.
        """
        place = np.stack([self._without_gaps(*both) for both in zip(signals, seen)])
        tint = np.stack([np.where(self.mesh.inner[:, None], 0, one.albedo - albedo) for one in seen])
        return Residuals(signals, np.concatenate([place, tint], 2), np.stack([one.found for one in seen]))

    def _without_gaps(self, signals: Signals, one: Observation) -> np.ndarray:
        """(v, 3) `shift`, what was not found in the place that lies most smoothly between what was.

        Smoothly as it differs from skinning by weights without steps: at the crotch neighbours are skin of either leg in turns.
        """
        known, rest = one.found | self.own, self.mesh.vertices
        matrices = skinning(self.avatar.person, signals)[:, :3].reshape(-1, 12).numpy()
        sharp, soft = ((weight @ matrices).reshape(-1, 3, 4) for weight in self._weights)
        base = _placed(soft, rest)
        posed = base + filled(_placed(sharp, rest + one.shift) - base, known, self._tension)
        shift = np.linalg.solve(sharp[:, :, :3], (posed - sharp[:, :, 3])[:, :, None])[:, :, 0] - rest
        return np.where(known[:, None], one.shift, shift)

    def follow(self, signals: Signals) -> tuple[ExactPose, Followed]:
        """The exact pose and the vertices on it, where their colours are."""
        exact = ExactPose.of(self.avatar, signals)
        followed = follow(self.avatar, self.mesh, exact, signals)
        if self.pattern is None:
            return exact, followed
        return exact, self._slid(exact, followed, self.pattern)

    def open_mouth(self, signals: Signals) -> tuple[ExactPose, Followed]:
        """The same, what the lips enclose as it is seen from between them: the field's mouth is shallower than the template's."""
        exact, followed = self.follow(signals)
        mouth = torch.as_tensor(self.mesh.mouth)
        if not mouth.any():
            return exact, followed
        rim = torch.as_tensor(self.smooth @ self.mesh.mouth.astype(float) > 0) & ~mouth
        return exact, seen_between(exact.field.sdf, followed, mouth, rim)

    def light(self, followed: Followed) -> Float[Tensor, "v 3"]:
        """What the albedo is multiplied by in that pose: of the mesh's own normals, as it is drawn."""
        with torch.no_grad():
            return self.avatar.light.over(np.eye(4)).mixed(normalize(followed.normal, dim=-1), self.lit)

    def _slid(self, exact: ExactPose, followed: Followed, pattern: Pattern) -> Followed:
        share = exact.field(followed.position).part_weight
        trusted = pattern.at(followed.found[:, None].float())[:, 0]
        linear, moved = followed.matrix[:, :, :3], followed
        for _ in range(SLIDES):
            step = pattern.slide(self._albedo(exact, moved, pattern, share), trusted)
            position = moved.position + (linear @ step[:, :, None])[:, :, 0]
            moved = replace(moved, position=position, normal=vertex_normals(position, self.faces))
        slid = (moved.position - followed.position).norm(dim=-1) > 0
        most = torch.where(slid, TRUSTED, 0.0)
        position, missed = onto_field(exact, moved.position, self.faces, most)
        found = followed.found & ((missed < ON_SURFACE) | ~slid)
        return replace(followed, position=position, normal=vertex_normals(position, self.faces), found=found)

    def _albedo(
        self, exact: ExactPose, followed: Followed, pattern: Pattern, share: Tensor, offset: Tensor | float = 0.0
    ) -> Float[Tensor, "s 3"]:
        """At the pattern's samples, moved by `offset` (s, 3)."""
        position = pattern.at(followed.position) + offset
        gaze = -normalize(pattern.at(followed.normal), dim=-1)
        with torch.no_grad():
            colour = exact.colours.colour(position, gaze, pattern.at(share)).clamp(0, 1)
        return colour / pattern.at(self.light(followed))

    def _reference(self) -> Pattern:
        """The pattern of the standing pose."""
        mesh = self.mesh
        faces = mesh.faces[(mesh.part[mesh.faces] == 0).all(1)]
        corner, barycentric = sample_places(faces)
        gather, smooth = neighbourhoods(corner.numpy(), faces.astype(np.int64), len(mesh.vertices))
        nothing = torch.zeros(len(corner), 3)
        blank = Pattern(corner, barycentric, nothing, torch.zeros(len(corner), 3, 3), gather, smooth)
        exact, followed = self.follow(Signals.rest().replace(body_pose=named_pose("stand")))
        share = exact.field(followed.position).part_weight
        ways = tangents(followed.position, corner)
        slopes = []
        for k in range(2):
            ahead, back = (
                self._albedo(exact, followed, blank, share, side * SLOPE * ways[:, k]) for side in (1.0, -1.0)
            )
            slopes.append((ahead - back) / (2 * SLOPE))
        slope = torch.stack(slopes, -1) @ tangents(torch.as_tensor(mesh.vertices), corner)
        return replace(blank, albedo=self._albedo(exact, followed, blank, share), slope=slope)

    def _sharp_and_soft(self) -> tuple[np.ndarray, np.ndarray]:
        """(v, j) skin weights of the mesh, and means of them over the neighbours."""
        sharp = np.zeros((len(self.mesh.vertices), self.avatar.person.body.weights.shape[1]))
        np.put_along_axis(sharp, self.mesh.joint.astype(int), self.mesh.weight, 1)
        soft = sharp
        for _ in range(SOFTENINGS):
            soft = self.smooth @ soft
        return sharp, soft

    def _lips(self) -> Bool[np.ndarray, " v"]:
        """The mouth, and what is few triangles from it."""
        near = self.mesh.mouth.astype(float)
        for _ in range(LIPS):
            near = self.smooth @ near
        return np.asarray(near > 0)

    def _eyes(self) -> Bool[np.ndarray, " v"]:
        groups = self.avatar.person.body.groups
        of_template = [groups[name].numpy() for name in ("left_eye", "right_eye") if name in groups]
        return np.isin(self.mesh.template_vertex, np.concatenate([*of_template, np.zeros(0, int)]))

    def _lit(self) -> Float[Tensor, " v"]:
        """1 − ω of the face, which has a light of its own."""
        signals = Signals.rest()
        exact = ExactPose.of(self.avatar, signals)
        followed = follow(self.avatar, self.mesh, exact, signals)
        share = exact.field(followed.position).part_weight[:, PARTS.index("face")]
        share[torch.as_tensor(self.mesh.part == PARTS.index("face") + 1)] = 1
        return 1 - share.clamp(0, 1)


def _placed(matrix: Float[np.ndarray, "v 3 4"], rest: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    return np.asarray(np.einsum("vab,vb->va", matrix[:, :, :3], rest) + matrix[:, :, 3])


def mean_of_known(
    value: Float[np.ndarray, "v 3"], known: Bool[np.ndarray, " v"], smooth: csr_array, rounds: int
) -> Float[np.ndarray, "v 3"]:
    """`value` as the mean of the neighbours, `rounds` times, of those that are `known`; 0 where none is near.

    `smooth` (v, v) takes the mean of neighbours.
    """
    weight = known[:, None].astype(float)
    total = weight * value
    for _ in range(rounds):
        total, weight = smooth @ total, smooth @ weight
    return np.asarray(total / np.maximum(weight, 1e-3))


def from_skin_around(
    offset: Float[np.ndarray, "v 3"], inner: Bool[np.ndarray, " v"], smooth: csr_array
) -> Float[np.ndarray, "v 3"]:
    """`offset`, on what is `inner` that of the skin around it, 0 where no skin is within `SPREAD` triangles: eyes and teeth hang on none.

    `smooth` (v, v) takes the mean of neighbours.
    """
    skin = ~inner[:, None]
    weight, kept = skin.astype(float), np.where(skin, offset, 0)
    for _ in range(SPREAD):
        weight, near = smooth @ (weight > 0), smooth @ kept
        kept = np.where(skin, kept, near / np.maximum(weight, 1e-9))
    return np.asarray(kept)


def seen_between(
    sdf: Callable[[Tensor], Tensor], followed: Followed, mouth: Bool[Tensor, " v"], rim: Bool[Tensor, " v"]
) -> Followed:
    """The vertices of the `mouth` where a gaze at them from amid its `rim` meets the field, as far in front as the rim reaches. Their
    normals are turned to where that gaze comes from: they are coloured and lit so, for the mesh's own face each other."""
    around = followed.position[rim]
    eye = torch.cat([around.mean(0)[:2], around[:, 2].amax()[None]])
    position, normal, broad = followed.position.clone(), followed.normal.clone(), followed.broad.clone()
    position[mouth] = met_from(sdf, eye, position[mouth])
    normal[mouth], broad[mouth] = normalize(eye - position[mouth], dim=-1), 0.0
    return replace(followed, position=position, normal=normal, found=followed.found | mouth, broad=broad)
