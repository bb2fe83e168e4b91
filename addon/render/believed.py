"""The angle up to which a scene is believed: a cone in the viewport, a line where it looks from beyond, a warning of renders."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import blf
import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix, Vector

from ...f4x_core.scene.believed import BelievedZone
from ...f4x_core.troubles import EXPECTED
from ..scene.scene_object import ARRAYS, PATH, SceneObject

FAR = 1e4
"""World units behind which a view without perspective stands."""
RING_COLOUR, WARNING_COLOUR = (0.35, 0.85, 0.45, 0.9), (1.0, 0.65, 0.2, 1.0)
SAMPLED, SLIGHT = 500, 0.01
"""Gaussians by which a view is asked whether it shows a scene, and the fraction of them from which it does."""
SPOKES = 8
"""Lines of the cone from the ring to what the camera looks at."""
TEXT, MARGIN = 13, 14
"""Size of the line and its distance from the lower edge, pixels at a scale of 1."""

_zones: dict[tuple[str, str], BelievedZone | None] = {}  # (path, hash of its Gaussians) -> zone
_warned: set[int] = set()  # session_uid of roots of which the render under way has warned
_handles: list = []


def zone_of(scene_object: SceneObject) -> BelievedZone | None:
    """Return the zone of a scene in its own axes; None where its fit did not tell, or its file is missing."""
    key = scene_object.root[PATH], scene_object.root.get(ARRAYS, "")
    if key not in _zones:
        try:
            _zones[key] = BelievedZone.of(scene_object.base)
        except EXPECTED:
            return None
    return _zones[key]


def present_of(scene_object: SceneObject) -> tuple[BelievedZone, int] | None:
    """Return the zone of a scene and the number of its present camera; None where there is no zone, or its file is missing."""
    zone = zone_of(scene_object)
    try:
        frame = 0 if zone is None else scene_object.base.cameras.frame_at(scene_object.frame)
    except EXPECTED:  # the file is gone since
        return None
    return None if zone is None else (zone, min(max(frame, 0), len(zone.eyes) - 1))


def line_at(scene_object: SceneObject, eye: Vector) -> str:
    """Return the line about a view at `eye`, in Blender's world; nothing where it can be believed or nobody knows."""
    zone = zone_of(scene_object)
    if zone is None:
        return ""
    place = scene_object.root.matrix_world.inverted_safe() @ eye
    return zone.line(zone.aside(np.array(place)))


