"""The default person's template as a surface, and the avatar that it stands in for."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from export_surface import seamed_surface

from avatarrex.avatar import Avatar
from avatarrex.export.clips import Clip
from avatarrex.export.losses import Source
from avatarrex.export.rig import rig_of
from avatarrex.fields.light import Light
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import load_person

TERMS = {"name": "Ada", "licence": "CC BY 4.0", "consent": "given in writing", "authors": ["A. Maker"]}


@lru_cache
def lit() -> Light:
    """Brighter from above, redder from the left."""
    light = Light()
    with torch.no_grad():
        light.harmonics[1] = 0.3
        light.harmonics[0] = torch.tensor([0.2, 0.0, 0.0])
    return light


@pytest.fixture(scope="session")
def source():
    return Source(seamed_surface(), load_person(), lit())


@pytest.fixture(scope="session")
def rig(source):
    return rig_of(source.surface, source.person, source.factor(source.posed(Signals.rest()), Signals.rest()))


@pytest.fixture(scope="session")
def moving():
    """A second of a motion with everything in it: body, hands, face, jaw, eyes, root; more than a half turn of the root."""
    frames = []
    for k in range(11):
        t = k / 10
        frames.append(
            Signals.rest().replace(
                body_pose=t * named_pose("squat") + (1 - t) * named_pose("wave"),
                left_hand_pose=t * named_hand("fist", "left"),
                right_hand_pose=named_hand("point", "right"),
                expression=t * named_expression("laugh") + (1 - t) * named_expression("wink"),
                jaw_pose=np.array([0.2 * t, 0, 0]),
                eye_pose=np.array([[0, 0.2 * t, 0], [0, 0.3, 0]]),
                global_orient=np.array([0, 5 * t, 0]),
                translation=np.array([0.3 * t, 0.1, -t]),
            )
        )
    return Clip("moving", SignalSequence(tuple(frames), 10.0, "moving"))


@pytest.fixture(scope="session")
def avatar(source):
    """Untrained, with the stand-in surface."""
    made = Avatar.create(source.person, "compact")
    made.surface, made.light = source.surface, source.light
    made.meta |= json.loads(json.dumps(TERMS))
    return made


@pytest.fixture
def unsigned(avatar):
    """The same without terms."""
    return replace(avatar, meta={"format": 3, "preset": "compact"})
