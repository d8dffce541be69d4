"""Where the body's surface is, and how what is painted slides on it: training pictures and texels are registered to each other. Ours.

    min_{s, δ} Σ_p ω_p (|c_p − t(p̄_p + Δ_p(s) + δ_p q_p)|² + μ |Δ_p(s)|² + ν δ_p²) + κ Σ_e ω_e (m_e − δ_e)² + λ Σ_ab (δ_a − δ_b)²

over the pixels p of the pictures and the borders e of their silhouettes, which end m_e short of the mattes (silhouette.py); t the
texels, painted from all pictures with what the round before found; Δ is linear in s (fields/slide.py). δ is the relief
(`BodyField.raise_surface`): a pixel's ray meets a surface that stands δ_p higher δ_p q_p further along the skin. This parallax differs
from camera to camera, a slide does not. Each round is a step of Gauss and Newton, by conjugate gradients, from finer slopes than the
last: texels that are painted from pictures that disagree are blurred, and show the coarse shift first. ω falls with the difference
(Geman–McClure), so that shadows and what passes over the surface do not count, nor a border that another thing hides.

Letters: p pixels, e pixels of borders, a b samples, n nodes, j joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.fields.local_frame import Neighbours
from avatarrex.fields.slide import Slide, carriers, slide_basis
from avatarrex.training.core.sighting import Sighting
from avatarrex.training.core.silhouette import Silhouette

SLOPES = (0.008, 0.008, 0.008, 0.005, 0.005, 0.003, 0.003, 0.002, 0.002)
"""Metres between which the texels' slopes are taken, round by round."""
PIXELS = 600_000
"""Of all pictures, drawn by chance."""
STRAY = 0.1
"""Difference in sRGB at which a pixel's weight has fallen to a quarter."""
STILL, LEVEL = 3.0, 0.3
"""μ and ν: sRGB per metre, squared."""
SMOOTH = 3.0
"""λ for each pixel that a sample has: sRGB per metre, squared."""
BESIDE = 6
"""Neighbours of a sample that rise as it does."""
RISE = 0.1
"""Metres of relief that conjugate gradients take as they take a share of 1."""
STEPS = 40
"""Of conjugate gradients in a round."""
SILHOUETTE = 500.0
"""κ for each pixel of the pictures, shared by those of all borders: sRGB per metre, squared. A tenth: 0.1 dB less (docs/training.md)."""
BORDER_STRAY = 0.005
"""Metres off the matte at which a border pixel's weight has fallen to a quarter."""
HIGHEST = 0.02
"""Metres that the surface rises or sinks: as far as cloth may stand off (`CLOTH` in fields/body.py)."""


@torch.no_grad()
def register(
    avatar: Avatar,
    sightings: Sequence[Sighting],
    silhouettes: Sequence[Silhouette],
    paint: Callable[[Sequence[Sighting]], None],
    slides: bool,
    rises: bool,
) -> None:
    """Let the body's slide, where it `slides`, and its relief, where it `rises`, be those with which the pictures agree.

    `paint` makes the texels anew, with the slide that has been found, from the sightings that it is given: they lie where the relief is.
    """
    body = avatar.body
    body.add_slide(Slide.none(len(body.node_vertex)).share)
    assert body.slide is not None
    pixels = _Pixels(avatar, sightings, silhouettes, slides, rises)
    height = torch.zeros(len(body.sample_anchor))
    hung = len(body.sample_rest) - len(height)  # anchors of an outgrowth, which has no relief
    for slope in SLOPES:
        paint(sightings)
        share, rise = pixels.step(avatar, sightings, height.numpy(), slope)
        body.slide.share.add_(share)
        rise = (height + rise).clamp(-HIGHEST, HIGHEST) - height
        height += rise
        rise = torch.nn.functional.pad(rise, (0, hung))
        sightings = [one.raised(one.beside.mean(rise[:, None])[:, 0]) for one in sightings]
    if rises:
        body.raise_surface(height)
    if not slides:
        body.slide = None


