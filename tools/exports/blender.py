"""A GLB in Blender (`pip install bpy`): imported, posed by its clip, an expression set, drawn. Prints one line of JSON.

python blender.py FILE.glb PICTURES CLIP FRAME MORPH EVERY
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy

FPS = 30
"""What Blender is told before it imports; frame numbers are of this rate."""


def main() -> None:
    """Import and draw."""
    path, pictures, clip, frame, morph, every = sys.argv[1:7]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = FPS
    bpy.ops.import_scene.gltf(filepath=path)
    mesh = next(item for item in bpy.data.objects if item.type == "MESH" and item.data.shape_keys)
    bones = next(item for item in bpy.data.objects if item.type == "ARMATURE")
    facts = {
        "blender": bpy.app.version_string,
        "vertices": len(mesh.data.vertices),
        "bones": len(bones.data.bones),
        "shape keys": len(mesh.data.shape_keys.key_blocks) - 1,
        "actions": sorted(action.name for action in bpy.data.actions),
        "groups of a vertex, most": max(len(vertex.groups) for vertex in mesh.data.vertices),
        "texture": [image.name for image in bpy.data.images if image.size[0]],
    }
    _view(scene)
    for track in bones.animation_data.nla_tracks:
        track.mute = track.name != clip
    bones.animation_data.action = None
    scene.frame_set(int(frame))
    facts["posed"] = _vertices(mesh, int(every))
    _draw(scene, Path(pictures) / "blender_clip.png")
    for track in bones.animation_data.nla_tracks:
        track.mute = True
    for bone in bones.pose.bones:
        bone.matrix_basis.identity()
    mesh.data.shape_keys.key_blocks[morph].value = 1
    scene.frame_set(int(frame))
    facts["morphed"] = _vertices(mesh, int(every))
    scene.camera.location, scene.camera.data.ortho_scale = (0, -4, 1.6), 0.5
    _draw(scene, Path(pictures) / "blender_morph.png")
    print("FACTS " + json.dumps(facts))


def _vertices(mesh: bpy.types.Object, every: int) -> list[list[float]]:
    """Evaluated positions, glTF's axes (Blender's z is up)."""
    evaluated = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    points = [mesh.matrix_world @ vertex.co for vertex in list(evaluated.vertices)[::every]]
    return [[point.x, point.z, -point.y] for point in points]


def _view(scene: bpy.types.Scene) -> None:
    """From the front, without perspective, on grey."""
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.4
    camera.location, camera.rotation_euler = (0, -4, 1.0), (1.5707963, 0, 0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("grey")
    scene.render.engine, scene.cycles.samples = "CYCLES", 8
    scene.render.resolution_x, scene.render.resolution_y = 512, 640
    scene.view_settings.view_transform = "Standard"


def _draw(scene: bpy.types.Scene, path: Path) -> None:
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
