"""Runs under `bpy`: the first skeleton of an FBX file and how it moves, as plain arrays. Imports nothing of ours.

    python fbx_scene.py FILE.fbx OUT.npz SAID.txt

Writes `names`, `parents`, `rest` (j, 3), `turned` (t, j, 3, 3) against rest, `places` (t, j, 3), `fps`, the ends of last bones as
joints that never turn; or one line of why not.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

MOST = 4_000_000
"""Frames times bones."""


def main(source: str, out: str) -> None:
    """Read and write. Raises `SystemExit` with a reason."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.fbx(filepath=source, ignore_leaf_bones=False, automatic_bone_orientation=False)
    scene = bpy.context.scene
    rigs = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    if not rigs:
        raise SystemExit("no skeleton")
    rig = max(rigs, key=lambda thing: len(thing.pose.bones))
    action = rig.animation_data.action if rig.animation_data else None
    first, last = (round(end) for end in action.frame_range) if action else (1, 1)
    bones = _ordered(rig)
    if (last - first + 1) * len(bones) > MOST:
        raise SystemExit(f"{last - first + 1} frames of {len(bones)} bones, too many")
    arrays: dict[str, Any] = _arrays(scene, rig, bones, range(first, last + 1))
    np.savez(out, fps=scene.render.fps / scene.render.fps_base, **arrays)


def _ordered(rig: Any) -> list[Any]:
    """Bones, each after its parent."""
    found: list[Any] = []
    waiting = [bone for bone in rig.pose.bones if bone.parent is None]
    while waiting:
        bone = waiting.pop(0)
        found.append(bone)
        waiting += bone.children
    return found


def _arrays(scene: Any, rig: Any, bones: list[Any], frames: range) -> dict[str, np.ndarray]:
    index = {bone.name: k for k, bone in enumerate(bones)}
    ends = [k for k, bone in enumerate(bones) if not bone.children]
    world = np.array(rig.matrix_world.to_3x3().normalized())
    scale = rig.matrix_world.to_scale()[0]
    rest_turned = np.array([bone.bone.matrix_local.to_3x3() for bone in bones])
    heads, tails = (np.array([getattr(bone.bone, f"{end}_local") for bone in bones]) for end in ("head", "tail"))
    turned, places = [], []
    for frame in frames:
        scene.frame_set(frame)
        posed = np.array([bone.matrix.to_3x3().normalized() for bone in bones]) @ np.swapaxes(rest_turned, 1, 2)
        here, far = (np.array([getattr(bone, end) for bone in bones]) for end in ("head", "tail"))
        turned.append(np.concatenate([posed, posed[ends]]))
        places.append(np.concatenate([here, far[ends]]) * scale)
    return {
        "names": np.array([*(bone.name for bone in bones), *(f"{bones[k].name} end" for k in ends)]),
        "parents": np.array([*(index[b.parent.name] if b.parent else -1 for b in bones), *ends]),
        "rest": np.concatenate([heads, tails[ends]]) * scale @ world.T,
        "turned": np.einsum("ab,tjbc,dc->tjad", world, np.array(turned), world),
        "places": np.array(places) @ world.T,
    }  # fmt: skip


if __name__ == "__main__":
    try:
        main(sys.argv[1], sys.argv[2])
    except (RuntimeError, SystemExit) as error:
        Path(sys.argv[3]).write_text(" ".join(str(error).split())[-200:], encoding="utf-8")
        sys.exit(1)
