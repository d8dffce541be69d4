"""USD by usd-core (`pip install 'avatarrex-studio[usd]'`): UsdSkel with blend shapes and animations, one emissive texture.

Points are the surface's own, texture coordinates those of the faces' corners, so nothing is split at seams. The colours contain the
light: the material emits them and reflects nothing. The first clip is bound; further ones are animations beside it, which a program
binds by name, at the first one's rate.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from avatarrex.export.clips import Clip
from avatarrex.export.glb import jpeg
from avatarrex.export.label import Label
from avatarrex.export.rig import Rig
from avatarrex.files.gate import written
from avatarrex.signals.joints import JOINT_NAMES

if TYPE_CHECKING:
    from pxr import Usd

ROOT = "/Avatar"


def write_usd(rig: Rig, clips: Sequence[Clip], label: Label, path: Path) -> list[Path]:
    """Write `.usdz`, or `.usdc` with its texture beside it; all or nothing. Raises `InputError`."""
    from pxr import Sdf, UsdUtils

    package = path.suffix.lower() == ".usdz"
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        texture = folder / ("colour.jpg" if package else f"{path.stem}.jpg")
        texture.write_bytes(jpeg(rig.texture))
        layer = folder / "avatar.usdc"
        _write_layer(rig, clips, label, layer, texture.name)
        if package:
            temporary = stack.enter_context(written(path))
            temporary.unlink()
            if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(layer)), str(temporary)):
                raise OSError(f"{path}: usd-core wrote no package")
            return [path]
        files = {path: layer, path.with_suffix(".jpg"): texture}
        for target, made in files.items():
            stack.enter_context(written(target)).write_bytes(made.read_bytes())
        return list(files)


def _write_layer(rig: Rig, clips: Sequence[Clip], label: Label, layer: Path, texture: str) -> None:
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.CreateNew(str(layer))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdSkel.Root.Define(stage, ROOT)
    stage.SetDefaultPrim(root.GetPrim())
    about = {"licence": label.licence, "consent": label.consent, "avatarrex": json.dumps(label.json())}
    stage.GetRootLayer().customLayerData = about
    skeleton = _skeleton(stage, rig)
    _mesh(stage, rig)
    _material(stage, texture)
    names = _prim_names(clips)
    if clips:
        fps = clips[0].sequence.fps
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(max(clips[0].sequence.duration * fps, 0))
        for clip, name in zip(clips, names):
            _animation(stage, rig, clip, f"{ROOT}/{name}", fps)
        binding = UsdSkel.BindingAPI.Apply(skeleton)
        binding.CreateAnimationSourceRel().SetTargets([f"{ROOT}/{names[0]}"])
    stage.GetRootLayer().Save()


def _prim_names(clips: Sequence[Clip]) -> list[str]:
    """Names that USD takes, each once."""
    from pxr import Tf

    names: list[str] = []
    for clip in clips:
        name = "clip_" + Tf.MakeValidIdentifier(clip.name)
        names.append(name if name not in names else f"{name}_{len(names)}")
    return names


def _paths(rig: Rig) -> list[str]:
    """UsdSkel's names of the joints: `pelvis/left_hip/…`."""
    paths: list[str] = []
    for j, name in enumerate(JOINT_NAMES):
        parent = rig.parents[j]
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def _skeleton(stage: Usd.Stage, rig: Rig) -> Usd.Prim:
    from pxr import Gf, UsdSkel, Vt

    skeleton = UsdSkel.Skeleton.Define(stage, f"{ROOT}/Skeleton")
    skeleton.CreateJointsAttr(_paths(rig))
    local = _local(rig)
    for attribute, places in (
        (skeleton.CreateBindTransformsAttr, rig.places),
        (skeleton.CreateRestTransformsAttr, local),
    ):
        attribute(Vt.Matrix4dArray([Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(*map(float, place))) for place in places]))
    return skeleton.GetPrim()


def _local(rig: Rig) -> np.ndarray:
    """(j, 3): joints from their parents."""
    return np.stack([place - (rig.places[above] if above >= 0 else 0) for place, above in zip(rig.places, rig.parents)])


