"""Make the clothed subject's solids: `avatarrex/data/subject.npz` from `avatarrex/data/person.npz`.

    python tools/build_subject.py            (needs the extra `sdf`; about two minutes)
    python tools/build_subject.py loose      (`subject_loose.npz`: a wide tunic instead of the T-shirt)

The pattern: a T-shirt, trousers, two shoes and a short haircut as level sets over the default person, teeth closed by
caps (subject_garments.py), and the skin under cloth pushed inwards. Each solid is bound to the body:
smoothed skin weights, and a nearest body triangle for shape, expression and pose offsets. Ambient occlusion is baked
in an A-pose.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import igl
import numpy as np
import trimesh
from scipy.spatial import cKDTree
from subject_body import Body, Y, Z, smoothstep
from subject_garments import Piece, hair, inner_parts, shirt, shoe, trousers, tunic
from subject_masks import masks

from avatarrex.capture.synthetic.mesh import averaging, smoothed, vertex_normals
from avatarrex.capture.synthetic.subject import PACKAGED, Subject, load_subject
from avatarrex.files.assets import DATA
from avatarrex.signals.driving import Signals
from avatarrex.templates.model import TemplateModel

INSIDE_MOUTH = ("upper_teeth", "lower_teeth", "tongue")
MOUTH_OPENNESS = 0.55
"""Least openness inside the mouth, which is baked shut but seen open."""
TUCK = 0.014
"""Metres that covered skin is pushed in, so that it stays inside when joints bend."""
WALL = 0.013
"""Metres that the mouth's lining stands off the skin behind it: lips and cheeks are otherwise shells of 3 mm."""
CROWN = 0.007
"""Metres of a tooth that the lining leaves bare."""


def tuck(body: Body, pieces: list[Piece]) -> np.ndarray:
    """Offsets (v, 3) that push covered skin inwards, growing over 3 cm from each opening."""
    normal = vertex_normals(body.vertices, body.faces)
    covered = np.zeros(len(body.vertices))
    for piece in pieces:
        if piece.covers is None:
            continue
        inside = igl.fast_winding_number(piece.vertices, piece.faces, body.vertices) > 0.5
        covered = np.maximum(covered, np.where(inside, np.clip((-piece.covers(body.vertices) - 0.02) / 0.03, 0, 1), 0))
    soft = smoothed(averaging(body.faces, len(normal)), normal, 6, 0)
    return -TUCK * smoothstep(covered)[:, None] * soft


def line_mouth(body: Body, lip: np.ndarray) -> np.ndarray:
    """Offsets (v, 3) that bring the mouth's lining forward as gums and cheeks, up to the bare crowns and the tongue.

    `lip` (v,): metres from the mouth's rim, negative inside. The lining keeps its own skinning and expressions, so it
    never comes through the lips.
    """
    upper, lower, tongue = map(body.group, INSIDE_MOUTH)
    meet = (upper[:, Y].min() + lower[:, Y].max()) / 2
    crowns = np.concatenate([upper, lower])
    bare = np.concatenate([crowns[np.abs(crowns[:, Y] - meet) < CROWN], tongue])
    mean = averaging(body.faces, len(body.vertices))
    normal = smoothed(mean, vertex_normals(body.vertices, body.faces), 2)
    depth = smoothstep((-lip - 0.001) / 0.007)
    free = cKDTree(bare).query(body.vertices)[0] - 0.001
    amount = depth * np.clip(free, 0, WALL)
    for _ in range(2):
        amount = np.where(depth > 0, np.minimum(amount, smoothed(mean, amount, 1)), 0)
    return amount[:, None] * normal


