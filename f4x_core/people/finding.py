"""Everyone in one picture: the whole of it, its parts for those who are far away, and what moves, whichever way is up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..priors.joints import TORSO
from .networks import Crop, Detection, Pose, box_overlap, confirm, detect, find_pose

THRESHOLD = 0.35
"""Score of a detection that is looked at; `find_pose` decides."""
PRESENCE = 0.5
"""A crop holds a person from here on."""
TILES = 0.6
"""Side of a part of the picture, in its height; parts overlap by half."""
CONFIRMED, MIN_SEED = 0.3, 0.6
"""Score of the detector, in the crop by the joints, from which a pose is a person's, and from which somebody is followed."""
EXPLAINED = 0.3
"""Moving regions are not looked at where the box of somebody's joints overlaps them by so much."""
TURNS = 8
"""Directions of "up" that are tried on what moves: whoever dances on their hands is upright for the network."""
COARSE = 2
"""Pixels between those at which masks are compared."""
SAME_MASK = 0.5
"""Two poses are one person where their masks have a larger intersection over union, whatever their joints."""
SAME_BODY = 0.3
"""Two poses are one person where the median distance of their joints is below this fraction of the body's size."""
MIN_BODY = 0.04
"""Sides of a crop below this fraction of the picture's longer side show too little."""


@dataclass(frozen=True)
class Seed:
    """Somebody found in one picture."""

    pose: Pose
    score: float
    """0..1, of the detector in the crop by the joints."""
    moves: bool = False
    """Found where something moves."""


def find_everyone(picture: np.ndarray, moving: Sequence[np.ndarray] = (), parts: bool = False) -> list[Seed]:
    """The people in `picture (H, W, 3)` uint8, the surest first.

    `moving`: boxes `(4,)` of what moves, looked at from every side. `parts`: look again in overlapping parts of the picture.
    """
    shape = picture.shape[0], picture.shape[1]
    seeds = _look(picture, _detected(picture, parts))
    for box in moving:
        if all(box_overlap(box, _joints_box(seed.pose)) < EXPLAINED for seed in seeds):
            seeds += [replace(seed, moves=True) for seed in _look(picture, _turned(box))]
    found: list[Seed] = []
    for seed in sorted(seeds, key=lambda seed: -seed.score):
        if not any(same_body(seed.pose, other.pose, shape) for other in found):
            found.append(seed)
    return found


def look_twice(picture: np.ndarray, crop: Crop) -> Pose | None:
    """The person in a crop, and again in the crop that their joints ask for; None where nobody is."""
    if not is_usable(crop, picture):
        return None
    first = find_pose(picture, crop)
    if first.presence < PRESENCE / 2 or not is_usable(first.next_crop, picture):
        return None
    second = find_pose(picture, first.next_crop)
    best = second if second.presence >= first.presence - 0.1 else first
    return best if best.presence >= PRESENCE and is_usable(best.next_crop, picture) else None


def is_usable(crop: Crop, picture: np.ndarray) -> bool:
    """Return True where a crop is large enough and has its center in the picture."""
    height, width = picture.shape[:2]
    inside = 0 <= crop.center[0] < width and 0 <= crop.center[1] < height
    return bool(inside and MIN_BODY * max(height, width) < crop.side < 4 * max(height, width))


def same_body(one: Pose, other: Pose, shape: tuple[int, int]) -> bool:
    """Return True where two poses in one picture of `shape` (H, W) are of one person."""
    apart = np.linalg.norm(one.joints - other.joints, axis=1)
    size = min(one.crop.side, other.crop.side) / 2
    if np.median(apart) < SAME_BODY * size or np.median(apart[list(TORSO)]) < SAME_BODY * size / 2:
        return True
    if np.linalg.norm(one.crop.center - other.crop.center) > max(one.crop.side, other.crop.side) / 2:
        return False
    shown, also = one.mask(*shape, COARSE) > 0.5, other.mask(*shape, COARSE) > 0.5
    return bool((shown & also).sum() > SAME_MASK * (shown | also).sum())


def _look(picture: np.ndarray, crops: Sequence[Crop]) -> list[Seed]:
    """Seeds of the people in the crops whom the detector knows, too."""
    poses = [pose for crop in crops if (pose := look_twice(picture, crop)) is not None]
    seeds = [Seed(pose, confirm(picture, pose.next_crop)) for pose in poses]
    return [seed for seed in seeds if seed.score >= MIN_SEED]


def _detected(picture: np.ndarray, parts: bool) -> list[Crop]:
    """Crops of the people that the detector sees, in the whole picture and in its parts; the surest first."""
    seen = detect(picture, THRESHOLD)
    if parts:
        height, width = picture.shape[:2]
        side = round(TILES * min(height, width))
        for top in _starts(height, side):
            for left in _starts(width, side):
                seen += [
                    _moved(one, left, top) for one in detect(picture[top : top + side, left : left + side], THRESHOLD)
                ]
    return [one.crop for one in sorted(seen, key=lambda one: -one.score)]


def _turned(box: np.ndarray) -> list[Crop]:
    """A box `(4,)` with every side up."""
    side = 1.2 * float(np.max(box[2:] - box[:2]))
    return [Crop((box[:2] + box[2:]) / 2, side, 2 * np.pi * turn / TURNS) for turn in range(TURNS)]


def _joints_box(pose: Pose) -> np.ndarray:
    """(4,) left, top, right, bottom of all joints."""
    return np.concatenate([pose.joints.min(0), pose.joints.max(0)])


def _starts(length: int, side: int) -> list[int]:
    """Starts of parts of length `side` along an edge: they overlap by half, and the last one ends at the border."""
    count = max(int(np.ceil(2 * (length - side) / side)), 0) + 1
    return np.round(np.linspace(0, max(length - side, 0), count)).astype(int).tolist()


def _moved(one: Detection, left: int, top: int) -> Detection:
    """A detection in a part of the picture, in pixels of the whole."""
    corner = np.array([left, top], np.float64)
    crop = Crop(one.crop.center + corner, one.crop.side, one.crop.angle)
    return Detection(one.score, one.box + np.tile(corner, 2), crop)
