"""Making what was imported visible: as the engine draws it or in colours, the clip's camera or the whole thing in view."""

import math
import time
from collections.abc import Sequence

import bpy
from bpy.app.handlers import persistent
from bpy_extras.view3d_utils import location_3d_to_region_2d

from ...f4x_core.native.library import open_library
from ..common.lines import CATEGORY
from ..jobs.preferences import preferences
from ..scene.scene_object import SceneObject
from .engine import Feature4XRenderEngine

EXACT = "RENDERED"
"""Shading that shows what the scene's engine draws."""
PLAIN = "SOLID"
"""Shading that every engine has."""
COLOURED = "MATERIAL"
"""Shading that shows point clouds in colour whatever the engine: Solid draws them grey up to 5.2."""
NEAREST = 1e-3
"""Near clip distance of a viewport at most, by the distance that it has to see."""

WAS_EXACT = "f4x_rendered"
"""Property of a screen in a saved file: numbers of its areas that showed what an engine draws. Blender itself opens every file
with Solid shading instead of it."""

FILLED = 0.94
"""Part of the free room of a viewport that a camera's picture fills along one side."""
TRY_AGAIN, PATIENCE = 0.1, 3.0
"""Seconds between two tries to choose the tab of the sidebar, and after which it is left as it is."""


def use_engine(scene: bpy.types.Scene) -> None:
    """Draw `scene` with the engine Feature4X, unless the preferences say no or numpy alone would keep the window waiting."""
    if _may_use_engine():
        scene.render.engine = Feature4XRenderEngine.bl_idname


def _may_use_engine() -> bool:
    settings = preferences()
    return (settings is None or settings.show_exactly) and open_library()[0] is not None


def show(root: bpy.types.Object, camera: bpy.types.Object | None, stay: bool = False) -> None:
    """Let every 3D viewport of the window show colours and no lines to parents.

    They are the engine's where the scene is drawn with Feature4X. The view is that of `camera` if given, with the whole range of
    frames in the timeline, else all below `root`; with `stay` a viewport that looks through a camera goes on doing so.
    """
    window = bpy.context.window
    if window is None:  # without a window there is nothing to look through
        return
    if len(SceneObject.among(bpy.context.scene.objects)) == 1:  # later ones come into a project that is under way
        _open_sidebar(window)
    if camera is not None:
        _fit_timeline(window)
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
        if stay and space.region_3d.view_perspective == "CAMERA":
            continue
        region = next(region for region in area.regions if region.type == "WINDOW")
        with bpy.context.temp_override(window=window, area=area, region=region):
            _look_at(root)


def _open_sidebar(window: bpy.types.Window) -> None:
    """Open the sidebar of the largest viewport at the tab of this extension, when Blender has drawn it."""
    areas = [area for area in window.screen.areas if area.type == "VIEW_3D"]
    if not areas:
        return
    area = max(areas, key=lambda each: each.width * each.height)
    area.spaces.active.show_region_ui = True
    until = time.monotonic() + PATIENCE

    def choose() -> float | None:
        sidebar = next((region for region in area.regions if region.type == "UI"), None)
        try:
            sidebar.active_panel_category = CATEGORY
        except (AttributeError, TypeError):  # read-only until the sidebar was drawn once
            return TRY_AGAIN if time.monotonic() < until else None
        if area.spaces.active.region_3d.view_perspective == "CAMERA":
            _fit_camera(area)
        return None

    bpy.app.timers.register(choose, first_interval=TRY_AGAIN)


def _fit_timeline(window: bpy.types.Window) -> None:
    """Let the timelines of a window show the whole frame range: a clip takes a fifth of what Blender's default file shows."""
    for area in window.screen.areas:
        if area.ui_type == "TIMELINE":
            region = next(region for region in area.regions if region.type == "WINDOW")
            with bpy.context.temp_override(window=window, area=area, region=region):
                bpy.ops.action.view_all()


