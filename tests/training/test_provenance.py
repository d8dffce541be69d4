"""Provenance: an avatar says what it began with, what tracking and light its pictures have, and what is the template's."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli import inspect, train
from avatarrex_studio.cli.main import main
from capture.tiny_capture import TinyCapture
from tiny_recipe import TINY

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.capture.readers.drawn import MAKER, light_frame
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.templates.person import load_person
from avatarrex.templates.person_fit import PersonFit, SurfaceOffsets
from avatarrex.training.core.provenance import light, of_the_template, prior, tracking
from avatarrex.training.recipe import RECIPES, from_scratch

DRAWN = {"provenance": {"maker": MAKER}}


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    return TinyCapture.make(("body",)).folder(tmp_path_factory.mktemp("tiny") / "capture")


def said(capture: Path, **manifest: object) -> Capture:
    return replace(open_capture(capture), manifest=manifest)


def test_tracking_is_what_the_capture_says_it_is(capture):
    assert tracking(said(capture)) == "as the capture's files state"
    assert tracking(said(capture, **DRAWN)) == "exact: the parameters that drew the pictures"
    noisy = tracking(said(capture, **DRAWN, variation={"tracking_noise": 2.0}))
    assert noisy.startswith("2 × (2 degrees a joint")
    assert "exact" not in noisy
    for manifest in ({}, DRAWN):
        refined = tracking(said(capture, **manifest, refined={"frames": 3}))
        assert refined.endswith("refined by its own pictures (capture refine)")


def test_light_is_what_the_capture_says_it_is(capture):
    assert light(said(capture)).startswith("the capture: fixed in the world"), "lamps stand still"
    assert "turns with the person" in light(said(capture, **DRAWN))
    assert "fixed in the world" in light(said(capture, **DRAWN, variation={"conditions": ["light", "noise"]}))
    assert "matched" not in light(said(capture))
    assert "cameras matched in exposure" in light(said(capture, matched="0123456789abcdef"))
    assert light_frame(said(capture)) == "world"
    assert light_frame(said(capture, **DRAWN)) == "root"


def test_what_is_the_templates_is_named(capture):
    drawn = said(capture, **DRAWN)
    own = replace(drawn, person=replace(drawn.person, fit=None))
    assert "the drawn person's own" in of_the_template(own)["hands"]
    assert "the drawn person's own: 95 %" in of_the_template(own)["face"]
    other = replace(own, manifest={**DRAWN, "variation": {"subject": "other"}})
    assert "own" not in of_the_template(other)["hands"]
    assert "%" not in of_the_template(other)["face"]
    skin = SurfaceOffsets(tuple(range(8)), np.zeros((8, 3)))
    fitted = replace(own, person=replace(own.person, fit=PersonFit(np.zeros(10), np.zeros((55, 3)), skin)))
    assert "fitted to the mattes" in of_the_template(fitted)["body"]
    assert "fitted to the mattes" not in of_the_template(own)["body"]


def test_the_prior_is_named_where_it_is_taken():
    avatar = Avatar.create(load_person(), "compact")
    quick = RECIPES["quick"]
    assert set(prior(avatar, quick, ("face", "body"), None)) == {"body", "face", "face_colour"}
    assert set(prior(avatar, quick, ("body",), None)) == {"body"}
    assert "minutes" in prior(avatar, quick, ("body",), None)["body"], "what it cost"
    assert prior(avatar, from_scratch(quick), ("body", "face"), None) == {}
    assert prior(Avatar.create(load_person(), "paper"), quick, ("body",), None) == {}, "networks of other widths"


def test_what_goes_on_has_the_prior_of_its_start():
    """One that says nothing of it is not one without a prior."""
    avatar, quick = Avatar.create(load_person(), "compact"), RECIPES["quick"]
    for said in ({"body": "3 minutes"}, {}):
        avatar.meta["training"] = {"prior": said}
        assert prior(avatar, quick, ("body",), avatar) == said
    avatar.meta["training"] = {"recipe": "long"}
    assert prior(avatar, quick, ("body",), avatar) == {"start": "it does not say"}
    avatar.meta["training"] = {"prior": {}, "start": {"prior": {"body": "3 minutes"}}}
    assert prior(avatar, quick, ("body",), avatar) == {"body": "3 minutes"}, "none was said of what went on"
    avatar.meta["training"] = {"prior": {}, "start": "from a file"}
    assert prior(avatar, quick, ("body",), avatar) == {"start": "it does not say"}
    del avatar.meta["training"]
    assert prior(avatar, quick, ("body",), avatar) == {"start": "it does not say"}


def test_a_trained_avatar_and_inspect_say_it(capture, tmp_path, monkeypatch):
    """Written by the verb; a path of the machine is not in it."""
    monkeypatch.setitem(train.RECIPES, "smoke", TINY)
    run = tmp_path / "run"
    assert main(["train", str(capture), "--recipe", "smoke", f"--out={run}", "--no-surface"]) == 0
    (*_, last) = sorted((run / "checkpoints").iterdir())
    training = load_avatar(last / "avatar.avatar").meta["training"]
    assert training["command"] == "avatarrex-studio train capture --recipe smoke --out=run --no-surface"
    assert training["seconds"] > 0
    told = "\n".join(inspect.describe(str(last / "avatar.avatar")))
    for name, value in (("tracking", training["tracking"]), ("template: hands", training["template"]["hands"])):
        assert f"training: {name}: {value[:100]}" in told
    test = training["splits"]["body"]["test"]
    assert f"training: splits: body rig, test: {json.dumps(test)}" in told
    assert str(tmp_path) not in told.replace(str(last / "avatar.avatar"), "")
