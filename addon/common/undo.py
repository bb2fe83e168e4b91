"""Steps of undo that no operator of a button ends."""

import bpy


def end_step(name: str) -> None:
    """End a step of undo called `name`: what changed since the one before is undone together."""
    if bpy.ops.ed.undo_push.poll():
        bpy.ops.ed.undo_push(message=name)
