"""Standard ways to look at a 4D scene: which camera at which time, one view per output frame."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from . import pose, quaternion
from .camera import Camera, CameraPath

SMOOTH = 8.0
"""Standard deviation (frames) of the Gaussian that a stabilised camera is smoothed by: a third of a second at 24 frames/s, slower
than a hand trembles and a walker steps."""
BULLET = 48
"""Views of a frozen moment: two seconds at 24 frames/s."""


class View(NamedTuple):
    """One output frame: where to look from, and at which moment of the scene."""

    camera: Camera
    time: float


Trajectory = list[View]


def cameras_of(views: Trajectory) -> CameraPath:
    """Return the cameras of views of one size, their numbers as times."""
    first = views[0].camera
    intrinsics = np.stack([view.camera.intrinsics for view in views])
    matrices = np.stack([view.camera.world_to_camera for view in views])
    return CameraPath(intrinsics, matrices, np.arange(len(views), dtype=float), first.width, first.height)


def original(path: CameraPath) -> Trajectory:
    """Return the clip itself: its cameras at their own times."""
    return [View(path[i], float(time)) for i, time in enumerate(path.times)]


def frozen(path: CameraPath, time: float) -> Trajectory:
    """Return a frozen moment: the scene stands still at `time` while the camera goes its original way."""
    return [View(path[i], float(time)) for i in range(len(path))]


def orbit(
    path: CameraPath,
    time: float | None = None,
    degrees: float = 5.0,
    depth: float = 1.0,
    around: float | None = None,
    count: int | None = None,
) -> Trajectory:
    """Return one small circle of the camera, always looking at the scene's centre.

    `degrees`: how far the circle is seen from its middle camera, at the scene's centre (radius = tan(degrees) depth).
    `depth`: distance of that centre in front of the middle camera, world units; 1 is the median scene depth.
    `around`: time of the middle camera; the middle of the clip when None.
    `time`: the moment the scene is frozen at; the scene plays when None.
    `count`: number of views, spread over the clip; one per camera of `path` when None.
    """
    middle = path.at(float(path.times[len(path) // 2]) if around is None else around)
    count = len(path) if count is None else count
    moments = np.linspace(path.times[0], path.times[-1], count) if time is None else np.full(count, float(time))
    right, down, forward = middle.world_to_camera[:3, :3]
    target = middle.center + depth * forward
    radius = depth * np.tan(np.radians(degrees))
    views = []
    for moment, angle in zip(moments, np.arange(count) * 2 * np.pi / max(count, 1), strict=True):
        center = middle.center + radius * (np.cos(angle) * right + np.sin(angle) * down)
        views.append(View(_looking_at(middle, center, target), float(moment)))
    return views


def stabilised(path: CameraPath, frames: float = SMOOTH) -> Trajectory:
    """Return the clip seen by a calm hand: the camera's centre, turn and lens smoothed over `frames` (standard deviation).

    The smoothed turn is the normalised mean of quaternions, for neighbours differ little.
    """
    distance = (path.times[:, None] - path.times) / frames
    weights = np.exp(-0.5 * distance**2)
    # a mirrored pair on the other side of every camera that has one: at the ends the mean does not lean inwards
    weights *= np.abs(distance) * frames <= np.minimum(path.times - path.times[0], path.times[-1] - path.times)[:, None]
    weights[weights.sum(1) == 0] = np.eye(len(path))[weights.sum(1) == 0]
    weights /= weights.sum(1, keepdims=True)
    turns, centers = pose.from_matrix(np.linalg.inv(path.world_to_camera))
    smooth = quaternion.normalize(weights @ quaternion.align_sequence(turns))
    matrices = pose.to_matrix(*pose.invert(smooth, weights @ centers))
    intrinsics = np.tensordot(weights, path.intrinsics, 1)
    return original(CameraPath(intrinsics, matrices, path.times, path.width, path.height))


def bullet_time(
    path: CameraPath, time: float, degrees: float = 5.0, count: int = BULLET, depth: float = 1.0
) -> Trajectory:
    """Return the clip that stops at `time` while the camera swings `degrees` to either side in `count` views, and goes on.

    `depth`: distance of the point that it swings about, world units; 1 is the median scene depth.
    """
    swing = degrees * np.sin(2 * np.pi * np.arange(1, count + 1) / (count + 1))
    stopped = [aside(path, time, right=angle, depth=depth) for angle in swing]
    views = original(path)
    return [v for v in views if v.time <= time] + stopped + [v for v in views if v.time > time]


def slow_motion(path: CameraPath, factor: float) -> Trajectory:
    """Return the clip `factor` times slower, as many times more views: motion and camera between frames are the scene's own."""
    count = round((path.times[-1] - path.times[0]) * factor) + 1
    return original(path.at_times(np.linspace(path.times[0], path.times[-1], count)))


def aside(path: CameraPath, time: float, right: float = 0.0, up: float = 0.0, depth: float = 1.0) -> View:
    """Return the camera of `time` swung about the scene's centre, still looking at it.

    `right`, `up`: degrees of the swing in the camera's own axes, `up` below 90. `depth`: distance of that centre in front of
    the camera, world units; 1 is the median scene depth.
    """
    camera = path.at(time)
    axes = camera.world_to_camera[:3, :3]  # rows: right, down, forward
    across, above = np.radians([right, up])
    back = np.array([np.sin(across) * np.cos(above), -np.sin(above), -np.cos(across) * np.cos(above)])
    target = camera.center + depth * axes[2]
    return View(_looking_at(camera, target + depth * back @ axes, target), float(time))


def read_path(file: str | Path) -> Trajectory:
    """Return the views of a JSON camera path (`CameraPath.write`): each camera at its own time."""
    return original(CameraPath.read(file))


def _looking_at(camera: Camera, center: np.ndarray, target: np.ndarray) -> Camera:
    """Return the camera moved to `center` and turned to `target`, upright as before."""
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(camera.world_to_camera[1, :3], forward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(forward, right), forward
    matrix[:3, 3] = -matrix[:3, :3] @ center
    return Camera(camera.intrinsics, matrix, camera.width, camera.height)
