"""A real, small distillation: near the field it was made of, gone on with where it was killed, begun anew where it has to be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from distil.small_distillation import OPEN, make_small

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.counters import Counters
from avatarrex.distil import distil as module
from avatarrex.distil import rest_mesh
from avatarrex.distil.distil import distil
from avatarrex.distil.exact import ExactPose
from avatarrex.distil.observe import Observation, Observer
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.surface.pose import pose_surface
from avatarrex.surface.surface import Surface
from avatarrex.surface.surface_file import read_surface, surface_bytes, weights_key
from avatarrex.templates.parts import PARTS

POSES = 4


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar("default")


class Killed(Exception):
    """As by a signal that nothing can catch: nothing but the files is left."""


@pytest.fixture(scope="module")
def distilled(avatar: Avatar, tmp_path_factory) -> tuple[Surface, list[int]]:
    """The surface, made in two goes, killed in the third pose; and how many signals but rest each of them observed."""
    work, counts = tmp_path_factory.mktemp("small") / "work", []
    with pytest.MonkeyPatch.context() as patch:
        observed = make_small(patch)
        told: list[tuple[str, int, int]] = []

        def killed_in_the_third(what: str, done: int, of: int) -> None:
            told.append((what, done, of))
            if (what, done) == ("poses", 2):
                raise Killed

        with pytest.raises(Killed):
            distil(avatar, work, POSES, killed_in_the_third)
        counts.append(sum(bool(one.body_pose.any() or one.expression.any()) for one in observed))
        observed.clear()
        surface = distil(avatar, work, POSES, lambda *step: told.append(step))
        counts.append(sum(bool(one.body_pose.any() or one.expression.any()) for one in observed))
    assert list(work.glob("*.npz")), "until the surface is stored"
    assert ("poses", POSES - 1, POSES) in told
    return surface, counts


def off_the_field(avatar: Avatar, surface: Surface, signals: Signals, part: int) -> np.ndarray:
    """Distances of the part's posed vertices to the exact surface, metres."""
    posed = pose_surface(surface, avatar.person, signals, None, Counters())
    chosen = np.asarray(posed.vertices)[surface.part == part]
    return np.abs(ExactPose.of(avatar, signals).field.sdf(torch.as_tensor(chosen)).numpy())


@pytest.mark.slow
def test_what_was_observed_is_not_observed_again(distilled) -> None:
    _, counts = distilled
    assert counts == [2, POSES - 2 + len(EXPRESSION_NAMES)]


@pytest.mark.slow
def test_it_is_near_the_field(avatar, distilled) -> None:
    """0.7 mm standing, 1.0 mm in a wave, 0.5 mm of an open mouth: between vertices, and in pictures, it is more."""
    surface, _ = distilled
    for pose, body in (("stand", 0.0012), ("wave", 0.002)):
        found = off_the_field(avatar, surface, Signals.rest().replace(body_pose=named_pose(pose)), 0)
        assert found.mean() < body, pose
    smile = Signals.rest().replace(expression=np.eye(len(EXPRESSION_NAMES))[OPEN])
    found = off_the_field(avatar, surface, smile, PARTS.index("face") + 1)
    assert np.median(found) < 0.0006, "the mean has gums and eyelids inside"


@pytest.mark.slow
def test_only_an_expression_that_moves_is_stored(distilled) -> None:
    surface, _ = distilled
    moved = np.abs(surface.morph).max((1, 2))
    assert moved[OPEN] > 0.01, "a mouth opens by centimetres"
    assert moved.argmax() == OPEN
    assert np.delete(moved, OPEN).max() < 1e-6


@pytest.mark.slow
def test_it_is_of_these_weights_and_its_file_is_in_order(avatar, distilled) -> None:
    surface, _ = distilled
    assert surface.key == weights_key(avatar)
    assert surface.meta["poses"] == POSES
    again = read_surface(surface_bytes(surface), "a", len(avatar.person.body.faces))
    assert np.array_equal(again.faces, surface.faces)
    assert again.meta == surface.meta


@pytest.fixture
def quick_observing(monkeypatch) -> list[Signals]:
    """Nothing is seen of any signal: how a work folder is used."""
    observed: list[Signals] = []

    class Blind(Observer):
        def __init__(self, avatar: Avatar, mesh: object) -> None:
            pass

        def observe(self, signals: Signals) -> Observation:
            observed.append(signals)
            point = np.zeros((1, 3))
            return Observation(**{**dict.fromkeys(Observation.__dataclass_fields__, point), "found": np.ones(1, bool)})

    monkeypatch.setattr(module, "rest_mesh", lambda avatar: None)
    monkeypatch.setattr(module, "Observer", Blind)
    return observed


def test_another_avatar_or_other_options_begin_anew(avatar, quick_observing, tmp_path: Path) -> None:
    def until_the_expressions(what: str, done: int, of: int) -> None:
        if what == "expressions":
            raise Killed

    def go(avatar: Avatar, poses: int) -> int:
        quick_observing.clear()
        with pytest.raises(Killed):
            distil(avatar, tmp_path / "work", poses, until_the_expressions)
        return len(quick_observing)

    other = Avatar.create(avatar.person, "compact", 1)
    assert [go(avatar, 5), go(avatar, 5), go(avatar, 7), go(other, 7), go(other, 7), go(avatar, 7)] == [
        5,
        0,
        7,
        7,
        0,
        7,
    ]


def test_a_folder_with_other_files_is_not_emptied(avatar, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"expected an empty folder, or one of a distillation, found thesis\.tex"):
        distil(avatar, tmp_path, POSES)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_an_avatar_whose_parts_were_never_trained_has_a_mesh_of_the_body_alone(avatar, monkeypatch):
    monkeypatch.setattr(rest_mesh, "CELL", 0.012)
    body = replace(avatar, meta={**avatar.meta, "untrained": list(PARTS)})
    mesh = rest_mesh.rest_mesh(body, 2500)
    assert (mesh.part == 0).all()
    assert (mesh.template_vertex == -1).all()
    assert mesh.faces.max() < len(mesh.vertices)
