"""Provenance: what an avatar's `avatar.json` says of where its geometry, colours and figures come from.

What a reader needs to judge a figure: a prior that knew the template, tracking that drew the pictures, and a hand whose geometry
is the template's all change what a number is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.drawn import drawn, light_frame, variation
from avatarrex.capture.readers.rigs import Capture
from avatarrex.parts.known_expressions import KnownExpressions
from avatarrex.signals.driving import Signals
from avatarrex.training.core.warm_start import PRIOR, prior_of, read_prior
from avatarrex.training.recipe import Recipe

WORLD, PERSON = "fixed in the world", "turns with the person"
PARTS = {"body": ("body",), "face": ("face", "face_colour")}
"""Parts of the prior by trained part."""
SHARED = "95 % of its vertices at rest (weight above 0.5)"
"""How much of the template's face the studio's drawn subject has (tests/capture/test_subject.py)."""


def prior(avatar: Avatar, recipe: Recipe, parts: tuple[str, ...], start: Avatar | None) -> dict[str, str]:
    """By part of the packaged prior what it cost, only of parts that the training began with; one that went on has that of its start.
    Empty: nothing was known before."""
    if start is not None:
        return _recorded_prior(start.meta.get("training"))
    about = read_prior(PRIOR)[1]
    begun = [part for part in parts if (one := getattr(recipe, part)[0]).warm_steps and one.prior]
    return {name: about[name] for part in begun for name in PARTS[part] if prior_of(avatar, name) is not None}


def _recorded_prior(training: object) -> dict[str, str]:
    """The prior of an avatar's `training`. One that went on said none until 2026-11-29: it has that of the start before."""
    if not isinstance(training, dict):
        return {"start": "it does not say"}
    if "start" in training and not training.get("prior"):
        return _recorded_prior(training["start"])
    known = training.get("prior")
    return known if isinstance(known, dict) else {"start": "it does not say"}


def tracking(capture: Capture) -> str:
    """How good the body parameters, expressions and cameras are that the training was given."""
    refined = (
        "; poses and shape then refined by its own pictures (capture refine)" if "refined" in capture.manifest else ""
    )
    if not drawn(capture):
        return "as the capture's files state" + refined
    noise = variation(capture).get("tracking_noise", 0.0)
    given = f"{noise:g} × (2 degrees a joint, 1 cm of the root, 0.1 of the coefficients) off" if noise else "exact"
    return f"{given}: the parameters that drew the pictures" + (", with noise" if noise else "") + refined


def light(capture: Capture) -> str:
    """What light the pictures were taken in, as far as the capture says."""
    frame = {"world": WORLD, "root": PERSON}[light_frame(capture)]
    matched = "; cameras matched in exposure (capture match-exposure)" if "matched" in capture.manifest else ""
    return f"{'drawn' if drawn(capture) else 'the capture'}: {frame}; one light for all poses is learnt{matched}"


def of_the_template(capture: Capture) -> dict[str, str]:
    """By part what of its geometry the training did not learn."""
    fit = capture.person.fit
    same = (
        capture.person.name == "default"
        and drawn(capture)
        and variation(capture).get("subject", "default") == "default"
    )
    own = "the template, which is the drawn person's own" if same else "the template"
    skin = "" if fit is None or fit.surface is None else ", its skin fitted to the mattes"
    face = "" if fit is None or fit.face is None else ", fitted to the face rig's pictures"
    shared = f": {SHARED}" if same else ""
    return {
        "body": f"joints, skinning weights and nodes of {own}{skin}",
        "hands": f"all: meshes of {own}{skin}, by exact signed distance",
        "face": f"morph targets, which carry the tri-planes, of {own}{shared}{face}",
    }


def expressions(frames: Sequence[Signals] | None, start: Avatar | None) -> dict[str, Any] | None:
    """The range of ψ, jaw and eyes among the frames that the face was trained on; where it was not, what its avatar before says."""
    known = KnownExpressions.of(frames) if frames else None
    if not frames and start is not None:
        known = start.known_expressions
    return None if known is None else known.to_json()
