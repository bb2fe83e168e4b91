"""Between OpenCV (the core) and Blender: camera axes, world axes, intrinsics."""

from collections.abc import Iterable

import bpy
import numpy as np

from ..f4x_core.geometry.camera import CameraPath

# OpenCV camera axes (x right, y down, z forward) <-> Blender camera axes (x right, y up, z backward); its own inverse.
FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])
# The scene's world (OpenCV: x right, y down, z forward) -> Blender's (x right, y forward, z up).
BLENDER_FROM_SCENE = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def intrinsics(camera: bpy.types.Camera, width: int, height: int) -> np.ndarray:
    """(3,3) float64 pinhole matrix in pixels of a Blender camera with square pixels and sensor fit HORIZONTAL."""
    focal = camera.lens / camera.sensor_width * width
    # shift is measured in sensor widths; +y is up in Blender and down in OpenCV
    return np.array(
        [
            [focal, 0.0, width / 2 - camera.shift_x * width],
            [0.0, focal, height / 2 + camera.shift_y * width],
            [0.0, 0.0, 1.0],
        ]
    )


def lens_from_intrinsics(matrices: np.ndarray, width: int, height: int, sensor_width: float) -> dict[str, np.ndarray]:
    """Blender camera settings (name -> (T,) values) of pinhole matrices `(T,3,3)`; the inverse of `intrinsics`.

    Vertical numbers are in square pixels: with fx != fy the render's pixel aspect must be fx / fy.
    """
    fx, fy = matrices[:, 0, 0], matrices[:, 1, 1]
    return {
        "lens": fx * sensor_width / width,
        "shift_x": (width / 2 - matrices[:, 0, 2]) / width,
        "shift_y": (matrices[:, 1, 2] - height / 2) * fx / fy / width,
    }


def camera_path(scene: bpy.types.Scene, camera: bpy.types.Object, times: Iterable[int]) -> CameraPath:
    """Read the animated Blender camera at `times` as an OpenCV CameraPath in Blender's world frame."""
    width, height = scene.render.resolution_x, scene.render.resolution_y
    times = np.asarray(list(times))
    matrices, poses = [], []
    for time in times:
        scene.frame_set(int(time))
        matrices.append(intrinsics(camera.data, width, height))
        poses.append(FLIP_YZ @ np.linalg.inv(np.array(camera.matrix_world)))
    return CameraPath(np.stack(matrices), np.stack(poses), times.astype(np.float64), width, height)
