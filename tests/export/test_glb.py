"""GLB and VRM as files: read again by glTF's rules, and by Khronos' validator where it is installed."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from reading import Glb

from avatarrex.export.clips import Clip, read_clips
from avatarrex.export.export import export_avatar
from avatarrex.export.losses import frames_of
from avatarrex.export.texture import baked_texture
from avatarrex.export.vrm import PRESETS, human_bones
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.library import coefficients, named_expression
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence

LIMBS = ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
REQUIRED = ("hips", "spine", "head", *(side + limb for side in ("left", "right") for limb in LIMBS))
"""Of VRM 1.0."""


@pytest.fixture(scope="module")
def files(avatar, moving, tmp_path_factory):
    folder = tmp_path_factory.mktemp("glb")
    export_avatar(avatar, folder / "a.glb", [moving])
    export_avatar(avatar, folder / "a.vrm")
    return folder


@pytest.fixture(scope="module")
def glb(files):
    return Glb((files / "a.glb").read_bytes())


@pytest.fixture(scope="module")
def vrm(files):
    return Glb((files / "a.vrm").read_bytes())


def test_every_accessor_is_in_range_and_says_its_bounds(glb, vrm):
    for file in (glb, vrm):
        for index, accessor in enumerate(file.document.accessors):
            values = file.values(index)
            assert values.shape[0] == accessor.count
            if accessor.min:
                assert np.array_equal(np.float32(accessor.min), values.min(0).astype(np.float32))
                assert np.array_equal(np.float32(accessor.max), values.max(0).astype(np.float32))
        assert len(file.document.accessors[file.primitive.attributes.POSITION].min) == 3
        indices = file.values(file.primitive.indices)
        assert indices.max() == file.document.accessors[file.primitive.attributes.POSITION].count - 1
        assert file.influences()[0].max() < 55


def test_inverse_bind_matrices_undo_the_rest(glb):
    nodes, place = glb.document.nodes, np.zeros((55, 3))
    for index, node in enumerate(nodes[:55]):
        for child in node.children or ():
            place[child] = place[index] + nodes[child].translation
        if index == 0:
            place[0] = node.translation
            for child in node.children:
                place[child] = place[0] + nodes[child].translation
    inverse = glb.values(glb.document.skins[0].inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
    assert [node.name for node in nodes[:55]] == list(JOINT_NAMES)
    assert np.abs(inverse[:, :3, 3] + place).max() < 1e-6
    assert np.array_equal(inverse[:, :3, :3], np.tile(np.eye(3, dtype=np.float32), (55, 1, 1)))


@pytest.mark.parametrize("frame", [0, 4, 10])
def test_posed_by_the_rules_of_gltf_it_is_our_skinning(glb, rig, moving, frame):
    ours = rig.moved(moving.sequence[frame])[rig.uv_vertex]
    assert np.abs(glb.posed("moving", frame) - ours).max() < 1e-5


def test_a_vrm_at_rest_and_posed(vrm, rig):
    assert np.abs(vrm.posed() - rig.vertices[rig.uv_vertex]).max() < 1e-6
    joints, weights = vrm.influences()
    four = rig.limited(4)
    assert joints.shape[1] == 4
    assert np.array_equal(weights, four.weight[rig.uv_vertex])


def test_weights_sum_to_one_over_both_sets(glb):
    joints, weights = glb.influences()
    assert joints.shape[1] == 8
    assert np.abs(weights.sum(1, dtype=np.float64) - 1).max() < 1e-6
    assert (weights[:, :4].min(1) >= weights[:, 4:].max(1) - 1e-6).all()


def test_sparse_morph_targets_are_the_dense_ones(glb, source):
    surface = source.surface
    assert glb.document.meshes[0].extras["targetNames"] == list(EXPRESSION_NAMES)
    dense = np.zeros((len(surface.vertices), 3), np.float32)
    stored = 0
    for e, target in enumerate(glb.primitive.targets):
        index = target["POSITION"] if isinstance(target, dict) else target.POSITION
        dense[surface.morph_vertex] = surface.morph[e]
        assert np.abs(glb.values(index) - dense[surface.uv_vertex]).max() <= 1e-5
        stored += glb.document.accessors[index].sparse.count
    assert stored < 0.2 * 52 * len(surface.uv)


def test_quaternions_are_unit_and_continuous(glb):
    for (_, path), (times, values) in glb.channels("moving").items():
        assert (np.diff(times) > 0).all()
        if path == "rotation":
            assert np.abs(np.linalg.norm(values, axis=1) - 1).max() < 1e-6
            assert ((values[1:] * values[:-1]).sum(1) > 0).all()


def test_the_texture_is_a_jpeg_of_the_baked_colours(glb, source, moving):
    image = glb.document.images[0]
    content = glb.view(image.bufferView, np.uint8, glb.document.bufferViews[image.bufferView].byteLength).tobytes()
    with Image.open(io.BytesIO(content)) as picture:
        assert picture.format == "JPEG"
        ours = baked_texture(source.surface, source.mean_factor(frames_of([moving])))
        assert np.abs(np.asarray(picture, float) - ours).mean() < 3
    assert "KHR_materials_unlit" in glb.document.materials[0].extensions


def test_terms_and_losses_travel(glb, source):
    stored = glb.document.asset.extras["avatarrex"]
    assert stored["licence"] == glb.document.asset.copyright == "CC BY 4.0"
    assert stored["consent"] == "given in writing"
    assert stored["not_stated"] == "nothing"
    assert stored["allowed_use"]["avatarPermission"] == "onlyAuthor"
    losses = stored["losses"]
    assert losses["triangles"] == len(source.surface.faces)
    assert losses["joints of a vertex"] == 8
    assert losses["place against the whole surface, mm, mean"] > 0.1  # the stand-in's corrections
    assert losses["surface: depth mean_mm"] == 1.5


def test_a_vrm_has_the_bones_expressions_and_terms_of_vrm_1(vrm):
    extension = vrm.document.extensions["VRMC_vrm"]
    assert "VRMC_vrm" in vrm.document.extensionsUsed
    assert extension["specVersion"] == "1.0"
    meta = extension["meta"]
    assert meta["licenseUrl"] == "https://vrm.dev/licenses/1.0/"
    assert (meta["name"], meta["authors"]) == ("Ada", ["A. Maker"])
    assert "CC BY 4.0" in meta["copyrightInformation"]
    assert (meta["avatarPermission"], meta["modification"]) == ("onlyAuthor", "prohibited")
    bones = {bone: value["node"] for bone, value in extension["humanoid"]["humanBones"].items()}
    assert set(REQUIRED) <= set(bones)
    assert sorted(bones.values()) == list(range(55))
    assert vrm.document.nodes[bones["leftHand"]].name == "left_wrist"
    assert vrm.document.nodes[bones["rightLittleDistal"]].name == "right_pinky3"
    assert vrm.document.nodes[bones["leftThumbMetacarpal"]].name == "left_thumb1"
    assert not vrm.document.animations
    assert getattr(vrm.primitive.attributes, "JOINTS_1", None) is None


def test_expressions_of_a_vrm_are_made_of_the_52(vrm):
    expressions = vrm.document.extensions["VRMC_vrm"]["expressions"]
    assert list(expressions["custom"]) == list(EXPRESSION_NAMES)
    assert set(expressions["preset"]) == set(PRESETS)
    assert "morphTargetBinds" not in expressions["preset"]["neutral"]
    for name, expression in (expressions["preset"] | expressions["custom"]).items():
        weights = np.zeros(52)
        for bind in expression.get("morphTargetBinds", ()):
            assert vrm.document.nodes[bind["node"]].mesh == 0
            weights[bind["index"]] = bind["weight"]
        assert np.allclose(weights, coefficients(PRESETS.get(name, {name: 1.0})))


def test_parents_of_human_bones_are_vrm_s():
    ours = human_bones()
    assert len(ours) == len(set(ours.values())) == 55


def test_clips_of_one_name_are_named_apart(tmp_path):
    clips = read_clips((), ["wave", "wave", "squat"])
    assert [clip.name for clip in clips] == ["wave", "wave_2", "squat"]


def test_the_shape_of_a_motion_is_left_out(tmp_path):
    tall = Signals.rest().replace(shape=np.full(10, 2.0), translation=np.ones(3))
    write_json(tmp_path / "tall.json", SignalSequence((tall, Signals.rest()), 30.0))
    (clip,) = read_clips([tmp_path / "tall.json"])
    assert not clip.sequence[0].shape.any()
    assert clip.sequence[0].translation.tolist() == [1, 1, 1]


def test_a_joint_that_stays_at_rest_has_no_channel(avatar, tmp_path):
    turned = np.zeros((21, 3))
    turned[0] = 0.5
    still = Signals.rest().replace(body_pose=turned)
    face = Signals.rest().replace(expression=named_expression("smile"), eye_pose=np.full((2, 3), 0.1))
    clips = [
        Clip(name, SignalSequence((one,), 30.0))
        for name, one in (("hip", still), ("face", face), ("rest", Signals.rest()))
    ]
    export_avatar(avatar, tmp_path / "a.glb", clips)
    found = Glb((tmp_path / "a.glb").read_bytes())
    assert set(found.channels("hip")) == {(1, "rotation")}
    assert set(found.channels("face")) == {(55, "weights"), (23, "rotation"), (24, "rotation")}
    assert set(found.channels("rest")) == {(0, "translation")}
    nod = np.zeros((21, 3))
    nod[14] = 0.2  # the head
    talking = Clip("talk", SignalSequence((face.replace(body_pose=nod),), 30.0))
    assert frames_of([*clips, talking]) == [still]


def test_two_half_turns_are_one_way_round(rig):
    """Rotation vectors that jump from +π to −π are one turn that goes on."""
    angles = np.radians([170, 179, -179, -170, 170])
    frames = tuple(Signals.rest().replace(global_orient=np.array([0, angle, 0])) for angle in angles)
    values = Clip("turn", SignalSequence(frames, 30.0)).rotations()[:, 0]
    assert ((values[1:] * values[:-1]).sum(1) > 0).all()


@pytest.mark.slow
def test_the_validator_of_khronos_finds_nothing(files):
    """`cd DIR && npm install gltf-validator`, DIR named by AVATARREX_NODE."""
    folder = os.environ.get("AVATARREX_NODE")
    if not (folder and shutil.which("node") and (Path(folder) / "node_modules/gltf-validator").is_dir()):
        pytest.skip("no gltf-validator: `npm install gltf-validator` in a folder named by AVATARREX_NODE")
    script = Path(__file__).parents[2] / "tools/exports/validate.mjs"
    command = ["node", str(script), str(files / "a.glb"), str(files / "a.vrm")]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    for line in done.stdout.splitlines():
        report = json.loads(line)
        assert report["numErrors"] == report["numWarnings"] == 0, report


def test_an_avatar_without_terms_says_so(unsigned, tmp_path):
    exported = export_avatar(unsigned, tmp_path / "a.vrm")
    file = Glb((tmp_path / "a.vrm").read_bytes())
    assert exported.label.missing == ("licence", "consent", "authors")
    assert file.document.asset.extras["avatarrex"]["not_stated"] == "licence, consent, authors"
    assert file.document.extensions["VRMC_vrm"]["meta"]["authors"] == ["not stated"]


def test_what_an_avatar_allows_is_what_the_vrm_allows(avatar, tmp_path):
    allowed = {"avatarPermission": "everyone", "allowRedistribution": True}
    export_avatar(replace(avatar, meta={**avatar.meta, "allowed_use": allowed}), tmp_path / "a.vrm")
    meta = Glb((tmp_path / "a.vrm").read_bytes()).document.extensions["VRMC_vrm"]["meta"]
    assert (meta["avatarPermission"], meta["allowRedistribution"]) == ("everyone", True)
    assert meta["commercialUsage"] == "personalNonProfit"
