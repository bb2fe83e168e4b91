"""Registration of everything Blender should know, in order; taken away in reverse."""

import bpy

from . import operators, render_engine

CLASSES = (*operators.CLASSES, *render_engine.CLASSES)


def _draw_import(self, context) -> None:
    self.layout.operator(operators.F4X_OT_import_scene.bl_idname, text="Feature4X Scene (.f4x)")


def register() -> None:
    """Register classes and the File > Import entry."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    render_engine.register()
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)


def unregister() -> None:
    """Undo `register`."""
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import)
    render_engine.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
