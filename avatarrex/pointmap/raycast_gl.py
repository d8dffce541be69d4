"""The raycast as GLSL compute passes (shaders/pointmap): beams, trace, exact walk, edges, sub-rays, surface.

Between the passes the rays that need more work are compacted into lists and dispatched indirectly; only the records of
covered pixels are read back, and only volumes that changed are uploaded.
"""

from __future__ import annotations

from collections.abc import Callable

import moderngl
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.gl.context import current_context, gl_context, per_context, renderer_name
from avatarrex.gl.grids import GridTextures
from avatarrex.gl.shader import compute_shader
from avatarrex.pointmap.occlusion_edges import NEIGHBOURS, SHEET_GAP, OcclusionEdges
from avatarrex.pointmap.point_map import CoveredPixels, PointMap
from avatarrex.pointmap.rays import RayPlane, box_window
from avatarrex.templates.parts import PARTS
from avatarrex.volume.bricks import ROW
from avatarrex.volume.sdf_volume import SdfVolume

MOST_GROUPS = 65535
"""That OpenGL promises along one side of a dispatch."""
GROUP = 64
"""Rays in a work group; 8 × 8 pixels where all pixels are visited."""
PART = np.dtype(
    [
        ("box_from_root", "f4", (4, 4)),
        ("size", "f4", 3),
        ("voxel", "f4"),
        ("first", "f4", 3),
        ("contact", "i4"),
        ("window", "f4", 4),
    ]
)
"""Mirrors `struct Part` of shaders/pointmap/volume.glsl; the matrix by columns (std140)."""
VIEW = np.dtype(
    [
        ("origin", "f4", 3),
        ("voxel", "f4"),
        ("last", "f4", 3),
        ("brick_side", "f4"),
        ("point", "f4", 3),
        ("brick_row", "f4"),
        ("gaze", "f4", 3),
        ("slots", "u4"),
        ("across", "f4", 3),
        ("unused", "f4"),
        ("down", "f4", 3),
        ("also_unused", "f4"),
        ("middle", "f4", 2),
        ("image", "i4", 2),
    ]
)
"""Mirrors the block `View` there."""
BOXES = (0, *(1 << k for k in range(len(PARTS))), (1 << len(PARTS)) - 1)
"""Rays that meet no part box, one of `PARTS`, or several: bits of the boxes that their program looks at."""
TILE_LIST = 0
"""Tiles come twice: those in which no part box is seen, and those in which one may be."""
TRACE_LIST, EXACT_LIST, COVERED_LIST, EDGE_LIST = (2 + k * len(BOXES) for k in range(4))
"""Pixels of each kind come once for each of `BOXES`."""
PART_UNIT, CONTACT_UNIT = 3, 3 + len(PARTS)
"""Texture units from which there is one for each part; before them the body, and numbers of bricks."""
STEP_BITS = 20
"""Of `walked` in `RECORD`: steps; above them five bits of sub-positions on another sheet, then the neighbour that shows it."""
PART_SLOTS = {"PART_COUNT": len(PARTS), "CONTACT_UNIT": CONTACT_UNIT, "SHEET_GAP": SHEET_GAP, "STEP_BITS": STEP_BITS}
"""Constants of every pass, with what occlusion_edges.py says of sheets."""
LIST = np.dtype([("groups", "u4"), ("one", "u4"), ("also_one", "u4"), ("count", "u4")])
LISTS = np.dtype([("lists", LIST, EDGE_LIST + len(BOXES)), ("steps", "u4"), ("edges", "u4")])
"""Mirrors `buffer Lists` of shaders/pointmap/rays.glsl."""
RECORD = np.dtype(
    [
        ("position", "f4", 3),
        ("pixel", "u4"),
        ("normal", "f4", 3),
        ("coverage", "f4"),
        ("weight", "f4", len(PARTS)),
        ("walked", "u4"),
        ("unused", "f4", -(len(PARTS) + 1) % 4),
    ]
)
"""Mirrors `struct Record` of shaders/pointmap/surface.comp."""
HIT_BIT = -(1 << 31)
"""Of a pixel's number as a signed one."""
T, BEAM, RECORDS = 4, 8, 10
"""Places among `GlCaster.pixels`."""
NO_HIT, EMPTY = np.float32(1e9), np.float32(2e9)
"""Of rays; of tiles that no pass visits."""
TILE = 8
"""Pixels along its side."""


