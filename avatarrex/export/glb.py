"""GLB (glTF 2.0) by pygltflib: skeleton, skin, sparse morph targets, one unlit texture, animation clips.

The colours contain the light already, so the material is `KHR_materials_unlit`: lit again it would be lit twice. Vertices are
those of the texture, split at its seams. Joint nodes have no rotation at rest, and so inverse bind matrices are translations.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import pygltflib as gltf
from PIL import Image

from avatarrex.export.clips import Clip
from avatarrex.export.label import Label
from avatarrex.export.rig import Rig
from avatarrex.signals.joints import JOINT_NAMES

JPEG_QUALITY = 95
"""Without chroma subsampling; what it loses is a line of the table."""
TYPES = {1: gltf.SCALAR, 2: gltf.VEC2, 3: gltf.VEC3, 4: gltf.VEC4, 16: gltf.MAT4}
COMPONENTS = {
    "float32": gltf.FLOAT,
    "uint32": gltf.UNSIGNED_INT,
    "uint16": gltf.UNSIGNED_SHORT,
    "uint8": gltf.UNSIGNED_BYTE,
}
MESH_NODE = len(JOINT_NAMES)
"""Index of the node with the mesh: joints are the nodes before it, in their own order."""


class Document:
    """A glTF document with its one buffer."""

    def __init__(self) -> None:
        self.gltf = gltf.GLTF2(scene=0)
        self._data = bytearray()

    def view(self, content: bytes, target: int | None = None) -> int:
        """A buffer view of some bytes; its index."""
        self._data += bytes(-len(self._data) % 4)
        view = gltf.BufferView(buffer=0, byteOffset=len(self._data), byteLength=len(content), target=target)
        self._data += content
        self.gltf.bufferViews.append(view)
        return len(self.gltf.bufferViews) - 1

    def accessor(self, values: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """An accessor of an array (n,) or (n, c); its index."""
        rows = values.reshape(len(values), -1)
        accessor = gltf.Accessor(
            bufferView=self.view(np.ascontiguousarray(rows).tobytes(), target),
            componentType=COMPONENTS[values.dtype.name],
            count=len(rows),
            type=TYPES[rows.shape[1]],
        )
        if bounds:
            accessor.min, accessor.max = rows.min(0).tolist(), rows.max(0).tolist()
        return self._added(accessor)

    def sparse(self, count: int, index: np.ndarray, values: np.ndarray) -> int:
        """An accessor of `count` vectors that are zero but for `values` (n, 3) at `index` (n,), which ascends."""
        if not len(index):  # at least one is to be named
            index, values = np.zeros(1, np.int64), np.zeros((1, 3), np.float32)
        small = index.astype(np.uint16 if count <= 1 << 16 else np.uint32)
        bound = np.concatenate([values, np.zeros((int(len(index) < count), 3), np.float32)])
        indices = gltf.AccessorSparseIndices(
            bufferView=self.view(small.tobytes()), componentType=COMPONENTS[small.dtype.name]
        )
        stored = gltf.AccessorSparseValues(bufferView=self.view(np.ascontiguousarray(values, np.float32).tobytes()))
        accessor = gltf.Accessor(
            byteOffset=None, componentType=gltf.FLOAT, count=count, type=gltf.VEC3,
            min=bound.min(0).tolist(), max=bound.max(0).tolist(),
            sparse=gltf.Sparse(count=len(index), indices=indices, values=stored),
        )  # fmt: skip
        return self._added(accessor)

    def _added(self, accessor: gltf.Accessor) -> int:
        self.gltf.accessors.append(accessor)
        return len(self.gltf.accessors) - 1

    def bytes(self) -> bytes:
        """The whole as GLB."""
        self._data += bytes(-len(self._data) % 4)
        self.gltf.buffers = [gltf.Buffer(byteLength=len(self._data))]
        self.gltf.set_binary_blob(bytes(self._data))
        return b"".join(self.gltf.save_to_bytes())


def glb_document(rig: Rig, clips: Sequence[Clip], label: Label) -> Document:
    """The avatar as a glTF document; eight joints a vertex go into two sets, the strongest four first."""
    document = Document()
    document.gltf.asset = gltf.Asset(
        generator="AvatarReX Studio", copyright=label.licence, extras={"avatarrex": label.json()}
    )
    document.gltf.extensionsUsed = ["KHR_materials_unlit"]
    _skeleton(document, rig, label.name)
    _mesh(document, rig, label.name)
    _material(document, rig)
    for clip in clips:
        _animation(document, rig, clip)
    return document


def jpeg(texture: np.ndarray) -> bytes:
    """A texture as JPEG."""
    buffer = io.BytesIO()
    Image.fromarray(texture).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0, optimize=True)
    return buffer.getvalue()


def _skeleton(document: Document, rig: Rig, name: str) -> None:
    """Nodes of the joints, of the mesh, and of the whole; the skin."""
    nodes = []
    for j, joint in enumerate(JOINT_NAMES):
        parent = rig.parents[j]
        place = rig.places[j] - (rig.places[parent] if parent >= 0 else 0)
        children = [child for child, above in enumerate(rig.parents) if above == j]
        nodes.append(gltf.Node(name=joint, translation=place.tolist(), children=children))
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(nodes), 1, 1))
    inverse[:, 3, :3] = -rig.places  # column by column
    skin = gltf.Skin(
        name=f"{name} skin", joints=list(range(len(nodes))), skeleton=0,
        inverseBindMatrices=document.accessor(inverse.reshape(-1, 16)),
    )  # fmt: skip
    nodes.append(gltf.Node(name=f"{name} mesh", mesh=0, skin=0))  # of no node: a skinned mesh follows its joints alone
    nodes.append(gltf.Node(name=name, children=[0]))
    document.gltf.nodes, document.gltf.skins = nodes, [skin]
    document.gltf.scenes = [gltf.Scene(name=name, nodes=[MESH_NODE + 1, MESH_NODE])]


def _mesh(document: Document, rig: Rig, name: str) -> None:
    vertex, array = rig.uv_vertex, gltf.ARRAY_BUFFER
    attributes = gltf.Attributes(
        POSITION=document.accessor(rig.vertices[vertex], array, bounds=True),
        NORMAL=document.accessor(rig.normals[vertex], array),
        TEXCOORD_0=document.accessor(rig.uv, array),
    )
    for number, first in enumerate(range(0, rig.joint.shape[1], 4)):
        for kind, values in (("JOINTS", rig.joint), ("WEIGHTS", rig.weight)):
            four = np.zeros((len(vertex), 4), values.dtype)
            part = values[vertex, first : first + 4]
            four[:, : part.shape[1]] = part
            setattr(attributes, f"{kind}_{number}", document.accessor(four, array))
    primitive = gltf.Primitive(
        attributes=attributes,
        indices=document.accessor(rig.uv_faces.reshape(-1).astype(np.uint32), gltf.ELEMENT_ARRAY_BUFFER),
        material=0,
        targets=[gltf.Attributes(POSITION=target) for target in _targets(document, rig)],
    )
    names = [morph.name for morph in rig.morphs]
    document.gltf.meshes = [
        gltf.Mesh(name=name, primitives=[primitive], weights=[0.0] * len(names), extras={"targetNames": names})
    ]


def _targets(document: Document, rig: Rig) -> list[int]:
    """Sparse accessors of the morph targets at the texture's vertices."""
    accessors = []
    row = np.full(len(rig.vertices), -1)
    for morph in rig.morphs:
        row[morph.vertex] = np.arange(len(morph.vertex))
        moved = np.flatnonzero(row[rig.uv_vertex] >= 0)
        accessors.append(document.sparse(len(rig.uv_vertex), moved, morph.offset[row[rig.uv_vertex[moved]]]))
        row[morph.vertex] = -1
    return accessors


