"""Depth of what moves: plausible where it cannot be measured, by contact with the ground and change of size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from .folder import Priors

GUESS_CONFIDENCE = 0.05
"""Most confidence of the plausible depth of moving pixels, and of everything in a clip without parallax."""
MOVING_MARGIN = 6
"""Pixels around moving regions whose flow is not trusted as static: flow bleeds over the outline of what moves."""
MOVING_CONFIDENCE = 0.2
"""Most confidence of ... in a clip with parallax."""
GROUND_SHARE, GROUND_NOISE = 0.2, 0.03
"""How far below a moving region its ground is fitted (picture heights), and how flat ground is (relative inverse depth)."""
TURN_LIMIT, TURNS, TURN_COST = 1.5, 31, 0.05
"""Largest turn of a region against the view (relative inverse depth over the picture's width), how many are tried, and the
share of touching columns that a turn of 1 must win."""
HOVERING = 0.03
"""Say of a contact behind the object's depth: what jumps or flies is seen in front of farther ground, never behind nearer."""
SMALLEST_CONTACT = 8
"""With fewer free pixels below a moving region than this, it takes the depth of its surroundings."""
TILT_FRAMES, TILT_RANGE = 3.0, (0.5, 2.0)
"""Frames over which the turn of a region is smoothed, and the bounds of what it may do to the inverse depth."""
SIZE_NOISE, CONTACT_NOISE = 0.02, 0.05
"""Relative errors of the frame-to-frame size change and of one contact depth, used to smooth an object's depth."""
SMALLEST_OBJECT = 30
"""Moving regions with fewer pixels per frame than this follow the static depth around them."""


def place_objects(inverse: np.ndarray, confidence: np.ndarray, moving: np.ndarray, priors: Priors) -> int:
    """Write plausible inverse depth of moving pixels into `inverse (F, H, W)` in place; return the number of objects.

    An object is a connected region of the mask in space and time.
    """
    static_confidence = confidence.copy()
    confidence[moving] = np.minimum(confidence[moving], GUESS_CONFIDENCE)
    labels, _ = ndimage.label(moving)
    objects = 0
    for number, region in enumerate(ndimage.find_objects(labels), start=1):
        own = labels[region] == number  # (f, h, w) within the box
        frames = region[0].start + np.flatnonzero(own.any((1, 2)))
        pixels = own.sum((1, 2))
        if pixels.mean() < SMALLEST_OBJECT:
            continue
        objects += 1
        contacts = np.array(
            [_contact(inverse[f], static_confidence[f], moving[f], labels[f] == number) for f in frames]
        )
        size = np.array([_growth(priors, f, labels[f] == number) for f in frames[:-1]])
        middle, tilt, trust = contacts.T
        solved, certain = smooth_object_depth(middle, trust, size)
        norm = ndimage.gaussian_filter1d(trust + 1e-3, TILT_FRAMES)
        tilt = ndimage.gaussian_filter1d(tilt * (trust + 1e-3), TILT_FRAMES) / norm
        for f, value, slope, sure in zip(frames, solved, tilt, certain, strict=True):
            y, x = np.nonzero(labels[f] == number)
            inverse[f][y, x] = value * np.clip(1 + slope * (x - x.mean()), *TILT_RANGE)
            confidence[f][y, x] = MOVING_CONFIDENCE * sure if priors.camera_kind == "moving" else GUESS_CONFIDENCE
    return objects


def smooth_object_depth(contact: np.ndarray, trust: np.ndarray, growth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth `(f,)` of one object over time, and its certainty 0..1.

    `contact (f,)` inverse depths where it touches the ground with `trust (f,)` 0..1, `growth (f - 1,)` logarithm of its
    change of picture size to the next frame (NaN = unknown). Size is inverse depth times a constant, so
    `argmin sum trust (x - log contact)^2 / c^2 + sum (x' - x - growth)^2 / s^2`, x = log inverse depth; Cauchy weights
    on the contacts, and little weight where the ground is seen behind the object (`HOVERING`).
    """
    count, measured = len(contact), np.log(contact)
    known = np.isfinite(growth)
    step = np.where(known, growth, 0.0)
    link = np.where(known, 1 / SIZE_NOISE**2, 1 / (5 * SIZE_NOISE) ** 2)
    laplacian = np.zeros((count, count))
    right = np.zeros(count)
    for i in range(count - 1):
        laplacian[i : i + 2, i : i + 2] += link[i] * np.array([[1, -1], [-1, 1]])
        right[i : i + 2] += link[i] * step[i] * np.array([-1, 1])
    solution = np.full(count, np.average(measured, weights=trust + 1e-6))
    for _ in range(5):
        weight = (trust + 1e-3) / CONTACT_NOISE**2 / (1 + ((measured - solution) / (2 * CONTACT_NOISE)) ** 2)
        weight *= np.where(measured < solution, HOVERING, 1.0)
        solution = np.linalg.solve(laplacian + np.diag(weight), right + weight * measured)
    return np.exp(solution), np.clip(trust, 0.25, 1.0)


def _contact(
    inverse: np.ndarray, confidence: np.ndarray, moving: np.ndarray, own: np.ndarray
) -> tuple[float, float, float]:
    """Where a region stands: inverse depth at its mean column, relative change per column, and trust 0..1.

    The ground is a plane, so its inverse depth is linear in the picture; fitted below the region, where flow is free of it, it
    is carried up to the region's lower edge. Nothing is behind the ground that it is seen in front of, so the region, an
    upright plane of inverse depth `a (1 + b (column - mean))`, lies above the ground's values on that edge and touches them at
    its feet; of all turns `b` the one that touches most columns is taken (feet and wheels do, bellies and tails do not).
    """
    height, width = own.shape
    columns = np.flatnonzero(own.any(0))
    bottom = height - 1 - np.argmax(own[::-1], axis=0)[columns]
    rows = np.arange(height)[:, None]
    lowest = int(bottom.max()) + MOVING_MARGIN + round(GROUND_SHARE * height)
    ground = (rows > bottom + MOVING_MARGIN) & (rows <= lowest) & ~moving[:, columns]
    y, which = np.nonzero(ground)
    if len(y) < SMALLEST_CONTACT:
        rim = ndimage.binary_dilation(own, iterations=2 * MOVING_MARGIN) & ~moving
        return float(np.median(inverse[rim] if rim.any() else inverse)), 0.0, 0.05
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
    edge = plane[0] + plane[1] * run + plane[2] * (bottom - bottom.max())  # (n,) ground behind the lower edge
    usual = max(float(edge.max()), 1e-6)
    best, a, b = -np.inf, usual, 0.0
    for turn in np.linspace(-TURN_LIMIT, TURN_LIMIT, TURNS) / width:  # relative change per column
        touching = float(np.quantile(edge / (1 + turn * run), 0.98))
        gap = 1 - edge / (touching * (1 + turn * run))
        score = float(np.exp(-((gap / GROUND_NOISE) ** 2)).mean()) - TURN_COST * (turn * width) ** 2
        if score > best:
            best, a, b = score, touching, turn
    hidden = float((bottom >= height - 2).mean())  # it leaves the picture below: the true contact is nearer
    return max(a, 0.3 * usual), b, float(np.clip(1 - 2 * hidden, 0.1, 1.0) * np.sqrt(given.mean()).clip(0.1, 1))


def _growth(priors: Priors, frame: int, own: np.ndarray) -> float:
    """Logarithm of a region's change of size to the next frame, from a robust similarity of its flow; NaN if unknown."""
    if priors.flow_forward is None or priors.flow_forward_mask is None:
        return float("nan")
    y, x = np.nonzero(own & priors.flow_forward_mask[frame])
    if len(x) < SMALLEST_OBJECT:
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
    return float(np.clip(np.log(abs(factor)), -0.2, 0.2))
