"""A lens that zooms: whether a camera that turns while its focal length changes explains a clip, and that solution.

A zoom of a camera that does not move is a homography, and so is a step towards a wall: a moving camera explains a zoom by a flat
world that it walks towards, through a lens of any length, and a focal length per frame lowers its error by no more in a clip
that zooms (3 to 9 %) than in one that does not (1 to 6 %; `bundle.BundleConfig.refine_zoom`). What tells them apart is
how well the clip is explained without any depth. Where the camera really walks, turning and zooming leave parallax.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .bundle import Bundle, BundleConfig, Observations, adjust
from .mirror import adjust_coarse_to_fine
from .sfm import Solution, refocused

MAX_COST_LEFT_BY_ZOOM = 0.4
"""A lens zooms when turning and zooming leave at most this fraction of the cost that turning alone leaves: 0.08 to 0.17 in
clips made to zoom, 0.82 to 0.99 in the choosing half of the real clips, none of which does."""
MIN_COST_LEFT_BY_MOVING = 0.55
"""... and when a moving camera leaves at least this fraction of the cost that turning and zooming leave. Chosen on 17 rooms of
cards filmed by a zoom, most by a shaking hand (0.59 to 0.86, one 0.39), and on 16 filmed by a walk ahead (0.17 to 0.41, one
0.58). Of 34 others with more noise it is right in 30; 0.5 in 28."""
MIN_FACTOR = 1.05
"""Smallest ratio of focal lengths that counts as a zoom: a smaller change comes from focusing, and the lens is held constant."""


@dataclass(frozen=True)
class Zoom:
    """A camera that turns and zooms, as far as a sample of frames tells."""

    factor: float
    """Longest over shortest focal length."""
    left: float
    """Cost as a fraction of that of a camera that only turns."""
    cost: float
    """Cost per sighting and degree of freedom."""
    logarithm: np.ndarray
    """(S,) logarithm of the sampled frames' focal lengths in pixels."""
    frames: np.ndarray
    """(S,) which frames those are."""

    @property
    def explains(self) -> bool:
        """Return True if it explains most of what turning alone does not."""
        return self.factor >= MIN_FACTOR and self.left <= MAX_COST_LEFT_BY_ZOOM

    def summary(self, bundle: Bundle, width: int) -> dict[str, Any]:
        """Return plain values for the statistics of the priors; `bundle` is the solution of all frames."""
        first, last = (round(float(focal) / width, 3) for focal in bundle.focals[[0, -1]])
        span = float(bundle.focals.max() / bundle.focals.min())
        return {"factor": round(span, 3), "first": first, "last": last, "left": round(self.left, 3)}


def mean_cost(bundle: Bundle, observations: Observations, unknowns: int = 0) -> float:
    """Return the mean Cauchy cost (px^2) of the sightings, over the fraction of their values that `unknowns` leave free."""
    squared = np.minimum(bundle.errors(observations), 1e3) ** 2
    free = 1 - unknowns / max(2 * len(observations.frame), 1)
    return float(np.log1p(squared).mean()) / max(free, 0.1)


def find_zoom(sample: Solution, frames: np.ndarray, lens: BundleConfig) -> Zoom:
    """Adjust `sample`, a camera that only turns and sees points at any distance, with and without a zoom.

    `frames` are those that were sampled.
    """
    seen, (count, points) = sample.observations, (len(sample.bundle.center), len(sample.bundle.points))
    turning = adjust_coarse_to_fine(sample.bundle, seen, replace(lens, refine_centers=False))
    zooming = adjust_coarse_to_fine(turning, seen, replace(lens, refine_centers=False, refine_zoom=True))
    costs = [mean_cost(one, seen, own * count + 2 * points) for one, own in ((turning, 3), (zooming, 4))]
    logarithm = np.log(zooming.focals)
    return Zoom(float(np.exp(np.ptp(logarithm))), costs[1] / max(costs[0], 1e-12), costs[1], logarithm, frames)


def zoomed(turning: Solution, zoom: Zoom, known: float | None) -> Solution:
    """Return all frames of a turning camera, adjusted with the zoom found; `known`: focal length of the first frame in pixels."""
    logarithm = np.interp(np.arange(len(turning.bundle.center)), zoom.frames, zoom.logarithm)
    usual = float(np.exp(logarithm.mean()))
    start = refocused(turning, usual, translating=False)
    start = replace(start, bundle=replace(start.bundle, zoom=np.exp(logarithm) / usual))
    settings = BundleConfig(refine_focal=False, refine_zoom=True, refine_centers=False)
    bundle = adjust_coarse_to_fine(start.bundle, turning.observations, settings)
    if known is not None:
        found = refocused(replace(turning, bundle=bundle), bundle.focal * known / bundle.focals[0], translating=False)
        bundle = adjust(found.bundle, turning.observations, replace(settings, refine_zoom=False))
    return replace(turning, bundle=bundle)
