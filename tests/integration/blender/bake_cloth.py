"""In Blender: a pinned cloth falls over a ball and goes through the add-on: bake_cloth.py FOLDER [FRAMES]

Leaves FOLDER/frame.png, a rendered frame, and prints seconds for the bake."""
import json
import os
import sys
import time

import bpy
import numpy as np

FOLDER = sys.argv[sys.argv.index("--") + 1]
FRAMES = int(sys.argv[sys.argv.index("--") + 2])
RADIUS = 0.3
CELLS = 24

bpy.ops.preferences.addon_enable(module="pleat")
import pleat.bake  # noqa: E402
import pleat.cloth  # noqa: E402
import pleat.exchange  # noqa: E402


def make_scene():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    bpy.ops.preferences.addon_enable(module="pleat")
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.render.fps = 25
    bpy.ops.mesh.primitive_uv_sphere_add(radius=RADIUS, location=(0, 0, 0))
    ball = bpy.context.view_layer.objects.active
    ball.name = "Ball"
    ball.modifiers.new("Collision", "COLLISION")
    # A moving obstacle: it rises into the cloth.
    for frame, height in ((1, -0.1), (FRAMES, 0.0)):
        ball.location.z = height
        ball.keyframe_insert("location", frame=frame)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=CELLS, y_subdivisions=CELLS, size=1.2, location=(0, 0, 0.45))
    cloth = bpy.context.view_layer.objects.active
    cloth.name = "Cloth"
    # The map of a grid covers the unit square: it says nothing of metres.
    cloth.data.uv_layers[0].name = "Print"
    for color in ((0.1, 0.25, 0.55, 1), (0.75, 0.2, 0.15, 1)):
        material = bpy.data.materials.new("Fabric")
        material.diffuse_color = color
        material.use_nodes = True
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = color
        cloth.data.materials.append(material)
    for polygon in cloth.data.polygons:
        polygon.material_index = (polygon.index // CELLS + polygon.index % CELLS) // 6 % 2
    pinned = cloth.vertex_groups.new(name="Pinned")
    pinned.add([v.index for v in cloth.data.vertices if v.co.y > 0.599], 1.0, "REPLACE")
    cloth.vertex_groups.new(name="Half").add([v.index for v in cloth.data.vertices if v.co.x < 0], 0.5, "REPLACE")
    settings = cloth.modifiers.new("Cloth", "CLOTH").settings
    settings.vertex_group_mass = "Pinned"
    settings.quality = 6
    # Else it passes through itself in time, and what comes in so goes out so.
    cloth.modifiers["Cloth"].collision_settings.use_self_collision = True
    cloth.modifiers.new("Looks", "SUBSURF").levels = 1
    cloth.modifiers["Cloth"].point_cache.frame_end = FRAMES
    cloth.pleat.folder = os.path.join(FOLDER, "cache")
    bpy.context.view_layer.objects.active = cloth
    return scene, cloth, ball


def in_world(thing):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return pleat.cloth._in_world(pleat.cloth._points(thing.evaluated_get(depsgraph).data),
                                 thing.evaluated_get(depsgraph).matrix_world)


def check_mesh(cloth, fine):
    coarse = len(cloth.data.polygons) * 2
    assert len(fine.data.polygons) == 16 * coarse, len(fine.data.polygons)
    assert [slot.material.name for slot in fine.material_slots] == [slot.material.name for slot in cloth.material_slots]
    for index in (0, 1):
        share = sum(p.material_index == index for p in cloth.data.polygons) / len(cloth.data.polygons)
        fine_share = sum(p.material_index == index for p in fine.data.polygons) / len(fine.data.polygons)
        assert abs(share - fine_share) < 1e-9, (index, share, fine_share)
    # The print lies on the fine cloth as on the coarse one: the grid's map is its x and y.
    layer = fine.data.uv_layers["Print"]
    rest = np.array([fine.data.vertices[loop.vertex_index].co for loop in fine.data.loops])
    uv = np.array([entry.uv for entry in layer.data])
    np.testing.assert_allclose(uv, np.stack([rest[:, 0], -rest[:, 2]], axis=1) / 1.2 + 0.5, atol=1e-4)
    weights = {group.name: group.index for group in fine.vertex_groups}
    assert set(weights) == {"Pinned", "Half"}
    held = [v for v in fine.data.vertices if any(g.group == weights["Pinned"] and g.weight > 0.999 for g in v.groups)]
    assert len(held) == 4 * CELLS + 1, len(held)
    assert all(-v.co.z > 0.599 for v in held)


def check_frame(cloth, fine, ball):
    coarse, ball_at = in_world(cloth), in_world(ball).mean(axis=0)
    assert len(coarse) == (CELLS + 1)**2, len(coarse)  # without what is for looks
    made = in_world(fine)
    apart = np.abs(made[:len(coarse)] - coarse).max()
    assert apart < 0.12, f"frame {bpy.context.scene.frame_current}: {apart} m"
    # Blender's ball is a polyhedron: its faces lie within.
    assert np.linalg.norm(made - ball_at, axis=1).min() > 0.98 * RADIUS
    return made


def main():
    scene, cloth, ball = make_scene()
    # Blender simulates first, as an artist does; baking reads its cache.
    began = time.monotonic()
    for frame in range(1, FRAMES + 1):
        scene.frame_set(frame)
    simulated = time.monotonic() - began
    cache = cloth.modifiers["Cloth"].point_cache
    with pleat.cloth.kept_simulation(cloth, bpy.context):
        assert cache.is_baked, "what was simulated as a whole would be simulated again"
    assert not cache.is_baked

    began = time.monotonic()
    assert bpy.ops.pleat.bake() == {"FINISHED"}
    baked = time.monotonic() - began
    fine = pleat.cloth.fine_of(cloth)
    assert cloth.hide_render and not fine.hide_render
    assert cloth.modifiers["Cloth"].point_cache.info.replace(",", "").startswith(f"{FRAMES} frames"), "the simulation was forgotten"
    check_mesh(cloth, fine)
    looked_at = sorted({1, 2, 3, FRAMES // 2, FRAMES})
    frames = {}
    for frame in looked_at:
        scene.frame_set(frame)
        frames[frame] = check_frame(cloth, fine, ball)
    motion = np.abs(frames[FRAMES] - frames[1]).max()
    assert motion > 0.05, motion

    # Live, the same frames come while the time line moves; what was baked is their judge.
    fine.modifiers["Pleat"].show_viewport = False
    scene.frame_set(1)
    cloth.pleat.live = True
    assert "Cloth" in pleat.bake.live.names(), pleat.bake.live.error
    fine = pleat.cloth.fine_of(cloth)
    for frame in (1, 2, 3):
        scene.frame_set(frame)
        np.testing.assert_allclose(in_world(fine), frames[frame], atol=1e-5)
    bridge = pleat.bake.live._sessions["Cloth"][0]
    cloth.pleat.live = False
    assert not bridge.alive()

    # Cancelled half way: no process is left, and the scene is as it was.
    bake = pleat.bake.Bake(cloth, bpy.context)
    steps = bake.steps()
    while bake.done < 2:
        next(steps)
    steps.close()
    assert scene.frame_current == 3 and pleat.cloth.fine_of(cloth) is None
    assert cloth.modifiers["Looks"].show_viewport and not cloth.hide_render

    # What can't be done is said in one line.
    cloth.pleat.detail, cloth.pleat.model = "network", "no-such-model"
    try:
        bpy.ops.pleat.bake()
        raise AssertionError("a missing model was taken")
    except RuntimeError as error:
        assert "no-such-model" in str(error), error
    cloth.pleat.detail = "fold"

    assert bpy.ops.pleat.bake() == {"FINISHED"}
    render(scene)
    print(json.dumps({"simulated_s": round(simulated, 1), "baked_s": round(baked, 1), "frames": FRAMES}))


def render(scene):
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (1.25, -1.6, 1.15), (1.08, 0, 0.66)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 3, (0.7, 0.3, 0.2)
    for thing in (camera, sun):
        scene.collection.objects.link(thing)
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.8, 0.85, 0.9, 1)
    scene.camera = camera
    scene.frame_set(FRAMES)
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 16, False
    scene.render.resolution_x, scene.render.resolution_y = 480, 360
    scene.render.filepath = os.path.join(FOLDER, "frame.png")
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
