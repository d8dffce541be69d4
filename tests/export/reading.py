"""A GLB read as glTF 2.0 says, with pygltflib and NumPy alone: the reference of the writer."""

from __future__ import annotations

import numpy as np
import pygltflib
from scipy.spatial.transform import Rotation

WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
KIND = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}


class Glb:
    """The document and its numbers."""

    def __init__(self, content: bytes) -> None:
        self.document = pygltflib.GLTF2.load_from_bytes(content)
        self.blob = self.document.binary_blob()

    def view(self, index, kind, count):
        view = self.document.bufferViews[index]
        assert count * np.dtype(kind).itemsize <= view.byteLength
        assert view.byteOffset + view.byteLength <= len(self.blob)
        assert view.byteOffset % np.dtype(kind).itemsize == 0
        return np.frombuffer(self.blob, kind, count, view.byteOffset)

    def values(self, index):
        """(n, c) of an accessor, sparse ones filled in."""
        accessor = self.document.accessors[index]
        kind, width = KIND[accessor.componentType], WIDTH[accessor.type]
        if accessor.bufferView is None:
            dense = np.zeros((accessor.count, width), kind)
        else:
            dense = self.view(accessor.bufferView, kind, accessor.count * width).reshape(-1, width).copy()
        if accessor.sparse is not None:
            sparse = accessor.sparse
            rows = self.view(sparse.indices.bufferView, KIND[sparse.indices.componentType], sparse.count)
            assert (np.diff(rows.astype(int)) > 0).all()
            assert rows[-1] < accessor.count
            dense[rows] = self.view(sparse.values.bufferView, kind, sparse.count * width).reshape(-1, width)
        return dense

    @property
    def primitive(self):
        return self.document.meshes[0].primitives[0]

    def influences(self):
        """Joints (t, k) and weights (t, k) of all sets."""
        attributes = self.primitive.attributes
        sets = [n for n in (0, 1) if getattr(attributes, f"JOINTS_{n}", None) is not None]
        return tuple(
            np.concatenate([self.values(getattr(attributes, f"{name}_{n}")) for n in sets], 1)
            for name in ("JOINTS", "WEIGHTS")
        )

    def channels(self, animation):
        """(node, path) -> times (n,), values (n, …)."""
        clip = next(clip for clip in self.document.animations if clip.name == animation)
        found = {}
        for channel in clip.channels:
            sampler = clip.samplers[channel.sampler]
            times, values = self.values(sampler.input)[:, 0], self.values(sampler.output)
            found[channel.target.node, channel.target.path] = times, values.reshape(len(times), -1)
        return found

    def posed(self, animation=None, frame=0):
        """(t, 3): vertices by glTF's rules: morph targets, then Σ w · global joint · inverse bind."""
        nodes, channels = self.document.nodes, self.channels(animation) if animation else {}

        def value(node, path, rest):
            return channels[node, path][1][frame] if (node, path) in channels else rest

        local = []
        for index, node in enumerate(nodes):
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_quat(value(index, "rotation", node.rotation or [0, 0, 0, 1])).as_matrix()
            matrix[:3, 3] = value(index, "translation", node.translation or [0, 0, 0])
            local.append(matrix)
        world = [None] * len(nodes)

        def walk(index, above):
            world[index] = above @ local[index]
            for child in nodes[index].children or ():
                walk(child, world[index])

        for root in self.document.scenes[0].nodes:
            walk(root, np.eye(4))
        skin = self.document.skins[0]
        inverse = self.values(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
        matrices = np.stack([world[joint] for joint in skin.joints]) @ inverse
        mesh_node = next(k for k, node in enumerate(nodes) if node.mesh is not None)
        rest = self.values(self.primitive.attributes.POSITION).astype(float)
        for weight, target in zip(value(mesh_node, "weights", np.zeros(52)), self.primitive.targets):
            rest += weight * self.values(target["POSITION"] if isinstance(target, dict) else target.POSITION)
        joints, weights = self.influences()
        blended = (weights[..., None, None] * matrices[joints]).sum(1)
        return np.einsum("vab,vb->va", blended[:, :3, :3], rest) + blended[:, :3, 3]
