"""Detail embedding and node residuals from the body pose (paper sec. 3.1): a conditional variational auto-encoder.

    encoder  q(z | θ, per-frame code) = N(μ, diag exp(log σ²))        decoder  (z, θ) → {Δn_i, e_i}        z = 0 at test

θ enters as rotation matrices minus identity of the 21 body joints. The paper inherits this part from structured local
radiance fields without repeating it; its exact form here is our choice. |Δn_i| is bounded by `RESIDUAL` per axis and
e_i by 1, so that a pose far from the training poses cannot tear the surface apart. Once the geometry is trained, each number
is clamped to the middle of its range over the training poses (`clamp_to`; ours): codes beyond it appear in no picture.

Letters: b frames, n nodes, e embedding, z latent channels. Residuals in metres, rest pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from avatarrex.fields.local_networks import mlp

BODY_JOINTS = 21
RESIDUAL = 0.05
"""Largest residual per axis, metres: loose clothing moves by centimetres."""
MIDDLE = (0.2, 0.8)
"""Quantiles over the training poses' codes that codes are clamped to."""


@dataclass(frozen=True)
class BodyCode:
    """What the pose says about every node."""

    residual: Float[Tensor, "*b n 3"]
    """Δn_i, metres in the rest pose."""
    embedding: Float[Tensor, "*b n e"]
    """e_i."""


class DetailCode(nn.Module):
    """Encoder and decoder."""

    least: Tensor
    """(n, 3 + e) bounds of the decoder's output, −1 to 1 until `clamp_to`."""
    most: Tensor

    def __init__(self, nodes: int, embedding: int, latent: int, decoder: Sequence[int], encoder: Sequence[int]) -> None:
        super().__init__()
        self.nodes, self.latent = nodes, latent
        self.decoder = mlp((BODY_JOINTS * 9 + latent, *decoder, nodes * (3 + embedding)), "elu")
        self.encoder = mlp((BODY_JOINTS * 9 + latent, *encoder, 2 * latent), "elu")
        with torch.no_grad():  # start at rest: no residual, embeddings of a few per cent
            *_, last = self.decoder.children()
            for parameter in last.parameters():
                parameter.mul_(0.1)
        self.register_buffer("least", torch.full((nodes, 3 + embedding), -1.0))
        self.register_buffer("most", torch.full((nodes, 3 + embedding), 1.0))

    def posterior(
        self, body_rotations: Float[Tensor, "*b 21 3 3"], frame_code: Float[Tensor, "*b z"]
    ) -> tuple[Float[Tensor, "*b z"], Float[Tensor, "*b z"]]:
        """μ and log σ² of q(z | θ, code of the training frame)."""
        mean, log_variance = self.encoder(torch.cat([pose_feature(body_rotations), frame_code], -1)).chunk(2, -1)
        return mean, log_variance.clamp(-20, 10)

    def forward(
        self, body_rotations: Float[Tensor, "*b 21 3 3"], latent: Float[Tensor, "*b z"] | None = None
    ) -> BodyCode:
        """Residuals and embeddings; `latent` None is z = 0."""
        out = self._decoded(body_rotations, latent).clamp(self.least, self.most)
        return BodyCode(RESIDUAL * out[..., :3], out[..., 3:])

    def _decoded(
        self, body_rotations: Float[Tensor, "*b 21 3 3"], latent: Float[Tensor, "*b z"] | None
    ) -> Float[Tensor, "*b n c"]:
        pose = pose_feature(body_rotations)
        if latent is None:
            latent = pose.new_zeros(*pose.shape[:-1], self.latent)
        return torch.tanh(self.decoder(torch.cat([pose, latent], -1)).unflatten(-1, (self.nodes, -1)))

    @torch.no_grad()
    def clamp_to(self, body_rotations: Float[Tensor, "b 21 3 3"]) -> None:
        """From now on clamp every number to the middle of its range over these poses, z = 0."""
        seen = self._decoded(body_rotations, None)
        low, high = torch.quantile(seen, seen.new_tensor(MIDDLE), dim=0)
        self.least, self.most = low, high

    def unclamp(self) -> None:
        """The whole range again: poses that are to be learnt may need other codes."""
        self.least, self.most = torch.full_like(self.least, -1.0), torch.full_like(self.most, 1.0)


def pose_feature(body_rotations: Float[Tensor, "*b 21 3 3"]) -> Float[Tensor, "*b 189"]:
    """vec(R_j − I) of the 21 body joints: zero at rest."""
    eye = torch.eye(3, dtype=body_rotations.dtype, device=body_rotations.device)
    return (body_rotations - eye).flatten(-3)


def sample_latent(
    mean: Float[Tensor, "*b z"], log_variance: Float[Tensor, "*b z"], noise: torch.Generator | None = None
) -> Float[Tensor, "*b z"]:
    """z = μ + σ·noise, differentiable in both."""
    return mean + torch.exp(log_variance / 2) * torch.randn(mean.shape, generator=noise)


def node_loss(code: BodyCode) -> Float[Tensor, ""]:
    """L_node = mean ‖Δn_i‖², m²."""
    return code.residual.square().sum(-1).mean()


def embedding_loss(code: BodyCode) -> Float[Tensor, ""]:
    """L_ebd = mean ‖e_i‖²."""
    return code.embedding.square().sum(-1).mean()


def kl_loss(mean: Float[Tensor, "*b z"], log_variance: Float[Tensor, "*b z"]) -> Float[Tensor, ""]:
    """KL(N(μ, σ²) ‖ N(0, 1)), summed over z, mean over frames."""
    return 0.5 * (mean.square() + torch.expm1(log_variance) - log_variance).sum(-1).mean()
