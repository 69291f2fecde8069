# SPDX-License-Identifier: GPL-3.0-or-later
"""A cloth object of Blender as Pleat's coarse garment, and Pleat's fine mesh as an object of Blender."""

import contextlib
import os
import re

import bpy
import numpy as np
from mathutils import Matrix

from . import exchange

# Modifiers that move the cloth over time; what comes behind the last of them is for looks.
_MOVERS = {"CLOTH", "MESH_CACHE", "MESH_SEQUENCE_CACHE", "ARMATURE", "SOFT_BODY", "SURFACE_DEFORM", "MESH_DEFORM",
           "LATTICE", "HOOK", "SHRINKWRAP"}
_SIMULATED = {"CLOTH", "MESH_CACHE", "MESH_SEQUENCE_CACHE", "SOFT_BODY"}
_BAD_FIT = 0.1  # of edges in uv over edges in space
_NO_FIT = 0.4
_FINE = "pleat_fine_of"
_OFF = "pleat_off"


class ClothError(RuntimeError):
    """What is wrong with the cloth, for its user; one line."""


def metres(scene):
    """Metres in one of Blender's units."""
    return scene.unit_settings.scale_length if scene.unit_settings.system != "NONE" else 1.0


def _last_mover(cloth):
    kinds = [modifier.type for modifier in cloth.modifiers]
    places = [k for k, kind in enumerate(kinds) if kind in _MOVERS]
    return places[-1] if places else -1


def _behind(cloth):
    """Modifiers that come behind the cloth's motion: subdivision, thickness."""
    return list(cloth.modifiers)[_last_mover(cloth) + 1:]


def show_coarse(cloth):
    """The cloth as Pleat takes it, until show_cloth(): without what comes behind its motion, and a box that does not
    render, for its fine mesh takes its place; but not hidden, because Blender evaluates nothing that is.
    Blender forgets the simulated frames with each of these changes, unless they are baked: it is to simulate again from
    first_simulated() on. So nothing is touched that need not be."""
    off = [modifier for modifier in _behind(cloth) if modifier.show_viewport]
    for modifier in off:
        modifier.show_viewport = False
    if off:
        cloth[_OFF] = [modifier.name for modifier in off] + list(cloth.get(_OFF, []))
    if cloth.hide_viewport:
        cloth.hide_viewport = False
    if cloth.hide_get():
        cloth.hide_set(False)
    if not cloth.hide_render:
        cloth.hide_render = True
    if cloth.display_type != "BOUNDS":
        cloth.display_type = "BOUNDS"


def _is_whole(cache):
    """Whether Blender has simulated all frames of the cache; it says so in words alone: "1,000 frames in memory"."""
    known = re.match(r"([\d,.\s]+) frames", cache.info)
    return (known is not None and "outdated" not in cache.info
            and int(re.sub(r"\D", "", known[1])) == cache.frame_end - cache.frame_start + 1)


@contextlib.contextmanager
def kept_simulation(cloth, context):
    """What was simulated as a whole is baked meanwhile, so that Blender does not forget it (show_coarse)."""
    caches = [modifier.point_cache for modifier in cloth.modifiers if modifier.type in ("CLOTH", "SOFT_BODY")]
    kept = [cache for cache in caches if not cache.is_baked and _is_whole(cache)]
    for cache in kept:
        with context.temp_override(object=cloth, point_cache=cache):
            bpy.ops.ptcache.bake_from_cache()
    try:
        yield
    finally:
        for cache in kept:
            with context.temp_override(object=cloth, point_cache=cache):
                bpy.ops.ptcache.free_bake()


def first_simulated(cloth, first):
    """The frame to begin at, so that the simulation has come to frame `first` by then."""
    starts = [modifier.point_cache.frame_start for modifier in cloth.modifiers
              if modifier.type in ("CLOTH", "SOFT_BODY") and not modifier.point_cache.is_baked]
    return min([first, *starts])


@contextlib.contextmanager
def _at_rest(cloth, context):
    """The cloth without its motion and what comes behind it: itself, or a copy, evaluated, if anything shapes it."""
    if all(modifier.type in _MOVERS for modifier in list(cloth.modifiers)[:_last_mover(cloth) + 1]):
        yield cloth
        return
    copy = cloth.copy()
    try:
        for modifier in list(copy.modifiers):
            if modifier.type in _MOVERS or modifier.name in {behind.name for behind in _behind(cloth)}:
                copy.modifiers.remove(modifier)
        copy.hide_viewport = False
        context.scene.collection.objects.link(copy)
        yield copy.evaluated_get(context.evaluated_depsgraph_get())
    finally:
        bpy.data.objects.remove(copy)


def _points(mesh):
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3)


