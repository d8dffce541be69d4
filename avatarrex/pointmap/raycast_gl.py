"""The raycast as GLSL compute passes (shaders/pointmap): trace, exact walk, silhouettes, surface.

Between the passes the rays that need more work are compacted into lists and dispatched indirectly; only the records of
covered pixels are read back, and only volumes that changed are uploaded.
"""

from __future__ import annotations

import moderngl
import numpy as np
import torch

from avatarrex.camera import Camera
from avatarrex.gl.context import gl_context, per_context, renderer_name
from avatarrex.gl.grids import GridTextures
from avatarrex.gl.shader import compute_shader
from avatarrex.pointmap.pointmap import PointMap, scatter
from avatarrex.pointmap.rays import RayPlane
from avatarrex.volume.volume import PARTS, SdfVolume

GROUP = 64
"""Rays in a work group; 8 × 8 pixels where all pixels are visited."""
PART = np.dtype(
    [("box_from_root", "f4", (4, 4)), ("size", "f4", 3), ("voxel", "f4"), ("first", "f4", 3), ("contact", "i4")]
)
"""Mirrors `struct Part` of shaders/pointmap/volume.glsl; the matrix by columns (std140)."""
LIST = np.dtype([("groups", "u4"), ("one", "u4"), ("also_one", "u4"), ("count", "u4")])
LISTS = np.dtype([("lists", LIST, 8), ("steps", "u4")])
"""Mirrors `buffer Lists` of shaders/pointmap/rays.glsl."""
RECORD = np.dtype(
    [
        ("position", "f4", 3),
        ("pixel", "u4"),
        ("normal", "f4", 3),
        ("coverage", "f4"),
        ("weight", "f4", 3),
        ("steps", "f4"),
    ]
)
"""Mirrors `struct Record` of shaders/pointmap/surface.comp."""
TRACE_LIST, EXACT_LIST, EDGE_LIST, COVERED_LIST = range(0, 8, 2)
"""Each comes twice: rays that meet no part box, and rays that do."""
HIT_BIT = np.uint32(1 << 31)


def raycast_gl(volume: SdfVolume, camera: Camera, antialias: bool) -> PointMap:
    """See `avatarrex.pointmap.pointmap.raycast`."""
    context = gl_context()
    return per_context(context, "raycast", lambda: _Caster(context)).cast(volume, camera, antialias)


