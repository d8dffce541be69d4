"""Point map: where each pixel's ray first meets the avatar (paper sec. 4, Step II).

Letters: h w image rows and columns. Root frame, metres; the SDF is negative inside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.gl.context import gl_unavailable
from avatarrex.ops.finite import require_finite
from avatarrex.volume.sdf_volume import SdfVolume


@dataclass(frozen=True, eq=False)
class PointMap:
    """What the rays met. All zero where nothing is covered."""

    position: Float[Tensor, "h w 3"]
    """Surface point, root frame, metres."""
    normal: Float[Tensor, "h w 3"]
    """Unit gradient of the composed field there, root frame."""
    depth: Float[Tensor, "h w"]
    """Camera z, metres."""
    hit: Bool[Tensor, "h w"]
    """Whether the ray through the pixel's centre meets the surface."""
    coverage: Float[Tensor, "h w"]
    """Share of the pixel that is covered: 1 inside, between 0 and 1 at silhouettes. Where the centre misses but the
    pixel is partly covered, the nearest covered sub-position gives the point."""
    part_weight: Float[Tensor, "h w 3"]
    """Effective ω of left hand, right hand and face."""
    steps: Float[Tensor, "h w"]
    """Field samples that the covered pixel's centre ray took."""
    renderer: str
    """What cast the rays."""
    counters: dict[str, int] = field(default_factory=dict)
    side: Int[Tensor, "h w"] | None = None
    """Whose body each point is on (`Composed.side`), where the field itself was asked; None: the volume knows."""

    def __post_init__(self) -> None:
        require_finite(
            "point map",
            position=self.position,
            normal=self.normal,
            depth=self.depth,
            coverage=self.coverage,
            part_weight=self.part_weight,
        )


def available() -> tuple[str, ...]:
    """The implementations that this machine can run."""
    return ("gl", "torch", "reference") if gl_unavailable() is None else ("torch", "reference")


def raycast(
    volume: SdfVolume, camera: Camera, impl: str = "auto", antialias: bool = True, march: str = "exact"
) -> PointMap:
    """Walk each pixel's ray to its first outside-to-inside zero crossing; `camera` is in the root frame.

    `gl` runs the compute shaders, `torch` the same walk on tensors, `reference` walks every cell in float64 (small
    images); `auto` takes the shaders where a context can be had and torch elsewhere, and `renderer` says which. `march`
    is `exact`, or `fixed`: steps of a quarter of a body voxel and one linear interpolation, no antialiasing (to compare
    with). Not differentiable. A ray that starts inside the avatar first leaves it. Raises `InputError` for an impl that
    is unknown or cannot run here, and for an unknown march.
    """
    if march not in ("exact", "fixed"):
        raise InputError("raycast", "march", "exact or fixed", march)
    return _caster(impl)(volume, camera, antialias, march)


def _caster(impl: str) -> Callable[[SdfVolume, Camera, bool, str], PointMap]:
    if impl not in ("auto", "gl", "torch", "reference"):
        raise InputError("raycast", "impl", "auto, gl, torch or reference", impl)
    # The three import this file for PointMap, and OpenGL only where it is used.
    if impl in ("auto", "gl"):
        missing = gl_unavailable()
        if missing is None:
            from avatarrex.pointmap.raycast_gl import raycast_gl

            return raycast_gl
        if impl == "gl":
            raise InputError("raycast", "impl", "a machine with OpenGL 4.3 compute shaders", missing)
    if impl == "reference":
        from avatarrex.pointmap.raycast_reference import raycast_reference

        return raycast_reference
    from avatarrex.pointmap.raycast_torch import raycast_torch

    return raycast_torch


def scatter(
    camera: Camera,
    pixel: Tensor,
    position: Float[Tensor, "p 3"],
    normal: Float[Tensor, "p 3"],
    hit: Bool[Tensor, " p"],
    coverage: Float[Tensor, " p"],
    part_weight: Float[Tensor, "p 3"],
    steps: Float[Tensor, " p"],
    renderer: str,
    counters: dict[str, int],
) -> PointMap:
    """The images from what the covered pixels (p,) hold; depth is taken in float64."""
    row = torch.as_tensor(camera.camera_from_world[2])
    depth = position.double() @ row[:3] + row[3]

    def image(values: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        out = torch.zeros(camera.height * camera.width, *values.shape[1:], dtype=dtype)
        out[pixel] = values.to(dtype)
        return out.view(camera.height, camera.width, *values.shape[1:])

    return PointMap(
        position=image(position),
        normal=image(normal),
        depth=image(depth),
        hit=image(hit, torch.bool),
        coverage=image(coverage),
        part_weight=image(part_weight),
        steps=image(steps),
        renderer=renderer,
        counters=counters,
    )