def _in_world(points, matrix):
    matrix = np.array(matrix, np.float64)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def evaluated_points(thing, depsgraph, scale):
    """The object's vertices as they are now, for Pleat."""
    seen = thing.evaluated_get(depsgraph)
    return exchange.to_pleat(_in_world(_points(seen.data), seen.matrix_world), scale)


def _triangles(mesh):
    """Vertices (F, 3), loops (F, 3) and polygons (F) of the mesh's triangles."""
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.loop_triangles), np.int32)
    loops = np.empty(3 * len(mesh.loop_triangles), np.int32)
    polygons = np.empty(len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", vertices)
    mesh.loop_triangles.foreach_get("loops", loops)
    mesh.loop_triangles.foreach_get("polygon_index", polygons)
    return vertices.reshape(-1, 3), loops.reshape(-1, 3), polygons


def _uv(layer):
    values = np.empty(2 * len(layer.data), np.float32)
    layer.data.foreach_get("uv", values)
    return values.reshape(-1, 2)


class Garment:
    """The coarse cloth at rest, and what its fine mesh takes over: uv layers, materials, vertex groups."""

    def __init__(self, cloth, context):
        self.name = cloth.name
        self.scale = metres(context.scene)
        with _at_rest(cloth, context) as seen:
            mesh = seen.data
            if not mesh.polygons:
                raise ClothError(f"{cloth.name}: has no faces")
            self.points = exchange.to_pleat(_in_world(_points(mesh), seen.matrix_world), self.scale)
            self.faces, loops, polygons = _triangles(mesh)
            self.layers = {layer.name: _uv(layer)[loops] for layer in mesh.uv_layers}
            active = mesh.uv_layers.active.name if mesh.uv_layers.active else None
            self.active_layer = active
            self.materials = [slot.material for slot in cloth.material_slots]
            of_polygon = np.empty(len(mesh.polygons), np.int32)
            mesh.polygons.foreach_get("material_index", of_polygon)
            self.material_index = of_polygon[polygons]
            self.groups = {group.name: np.zeros(len(mesh.vertices), np.float32) for group in cloth.vertex_groups}
            names = [group.name for group in cloth.vertex_groups]
            for vertex in mesh.vertices:
                for element in vertex.groups:
                    if element.group < len(names):
                        self.groups[names[element.group]][vertex.index] = element.weight
            corners, error = self.layers.get(active), np.inf
            if corners is not None:
                factors, error = exchange.fit_scale(self.points, self.faces, corners)
            if error > _BAD_FIT:
                flat = _unwrapped(seen, context)[loops]
                flat_factors, flat_error = exchange.fit_scale(self.points, self.faces, flat)
                if flat_error < error:
                    corners, factors, error = flat, flat_factors, flat_error
        if error > _NO_FIT:
            raise ClothError(f"{cloth.name}: its UV map does not lay the cloth flat, and neither does unwrapping; mark seams "
                             f"where a tailor cuts (edges are {100 * error:.0f} % off)")
        self.notes = []
        if error > _BAD_FIT:
            self.notes.append(f"{cloth.name}: edges in its UV map are {100 * error:.0f} % off their lengths in space; mark "
                              "seams where a tailor cuts")
        self.uv, self.uv_faces = exchange.share_corners(corners * factors)

    def held(self, cloth):
        """Vertices that the cloth's pin group holds all the time."""
        settings = next((modifier.settings for modifier in cloth.modifiers if modifier.type == "CLOTH"), None)
        name = settings.vertex_group_mass if settings else ""
        return np.nonzero(self.groups[name] > 0.99)[0].tolist() if name in self.groups else []

    def write(self, path):
        exchange.write_obj(path, self.points, self.faces, self.uv, self.uv_faces)


def _unwrapped(seen, context):
    """uv of each loop of the evaluated object's mesh, unwrapped along its seams."""
    copy = bpy.data.meshes.new_from_object(seen)
    thing = bpy.data.objects.new("pleat-unwrap", copy)
    context.scene.collection.objects.link(thing)
    active, selected = context.view_layer.objects.active, list(context.selected_objects)
    mode = context.mode
    try:
        if mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        for other in selected:
            other.select_set(False)
        context.view_layer.objects.active = thing
        thing.select_set(True)
        layer = copy.uv_layers.new(name="pleat", do_init=False) or copy.uv_layers[0]
        copy.uv_layers.active = layer
        name = layer.name
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.uv.unwrap(method="ANGLE_BASED", margin=0.001)
        bpy.ops.object.mode_set(mode="OBJECT")
        return _uv(copy.uv_layers[name])
    finally:
        bpy.data.objects.remove(thing)
        bpy.data.meshes.remove(copy)
        for other in selected:
            other.select_set(True)
        context.view_layer.objects.active = active


def obstacles(cloth, context):
    """What the cloth collides with: visible meshes with collision physics."""
    return [
        thing for thing in context.view_layer.objects
        if thing is not cloth and thing.type == "MESH" and thing.visible_get() and _FINE not in thing
        and any(modifier.type == "COLLISION" for modifier in thing.modifiers)
    ]


def moves(thing):
    """Whether anything may move the object or its vertices."""
    if any(modifier.type not in ("COLLISION", "SUBSURF", "SOLIDIFY", "TRIANGULATE", "BEVEL", "MIRROR", "EDGE_SPLIT",
                                 "WEIGHTED_NORMAL") for modifier in thing.modifiers):
        return True
    keys = getattr(thing.data, "shape_keys", None)
    if (keys and keys.animation_data) or thing.rigid_body:
        return True
    while thing:
        if thing.animation_data or thing.constraints or thing.parent_type == "BONE":
            return True
        thing = thing.parent
    return False


def write_obstacle(thing, depsgraph, scale, path):
    """The object's mesh as it is now; its number of vertices."""
    points = evaluated_points(thing, depsgraph, scale)
    exchange.write_obj(path, points, _triangles(thing.evaluated_get(depsgraph).data)[0])
    return len(points)


def is_simulated(thing):
    return thing is not None and thing.type == "MESH" and any(m.type in _SIMULATED for m in thing.modifiers)


def fine_of(cloth):
    """The fine object that was made of the cloth, or None."""
    return next((thing for thing in bpy.data.objects if thing.get(_FINE) == cloth.name), None)


def make_fine(cloth, garment, mesh_file, rounds, context):
    """The fine mesh as an object in the cloth's place, with the cloth's uv layers, materials and vertex groups. Its
    coordinates are Pleat's own: metres, Y up."""
    points, faces = exchange.read_obj(mesh_file)
    if len(faces) != len(garment.faces) * 4**rounds:
        raise ClothError(f"{mesh_file}: is not the fine mesh of {cloth.name}")
    mesh = bpy.data.meshes.new(cloth.name + ".fine")
    mesh.from_pydata(points.tolist(), [], faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), bool))
    for material in garment.materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", np.repeat(garment.material_index, 4**rounds))
    for name, corners in garment.layers.items():
        layer = mesh.uv_layers.new(name=name, do_init=False)
        layer.data.foreach_set("uv", exchange.to_fine(corners, rounds).astype(np.float32).ravel())
    if garment.active_layer:
        mesh.uv_layers.active = mesh.uv_layers[garment.active_layer]
    mesh.update()
    fine = fine_of(cloth)
    if fine:
        old = fine.data
        fine.modifiers.clear()
        fine.vertex_groups.clear()
        fine.data = mesh
        bpy.data.meshes.remove(old)
    else:
        fine = bpy.data.objects.new(cloth.name + ".fine", mesh)
        for collection in cloth.users_collection:
            collection.objects.link(fine)
        fine[_FINE] = cloth.name
    for name, weights in garment.groups.items():
        group = fine.vertex_groups.new(name=name)
        fine_weights = np.zeros(len(points), np.float32)
        fine_weights[faces.ravel()] = exchange.to_fine(weights[garment.faces][:, :, None], rounds).ravel()
        for weight in np.unique(np.round(fine_weights[fine_weights > 0], 3)):
            group.add(np.nonzero(np.round(fine_weights, 3) == weight)[0].tolist(), float(weight), "REPLACE")
    unit = 1.0 / garment.scale
    fine.matrix_world = Matrix(((unit, 0, 0, 0), (0, 0, -unit, 0), (0, unit, 0, 0), (0, 0, 0, 1)))
    context.view_layer.update()
    return fine


def show_cloth(cloth):
    """As it was before its fine mesh took its place."""
    cloth.hide_render = False
    cloth.display_type = "TEXTURED"
    for name in cloth.pop(_OFF, []):
        if name in cloth.modifiers:
            cloth.modifiers[name].show_viewport = True


def play(fine, cache, first_frame):
    """The fine object plays the point cache, whose sample 0 is in `first_frame`."""
    modifier = fine.modifiers.new("Pleat", "MESH_CACHE")
    modifier.cache_format = "PC2"
    modifier.filepath = cache
    modifier.frame_start = first_frame
    modifier.interpolation = "NONE"
    return modifier


def cache_folder(cloth, named):
    """The folder of the cloth's files: as named, beside the .blend file, or in Blender's temporary folder."""
    folder = bpy.path.abspath(named) if named and (bpy.data.is_saved or not named.startswith("//")) else os.path.join(
        bpy.app.tempdir, "pleat")
    folder = os.path.join(folder, bpy.path.clean_name(cloth.name))
    os.makedirs(folder, exist_ok=True)
    return folder
