"""Registration of everything Blender should know, in order; taken away in reverse."""

import bpy

from .edits import display, listing
from .jobs import preferences, runner
from .operators import (
    baking,
    cameras,
    cleanup,
    documentation,
    editing,
    exporting,
    gestures,
    handles,
    importing,
    keeping,
    meshes,
    motion,
    placing,
    planning,
    point_edits,
    searching,
    selecting,
    tasks,
)
from .render import believed, compositing, engine, shadows, viewport
from .rig import native_motion, repair
from .scene import clip_time, scene_object
from .ui import motion_panel, overlay, panel, properties, sphere_gizmo

CLASSES = (
    *importing.CLASSES,
    *documentation.CLASSES,
    *engine.CLASSES,
    *runner.CLASSES,
    *preferences.CLASSES,
    *tasks.CLASSES,
    *exporting.CLASSES,
    *baking.CLASSES,
    *cameras.CLASSES,
    *properties.CLASSES,
    *searching.CLASSES,
    *selecting.CLASSES,
    *gestures.CLASSES,
    *sphere_gizmo.CLASSES,
    *editing.CLASSES,
    *planning.CLASSES,
    *keeping.CLASSES,
    *handles.CLASSES,
    *motion.CLASSES,
    *cleanup.CLASSES,
    *placing.CLASSES,
    *point_edits.CLASSES,
    *panel.CLASSES,
    *motion_panel.CLASSES,
    *shadows.CLASSES,
    *native_motion.CLASSES,
    *meshes.CLASSES,
    *compositing.CLASSES,
)
HANDLED = (
    clip_time,
    display,
    listing,
    keeping,
    handles,
    overlay,
    believed,
    point_edits,
    repair,
    native_motion,
    compositing,
    viewport,
)
"""Modules with `HANDLERS`: name of a list of `bpy.app.handlers` -> function; Blender calls them in this order."""
STARTED = (engine, properties, gestures, planning, overlay, believed, native_motion, shadows, meshes, viewport)
"""Modules with their own register() to call once the classes are registered."""


def _draw_import(self, context) -> None:
    self.layout.operator(importing.F4X_OT_import_scene.bl_idname, text="Feature4X (.f4x, .ply, .splat, .spz, .glb)")


def _draw_export(self, context) -> None:
    text = "Feature4X (.ply, .splat, .spz, .glb, .usd)"
    self.layout.operator(exporting.F4X_OT_export_scene.bl_idname, text=text)


def register() -> None:
    """Register classes and the entries of File > Import and File > Export."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for module in HANDLED:
        for name, function in module.HANDLERS.items():
            getattr(bpy.app.handlers, name).append(function)
    for module in STARTED:
        module.register()
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)
    bpy.types.TOPBAR_MT_file_export.append(_draw_export)
    bpy.types.VIEW3D_MT_object.append(motion.draw_menu)


def unregister() -> None:
    """Undo `register`; jobs under way end with it."""
    runner.end_all()
    bpy.types.VIEW3D_MT_object.remove(motion.draw_menu)
    bpy.types.TOPBAR_MT_file_export.remove(_draw_export)
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import)
    for module in HANDLED:
        for name, function in module.HANDLERS.items():
            getattr(bpy.app.handlers, name).remove(function)
    for module in reversed(STARTED):
        module.unregister()
    scene_object.forget()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
