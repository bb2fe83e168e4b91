"""Fields of the sidebar that act as soon as they are confirmed with Enter. Esc leaves a field as it was, and nothing happens."""

from __future__ import annotations

import bpy

_waiting: set[tuple[int, str]] = set()  # (session_uid of a root, operator) of calls that are to come


def submit(context: bpy.types.Context, root: bpy.types.Object, name: str) -> None:
    """Call the operator `f4x.NAME`, as its button does, when Blender has handled the key that confirmed a field of `root`.

    Blender tells of a new text in the middle of an event, when no operator may run yet. Scripts, which have no window, act by
    calling the operator.
    """
    call = root.session_uid, name
    if bpy.app.background or context.area is None or call in _waiting:
        return  # Blender tells of one key several times
    window, area = context.window, context.area
    _waiting.add(call)

    def act() -> None:
        _waiting.discard(call)
        regions = [region for region in area.regions if region.type == "WINDOW"]
        with bpy.context.temp_override(window=window, area=area, region=regions[0]):
            shown = bpy.context.view_layer.objects
            if any(item.session_uid == call[0] for item in shown):
                operator = getattr(bpy.ops.f4x, name)
                try:
                    operator("INVOKE_DEFAULT", True)  # True: a step of undo
                except RuntimeError as error:  # it was reported
                    print(error)

    bpy.app.timers.register(act, first_interval=0.0)
