"""Registration of everything Blender should know, in order; taken away in reverse."""

import bpy

from . import (
    believed,
    camera_operators,
    display,
    documentation,
    edit_operators,
    gesture_operators,
    job_operators,
    jobs,
    meshes,
    motion_operators,
    native_motion,
    operators,
    panel,
    panel_overlay,
    panel_properties,
    preferences,
    query_operators,
    render_engine,
    rig_repair,
    searching,
    shadows,
    sphere_gizmo,
)

CLASSES = (
    *operators.CLASSES,
    *documentation.CLASSES,
    *render_engine.CLASSES,
    *jobs.CLASSES,
    *preferences.CLASSES,
    *job_operators.CLASSES,
    *camera_operators.CLASSES,
    *panel_properties.CLASSES,
    *searching.CLASSES,
    *query_operators.CLASSES,
    *gesture_operators.CLASSES,
    *sphere_gizmo.CLASSES,
    *edit_operators.CLASSES,
    *motion_operators.CLASSES,
    *panel.CLASSES,
    *shadows.CLASSES,
    *meshes.CLASSES,
)
# modules with their own register() to call once the classes are registered
STARTED = (
    render_engine,
    panel_properties,
    gesture_operators,
    display,
    edit_operators,
    panel_overlay,
    believed,
    rig_repair,
    native_motion,
    shadows,
    meshes,
)


def _draw_import(self, context) -> None:
    self.layout.operator(operators.F4X_OT_import_scene.bl_idname, text="Feature4X (.f4x, .ply, .splat)")


def register() -> None:
    """Register classes and the File > Import entry."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for module in STARTED:
        module.register()
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)
    bpy.types.VIEW3D_MT_object.append(motion_operators.draw_menu)


def unregister() -> None:
    """Undo `register`; jobs under way end with it."""
    jobs.end_all()
    bpy.types.VIEW3D_MT_object.remove(motion_operators.draw_menu)
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import)
    for module in reversed(STARTED):
        module.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
