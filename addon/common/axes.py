"""Between OpenCV (the core) and Blender: camera axes, world axes, intrinsics."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import bpy
import numpy as np

from ...f4x_core.errors import F4xError
from ...f4x_core.geometry.camera import Camera, CameraPath
from ...f4x_core.scene.exposure import Lens

# OpenCV camera axes (x right, y down, z forward) <-> Blender camera axes (x right, y up, z backward); its own inverse.
FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])
# The scene's world (OpenCV: x right, y down, z forward) -> Blender's (x right, y forward, z up).
BLENDER_FROM_SCENE = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])

Vector3 = tuple[float, float, float]
FAR_AWAY = 1000.0
"""A view without perspective is drawn by a pinhole that stands back this many times half its width."""


class Eye(NamedTuple):
    """A Blender view as the core sees it."""

    camera: Camera
    """In Blender's world, OpenCV camera axes."""
    near: float
    """Depth from which on the camera sees."""
    far: float
    """Depth up to which the camera sees."""
    back: float
    """Distance of the pinhole behind the view's own plane of depth 0, world units; 0 with perspective."""


class Stereo(NamedTuple):
    """Place and lens shift of one eye of a stereo camera, from Blender."""

    to_world: np.ndarray
    """(4,4)."""
    shift_x: float
    """Shift of the lens to the right, in place of the camera's own."""


@dataclass(frozen=True, eq=False)
class SceneAxes:
    """Ways and turns along Blender's axes, and the same in the axes of a scene that is placed somewhere."""

    to_world: np.ndarray
    """(3,3) from the scene's axes and unit to Blender's."""
    turn: np.ndarray
    """(3,3) the same without scale."""

    @classmethod
    def of(cls, root: bpy.types.Object) -> SceneAxes:
        """Return the axes of the scene below `root`."""
        placed = (
            root.matrix_world if root.parent or root.constraints else root.matrix_basis
        )  # that is there before evaluation
        return cls.from_matrix(np.array(placed))

    @classmethod
    def from_matrix(cls, matrix: np.ndarray) -> SceneAxes:
        """Return the axes of a (4,4) matrix from the scene to Blender's world; noise of single precision is rounded off."""
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        scale = np.array([float(f"{each:.6g}") for each in scale]) if scale.all() else np.ones(3)
        turn = np.round(matrix[:3, :3] / scale, 6)
        return cls(turn * scale, turn * (np.sign(np.linalg.det(turn)) or 1.0))

    def way_in_scene(self, way: Iterable[float]) -> Vector3:
        """Return a way in Blender's world as one in the scene's axes and unit."""
        return _three(np.linalg.inv(self.to_world) @ np.array(tuple(way), float))

    def way_in_world(self, way: Iterable[float]) -> Vector3:
        """Return a way in the scene as one in Blender's world."""
        return _three(self.to_world @ np.array(tuple(way), float))

    def turn_in_scene(self, turn: Iterable[float]) -> Vector3:
        """Return the axis times angle of a turn in Blender's world as in the scene's axes."""
        return _three(self.turn.T @ np.array(tuple(turn), float))

    def turn_in_world(self, turn: Iterable[float]) -> Vector3:
        """Return the axis times angle of a turn in the scene's axes as in Blender's world."""
        return _three(self.turn @ np.array(tuple(turn), float))


def _three(values: np.ndarray) -> Vector3:
    x, y, z = (values + 0.0).tolist()  # no -0
    return x, y, z


def eye(projection: np.ndarray, world_to_view: np.ndarray, width: int, height: int) -> Eye:
    """Return the view of Blender's (4,4) matrices, clipping as in OpenGL, on a picture of `width` x `height` pixels."""
    p = np.asarray(projection, np.float64)
    world_to_camera = FLIP_YZ @ np.asarray(world_to_view, np.float64)
    half = np.array([width / 2, height / 2])
    if p[3, 3] == 0:  # perspective: clip coordinates are divided by depth
        back, shift = 0.0, np.array([-p[0, 2], p[1, 2]])
        near, far = p[2, 3] / (p[2, 2] - 1), p[2, 3] / (p[2, 2] + 1) if p[2, 2] != -1 else np.inf
    else:
        back, shift = FAR_AWAY / p[0, 0], np.array([p[0, 3], -p[1, 3]])
        near, far = back + (p[2, 3] + 1) / p[2, 2], back + (p[2, 3] - 1) / p[2, 2]
    world_to_camera[2, 3] += back
    focal = half * [p[0, 0], p[1, 1]] * (back or 1.0)
    centre = half * (1 + shift)
    matrix = np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])
    return Eye(Camera(matrix, world_to_camera, width, height), near, far, back)


