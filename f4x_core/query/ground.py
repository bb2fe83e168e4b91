"""The floor that a scene stands on: the largest flat surface below the rest of it. Needs numpy alone."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ..errors import F4xError
from ..geometry.camera import CameraPath
from ..scene import Scene
from ..scene.passes import shortest_axes
from .labels import no_teacher_knows

SOLID = 0.3
"""Opacity from which a Gaussian counts as a part of a surface."""
SAMPLED = 6000
"""Gaussians at most by which planes are tried, drawn by the area that they cover."""
TRIED = 1500
"""Planes that are tried."""
NEAREST = 0.1
"""Least distance from the cameras, by the median, that is reckoned with."""
BACKDROP = 8.0
"""Distance from the cameras, by the median, beyond which all is backdrop: a dome of sky goes on below the floor."""
THICKNESS = 0.02
"""Distance from a plane, by the scene's size, within which a Gaussian lies in it."""
TILT = 45.0
"""Degrees at most between the floor's normal and up in the clip's pictures: people hold cameras upright."""
MAX_BELOW = 0.15
"""Fraction of what is seen that may lie below its floor: reflections, noise, a step."""
MIN_FLOOR = 0.08
"""Fraction of what is seen that a floor has at least."""
MIN_PEAK = 1.4
"""Least ratio of what lies in a floor to what lies in as thick a layer above it: the lower side of a random cloud has 1.0, the
weakest of six fitted scenes with a floor 2.05."""
LEANS = 3.0
"""Degrees that a floor leans sideways in the clip's pictures from which the message says so."""
MIN_ANGLE = 0.02
"""Sine of the angle at a point, from which on three points tell a plane."""
REFINED = 4
"""Times that a plane is fitted to what lies in it."""
GROUND = "ground"
"""The word for the floor, whatever it is made of."""
GROUND_WORDS = re.compile(r"(?:the )?(?:ground|floor)", re.IGNORECASE)
"""Names of the floor as a whole; that it is grass or a road, its shape does not tell."""
UNEVEN = 2.0
"""Height of the ground's own Gaussians from its plane, in `THICKNESS`: it is less even than the part that tells the plane."""
LEVEL = 0.5
"""Least cosine of the angle between the ground's normal and that of a Gaussian of it: feet of walls are as low and upright."""
FLAT = 0.5
"""Largest ratio of a Gaussian's least axis to its middle one at which it has a normal."""


