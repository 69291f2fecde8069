# SPDX-License-Identifier: GPL-3.0-or-later
"""Pleat for Blender: a coarse cloth simulation becomes fine, wrinkled and collision-free (README.md beside this)."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from . import bake as bakes
from . import cloth as cloths
from .bridge import BridgeError

bl_info = {
    "name": "Pleat",
    "description": "Fine, wrinkled, collision-free cloth from a coarse simulation",
    "author": "The Pleat authors",
    "version": (0, 2, 0),
    "blender": (3, 4, 0),
    "location": "3D View > Sidebar > Pleat",
    "category": "Physics",
}

_FABRICS = [("DEFAULT", "Gray interlock", "A knitted fabric of middling weight"),
            ("silk", "Silk", ""), ("cotton-shirting", "Shirting", ""), ("wool-suiting", "Suiting", ""),
            ("denim", "Denim", ""), ("felt", "Felt", "")]
_DETAILS = [("fold", "Physics", "The fold step: any garment, no training"),
            ("network", "Network", "A trained network"), ("both", "Both", "Physics, drawn to a network's answer")]


def _live_changed(self, context):
    cloth = self.id_data
    if not self.live:
        bakes.live.stop(cloth)
        return
    try:
        bakes.live.start(cloth, context)
    except (BridgeError, cloths.ClothError) as error:
        bakes.live.error[cloth.name] = str(error)
        self["live"] = False


class PleatSettings(bpy.types.PropertyGroup):
    fabric: EnumProperty(name="Fabric", items=_FABRICS, description="What the cloth is made of")
    detail: EnumProperty(name="Detail", items=_DETAILS, description="What makes the wrinkles")
    model: StringProperty(name="Model", description="Model bundle, a file or a name; empty: the shipped one",
                          subtype="FILE_PATH")
    rounds: IntProperty(name="Subdivision", default=2, min=1, max=4,
                        description="Each edge is halved so many times; 2 makes 16 faces of one")
    folder: StringProperty(name="Files", default="//pleat", subtype="DIR_PATH",
                           description="Where the point caches go")
    live: BoolProperty(name="Live", description="Make the fine mesh while the time line moves", update=_live_changed)
    progress: FloatProperty(options={"HIDDEN", "SKIP_SAVE"}, min=0, max=1, subtype="FACTOR")
    baking: BoolProperty(options={"HIDDEN", "SKIP_SAVE"})
    cancel: BoolProperty(options={"HIDDEN", "SKIP_SAVE"})


class PleatPreferences(bpy.types.AddonPreferences):
    bl_idname = __package__
    program: StringProperty(name="Program", subtype="FILE_PATH",
                            description="The command pleat; empty: $PLEAT_PROGRAM, or the one on the PATH")

    def draw(self, _context):
        self.layout.prop(self, "program")


class PLEAT_OT_bake(bpy.types.Operator):
    bl_idname = "pleat.bake"
    bl_label = "Bake Fine Cloth"
    bl_description = "Enhance the frame range; the fine mesh plays it from a point cache"

    @classmethod
    def poll(cls, context):
        return cloths.is_simulated(context.object) and not context.object.pleat.baking

    def execute(self, context):
        try:
            bake = bakes.bake_now(context.object, context)
        except (BridgeError, cloths.ClothError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"WARNING" if bake.intersections or bake.failed else "INFO"}, bake.summary())
        return {"FINISHED"}

    def invoke(self, context, _event):
        self._cloth = context.object
        self._bake = bakes.Bake(self._cloth, context)
        self._steps = self._bake.steps()
        self._cloth.pleat.progress, self._cloth.pleat.baking, self._cloth.pleat.cancel = 0, True, False
        self._timer = context.window_manager.event_timer_add(0.02, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        settings = self._cloth.pleat
        if event.type == "ESC" or settings.cancel:
            self._steps.close()
            return self._end(context, {"INFO"}, "cancelled", {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            over = bakes.steps_for(self._steps, 0.1)
        except (BridgeError, cloths.ClothError, OSError) as error:
            return self._end(context, {"ERROR"}, str(error), {"CANCELLED"})
        settings.progress = self._bake.done / max(1, self._bake.total)
        for area in context.screen.areas:
            area.tag_redraw()
        if not over:
            return {"RUNNING_MODAL"}
        kind = {"WARNING"} if self._bake.intersections or self._bake.failed else {"INFO"}
        return self._end(context, kind, self._bake.summary(), {"FINISHED"})

    def _end(self, context, kind, text, result):
        context.window_manager.event_timer_remove(self._timer)
        self._cloth.pleat.baking = False
        self.report(kind, text)
        return result


class PLEAT_OT_cancel(bpy.types.Operator):
    bl_idname = "pleat.cancel"
    bl_label = "Cancel"
    bl_description = "Stop baking"

    def execute(self, context):
        context.object.pleat.cancel = True
        return {"FINISHED"}


class PLEAT_OT_remove(bpy.types.Operator):
    bl_idname = "pleat.remove"
    bl_label = "Remove Fine Cloth"
    bl_description = "Delete the fine mesh and show the coarse cloth again; the files stay"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and cloths.fine_of(context.object) is not None

    def execute(self, context):
        cloth = context.object
        bakes.live.stop(cloth)
        cloth.pleat["live"] = False
        fine = cloths.fine_of(cloth)
        mesh = fine.data
        bpy.data.objects.remove(fine)
        bpy.data.meshes.remove(mesh)
        cloths.show_cloth(cloth)
        return {"FINISHED"}


class PLEAT_PT_panel(bpy.types.Panel):
    bl_label = "Pleat"
    bl_idname = "PLEAT_PT_panel"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Pleat"

    def draw(self, context):
        layout, cloth = self.layout, context.object
        if not cloths.is_simulated(cloth):
            layout.label(text="Select a cloth: a mesh with", icon="INFO")
            layout.label(text="cloth physics or a mesh cache")
            return
        settings = cloth.pleat
        layout.use_property_split = True
        column = layout.column()
        column.enabled = not settings.baking and not settings.live
        column.prop(settings, "fabric")
        column.prop(settings, "detail")
        if settings.detail != "fold":
            column.prop(settings, "model")
        column.prop(settings, "rounds")
        column.prop(settings, "folder")
        things = cloths.obstacles(cloth, context)
        layout.label(text="Obstacles: " + (", ".join(thing.name for thing in things) or "none"), icon="MOD_PHYSICS")
        if settings.baking:
            layout.prop(settings, "progress", text="Frames", slider=True)
            layout.operator("pleat.cancel", icon="CANCEL")
        else:
            layout.operator("pleat.bake", icon="MOD_CLOTH")
            layout.prop(settings, "live", toggle=True, icon="PLAY")
            if cloths.fine_of(cloth):
                layout.operator("pleat.remove", icon="X")
        if cloth.name in bakes.live.error:
            box = layout.box()
            box.label(text=bakes.live.error[cloth.name], icon="ERROR")


_CLASSES = (PleatSettings, PleatPreferences, PLEAT_OT_bake, PLEAT_OT_cancel, PLEAT_OT_remove, PLEAT_PT_panel)


def register():
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Object.pleat = PointerProperty(type=PleatSettings)
    bpy.app.handlers.frame_change_post.append(bakes.on_frame)
    bpy.app.handlers.load_pre.append(bakes.on_load)


def unregister():
    bakes.live.stop_all()
    bpy.app.handlers.frame_change_post.remove(bakes.on_frame)
    bpy.app.handlers.load_pre.remove(bakes.on_load)
    del bpy.types.Object.pleat
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)
