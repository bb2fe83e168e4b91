"""Chooses the tracks that become nodes, and their number. numpy and scipy."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..errors import F4xError
from ..geometry import pose, quaternion
from ..geometry.camera import CameraPath
from ..parallel import in_threads
from .deformation import deform, pairs_of
from .distance import curve_distance, distance_to
from .graph import GraphConfig, attach_nodes, build_graph
from .lifting import LiftedTracks
from .radius import RadiusConfig, initial_radius
from .rotation import initial_rotations
from .skinning import skinning_weights
from .structure import Scaffold

Rotations = Literal["tracks", "identity"]

NOISE_MARGIN = 2.0
"""No model of noisy tracks leaves less than their own noise; the noise of a few nodes adds up to as much again."""
MIN_COMMON = 16
"""Of fewer tracks the median jitter is partly their own. (A car filmed from the hand, drift-straight: 11 pixels, all but .7 of them
common to its tracks; 32 nodes were taken to be as good as any.)"""


@dataclass(frozen=True)
class SelectionConfig:
    """Settings of drawing nodes from lifted tracks."""

    maximum: int = 512
    """Never more nodes."""
    counts: tuple[int, ...] = (4, 8, 16, 32, 64, 128, 256, 512)
    """Node counts that `choose_nodes` tries."""
    tracks_per_node: float = 2.0
    """Counts that leave a node fewer tracks are not tried: such nodes are the tracks themselves, not what moves them, and
    their residual falls on. (Toy arm of 182 tracks: the residual asks for 128 nodes, 64 are no better than 32.)"""
    held_out: float = 0.25
    """Fraction of the tracks that only measure the residual: never nodes, never used for node rotations."""
    slack: float = 0.25
    """If no count reaches the tolerance, the fewest nodes within this fraction of the best residual win. Of at most 400 nodes,
    a tenth takes 256 for a rendered cube that hops (against 128: -.25 dB from 10 degrees aside), and brings dog .7 dB of what it
    used and nothing of what is held out."""
    quantile: float = 0.9
    """The residual of a count is this quantile over held-out tracks: a small moving part is not averaged away."""
    lost: float = 0.05
    """Fraction of the picture's longer side from which the least residual shows tracks that are lost, not moved: linked to other
    points, or followed onto the background. No number of nodes carries these, more of them follow them more, so the median
    decides. (A pillow in a person's hands: 90 % of the tracks within 35 pixels by 16 nodes and 64 by 384, half of them within 12
    and 3; hand-set points carried by nodes to within a twentieth of the picture: .28 by 8, .55 by 64, .58 by 256.)"""
    candidates: int = 2000
    """At most so many tracks (the longest observed) are considered as nodes; more cost time and add little."""
    rotations: Rotations = "tracks"
    """Nodes turn as the `tracks` around them do, or not at all (`identity`)."""
    support: int = 12
    """Tracks around a node that determine its rotation."""
    seed: int = 0
    graph: GraphConfig = field(default_factory=GraphConfig)
    radius: RadiusConfig = field(default_factory=RadiusConfig)


@dataclass(frozen=True)
class NodeCountTrial:
    """One tried node count."""

    nodes: int
    unit: float
    """Node spacing in world units."""
    residual: float
    """Quantile over held-out tracks of the mean distance to their own positions."""
    median: float
    """The median over held-out tracks."""


@dataclass(frozen=True, eq=False)
class Selection:
    """The chosen nodes and why."""

    index: np.ndarray
    """(M,) int64 into the lifted tracks."""
    unit: float
    residual: float
    tolerance: float
    noise: float
    """Residual that the tracks' own jitter alone would leave (`track_noise`)."""
    pixels: bool
    """True when residual, tolerance and noise are in pixels, False for world units."""
    table: tuple[NodeCountTrial, ...]
    by_median: bool = False
    """True when tracks are lost and the medians chose."""

    @property
    def median(self) -> float:
        """The median residual of the chosen count."""
        return next(row.median for row in self.table if row.residual == self.residual)

    @property
    def met(self) -> bool:
        """True when the residual is within the tolerance."""
        return self.residual <= self.tolerance


def automatic_unit(xyz: np.ndarray, factor: float, neighbours: int = 4, frames: int = 16) -> float:
    """Return a node spacing in world units: `factor` times the typical distance between neighbouring curves `(F, N, 3)`.

    `sqrt(median_t median_i |x_i - its neighbours|^2)` over at most `frames` frames spread over the clip.
    """
    from scipy.spatial import cKDTree

    count = min(neighbours + 1, xyz.shape[1])
    if count < 2:
        return factor * 1e-2  # a lone track: one hundredth of the scene depth, so that radii are not zero
    sampled = np.unique(np.linspace(0, len(xyz) - 1, frames).astype(int))
    squared = in_threads(lambda f: np.median(cKDTree(xyz[f]).query(xyz[f], count)[0][:, 1:] ** 2), sampled)
    return factor * float(np.sqrt(np.median(squared)))


