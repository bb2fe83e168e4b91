"""Distances of moving objects from the ground that they touch and from how their pictures grow, over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from .folder import Priors

GUESS_CONFIDENCE = 0.05
"""Largest confidence of the guessed depth of moving pixels, and of all depth in a clip without parallax."""
MOVING_CONFIDENCE = 0.2
"""Largest confidence of the guessed depth of moving pixels in a clip with parallax."""
NO_CONTACT, MIN_CONTACT_FRAMES = 0.05, 0.25
"""Weight of the surroundings' depth for a body without ground contact; fraction of frames with contact below which the body's
size gives its distance."""
CONTACT_QUANTILE = 0.7
"""Quantile over the frames of a body's contacts that gives its distance: above the middle, as it may hop, never sink in."""
GROUND_FRACTION, GROUND_NOISE = 0.2, 0.03
"""Distance below a moving region in which the ground is fitted (fraction of the image height), and unevenness of ground (relative
inverse depth)."""
MAX_SLOPE, MIN_LEVEL = np.radians(55), 0.1
"""Largest angle of ground against the camera's own level, and fraction of a mover's frames that have to see some before what is
steeper counts as no ground (8 of 36 where a box hides the feet; 2 of 90 where depth is poor)."""
AGREEING = 0.15
"""Columns whose pixels below the region agree less with the ground's plane than this have something else there."""
BEHIND_WEIGHT = 0.02
"""Weight of a ground contact behind the object's depth: an object in the air is seen in front of farther ground, never behind
nearer ground."""
MIN_CONTACT_PIXELS = 8
"""Free pixels below a moving region that a contact needs at least; else it takes the depth of its surroundings."""
SIZE_NOISE, CONTACT_NOISE, PATH_NOISE = 0.04, 0.04, 0.004
"""Relative errors of the frame-to-frame size change and of one contact depth, and usual acceleration along the view as a fraction
of the distance (per frame squared; 11 m/s^2 at five meters), used to smooth an object's depth. Chosen on people-cross, knight,
crossing and demo: error of the distance 2.18 -> 1.94 %, on nine other clips 4.95 -> 4.36 %."""
MAX_MISFIT = 0.04
"""Largest median error of a similarity, over the region's size, with which it tells how the region grows: what rolls has .13, what
bounces .09, what passes before another mover .05; what walks or turns has .005 to .036."""
MIN_OBJECT_PIXELS = 30
"""Moving regions with fewer pixels per frame than this follow the static depth around them."""
MOVING_MARGIN = 6
"""Pixels around moving regions whose flow is not trusted as static: flow bleeds over the outline of moving objects."""


@dataclass(frozen=True)
class DepthMaps:
    """Depth, its confidence and the moving mask of every pixel, each (F, H, W)."""

    inverse: np.ndarray
    """Inverse depth; written where objects move."""
    confidence: np.ndarray
    """0..1; written where objects move."""
    static_confidence: np.ndarray
    """`confidence` before anything was written."""
    moving: np.ndarray
    """bool."""


def guessed_confidence(priors: Priors, certain: float) -> float:
    """Return the confidence of an object's depth in a frame in which its contact is `certain` 0..1."""
    return MOVING_CONFIDENCE * certain if priors.camera_kind == "moving" else GUESS_CONFIDENCE


