"""Run by Blender: a waving cloth in every format that it can write with frames, and where its vertices were.

  blender --background --factory-startup --python make_cloth_files.py -- FOLDER
"""
import json
import math
import sys
from pathlib import Path

import bpy

FRAMES = 8
folder = Path(sys.argv[sys.argv.index("--") + 1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.frame_start, scene.frame_end = 24, 1, FRAMES

# Quads of 1/12 m by 1/10 m; the grid's map is the unit square, which fits.
bpy.ops.mesh.primitive_grid_add(x_subdivisions=12, y_subdivisions=10, size=1, location=(1, 2, 3))
cloth = bpy.context.object
cloth.name = "Cloth"
rest = [vertex.co.copy() for vertex in cloth.data.vertices]
cloth.shape_key_add(name="Basis")
for frame in range(1, FRAMES + 1):
    key = cloth.shape_key_add(name=f"frame {frame}")
    for point, co in zip(key.data, rest):
        point.co = (co.x, co.y, co.z + 0.03 * math.sin(4 * co.x + 0.5 * frame) * (1 + co.y))
    for other in range(1, FRAMES + 1):
        key.value = float(other == frame)
        key.keyframe_insert("value", frame=other)


def truth():
    frames = []
    for frame in range(1, FRAMES + 1):
        scene.frame_set(frame)
        evaluated = cloth.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = evaluated.to_mesh()
        # Y up, as Pleat has it.
        frames.append([(p.x, p.z, -p.y) for p in (evaluated.matrix_world @ v.co for v in mesh.vertices)])
        evaluated.to_mesh_clear()
    scene.frame_set(1)
    return frames


written = {}
bpy.ops.export_scene.gltf(filepath=str(folder / "cloth.glb"), export_format="GLB")
written["cloth.glb"] = truth()
# The object itself moves as well, which glTF readers of vertices refuse.
for frame in range(1, FRAMES + 1):
    cloth.location.x = 1 + 0.02 * frame
    cloth.rotation_euler.z = 0.3 + 0.02 * frame
    cloth.keyframe_insert("location", frame=frame)
    cloth.keyframe_insert("rotation_euler", frame=frame)
moved = truth()
bpy.ops.export_scene.fbx(filepath=str(folder / "cloth.fbx"), bake_anim_simplify_factor=0)
written["cloth.fbx"] = moved
bpy.ops.export_scene.fbx(filepath=str(folder / "cloth-z-up.fbx"), bake_anim_simplify_factor=0, axis_forward="Y", axis_up="Z",
                         global_scale=1, apply_unit_scale=False)
written["cloth-z-up.fbx"] = moved
if bpy.app.build_options.alembic:
    bpy.ops.wm.alembic_export(filepath=str(folder / "cloth.abc"), start=1, end=FRAMES, as_background_job=False)
    written["cloth.abc"] = moved
(folder / "truth.json").write_text(json.dumps(written))
