"""Making what was imported visible: engine-independent colours, the clip's camera or the whole thing in view."""

import bpy

COLOURED = "MATERIAL"
"""Shading that shows point clouds in colour: Solid draws them grey up to 5.2."""


def show(root: bpy.types.Object, camera: bpy.types.Object | None) -> None:
    """Let every 3D viewport of the window show colours and no lines to parents.

    It looks through `camera` if given, else at all below `root`.
    """
    window = bpy.context.window
    if window is None:  # without a window there is nothing to look through
        return
    for area in window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        space = area.spaces.active
        space.shading.type = COLOURED
        space.overlay.show_relationship_lines = False  # hundreds of nodes have the same parent
        if camera is not None:
            space.region_3d.view_perspective = "CAMERA"
            continue
        region = next(region for region in area.regions if region.type == "WINDOW")
        with bpy.context.temp_override(window=window, area=area, region=region):
            _look_at(root)


def _look_at(root: bpy.types.Object) -> None:
    selected = list(bpy.context.selected_objects)
    parts = [item for item in root.children_recursive if item.type == "POINTCLOUD" and item.visible_get()]
    for item in selected:
        item.select_set(False)
    for item in parts:
        item.select_set(True)
    bpy.ops.view3d.view_selected()
    for item in parts:
        item.select_set(False)
    for item in selected:
        item.select_set(True)
