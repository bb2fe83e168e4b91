"""Ground truth of any Blender scene: pictures, depth, flow, masks, tracks and cameras of the same moments.

World frame of the truth: Blender's own (z up, its unit). Cameras in it are OpenCV cameras (`world_to_camera`).

    OUT/images/%05d.png    as the scene's own view transform shows it
    OUT/truth/%05d.exr     multilayer float32: Combined, Depth.Z (z depth, 1e10 = nothing), Vector, Position and
                           the object index (`IndexOB.X` from Blender 4.x, `Object Index.X` from 5.x)
    OUT/masks/%05d.png     white where what moves is in front
    OUT/tracks.npz         tracks (F,N,2) float32 pixels, visible (F,N), xyz (F,N,3) float32 world, moving (N,)
    OUT/truth.json         cameras, moving object indices, extra cameras

Flow in pixels (x right, y down): forward t -> t+1 = (-Vector.Z, +Vector.W); backward t -> t-1 = (+Vector.X, -Vector.Y).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..addon.common.axes import camera_path
from ..addon.common.render_settings import save_multilayer, save_png
from ..addon.render.evaluated import SOLID, surface_of
from ..f4x_core.errors import F4xError
from ..f4x_core.geometry.camera import CameraPath

STATIC_INDEX, MOVING_INDEX = 1, 2  # object index pass
STILL = 1e-5
"""Largest motion of what counts as standing, in sizes of the whole scene: single precision alone gives a hundredth of it."""
NEAR_ENOUGH = 1e-3
"""Fraction of a point's distance by which a ray towards it may end early and still have met the point itself."""
RAYS = 8
"""Rays per wanted track: sky is missed, and what moves is small in most pictures."""

Key = tuple[str, tuple[int, ...]]  # object name, place among its instances


@dataclass(frozen=True)
class TruthSettings:
    """Settings of rendering the open scene."""

    frames: range
    """Blender frames, step 1; they become clip frames 0, 1, …"""
    samples: int = 16
    """Cycles samples per pixel."""
    tracks: int = 256
    """Number of tracked surface points, half of them on moving objects if enough are visible; 0: none."""
    moving: tuple[str, ...] = ()
    """Names of the moving objects; empty: detected from the motion of their surfaces."""
    seed: int = 0
    """Of Cycles' noise and of the places of tracks."""


def write_truth(folder: Path, name: str, scene: bpy.types.Scene, settings: TruthSettings) -> dict[str, Any]:
    """Render the open scene through its camera into `folder`; returns what was found: frames, moving objects, tracks.

    The scene's settings, object indices and modifiers are changed for it: open the file anew for other work.
    Raises F4xError: no pinhole camera, an unknown name among `moving`, or nothing that can be seen.
    """
    if scene.camera is None or scene.camera.data.type != "PERSP":
        raise F4xError(f"{name} has no perspective camera; give one with --camera.")
    use_passes(scene, settings.samples, settings.seed)
    _match_viewport(scene)
    scene.frame_start, scene.frame_end = settings.frames[0], settings.frames[-1]
    cameras = camera_path(scene, scene.camera, settings.frames)
    moving = _mark_moving(scene, settings)
    render_frames(folder, scene, settings.frames)
    _render_masks(folder, scene, settings.frames)
    found = _follow(scene, cameras, settings, moving) if settings.tracks else {}
    if found:
        np.savez(folder / "tracks.npz", **found)
    clip_times = cameras.times - settings.frames[0]
    cameras = CameraPath(
        cameras.intrinsics, cameras.world_to_camera, clip_times, width=cameras.width, height=cameras.height
    )
    write_facts(folder, name, scene.render.fps / scene.render.fps_base, cameras)
    return {
        "frames": len(cameras),
        "width": cameras.width,
        "height": cameras.height,
        "moving": sorted(moving),
        "tracks": found["tracks"].shape[1] if found else 0,
        "visible": float(found["visible"].mean()) if found else 0.0,
    }


