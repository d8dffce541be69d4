"""Parametric meshes: body, hands and face of a person, posed by driving signals (paper sec. 3.1 to 3.3)."""

from avatarrex.templates.face import FaceTemplate, cut_face, pose_face
from avatarrex.templates.hand import HandTemplate, cut_hand, pose_hand
from avatarrex.templates.model import PosedTemplate, TemplateModel, pose_template, shape_template
from avatarrex.templates.person import Person, load_person, read_model
from avatarrex.templates.transform import world_from_root

__all__ = [
    "FaceTemplate",
    "HandTemplate",
    "Person",
    "PosedTemplate",
    "TemplateModel",
    "cut_face",
    "cut_hand",
    "load_person",
    "pose_face",
    "pose_hand",
    "pose_template",
    "read_model",
    "shape_template",
    "world_from_root",
]
