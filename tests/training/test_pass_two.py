"""What pass II compares and what painting reads, against a pattern that is known; and which views networks get."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor
from training.miniature import WAVES, uncoloured, write_miniature

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.fields.body import BodyField
from avatarrex.fields.face import FaceField
from avatarrex.fields.hand import HandQuery
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.parts.face import Face
from avatarrex.shading.colour import OPAQUE, SurfaceColour
from avatarrex.templates.parts import PARTS
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.pass_two import Patch, PatchPass
from avatarrex.training.core.process_group import WHOLE
from avatarrex.training.core.projection import start_from_pictures
from avatarrex.training.core.trained_field import FACE
from avatarrex.training.recipe import QUICK

BODY_ALONE = frozenset({"face", "left_hand", "right_hand"})
SPACING = 0.02
"""Metres between texels, and more than a pixel."""
DRAWS = 400
HAND = 1
"""The hand that is coloured last."""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    return open_capture(write_miniature(tmp_path_factory.mktemp("capture"), "body")).rigs["body"]


def first_frame(avatar: Avatar, rig: Rig, hidden: frozenset[str]) -> FrameStore:
    """Its first frame from four sides."""
    store = FrameStore(avatar, rig, "body", hidden, True)
    store.renew(0)
    store.pairs = [(index, view) for index, view in store.pairs if index == 0]
    return store


@pytest.fixture(scope="module")
def body(rig: Rig) -> FrameStore:
    return first_frame(uncoloured(0), rig, BODY_ALONE)


def stage_of(store: FrameStore, dropout: float = 0.0, side: int = 64) -> PatchPass:
    recipe = replace(QUICK.body[1], patch=side, view_dropout=dropout)
    return PatchPass(store.avatar, store, "body", recipe, Perceptual(None, "test"), 0)


def patch(stage: PatchPass, view: int, seed: int = 0) -> Patch:
    return stage._patch(stage.store, 0, view, np.random.default_rng(seed), WHOLE)


def pattern(rest: np.ndarray) -> Tensor:
    """The miniature's colours."""
    return torch.from_numpy(0.5 + 0.4 * np.sin(WAVES["body"] * rest + np.array([0.0, 1.0, 2.0]))).float()


@torch.no_grad()
def lay_pattern(avatar: Avatar) -> None:
    """On the body's texels, in an even light, under networks that say nothing."""
    body = avatar.body
    body.add_detail(SPACING)
    assert body.detail is not None
    body.detail.paint(pattern(body.detail.lattice.position))
    for parameter in (*body.colour_blend[-1].parameters(), avatar.light.harmonics):
        parameter.zero_()


def test_who_knows_the_pattern_has_nothing_to_learn_from_patches(body: FrameStore) -> None:
    """From each side: patches have the person where pictures have it, and the same colours."""
    lay_pattern(body.avatar)
    for _, view in body.pairs:
        with torch.no_grad():
            found = patch(stage_of(body), view)
        shown = (found.rendered.amax(-1) > 0).sum()
        assert shown > 300
        assert found.both.sum() > 0.8 * shown  # the others lie on its border
        off = (found.rendered - found.truth).square()[found.both[..., 0] > 0.9].mean().sqrt()
        assert off < 0.06, f"view {view}: {off}"


def test_without_its_weight_the_perceptual_term_is_not_computed(body: FrameStore) -> None:
    stage, picture = stage_of(body), torch.rand(32, 32, 3, generator=torch.Generator().manual_seed(0))
    both = torch.ones(32, 32, 1)
    assert set(stage._compare(picture, 1 - picture, both)) == {"rgb", "perceptual"}
    stage.recipe = replace(stage.recipe, weights=replace(stage.recipe.weights, perceptual=0.0))
    assert set(stage._compare(picture, 1 - picture, both)) == {"rgb"}


def test_pictures_are_painted_where_they_are_seen(rig: Rig) -> None:
    body = first_frame(uncoloured(0), rig, BODY_ALONE)
    start_from_pictures(body.avatar, "body", body, SPACING)
    detail = body.avatar.body.detail
    assert detail is not None
    place = detail.lattice.position
    chest = (np.abs(place[:, 0]) < 0.12) & (place[:, 1] > 0) & (place[:, 1] < 0.35) & (np.abs(place[:, 2]) > 0.06)
    assert chest.sum() > 100
    off = (torch.sigmoid(detail.texel.detach()) - pattern(place)).abs()
    assert off[chest].median() < 0.06