def largest_piece(own: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: the largest connected piece of the region `own (H,W)`, which touches the ground; others may be shadows."""
    import cv2

    count, labels, boxes, _ = cv2.connectedComponentsWithStats(own.astype(np.uint8))
    return own if count <= 2 else labels == 1 + int(boxes[1:, cv2.CC_STAT_AREA].argmax())


def inverse_around(inverse: np.ndarray, moving: np.ndarray, own: np.ndarray) -> float:
    """Return the median inverse depth `(H,W)` of the background around the region `own (H,W)`; without any, of the frame."""
    rim = ndimage.binary_dilation(own, iterations=2 * MOVING_MARGIN) & ~moving
    return float(np.median(inverse[rim] if rim.any() else inverse))


def one_scale(ratio: np.ndarray, trust: np.ndarray, quantile: float = CONTACT_QUANTILE) -> float:
    """Return the factor of a body's inverse depth, from what every frame's ground asks for `(f,)`, with `trust (f,)` 0..1.

    The weighted `quantile` of what frames ask for: ground behind a body that is in the air asks for less.
    """
    order = np.argsort(ratio)
    weight = np.cumsum((trust + 1e-3)[order])
    return float(ratio[order][np.searchsorted(weight, quantile * weight[-1])])


def smooth_object_depth(contact: np.ndarray, trust: np.ndarray, grown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse depth `(f,)` of one object over time, and its certainty 0..1.

    `contact (f,)` inverse depths where it touches the ground with `trust (f,)` 0..1, `grown (f - 1,)` logarithm of its
    change of picture size to the next frame (NaN = unknown). Size is inverse depth times a constant, so
    `argmin sum trust (x - log contact)^2 / c^2 + sum (x' - x - grown)^2 / s^2 + sum (x'' - 2 x' + x)^2 / a^2`, x = log
    inverse depth; Cauchy weights on the contacts, and little weight where the ground is seen behind the object
    (`BEHIND_WEIGHT`).
    """
    count, measured = len(contact), np.log(contact)
    known = np.isfinite(grown)
    step = np.where(known, grown, 0.0)
    link = np.where(known, 1 / SIZE_NOISE**2, 1 / (5 * SIZE_NOISE) ** 2)
    bend = np.diff(np.eye(count), 2, axis=0)
    laplacian = bend.T @ bend / PATH_NOISE**2
    right = np.zeros(count)
    for i in range(count - 1):
        laplacian[i : i + 2, i : i + 2] += link[i] * np.array([[1, -1], [-1, 1]])
        right[i : i + 2] += link[i] * step[i] * np.array([-1, 1])
    solution = np.full(count, np.average(measured, weights=trust + 1e-6))
    for _ in range(5):
        weight = (trust + 1e-3) / CONTACT_NOISE**2 / (1 + ((measured - solution) / (2 * CONTACT_NOISE)) ** 2)
        weight *= np.where(measured < solution, BEHIND_WEIGHT, 1.0)
        solution = np.linalg.solve(laplacian + np.diag(weight), right + weight * measured)
    return np.exp(solution), np.clip(trust, 0.25, 1.0)


@dataclass(frozen=True)
class GroundEdge:
    """The ground behind the lower edge of a region, n of its columns."""

    columns: np.ndarray
    """(n,) int."""
    run: np.ndarray
    """(n,) columns from the region's mean one."""
    ground: np.ndarray
    """(n,) inverse depth of the ground at the region's lowest pixel."""
    plane: np.ndarray
    """(3,) its inverse depth at a pixel's (1, x, y)."""
    trust: float
    """0..1."""

    def normal(self, intrinsics: np.ndarray) -> np.ndarray:
        """Return (3,) direction up from the ground in the axes of the camera with `intrinsics (3, 3)`, of any length."""
        (fx, _, cx), (_, fy, cy) = intrinsics[:2]
        return -np.array([self.plane[1] * fx, self.plane[2] * fy, self.plane @ (1, cx, cy)])


def without_upright(edges: Sequence[GroundEdge | None], intrinsics: np.ndarray) -> list[GroundEdge | None]:
    """Return the `edges` of a mover in f frames, None for those on something upright, as the side of a box, which hides its feet.

    All of them where hardly any is level: then depth is too poor to tell. intrinsics: (f, 3, 3).
    """

    def is_level(edge: GroundEdge | None, lens: np.ndarray) -> bool:
        up = np.zeros(3) if edge is None else edge.normal(lens)
        return bool(-up[1] > np.cos(MAX_SLOPE) * np.linalg.norm(up))

    level = [is_level(edge, lens) for edge, lens in zip(edges, intrinsics, strict=True)]
    if np.mean(level) < MIN_LEVEL:
        return list(edges)
    return [edge if one else None for edge, one in zip(edges, level, strict=True)]


def ground_edge(inverse: np.ndarray, confidence: np.ndarray, moving: np.ndarray, own: np.ndarray) -> GroundEdge | None:
    """Return the ground that a region is seen in front of, carried up to its lower edge; None where too little of it is seen.

    The ground is a plane, so its inverse depth is linear in the picture; it is fitted below the region, where flow is free.
    """
    height = len(own)
    columns = np.flatnonzero(own.any(0))
    bottom = height - 1 - np.argmax(own[::-1], axis=0)[columns]
    rows = np.arange(height)[:, None]
    lowest = int(bottom.max()) + MOVING_MARGIN + round(GROUND_FRACTION * height)
    ground = (rows > bottom + MOVING_MARGIN) & (rows <= lowest) & ~moving[:, columns]
    y, which = np.nonzero(ground)
    if len(y) < MIN_CONTACT_PIXELS:
        return None
    run = columns - np.nonzero(own)[1].mean()  # (n,)
    values = inverse[y, columns[which]].astype(np.float64)
    offset = np.stack([np.ones(len(y)), run[which], y - bottom.max() - 1.0], 1)
    given = confidence[y, columns[which]].astype(np.float64) ** 2 + 1e-3
    weight = given
    for _ in range(6):
        normal = (offset * weight[:, None]).T @ offset + np.diag(
            [0.0, 1.0, 1.0]
        ) * given.sum()  # ridge: one pixel's worth
        plane = np.linalg.solve(normal, offset.T @ (weight * values))
        weight = given / (1 + ((values - offset @ plane) / (GROUND_NOISE * abs(plane[0]) + 1e-9)) ** 2)
    edge = plane[0] + plane[1] * run + plane[2] * (bottom - bottom.max())
    hidden = float((bottom >= height - 2).mean())  # it leaves the picture below: the true contact is nearer
    trust = float(np.clip(1 - 2 * hidden, 0.1, 1.0) * np.sqrt(given.mean()).clip(0.1, 1))
    left, above = float(np.nonzero(own)[1].mean()), bottom.max() + 1.0
    everywhere = np.array([plane[0] - plane[1] * left - plane[2] * above, plane[1], plane[2]])
    agrees = np.bincount(which, weight / given, len(columns)) >= AGREEING * np.bincount(which, minlength=len(columns))
    if not agrees.any():
        return None
    return GroundEdge(columns[agrees], run[agrees], edge[agrees], everywhere, trust * float(agrees.mean()))


def growth(priors: Priors, frame: int, own: np.ndarray) -> float:
    """Return the log of a region's change of size to the next frame, from a robust similarity of its flow; NaN if unknown."""
    if priors.flow_forward is None or priors.flow_forward_mask is None:
        return float("nan")
    y, x = np.nonzero(own & priors.flow_forward_mask[frame])
    if len(x) < MIN_OBJECT_PIXELS:
        return float("nan")
    here = np.stack([x + 0.5, y + 0.5], 1)
    there = here + priors.flow_forward[frame][y, x].astype(np.float64)
    weight = np.ones(len(x))
    for _ in range(4):
        p = here - np.average(here, axis=0, weights=weight)
        q = there - np.average(there, axis=0, weights=weight)
        a, b = p[:, 0] + 1j * p[:, 1], q[:, 0] + 1j * q[:, 1]
        factor = (weight * b * a.conj()).sum() / (weight * abs(a) ** 2).sum()  # scale and turn as one complex number
        weight = 1 / (1 + abs(b - factor * a) ** 2)
    if np.median(abs(b - factor * a)) > MAX_MISFIT * np.median(abs(a)):
        return float("nan")
    return float(np.clip(np.log(abs(factor)), -0.2, 0.2))
