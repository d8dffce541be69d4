"""Frames of a state on its stage: in its light, over its floor and background. A stage that is off changes nothing.

Letters: h w pixels.
"""

from __future__ import annotations

import numpy as np
from avatarrex_studio.session.state import StudioState
from jaxtyping import UInt8

from avatarrex.files.images import composite
from avatarrex.frame import DeferredFrame, Frame
from avatarrex.live import LiveFrame
from avatarrex.stage.composite import staged
from avatarrex.stage.lighting import Lit, lit, lit_surface


def in_light(frame: Frame, state: StudioState) -> Lit:
    """The frame's image in the light of the state's stage, and the floor's light."""
    light = state.stage.light
    if light is None:
        return Lit(frame.image, None)
    if isinstance(frame, LiveFrame):
        return lit_surface(frame, light)
    assert isinstance(frame, DeferredFrame)
    return lit(frame, light)


def over_stage(shown: Lit, state: StudioState) -> UInt8[np.ndarray, "h w 4"]:
    """What `in_light` gave over the state's floor and background, straight-alpha bytes.

    Raises `InputError` for a picture that cannot be read.
    """
    if not state.stage.shown:
        return composite(shown.image, state.background)
    height, width = shown.image.shape[:2]
    camera = state.view.camera(width, height)
    return staged(shown.image, camera, state.stage, state.background, shown.floor, state.middle)
