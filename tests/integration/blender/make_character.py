"""Run by Blender: a bent, waving figure of two bones in every format that carries a skin, and what Blender makes of it.

  blender --background --factory-startup --python make_character.py -- FOLDER
"""
import json
import math
import sys
from pathlib import Path

import bpy
from mathutils import Vector

FRAMES = 24
folder = Path(sys.argv[sys.argv.index("--") + 1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.frame_start, scene.frame_end = 24, 1, FRAMES

# A column of 1.8 m, Z up as in Blender, with rings every 0.1 m.
bpy.ops.mesh.primitive_cylinder_add(vertices=12, radius=0.15, depth=1.8, location=(0, 0, 0.9), end_fill_type="TRIFAN")
column = bpy.context.object
bpy.ops.object.transform_apply(location=True)
bpy.ops.object.mode_set(mode="EDIT")
bpy.ops.mesh.select_all(action="SELECT")
bpy.ops.mesh.bisect(plane_co=(0, 0, 0.9), plane_no=(0, 0, 1))
for height in range(1, 18):
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.bisect(plane_co=(0, 0, height * 0.1), plane_no=(0, 0, 1))
bpy.ops.object.mode_set(mode="OBJECT")

bpy.ops.object.armature_add(location=(0, 0, 0))
rig = bpy.context.object
bpy.ops.object.mode_set(mode="EDIT")
hips = rig.data.edit_bones[0]
hips.name, hips.head, hips.tail = "Hips", (0, 0, 0.0), (0, 0, 0.9)
head = rig.data.edit_bones.new("Head")
head.head, head.tail, head.parent = hips.tail, (0, 0, 1.8), hips
bpy.ops.object.mode_set(mode="OBJECT")

for name in ("Hips", "Head"):
    column.vertex_groups.new(name=name)
for vertex in column.data.vertices:
    upper = min(1.0, max(0.0, (vertex.co.z - 0.7) / 0.4))
    column.vertex_groups["Hips"].add([vertex.index], 1 - upper, "REPLACE")
    column.vertex_groups["Head"].add([vertex.index], upper, "REPLACE")
column.parent = rig
column.modifiers.new("rig", "ARMATURE").object = rig

for bone in rig.pose.bones:
    bone.rotation_mode = "XYZ"
for frame in range(1, FRAMES + 1):
    phase = (frame - 1) / (FRAMES - 1)
    rig.pose.bones["Head"].rotation_euler = (math.radians(70 * phase), 0, math.radians(30 * math.sin(3 * phase)))
    rig.pose.bones["Hips"].location = Vector((0.3 * phase, 0, 0.1 * phase * phase))
    for bone, path in (("Head", "rotation_euler"), ("Hips", "location")):
        rig.pose.bones[bone].keyframe_insert(path, frame=frame)

truth = []
for frame in range(1, FRAMES + 1):
    scene.frame_set(frame)
    evaluated = column.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    # Y up, as Pleat has it.
    truth.append([(p.x, p.z, -p.y) for p in (evaluated.matrix_world @ v.co for v in mesh.vertices)])
    evaluated.to_mesh_clear()
(folder / "truth.json").write_text(json.dumps(truth))

scene.frame_set(1)
for item in bpy.data.objects:
    item.select_set(True)
bpy.ops.export_scene.gltf(filepath=str(folder / "character.glb"), export_format="GLB")
bpy.ops.export_scene.fbx(filepath=str(folder / "character.fbx"), add_leaf_bones=False, bake_anim_simplify_factor=0)
