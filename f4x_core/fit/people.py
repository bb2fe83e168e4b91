"""The person and the part of the body that each Gaussian shows, from the masks and joints of the priors. No torch."""

from __future__ import annotations

import numpy as np

from ..clip.images import resize_nearest
from ..geometry.arrays import evenly_spaced
from ..priors import Priors
from ..priors.joints import LIMBS, to_segments
from ..priors.moving_people import SHOWN
from ..raster.blend_weights import blend_weight_sums
from ..scene import MADE_UP, Scene
from ..scene.people import People, with_people

FRAMES, COLUMNS = 16, 480
"""Used frames, evenly over the clip, whose masks are lifted, and their largest width in pixels."""
MOSTLY = 0.5
"""Fraction of a Gaussian's light that falls into the mask of the person whose it is; it has to be exceeded."""
VISIBLE = 0.5
"""Visibility of both ends from which on a limb is there for pixels; hidden joints are guesses."""
LIKE_ITS_NODE = 0.5
"""Light, in pixels, that a moving Gaussian gets in addition, spread as that of all that follow its node: what shows in none of the
frames goes with what it is carried along with."""


def with_people_of(scene: Scene, priors: Priors) -> Scene:
    """Return the unedited scene with the person and the part of the body of every Gaussian stored in it, by its blend weights.

    A scene in whose clip nobody was found stays as it is.
    """
    if priors.people is None or priors.people_probability is None or not priors.people.any():
        return scene
    count = int(priors.people.max())
    light = np.zeros((len(scene.ids), count + len(LIMBS) + 1))
    for row in evenly_spaced(len(priors.frames), FRAMES):
        frame = int(priors.frames[row])
        camera = scene.cameras[frame]
        camera = camera.of_width(min(COLUMNS, camera.width))
        layers = _layers(priors, int(row), count, (camera.height, camera.width))
        light += blend_weight_sums(scene.posed(float(scene.cameras.times[frame])), camera, layers)
    light[len(scene.static) :] += _of_their_nodes(scene, light[len(scene.static) :])
    inside, parts, total = light[:, :count], light[:, count:-1], light[:, -1]
    person = np.where(inside.max(1) > MOSTLY * total, inside.argmax(1) + 1, 0)
    person[: len(scene.static)][scene.extra.get(MADE_UP, np.zeros(len(scene.static), bool))] = 0  # seen past edges
    part = np.where((person > 0) & parts.any(1), parts.argmax(1) + 1, 0)
    if not person.any():
        return scene
    return with_people(scene, People(person.astype(np.uint8), part.astype(np.uint8)))


def _of_their_nodes(scene: Scene, light: np.ndarray) -> np.ndarray:
    """Return (Nd,L): `LIKE_ITS_NODE` of light for each dynamic Gaussian, spread as the `light (Nd,L)` of all of its node."""
    if scene.scaffold is None:
        return light
    node, together = scene.dynamic.node[:, 0], np.zeros((len(scene.scaffold.ids), light.shape[1]))
    np.add.at(together, node, light)
    return LIKE_ITS_NODE * (together / np.maximum(together[:, -1:], 1e-9))[node]


def _layers(priors: Priors, row: int, count: int, size: tuple[int, int]) -> np.ndarray:
    """Return (h,w,count + parts + 1) float32 of a used frame: the mask of each person, of each part of the body, and ones."""
    assert priors.people is not None and priors.people_probability is not None
    height, width = size
    who = np.where(priors.people_probability[row] > SHOWN, priors.people[row], 0)
    who = resize_nearest(who, width, height)
    layers = np.zeros((height, width, count + len(LIMBS) + 1), np.float32)
    layers[..., -1] = 1
    scale = np.array([width / priors.width, height / priors.height])
    for person in range(1, count + 1):
        rows, columns = np.nonzero(who == person)
        layers[rows, columns, person - 1] = 1
        if len(rows) and priors.people_joints is not None:
            pixels = (np.stack([columns, rows], 1) + 0.5) / scale
            part = nearest_part(pixels, priors.people_joints[row, person - 1])
            known = part >= 0
            layers[rows[known], columns[known], count + part[known]] = 1
    return layers


def nearest_part(pixels: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(n,) int: index in `LIMBS` of the part of the body whose segments are nearest to `pixels (n,2)`; -1 where none is visible.

    `joints (33,3)`: x, y in pixels and visibility of one person.
    """
    seen = np.isfinite(joints).all(1) & (np.nan_to_num(joints[:, 2]) >= VISIBLE)
    nearest = np.full((len(LIMBS), len(pixels)), np.inf)
    for index, segments in enumerate(LIMBS.values()):
        ends = np.array([pair for pair in segments if seen[list(pair)].all()], int).reshape(-1, 2)
        if len(ends):
            nearest[index] = to_segments(pixels, joints[ends[:, 0], :2], joints[ends[:, 1], :2])[0].min(1)
    return np.where(np.isfinite(nearest).any(0), nearest.argmin(0), -1)