class _Pixels:
    """Some of the sightings' pixels, with what moves them: the slide's joints along `basis`, the relief along `parallax`, metres at rest."""

    def __init__(
        self,
        avatar: Avatar,
        sightings: Sequence[Sighting],
        silhouettes: Sequence[Silhouette],
        slides: bool,
        rises: bool,
    ) -> None:
        rng = np.random.default_rng(0)
        body = avatar.body
        assert body.slide is not None
        self.mask = slides & carriers(body.node_rest, avatar.person.body.joint_template).cpu().numpy()
        count = max(PIXELS // len(sightings), 1)
        self.rows = [torch.from_numpy(rng.permutation(len(one.position))[:count]) for one in sightings]
        basis, parallax, carried = zip(*(_moves(*both) for both in zip(sightings, self.rows)))
        near, skin = body.slide.reach.cpu().numpy(), len(body.sample_anchor)
        samples, total = body.sample_rest[:skin].cpu().numpy(), vstack(carried).tocsr()
        self.reach = (total @ csr_matrix(np.where(near > 1e-3, near, 0))).tocsr()
        self.basis, self.parallax = np.concatenate(basis), np.concatenate(parallax)
        self.carried = total[:, :skin] if rises else csr_matrix((total.shape[0], skin), dtype=total.dtype)
        self.uneven = SMOOTH * rises * len(self.parallax) / len(samples) * _differences(samples)
        self.borders = _Borders(silhouettes if rises else [], skin, len(body.sample_rest), len(self.parallax))

    def step(
        self, avatar: Avatar, sightings: Sequence[Sighting], height: np.ndarray, slope: float
    ) -> tuple[Tensor, Tensor]:
        """What to add to s (n, j) and to δ (a,)."""
        residual, jacobian, weight = (
            np.concatenate(each) for each in zip(*(_seen(avatar, *both, slope) for both in zip(sightings, self.rows)))
        )
        weight = weight / (1 + np.square(residual).mean(1) / STRAY**2) ** 2
        curved = weight[:, None, None] * (jacobian.transpose(0, 2, 1) @ jacobian)
        assert avatar.body.slide is not None
        now = avatar.body.slide.share.cpu().numpy(), height
        pull = weight[:, None] * np.einsum("pck,pc->pk", jacobian, residual)
        share, along = self._gathered(pull)
        self.borders.weigh(height)
        right = _joined(share, along + self.borders.wanted) - _joined(*self._penalty(weight, *now))

        def product(values: np.ndarray) -> np.ndarray:
            share, rise = self._split(values)
            moved = self._slid(share) + (self.carried @ rise)[:, None] * self.parallax
            pulled = self._gathered(np.einsum("pkc,pc->pk", curved, moved))
            found: np.ndarray = (
                _joined(*pulled) + _joined(*self._penalty(weight, share, rise)) + np.float32(1e-3) * values
            )
            return found

        system = LinearOperator((right.size, right.size), matvec=product, dtype=np.float32)
        share, rise = self._split(cg(system, right, rtol=1e-3, maxiter=STEPS)[0].astype(np.float32))
        return torch.from_numpy(share), torch.from_numpy(rise)

    def _split(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """s and δ of what conjugate gradients take."""
        share = values[: self.mask.size].reshape(self.mask.shape) * self.mask
        return share, RISE * values[self.mask.size :]

    def _slid(self, share: np.ndarray) -> np.ndarray:
        """Δ (p, 3)."""
        found: np.ndarray = np.einsum("pj,pjc->pc", self.reach @ share, self.basis)
        return found

    def _gathered(self, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What moves the pixels, transposed: (p, 3) onto s and δ."""
        along = self.carried.T @ np.einsum("pk,pk->p", pull, self.parallax)
        return self._of_nodes(pull), along

    def _of_nodes(self, pull: np.ndarray) -> np.ndarray:
        """`_slid` transposed."""
        found: np.ndarray = self.mask * (self.reach.T @ np.einsum("pjc,pc->pj", self.basis, pull))
        return found

    def _penalty(self, weight: np.ndarray, share: np.ndarray, rise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Half the slope of what s and δ cost."""
        slid, up = STILL * weight[:, None] * self._slid(share), LEVEL * weight * (self.carried @ rise)
        return self._of_nodes(slid), self.carried.T @ up + self.uneven @ rise + self.borders.form @ rise


class _Borders:
    """κ Σ_e ω_e (m_e − δ_e)²: its form in δ (a, a), and where it pulls a level surface (a,)."""

    def __init__(self, silhouettes: Sequence[Silhouette], skin: int, samples: int, pixels: int) -> None:
        nothing = csr_matrix((0, samples), dtype=np.float32)
        carried = vstack([nothing, *(_matrix(one.beside, samples) for one in silhouettes)]).tocsr()
        self.carried = carried[:, :skin]
        self.miss = np.concatenate([np.zeros(0, np.float32), *(one.miss.numpy() for one in silhouettes)])
        self.each = SILHOUETTE * pixels / max(len(self.miss), 1)

    def weigh(self, height: np.ndarray) -> None:
        """By what the borders miss while the samples stand so high."""
        left = self.miss - self.carried @ height
        weight = self.each / (1 + np.square(left / BORDER_STRAY)) ** 2
        self.form = (self.carried.T @ diags(weight) @ self.carried).tocsr()
        self.wanted = self.carried.T @ (weight * self.miss)


def _moves(one: Sighting, rows: Tensor) -> tuple[np.ndarray, np.ndarray, csr_matrix]:
    """Of a sighting's `rows`: (p, j, 3) the slide's basis, (p, 3) q, (p, a) the samples that carry them."""
    samples, beside = one.samples, one.beside.rows(rows)
    moves = slide_basis(samples.rest_from_posed, one.posed.body.skinning, samples.rest)
    carried = _matrix(beside, len(samples.rest))
    linear = beside.mean(samples.rest_from_posed[:, :, :3].flatten(1)).unflatten(1, (3, 3))
    basis = (carried @ moves.flatten(1).numpy()).reshape(-1, *moves.shape[1:])
    return basis, (linear @ one.parallax[rows, :, None])[..., 0].numpy(), carried


def _seen(avatar: Avatar, one: Sighting, rows: Tensor, slope: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(p, 3) c − t, (p, 3, 3) slopes of t's channels, (p,) weights."""
    detail = avatar.body.detail
    assert detail is not None
    samples, beside = one.slid(avatar), one.beside.rows(rows)
    rest = samples.painted_position(one.position[rows], beside)
    albedo = (one.colour[rows] / one.light(avatar)(samples.facing(beside))).clamp(0, 1)

    def texel(offset: Tensor) -> Tensor:
        return torch.sigmoid(detail(detail.places(rest + offset)))

    steps = slope * torch.eye(3)
    jacobian = torch.stack([(texel(step) - texel(-step)) / (2 * slope) for step in steps], -1)
    return (albedo - texel(torch.zeros(3))).numpy(), jacobian.numpy(), one.weight[rows].numpy()


def _joined(share: np.ndarray, rise: np.ndarray) -> np.ndarray:
    """Slopes of s and δ as conjugate gradients take them."""
    return np.concatenate([share.ravel(), RISE * rise]).astype(np.float32)


def _matrix(beside: Neighbours, samples: int) -> csr_matrix:
    """(p, a): means over the samples that carry pixels."""
    index, weight = beside.index.numpy(), beside.weight.numpy()
    starts = np.arange(0, index.size + 1, index.shape[1])
    return csr_matrix((weight.ravel(), index.ravel(), starts), shape=(len(index), samples))


def _differences(samples: np.ndarray) -> csr_matrix:
    """(a, a) whose form is Σ (δ_a − δ_b)² over pairs of samples that are near each other at rest."""
    near = cKDTree(samples).query(samples, BESIDE + 1)[1][:, 1:]
    row = np.repeat(np.arange(len(samples)), BESIDE)
    beside = csr_matrix((np.full(row.size, 0.5, np.float32), (row, near.ravel())), shape=(len(samples),) * 2)
    beside = beside + beside.T
    return (diags(np.asarray(beside.sum(1)).ravel()) - beside).tocsr()
