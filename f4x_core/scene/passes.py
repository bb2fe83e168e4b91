"""Values of Gaussians and of places on surfaces for the passes of a picture, in Blender's conventions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import quaternion
from ..geometry.camera import Camera
from .view import NEAR


@dataclass(frozen=True)
class Mist:
    """Fog that thickens with the distance: `((distance - start) / depth) ^ exponent`, cut to 0 .. 1 (Cycles)."""

    start: float = 0.0
    """World units; nearer than this all is clear."""
    depth: float = 2.0
    """World units from `start` to where only mist is seen; a scene's median depth is 1."""
    exponent: float = 1.0
    """Blender's falloff: 1 linear, 2 quadratic, 0.5 inverse quadratic."""
    back: float = 0.0
    """A view without perspective counts depth from a plane so far before the camera; 0 = distance from the camera's centre."""


def mist_left(mist: Mist, places: np.ndarray, camera: Camera) -> np.ndarray:
    """Return (N,) how much of `places (N,3)` in the world the mist leaves: 1 clear, 0 nothing."""
    straight = np.linalg.norm(places - camera.center, axis=-1)
    distance = np.abs(camera.project(places)[1] - mist.back) if mist.back else straight
    return 1 - np.clip((distance - mist.start) / max(mist.depth, 1e-9), 0, 1) ** mist.exponent


def shortest_axes(quats: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return (N,3) unit vectors of either sign: the shortest axes of Gaussians with `quats (N,4)` of any length, `scales (N,3)`."""
    axes = quaternion.to_matrix(quaternion.normalize(quats))
    return np.take_along_axis(axes, scales.argmin(1)[:, None, None], axis=2)[..., 0]


def normals(quats: np.ndarray, scales: np.ndarray, to_world: np.ndarray, looks: np.ndarray) -> np.ndarray:
    """Return (N,3) unit normals in the world: the shortest axis of each Gaussian, turned towards the camera.

    Args:
        quats: (N,4) wxyz, any length, in the frame of the object.
        scales: (N,3).
        to_world: (4,4) affine; normals go by the inverse transpose of its linear part.
        looks: (N,3) from the camera to each Gaussian, in the world.
    """
    turned = shortest_axes(quats, scales) @ np.linalg.inv(to_world[:3, :3])
    turned *= np.where((turned * looks).sum(1) > 0, -1, 1)[:, None]
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def vectors(
    places: np.ndarray,
    beside: tuple[np.ndarray, np.ndarray] | None,
    camera: Camera,
    cameras: tuple[Camera, Camera] | None,
) -> np.ndarray:
    """Return (N,4) motion in pixels as in Blender's pass Vector, x right and y up: XY = before - now, ZW = now - after.

    Args:
        places: (N,3) in the world, now.
        beside: (N,3) each, one frame before and one after; None = it stands still.
        camera: now.
        cameras: one frame before and one after; None = the camera stands still.

    A place that is nearer than `NEAR` to a camera's plane at either of two moments has no motion between them.
    """
    now, depth = camera.project(places)
    halves = []
    for there, view, sign in zip(beside or (places, places), cameras or (camera, camera), (1, -1), strict=True):
        pixels, far = view.project(there)
        seen = np.minimum(depth, far) > NEAR
        halves.append(np.where(seen[:, None], sign * (pixels - now), 0) * (1, -1))
    return np.concatenate(halves, 1)
