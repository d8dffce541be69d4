"""What the ray casters are tried on."""

import pytest

from avatarrex.pointmap.raycast import available
from avatarrex.reference.solids import capsule_man


@pytest.fixture(scope="session")
def man():
    """The capsule man on a grid cut to his size, the face at 5 mm."""
    return capsule_man(shape=(24, 100, 96), face_voxel=0.005)


@pytest.fixture(params=[impl for impl in available() if impl != "reference"])
def impl(request) -> str:
    """Every ray caster but the reference that runs on this machine."""
    return request.param
