"""Positions far from the origin, as georeferenced files have them: float32 near the origin, and an offset in float64.

A scene keeps the offset in its provenance. Everything that is drawn or edited stays near the origin; writers whose format has
double precision add the offset again.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import F4xError

FAR = 1000.0
"""Distance of the middle of all Gaussians from the origin, in the file's unit, below which float32 is always fine enough."""
FINE = 1 / 100
"""Part of a typical Gaussian's size that float32 may lose of a position."""


def offset_for(means: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return the whole numbers (3,) float64 to take off positions `means (N,3)` so that float32 holds them; 0 where it does.

    The middle of all Gaussians decides, with their sizes `scales (N,3)`: far outliers change nothing.
    """
    if not len(means):
        return np.zeros(3)
    middle = np.rint(np.median(means, axis=0)).astype(np.float64) + 0.0  # there is no -0 then
    reach = float(np.abs(middle).max())
    lost = float(np.spacing(np.float32(min(reach, float(np.finfo(np.float32).max)))))
    far = reach >= FAR and lost > FINE * float(np.median(scales.max(axis=1)))
    return middle if far else np.zeros(3)


def offset_of(provenance: Mapping[str, Any]) -> np.ndarray:
    """Return the offset (3,) float64 that `provenance` of a scene holds, 0 where there is none; F4xError if it is damaged."""
    imported = provenance.get("import")
    kept = imported.get("offset") if isinstance(imported, Mapping) else None
    if kept is None:
        return np.zeros(3)
    try:
        offset = np.array(kept, np.float64)
    except (TypeError, ValueError, OverflowError):
        offset = np.full(3, np.nan)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise F4xError("its provenance has no valid 'offset', three numbers; export the scene again")
    return offset
