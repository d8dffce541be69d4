"""The volumes and views that the ray casters are tried on."""

import pytest
import torch

from avatarrex.camera import Camera
from avatarrex.pointmap.pointmap import PointMap, available, raycast
from avatarrex.volume.solids import capsule_man


@pytest.fixture(scope="session")
def man():
    """The capsule man on a grid cut to his size, the face at 5 mm."""
    return capsule_man(shape=(24, 100, 96), face_voxel=0.005)


@pytest.fixture(params=[impl for impl in available() if impl != "reference"])
def impl(request) -> str:
    """Every ray caster but the reference that runs on this machine."""
    return request.param


VIEWS = [
    Camera.orbit(20, 10, 2.6, 40, (0, -0.05, 0), 96, 96),
    Camera.orbit(75, -20, 0.7, 45, (0.6, 0.3, 0.02), 80, 60),
    Camera.orbit(-30, 15, 0.8, 40, (0, 0.7, 0), 61, 83),
]


def errors(one: PointMap, truth: PointMap) -> tuple[torch.Tensor, int, int]:
    """Metres apart where both hit; missed; false."""
    both = one.hit & truth.hit
    apart = (one.position.double() - truth.position.double())[both].norm(dim=-1)
    return apart, int((truth.hit & ~one.hit).sum()), int((one.hit & ~truth.hit).sum())


def agree(volume, camera, impl: str) -> PointMap:
    """The point map, after it was found to agree with the reference within the targets (design: performance)."""
    one, truth = raycast(volume, camera, impl), raycast(volume, camera, "reference")
    apart, missed, false = errors(one, truth)
    assert (missed, false) == (0, 0)
    if len(apart):
        assert apart.mean() <= 1e-6
        assert apart.quantile(0.99) <= 1e-5
        assert apart.max() <= 1e-4
    return one