@current_context()
def raycast_gl(
    volume: SdfVolume, camera: Camera, antialias: bool, march: str = "exact", only: Bool[Tensor, "h w"] | None = None
) -> PointMap:
    """See `avatarrex.pointmap.raycast.raycast`."""
    return gl_caster().cast(volume, camera, antialias, march, only)


def gl_caster() -> GlCaster:
    """The caster of the context in use."""
    context = gl_context()
    return per_context(context, "raycast", lambda: GlCaster(context))


class GlCaster:
    """Programs, textures and buffers of one context."""

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self.textures = GridTextures(context)
        self.programs: dict[tuple[object, ...], moderngl.ComputeShader] = {}
        self.parts = context.buffer(reserve=len(PARTS) * PART.itemsize)
        self.view = context.buffer(reserve=VIEW.itemsize)
        self.lists = context.buffer(reserve=LISTS.itemsize)
        self.pixels: list[moderngl.Buffer] = []
        self.float_filter = int(self._filters_in_float())

    def cast(
        self,
        volume: SdfVolume,
        camera: Camera,
        antialias: bool,
        march: str = "exact",
        only: Bool[Tensor, "h w"] | None = None,
    ) -> PointMap:
        """All passes, one read-back."""
        antialias = antialias and march == "exact"
        chosen = _wanted_tiles(camera, only)
        run, uploaded = self.prepare(volume, camera, antialias, chosen)
        boxes = BOXES if volume.parts else BOXES[:1]
        for name, over, constants in march_passes(boxes, march):
            run(name, over, **constants)
        for boxed in range(min(len(boxes), 2)):
            run("edges", TILE_LIST + boxed, PARTS=0, BOXED=boxed, ANTIALIAS=int(antialias))
        for k, parts in enumerate(boxes if antialias else ()):
            run("subrays", EDGE_LIST + k, PARTS=parts)
        for k, parts in enumerate(boxes):
            run("surface", COVERED_LIST + k, PARTS=parts)
        slots, lists = _slots(camera, antialias), np.frombuffer(self.lists.read(), LISTS)[0]
        covered = int(lists["lists"]["count"][COVERED_LIST : COVERED_LIST + len(BOXES)].sum())
        records = np.empty(covered, RECORD)
        if covered:
            self.pixels[RECORDS].read_into(records, covered * RECORD.itemsize)
        counters = {
            "rays": _pixels_of(chosen, camera) + 16 * min(int(lists["edges"]), slots),
            "ray_steps": int(lists["steps"]),
            "bytes_uploaded": uploaded,
            "bytes_read_back": LISTS.itemsize + records.nbytes,
        }
        return _covered(records, camera.width, only).scatter(
            camera, f"OpenGL compute, {renderer_name(self.context)}", counters
        )

    def distances(self, camera: Camera) -> np.ndarray:
        """t of every pixel's ray as the last passes left it, row by row (float32); ∞ where there is no hit."""
        t = np.frombuffer(self.pixels[T].read(4 * camera.width * camera.height), "f4").reshape(camera.height, -1)
        across = -(-camera.width // 8)
        beam = np.frombuffer(self.pixels[BEAM].read(4 * _tiles(camera)), "f4").reshape(-1, across)
        beam = beam.repeat(8, 0).repeat(8, 1)[: camera.height, : camera.width]
        return np.where((t < NO_HIT) & (beam <= NO_HIT), t, np.inf).ravel()

    def prepare(
        self, volume: SdfVolume, camera: Camera, antialias: bool, chosen: np.ndarray | None = None
    ) -> tuple[Callable[..., None], int]:
        """Bind everything; `run(pass, list, **constants)` to dispatch over all pixels or a list; bytes uploaded.

        `chosen`: tiles, a truth each, that are cast at all; None: all.
        """
        uploaded = self._bind_volume(volume, camera)
        self._bind_buffers(camera.width * camera.height, _slots(camera, antialias), _tiles(camera))
        free = np.full(_tiles(camera), NO_HIT)
        if chosen is not None:
            free[~chosen.ravel()] = EMPTY
        self.pixels[BEAM].write(free.tobytes())
        contacts = int(any(part.contact is not None for part in volume.parts))
        self.view.write(_view(volume, camera, _slots(camera, antialias)).tobytes())

        def run(name: str, over: int | None = None, **constants: int) -> None:
            contact = contacts * int(constants["PARTS"] != 0)
            kind = {"CONTACTS": contact, "BRICKS": int(volume.body.bricks is not None)}
            program = self._program(name, FLOAT_FILTER=self.float_filter, **kind, **constants)
            if over is None:
                groups = -(-_tiles(camera) // GROUP) if name == "beams" else _tiles(camera)
                program.run(min(groups, MOST_GROUPS), -(-groups // MOST_GROUPS))
            else:
                program.run_indirect(self.lists, over * LIST.itemsize)
            self.context.memory_barrier()

        return run, uploaded

    def _program(self, name: str, **constants: int) -> moderngl.ComputeShader:
        key = (name, *sorted(constants.items()))
        if key not in self.programs:
            self.programs[key] = compute_shader(
                self.context,
                f"pointmap/{name}.comp",
                PART_SLOTS | constants,
            )
        return self.programs[key]

    def _filters_in_float(self) -> bool:
        """Hardware rounds the weights of its texture filter to 8 bits, software need not."""
        self.textures.bind("probe", torch.tensor([[[0.0, 1.0]]]), 0)
        values = self.context.buffer(reserve=4 * GROUP)
        values.bind_to_storage_buffer(0)
        self._program("probe").run()
        self.context.memory_barrier()
        got = np.frombuffer(values.read(), "f4")
        values.release()
        return bool(np.abs(got - np.linspace(0, 1, GROUP)).max() < 1e-6)

    def _bind_volume(self, volume: SdfVolume, camera: Camera) -> int:
        """Grids on their texture units; bytes uploaded."""
        table = np.zeros(len(PARTS), PART)
        table["box_from_root"], table["voxel"], table["size"] = np.eye(4), 1.0, -1.0
        table["window"] = (np.inf, np.inf, -np.inf, -np.inf)
        bricks = volume.body.bricks
        if bricks is None:
            uploaded = self.textures.bind("body", volume.body.sdf, 0)
        else:
            uploaded = self.textures.bind("body with bricks", bricks.atlas, 0)
            uploaded += self.textures.bind("brick numbers", bricks.number, 1)
        by_name = {part.name: part for part in volume.parts}
        for k, name in enumerate(PARTS):
            part = by_name.get(name)
            contact = part.contact if part else None
            uploaded += self.textures.bind(name, part.field if part else None, PART_UNIT + k)
            uploaded += self.textures.bind(f"{name} contact", contact.field if contact else None, CONTACT_UNIT + k)
            if part:
                table[k]["box_from_root"], table[k]["voxel"], table[k]["size"] = (
                    part.box_from_root.T,
                    part.voxel,
                    part.size,
                )
                table[k]["window"] = box_window(part, camera)
            if contact:
                table[k]["first"], table[k]["contact"] = contact.first[::-1], 1
        self.parts.write(table.tobytes())
        return uploaded

    def _bind_buffers(self, count: int, slots: int, tiles: int) -> None:
        """Parts, lists, then what grows with the image: bindings 2 to 13."""
        sizes = [
            4 * len(BOXES) * count,
            12 * len(BOXES) * count,
            4 * slots,
            4 * count,
            4 * count,
            8 * count,
            4 * count,
            64 * slots,
        ]
        sizes += [4 * tiles, 4 * tiles, RECORD.itemsize * count, 4 * len(BOXES) * slots]
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
        self.view.bind_to_uniform_block(1)
        for binding, buffer in enumerate((self.lists, *self.pixels), start=1):
            buffer.bind_to_storage_buffer(binding)


def _tiles(camera: Camera) -> int:
    """Of 8 × 8 pixels."""
    return -(-camera.width // TILE) * -(-camera.height // TILE)


def _slots(camera: Camera, antialias: bool) -> int:
    """Pixels of edges that there is room for: 64 bytes each."""
    return camera.width * camera.height // 4 + 4096 if antialias else 0


def march_passes(boxes: tuple[int, ...], march: str = "exact") -> list[tuple[str, int | None, dict[str, int]]]:
    """Name, list and constants of the passes that find t of every pixel; `boxes` are `BOXES`, or 0 alone where there are no parts."""
    if march == "fixed":
        return [("plain", None, {"PARTS": boxes[-1], "METHOD": 2})]
    traced = [("trace", TILE_LIST + boxed, {"PARTS": 0, "BOXED": boxed}) for boxed in range(min(len(boxes), 2))]
    traced += [("trace", TRACE_LIST + k, {"PARTS": boxes[k], "BOXED": 0}) for k in range(1, len(boxes))]
    exact = [("exact", EXACT_LIST + k, {"PARTS": parts}) for k, parts in enumerate(boxes)]
    return [("beams", None, {"PARTS": 0}), *traced, *exact]


def _view(volume: SdfVolume, camera: Camera, slots: int) -> np.ndarray:
    """One `VIEW`."""
    plane, grid = RayPlane.of(camera, volume.middle), volume.body
    view = np.zeros(1, VIEW)
    view["origin"], view["voxel"], view["last"] = grid.origin, grid.voxel, np.array(grid.sdf.shape[::-1]) - 1
    view["brick_side"], view["brick_row"] = grid.bricks.side if grid.bricks else 1, ROW
    view["point"], view["gaze"], view["middle"] = plane.point, plane.gaze, plane.middle
    view["across"], view["down"] = plane.across, plane.down
    view["slots"], view["image"] = slots, (camera.width, camera.height)
    return view


def _wanted_tiles(camera: Camera, only: Tensor | None) -> np.ndarray:
    """Whether each tile (down, across) holds a pixel that is to be cast, or one beside it."""
    down, across = -(-camera.height // TILE), -(-camera.width // TILE)
    if only is None:
        return np.ones((down, across), bool)
    beside = np.zeros((down * TILE + 2, across * TILE + 2), bool)
    for y, x in ((0, 1), (1, 0), (1, 1), (1, 2), (2, 1)):
        beside[y : y + camera.height, x : x + camera.width] |= only.numpy()
    return np.asarray(beside[1:-1, 1:-1].reshape(down, TILE, across, TILE).any((1, 3)))


def _pixels_of(chosen: np.ndarray, camera: Camera) -> int:
    """Pixels of the picture in these tiles."""
    return int(chosen.repeat(TILE, 0).repeat(TILE, 1)[: camera.height, : camera.width].sum())


def _covered(records: np.ndarray, width: int, only: Tensor | None) -> CoveredPixels:
    table = torch.from_numpy(records.view("f4").reshape(-1, RECORD.itemsize // 4))
    pixel, coverage = column(table, "pixel")[:, 0].view(torch.int32), column(table, "coverage")[:, 0]
    if only is not None:
        wanted = torch.nonzero(only.view(-1)[(pixel & ~HIT_BIT).long()])[:, 0]
        table = table.index_select(0, wanted)
        pixel, coverage = pixel[wanted], coverage[wanted]
    walked, place = column(table, "walked")[:, 0].view(torch.int32), (pixel & ~HIT_BIT).long()
    return CoveredPixels(
        pixel=place,
        position=column(table, "position"),
        normal=column(table, "normal"),
        part_weight=column(table, "weight"),
        hit=pixel < 0,
        coverage=coverage,
        steps=(walked & ((1 << STEP_BITS) - 1)).float(),
        edges=_edges(place, coverage, walked, width),
    )


def _edges(pixel: Tensor, coverage: Tensor, walked: Tensor, width: int) -> OcclusionEdges:
    """By the bits of `walked`."""
    others = walked >> STEP_BITS & 31
    rows = torch.nonzero(others)[:, 0]
    step = torch.tensor([x + y * width for x, y in NEIGHBOURS])[(walked[rows] >> (STEP_BITS + 5)).long()]
    return OcclusionEdges(pixel[rows], pixel[rows] + step, others[rows] / (16 * coverage[rows]))


def column(table: Tensor, name: str) -> Tensor:
    """The numbers (p, c) of a field of `RECORD` in a table (p, ·) of them; no copy."""
    assert RECORD.fields
    at = RECORD.fields[name][1]
    return table[:, at // 4 : (at + RECORD[name].itemsize) // 4]
