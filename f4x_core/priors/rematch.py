"""Sightings of points matched anew with one picture of each point.

Tracks are chained flow, and flow is smooth: on ground seen at a grazing angle what is far is drawn along by what is near, so tracks
slip by half a pixel over their life, all in the same direction. Cameras that follow them bend the world: on rendered clips the far
ground came 2 to 5 % too near, whatever its depth was measured with. A patch of the picture in the middle of a track's life does not
slip, and shows the point again in the other frames to within a tenth of a pixel (Lucas and Kanade, "An Iterative Image Registration
Technique", 1981).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..parallel import in_threads
from .bundle import Observations
from .flow import length

WINDOW = 11
"""Side in pixels of the patches. On seven rendered clips 7 to 15 serve alike; the ground under one of 21 changes its shape."""
STEPS, SETTLED_PX = 20, 0.01
"""Most steps of a match, and the step at which it ends."""
FARTHEST_PX = 2.0
"""A sighting is matched within so many pixels of where its track is; flow slips by less."""
RETURN_PX = 0.05
"""Matched back from where it was found, a point must end up so near to where it was. With .05 static depth bends by 1.6 %
on seven rendered clips, with .1 by 2.2, with .3 by 2.6, by tracks as they are 4.0."""
MIN_GRADIENT = 1e-3
"""Least eigenvalue of a patch's gradients, as OpenCV counts it: less texture holds nothing."""
UNMATCHED_WEIGHT = 0.1
"""Weight of sightings that are not matched: with less, frames that share few patches come loose."""
ANCHOR_STEP = 4
"""Patches are taken from every such frame that sees the point, so that many are matched between the same two pictures."""


def match_anew(pictures: np.ndarray, seen: Observations) -> Observations:
    """Return `seen` with places and weights of sightings that were matched anew with one picture of their point.

    pictures: (F, H, W) uint8 grey levels. A matched sighting, and the one that it is matched with, has weight 1.
    """
    source = _anchors(seen)
    uv, matched = seen.uv.copy(), np.zeros(len(seen.frame), bool)
    matched[source] = True
    order = np.lexsort((seen.frame, seen.frame[source]))
    order = order[source[order] != order]
    pairs = np.stack([seen.frame[source[order]], seen.frame[order]], 1)
    starts = np.flatnonzero(np.diff(pairs, axis=0, prepend=-1).any(1))

    def match(rows: np.ndarray) -> None:
        here, there = pictures[seen.frame[source[rows[0]]]], pictures[seen.frame[rows[0]]]
        found, good = _match(here, there, seen.uv[source[rows]], seen.uv[rows])
        uv[rows[good]], matched[rows[good]] = found[good], True

    in_threads(match, np.split(order, starts[1:]) if len(order) else [])
    return replace(seen, uv=uv, weight=np.where(matched, 1.0, UNMATCHED_WEIGHT))


def _anchors(seen: Observations) -> np.ndarray:
    """Return (O,) int: the sighting that holds the patch of each one's point, near the middle of the point's life."""
    order = np.lexsort((seen.frame, seen.point))
    _, first, point, number = np.unique(seen.point[order], return_index=True, return_inverse=True, return_counts=True)
    middle = seen.frame[order][first + number // 2]  # (P,)
    frame = seen.frame[order]
    off = abs(frame - middle[point]) + ANCHOR_STEP * (frame % ANCHOR_STEP > 0)
    nearest = order[np.lexsort((off, point))[first]]
    sources = np.empty(len(order), int)
    sources[order] = nearest[point]
    return sources


def _match(here: np.ndarray, there: np.ndarray, patch: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the places `(n, 2)` in the picture `there` of `patch (n, 2)` of `here`, near `guess (n, 2)`, and found `(n,)` bool."""
    import cv2

    settings: Any = {
        "winSize": (WINDOW, WINDOW),
        "maxLevel": 0,
        "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, STEPS, SETTLED_PX),
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        "minEigThreshold": MIN_GRADIENT,
    }
    start, near = (np.ascontiguousarray(one - 0.5, np.float32)[:, None] for one in (patch, guess))
    found, one_way, _ = cv2.calcOpticalFlowPyrLK(here, there, start, near.copy(), **settings)
    back, other_way, _ = cv2.calcOpticalFlowPyrLK(there, here, found, start.copy(), **settings)
    good = (one_way[:, 0] > 0) & (other_way[:, 0] > 0)
    good &= (length(found - near)[:, 0] < FARTHEST_PX) & (length(back - start)[:, 0] < RETURN_PX)
    return found[:, 0] + 0.5, good
