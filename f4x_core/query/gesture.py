"""What a gesture over a view selects: box, lasso, brush stroke or sphere, through everything or what is seen. Needs numpy alone.

Gestures are in pixels of the view, x right and y down, as cameras are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import F4xError
from ..geometry.camera import Camera
from ..scene import Scene
from ..scene.clouds import Cloud, fitted_config
from .blend_weights import Look, seen_sums
from .marks import Mark
from .not_deleted import not_deleted
from .pixels import SHOWN, coverage_image
from .prompts import select_by_evidence
from .score import THRESHOLD
from .selection import Selection, fingerprint
from .shapes import Shape

SEEN = 0.1
"""Fraction of a Gaussian's light that has to reach the camera for it to count as seen: behind one solid surface hardly any is
left, while the Gaussians of the surface itself share its light in a few layers."""
COLUMNS = 640
"""Width in pixels, at most, of the picture in which is looked what is seen; Gaussians are many pixels wide or many in number."""


@dataclass(frozen=True, eq=False)
class View:
    """View of a scene in which a gesture is made."""

    camera: Camera
    """In the world."""
    time: float
    """Clip time."""
    near: float = 0.0
    """Depth from which on the camera sees, world units."""
    to_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    """(4,4) affine: where the scene stands in the world."""
    perspective: bool = True
    """True if the camera is a pinhole near the scene, so that Gaussians look as wide as they were fitted."""
    hidden: np.ndarray | None = None
    """(N,) bool: Gaussians that the view does not show; None = it shows all."""


def select_by_gesture(
    scene: Scene, view: View, shape: Shape, *, through: bool = False, backend: str = "auto"
) -> Selection:
    """Select the Gaussians in a shape drawn over a view of a scene, moving ones where they are at the view's time.

    `through`: all whose centres lie in the shape, however deep. Otherwise those that are seen (`SEEN`); their scores are the
    fractions of what is seen of them that lies in the shape. Neither deleted nor hidden Gaussians are selected.
    """
    cloud = _in_world(scene, view)
    if through:
        pixels, depth = view.camera.project(cloud.means.astype(np.float64))
        scores = (depth > view.near) & shape.contains(pixels)
    else:
        scores = _seen_inside(cloud, view, shape, backend)
    return _selection(scene, view, scores)


def select_by_sphere(scene: Scene, view: View, centre: Sequence[float], radius: float) -> Selection:
    """Select the Gaussians within `radius` of `centre (3,)`, in the world, at the view's time; F4xError without a radius."""
    if radius <= 0:
        raise F4xError("A sphere needs a radius above 0.")
    away: np.ndarray = _in_world(scene, view).means - np.asarray(centre, np.float64)
    return _selection(scene, view, (away**2).sum(1) <= radius**2)


@dataclass(frozen=True, eq=False)
class _Covered(Mark):
    """Pixels of the clip that marked Gaussians cover."""

    covered: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    """(H,W) bool."""
    around: bool = False
    exact: bool = False

    def pixels(self, size: tuple[int, int]) -> np.ndarray:
        """Return the covered pixels (H,W) bool."""
        return self.covered


def select_thing(scene: Scene, found: Selection, frame: int, *, around: bool) -> Selection:
    """Select the thing that a gesture's Gaussians `found` show, as marks on the clip's frame (`prompts.select_by_evidence`).

    `around`: the gesture went around the thing; else it was drawn on it. F4xError where the clip's camera does not see them.
    """
    cameras = scene.cameras
    covered = coverage_image(scene, found, cameras[frame], float(cameras.times[frame])) > SHOWN
    if not covered.any():
        raise F4xError("The clip's camera does not see what is marked in this frame; choose another frame or place.")
    return select_by_evidence(scene, [_Covered(frame, True, covered, around, not around)])


def _in_world(scene: Scene, view: View) -> Cloud:
    cloud = replace(Cloud.of_scene(scene, view.time), to_world=np.asarray(view.to_world, np.float64)).seen_from(
        np.eye(4)
    )
    opacities = cloud.opacities if view.hidden is None else np.where(view.hidden, 0, cloud.opacities)
    return replace(cloud, opacities=opacities, fitted_focal=cloud.fitted_focal if view.perspective else None)


def _seen_inside(cloud: Cloud, view: View, shape: Shape, backend: str) -> np.ndarray:
    """Return the fraction (N,) of what the view shows of each Gaussian that lies in the shape; 0 where hardly any is seen."""
    scale = min(1.0, COLUMNS / view.camera.width)
    size = (max(1, round(view.camera.width * scale)), max(1, round(view.camera.height * scale)))
    camera = view.camera.resized(*size)
    config = replace(fitted_config([cloud], camera), near=max(view.near, 1e-6))
    pixels = camera.pixel_grid().reshape(-1, 2) * (view.camera.width / size[0], view.camera.height / size[1])
    inside = shape.contains(pixels).reshape(size[1], size[0])
    layers = np.stack([inside, np.ones_like(inside)], -1).astype(np.float32)
    sums, seen = seen_sums(Look(cloud.shape, camera, config, backend), layers, SEEN)
    return np.clip(np.divide(sums[:, 0], sums[:, 1], out=np.zeros(len(sums)), where=seen), 0, 1)


def _selection(scene: Scene, view: View, scores: np.ndarray) -> Selection:
    rows = not_deleted(scene) if view.hidden is None else not_deleted(scene) & ~view.hidden
    wins = np.zeros(len(scores), bool)
    return Selection(scene.ids, scores.astype(float), wins, THRESHOLD, None, "", fingerprint(scene)).among(rows)
