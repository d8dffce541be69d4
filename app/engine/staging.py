"""Frames of a state on its stage: in its light, over its floor and background. A stage that is off changes nothing.

Letters: h w pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from avatarrex_studio.session.state import StudioState
from jaxtyping import UInt8
from torch import Tensor

from avatarrex.files.images import composite
from avatarrex.frame import DeferredFrame, Frame
from avatarrex.live import LiveFrame
from avatarrex.stage.composite import staged
from avatarrex.stage.depth_composite import depth_composite
from avatarrex.stage.lighting import Lit, lit, lit_surfaces


def in_light(frames: Sequence[Frame], state: StudioState) -> Lit:
    """The frames of a state's figures as one picture in the light of its stage, and the floor's light."""
    light = state.stage.light
    live = [frame for frame in frames if isinstance(frame, LiveFrame)]
    if light is None and len(frames) == 1:
        return Lit(frames[0].image, None)
    if live:
        return lit_surfaces(live, light)
    images, floor = [frame.image for frame in frames], None
    if light is not None:
        images, floor = lit([frame for frame in frames if isinstance(frame, DeferredFrame)], light)
    return Lit(together(frames, images), floor)


def together(frames: Sequence[Frame], images: Sequence[Tensor]) -> Tensor:
    """Images of the frames as one picture, nearer figures before farther ones."""
    return depth_composite([image.float().cpu() for image in images], [f.pointmap.depth.float().cpu() for f in frames])


def over_stage(shown: Lit, state: StudioState) -> UInt8[np.ndarray, "h w 4"]:
    """What `in_light` gave over the state's floor and background, straight-alpha bytes.

    Raises `InputError` for a picture that cannot be read.
    """
    if not state.stage.shown:
        return composite(shown.image, state.background)
    height, width = shown.image.shape[:2]
    camera = state.view.camera(width, height)
    return staged(shown.image, camera, state.stage, state.background, shown.floor, state.middle)