def _fit_camera(area: bpy.types.Area) -> None:
    """Show the camera's picture whole and large beside the toolbar and the sidebar, which lie over the viewport."""
    view, camera = area.spaces.active.region_3d, bpy.context.scene.camera
    region = next(region for region in area.regions if region.type == "WINDOW")
    corners = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=bpy.context.scene)]
    seen = [location_3d_to_region_2d(region, view, corner) for corner in corners]
    if None in seen:
        return
    left, right, top = 0, region.width, region.height
    for other in area.regions:
        if other.width <= 1 or other.height <= 1:  # it is hidden
            continue
        if other.type == "TOOLS" and other.alignment == "LEFT":
            left = max(left, other.x + other.width - region.x)
        elif other.type == "UI" and other.alignment == "RIGHT":
            right = min(right, other.x - region.x)
        elif other.type in ("HEADER", "TOOL_HEADER") and other.alignment == "TOP":
            top = min(top, other.y - region.y)
    sides = [max(place[axis] for place in seen) - min(place[axis] for place in seen) for axis in (0, 1)]
    view.view_camera_zoom, view.view_camera_offset = framing(
        view.view_camera_zoom, sides, (left, 0, right, top), (region.width, region.height)
    )


def framing(
    zoom: float, sides: Sequence[float], free: tuple[float, float, float, float], region: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """Return (zoom, offset) of a viewport that looks through a camera, whose picture is then as large as the free part allows.

    Args:
        zoom: the present zoom.
        sides: width and height of the picture at that zoom, pixels.
        free: left, bottom, right and top of the free part of the region, pixels from its lower left corner.
        region: width and height of the region.
    """
    room = free[2] - free[0], free[3] - free[1]
    larger = FILLED * min(part / side for part, side in zip(room, sides, strict=True))
    factor = ((zoom / 50 + math.sqrt(2)) / 2) ** 2 * larger  # as Blender has it (BKE_screen_view3d_zoom_to_fac)
    middle = (free[0] + free[2] - region[0]) / 2, (free[1] + free[3] - region[1]) / 2
    across, up = (-way / (2 * factor * side) for way, side in zip(middle, region, strict=True))
    return min(max(50 * (2 * math.sqrt(factor) - math.sqrt(2)), -30), 600), (across, up)


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


def shows_picture(scene: bpy.types.Scene, space: bpy.types.SpaceView3D | None) -> bool:
    """Return True if a viewport shows `scene` as *Show Picture* would; True without one."""
    if space is None:
        return True
    exact = scene.render.engine == Feature4XRenderEngine.bl_idname
    return space.shading.type == (EXACT if exact else COLOURED) and (exact or not _may_use_engine())


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


def _draw_button(self, context) -> None:
    """Draw *Show Picture* beside the menus of a viewport that shows a scene otherwise."""
    if not shows_picture(context.scene, context.space_data) and SceneObject.among(context.scene.objects):
        self.layout.operator("f4x.show_picture", icon="SHADING_RENDERED")


@persistent
def _will_save(*_) -> None:
    for screen in bpy.data.screens:
        views = [(number, area.spaces.active) for number, area in enumerate(screen.areas) if area.type == "VIEW_3D"]
        screen[WAS_EXACT] = [number for number, space in views if space.shading.type == EXACT]


@persistent
def _saved(*_) -> None:
    for screen in bpy.data.screens:
        screen.pop(WAS_EXACT, None)


@persistent
def _opened(*_) -> None:
    scenes = {window.screen: window.scene for window in bpy.context.window_manager.windows}
    for screen in bpy.data.screens:
        exact = list(screen.pop(WAS_EXACT, ()))
        scene = scenes.get(screen, bpy.context.scene)
        for number in exact if scene.render.engine == Feature4XRenderEngine.bl_idname else ():
            area = screen.areas[number] if number < len(screen.areas) else None
            if area is not None and area.type == "VIEW_3D":
                area.spaces.active.shading.type = EXACT


HANDLERS = {"save_pre": _will_save, "save_post": _saved, "save_post_fail": _saved, "load_post": _opened}


def register() -> None:
    """Add the button of the header."""
    bpy.types.VIEW3D_MT_editor_menus.append(_draw_button)


def unregister() -> None:
    """Undo `register`."""
    bpy.types.VIEW3D_MT_editor_menus.remove(_draw_button)
