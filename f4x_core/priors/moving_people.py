"""Moving people in the mask of moving objects: they count whole, and what only seems to move beside them does not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from ..parallel import in_threads
from .joints import TORSO
from .points import fit_points

if TYPE_CHECKING:
    from .folder import Priors

SHOWN = 0.5
"""Probability from which a pixel shows a person."""
MIN_MOVING = 0.5
"""Fraction of a person's pixels that must lie in the mask, mean over their frames: who only stands in a passing picture is
background."""
NEAR = 3
"""Pixels around a person that belong to them: hair, clothes, what they hold."""
AS_SURE = 0.88
"""Regions that touch people or the border stay in the mask where their motion, mean over all frames, is as sure as this fraction of
the people's: a horse is as sure as its rider (.91), walls that a walking camera passes (.82) and an audience (.86) are not."""
WALKS = 0.07
"""Error of the point in space nearest to the middle of somebody's trunk, as a fraction of their size in the picture, from which no
standing person shows it: people who walk have .075 and more, mostly no point in front of the camera, an onlooker .035."""
HIDDEN_SURE = 0.95
"""The same for single pixels in frames without a moving person: a rendered walker is lost behind a box for 13 of 36
frames (J .54 -> .82)."""


def shows_person(priors: Priors, person: int) -> np.ndarray:
    """Return (F,H,W) bool: the pixels that show a person, numbered from 1."""
    assert priors.people is not None and priors.people_probability is not None
    return (priors.people == person) & (priors.people_probability > SHOWN)


def shows_people(priors: Priors) -> np.ndarray | None:
    """Return (F,H,W) bool: the pixels that show somebody; None where nobody is known."""
    if priors.people is None or priors.people_probability is None or not priors.people.any():
        return None
    return (priors.people > 0) & (priors.people_probability > SHOWN)


def moving_people(mask: np.ndarray, priors: Priors) -> np.ndarray:
    """Return (F,H,W) bool: all pixels of the people most of whom lie in the moving `mask (F,H,W)`."""
    found = np.zeros_like(mask)
    if priors.people_joints is None:
        return found
    for person in range(1, priors.people_joints.shape[1] + 1):
        shown = shows_person(priors, person)
        size = shown.sum((1, 2))
        seen = size > 0
        if seen.any() and ((shown & mask).sum((1, 2))[seen] / size[seen]).mean() > MIN_MOVING:
            found |= shown
    return found


def walking_people(priors: Priors) -> np.ndarray:
    """Return (F,H,W) bool: all pixels of people whom no moving camera explains as standing still, however small they are."""
    assert priors.cameras is not None
    found = np.zeros((len(priors.frames), priors.height, priors.width), bool)
    if priors.people_joints is None or not priors.people_joints.size:
        return found
    joints = priors.people_joints.astype(np.float64)  # (F,M,33,3)
    seen = np.isfinite(joints).all((2, 3))
    trunk = np.nan_to_num(joints[:, :, list(TORSO), :2]).mean(2)
    off = fit_points(priors.cameras, trunk, seen).rms
    for person in np.flatnonzero(seen.any(0)):
        places = joints[seen[:, person], person, :, :2]
        size = float(np.median(np.linalg.norm(np.ptp(places, axis=1), axis=1)))
        if off[person] > WALKS * size:
            found |= shows_person(priors, int(person) + 1)
    return found


def with_people(mask: np.ndarray, motion: np.ndarray, priors: Priors) -> np.ndarray:
    """Return (F,H,W) bool: the moving `mask` with moving people whole, without doubtful regions that touch them or the border.

    motion: (F,H,W) 0..1, how surely a pixel moves; a region's is its mean over all frames.
    """
    people = moving_people(mask, priors)
    if not people.any():
        return mask
    near, touching = dilate_masks(people, NEAR), dilate_masks(people, NEAR + 1)
    touching[:, [0, -1]] = touching[:, :, [0, -1]] = True  # the border of the picture
    labels, count = ndimage.label(mask & ~near)
    size = np.maximum(np.bincount(labels.ravel(), minlength=count + 1), 1)
    mean = np.bincount(labels.ravel(), motion.ravel(), count + 1) / size
    typical = float(np.median(motion[people & mask]))
    kept = mean >= AS_SURE * typical
    beside = np.isin(np.arange(count + 1), np.unique(labels[touching]))
    kept |= ~beside
    kept[0] = False  # everything else
    # Nobody is found where somebody is half hidden: of a doubtful region stays what is as sure as people are.
    lost = (labels > 0) & (motion >= HIDDEN_SURE * typical) & ~people.any((1, 2))[:, None, None]
    return people | (mask & near) | kept[labels] | lost


def dilate_masks(masks: np.ndarray, margin: int) -> np.ndarray:
    """Return the masks (F,H,W) bool grown by a square of `margin` pixels to each side."""
    import cv2

    square = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return np.stack(in_threads(lambda mask: cv2.dilate(mask.astype(np.uint8), square) > 0, masks))