def camera_eye(
    camera: bpy.types.Object,
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    width: int,
    height: int,
    stereo: Stereo | None = None,
) -> Eye:
    """Return a camera of the scene, as evaluated, on a picture of this many pixels; F4xError for one that is no pinhole."""
    camera, render = camera.evaluated_get(depsgraph), scene.render
    if camera.type != "CAMERA" or camera.data.type == "PANO":
        raise F4xError(f"{camera.name} is not a perspective or orthographic camera; change its type or choose another.")
    aspect = (render.pixel_aspect_x, render.pixel_aspect_y)
    projection = np.array(camera.calc_matrix_camera(depsgraph, x=width, y=height, scale_x=aspect[0], scale_y=aspect[1]))
    to_world = np.array(camera.matrix_world.normalized(), np.float64)  # a camera's own scale counts for nothing
    if stereo is not None:
        to_world = stereo.to_world / np.append(np.linalg.norm(stereo.to_world[:3], axis=0)[:3], 1)
        _shift(projection, camera.data, stereo.shift_x - camera.data.shift_x, (width * aspect[0], height * aspect[1]))
    seen = eye(projection, np.linalg.inv(to_world), width, height)
    # from the matrix, in single precision, the far end would be off by some percent
    return seen._replace(near=seen.back + camera.data.clip_start, far=seen.back + camera.data.clip_end)


def _shift(projection: np.ndarray, data: bpy.types.Camera, shift_x: float, size: tuple[float, float]) -> None:
    """Shift the picture of a camera by so much more, a fraction of the side that its sensor is fitted to."""
    fit = data.sensor_fit if data.sensor_fit != "AUTO" else ("HORIZONTAL" if size[0] >= size[1] else "VERTICAL")
    moved = 2 * shift_x * (1 if fit == "HORIZONTAL" else size[1] / size[0])
    if projection[3, 3] == 0:
        projection[0, 2] += moved
    else:
        projection[0, 3] -= moved


def camera_lens(camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph, back: float) -> Lens | None:
    """Return the lens of a camera with depth of field, sized as Cycles sizes it; None without. `back`: that of its `Eye`."""
    camera = camera.evaluated_get(depsgraph)
    data, dof = camera.data, camera.data.dof
    if not dof.use_dof:
        return None
    focus = dof.focus_distance
    if dof.focus_object is not None:
        target = dof.focus_object.evaluated_get(depsgraph).matrix_world.translation
        focus = abs((camera.matrix_world.normalized().inverted() @ target).z)
    focus = max(focus, data.clip_start)
    radius = (1.0 if data.type == "ORTHO" else data.lens * 1e-3) / (2 * dof.aperture_fstop)
    far = (back + focus) / focus  # from far away the same blur takes a larger lens
    return Lens(radius * far, back + focus, dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio)


def lens_from_intrinsics(matrices: np.ndarray, width: int, height: int, sensor_width: float) -> dict[str, np.ndarray]:
    """Return Blender's camera settings (name -> (T,) values) for pinhole matrices `(T,3,3)` and sensor fit HORIZONTAL.

    Vertical numbers are in square pixels: with fx != fy the render's pixel aspect must be fx / fy.
    """
    fx, fy = matrices[:, 0, 0], matrices[:, 1, 1]
    return {
        "lens": fx * sensor_width / width,
        "shift_x": (width / 2 - matrices[:, 0, 2]) / width,
        "shift_y": (matrices[:, 1, 2] - height / 2) * fx / fy / width,
    }


def camera_path(scene: bpy.types.Scene, camera: bpy.types.Object, times: Iterable[int]) -> CameraPath:
    """Return the animated perspective camera at Blender's frames `times` as an OpenCV CameraPath in Blender's world frame."""
    scale = scene.render.resolution_percentage / 100
    width, height = int(scene.render.resolution_x * scale), int(scene.render.resolution_y * scale)
    times = np.asarray(list(times))
    seen = []
    for time in times:
        scene.frame_set(int(time))
        seen.append(camera_eye(camera, scene, bpy.context.evaluated_depsgraph_get(), width, height).camera)
    matrices, poses = np.stack([one.intrinsics for one in seen]), np.stack([one.world_to_camera for one in seen])
    return CameraPath(matrices, poses, times.astype(np.float64), width, height)
