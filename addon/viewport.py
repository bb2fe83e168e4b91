"""Making what was imported visible: as the engine draws it or in colours, the clip's camera or the whole thing in view."""

import bpy

from ..f4x_core.native.library import open_library
from .preferences import preferences
from .render_engine import Feature4XRenderEngine

EXACT = "RENDERED"
"""Shading that shows what the scene's engine draws."""
PLAIN = "SOLID"
"""Shading that every engine has."""
COLOURED = "MATERIAL"
"""Shading that shows point clouds in colour whatever the engine: Solid draws them grey up to 5.2."""
NEAREST = 1e-3
"""Near clip distance of a viewport at most, by the distance that it has to see."""


def use_engine(scene: bpy.types.Scene) -> None:
    """Draw `scene` with the engine Feature4X, unless the preferences say no or numpy alone would keep the window waiting."""
    settings = preferences()
    if (settings is None or settings.show_exactly) and open_library()[0] is not None:
        scene.render.engine = Feature4XRenderEngine.bl_idname


def show(root: bpy.types.Object, camera: bpy.types.Object | None) -> None:
    """Let every 3D viewport of the window show colours and no lines to parents.

    They are the engine's where the scene is drawn with Feature4X. The view is that of `camera` if given, else all below `root`.
    """
    window = bpy.context.window
    if window is None:  # without a window there is nothing to look through
        return
    for area in window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        space = area.spaces.active
        exact = draw_exactly(space)
        space.overlay.show_relationship_lines = False  # hundreds of nodes have the same parent
        if camera is not None and exact:
            camera.data.show_background_images = False  # the picture hides the clip, but for specks at the points
        if camera is not None:
            space.region_3d.view_perspective = "CAMERA"
            continue
        region = next(region for region in area.regions if region.type == "WINDOW")
        with bpy.context.temp_override(window=window, area=area, region=region):
            _look_at(root)


def see_to(distance: float) -> None:
    """Let every 3D viewport see at least as far as `distance`, and as near as depth precision then allows."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                space = area.spaces.active
                space.clip_end = max(space.clip_end, distance)
                space.clip_start = min(space.clip_start, distance * NEAREST)


def draw_exactly(space: bpy.types.SpaceView3D) -> bool:
    """Let a viewport show colours; whether they are the engine's, exactly."""
    exact = bpy.context.scene.render.engine == Feature4XRenderEngine.bl_idname
    try:
        space.shading.type = EXACT if exact else COLOURED
    except TypeError:  # an engine such as Workbench has no Material Preview
        space.shading.type = PLAIN
    return exact


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
