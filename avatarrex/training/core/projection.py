"""Where the mesh ends: the static detail of the body from the training pictures, as the colour that pass II starts with. Ours.

Every chosen picture is projected onto the surface that the geometry has by now (the renderer's own volume and raycast: what is
hidden is not painted). A pixel counts where the body alone is drawn and the matte is opaque, by the square of the cosine at which
it is seen: towards the outline it covers more, and errors of pose and cameras shift it most. Its colour, with the light E(n)
divided out, goes to the three texels around; a texel has the weighted mean, then twice that of what is near its last mean
(Geman–McClure), so that what moved over it, a shadow or another limb, does not count. A texel never seen has the colour of the
nearest seen one at rest.

Letters: p pixels, k texels around one, t texels. Root frame, metres; sRGB in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.errors import InputError
from avatarrex.fields.detail_texture import DetailTexture
from avatarrex.pointmap.raycast import raycast
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.pixels import training_pairs

PICTURES = 120
"""Projected at most, spread over frames and views: a texel on the side of the body is then seen by thirty."""
FACING = 0.3
"""Cosine from which a pixel is believed."""
OPAQUE = 250 / 255
"""Matte from which a pixel has the person's colour alone."""
ALONE = 0.01
"""Share of the parts beside the body, at most."""
ROUNDS, STRAY = 2, 0.1
"""Means after the first, and the difference in sRGB at which a pixel's weight has fallen to a quarter."""


@dataclass(frozen=True)
class Projected:
    """Pixels of one picture on the texels."""

    texel: Int[Tensor, "p k"]
    weight: Float[Tensor, "p k"]
    albedo: Float[Tensor, "p 3"]


@torch.no_grad()
def start_from_pictures(avatar: Avatar, store: FrameStore, spacing: float) -> None:
    """Lay texels on the body, paint them, and let the networks begin at nothing. Raises `InputError` where no picture shows it."""
    avatar.body.add_detail(spacing)
    assert avatar.body.detail is not None
    pairs = training_pairs(store.rig)
    chosen = [pairs[k] for k in np.unique(np.linspace(0, len(pairs) - 1, PICTURES).round().astype(int))]
    paint(avatar.body.detail, [project(avatar, store, *pair) for pair in chosen], f"{store.rig.name} rig")
    for parameter in avatar.body.colour_blend[-1].parameters():
        parameter.zero_()


def project(avatar: Avatar, store: FrameStore, index: int, view: int) -> Projected:
    """One picture on the body's texels."""
    frame, rig, detail = store[index], store.rig, avatar.body.detail
    assert detail is not None
    camera = frame.camera(rig.views[view].camera)
    seen = raycast(frame.volume.sdf, camera, antialias=True)
    eye = torch.as_tensor(camera.centre).to(seen.position)
    facing = -(torch.nn.functional.normalize(seen.position - eye, dim=-1) * seen.normal).sum(-1)
    matte = torch.from_numpy(rig.matte(view, index) / np.float32(255))
    counts = (seen.coverage >= 1) & (seen.part_weight.sum(-1) < ALONE) & (facing > FACING) & (matte >= OPAQUE)
    position, picture = seen.position[counts], torch.from_numpy(rig.image(view, index) / np.float32(255))
    samples = frame.volume.body_frame.samples
    beside = samples.neighbours_of(position)
    places = detail.places(samples.rest_position(position, beside))
    albedo = (picture[counts] / avatar.light(samples.facing(beside))).clamp(0, 1)
    return Projected(places.texel, places.share * facing[counts, None].square(), albedo)


def paint(detail: DetailTexture, pictures: list[Projected], where: str) -> None:
    """Robust means of what the pictures show; `where` they are from, for an error."""
    mean = total = torch.zeros(len(detail.texel), 1)
    for round in range(1 + ROUNDS):
        old, known = mean, total > 0
        mean, total = torch.zeros(len(detail.texel), 3), torch.zeros(len(detail.texel), 1)
        for one in pictures:
            weight = one.weight
            if round:
                away = (old[one.texel] - one.albedo[:, None]).square().mean(-1)
                weight = weight / (1 + away / STRAY**2).square()
            flat = one.texel.flatten()
            total.index_add_(0, flat, weight.flatten()[:, None])
            mean.index_add_(0, flat, (weight[..., None] * one.albedo[:, None]).flatten(0, 1))
        mean = mean / total.clamp_min(1e-12)
    del known
    if not (total > 0).any():
        raise InputError(where, "pictures", "some that show the body", "none")
    detail.paint(mean, total[:, 0] > 1e-4)