def is_in_view(scene_object: SceneObject, to_clip: Matrix) -> bool:
    """Return True where a view shows some of a scene; `to_clip`: the (4,4) matrix from Blender's world to its clip coordinates."""
    try:
        means = scene_object.base.static.means
    except EXPECTED:
        return True
    some = means[:: max(len(means) // SAMPLED, 1)]
    places = np.array(to_clip @ scene_object.root.matrix_world) @ np.column_stack([some, np.ones(len(some))]).T
    inside = (np.abs(places[:2]) <= places[3]).all(0)
    return not len(some) or inside.mean() > SLIGHT


def _clip_of(camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Matrix:
    """Return the matrix from Blender's world to the clip coordinates of a render's camera."""
    render = depsgraph.scene.render
    size = {"x": render.resolution_x, "y": render.resolution_y}
    aspect = {"scale_x": render.pixel_aspect_x, "scale_y": render.pixel_aspect_y}
    return camera.calc_matrix_camera(depsgraph, **size, **aspect) @ camera.matrix_world.normalized().inverted_safe()


def warn(report: Callable[[set[str], str], None], depsgraph: bpy.types.Depsgraph) -> None:
    """Warn once in a render where its camera stands farther aside than a scene that it shows can be believed."""
    scene, camera = depsgraph.scene.original, depsgraph.scene.camera.evaluated_get(depsgraph)
    for scene_object in _shown(scene):
        uid = scene_object.root.session_uid
        line = "" if uid in _warned else line_at(scene_object, camera.matrix_world.translation)
        line = line if line and is_in_view(scene_object, _clip_of(camera, depsgraph)) else ""
        if line:
            _warned.add(uid)
            report({"WARNING"}, f"{scene_object.name}, frame {scene.frame_current}: {line}")


def _shown(scene: bpy.types.Scene) -> Iterator[SceneObject]:
    for scene_object in SceneObject.among(scene.objects):
        if any(not cloud.hide_render for cloud in scene_object.clouds):
            yield scene_object


def _eye(view: bpy.types.RegionView3D) -> Vector:
    """Return the place in Blender's world from which a viewport looks."""
    to_world = view.view_matrix.inverted()
    if view.window_matrix[3][3] == 0:  # perspective
        return to_world.translation
    return to_world.translation + FAR * to_world.to_3x3().col[2]


def _scenes(context: bpy.types.Context) -> list[SceneObject]:
    """Return the scenes of which a viewport tells."""
    if not context.space_data.overlay.show_overlays:
        return []
    shown = SceneObject.among(context.scene.objects)
    return [each for each in shown if each.state.show_believed and any(cloud.visible_get() for cloud in each.clouds)]


def _draw_rings() -> None:
    """Draw the cone of the present camera of each clip, where it is seen from outside."""
    context = bpy.context
    if context.region_data.view_perspective == "CAMERA":
        return
    for scene_object in _scenes(context):
        present = present_of(scene_object)
        if present is None:
            continue
        zone, index = present
        ring = zone.ring(index)
        spokes = ring[:: len(ring) // SPOKES]
        lines = [
            *zip(ring, np.roll(ring, -1, axis=0), strict=True),
            *((place, zone.targets[index]) for place in spokes),
        ]
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        gpu.state.blend_set("ALPHA")
        with gpu.matrix.push_pop():
            gpu.matrix.multiply_matrix(scene_object.root.matrix_world)
            shader.uniform_float("color", RING_COLOUR)
            batch_for_shader(shader, "LINES", {"pos": np.array(lines, np.float32).reshape(-1, 3)}).draw(shader)
        gpu.state.blend_set("NONE")


def _draw_line() -> None:
    """Say at the bottom, above Adjust Last Operation, how far aside a viewport looks from, where that is a guess."""
    context = bpy.context
    scale = context.preferences.system.ui_scale
    covered = sum(region.width for region in context.area.regions if region.type == "UI")
    folded = [region for region in context.area.regions if region.type == "HUD" and region.height > 1]
    height = MARGIN * scale + max((each.y + each.height - context.region.y for each in folded), default=0)
    scenes, to_clip = _scenes(context), context.region_data.perspective_matrix
    for scene_object in scenes:
        line = line_at(scene_object, _eye(context.region_data))
        if line and is_in_view(scene_object, to_clip):
            line = f"{scene_object.name}: {line}" if len(scenes) > 1 else line
            blf.size(0, TEXT * scale)
            blf.color(0, *WARNING_COLOUR)
            blf.enable(0, blf.SHADOW)
            blf.shadow(0, 5, 0.0, 0.0, 0.0, 0.9)
            blf.position(0, (context.region.width - covered - blf.dimensions(0, line)[0]) / 2, height, 0)
            blf.draw(0, line)
            blf.disable(0, blf.SHADOW)
            height += 1.6 * TEXT * scale


@persistent
def _begin(*_) -> None:
    _warned.clear()


@persistent
def _forget(*_) -> None:
    _zones.clear()


HANDLERS = {"render_init": _begin, "load_post": _forget}


def register() -> None:
    """Start drawing and warning."""
    if not bpy.app.background:
        for function, when in ((_draw_rings, "POST_VIEW"), (_draw_line, "POST_PIXEL")):
            _handles.append(bpy.types.SpaceView3D.draw_handler_add(function, (), "WINDOW", when))


def unregister() -> None:
    """Undo `register`."""
    for handle in _handles:
        bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
    _handles.clear()
    _zones.clear()
    _warned.clear()