def _material(document: Document, rig: Rig) -> None:
    document.gltf.images = [
        gltf.Image(bufferView=document.view(jpeg(rig.texture)), mimeType="image/jpeg", name="colour")
    ]
    document.gltf.samplers = [
        gltf.Sampler(
            magFilter=gltf.LINEAR,
            minFilter=gltf.LINEAR_MIPMAP_LINEAR,
            wrapS=gltf.CLAMP_TO_EDGE,
            wrapT=gltf.CLAMP_TO_EDGE,
        )
    ]
    document.gltf.textures = [gltf.Texture(source=0, sampler=0)]
    colour = gltf.PbrMetallicRoughness(
        baseColorTexture=gltf.TextureInfo(index=0), metallicFactor=0.0, roughnessFactor=1.0
    )
    document.gltf.materials = [
        gltf.Material(
            name="avatar", pbrMetallicRoughness=colour, extensions={"KHR_materials_unlit": {}}, alphaCutoff=None
        )
    ]


def _animation(document: Document, rig: Rig, clip: Clip) -> None:
    """Channels of what leaves rest: joints' rotations, the morph targets' weights, the pelvis' place.

    So a program can play a face recording on top of a motion.
    """
    animation = gltf.Animation(name=clip.name)
    times = document.accessor(clip.times.astype(np.float32), bounds=True)

    def channel(values: np.ndarray, node: int, path: str) -> None:
        target = gltf.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(gltf.AnimationChannel(sampler=len(animation.samplers), target=target))
        output = document.accessor(values.astype(np.float32))
        animation.samplers.append(gltf.AnimationSampler(input=times, output=output, interpolation=gltf.ANIM_LINEAR))

    rotations = clip.rotations()
    for j in np.flatnonzero(np.abs(rotations[..., :3]).max((0, 2)) > 0):
        channel(rotations[:, j], int(j), "rotation")
    expressions, moved = clip.expressions(), clip.translations()
    if expressions.any():
        channel(expressions.reshape(-1), MESH_NODE, "weights")
    if moved.any() or not animation.channels:  # at least one is to be there
        channel(rig.places[0] + moved, 0, "translation")
    document.gltf.animations.append(animation)
