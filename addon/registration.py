"""Registration of everything Blender should know, in order; taken away in reverse."""

import bpy

from . import (
    believed,
    camera_operators,
    cleanup_operators,
    clip_time,
    compositing,
    display,
    documentation,
    edit_handles,
    edit_operators,
    export_operator,
    gesture_operators,
    job_operators,
    jobs,
    meshes,
    motion_operators,
    motion_panel,
    native_motion,
    operators,
    panel,
    panel_overlay,
    panel_properties,
    placing_operators,
    point_edits,
    preferences,
    query_operators,
    render_engine,
    rig_repair,
    searching,
    shadows,
    sphere_gizmo,
    viewport,
)

CLASSES = (
    *operators.CLASSES,
    *documentation.CLASSES,
    *render_engine.CLASSES,
    *jobs.CLASSES,
    *preferences.CLASSES,
    *job_operators.CLASSES,
    *export_operator.CLASSES,
    *camera_operators.CLASSES,
    *panel_properties.CLASSES,
    *searching.CLASSES,
    *query_operators.CLASSES,
    *gesture_operators.CLASSES,
    *sphere_gizmo.CLASSES,
    *edit_operators.CLASSES,
    *edit_handles.CLASSES,
    *motion_operators.CLASSES,
    *cleanup_operators.CLASSES,
    *placing_operators.CLASSES,
    *point_edits.CLASSES,
    *panel.CLASSES,
    *motion_panel.CLASSES,
    *shadows.CLASSES,
    *native_motion.CLASSES,
    *meshes.CLASSES,
    *compositing.CLASSES,
)
# modules with their own register() to call once the classes are registered
STARTED = (
    render_engine,
    panel_properties,
    gesture_operators,
    clip_time,
    display,
    edit_operators,
    edit_handles,
    panel_overlay,
    believed,
    point_edits,
    rig_repair,
    native_motion,
    shadows,
    meshes,
    compositing,
    viewport,
)


def _draw_import(self, context) -> None:
    self.layout.operator(operators.F4X_OT_import_scene.bl_idname, text="Feature4X (.f4x, .ply, .splat, .spz, .glb)")


def _draw_export(self, context) -> None:
    text = "Feature4X (.ply, .splat, .spz, .glb, .usd)"
    self.layout.operator(export_operator.F4X_OT_export_scene.bl_idname, text=text)


def register() -> None:
    """Register classes and the entries of File > Import and File > Export."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for module in STARTED:
        module.register()
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)
    bpy.types.TOPBAR_MT_file_export.append(_draw_export)
    bpy.types.VIEW3D_MT_object.append(motion_operators.draw_menu)


def unregister() -> None:
    """Undo `register`; jobs under way end with it."""
    jobs.end_all()
    bpy.types.VIEW3D_MT_object.remove(motion_operators.draw_menu)
    bpy.types.TOPBAR_MT_file_export.remove(_draw_export)
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import)
    for module in reversed(STARTED):
        module.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
