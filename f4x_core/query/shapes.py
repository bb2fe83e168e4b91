"""Shapes in a picture, by the pixels (x right, y down) that they hold: what a hand draws in a view or on a frame of the clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..errors import F4xError


class Shape(Protocol):
    """A part of a picture."""

    def contains(self, pixels: np.ndarray) -> np.ndarray:
        """Return (n,) bool: the `pixels (n,2)` in the shape."""
        ...


@dataclass(frozen=True)
class Rectangle:
    """A rectangle with sides along those of the picture."""

    corner: tuple[float, float]
    """x, y in pixels."""
    opposite: tuple[float, float]
    """x, y in pixels."""

    def contains(self, pixels: np.ndarray) -> np.ndarray:
        """Return (n,) bool: the `pixels (n,2)` in the rectangle."""
        low, high = np.minimum(self.corner, self.opposite), np.maximum(self.corner, self.opposite)
        return ((pixels >= low) & (pixels <= high)).all(1)


@dataclass(frozen=True)
class Polygon:
    """Area that a closed line encloses; where it crosses itself, the area with an odd number of turns around it."""

    outline: Sequence[tuple[float, float]]
    """x, y in pixels of at least three corners."""

    def __post_init__(self) -> None:
        """Validate."""
        if len(self.outline) < 3:
            raise F4xError("A lasso needs at least three corners; draw around what is meant.")

    def contains(self, pixels: np.ndarray) -> np.ndarray:
        """Return (n,) bool: the `pixels (n,2)` from which a ray to the right crosses the line an odd number of times."""
        corners = np.asarray(self.outline, np.float64)
        inside = np.zeros(len(pixels), bool)
        near = np.flatnonzero(((pixels >= corners.min(0)) & (pixels <= corners.max(0))).all(1))
        x, y = pixels[near].T
        odd = np.zeros(len(near), bool)
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, 0), strict=True):
            if y0 != y1:
                odd ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
        inside[near] = odd
        return inside


@dataclass(frozen=True)
class Stroke:
    """Area that a round brush has passed over."""

    path: Sequence[tuple[float, float]]
    """x, y in pixels of its centre; one point is a click."""
    radius: float
    """Pixels."""

    def __post_init__(self) -> None:
        """Validate."""
        if not len(self.path) or self.radius <= 0:
            raise F4xError("A brush needs a point to start from and a radius above 0.")

    def contains(self, pixels: np.ndarray) -> np.ndarray:
        """Return (n,) bool: the `pixels (n,2)` within the radius of the path."""
        corners = np.asarray(self.path, np.float64)
        inside = np.zeros(len(pixels), bool)
        low, high = corners.min(0) - self.radius, corners.max(0) + self.radius
        near = np.flatnonzero(((pixels >= low) & (pixels <= high)).all(1))
        for start, end in zip(corners, [*corners[1:], corners[-1]], strict=True):
            low, high = np.minimum(start, end) - self.radius, np.maximum(start, end) + self.radius
            beside = near[((pixels[near] >= low) & (pixels[near] <= high)).all(1)]
            away, along = pixels[beside] - start, end - start
            part = np.clip(away @ along / max(along @ along, 1e-12), 0, 1)
            inside[beside] |= ((away - part[:, None] * along) ** 2).sum(1) <= self.radius**2
        return inside
