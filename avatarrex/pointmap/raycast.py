"""Casting rays: one door to the implementations of Step II (paper sec. 4). Root frame, metres; negative inside."""

from __future__ import annotations

from collections.abc import Callable

from jaxtyping import Bool
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.gl.context import gl_unavailable
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast_gl import raycast_gl
from avatarrex.pointmap.raycast_reference import raycast_reference
from avatarrex.pointmap.raycast_torch import raycast_torch
from avatarrex.volume.sdf_volume import SdfVolume


def available() -> tuple[str, ...]:
    """The implementations that this machine can run."""
    return ("gl", "torch", "reference") if gl_unavailable() is None else ("torch", "reference")


def raycast(
    volume: SdfVolume,
    camera: Camera,
    impl: str = "auto",
    antialias: bool = True,
    march: str = "exact",
    only: Bool[Tensor, "h w"] | None = None,
) -> PointMap:
    """Walk each pixel's ray to its first outside-to-inside zero crossing; `camera` is in the root frame.

    `gl` runs the compute shaders, `torch` the same walk on tensors, `reference` walks every cell in float64 (small
    images); `auto` takes the shaders where a context can be had and torch elsewhere, and `renderer` says which. `march`
    is `exact`, or `fixed`: steps of a quarter of a body voxel and one linear interpolation, no antialiasing (to compare
    with). `only`: pixels that are wanted, in an exact march; the others may then be anything. Not differentiable.
    A ray that starts inside the avatar first leaves it. Raises `InputError` for an impl that is unknown or cannot run here,
    and for an unknown march.
    """
    if march not in ("exact", "fixed"):
        raise InputError("raycast", "march", "exact or fixed", march)
    if only is not None and sees_what_it_meets(impl):
        return raycast_gl(volume, camera, antialias, march, only)
    return _caster(impl)(volume, camera, antialias, march)


def sees_what_it_meets(impl: str) -> bool:
    """Whether a ray's result depends on what it meets alone, to the bit: on tensors steps also end beside boxes that are missed."""
    return _caster(impl) is raycast_gl


def _caster(impl: str) -> Callable[[SdfVolume, Camera, bool, str], PointMap]:
    if impl not in ("auto", "gl", "torch", "reference"):
        raise InputError("raycast", "impl", "auto, gl, torch or reference", impl)
    if impl in ("auto", "gl"):
        missing = gl_unavailable()
        if missing is None:
            return raycast_gl
        if impl == "gl":
            raise InputError("raycast", "impl", "a machine with OpenGL 4.3 compute shaders", missing)
    return raycast_reference if impl == "reference" else raycast_torch
