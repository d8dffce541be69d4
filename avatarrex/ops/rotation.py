"""Rotations: axis-angle vectors (rotvec, radians), 3×3 matrices and unit quaternions (wxyz).

Every function is batched over leading axes, keeps the tensor's dtype and device, and stays finite with finite gradients
at angle 0 and π: small angles take a series behind a double `where` (the branch that is not taken is fed harmless
numbers, or its NaN would reach the gradient through 0·NaN), and the inverse goes by the largest quaternion component,
never by arccos. NumPy users pass float64 tensors; half precision is not served.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def matrix_from_rotvec(rotvec: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    """Rodrigues' formula, I + a K + b K², a = sin θ/θ, b = (1 − cos θ)/θ², K = [rotvec]×."""
    square = (rotvec * rotvec).sum(-1)
    small = square < _series_limit(rotvec.dtype)
    square_safe = torch.where(small, torch.ones_like(square), square)
    angle = square_safe.sqrt()
    half = torch.sin(angle / 2)
    a = torch.where(small, 1 - square / 6 + square**2 / 120, torch.sin(angle) / angle)
    b = torch.where(small, 0.5 - square / 24 + square**2 / 720, 2 * half * half / square_safe)
    k = cross_matrix(rotvec)
    eye = torch.eye(3, dtype=rotvec.dtype, device=rotvec.device)
    return eye + a[..., None, None] * k + b[..., None, None] * (k @ k)


def cross_matrix(vector: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    """[v]×, so that [v]× u = v × u."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)


def quaternion_from_rotvec(rotvec: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 4"]:
    """Unit quaternion wxyz = (cos θ/2, rotvec · sin(θ/2)/θ)."""
    square = (rotvec * rotvec).sum(-1, keepdim=True)
    small = square < _series_limit(rotvec.dtype)
    angle = torch.where(small, torch.ones_like(square), square).sqrt()
    real = torch.where(small, 1 - square / 8 + square**2 / 384, torch.cos(angle / 2))
    scale = torch.where(small, 0.5 - square / 48 + square**2 / 3840, torch.sin(angle / 2) / angle)
    return torch.cat([real, scale * rotvec], -1)


def rotvec_from_quaternion(quaternion: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 3"]:
    """Shortest rotvec (angle in [0, π]) of a wxyz quaternion of any positive length."""
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    real, vector = quaternion[..., :1], quaternion[..., 1:]
    square = (vector * vector).sum(-1, keepdim=True)
    ratio = square / (real * real).clamp_min(torch.finfo(real.dtype).tiny)
    small = ratio < _series_limit(real.dtype)
    real_safe = torch.where(small, real, torch.ones_like(real))
    length = torch.where(small, torch.ones_like(square), square).sqrt()
    ratio = torch.where(small, ratio, torch.zeros_like(ratio))
    series = 2 / real_safe * (1 - ratio / 3 + ratio**2 / 5 - ratio**3 / 7)
    return vector * torch.where(small, series, 2 * torch.atan2(length, real) / length)


def matrix_from_quaternion(quaternion: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation matrix of a wxyz quaternion, normalised first."""
    w, x, y, z = torch.nn.functional.normalize(quaternion, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).reshape(*w.shape, 3, 3)


def quaternion_from_matrix(matrix: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 4"]:
    """Unit quaternion wxyz with w ≥ 0 of a rotation matrix.

    The four columns of 4 q qᵀ follow from the entries; the one with the largest diagonal (≥ 1) is normalised, so
    nothing is ever divided by less than one (Shepperd 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in matrix.unbind(-2))
    rows = [
        1 + a + e + i, h - f, c - g, d - b,
        h - f, 1 + a - e - i, b + d, c + g,
        c - g, b + d, 1 - a + e - i, f + h,
        d - b, c + g, f + h, 1 - a - e + i,
    ]  # fmt: skip
    outer = torch.stack(rows, -1).unflatten(-1, (4, 4))
    best = outer.diagonal(dim1=-2, dim2=-1).argmax(-1)
    chosen = outer.gather(-2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    quaternion = torch.nn.functional.normalize(chosen, dim=-1)
    return torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def rotvec_from_matrix(matrix: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 3"]:
    """Shortest rotvec of a rotation matrix, exact at 0 and π (at π the axis' sign is free)."""
    return rotvec_from_quaternion(quaternion_from_matrix(matrix))


def slerp(start: Float[Tensor, "*b 4"], end: Float[Tensor, "*b 4"], fraction: Tensor | float) -> Float[Tensor, "*b 4"]:
    """Unit quaternions on the shorter arc from `start` to `end` (wxyz), at `fraction` in [0, 1].

    A tensor `fraction` has one value per quaternion. start · exp(fraction · log(start⁻¹ end)), without dividing by the
    arc's sine.
    """
    inverse = start * start.new_tensor([1.0, -1.0, -1.0, -1.0])
    step = rotvec_from_quaternion(quaternion_multiply(inverse, end))
    if isinstance(fraction, Tensor):
        fraction = fraction[..., None]
    return torch.nn.functional.normalize(quaternion_multiply(start, quaternion_from_rotvec(fraction * step)), dim=-1)


def quaternion_multiply(first: Float[Tensor, "*b 4"], second: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 4"]:
    """Hamilton product: the rotation `second`, then `first`."""
    real_1, vector_1 = first[..., :1], first[..., 1:]
    real_2, vector_2 = second[..., :1], second[..., 1:]
    real = real_1 * real_2 - (vector_1 * vector_2).sum(-1, keepdim=True)
    vector = real_1 * vector_2 + real_2 * vector_1 + torch.linalg.cross(vector_1, vector_2, dim=-1)
    return torch.cat([real, vector], -1)


def _series_limit(dtype: torch.dtype) -> float:
    """θ² below which the three-term series is exact to rounding: its next term is below θ⁶/5000."""
    return 1e-2 if dtype == torch.float32 else 1e-5