def test_views_are_dropped_as_often_as_wanted_and_turned_anywhere(
    body: FrameStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Tensor | None] = []

    def shade(self, frame, camera, gaze, share) -> tuple[Tensor, Tensor]:
        given.append(gaze)
        return torch.zeros(camera.height, camera.width, 3), torch.zeros(camera.height, camera.width)

    monkeypatch.setattr(PatchPass, "shade", shade)
    for seed in range(DRAWS):
        patch(stage_of(body, 0.5), seed % 4, seed)
    gazes = [gaze for gaze in given if gaze is not None]
    assert len(gazes) == pytest.approx(DRAWS / 2, abs=40)  # four standard deviations, as below
    turned = torch.stack(gazes)
    torch.testing.assert_close(turned.norm(dim=1), torch.ones(len(turned)))
    assert turned.mean(0).abs().max() < 0.16
    torch.testing.assert_close(turned.T @ turned / len(turned), torch.eye(3) / 3, atol=0.085, rtol=0)


@pytest.fixture(scope="module")
def person(rig: Rig) -> FrameStore:
    """With hands and face; one with a light of its own looks for its texels."""
    avatar = uncoloured(0)
    avatar.light.add_face()
    return first_frame(avatar, rig, frozenset())


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> dict[str, Tensor]:
    """By name what they were called with last: points and rays of a patch, directions for the networks, and for the face's texels."""
    found: dict[str, Tensor] = {}

    def watched(whole: Callable[..., Tensor], **places: int) -> Callable[..., Tensor]:
        def call(*values, **options) -> Tensor:
            found.update({name: values[place].detach() for name, place in places.items()})
            return whole(*values, **options)

        return call

    monkeypatch.setattr(SurfaceColour, "colour", watched(SurfaceColour.colour, point=1, ray=2, share=3))
    monkeypatch.setattr(BodyField, "seen", watched(BodyField.seen, body=3))
    monkeypatch.setattr(FaceField, "colour", watched(FaceField.colour, face=3))
    monkeypatch.setattr(Face, "_places", watched(Face._places, texel=4))
    monkeypatch.setattr(HandQuery, "facing", watched(HandQuery.facing, hand=1))
    return found


@pytest.mark.parametrize("dropped", [False, True])
def test_dropped_views_are_kept_from_networks_and_not_from_texels(
    person: FrameStore, given: dict[str, Tensor], dropped: bool
) -> None:
    """What lies behind open lips is seen along the camera's own rays, and skin of a hand faces the eye; networks get these rays, or one
    direction for the whole patch."""
    patch(stage_of(person, float(dropped), 128), 0)  # with gradients, so that parts take turns
    frame = person[0]
    eye = torch.as_tensor(frame.camera(person.rig.views[0].camera).centre).float()
    ray, share = given["ray"], given["share"]
    torch.testing.assert_close(ray, torch.nn.functional.normalize(given["point"] - eye, dim=1), atol=1e-5, rtol=0)
    of_body, of_face = share.sum(1) < OPAQUE, share[:, FACE] > 0
    assert min(of_body.sum(), of_face.sum()) > 30
    turn = torch.from_numpy(frame.posed.root_from_part("face")[:3, :3].copy()).float()
    torch.testing.assert_close(given["texel"], ray[of_face] @ turn, atol=1e-5, rtol=0)
    hand = torch.from_numpy(frame.posed.root_from_part(PARTS[HAND])[:3, :3].copy()).float()
    torch.testing.assert_close(given["hand"], ray[share[:, HAND] > 0] @ hand, atol=1e-5, rtol=0)
    said = given["body"][:1].expand_as(ray) if dropped else ray
    assert torch.allclose(said, ray, atol=0.1) != dropped
    torch.testing.assert_close(given["body"], said[of_body], atol=1e-5, rtol=0)
    torch.testing.assert_close(given["face"], said[of_face] @ turn, atol=1e-5, rtol=0)
