"""The scaffold before the photometric stage: lifted tracks, the fewest nodes that carry them, geometric optimisation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..parallel import in_threads
from ..priors import Priors
from ..progress import Progress
from ..scaffold import Scaffold
from ..scaffold.following import follow_tracks
from ..scaffold.lifting import lift_tracks
from ..scaffold.optimise import Sightlines, optimise_geometry
from ..scaffold.selection import choose_nodes, scaffold_of
from .config import FitConfig
from .needs import Need

# A track belongs to the moving region when most of its visible samples lie in the mask.
MIN_MASK_FRACTION = 0.6
# Fewer lifted tracks than this cannot carry a scaffold.
MIN_TRACKS = 8
# So many nearest nodes tell how far a pixel's depth was moved.
DEPTH_NODES = 4


def moving_tracks(priors: Priors) -> np.ndarray:
    """Return the indices of the tracks whose visible samples mostly lie in the moving mask."""
    assert priors.tracks is not None
    assert priors.tracks_visible is not None
    assert priors.mask is not None
    frames, count = priors.tracks_visible.shape
    inside = np.zeros((frames, count), bool)
    for frame in range(frames):
        seen = priors.tracks_visible[frame]
        column, row = np.floor(priors.tracks[frame, seen]).astype(int).T
        column, row = np.clip(column, 0, priors.width - 1), np.clip(row, 0, priors.height - 1)
        inside[frame, seen] = priors.mask[frame, row, column]
    visible = priors.tracks_visible.sum(0)
    return np.flatnonzero(inside.sum(0) >= MIN_MASK_FRACTION * np.maximum(visible, 1))


@dataclass(frozen=True)
class Start:
    """Start of the dynamic part, from tracks alone, before anything is rendered."""

    scaffold: Scaffold | None
    """None when no moving track can be lifted."""
    needs: list[Need]
    priors: Priors
    """Priors with depth that lies on the scaffold (`carried_depth`)."""


def start_scaffold(priors: Priors, config: FitConfig, progress: Progress) -> Start:
    """Build and optimise the scaffold, and take the depth of moving objects along."""
    assert priors.tracks is not None
    assert priors.tracks_visible is not None
    assert priors.cameras is not None
    assert priors.depth is not None
    chosen = moving_tracks(priors)
    times = priors.cameras.times
    if len(chosen) < MIN_TRACKS:
        return Start(None, [], priors)
    lifted = lift_tracks(
        priors.tracks[:, chosen], priors.tracks_visible[:, chosen], priors.depth, priors.cameras, times
    )
    if len(lifted) < MIN_TRACKS:
        return Start(None, [], priors)
    settings = config.scaffold
    progress("scaffold", 0, 2, f"{len(lifted)} moving tracks")
    selected = settings.selection(config.seed)
    tolerance = settings.tolerance_at(priors.width)
    selection = choose_nodes(lifted, times, tolerance, selected, priors.cameras)
    scaffold = scaffold_of(lifted, selection.index, times, selection.unit, selected)
    progress("scaffold", 1, 2, f"{len(scaffold)} nodes")
    sightlines = _sightlines(scaffold, priors, chosen[lifted.index[selection.index]])
    lifted_scaffold = scaffold
    scaffold = optimise_geometry(scaffold, settings.geometry(config.seed), progress, sightlines, config.kernels)
    scaffold = follow_tracks(
        scaffold, lifted, priors.cameras, settings.following(config.seed), config.kernels, progress
    )
    priors = replace(priors, depth=carried_depth(priors, lifted_scaffold, scaffold))
    progress("scaffold", 2, 2, f"{len(scaffold)} nodes")
    evidence = ", ".join(f"{row.nodes}: {row.residual:.2f}" for row in selection.table)
    wanted = f"wanted {tolerance:g}"
    if not selection.met:
        wanted += (
            f", which none reaches: the fewest within {selected.slack:.0%} of the best, or at the tracks' own noise"
        )
    if selection.by_median:
        wanted += f" by the median, for some tracks are lost: half of them follow within {selection.median:.2f}"
    need = Need(
        "motion nodes at the start",
        str(len(scaffold)),
        f"90 % of {len(lifted)} tracks held out follow within so many pixels, by nodes: {evidence}; {wanted}",
        f"{max(settings.max_nodes - len(scaffold), 0)} nodes of at most {settings.max_nodes}",
    )
    return Start(scaffold, [need], priors)


def carried_depth(priors: Priors, before: Scaffold, after: Scaffold) -> np.ndarray:
    """Return depth `(F, H, W)` in which moving pixels follow their nodes along the view, from `before` to `after` the optimisation.

    Gaussians are spawned at the depth of the priors and carried by nodes, so both must lie on one surface. A pixel takes
    the mean of the logarithmic changes of its nearest certain nodes, weighed by 1 / squared distance.
    """
    assert priors.depth is not None
    assert priors.mask is not None
    assert priors.cameras is not None
    masks, cameras, depth = priors.mask, priors.cameras, priors.depth.copy()

    def carry(frame: int) -> None:
        camera = cameras[frame]
        z = [(one.xyz[frame] @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]) for one in (before, after)]
        known = before.certain[frame] & (z[0] > 0) & (z[1] > 0)
        y, x = np.nonzero(masks[frame])
        if not known.any() or not len(y):
            return
        pixels, _ = camera.project(after.xyz[frame, known])
        count = min(DEPTH_NODES, int(known.sum()))
        distance, near = cKDTree(pixels).query(np.column_stack([x + 0.5, y + 0.5]), count)
        weight = 1 / (distance.reshape(len(y), count) ** 2 + 1)
        change = np.log(z[1][known] / z[0][known])[near].reshape(len(y), count)
        depth[frame, y, x] *= np.exp((weight * change).sum(1) / weight.sum(1)).astype(np.float32)

    in_threads(carry, range(len(masks)))
    return depth


def _sightlines(scaffold: Scaffold, priors: Priors, tracks: np.ndarray) -> Sightlines | None:
    """Return the viewing rays of the nodes, each through its one of the `tracks (M,)`; None where depth has no confidence."""
    if priors.depth_confidence is None:
        return None
    assert priors.cameras is not None
    assert priors.tracks is not None
    offset: np.ndarray = scaffold.xyz - priors.cameras.centers[:, None].astype(np.float32)
    direction = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
    limit = np.array([priors.width, priors.height]) - 1
    column, row = np.moveaxis(np.clip(np.nan_to_num(priors.tracks[:, tracks]), 0, limit).astype(int), -1, 0)
    confidence = priors.depth_confidence[np.arange(len(offset))[:, None], row, column]
    return Sightlines(direction, confidence.astype(np.float32))
