"""Leakage: how much of a selection lies outside the object. Needs numpy alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..progress import Progress, silent
from ..scene import Scene
from .blend_weights import lift_masks
from .pixels import SHOWN, coverage_image
from .segmentation import connected_regions
from .selection import Selection

VIEWS = 5
"""Original views, evenly over the clip, that are measured when no masks are given."""


def leakage(
    scene: Scene,
    selection: Selection,
    masks: Mapping[int, np.ndarray] | None = None,
    backend: str = "auto",
    progress: Progress = silent,
) -> float:
    """Return the fraction of the selection's blend weights outside `masks` (clip frame -> (H,W) bool); 0 where it is empty.

    Without masks: outside the largest connected region of the selection's own picture, in `VIEWS` views. Frames outside the
    selection's span do not count.
    """
    times = scene.cameras.times
    if masks is None:
        own: dict[int, np.ndarray] = {}
        for frame in evenly_spaced(len(times), VIEWS):
            image = coverage_image(scene, selection, scene.cameras[frame], float(times[frame]), backend) > SHOWN
            own[int(frame)] = largest_region(image)
        masks = own
    held = {frame: mask for frame, mask in masks.items() if selection.holds_at(float(times[frame]))}
    inside, weights = lift_masks(scene, held, progress)
    chosen = weights * selection.chosen
    return float(((1 - inside) * chosen).sum() / max(chosen.sum(), 1e-12))


def largest_region(mask: np.ndarray) -> np.ndarray:
    """Return the largest connected region (H,W) bool of `mask (H,W)`, all False where it is empty."""
    if not mask.any():
        return mask
    regions = connected_regions(mask.astype(int))
    names, sizes = np.unique(regions[mask], return_counts=True)
    return regions == names[sizes.argmax()]
