"""Tracks without drift: every sighting is aligned with the picture of its point where the track was anchored.

Chained flow lags behind (its smoothness costs 2 % of each step on rendered clips) and adds up: 0.08 px after four frames, 0.3 px
after sixteen. The patch around a point looks nearly the same all along a track, so a few Gauss-Newton steps from where the
chain lies find it to a few hundredths of a pixel (Lucas and Kanade 1981; Baker and Matthews 2004). What looks different there
(a turned surface, another light, something in front) keeps its chained place.
"""

from __future__ import annotations

import numpy as np

WINDOW = 11
"""Side of the patch in pixels."""
ANCHOR_FRAMES = 16
"""Frames that one anchor serves: over more, views differ too much."""
ITERATIONS, STEP_PX = 12, 0.005
"""Most Gauss-Newton steps, and the step at which they end."""
MAX_CORRECTION_PX, CORRECTION_GROWTH = 0.5, 0.1
"""Largest correction in pixels, and what it grows by per frame from the anchor; a larger one has matched another, similar place."""
MAX_DIFFERENCE = 12.0
"""Largest mean difference of grey levels (of 255) between two patches that show the same place."""
MIN_EIGENVALUE = 2e-4
"""Smallest eigenvalue of the patch's gradient matrix (OpenCV's unit); patches with less texture are not aligned."""


def align_tracks(tracks: np.ndarray, visible: np.ndarray, pictures: np.ndarray) -> np.ndarray:
    """Return `tracks (F, N, 2)` float32 with their `visible (F, N)` sightings aligned; `pictures (F, H, W)` uint8 grey.

    The anchors are the sightings in the middle of each stretch of `ANCHOR_FRAMES` frames; stretches are chained through the
    anchors, each of which was aligned with the one before.
    """
    aligned = tracks.copy()
    frames = len(tracks)
    half = ANCHOR_FRAMES // 2
    anchors = list(range(min(half, frames - 1), frames, ANCHOR_FRAMES))
    for number, anchor in enumerate(anchors):
        start = 0 if number == 0 else anchor - half
        end = frames if number == len(anchors) - 1 else anchor + half
        order = [*range(anchor - 1, start - 1, -1), *range(anchor + 1, end)]
        if number + 1 < len(anchors):
            order.append(anchors[number + 1])
        for frame in order:
            both = np.flatnonzero(visible[anchor] & visible[frame])
            if len(both):
                before = aligned[anchor, both]
                aligned[frame, both] = _aligned(
                    pictures[anchor], pictures[frame], before, aligned[frame, both], abs(frame - anchor)
                )
    return aligned


def _aligned(there: np.ndarray, here: np.ndarray, anchor: np.ndarray, guess: np.ndarray, gap: int) -> np.ndarray:
    """Return the places (n, 2) near `guess` in picture `here` that look like those of `anchor` in picture `there`."""
    import cv2

    offset = np.float32(0.5)  # OpenCV counts pixel centres from 0
    found, status, difference = cv2.calcOpticalFlowPyrLK(
        there,
        here,
        np.ascontiguousarray(anchor - offset, np.float32)[:, None],
        np.ascontiguousarray(guess - offset, np.float32)[:, None].copy(),
        winSize=(WINDOW, WINDOW),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, ITERATIONS, STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=MIN_EIGENVALUE,
    )
    place = found[:, 0] + offset
    far = np.linalg.norm(place - guess, axis=1) > MAX_CORRECTION_PX + CORRECTION_GROWTH * gap
    good = (status[:, 0] > 0) & (difference[:, 0] < MAX_DIFFERENCE) & ~far
    return np.where(good[:, None], place, guess)
