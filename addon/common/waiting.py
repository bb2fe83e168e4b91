"""The cursor of waiting, as Blender's own importers show it while they keep the window busy."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def waiting() -> Iterator[None]:
    """Show the cursor of waiting in all windows within a `with` block; the cursors of tools come back."""
    for window in bpy.context.window_manager.windows:
        window.cursor_modal_set("WAIT")
    try:
        yield
    finally:
        for window in bpy.context.window_manager.windows:
            window.cursor_modal_restore()
