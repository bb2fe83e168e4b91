"""Moving people in the mask of what moves: they count whole, and what passes at the border is no mover beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..parallel import in_threads

if TYPE_CHECKING:
    from .folder import Priors

SHOWN = 0.5
"""Probability from which a pixel shows a person."""
MIN_MOVING = 0.5
"""Fraction of a person's pixels that must lie in the mask, mean over their frames: who only stands in a passing picture is
background."""
NEAR = 3
"""Pixels around a person that belong to them: hair, clothes, what they hold."""
AS_SURE = 0.9
"""Regions at the border stay in the mask where their motion is as sure as this fraction of the people's: near walls that a walking
camera passes are less sure, a horse is as sure as its rider. Chosen on parkour, horsejump-high and scooter-black (J .31 -> .75,
.67 -> .67, .70 -> .72); dance-twirl .78 -> .81, breakdance .46 -> .49."""


def shows_person(priors: Priors, person: int) -> np.ndarray:
    """(F,H,W) bool: the pixels that show a person, numbered from 1."""
    assert priors.people is not None and priors.people_probability is not None
    return (priors.people == person) & (priors.people_probability > SHOWN)


def moving_people(mask: np.ndarray, priors: Priors) -> np.ndarray:
    """(F,H,W) bool: all pixels of the people most of whom lie in the moving `mask (F,H,W)`."""
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


def with_people(mask: np.ndarray, motion: np.ndarray, priors: Priors) -> np.ndarray:
    """(F,H,W) bool: the moving `mask` with moving people whole, without doubtful regions at the border.

    motion: (F,H,W) 0..1, how surely a pixel moves.
    """
    import cv2

    people = moving_people(mask, priors)
    if not people.any():
        return mask
    sure = AS_SURE * float(np.median(motion[people & mask]))
    height, width = mask.shape[1:]
    square = np.ones((2 * NEAR + 1, 2 * NEAR + 1), np.uint8)

    def refine(frame: int) -> np.ndarray:
        near = cv2.dilate(people[frame].astype(np.uint8), square) > 0
        _, labels, boxes, _ = cv2.connectedComponentsWithStats((mask[frame] & ~near).astype(np.uint8))
        left, top, wide, high, area = boxes.T
        border = (left == 0) | (top == 0) | (left + wide == width) | (top + high == height)
        mean = np.bincount(labels.ravel(), motion[frame].ravel(), len(boxes)) / np.maximum(area, 1)
        kept = ~border | (mean >= sure)
        kept[0] = False  # everything else
        return people[frame] | (mask[frame] & near) | kept[labels]

    return np.stack(in_threads(refine, range(len(mask))))