def use_passes(scene: bpy.types.Scene, samples: int, seed: int) -> None:
    """Cycles without anything that blurs truth, and the passes that hold it."""
    render, cycles, layer = scene.render, scene.cycles, scene.view_layers[0]
    render.engine = "CYCLES"
    render.use_persistent_data = True
    render.use_motion_blur = False  # the Vector pass is empty with motion blur
    render.use_compositing = render.use_sequencer = False
    render.dither_intensity = 0.0
    cycles.device = "CPU"
    cycles.samples, cycles.seed, cycles.use_animated_seed = samples, seed, True
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"  # a pixel is the mean over its own square
    for other in scene.view_layers[1:]:
        other.use = False
    layer.use_pass_z = layer.use_pass_vector = layer.use_pass_position = layer.use_pass_object_index = True


def render_frames(folder: Path, scene: bpy.types.Scene, frames: Sequence[int] | np.ndarray) -> None:
    """Render pictures and passes; files are numbered from 0."""
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(frames):
        scene.frame_set(int(frame))
        save_multilayer(scene, folder / "truth" / f"{number:05d}.exr")
        save_png(scene, folder / "images" / f"{number:05d}.png")


def write_facts(
    folder: Path,
    name: str,
    fps: float,
    cameras: CameraPath,
    extra_cameras: Iterable[dict] = (),
    people: Sequence[dict] = (),
) -> None:
    """Write truth.json."""
    facts = {
        "width": cameras.width,
        "height": cameras.height,
        "fps": fps,
        "scene": name,
        "cameras": cameras.to_json(),
        "moving_index": sorted({MOVING_INDEX, *(person["index"] for person in people)}),
        "extra_cameras": list(extra_cameras),
        "people": list(people),
    }
    (folder / "truth.json").write_text(json.dumps(facts))


def _match_viewport(scene: bpy.types.Scene) -> None:
    """Make the evaluated scene the one that is rendered: what is hidden, and how finely surfaces are divided."""
    for item in scene.objects:
        item.hide_viewport = item.hide_render
        for modifier in item.modifiers:
            modifier.show_viewport = modifier.show_render
            if modifier.type in ("SUBSURF", "MULTIRES"):
                modifier.levels = modifier.render_levels


def _triangles(scene: bpy.types.Scene, frame: int) -> dict[Key, np.ndarray]:
    """World triangles (n,3,3) of every visible surface at a frame."""
    scene.frame_set(frame)
    found = {}
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        item = instance.object
        if instance.show_self and item.type in SOLID:
            surface = surface_of(item, np.array(instance.matrix_world))
            if surface is not None:
                found[item.name, tuple(instance.persistent_id)] = surface.triangles
    return found


def _mark_moving(scene: bpy.types.Scene, settings: TruthSettings) -> set[str]:
    """Give every object its index for the pass; the names of those that move."""
    unknown = [name for name in settings.moving if name not in scene.objects]
    if unknown:
        raise F4xError(f"--moving {unknown[0]}: the scene has no such object.")
    moving = set(settings.moving)
    if not moving:
        first = _triangles(scene, settings.frames[0])
        if not first:
            raise F4xError("The scene has no surface that a picture could show; give one with meshes.")
        corners = np.concatenate(list(first.values())).reshape(-1, 3)
        min_move = STILL * float(np.linalg.norm(np.ptp(corners, axis=0)))
        for frame in settings.frames[1:]:
            now = _triangles(scene, frame)
            for key in first.keys() | now.keys():
                before, after = first.get(key), now.get(key)
                if (
                    before is None
                    or after is None
                    or before.shape != after.shape
                    or np.abs(after - before).max() > min_move
                ):
                    moving.add(key[0])
    for item in bpy.data.objects:
        item.pass_index = MOVING_INDEX if item.name in moving else STATIC_INDEX
    return moving


def _render_masks(folder: Path, scene: bpy.types.Scene, frames: range) -> None:
    """Render moving objects in white and the rest in black, with one sample at the centre of each pixel."""
    material = bpy.data.materials.new("truth mask")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    index, compare = tree.nodes.new("ShaderNodeObjectInfo"), tree.nodes.new("ShaderNodeMath")
    emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    compare.operation = "COMPARE"
    compare.inputs[1].default_value, compare.inputs[2].default_value = MOVING_INDEX, 0.5
    tree.links.new(index.outputs["Object Index"], compare.inputs[0])
    tree.links.new(compare.outputs[0], emission.inputs["Strength"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])

    layer, world = scene.view_layers[0], scene.world
    layer.material_override, scene.world = material, None
    scene.view_settings.view_transform = "Raw"
    scene.cycles.samples, scene.cycles.filter_width = 1, 0.01
    for number, frame in enumerate(frames):
        scene.frame_set(frame)
        bpy.ops.render.render()
        save_png(scene, folder / "masks" / f"{number:05d}.png")
    layer.material_override, scene.world = None, world


