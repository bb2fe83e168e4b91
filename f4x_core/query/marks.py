"""What a user marks on the clip's pictures: points, boxes, brush strokes, lassos and masks, checked. Needs numpy alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import F4xError
from .decoder_prompt import Prompt, check_frame
from .shapes import Polygon, Rectangle, Shape, Stroke

DOT = 0.006
"""Radius of a point, in widths of the picture: what a hand with a mouse means."""


@dataclass(frozen=True, eq=False)
class Mark:
    """A mark on one frame of the clip; pixels are those of the clip's pictures, their centres at +0.5."""

    frame: int
    """Clip frame."""
    on: bool = True
    """The thing is there; False: what is marked is not meant."""

    around = False
    """Drawn around the thing, so that what lies outside is none of it; else drawn on it."""
    exact = False
    """Most of what is marked belongs to the thing, not only some of it."""

    def pixels(self, size: tuple[int, int]) -> np.ndarray:
        """Return the marked pixels (H,W) bool of a picture of `size` (H, W). F4xError: none is marked."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Point(Mark):
    """A click."""

    at: ArrayLike = (0.0, 0.0)
    """x, y in pixels."""

    def pixels(self, size: tuple[int, int]) -> np.ndarray:
        """Return a dot (H,W) bool. F4xError: a point outside the picture."""
        x, y = np.asarray(self.at, float).reshape(2)
        if not (0 <= x < size[1] and 0 <= y < size[0]):
            raise F4xError(f"Point ({x:g}, {y:g}) lies outside the picture of {size[1]} x {size[0]} pixels.")
        return _marked(Stroke([(x, y)], max(1.0, DOT * size[1])), size)


@dataclass(frozen=True, eq=False)
class Box(Mark):
    """A box around the thing."""

    corners: ArrayLike = (0.0, 0.0, 0.0, 0.0)
    """Left, top, right, bottom in pixels."""
    around = True

    def pixels(self, size: tuple[int, int]) -> np.ndarray:
        """Return the inside (H,W) bool. F4xError: corners in another order, or a box outside the picture."""
        corners = np.asarray(self.corners, float).reshape(-1)
        if corners.shape != (4,) or not (corners[:2] < corners[2:]).all():
            raise F4xError(
                f"A box is left, top, right, bottom with left < right and top < bottom; got {corners.tolist()}."
            )
        left, top, right, bottom = corners.tolist()
        return _some(_marked(Rectangle((left, top), (right, bottom)), size), f"The box {corners.tolist()}", size)


@dataclass(frozen=True, eq=False)
class Brush(Mark):
    """A stroke painted on the thing, or on what is not meant."""

    path: ArrayLike = ()
    """(n,2) x, y in pixels along the stroke."""
    radius: float = 0.0
    """Half the width of the stroke in pixels; at least that of a point."""
    exact = True

    def pixels(self, size: tuple[int, int]) -> np.ndarray:
        """Return the pixels (H,W) bool that the stroke covers. F4xError: no path, or one outside the picture."""
        path = _path(self.path, 1, "A brush stroke")
        stroke = Stroke(path.tolist(), max(1.0, DOT * size[1], float(self.radius)))
        return _some(_marked(stroke, size), "The brush stroke", size)


@dataclass(frozen=True, eq=False)
class Lasso(Mark):
    """A loose line around the thing; it closes by itself."""

    outline: ArrayLike = ()
    """(n,2) x, y in pixels along the line."""
    around = True

    def pixels(self, size: tuple[int, int]) -> np.ndarray:
        """Return the inside (H,W) bool. F4xError: fewer than three corners, or a line outside the picture."""
        outline = Polygon(_path(self.outline, 3, "A lasso").tolist())
        return _some(_marked(outline, size), "The lasso", size)


@dataclass(frozen=True, eq=False)
class Mask(Mark):
    """The thing's pixels, drawn elsewhere."""

    mask: ArrayLike = ()
    """(H,W) bool or numbers, above 0 on the thing, at the size of the clip's pictures."""
    around = True
    exact = True

    def pixels(self, size: tuple[int, int]) -> np.ndarray:
        """Return the mask (H,W) bool. F4xError: another size, or an empty one."""
        mask = np.asarray(self.mask) > 0
        if mask.shape != size:
            raise F4xError(f"The mask has shape {mask.shape}, the pictures are {size[0]} rows x {size[1]} columns.")
        if not mask.any():
            raise F4xError("The mask is empty: mark at least one pixel.")
        return mask


def check_marks(marks: Iterable[Mark], frames: int) -> list[Mark]:
    """Return `marks` as a list; F4xError where none is on the thing, or one lies outside the clip of so many `frames`."""
    found = list(marks)
    for mark in found:
        check_frame(mark.frame, frames)
    if not any(mark.on for mark in found):
        raise F4xError("Nothing says where the thing is; give a point, a box, a brush stroke, a lasso or a mask on it.")
    return found


def marks_of(frame: int, prompt: Prompt) -> list[Mark]:
    """Return the marks of a decoder's prompt on clip frame `frame`."""
    marks: list[Mark] = [Point(frame, bool(on), at) for at, on in zip(prompt.points, prompt.labels, strict=True)]
    if prompt.box is not None:
        marks.append(Box(frame, True, prompt.box))
    if prompt.mask is not None:
        marks.append(Mask(frame, True, prompt.mask))
    return marks


def _path(points: ArrayLike, least: int, what: str) -> np.ndarray:
    """Return `points` as (n,2) float64; F4xError for fewer than `least` points or numbers that are not finite."""
    path = np.asarray(points, float)
    if path.ndim != 2 or path.shape[1] != 2 or len(path) < least or not np.isfinite(path).all():
        raise F4xError(f"{what} is at least {least} points x, y in pixels; got an array of shape {path.shape}.")
    return path


def _some(pixels: np.ndarray, what: str, size: tuple[int, int]) -> np.ndarray:
    """Return `pixels`; F4xError where none is marked."""
    if not pixels.any():
        raise F4xError(f"{what} marks no pixel of the picture of {size[1]} x {size[0]} pixels.")
    return pixels


def _marked(shape: Shape, size: tuple[int, int]) -> np.ndarray:
    """Return the pixels (H,W) bool whose centre lies in the shape."""
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    return shape.contains(np.stack([columns.ravel(), rows.ravel()], 1)).reshape(size)
