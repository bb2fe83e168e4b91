"""The things of a scene that words are known for, and all that lies behind, in front of, beside or on one of them."""

from __future__ import annotations

import numpy as np

from ..errors import F4xError
from ..geometry.camera import Camera
from ..scene import Scene
from ..scene.people import people_of
from .connected_objects import INNER, separate_objects
from .inventory import things_there
from .not_deleted import not_deleted

MAX_SPAN = 0.8
"""A thing that takes up so much of the picture's width, or of the scene's depth, has no "left of", "behind" and so on."""
ON_TOP = 0.5
"""A thing stands on another if its base is in the upper half of that, or higher."""
NO_THING = -1


def known_things(scene: Scene, time: float) -> np.ndarray:
    """Return the number (N,) int of the thing that each Gaussian of `scene.posed(time)` is part of, or `NO_THING`.

    Things are the people of the scene, the separate objects of every word that it answers to, and what else moves. Of two words
    for a Gaussian the one that selects less counts: the cup and not the table.
    """
    posed, there = scene.posed(time), not_deleted(scene)
    owner = np.full(len(scene.ids), NO_THING)
    for selection in things_there(scene).values() if scene.features is not None else ():
        rows = np.flatnonzero(selection.chosen & there)
        if len(rows):
            owner[rows] = owner.max() + 1 + separate_objects(posed, rows)
    movers = np.flatnonzero(scene.moving & there & (owner == NO_THING))
    if len(movers):
        owner[movers] = owner.max() + 1 + separate_objects(posed, movers)
    if people := people_of(scene):
        own = (people.person > 0) & there
        owner[own] = owner.max() + people.person[own]
    numbers = np.unique(owner)
    return np.searchsorted(numbers, owner) - int(numbers[0] == NO_THING)


def is_backdrop(scene: Scene, rows: np.ndarray, time: float) -> bool:
    """Return True where the Gaussians `rows` reach over most of the picture, as a floor, a wall or a sky does."""
    camera = scene.cameras.at(time)
    pixels, depth = camera.project(scene.posed(time).means[rows])
    pixels = pixels[depth > 0]
    return len(pixels) > 0 and float(np.ptp(np.percentile(pixels[:, 0], INNER))) > MAX_SPAN * camera.width


def everything_to(scene: Scene, others: np.ndarray, where: str, time: float) -> np.ndarray:
    """Return rows (n,) of all that stands so (see `selects.Where`) to the Gaussians `others`, as the clip's camera sees it.

    Each known thing is in it or not, by its middle. Of a surface that goes through, and of what no word is known for, it holds
    the Gaussians that lie beyond the edge of the others. `above` means what stands on it. Raises F4xError where the direction
    means nothing: behind a floor that goes from here to the horizon, or "near".
    """
    if where == "near":
        raise F4xError("It is not said how near; name the things, or say for example 'everything on the table'.")
    camera, means = scene.cameras.at(time), scene.posed(time).means
    owner = known_things(scene, time)
    free = not_deleted(scene)
    free[others] = False
    if where in ("above", "below"):
        return _upon(means, owner, free, others, camera, where)
    pixels, depth = camera.project(means)
    along, whole = (depth, np.ptp(np.percentile(depth[free], INNER)) if free.any() else 0.0)
    if where in ("left", "right"):
        along, whole = pixels[:, 0], camera.width
    along = along if where in ("right", "behind") else -along
    low, high = np.percentile(along[others], INNER)
    if high - low > MAX_SPAN * whole:
        raise F4xError("That goes all through the scene, so nothing is on one side of it; name a smaller thing.")
    beyond, middle = along > high, float(np.median(along[others]))
    for thing in range(owner.max() + 1):
        rows = np.flatnonzero((owner == thing) & free)
        if not len(rows):
            continue
        first, last = np.percentile(along[rows], INNER)
        if not (first < low and last > high):
            beyond[rows] = np.median(along[rows]) > middle
    return np.flatnonzero(beyond & free)


def _upon(
    means: np.ndarray, owner: np.ndarray, free: np.ndarray, others: np.ndarray, camera: Camera, where: str
) -> np.ndarray:
    """Return rows (n,) of the known things that stand on the Gaussians `others`, or lie under them."""
    points = means @ camera.camera_to_world[:3, :3]  # right, down, forward
    low, high = np.percentile(points[others], INNER, axis=0)
    found = np.zeros(len(means), bool)
    for thing in range(owner.max() + 1):
        rows = np.flatnonzero((owner == thing) & free)
        if not len(rows):
            continue
        top, base = np.percentile(points[rows, 1], INNER)
        middle = np.median(points[rows], axis=0)
        inside = all(low[axis] <= middle[axis] <= high[axis] for axis in (0, 2))
        halfway = low[1] + ON_TOP * (high[1] - low[1])
        found[rows] = inside and (base <= halfway if where == "above" else top >= halfway)
    return np.flatnonzero(found)
