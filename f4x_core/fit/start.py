"""The scaffold before the photometric stage: lifted tracks, the fewest nodes that carry them, geometric optimisation."""

from __future__ import annotations

import numpy as np

from ..priors import Priors
from ..progress import Progress
from ..scaffold import Scaffold
from ..scaffold.lifting import lift_tracks
from ..scaffold.optimise import optimise_geometry
from ..scaffold.selection import choose_nodes, scaffold_of
from .config import FitConfig
from .needs import Need

# A track belongs to the moving region when most of its visible samples lie in the mask.
MASK_SHARE = 0.6
# Fewer lifted tracks than this cannot carry a scaffold.
LEAST_TRACKS = 8


def moving_tracks(priors: Priors) -> np.ndarray:
    """Indices of the tracks whose visible samples mostly lie in the moving mask."""
    assert priors.tracks is not None and priors.tracks_visible is not None and priors.mask is not None
    frames, count = priors.tracks_visible.shape
    inside = np.zeros((frames, count), bool)
    for frame in range(frames):
        seen = priors.tracks_visible[frame]
        column, row = np.floor(priors.tracks[frame, seen]).astype(int).T
        column, row = np.clip(column, 0, priors.width - 1), np.clip(row, 0, priors.height - 1)
        inside[frame, seen] = priors.mask[frame, row, column]
    visible = priors.tracks_visible.sum(0)
    return np.flatnonzero((visible > 0) & (inside.sum(0) >= MASK_SHARE * np.maximum(visible, 1)))


def start_scaffold(priors: Priors, config: FitConfig, progress: Progress) -> tuple[Scaffold | None, list[Need]]:
    """Build and optimise the scaffold; None when no moving track can be lifted."""
    assert priors.tracks is not None and priors.tracks_visible is not None
    assert priors.cameras is not None and priors.depth is not None
    chosen = moving_tracks(priors)
    times = priors.cameras.times
    if len(chosen) < LEAST_TRACKS:
        return None, []
    lifted = lift_tracks(
        priors.tracks[:, chosen], priors.tracks_visible[:, chosen], priors.depth, None, priors.cameras, times
    )
    if len(lifted) < LEAST_TRACKS:
        return None, []
    settings = config.scaffold
    progress("scaffold", 0, 2, f"{len(lifted)} moving tracks")
    selected = settings.selection(config.seed)
    tolerance = settings.tolerance_at(priors.width)
    selection = choose_nodes(lifted, times, tolerance, selected, priors.cameras)
    scaffold = scaffold_of(lifted, selection.index, times, selection.unit, selected)
    progress("scaffold", 1, 2, f"{len(scaffold)} nodes")
    scaffold = optimise_geometry(scaffold, settings.geometry(config.seed), progress)
    progress("scaffold", 2, 2, f"{len(scaffold)} nodes")
    evidence = ", ".join(f"{row.nodes}: {row.residual:.2f}" for row in selection.table)
    need = Need(
        "motion nodes",
        str(len(scaffold)),
        f"90 % of {len(lifted)} tracks held out follow within so many pixels, by nodes: {evidence}; wanted {tolerance:g}",
        f"{max(settings.most_nodes - len(scaffold), 0)} nodes of at most {settings.most_nodes}",
    )
    return scaffold, [need]
