"""Taking over a clip's camera, picture size, rate and frame range: at import in a fresh file, else only when asked.

A project is under way when the file was saved, holds objects of its own or another scene, or when its render settings are
neither Blender's defaults nor what the last import set. Then import leaves all settings and names those that differ.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import bpy
import numpy as np

from ...f4x_core.scene import Scene
from ...f4x_core.scene.foreign import SplatSequence
from ..scene.clip_time import Timing, place, rate_between, timing_of
from ..scene.scene_object import PATH

CLIP = "f4x_clip"
"""Property of an imported camera: JSON of its `ClipSettings`."""
SET_UP = "f4x_set_up"
"""Property of a Blender scene: JSON of its render settings after they were set up last."""
SOURCE = "f4x_source"
"""Property of the root of a sequence of splat files: its first file. A scene's root has `f4x_path` instead."""
VIEW_TRANSFORM = "Standard"
"""The core's picture is display-referred: Standard undoes the linear light of the pass and changes nothing else."""
LEFT = "Left as they are: "
"""Beginning of the sentence about settings that an import has left."""
DEFAULT_OBJECTS = {"Cube", "Light", "Camera"}
"""Objects of Blender's default file."""
SAME_RATE = 1e-4
"""Largest difference of two rates that are the same but for rounding."""
DEFAULT_CAMERA_LOCATION = (7.3589, -6.9258, 4.9583)
"""Location of the default file's camera; a camera elsewhere was placed by a person."""


@dataclass(frozen=True)
class ClipSettings:
    """Settings of a Blender scene by a clip; `None` leaves Blender's own value."""

    size: tuple[int, int] | None
    """Width and height in pixels."""
    pixel_aspect: float
    """Width of a pixel by its height."""
    fps: float | None
    """Frames per second."""
    frames: tuple[int, int] | None
    """First and last frame."""

    @classmethod
    def of(cls, opened: Scene | SplatSequence, foreign: bool) -> ClipSettings:
        """Return the settings of a scene or sequence; a still has no rate and no frames, a `foreign` one no picture size either."""
        cameras, moves = opened.cameras, len(opened.cameras) > 1
        return cls(
            size=None if foreign and not moves else (cameras.width, cameras.height),
            # focal lengths that differ between x and y are pixels that are not square
            pixel_aspect=float(cameras.intrinsics[0, 1, 1] / cameras.intrinsics[0, 0, 0]),
            fps=float(opened.fps) if moves else None,
            frames=(int(cameras.times[0]), int(cameras.times[-1])) if moves else None,
        )

    @classmethod
    def read(cls, camera: bpy.types.Object) -> ClipSettings:
        """Return the settings that `remember` stored with `camera`."""
        values = json.loads(camera[CLIP])
        pairs = {name: values[name] and tuple(values[name]) for name in ("size", "frames")}
        return cls(pixel_aspect=values["pixel_aspect"], fps=values["fps"], **pairs)

    def remember(self, camera: bpy.types.Object) -> None:
        """Store the settings with the imported camera."""
        camera[CLIP] = json.dumps(asdict(self))


def clip_camera(root: bpy.types.Object) -> bpy.types.Object | None:
    """Return the camera that import made for `root`; None where it was deleted."""
    return next((item for item in root.children if item.type == "CAMERA" and CLIP in item), None)


def is_under_way(target: bpy.types.Scene) -> bool:
    """Return True if `target` is a project whose settings an import must not change."""
    if bpy.data.is_saved or any(PATH in item or SOURCE in item for item in target.objects):
        return True
    before = target.get(SET_UP)
    if before is not None:  # the scene that the settings were made for is gone again
        return json.loads(before) != _settings(target)
    camera = target.camera
    moved = camera is not None and (
        camera.animation_data is not None
        or max(abs(a - b) for a, b in zip(camera.location, DEFAULT_CAMERA_LOCATION, strict=True)) > 1e-3
    )
    return moved or {item.name for item in target.objects} - DEFAULT_OBJECTS != set() or not _is_default(target)


