"""USD, OBJ, PLY and the web page, opened again by their own libraries; what is refused."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from base64 import b64decode

import numpy as np
import pytest
import trimesh
from avatarrex_studio.cli import main as cli
from PIL import Image
from reading import Glb

from avatarrex.errors import InputError
from avatarrex.export.clips import read_clips
from avatarrex.export.export import export_avatar
from avatarrex.export.target import check_export
from avatarrex.signals.joints import EXPRESSION_NAMES


@pytest.fixture(scope="module")
def stage(avatar, moving, tmp_path_factory):
    pytest.importorskip("pxr", reason="no usd-core: pip install 'avatarrex-studio[usd]'")
    from pxr import Usd

    path = tmp_path_factory.mktemp("usd") / "a.usdz"
    export_avatar(avatar, path, [moving])
    return Usd.Stage.Open(str(path))


@pytest.mark.parametrize("frame", [0, 10])
def test_usd_skins_as_we_do(stage, rig, moving, frame):
    from pxr import Usd, UsdSkel, Vt

    cache = UsdSkel.Cache()
    root = UsdSkel.Root(stage.GetPrimAtPath("/Avatar"))
    cache.Populate(root, Usd.TraverseInstanceProxies())
    (binding,) = cache.ComputeSkelBindings(root, Usd.TraverseInstanceProxies())
    skeleton, (mesh,) = cache.GetSkelQuery(binding.GetSkeleton()), binding.GetSkinningTargets()
    shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(mesh.GetPrim()))
    weights = skeleton.GetAnimQuery().ComputeBlendShapeWeights(frame)
    points = Vt.Vec3fArray.FromNumpy(rig.vertices)
    sub_weights, indices, sub = shapes.ComputeSubShapeWeights(weights)
    offsets, rows = shapes.ComputeSubShapePointOffsets(), shapes.ComputeBlendShapePointIndices()
    assert shapes.ComputeDeformedPoints(sub_weights, indices, sub, rows, offsets, points)
    matrices = skeleton.ComputeSkinningTransforms(frame)
    assert mesh.ComputeSkinnedPoints(matrices, points, frame)
    assert np.abs(np.array(points) - rig.moved(moving.sequence[frame])).max() < 1e-5


def test_usd_says_what_it_is(stage, rig):
    from pxr import UsdGeom, UsdShade

    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1.0)
    assert (stage.GetTimeCodesPerSecond(), stage.GetEndTimeCode()) == (10, 10)
    about = stage.GetRootLayer().customLayerData
    assert about["licence"] == "CC BY 4.0"
    assert json.loads(about["avatarrex"])["losses"]["joints of a vertex"] == 8
    body = stage.GetPrimAtPath("/Avatar/Body")
    assert list(body.GetAttribute("skel:blendShapes").Get()) == list(EXPRESSION_NAMES)
    st = UsdGeom.PrimvarsAPI(body).GetPrimvar("st")
    flat = st.ComputeFlattened()
    assert np.allclose(np.array(flat)[0], rig.uv[rig.uv_faces[0, 0]] * [1, -1] + [0, 1])
    material, _ = UsdShade.MaterialBindingAPI(body).ComputeBoundMaterial()
    assert material.GetPath() == "/Avatar/Material"


def test_the_validators_of_usd_find_nothing(stage):
    validation = pytest.importorskip(
        "pxr.UsdValidation", reason="a usd-core without validators: pip install -U usd-core"
    )
    registry = validation.ValidationRegistry()
    names = [item.name for item in registry.GetAllValidatorMetadata() if not item.isSuite]
    assert len(names) > 10
    found = validation.ValidationContext(registry.GetOrLoadValidatorsByName(names)).Validate(stage)
    assert [error.GetMessage() for error in found] == []


def test_usdc_has_its_texture_beside_it(avatar, tmp_path):
    pytest.importorskip("pxr", reason="no usd-core: pip install 'avatarrex-studio[usd]'")
    exported = export_avatar(avatar, tmp_path / "a.usdc")
    assert sorted(path.name for path in exported.files) == ["a.jpg", "a.usdc"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.jpg", "a.usdc"]
    from pxr import Usd

    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    image = stage.GetPrimAtPath("/Avatar/Material/Colour").GetAttribute("inputs:file")
    assert image.Get().path == "./a.jpg"


def test_obj_has_the_posed_surface_and_its_texture(avatar, source, moving, tmp_path):
    still = read_clips((), ["squat"])
    export_avatar(avatar, tmp_path / "a.obj", still)
    mesh = trimesh.load(tmp_path / "a.obj", process=False)
    surface, signals = source.surface, still[0].sequence[0]
    posed = source.posed(signals)
    found = source.world(posed, signals)[surface.faces]
    assert np.abs(np.sort(mesh.triangles.reshape(-1, 9), 0) - np.sort(found.reshape(-1, 9), 0)).max() < 1e-6
    uv = mesh.visual.uv[mesh.faces]
    assert np.abs(uv * [1, -1] + [0, 1] - surface.uv[surface.uv_faces]).max() < 1e-6
    assert mesh.visual.material.image.size == (128, 128)
    assert "# licence: CC BY 4.0" in (tmp_path / "a.obj").read_text()


def test_ply_has_the_colours_of_the_pose(avatar, source, tmp_path):
    export_avatar(avatar, tmp_path / "a.ply", read_clips((), ["wave"]))
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    signals = read_clips((), ["wave"])[0].sequence[0]
    colours = source.colours(source.posed(signals), signals)
    assert np.abs(mesh.visual.vertex_colors[:, :3] - 255 * colours).max() <= 0.51
    assert b"comment consent: given in writing" in (tmp_path / "a.ply").read_bytes()[:4000]


def test_a_motion_is_a_numbered_sequence_with_one_texture(avatar, moving, tmp_path):
    exported = export_avatar(avatar, tmp_path / "a.obj", [moving])
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["a.mtl", "a.png", *(f"a_{k:04d}.obj" for k in range(1, 12))]
    assert sorted(path.name for path in exported.files) == names
    first, last = (trimesh.load(tmp_path / f"a_{k:04d}.obj", process=False) for k in (1, 11))
    assert np.abs(first.vertices - last.vertices).max() > 0.5
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (128, 128)


def test_the_page_is_one_file_that_fetches_nothing(avatar, moving, tmp_path):
    export_avatar(avatar, tmp_path / "a.html", [moving])
    text = (tmp_path / "a.html").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]
    assert not re.search(r"<(script|link|img)[^>]*\s(src|href)=", text)
    assert text.count("<script") == text.count("</script>") == 3
    assert "{{" not in re.sub(r'<script type="module">.*</script>', "", text, flags=re.S)
    inside = re.search(r'id="glb">([^<]*)<', text)[1]
    glb = Glb(b64decode(inside))
    assert glb.influences()[0].shape[1] == 4
    label = json.loads(re.search(r'id="label">(.*?)</script>', text, re.S)[1])
    assert label["consent"] == "given in writing"
    assert "three.js authors" in text


def test_a_name_cannot_break_the_page(avatar, tmp_path, monkeypatch):
    monkeypatch.setitem(avatar.meta, "name", "</script><script>alert(1)</script>{{GLB}}")
    export_avatar(avatar, tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text()
    assert text.count("<script") == text.count("</script") == 3
    assert text.count("{{GLB}}") == 3  # title, heading, label: none was filled in


@pytest.mark.parametrize(
    ("name", "clips", "words"),
    [
        ("a.fbx", 0, ".glb"),
        ("a", 0, "no extension"),
        ("a.vrm", 1, "no clips"),
        ("a.obj", 2, "one motion or pose"),
        ("missing\0/a.glb", 0, "expected"),
    ],
)
def test_what_cannot_be_is_refused_before_work(tmp_path, name, clips, words):
    with pytest.raises(InputError, match=re.escape(words)):
        check_export(tmp_path / name, clips)
    assert not list(tmp_path.iterdir())


def test_usd_without_its_package_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr("avatarrex.export.target.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"avatarrex-studio\[usd\]"):
        check_export(tmp_path / "a.usdz")


def test_a_folder_in_the_way_of_the_texture_is_refused(tmp_path):
    (tmp_path / "a.png").mkdir()
    with pytest.raises(InputError, match="a file to write"):
        check_export(tmp_path / "a.obj")


@pytest.mark.parametrize(("name", "taken"), [("a.obj", "a.png"), ("a.obj", "a.mtl"), ("a.usdc", "a.jpg")])
def test_a_file_of_somebody_elses_beside_it_is_not_replaced(tmp_path, name, taken):
    check_export(tmp_path / name)
    (tmp_path / taken).write_text("mine")
    with pytest.raises(InputError, match=rf"{taken}: expected nothing there"):
        check_export(tmp_path / name)
    (tmp_path / name).write_text("an export before")
    check_export(tmp_path / name)


@pytest.mark.parametrize("ending", [".glb", ".obj", ".usdz", ".html"])
def test_what_fails_midway_leaves_nothing(avatar, moving, tmp_path, monkeypatch, ending):
    def fail(*_, **__):
        raise OSError("no space left")

    places = {
        ".glb": "Path.write_bytes",
        ".obj": "Image.Image.save",
        ".usdz": "Path.unlink",
        ".html": "Path.write_bytes",
    }
    target = {"Path.write_bytes": "pathlib.Path.write_bytes", "Image.Image.save": "PIL.Image.Image.save"}
    if ending == ".usdz":
        pytest.importorskip("pxr")
        monkeypatch.setattr("pxr.UsdUtils.CreateNewUsdzPackage", lambda *_: False)
    else:
        monkeypatch.setattr(target[places[ending]], fail)
    with pytest.raises((OSError, InputError)):
        export_avatar(avatar, tmp_path / f"a{ending}", [moving])
    assert not list(tmp_path.iterdir())


def test_an_avatar_without_a_surface_is_refused_in_one_line(avatar, tmp_path, monkeypatch):
    monkeypatch.setattr(avatar, "surface", None)
    with pytest.raises(InputError, match="surface: expected an avatar with a surface"):
        export_avatar(avatar, tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_a_use_that_there_is_not_is_refused(avatar, tmp_path, monkeypatch):
    for allowed, words in (({"fly": True}, "fly"), ({"allowRedistribution": 1}, "False or True"), ([], "an object")):
        monkeypatch.setitem(avatar.meta, "allowed_use", allowed)
        with pytest.raises(InputError, match=words):
            export_avatar(avatar, tmp_path / "a.vrm")


def test_the_verb_prints_the_table(avatar, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("avatarrex.avatar_file.load_avatar", lambda *_: avatar)
    assert cli.main(["export", "default", str(tmp_path / "a.glb"), "--pose", "wave", "--pose", "squat"]) == 0
    out = capsys.readouterr().out
    assert "licence: CC BY 4.0" in out
    assert re.search(r"place against the whole surface, mm, p99 +\d", out)
    assert out.splitlines()[-1].endswith("a.glb")
    assert {clip.name for clip in Glb((tmp_path / "a.glb").read_bytes()).document.animations} == {"wave", "squat"}


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["a.fbx"], ".fbx"),
        (["a.vrm", "--pose", "wave"], "no clips"),
        (["a.glb", "--pose", "wav"], "wave"),
        (["a.glb", "--motion", "nothing.bvh"], "nothing there"),
        (["a.glb", "--motion", "odd.bvh"], "odd.bvh"),
        (["a.glb", "--motion", ""], "--motion"),
        ([""], "OUT"),
    ],
)
def test_the_verb_refuses_in_one_line(tmp_path, monkeypatch, capsys, words, found):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd.bvh").write_text(
        "HIERARCHY\nROOT Wheel\n{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation Zrotation\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\n"
        "MOTION\nFrames: 1\nFrame Time: 0.03\n0 0 0\n"
    )
    assert cli.main(["export", "default", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert found in error
    assert [path.name for path in tmp_path.iterdir()] == ["odd.bvh"]


def test_a_refusal_needs_no_torch(tmp_path):
    code = """
import sys
from avatarrex_studio.cli.main import main
assert main(["export", "default", "a.fbx"]) == 2
assert "torch" not in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