def _follow(
    scene: bpy.types.Scene, cameras: CameraPath, settings: TruthSettings, moving: set[str]
) -> dict[str, np.ndarray]:
    """Tracks of surface points that are seen at the first, the middle or the last frame, exact to single precision."""
    random = np.random.default_rng(settings.seed)
    count = len(settings.frames)
    picked: list[tuple[Key, int, np.ndarray]] = []  # surface, triangle, its three weights
    starts = sorted({0, count // 2, count - 1})
    for start in starts:
        surfaces = _triangles(scene, settings.frames[start])
        seen = _hits(surfaces, cameras[start], RAYS * settings.tracks, random)
        wanted = -(-settings.tracks // len(starts))
        busy = [hit for hit in seen if hit[0][0] in moving]
        still = [hit for hit in seen if hit[0][0] not in moving][: max(wanted // 2, wanted - len(busy))]
        picked += still + busy[: wanted - len(still)]
    xyz = np.full((count, len(picked), 3), np.nan)
    visible = np.zeros((count, len(picked)), bool)
    sizes: dict[Key, int] = {}
    for number, frame in enumerate(settings.frames):
        surfaces = _triangles(scene, frame)
        for i, (key, triangle, weights) in enumerate(picked):
            corners = surfaces.get(key)
            if corners is not None and sizes.setdefault(key, len(corners)) == len(corners):
                xyz[number, i] = weights @ corners[triangle]
        visible[number] = _visible(surfaces, cameras[number], xyz[number])
    pixels = np.stack([cameras[i].project(xyz[i])[0] for i in range(count)])
    return {
        "tracks": pixels.astype(np.float32),
        "visible": visible,
        "xyz": xyz.astype(np.float32),
        "moving": np.array([key[0] in moving for key, _, _ in picked], bool),
    }


def _tree(surfaces: dict[Key, np.ndarray]) -> BVHTree:
    corners = np.concatenate(list(surfaces.values()))
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return BVHTree.FromPolygons(corners.reshape(-1, 3).tolist(), faces.tolist(), all_triangles=True)


def _hits(surfaces: dict[Key, np.ndarray], camera, rays: int, random) -> list[tuple[Key, int, np.ndarray]]:
    """Surface, triangle and corner weights at random pixels of an image."""
    tree = _tree(surfaces)
    keys, sizes = list(surfaces), [len(triangles) for triangles in surfaces.values()]
    begins = np.cumsum([0, *sizes])
    pixels = random.uniform(0, 1, (rays, 2)) * [camera.width, camera.height]
    directions = camera.unproject(pixels, np.ones(rays)) - camera.center
    found = []
    for direction in directions:
        point, _, face, _ = tree.ray_cast(camera.center, direction)
        if face is None:
            continue
        surface = int(np.searchsorted(begins, face, side="right")) - 1
        triangle = face - int(begins[surface])
        corners = surfaces[keys[surface]][triangle].astype(np.float64)
        edges = np.stack([corners[1] - corners[0], corners[2] - corners[0]], 1)
        second, third = np.linalg.lstsq(edges, np.array(point) - corners[0], rcond=None)[0]
        found.append((keys[surface], triangle, np.array([1 - second - third, second, third])))
    return found


def _visible(surfaces: dict[Key, np.ndarray], camera, xyz: np.ndarray) -> np.ndarray:
    """(N,) bool: inside the picture, in front of the camera, and met first on the way there."""
    pixels, depth = camera.project(xyz)
    inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < [camera.width, camera.height]).all(1)
    tree = _tree(surfaces)
    for i in np.flatnonzero(inside):
        direction = xyz[i] - camera.center
        distance = tree.ray_cast(camera.center, direction)[3]
        inside[i] = distance is not None and distance > (1 - NEAR_ENOUGH) * np.linalg.norm(direction)
    return inside
