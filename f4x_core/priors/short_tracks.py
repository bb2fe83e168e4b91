"""Cameras adjusted on short tracks: points spread evenly over the pictures, each followed by flow through a few frames.

Long tracks keep to what has texture, and drift where near things pass before far ones: there a robust adjustment takes the near
ones for outliers, and the direction of the path errs although the far ones fit. Flow between neighbouring frames holds on to both
and errs by a tenth of a pixel, so the points of a few frames tell what long tracks leave open, and these hold the path together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .bundle import MIN_SEEN, BundleConfig, Observations
from .flow import best_of_cells, inside, length, pixel_grid, sample, texture
from .sfm import Solution

CELLS = 24
"""Cells along the longer side of a picture; each gives its pixel with most texture, so that near ground has its say."""
GAPS = (-2, -1, 1, 2)
"""Frames through which it is followed; four on both sides gain nothing."""
MIN_TEXTURE = 0.3
"""Least `flow.texture`: on plain surfaces flow is made up."""
MAX_RETURN = 0.0016
"""Widths of the picture by which flow there and back may miss its start: .75 pixels of 480."""
ROBUST_PX = 0.5
"""Cauchy scale in pixels, for long and short tracks alike. Seven rendered paths err by .085 % of their length (.120 without short
tracks), with 1 pixel by .106 %, with long tracks that count .2 or .05 by .090 and .141 %."""
ROUNDS = 2
"""The second one takes points back that first cameras made outliers of."""


@dataclass(frozen=True)
class Neighbourhood:
    """Pictures and the flow between frames near each other."""

    pictures: np.ndarray
    """(F, H, W) uint8 grey."""
    flows: Mapping[int, np.ndarray]
    """Gap in frames -> (F, H, W, 2) flow, with all of `GAPS`."""
    blocked: np.ndarray
    """(F, H, W) bool: moving pixels."""

    def sightings(self) -> Observations:
        """Return the sightings of one point of every cell of every frame that at least `MIN_SEEN` frames see."""
        parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        count = 0
        for frame in range(len(self.pictures)):
            others, seen, uv = self._followed(frame)
            kept = np.flatnonzero(seen.sum(0) >= MIN_SEEN)
            row, column = np.nonzero(seen[:, kept])
            parts.append((others[row], count + column, uv[row, kept[column]]))
            count += len(kept)
        frames, points, pixels = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Observations(frames, points, pixels, np.ones(len(frames)))

    def _followed(self, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the frames (G,), in which of them each point of `frame` is seen (G, P), and where (G, P, 2)."""
        height, width = self.pictures.shape[1:]
        held = np.where(self.blocked[frame], 0, texture(self.pictures[frame]))
        row, column = best_of_cells(held, max(max(height, width) // CELLS, 1), MIN_TEXTURE)
        start = pixel_grid(height, width)[row, column].astype(np.float64)
        others = [frame] + [frame + gap for gap in GAPS if 0 <= frame + gap < len(self.pictures)]
        seen, uv = np.ones((len(others), len(start)), bool), np.empty((len(others), len(start), 2))
        uv[0] = start
        for index, other in enumerate(others[1:], 1):
            there = self.flows[other - frame][frame][row, column].astype(np.float64)
            uv[index] = start + there
            missed = length(there + sample(self.flows[frame - other][other], uv[index]))
            x, y = np.clip(uv[index].astype(int), 0, (width - 1, height - 1)).T
            free = inside(uv[index], height, width) & ~self.blocked[other][y, x]
            seen[index] = free & (missed < MAX_RETURN * max(width, height))
        return np.array(others), seen, uv


def sharpened(solution: Solution, short: Observations, lens: BundleConfig) -> Solution:
    """Return the solution adjusted on its own sightings and those of `short` tracks, all points triangulated anew."""
    own = solution.observations
    seen = own.followed_by(short, own.point.max(initial=-1) + 1)
    config = replace(lens, iterations=15, robust_px=ROBUST_PX)
    return replace(solution, observations=seen).adjusted_anew(config, ROUNDS)
