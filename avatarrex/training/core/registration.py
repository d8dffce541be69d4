"""How what is painted slides, from the training pictures: pictures and texels are registered to each other. Ours.

    min_s Σ_p ω_p |c_p − t(p̄_p + Δ_p(s))|² + μ Σ_p ω_p |Δ_p(s)|²

over the pixels p of the pictures; t the texels, painted from all pictures with the slide of the round before; Δ is linear in s
(fields/slide.py). Each round is a step of Gauss and Newton, by conjugate gradients, from finer slopes than the last: texels that are
painted from pictures that disagree are blurred, and show the coarse shift first. ω falls with the difference (Geman–McClure), so that
shadows and what passes over the surface do not count.

Letters: p pixels, a samples, n nodes, j joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.sparse import csr_matrix, vstack
from scipy.sparse.linalg import LinearOperator, cg
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.fields.local_frame import Neighbours
from avatarrex.fields.slide import Slide, carriers, slide_basis
from avatarrex.training.core.sighting import Sighting

SLOPES = (0.008, 0.008, 0.005, 0.003, 0.002)
"""Metres between which the texels' slopes are taken, round by round."""
PIXELS = 250_000
"""Of all pictures, drawn by chance."""
STRAY = 0.1
"""Difference in sRGB at which a pixel's weight has fallen to a quarter."""
STILL = 3.0
"""μ: sRGB per metre, squared."""
STEPS = 40
"""Of conjugate gradients in a round."""


@torch.no_grad()
def register(avatar: Avatar, sightings: Sequence[Sighting], paint: Callable[[], None], seed: int = 0) -> None:
    """Let the body's slide be that with which the pictures agree; `paint` makes the texels anew, with what has been found."""
    body = avatar.body
    body.add_slide(Slide.none(len(body.node_vertex)).share)
    assert body.slide is not None
    joints = avatar.person.body.joint_template
    mask = carriers(avatar.person.body.v_template[body.node_vertex], joints).numpy()
    pixels = _Pixels(avatar, sightings, np.random.default_rng(seed))
    for slope in SLOPES:
        paint()
        share = body.slide.share.cpu().numpy() + mask * pixels.step(avatar, slope, mask)
        body.slide.share.copy_(torch.from_numpy(share))


class _Pixels:
    """Some of the pictures' pixels, with what moves them."""

    def __init__(self, avatar: Avatar, sightings: Sequence[Sighting], rng: np.random.Generator) -> None:
        body = avatar.body
        assert body.slide is not None
        count = max(PIXELS // len(sightings), 1)
        near = body.slide.reach.cpu().numpy()
        nodes = csr_matrix(np.where(near > 1e-3, near, 0))
        self.parts, reach, basis = [], [], []
        for one in sightings:
            rows = torch.from_numpy(rng.permutation(len(one.position))[:count])
            samples = one.samples
            moves = slide_basis(samples.rest_from_posed, one.posed.body.skinning, samples.rest)
            carried = _matrix(one.beside.rows(rows), len(samples.rest))
            self.parts.append((one, rows))
            reach.append(carried @ nodes)
            basis.append((carried @ moves.flatten(1).numpy()).reshape(-1, *moves.shape[1:]))
        self.reach = vstack(reach).tocsr()
        self.basis = np.concatenate(basis)

    def step(self, avatar: Avatar, slope: float, mask: np.ndarray) -> np.ndarray:
        """What to add to s."""
        residual, jacobian = (
            np.concatenate(each) for each in zip(*(self._seen(avatar, *one, slope) for one in self.parts))
        )
        weight = residual[:, -1] / (1 + np.square(residual[:, :3]).mean(1) / STRAY**2) ** 2
        normal = weight[:, None, None] * (jacobian.transpose(0, 2, 1) @ jacobian + STILL * np.eye(3, dtype=np.float32))
        assert avatar.body.slide is not None
        now = self.moved(avatar.body.slide.share.cpu().numpy())
        target = np.einsum("pck,pc->pk", jacobian, residual[:, :3]) - STILL * now
        right = (mask * self.gathered(weight[:, None] * target)).ravel()

        def product(values: np.ndarray) -> np.ndarray:
            moved = self.moved(values.reshape(mask.shape) * mask)
            pulled = mask * self.gathered(np.einsum("pkc,pc->pk", normal, moved))
            found: np.ndarray = pulled.ravel() + 1e-3 * values.ravel()
            return found

        system = LinearOperator((mask.size, mask.size), matvec=product, dtype=np.float32)
        found: np.ndarray = cg(system, right, rtol=1e-3, maxiter=STEPS)[0].reshape(mask.shape).astype(np.float32)
        return found

    def moved(self, share: np.ndarray) -> np.ndarray:
        """Δ (p, 3)."""
        found: np.ndarray = np.einsum("pj,pjc->pc", self.reach @ share, self.basis)
        return found

    def gathered(self, pull: np.ndarray) -> np.ndarray:
        """`moved` transposed: (p, 3) onto (n, j)."""
        found: np.ndarray = self.reach.T @ np.einsum("pjc,pc->pj", self.basis, pull)
        return found

    @staticmethod
    def _seen(avatar: Avatar, one: Sighting, rows: Tensor, slope: float) -> tuple[np.ndarray, np.ndarray]:
        """(p, 4) c − t and weights, (p, 3, 3) slopes of t's channels."""
        detail = avatar.body.detail
        assert detail is not None
        samples, beside = one.slid(avatar), one.beside.rows(rows)
        rest = samples.painted_position(one.position[rows], beside)
        albedo = (one.colour[rows] / avatar.light(samples.facing(beside))).clamp(0, 1)

        def texel(offset: Tensor) -> Tensor:
            return torch.sigmoid(detail(detail.places(rest + offset)))

        steps = slope * torch.eye(3)
        jacobian = torch.stack([(texel(step) - texel(-step)) / (2 * slope) for step in steps], -1)
        residual = albedo - texel(torch.zeros(3))
        return torch.cat([residual, one.weight[rows, None]], 1).numpy(), jacobian.numpy()


def _matrix(beside: Neighbours, samples: int) -> csr_matrix:
    """(p, a): means over the samples that carry pixels."""
    index, weight = beside.index.numpy(), beside.weight.numpy()
    starts = np.arange(0, index.size + 1, index.shape[1])
    return csr_matrix((weight.ravel(), index.ravel(), starts), shape=(len(index), samples))