@dataclass(frozen=True, eq=False)
class Plane:
    """The points x with normal . x = distance."""

    normal: np.ndarray
    """(3,) float64 unit vector; of a floor it points up."""
    distance: float

    def height(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance (n,) of `points (n,3)` above the plane."""
        return points @ self.normal - self.distance


def up_of(cameras: CameraPath) -> np.ndarray:
    """Return the mean up direction (3,) of the pictures, which are taken for upright."""
    down = cameras.mean_down
    return -down if np.linalg.norm(down) > 0.5 else -cameras.world_to_camera[0, 1, :3]  # 0 where they cancel out


def leaning(cameras: CameraPath, floor: Plane) -> float:
    """Return the degrees by which a floor leans sideways in the pictures: people hold cameras upright, but streets slope."""
    right, up = cameras.world_to_camera[:, 0, :3].mean(0), up_of(cameras)
    return abs(float(np.degrees(np.arctan2(floor.normal @ right, floor.normal @ up))))


def plane_through(points: np.ndarray, above: np.ndarray) -> Plane:
    """Return the plane through `points (3,3)`, its normal toward the point `above (3,)`. F4xError if they are on a line."""
    a, b, c = np.asarray(points, np.float64)
    normal = np.cross(b - a, c - a)
    sides = float(np.linalg.norm(b - a) * np.linalg.norm(c - a))
    if not np.linalg.norm(normal) > MIN_ANGLE * sides:
        raise F4xError("The three points are nearly on one line; choose points that are farther apart.")
    normal /= np.linalg.norm(normal)
    normal = normal if normal @ (np.asarray(above) - a) >= 0 else -normal
    return Plane(normal, float(normal @ a))


def find_ground(scene: Scene) -> Plane:
    """Return the floor, its normal up: a plane that many Gaussians lie in and few below, not tilted beyond `TILT`.

    Raises F4xError where there is none.
    """
    return _ground_and_size(scene)[0]


def _ground_and_size(scene: Scene) -> tuple[Plane, float]:
    """Return `find_ground` and the size of the scene (`_surface`)."""
    points, area, size = _surface(scene)
    up = up_of(scene.cameras)
    random = np.random.default_rng(0)
    chosen = random.choice(len(points), min(SAMPLED, len(points)), p=area / area.sum())
    sample = points[chosen]
    tolerance = THICKNESS * size
    best, score = None, 0.0
    for a, b, c in sample[random.integers(0, len(sample), (TRIED, 3))]:
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-12 or abs(normal @ up) < np.cos(np.radians(TILT)) * length:
            continue
        normal *= np.sign(normal @ up) / length
        plane = Plane(normal, float(normal @ a))
        height = plane.height(sample)
        within, below = (np.abs(height) < tolerance).mean(), (height < -2 * tolerance).mean()
        value = within * (1 - below / MAX_BELOW) * (normal @ up) ** 2
        if value > score:
            best, score = plane, value
    if best is None or score < MIN_FLOOR / 2:
        raise F4xError(f"No floor was found in {scene.name}; place three points on it instead.")
    plane = _refined(best, points, area, tolerance)
    height = plane.height(points)
    within = area[np.abs(height) < tolerance].sum()
    above = area[(height >= tolerance) & (height < 3 * tolerance)].sum()
    if within < MIN_FLOOR * area.sum() or within < MIN_PEAK * above:
        raise F4xError(f"No floor was found in {scene.name}; place three points on it instead.")
    return plane, size


def is_of_ground(scene: Scene, label: str) -> bool:
    """Return True if `label` means the ground, and no teacher of the scene knows that word: then its shape tells."""
    return GROUND_WORDS.fullmatch(label.strip()) is not None and no_teacher_knows(scene, label)


def ground_scores(scene: Scene) -> np.ndarray:
    """Return (N,) float64: 1 for the static Gaussians of the floor, 0 for all others.

    Raises F4xError where there is no floor.
    """
    try:
        plane, size = _ground_and_size(scene)
    except F4xError:
        raise F4xError(
            f"In the scene '{scene.name}' no ground was found: no large level surface lies below the rest; click on the ground or"
            " draw a box around it."
        ) from None
    static = scene.static
    least, middle, _ = np.sort(static.scales, axis=1).T
    upright = (least < FLAT * middle) & (abs(shortest_axes(static.quats, static.scales) @ plane.normal) < LEVEL)
    scores = np.zeros(len(scene.ids))
    scores[: len(static)] = (abs(plane.height(static.means)) < UNEVEN * THICKNESS * size) & ~upright
    return scores


def _refined(plane: Plane, points: np.ndarray, area: np.ndarray, tolerance: float) -> Plane:
    for _ in range(REFINED):
        inside = np.abs(plane.height(points)) < tolerance
        weight = area[inside] / area[inside].sum()
        middle = weight @ points[inside]
        spread = points[inside] - middle
        normal = np.linalg.eigh((weight[:, None] * spread).T @ spread)[1][:, 0]
        normal *= np.sign(normal @ plane.normal) or 1.0
        plane = Plane(normal, float(normal @ middle))
    return plane


def _surface(scene: Scene) -> tuple[np.ndarray, np.ndarray, float]:
    """Return (points (n,3), weight (n,), size) of the solid static Gaussians; F4xError where there are none.

    The weight is the area by the square of the distance from the cameras: a far backdrop counts as it is seen. The size is
    the distance within which half of that lies.
    """
    static, opacities = scene.static, scene.full_appearance[0][: len(scene.static)]
    solid = opacities >= SOLID
    if solid.sum() < 3:
        raise F4xError(f"No floor was found in {scene.name}; place three points on it instead.")
    points, scales = static.means[solid].astype(np.float64), np.sort(static.scales[solid].astype(np.float64), axis=1)
    away = np.linalg.norm(points - np.median(scene.cameras.centers, axis=0), axis=1)
    near = away < BACKDROP * np.median(away)
    points, scales, away, opacities = points[near], scales[near], away[near], opacities[solid][near]
    weight = scales[:, 1] * scales[:, 2] * opacities / np.maximum(away, NEAREST * np.median(away)) ** 2
    weight = np.minimum(weight, np.percentile(weight, 99)) + 1e-30
    order = np.argsort(away)
    half = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
    return points, weight, float(away[order[min(half, len(order) - 1)]])
