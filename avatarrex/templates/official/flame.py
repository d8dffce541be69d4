"""FLAME as it is published: a head of 5023 vertices and 5 joints, 300 shape and 100 expression directions (docs/formats.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from avatarrex.templates.model import TemplateModel
from avatarrex.templates.model_arrays import read_model
from avatarrex.templates.official.model_file import read_model_file

JOINTS = ("root", "neck", "jaw", "left_eye", "right_eye")


def read_flame(path: str | Path) -> TemplateModel:
    """Read a model, metres. Raises `InputError` naming file and key."""
    return replace(read_model(read_model_file(path, "flame", "a FLAME"), path), joint_names=JOINTS)