class _Caster:
    """Programs, textures and buffers of one context."""

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self.textures = GridTextures(context)
        self.programs: dict[tuple[str, int, int], moderngl.ComputeShader] = {}
        self.parts = context.buffer(reserve=len(PARTS) * PART.itemsize)
        self.lists = context.buffer(reserve=LISTS.itemsize)
        self.pixels: list[moderngl.Buffer] = []

    def cast(self, volume: SdfVolume, camera: Camera, antialias: bool) -> PointMap:
        count = camera.width * camera.height
        slots = 2 * (count // 4 + 4096) if antialias else 0
        uploaded = self._bind_volume(volume)
        self._bind_buffers(count, slots)
        variants = (0, 1) if volume.parts else (0,)
        contacts = int(any(part.contact is not None for part in volume.parts))
        uniforms = _uniforms(volume, camera, slots)

        def run(name: str, parts: int, over: int | None = None) -> None:
            program = self._program(name, parts, contacts)
            for uniform in program:
                if uniform in uniforms:
                    program[uniform].value = uniforms[uniform]
            if over is None:
                program.run(-(-camera.width // 8) * -(-camera.height // 8))
            else:
                program.run_indirect(self.lists, (over + parts) * LIST.itemsize)
            self.context.memory_barrier()

        run("trace", 0)
        if volume.parts:
            run("trace", 1, TRACE_LIST)
        for parts in variants:
            run("exact", parts, EXACT_LIST)
        run("edges", 0)
        if antialias:
            self._sixteenfold(slots)
            for parts in variants:
                run("subrays", parts, EDGE_LIST)
        for parts in variants:
            run("surface", parts, COVERED_LIST)
        lists = np.frombuffer(self.lists.read(), LISTS)[0]
        covered, edges = (int(lists["lists"]["count"][k : k + 2].sum()) for k in (COVERED_LIST, EDGE_LIST))
        records = np.frombuffer(self.pixels[-1].read(covered * RECORD.itemsize) if covered else b"", RECORD)
        counters = {
            "rays": count + 16 * min(edges, slots),
            "ray_steps": int(lists["steps"]),
            "bytes_uploaded": uploaded,
            "bytes_read_back": LISTS.itemsize + records.nbytes,
        }
        return _pointmap(records, camera, f"OpenGL compute, {renderer_name(self.context)}", counters)

    def _program(self, name: str, parts: int, contacts: int) -> moderngl.ComputeShader:
        key = (name, parts, contacts if parts else 0)
        if key not in self.programs:
            constants = {"PARTS": parts, "CONTACTS": key[2]}
            self.programs[key] = compute_shader(self.context, f"pointmap/{name}.comp", constants)
        return self.programs[key]

    def _bind_volume(self, volume: SdfVolume) -> int:
        """Body on texture unit 0, parts on 1–3, contacts on 4–6; bytes uploaded."""
        table = np.zeros(len(PARTS), PART)
        table["box_from_root"], table["voxel"], table["size"] = np.eye(4), 1.0, -1.0
        uploaded = self.textures.bind("body", volume.body.sdf, 0)
        by_name = {part.name: part for part in volume.parts}
        for k, name in enumerate(PARTS):
            part = by_name.get(name)
            contact = part.contact if part else None
            uploaded += self.textures.bind(name, part.field if part else None, 1 + k)
            uploaded += self.textures.bind(f"{name} contact", contact.field if contact else None, 4 + k)
            if part:
                table[k]["box_from_root"], table[k]["voxel"], table[k]["size"] = (
                    part.box_from_root.T,
                    part.voxel,
                    part.size,
                )
            if contact:
                table[k]["first"], table[k]["contact"] = contact.first[::-1], 1
        self.parts.write(table.tobytes())
        return uploaded

    def _bind_buffers(self, count: int, slots: int) -> None:
        """Parts, lists, then what grows with the image: bindings 2 to 10."""
        sizes = [4 * count, 8 * count, 4 * slots, 8 * count, 4 * count, 4 * count, 4 * count, 64 * slots]
        sizes.append(RECORD.itemsize * count)
        for k, size in enumerate(sizes):
            if k == len(self.pixels):
                self.pixels.append(self.context.buffer(reserve=max(size, 4)))
            elif self.pixels[k].size < size:
                self.pixels[k].release()
                self.pixels[k] = self.context.buffer(reserve=size)
        empty = np.zeros(1, LISTS)
        empty["lists"]["one"] = empty["lists"]["also_one"] = 1
        self.lists.write(empty.tobytes())
        self.parts.bind_to_uniform_block(0)
        for binding, buffer in enumerate((self.lists, *self.pixels), start=1):
            buffer.bind_to_storage_buffer(binding)

    def _sixteenfold(self, slots: int) -> None:
        """The silhouette lists hold pixels; their dispatch needs sixteen rays for each, four pixels to a group."""
        lists = np.frombuffer(self.lists.read(), LISTS).copy()
        edges = lists["lists"][0, EDGE_LIST : EDGE_LIST + 2]
        edges["groups"] = -(-np.minimum(edges["count"], slots // 2).astype(np.int64) * 16 // GROUP)
        self.lists.write(lists.tobytes())


def _uniforms(volume: SdfVolume, camera: Camera, slots: int) -> dict[str, object]:
    """By name; a pass sets those that it uses."""
    plane = RayPlane.of(camera, volume.middle)
    return {
        "u_body": 0,
        "u_part": (1, 2, 3),
        "u_contact": (4, 5, 6),
        "u_origin": tuple(volume.body.origin),
        "u_voxel": volume.body.voxel,
        "u_image": (camera.width, camera.height),
        "u_middle": tuple(plane.middle),
        "u_point": tuple(plane.point),
        "u_gaze": tuple(plane.gaze),
        "u_across": tuple(plane.across),
        "u_down": tuple(plane.down),
        "u_slots": slots,
    }


def _pointmap(records: np.ndarray, camera: Camera, renderer: str, counters: dict[str, int]) -> PointMap:
    def tensor(name: str) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(records[name]))

    records = records[records["coverage"] > 0]
    return scatter(
        camera,
        torch.from_numpy((records["pixel"] & ~HIT_BIT).astype(np.int64)),
        tensor("position"),
        tensor("normal"),
        torch.from_numpy((records["pixel"] & HIT_BIT) != 0),
        tensor("coverage"),
        tensor("weight"),
        tensor("steps"),
        renderer,
        counters,
    )
