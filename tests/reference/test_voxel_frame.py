"""The fast frame against the frame in which nothing is skipped, 64×64."""

import numpy as np
import pytest
import torch

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.pipeline import render_frame
from avatarrex.pointmap.raycast import available
from avatarrex.reference.voxel_frame import render_reference
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose

SIGNALS = Signals.rest().replace(
    body_pose=named_pose("walk"),
    left_hand_pose=named_hand("point", "left"),
    expression=named_expression("laugh"),
    global_orient=np.array([0.1, 0.5, 0.0]),
    translation=np.array([3.0, 0.2, -1.0]),
)
HANDS = frozenset({"left_hand", "right_hand"})


@pytest.mark.slow
@pytest.mark.parametrize("target", ["person", "face"])
def test_the_fast_frame_is_the_reference_frame(target: str) -> None:
    avatar = load_avatar()
    avatar.light.frame = "world"
    drawn = torch.Generator().manual_seed(4)
    avatar.light.add_face()
    for harmonics in (avatar.light.harmonics, avatar.light.face):
        torch.nn.init.normal_(harmonics, 0.0, 0.2, generator=drawn)
    where, distance = ((3.0, 0.15, -1.0), 2.6) if target == "person" else ((3.05, 0.88, -0.93), 0.6)
    camera = Camera.orbit(20, 5, distance, 40, where, 64, 64)
    # The face's ω is queried at every other voxel of its box: of 12.5 mm that moves eight rays at the outline of a close-up.
    parts = {"part_voxel": 0.018} if target == "person" else {"part_voxel": 0.00625, "hidden": HANDS}
    settings = RenderSettings(
        voxel=0.04, antialias=False, thin=0, prefilter=False, **parts
    )  # the reference stores neither
    reference, pointmap = render_reference(avatar, SIGNALS, camera, settings)
    fast = render_frame(avatar, SIGNALS, camera, settings)
    both = fast.pointmap.hit & pointmap.hit
    assert both.sum() > 250
    assert (fast.pointmap.hit != pointmap.hit).sum() <= 2
    depth = (fast.pointmap.depth - pointmap.depth)[both].abs()
    assert depth.median() < 1e-5
    assert depth.quantile(0.99) < 3e-3
    error = (fast.image.double() - reference)[both].square().mean()
    assert -10 * torch.log10(error) > 40, f"{-10 * torch.log10(error):.1f} dB by {available()[0]}"