def set_up(target: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Make `target` look through an imported `camera`, at its clip's size, rate and frames."""
    clip, render, timing = ClipSettings.read(camera), target.render, _timing_at_its_rate(target, camera)
    target.camera = camera
    if clip.size is not None:
        render.resolution_x, render.resolution_y = clip.size
        render.resolution_percentage = 100
        render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, clip.pixel_aspect), max(1.0, 1 / clip.pixel_aspect)
    if clip.fps is not None:
        render.fps = max(1, round(clip.fps))
        render.fps_base = render.fps / clip.fps
    target.view_settings.view_transform = VIEW_TRANSFORM
    render.dither_intensity = 0.0  # the saved picture is then the core's
    # a frame is the same file whoever renders it, and whenever: what a farm leaves can be compared
    render.use_stamp_date = render.use_stamp_render_time = render.use_stamp_memory = render.use_stamp_hostname = False
    if clip.frames is not None:
        if timing != timing_of(camera.parent):
            place(camera.parent, timing.start, timing.rate)
        target.frame_start, target.frame_end = _frames_of(clip, timing)
        target.frame_set(target.frame_start)
    target[SET_UP] = json.dumps(_settings(target))


def was_set_up(camera: bpy.types.Object) -> str:
    """Return a sentence that names what `set_up` has changed."""
    clip = ClipSettings.read(camera)
    size, frames = clip.size and _size_text(*clip.size), _frames_of(clip, timing_of(camera.parent))
    frames = frames and f"frames {_frames_text(*frames)}"
    rate = clip.fps and f"{clip.fps:.6g} fps"
    done = [part for part in (size, rate, frames) if part]
    return f"Set up: {', '.join([*done, 'camera', f'view {VIEW_TRANSFORM}'])}"


def left_as_is(target: bpy.types.Scene, camera: bpy.types.Object) -> str:
    """Return a sentence that names the settings of `target` that differ from the clip's of `camera`; nothing where none does."""
    clip, render, left = ClipSettings.read(camera), target.render, []
    size, fps = (render.resolution_x, render.resolution_y), render.fps / render.fps_base
    frames, transform = (target.frame_start, target.frame_end), target.view_settings.view_transform
    if clip.size not in (None, size):
        left.append(f"size {_size_text(*size)} (clip: {_size_text(*clip.size)})")
    if clip.fps is not None and abs(clip.fps - fps) > 1e-3:
        left.append(f"rate {fps:.6g} fps (clip: {clip.fps:.6g})")
    wanted = _frames_of(clip, _timing_at_its_rate(target, camera))
    if wanted not in (None, frames):
        left.append(f"frames {_frames_text(*frames)} (clip: {_frames_text(*wanted)})")
    if target.camera != camera:
        left.append(f"camera {target.camera.name!r}" if target.camera else "no camera")
    if transform != VIEW_TRANSFORM:
        left.append(f"view transform {transform}")
    return f"{LEFT}{', '.join(left)}; Set Up Render takes the clip's" if left else ""


def _timing_at_its_rate(target: bpy.types.Scene, camera: bpy.types.Object) -> Timing:
    """Return the timing of an imported `camera` once `target` has its clip's rate: its own pace is Speed 1 then."""
    clip, timing = ClipSettings.read(camera), timing_of(camera.parent)
    own_pace = clip.fps is not None and abs(timing.rate - rate_between(clip.fps, target)) < SAME_RATE
    return replace(timing, rate=1.0) if own_pace else timing


def _frames_of(clip: ClipSettings, timing: Timing) -> tuple[int, int] | None:
    """Return the frames of the timeline at which a clip begins and ends; None for a still."""
    if clip.frames is None:
        return None
    first, last = timing.frames_of(np.array(clip.frames))
    return round(float(first)), round(float(last))


def _size_text(width: int, height: int) -> str:
    return f"{width} x {height}"


def _frames_text(first: int, last: int) -> str:
    return f"{first}-{last}"


def _settings(target: bpy.types.Scene) -> dict[str, Any]:
    """Return the settings that `set_up` changes, by name."""
    render = target.render
    found = {name: getattr(render, name) for name in ("resolution_x", "resolution_y", "resolution_percentage", "fps")}
    found |= {name: round(getattr(render, name), 6) for name in ("fps_base", "pixel_aspect_x", "pixel_aspect_y")}
    return found | {
        "frames": [target.frame_start, target.frame_end],
        "view_transform": target.view_settings.view_transform,
    }


def _is_default(target: bpy.types.Scene) -> bool:
    """Return True if the render settings are those of a new Blender scene."""
    render, view = target.render, target.view_settings
    names = ("resolution_x", "resolution_y", "resolution_percentage", "fps", "fps_base")
    names += ("pixel_aspect_x", "pixel_aspect_y")
    same = all(getattr(render, name) == render.bl_rna.properties[name].default for name in names)
    same &= (target.frame_start, target.frame_end) == (1, 250)
    return same and view.view_transform in ("AgX", "Filmic", VIEW_TRANSFORM)
