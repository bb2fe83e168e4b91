"""Everyone in one picture: the detector's people, and moving objects, whichever way is up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..priors.joints import BODY, TORSO
from .networks import Crop, Detection, Pose, confirm, detect, find_pose

THRESHOLD = 0.35
"""Score of a detection that is looked at; `find_pose` decides."""
PRESENCE = 0.5
"""A crop holds a person from here on."""
TILES = 0.6
"""Side of a part of the picture, in its height; parts overlap by half."""
MAX_FAR = 1.5
"""Largest crop, in sides of a part, of somebody who is far away; the whole picture shows the others."""
MIN_CONFIRMED, MIN_STEADY = 0.6, 0.5
"""Score of the detector, in the crop by the joints, from which somebody is followed; steadiness that counts instead for a mover
who is not upright, of whom the detector knows little."""
TURNS = 12
"""Directions of "up" that are tried on moving objects: whoever dances on their hands is upright for the network."""
TURNED = 1.0
"""Radians from upright beyond which the detector knows little of somebody."""
UPRIGHT_PRESENCE, UPRIGHT_AGREEMENT = 0.9, 0.5
"""Presence and agreement with the moving region from which the first direction, upright, is the right one."""
MIN_MOVER = 0.3
"""Intersection over union with the moving region from which a pose is the mover's."""
SECOND_CROPS = ((0.4, 1.0, False), (-0.4, 1.0, True), (0.0, 0.85, False))
"""Turn (radians), size and mirroring of the crops in which a pose is looked for again."""
STEADY_JOINT = 0.06
"""Distance, in sides of the crop, up to which a joint is found again."""
COARSE = 2
"""Pixels between those at which masks are compared."""
SAME_MASK = 0.5
"""Two poses are one person where their masks have a larger intersection over union, whatever their joints."""
SAME_BODY = 0.3
"""Two poses are one person where the median distance of their joints is below this fraction of the body's size."""
MIN_BODY = 0.04
"""Sides of a crop below this fraction of the picture's longer side show too little."""


@dataclass(frozen=True, eq=False)
class Seed:
    """Somebody found in one picture."""

    pose: Pose
    score: float
    """0..1: the detector's in the crop by the joints, or the steadiness of a mover."""
    moves: bool = False
    """Found where something moves."""


def find_everyone(picture: np.ndarray, parts: bool = False) -> list[Seed]:
    """Return the people whom the detector sees in `picture (H, W, 3)` uint8, the surest first.

    `parts`: look again in overlapping parts of the picture, for those who are far away.
    """
    shape = picture.shape[0], picture.shape[1]
    poses = [pose for crop in _detected(picture, parts) if (pose := look_twice(picture, crop)) is not None]
    found: list[Seed] = []
    for seed in sorted([Seed(pose, confirm(picture, pose.next_crop)) for pose in poses], key=lambda seed: -seed.score):
        if seed.score >= MIN_CONFIRMED and not any(same_body(seed.pose, other.pose, shape) for other in found):
            found.append(seed)
    return found


def find_mover(picture: np.ndarray, region: np.ndarray, step: int) -> Seed | None:
    """Return the person who fills a moving `region (H // step, W // step)` bool, whichever way is up; None where nobody does."""
    best, best_agreement = None, MIN_MOVER
    for turn in range(TURNS):
        pose = find_pose(picture, Crop.of_region(region, step, 2 * np.pi * turn / TURNS))
        if pose.presence < PRESENCE or not is_usable(pose.next_crop, picture):
            continue
        agreement = pose.presence * _agreement(pose, region, step)
        if agreement > best_agreement:
            best, best_agreement = pose, agreement
        if turn == 0 and pose.presence >= UPRIGHT_PRESENCE and agreement >= UPRIGHT_AGREEMENT:
            break
    again = None if best is None else find_pose(picture, best.next_crop)
    if again is None or again.presence < PRESENCE or not is_usable(again.next_crop, picture):
        return None
    if again.next_crop.turn < TURNED:
        score, needed = confirm(picture, again.next_crop), MIN_CONFIRMED
    else:
        score, needed = steadiness(picture, again), MIN_STEADY
    return Seed(again, score, moves=True) if score >= needed else None


def fills(pose: Pose, region: np.ndarray, step: int) -> bool:
    """Return True where a moving `region (H // step, W // step)` bool is the person of a pose."""
    return _agreement(pose, region, step) > MIN_MOVER


def steadiness(picture: np.ndarray, pose: Pose) -> float:
    """Return the agreement 0..1 of a pose with those found in the same crop turned, mirrored and smaller.

    A body is found again, whichever way is up; swans, camels and toy trains get other joints each time.
    """
    shape, center = (picture.shape[0], picture.shape[1]), pose.next_crop
    shown = pose.mask(*shape, COARSE) > 0.5
    agreements = []
    for turn, size, mirrored in SECOND_CROPS:
        other = find_pose(picture, Crop(center.center, size * center.side, center.angle + turn, mirrored))
        also = other.mask(*shape, COARSE) > 0.5
        apart = np.linalg.norm(other.joints - pose.joints, axis=1)[list(BODY)]
        common = (shown & also).sum() / max((shown | also).sum(), 1)
        agreements.append(other.presence * common * (apart < STEADY_JOINT * center.side).mean())
    return float(np.mean(agreements))


def _agreement(pose: Pose, region: np.ndarray, step: int) -> float:
    """Return the intersection over union of a person's mask and a `region (H // step, W // step)` bool."""
    shown = pose.mask(step * region.shape[0], step * region.shape[1], step) > 0.5
    return float((shown & region).sum() / max((shown | region).sum(), 1))


def look_twice(picture: np.ndarray, crop: Crop) -> Pose | None:
    """Return the person in a crop, and again in the crop that their joints ask for; None where nobody is."""
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


def _detected(picture: np.ndarray, parts: bool) -> list[Crop]:
    """Return the crops of the people that the detector sees, in the whole picture and in its parts; the surest first."""
    seen = detect(picture, THRESHOLD)
    if parts:
        height, width = picture.shape[:2]
        side = round(TILES * min(height, width))
        for top in _starts(height, side):
            for left in _starts(width, side):
                part = detect(picture[top : top + side, left : left + side], THRESHOLD)
                seen += [_moved(one, left, top) for one in part if one.crop.side < MAX_FAR * side]
    return [one.crop for one in sorted(seen, key=lambda one: -one.score)]


def _starts(length: int, side: int) -> list[int]:
    """Return the starts of parts of length `side` along an edge: they overlap by half, and the last one ends at the border."""
    count = max(int(np.ceil(2 * (length - side) / side)), 0) + 1
    return np.round(np.linspace(0, max(length - side, 0), count)).astype(int).tolist()


def _moved(one: Detection, left: int, top: int) -> Detection:
    """Return a detection in a part of the picture, in pixels of the whole."""
    corner = np.array([left, top], np.float64)
    crop = Crop(one.crop.center + corner, one.crop.side, one.crop.angle)
    return Detection(one.score, crop)
