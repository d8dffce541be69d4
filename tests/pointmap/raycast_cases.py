"""Views, the cached float64 reference, and how far a ray caster is from it."""

import torch

from avatarrex.camera import Camera
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast import raycast
from avatarrex.volume.sdf_volume import SdfVolume

VIEWS = [
    Camera.orbit(20, 10, 2.6, 40, (0, -0.05, 0), 80, 80),
    Camera.orbit(75, -20, 0.7, 45, (0.6, 0.3, 0.02), 48, 40),
    Camera.orbit(-30, 15, 0.8, 40, (0, 0.7, 0), 41, 53),
]


_references: dict[tuple[object, ...], tuple[SdfVolume, PointMap]] = {}


def reference(volume: SdfVolume, camera: Camera) -> PointMap:
    """The float64 cell walk, once for each volume and view."""
    key = (id(volume), camera.key())
    if key not in _references:
        _references[key] = volume, raycast(volume, camera, "reference")
    return _references[key][1]


def errors(one: PointMap, truth: PointMap) -> tuple[torch.Tensor, int, int]:
    """Metres apart where both hit; missed; false."""
    both = one.hit & truth.hit
    apart = (one.position.double() - truth.position.double())[both].norm(dim=-1)
    return apart, int((truth.hit & ~one.hit).sum()), int((one.hit & ~truth.hit).sum())


def agree(volume, camera, impl: str) -> PointMap:
    """The point map, after it was found to agree with the reference within the targets (design: performance)."""
    one, truth = raycast(volume, camera, impl), reference(volume, camera)
    apart, missed, false = errors(one, truth)
    assert (missed, false) == (0, 0)
    if len(apart):
        assert apart.mean() <= 1e-6
        assert apart.quantile(0.99) <= 1e-5
        assert apart.max() <= 1e-4
    return one