def _mesh(stage: Usd.Stage, rig: Rig) -> None:
    from pxr import Gf, Sdf, UsdGeom, UsdShade, UsdSkel, Vt

    mesh = UsdGeom.Mesh.Define(stage, f"{ROOT}/Body")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(rig.vertices))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([rig.vertices.min(0), rig.vertices.max(0)])))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(rig.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(rig.faces.reshape(-1)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(rig.normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    st.Set(Vt.Vec2fArray.FromNumpy((rig.uv * [1, -1] + [0, 1]).astype(np.float32)))
    st.SetIndices(Vt.IntArray.FromNumpy(rig.uv_faces.reshape(-1)))
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    bones = rig.joint.shape[1]
    binding.CreateSkeletonRel().SetTargets([f"{ROOT}/Skeleton"])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    binding.CreateJointIndicesPrimvar(False, bones).Set(Vt.IntArray.FromNumpy(rig.joint.reshape(-1).astype(np.int32)))
    binding.CreateJointWeightsPrimvar(False, bones).Set(Vt.FloatArray.FromNumpy(rig.weight.reshape(-1)))
    for morph in rig.morphs:
        shape = UsdSkel.BlendShape.Define(stage, f"{ROOT}/Body/{morph.name}")
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(morph.offset))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(morph.vertex))
    binding.CreateBlendShapesAttr([morph.name for morph in rig.morphs])
    binding.CreateBlendShapeTargetsRel().SetTargets([f"{ROOT}/Body/{morph.name}" for morph in rig.morphs])
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(UsdShade.Material.Define(stage, f"{ROOT}/Material"))


def _material(stage: Usd.Stage, texture: str) -> None:
    """UsdPreviewSurface that emits the texture."""
    from pxr import Sdf, UsdShade

    kinds = Sdf.ValueTypeNames

    def shader(name: str, kind: str, inputs: dict[str, tuple[Any, Any]]) -> UsdShade.Shader:
        made = UsdShade.Shader.Define(stage, f"{ROOT}/Material/{name}")
        made.CreateIdAttr(kind)
        for key, (type_name, value) in inputs.items():
            made.CreateInput(key, type_name).Set(value)
        return made

    reader = shader("Coordinates", "UsdPrimvarReader_float2", {"varname": (kinds.String, "st")})
    image = shader("Colour", "UsdUVTexture", {
        "file": (kinds.Asset, Sdf.AssetPath(f"./{texture}")), "sourceColorSpace": (kinds.Token, "sRGB"),
        "wrapS": (kinds.Token, "clamp"), "wrapT": (kinds.Token, "clamp"),
    })  # fmt: skip
    black = (kinds.Color3f, (0.0, 0.0, 0.0))
    surface = shader("Surface", "UsdPreviewSurface", {
        "diffuseColor": black, "specularColor": black, "useSpecularWorkflow": (kinds.Int, 1), "roughness": (kinds.Float, 1.0),
    })  # fmt: skip
    image.CreateInput("st", kinds.Float2).ConnectToSource(reader.CreateOutput("result", kinds.Float2))
    surface.CreateInput("emissiveColor", kinds.Color3f).ConnectToSource(image.CreateOutput("rgb", kinds.Float3))
    material = UsdShade.Material.Get(stage, f"{ROOT}/Material")
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", kinds.Token))


def _animation(stage: Usd.Stage, rig: Rig, clip: Clip, path: str, fps: float) -> None:
    """Time samples at the stage's rate."""
    from pxr import Gf, UsdSkel, Vt

    if clip.sequence.fps != fps:
        clip = Clip(clip.name, clip.sequence.resample(fps))
    animation = UsdSkel.Animation.Define(stage, path)
    animation.CreateJointsAttr(_paths(rig))
    animation.CreateBlendShapesAttr([morph.name for morph in rig.morphs])
    animation.CreateScalesAttr(Vt.Vec3hArray(len(JOINT_NAMES), Gf.Vec3h(1, 1, 1)))
    rotations, moved, weights = clip.rotations(), clip.translations(), clip.expressions()
    turns, places = animation.CreateRotationsAttr(), animation.CreateTranslationsAttr()
    amounts = animation.CreateBlendShapeWeightsAttr()
    local = _local(rig)
    for t in range(len(clip)):
        turns.Set(Vt.QuatfArray.FromNumpy(rotations[t].astype(np.float32)), t)
        at = local.copy()
        at[0] += moved[t]
        places.Set(Vt.Vec3fArray.FromNumpy(at.astype(np.float32)), t)
        amounts.Set(Vt.FloatArray.FromNumpy(weights[t].astype(np.float32)), t)
