"""An avatar on generated SMPL-X, MANO and Faceverse files is distilled and exported as the default one is, in its smallest form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from distil.small_distillation import OPEN, make_small
from export.reading import Glb

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.distil.distil import distil
from avatarrex.distil.exact import ExactPose
from avatarrex.export.clips import read_clips
from avatarrex.export.export import export_avatar
from avatarrex.export.rig import rig_of
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.surface.pose import pose_surface
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import Person
from avatarrex.training.prior import load_prior


@pytest.fixture(scope="module")
def avatar(person: Person) -> Avatar:
    """What a training begins with, and its surface of four poses."""
    made = Avatar.create(person, "compact")
    assert all(load_prior(made, part) for part in ("body", "face", "face_colour"))
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        made.surface = distil(made, None, 4)
    return made


@pytest.mark.slow
def test_its_surface_is_near_its_field(avatar: Avatar) -> None:
    """All parts are there, each on the exact surface, and the mouth opens by Faceverse's jaw."""
    surface = avatar.surface
    assert surface is not None
    stand = Signals.rest().replace(body_pose=named_pose("stand"))
    vertices = np.asarray(pose_surface(surface, avatar.person, stand, None, Counters()).vertices)
    away = np.abs(ExactPose.of(avatar, stand).field.sdf(torch.as_tensor(vertices)).numpy())
    for part in range(1 + len(PARTS)):
        assert np.median(away[surface.part == part]) < 0.0015, ("body", *PARTS)[part]
    assert np.abs(surface.morph[OPEN]).max() > 0.01


@pytest.mark.slow
def test_its_files_are_posed_as_it_is(avatar: Avatar, tmp_path: Path) -> None:
    """A GLB by the rules of glTF, with the 55 joints and 52 names; the page has one, too."""
    assert avatar.surface is not None
    clips = read_clips((), ["walk"])
    for name in ("a.glb", "a.html"):
        assert export_avatar(avatar, tmp_path / name, clips).files == (tmp_path / name,)
    glb = Glb((tmp_path / "a.glb").read_bytes())
    rig = rig_of(avatar.surface, avatar.person, np.ones_like(avatar.surface.vertices)).limited(8)
    ours = rig.moved(clips[0].sequence[0])[rig.uv_vertex]
    assert np.abs(glb.posed(clips[0].name, 0) - ours).max() < 1e-5
    assert [node.name for node in glb.document.nodes[:55]] == list(JOINT_NAMES)
    assert glb.document.meshes[0].extras["targetNames"] == list(EXPRESSION_NAMES)
    assert len((tmp_path / "a.html").read_bytes()) > len((tmp_path / "a.glb").read_bytes())
