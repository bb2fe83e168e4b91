"""Finds upright objects on the ground in one picture: what does not look like the ground that things walk on.

As in a pop-up book (Hoiem et al., "Automatic Photo Pop-up", 2005) every column of what is not ground stands at the row of its
foot. An error stays small: a marking on the road is a run of few rows, and stands where it lies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from ..geometry.arrays import evenly_spaced

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

PLATE_FRAMES = 24
"""Frames of which the background is the median."""
COLORS, MIN_COLOR, LIGHTNESS = 6, 0.06, 0.5
"""Colors of the ground (k-means in CIE Lab), the fraction of it that one must have, and the weight of lightness (shadows)."""
COLOR_SPREAD, MIN_SPREAD = 3.0, 6.0
"""A pixel is ground within so many median distances of the ground's own pixels from their colors, or within the second."""
BELOW_FEET, NEAR_FRACTION, MIN_FOOT_HEIGHT = 5, 0.4, 12
"""Ground is known so many pixels below a moving object that is MIN_FOOT_HEIGHT high, and in this fraction of its rows."""
MIN_KNOWN, MIN_GROUND = 0.8, 0.3
"""Fractions of the known ground, and of the picture below its end, that must look like ground; else colors tell nothing."""
HOLE, NECK, MIN_FRACTION = 7, 13, 0.003
"""Holes in the ground, and necks of it, up to so many pixels across count with what is around them, and pieces of a smaller
fraction of the picture with the ground."""
BESIDE = 8
"""Columns to each side whose feet count: what bridges two wheels stands where they do."""


def feet_of_uprights(clip: Clip, priors: Priors, end: float) -> np.ndarray:
    """Return (H,W) the row of the foot of the upright object at each pixel, 0 for none, in the background of the clip.

    end: row at which the ground ends at the latest.
    """
    plate, moving = background(clip, priors)
    height, width = plate.shape[:2]
    known = np.zeros((height, width), bool)
    known[height - round(NEAR_FRACTION * (height - end)) :] = True
    for mask in moving:
        for y, x in ndimage.find_objects(ndimage.label(mask)[0]):
            if y.stop - y.start >= MIN_FOOT_HEIGHT:
                known[y.stop : y.stop + BELOW_FEET, x] = True
    known[: int(end)] = False
    ground = like_ground(plate, known)
    if not known.any() or ground[known].mean() < MIN_KNOWN or ground[int(end) :].mean() < MIN_GROUND:
        return np.zeros((height, width))
    pieces, _ = ndimage.label(~ground)
    large = np.bincount(pieces.ravel()) >= MIN_FRACTION * ground.size
    large[0] = False
    return feet_in_columns(large[pieces])


def background(clip: Clip, priors: Priors) -> tuple[np.ndarray, np.ndarray]:
    """Return (H,W,3) uint8 median of some frames where nothing moves, and the moving masks of these frames (f,H,W)."""
    chosen = evenly_spaced(len(priors.frames), PLATE_FRAMES)
    pictures = clip.frames[priors.frames[chosen]]
    moving = np.zeros(pictures.shape[:3], bool) if priors.mask is None else priors.mask[chosen]
    hidden = np.broadcast_to(moving[..., None], pictures.shape)
    plate = np.ma.median(np.ma.array(pictures, mask=hidden), axis=0).filled(0)
    never = moving.all(0)
    plate[never] = pictures[0][never]
    return plate.astype(np.uint8), moving


def like_ground(picture: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: pixels of `picture (H,W,3)` whose color is one of those of the ground, `known (H,W)`."""
    import cv2

    samples = known.sum()
    if samples < COLORS:
        return known
    lab = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_RGB2LAB), (0, 0), 1.2).astype(np.float32)
    lab *= np.array([LIGHTNESS, 1, 1], np.float32)
    own = lab[known]
    cv2.setRNGSeed(0)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.1)
    few = np.ascontiguousarray(own[:: samples // 20000 + 1])
    _, label, centers = cv2.kmeans(few, COLORS, None, stop, 3, cv2.KMEANS_PP_CENTERS)
    centers = centers[np.bincount(label.ravel(), minlength=COLORS) >= MIN_COLOR * len(few)]
    apart = np.min([np.linalg.norm(lab - center, axis=-1) for center in centers], axis=0)
    near = apart < max(COLOR_SPREAD * float(np.median(apart[known])), MIN_SPREAD)
    hole, neck = (np.ones((side, side), np.uint8) for side in (HOLE, NECK))
    closed = cv2.morphologyEx(near.astype(np.uint8), cv2.MORPH_CLOSE, hole)
    pieces, _ = ndimage.label(cv2.morphologyEx(closed, cv2.MORPH_OPEN, neck))
    counts = np.bincount(pieces[known], minlength=1)
    counts[0] = 0
    return pieces == counts.argmax() if counts.any() else known  # what looks like ground within a thing is none


def feet_in_columns(upright: np.ndarray) -> np.ndarray:
    """Return (H,W) the lowest row, + .5, of the run of `upright (H,W)` at a pixel, also of columns beside it; 0 elsewhere."""
    rows = np.arange(len(upright))[:, None]
    free = np.where(upright, len(upright), rows)  # the nearest row below that is not upright
    after = np.minimum.accumulate(free[::-1], axis=0)[::-1]
    feet = np.where(upright, after - 0.5, 0.0)
    wide = np.where(upright, ndimage.maximum_filter1d(feet, 2 * BESIDE + 1, axis=1), 0.0)
    total, count = (ndimage.uniform_filter1d(one, 2 * BESIDE + 1, axis=1) for one in (wide, upright.astype(np.float64)))
    return np.where(upright, total / np.maximum(count, 1e-9), 0.0)
