"""Steps of undo that no operator of a button ends, and the mode in which there are any."""

import bpy


def leave_mode() -> bool:
    """Go to Object Mode; return True if another one was on."""
    other = bpy.context.mode != "OBJECT"
    if other:
        bpy.ops.object.mode_set(mode="OBJECT")
    return other


def end_step(name: str) -> None:
    """End a step of undo called `name`: what changed since the one before is undone together."""
    if bpy.ops.ed.undo_push.poll():
        bpy.ops.ed.undo_push(message=name)
