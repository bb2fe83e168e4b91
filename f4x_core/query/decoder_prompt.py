"""Marks of a user on one frame - points, a box or a mask - checked. Needs numpy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import F4xError


@dataclass(frozen=True)
class Prompt:
    """Marks on one frame in pixels (pixel centres at +0.5); either points and a box, or a mask."""

    points: np.ndarray
    """(N,2) float64 x, y."""
    labels: np.ndarray
    """(N,) bool, True = on the object, False = beside it."""
    box: np.ndarray | None
    """(4,) float64 left, top, right, bottom."""
    mask: np.ndarray | None
    """(H,W) bool."""


def check_prompt(
    size: tuple[int, int],
    points: ArrayLike | None = None,
    labels: ArrayLike | None = None,
    box: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> Prompt:
    """Return the prompt on one frame of a video of `size (H, W)`; all points are positive without `labels`.

    Errors: F4xError for an empty or contradictory prompt, or a point outside the picture.
    """
    height, width = size
    if mask is not None:
        if points is not None or box is not None:
            raise F4xError("A mask is a complete prompt: give it without points and box.")
        inside = np.asarray(mask) > 0
        if inside.shape != (height, width):
            raise F4xError(f"The mask has shape {inside.shape}, the pictures are {height} rows x {width} columns.")
        if not inside.any():
            raise F4xError("The mask is empty: mark at least one pixel.")
        return Prompt(np.zeros((0, 2)), np.zeros(0, bool), None, inside)
    if points is None and box is None:
        raise F4xError("The prompt is empty: give points, a box or a mask.")
    xy = np.asarray([] if points is None else points, np.float64).reshape(-1, 2)
    positive = np.ones(len(xy), bool) if labels is None else np.asarray(labels).astype(bool).reshape(-1)
    if len(positive) != len(xy):
        raise F4xError(f"There are {len(xy)} points and {len(positive)} labels; give one label for each point.")
    if box is None and not positive.any():
        raise F4xError("The prompt names no place on the object: give at least one positive point, a box or a mask.")
    outside = ~((xy >= 0) & (xy < (width, height))).all(1)
    if outside.any():
        x, y = xy[outside][0]
        raise F4xError(f"Point ({x:g}, {y:g}) lies outside the picture of {width} x {height} pixels.")
    return Prompt(xy, positive, None if box is None else _check_box(box, width, height), None)


def check_frame(t: int, count: int) -> None:
    """Raise F4xError where the clip of `count` frames has no frame `t`."""
    if not 0 <= t < count:
        raise F4xError(f"There is no frame {t}: the clip has frames 0 to {count - 1}.")


def _check_box(box: ArrayLike, width: int, height: int) -> np.ndarray:
    corners = np.asarray(box, np.float64).reshape(-1)
    if corners.shape != (4,) or not (corners[:2] < corners[2:]).all():
        raise F4xError(f"A box is left, top, right, bottom with left < right and top < bottom; got {corners.tolist()}.")
    clipped = np.clip(corners, 0, (width, height, width, height))
    if not (clipped[:2] < clipped[2:]).all():
        raise F4xError(f"The box {corners.tolist()} lies outside the picture of {width} x {height} pixels.")
    return clipped