def bind(piece: Piece, model: TemplateModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed skin weights (v, 55), nearest template face (v,) and barycentrics (v, 3) there."""
    vertices, faces = model.v_template.numpy(), model.faces.numpy()
    skin = (faces < len(model.groups["body"])).all(1)
    wanted = np.flatnonzero(skin) if piece.smoothing else np.arange(len(faces))
    _, face, nearest = igl.point_mesh_squared_distance(piece.vertices, vertices, faces[wanted])
    face = wanted[np.asarray(face).ravel()]
    bary = trimesh.triangles.points_to_barycentric(vertices[faces[face]], np.asarray(nearest))
    bary = np.clip(np.nan_to_num(bary, nan=1 / 3), 0, 1)
    bary /= bary.sum(1, keepdims=True)
    own = np.einsum("vk,vkj->vj", bary, model.weights.numpy()[faces[face]])
    return smoothed(averaging(piece.faces, len(own)), own, piece.smoothing, 0.4), face, bary


def bake_openness(subject: Subject) -> np.ndarray:
    """(v,) uint8: 255 · (1 − ambient occlusion) with the arms lowered halfway and the legs apart."""
    pose = np.zeros((55, 3))
    for name, angle in (("left_shoulder", -0.7), ("right_shoulder", 0.7), ("left_hip", 0.12), ("right_hip", -0.12)):
        pose[subject.model.joint_names.index(name), Z] = angle
    posed = subject.pose(Signals.from_full_pose(pose))
    faces = np.ascontiguousarray(posed.faces[posed.solids.outer])
    lifted = posed.vertices + 1.5e-3 * posed.normals
    occlusion = np.asarray(igl.ambient_occlusion(posed.vertices, faces, lifted, posed.normals, 160)).ravel()
    occlusion = smoothed(averaging(posed.faces, len(occlusion)), occlusion, 2)
    shown = np.isin(np.array(subject.names)[subject.solid_of_vertex], INSIDE_MOUTH)
    openness = np.maximum(1 - occlusion, np.where(shown | (subject.masks["lip"] < 0), MOUTH_OPENNESS, 0))
    return np.round(255 * np.clip(openness, 0, 1)).astype(np.uint8)


def follow(upper: Piece, own: np.ndarray, lower: Piece, lower_weights: np.ndarray) -> np.ndarray:
    """Skin weights (v, 55) of the shirt that go over, below the waist, to those of the trousers it hangs on.

    Cloth that lies on other cloth must bend like it: with the pelvis' weights the front hem cuts through a squat's groin.
    """
    _, near = cKDTree(lower.vertices[: lower.cloth]).query(upper.vertices, k=4)
    ramp = np.clip((0.07 - upper.vertices[:, Y]) / 0.08, 0, 1)[:, None]
    mixed = own + (lower_weights[near].mean(1) - own) * ramp * ramp * (3 - 2 * ramp)
    return smoothed(averaging(upper.faces, len(mixed)), mixed, 6, 0.4)


def packed(pieces: list[Piece], model: TemplateModel, garment: str) -> dict[str, np.ndarray]:
    """The solids' own arrays, as `assets_spec/subject.json` names them; each solid is reported on a line."""
    for piece in pieces:
        mesh = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
        closed = "closed" if mesh.is_watertight else "OPEN"
        print(f"{piece.name}: {len(mesh.vertices)} v, {len(mesh.faces)} f, {1e3 * mesh.volume:.2f} l, {closed}")
    bound, face, bary = map(list, zip(*(bind(piece, model) for piece in pieces)))
    if garment == "default":
        bound[0] = follow(pieces[0], bound[0], pieces[1], bound[1])
    weights = np.concatenate(bound)
    top = np.argsort(-weights, axis=1)[:, :6]
    strongest = np.take_along_axis(weights, top, 1)
    strongest /= strongest.sum(1, keepdims=True)
    return {
        "names": np.array([piece.name for piece in pieces]),
        "vertex_count": np.array([len(piece.vertices) for piece in pieces]),
        "face_count": np.array([len(piece.faces) for piece in pieces]),
        "vertices": np.concatenate([piece.vertices for piece in pieces]).astype(np.float32),
        "faces": np.concatenate([piece.faces for piece in pieces]).astype(np.uint16),
        "weight_joint": top.astype(np.uint8),
        "weight": np.round(strongest * 65535).astype(np.uint16),
        "bind_face": np.concatenate(face).astype(np.uint16),
        "bind_bary": np.round(np.concatenate(bary) * 65535).astype(np.uint16),
    }


def main(garment: str = "default", out: str = "") -> None:
    path = Path(out) if out else DATA / PACKAGED[garment]
    started = time.time()
    body = Body()
    print(f"crotch {body.crotch:.3f}, armpit {body.armpit:.3f}")
    below = trousers(body)
    upper = tunic(body) if garment == "loose" else shirt(body, below)
    pieces = [upper, below, shoe(body, 1), shoe(body, -1), hair(body), *inner_parts(body)]
    print(f"shapes {time.time() - started:.0f} s")
    arrays = packed(pieces, body.model, garment)
    painted = masks(body, pieces)
    lining = line_mouth(body, painted["lip"][: len(body.vertices)])
    arrays["tuck"] = (tuck(body, pieces) + lining).astype(np.float16)
    arrays["person_hash"] = np.array(body.person.hash)
    arrays["measures"] = np.array([body.crotch, body.armpit])
    arrays |= {f"mask_{name}": mask.astype(np.float16) for name, mask in painted.items()}
    arrays["openness"] = np.full(len(body.vertices) + len(arrays["vertices"]), 255, np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        first = Path(folder) / "unlit.npz"
        np.savez(first, allow_pickle=False, **arrays)
        arrays["openness"] = bake_openness(load_subject(str(first)))
    np.savez_compressed(path, allow_pickle=False, **arrays)
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB, {time.time() - started:.0f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