def choose_nodes(
    lifted: LiftedTracks,
    times: np.ndarray,
    tolerance: float,
    config: SelectionConfig | None = None,
    cameras: CameraPath | None = None,
) -> Selection:
    """Return the fewest nodes that carry held-out tracks to within `tolerance`.

    The tracks are split; nodes come from one part, spread over the motion by farthest-curve order and centred in their
    cells. Tracks of the other part are deformed by the nodes from their own reference frame and compared with their
    own observed positions: in world units, or with `cameras` in pixels. Counts are tried upwards until the tolerance,
    or `NOISE_MARGIN` times the tracks' own noise, is met; when none meets it, the fewest nodes whose residual is
    within `config.slack` of the best are taken, of their medians where tracks are lost (`config.lost`). Counts that
    leave a node fewer than `config.tracks_per_node` tracks are left out, unless all do: then the least is taken.
    `times (F,)`. Raises F4xError when there is no track.
    """
    config = config or SelectionConfig()
    if len(lifted) == 0:
        raise F4xError("no track moves visibly with known depth, so there is no scaffold; fit the clip as static")
    candidates, held_out = _split(lifted, config)
    nodes = lifted.subset(candidates)
    order, covering = _farthest_order(nodes, min(max(config.counts), config.maximum, len(nodes)))
    noise = float(np.median(track_noise(lifted, times, cameras)))
    enough = max(tolerance, NOISE_MARGIN * noise)
    table, picks = [], []
    supported = [count for count in config.counts if count * config.tracks_per_node <= len(lifted)]
    for count in sorted({min(count, len(order)) for count in supported or [min(config.counts)]}):
        pick = _centred(nodes, order[:count])
        scaffold = scaffold_of(nodes, pick, times, max(float(covering[count - 1]), _least_unit(nodes)), config)
        residual = track_residuals(scaffold, lifted.subset(held_out), cameras)
        value = float(np.quantile(residual, config.quantile)) if len(residual) else 0.0
        median = float(np.median(residual)) if len(residual) else 0.0
        table.append(NodeCountTrial(len(pick), scaffold.unit, value, median))
        picks.append(candidates[pick])
        if value <= enough:
            break
    residuals = [row.residual for row in table]
    lost = cameras is not None and min(residuals) > config.lost * max(cameras.width, cameras.height)
    if lost:
        residuals = [row.median for row in table]
    enough = max(enough, min(residuals) * (1 + config.slack))
    best = next(i for i, residual in enumerate(residuals) if residual <= enough)
    chosen = table[best]
    return Selection(
        picks[best], chosen.unit, chosen.residual, tolerance, noise, cameras is not None, tuple(table), lost
    )


def scaffold_of(
    lifted: LiftedTracks, index: np.ndarray, times: np.ndarray, unit: float, config: SelectionConfig | None = None
) -> Scaffold:
    """Return the scaffold whose nodes are the tracks `index (M,)`, turned by the tracks around them."""
    config = config or SelectionConfig()
    xyz, certain = lifted.xyz[:, index], lifted.certain[:, index]
    distance = curve_distance(xyz, certain, config.graph.kth)
    neighbours, edge_mask = build_graph(distance, config.graph.neighbours, config.graph.reach * unit)
    if config.rotations == "identity":
        quat = np.tile(quaternion.IDENTITY, (*certain.shape, 1))
    else:
        support = np.argsort(distance_to(xyz, lifted.xyz), axis=1, kind="stable")[:, : config.support]
        quat = initial_rotations(support, np.ones(support.shape, bool), lifted.xyz, lifted.certain)
    return Scaffold(
        np.asarray(times, np.float64),
        xyz,
        quat.astype(np.float32),
        initial_radius(len(index), unit, config.radius),
        certain,
        np.arange(len(index)),
        neighbours,
        edge_mask,
        float(unit),
    )


def track_residuals(scaffold: Scaffold, lifted: LiftedTracks, cameras: CameraPath | None = None) -> np.ndarray:
    """Return the mean distance `(N,)` of each track from where the scaffold carries it.

    Every track starts at the middle one of its certain frames and is compared at the others; in world units, or with
    `cameras` in pixels.
    """
    seen = lifted.certain
    tracks = np.arange(len(lifted))
    rank = seen.cumsum(axis=0)
    reference = (2 * rank > seen.sum(axis=0)).argmax(axis=0)  # (N,) the middle certain frame
    start = lifted.xyz[reference, tracks]
    attach = attach_nodes(start, reference, scaffold.xyz)
    neighbours = scaffold.neighbours[attach]
    skinning = skinning_weights(
        start, scaffold.xyz[reference[:, None], neighbours], scaffold.radius[neighbours], scaffold.edge_mask[attach]
    )
    pairs = pairs_of(neighbours, reference)
    total = np.zeros(len(lifted))
    for f, time in enumerate(scaffold.times):
        motion = deform(scaffold.times, scaffold.xyz, scaffold.quat, pairs, skinning, time)
        carried = pose.transform(*motion, start)
        truth = lifted.xyz[f]
        if cameras is not None:
            carried, truth = (cameras.at(time).project(points)[0] for points in (carried, truth))
        total += np.where(seen[f] & (reference != f), np.linalg.norm(carried - truth, axis=-1), 0.0)
    return total / np.maximum(seen.sum(axis=0) - 1, 1)


