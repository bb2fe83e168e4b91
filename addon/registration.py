"""Registration of everything Blender should know, in order; taken away in reverse."""

import bpy

from . import job_operators, jobs, operators, preferences, render_engine

CLASSES = (
    *operators.CLASSES,
    *render_engine.CLASSES,
    *jobs.CLASSES,
    *preferences.CLASSES,
    *job_operators.CLASSES,
)


def _draw_import(self, context) -> None:
    self.layout.operator(operators.F4X_OT_import_scene.bl_idname, text="Feature4X Scene (.f4x)")


def register() -> None:
    """Register classes and the File > Import entry."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    render_engine.register()
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)


def unregister() -> None:
    """Undo `register`; jobs under way end with it."""
    jobs.end_all()
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import)
    render_engine.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
