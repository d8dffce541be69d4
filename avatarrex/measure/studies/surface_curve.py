"""What more fitted poses and more directions are worth to a surface: its error in poses that were not fitted, against what they cost.

Poses are observed as `distil` does (some 1.5 s each of one core) and kept in the folder WORK; a stopped run goes on there. The body's
vertices that were found are compared: where the correction puts them, where the exact field has them, at rest.

Letters: n poses, v vertices.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from tqdm import tqdm

from avatarrex.avatar_file import load_avatar
from avatarrex.distil.distil import claim, observed
from avatarrex.distil.fit import Residuals, fit_correction
from avatarrex.distil.observe import Observer
from avatarrex.distil.poses import fitting_poses
from avatarrex.distil.rest_mesh import rest_mesh
from avatarrex.errors import check
from avatarrex.metrics.table import printed
from avatarrex.signals.driving import Signals
from avatarrex.surface.pose_kernel import pose_kernel, turns
from avatarrex.surface.surface import Correction
from avatarrex.surface.surface_file import weights_key
from avatarrex.templates.mesh import vertex_normals

SEED = 7
"""Of the poses that are left out."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Work folder, avatar, poses, directions, poses that are left out."""
    parser.add_argument("work", type=Path, help="a folder for observed poses")
    parser.add_argument("--avatar", default="default")
    parser.add_argument("--poses", default="20,40,80,160", help="fitted poses, each number a row (20,40,80,160)")
    parser.add_argument("--ranks", default="0,6,12,24", help="directions a group (0,6,12,24; 0: skinning alone)")
    parser.add_argument("--left-out", type=int, default=24, help="poses that are not fitted (24)")


def run(options: argparse.Namespace) -> None:
    """Print a row for each pair of poses and directions."""
    poses, ranks = (_numbers(options, name) for name in ("poses", "ranks"))
    avatar, most, left_out = load_avatar(options.avatar), max(poses), options.left_out
    check(
        min(poses) >= 5 and left_out >= 1,
        "surface-curve",
        "poses",
        "five fitted ones and one left out at least",
        min(poses),
    )
    claim(options.work, f"{weights_key(avatar)} curve {most} {left_out}")
    observer = Observer(avatar, rest_mesh(avatar))
    fitted = _residuals(observer, fitting_poses(most), options.work, "fitted")
    unfitted = _residuals(observer, fitting_poses(left_out, SEED), options.work, "left_out")
    mesh = observer.mesh
    normal = vertex_normals(torch.as_tensor(mesh.vertices), observer.faces).numpy()
    joint, parents = mesh.joint[:, 0].astype(int), avatar.person.body.parents
    row = printed("poses", "directions", "normal mm", "p99 mm", "skin mm", "dB", "MB", "fit s")
    for count in poses:
        some = Residuals(fitted.signals[:count], fitted.value[:count], fitted.found[:count])
        for rank in ranks:
            begun = time.monotonic()
            mean, correction = fit_correction(some, joint, parents, rank)
            took, body = time.monotonic() - begun, mesh.part == 0
            figures = missed(unfitted, predicted(mean, correction, unfitted.signals), normal, body)
            stored = 2 * correction.basis.size + 4 * correction.weights.size  # half and single precision
            words = (f"{value:.{digits}f}" for value, digits in zip(figures, (3, 2, 2, 1)))
            row(count, rank, *words, f"{stored / 1e6:.1f}", f"{took:.0f}")


def predicted(
    mean: Float[np.ndarray, "v 6"], correction: Correction, signals: list[Signals]
) -> Float[np.ndarray, "n v 6"]:
    """The equation of `Correction`, around `mean`."""
    turn, fitted = turns(np.stack([one.full_pose() for one in signals])), turns(correction.poses)
    out = np.repeat(mean[None].astype(np.float64), len(signals), 0)
    for g in range(len(correction.joints)):
        of = correction.group == g
        kernel = pose_kernel(turn, fitted, correction.joints[g], correction.closeness[g])
        amount = np.clip(kernel @ correction.weights[g], correction.low[g], correction.high[g])
        out[:, of] += np.einsum("nr,vrc->nvc", amount, correction.basis[of])
    return out


def missed(
    true: Residuals, guess: Float[np.ndarray, "n v 6"], normal: Float[np.ndarray, "v 3"], vertex: np.ndarray
) -> tuple[float, float, float, float]:
    """Medians over poses, of the vertices `vertex` (v,) that were found: mean and 99th percentile along the normal and mean along
    the skin in mm, PSNR of the albedo in dB."""
    rows = []
    for value, found, predicted_value in zip(true.value, true.found, guess):
        of = found & vertex
        error = (predicted_value - value)[of]
        along = np.einsum("vx,vx->v", error[:, :3], normal[of])
        aside = np.linalg.norm(error[:, :3] - along[:, None] * normal[of], axis=1)
        square = max(float(np.square(error[:, 3:]).mean()), 1e-12)
        off = 1e3 * np.abs(along)
        rows.append((off.mean(), np.quantile(off, 0.99), 1e3 * aside.mean(), -10 * np.log10(square)))
    normal_mm, p99, skin, psnr = np.median(np.array(rows), 0).tolist()
    return normal_mm, p99, skin, psnr


def _residuals(observer: Observer, signals: list[Signals], work: Path, name: str) -> Residuals:
    """What skinning misses of the standing pose's albedo and of the place."""
    with tqdm(total=len(signals), unit="pose", leave=False) as bar:
        seen = observed(observer, signals, work, name, lambda what, done, of: bar.update(done - bar.n))
    neutral = observer.neutral
    assert neutral is not None
    return observer.residuals(signals, seen, neutral.albedo)


def _numbers(options: argparse.Namespace, name: str) -> list[int]:
    """Increasing. Raises `InputError`."""
    words = str(getattr(options, name)).split(",")
    check(
        all(word.isdigit() for word in words), "surface-curve", f"--{name}", "numbers, comma separated", ",".join(words)
    )
    return sorted({int(word) for word in words})