def track_noise(lifted: LiftedTracks, times: np.ndarray, cameras: CameraPath | None = None) -> np.ndarray:
    """Return the distance `(N,)` that a perfect model would leave because each track jitters in time.

    From third differences in time, which smooth motion hardly has: normalised, the difference of samples with
    independent noise of variance s^2 has variance s^2, and the distance between two samples 2 s^2. The median over all
    frames with four certain samples in a row, 0 for tracks without. What at least `MIN_COMMON` tracks do alike is motion:
    an unsteady path of the camera shakes them all. World units, or with `cameras` pixels.
    """
    noise = np.full((max(len(times) - 3, 1), len(lifted)), np.nan)
    for f in range(len(times) - 3):
        window = slice(f, f + 4)
        gaps = times[window, None] - times[None, window] + np.eye(4)
        weights = 1 / gaps.prod(axis=1)  # divided difference over unequal intervals
        jitter = np.tensordot(weights / np.linalg.norm(weights), lifted.xyz[window], 1)  # (N, 3)
        here = lifted.xyz[f + 1]
        if cameras is not None:
            camera = cameras.at(times[f + 1])
            jitter = camera.project(here + jitter)[0] - camera.project(here)[0]
        known = lifted.certain[window].all(axis=0)
        if known.sum() >= MIN_COMMON:
            jitter -= np.median(jitter[known], axis=0)
        noise[f] = np.where(known, np.linalg.norm(jitter, axis=-1), np.nan)
    noise[0, np.isnan(noise).all(axis=0)] = 0.0
    return np.sqrt(2) * np.nanmedian(noise, axis=0)


def _split(lifted: LiftedTracks, config: SelectionConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return indices of (candidates, held-out tracks)."""
    number = len(lifted)
    drawn = np.random.default_rng(config.seed).permutation(number)[: int(config.held_out * number)]
    held_out = np.zeros(number, bool)
    held_out[drawn] = True
    order = _by_observation(lifted)
    candidates = order[~held_out[order]][: config.candidates]
    return np.sort(candidates), np.flatnonzero(held_out)


def _by_observation(lifted: LiftedTracks) -> np.ndarray:
    return np.argsort(-lifted.certain.sum(axis=0), kind="stable")


def _distances(lifted: LiftedTracks):
    """Return the function of `i` that gives the distances of curve `i` to all curves.

    Over common certain frames; curves never seen together are compared where they were filled in, else every short
    track would be infinitely far from some others and become a node.
    """

    def distance_from(i: int) -> np.ndarray:
        one = lifted.subset(np.array([i]))
        common = distance_to(one.xyz, lifted.xyz, one.certain, lifted.certain)[0]
        apart = np.isinf(common)
        if apart.any():
            common[apart] = distance_to(one.xyz, lifted.xyz[:, apart])[0]
        return common

    return distance_from


def _farthest_order(lifted: LiftedTracks, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return `(order (count,), covering (count,))`: each next curve is the farthest from those before.

    Fewer than `count` when all other curves coincide with one of them.
    `covering[i]` is the distance within which 95 % of all curves have one of the first i + 1: the unit of that count.
    """
    distance_from = _distances(lifted)
    order = [int(_by_observation(lifted)[0])]
    nearest = distance_from(order[0]).astype(np.float64)
    covering = [np.quantile(nearest, 0.95)]
    while len(order) < count and nearest.max() > 0:
        order.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, distance_from(order[-1]))
        covering.append(np.quantile(nearest, 0.95))
    return np.asarray(order), np.asarray(covering)


def _centred(lifted: LiftedTracks, seeds: np.ndarray) -> np.ndarray:
    """Return `(M,)` tracks: in the cell of each seed curve the track nearest to the cell's mean curve.

    Farthest-curve order likes outliers; the middle of a cell is a better node than its corner.
    """
    cell = distance_to(lifted.xyz[:, seeds], lifted.xyz).argmin(axis=0)  # (N,)
    cell[seeds] = np.arange(len(seeds))  # of coinciding seeds each keeps a cell of its own
    sums = np.zeros((len(seeds), *lifted.xyz.shape[::2]))
    curves = lifted.xyz.transpose(1, 0, 2).astype(np.float64)  # (N, F, 3)
    np.add.at(sums, cell, curves)
    means = sums / np.bincount(cell)[:, None, None]
    off_centre = np.linalg.norm(curves - means[cell], axis=-1).mean(axis=1)
    by_cell = np.lexsort((off_centre, cell))
    return by_cell[np.searchsorted(cell[by_cell], np.arange(len(seeds)))]


def _least_unit(lifted: LiftedTracks) -> float:
    """Return a positive lower bound of the unit, for tracks that all coincide."""
    return max(automatic_unit(lifted.xyz, 1.0), 1e-4)
