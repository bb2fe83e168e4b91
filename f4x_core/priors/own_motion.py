"""Structure of a rigid moving object from its own motion, as if a camera moved around an object at rest.

Only the motion between camera and object matters, so the tracks on one object are a clip of a static world with a virtual
camera. Its structure follows up to one scale, as that of the background does: all frames at once, from a camera that only
turns (`cameras`). An object is expected to be as deep as it is wide and high (`BundleConfig.relief`); without this prior a
body that bends is explained by a needle along the view. Seen from afar, the mirror image in depth explains the tracks as
well. Parts that stick out towards the camera are farther from the outline than the rim is, which decides between the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.arrays import evenly_spaced, rank_correlation
from ..geometry.quaternion import angles_between
from .bundle import Bundle, BundleConfig, Observations, resect, total_cost, triangulate
from .mirror import MIN_SAMPLES, adjust_coarse_to_fine, mirrored
from .point_tracks import PointTracks
from .sfm import sightings, solve_rotations

MAX_POINTS, MAX_FRAMES = 300, 24
"""Points and frames that a structure is solved from: two seconds; other frames are resected."""
MIN_POINTS = 30
"""Smallest number of tracks in the sampled frames that a structure is solved from."""
MIN_EXTENT_PX = 1.0
"""Smallest extent of the tracks: what lies on one line of pixels shows no turning."""
INLIER_PX, MAX_ERROR_PX, MIN_INLIERS = 1.5, 1.0, 0.75
"""A point follows the body when its median error is below the first; a body is rigid when the median of all errors is below
the second and so many of its points follow: pixels as they are, for what tracks err by does not grow with the picture."""
MAX_RELIEF = 1.5
"""Largest ratio of depth to width and height with which the structure of a body is accepted."""
MIN_DEGREES = 10.0
"""Angle of the rays (median over its points) that structure from motion needs."""
NARROW = 0.35
"""Points seen from less than this fraction of the usual angle are left out: their depth is noise."""
MIN_BULGE = 0.15
"""Rank correlation of nearness and distance from the outline that the chosen one of two mirror images must have."""
ERROR_SCALE = 0.025
"""Relative difference of the robust squared error that is worth one unit of log-odds."""
BULGE_WEIGHT = 6.0
"""Log-odds where nearness grows from the outline to the middle in one solution and falls in the other."""
LITTLE_TURN, STEADY = np.deg2rad(20.0), 0.8
"""A body that turns by more than the first in all must end up this fraction of its way from where it was at some time."""
OUTLINE_PX = 20.0
"""Distances from the outline beyond this (480 wide) are all the same: bodies are flat in their middle."""


@dataclass(frozen=True)
class TracksOnObject:
    """Tracks that lie on one object, over the frames in which it is seen. f frames, n tracks."""

    tracks: np.ndarray
    """(f, n, 2) pixels."""
    visible: np.ndarray
    """(f, n) bool."""
    from_outline: np.ndarray
    """(f, n) pixels to the outline of the object's mask; 0 where not visible."""
    focal: np.ndarray
    """(f,) pixels, of the true cameras."""
    principal: np.ndarray
    """(2,) pixels."""
    world_to_camera: np.ndarray
    """(f, 4, 4) of the true cameras."""

    @property
    def unit(self) -> float:
        """Pixels of this clip per pixel of a picture 480 wide."""
        return 2 * float(self.principal.max()) / 480


@dataclass(frozen=True)
class OwnMotion:
    """A rigid body in the axes of the camera, frame by frame, in a unit of its own."""

    z: np.ndarray
    """(f, n) depth of every track's point in every frame, NaN where it is not part of the body."""
    inliers: np.ndarray
    """(n,) bool, tracks that follow the body."""
    degrees: float
    """Angle of the rays its points were seen from, median over them."""
    error_px: float
    """Median reprojection error."""


def solve(seen: TracksOnObject) -> OwnMotion | None:
    """Return the rigid body that the tracks lie on; None where they show no rigid body that turns."""
    focal = float(np.median(seen.focal))
    tracks = (seen.tracks - seen.principal) * (focal / seen.focal)[:, None, None] + seen.principal  # one lens for all
    frames = evenly_spaced(len(tracks), MAX_FRAMES)
    own = PointTracks.all_static(tracks[frames], seen.visible[frames])  # in its own world the body is static
    order = sightings(own, MAX_POINTS).tracks
    if len(order) < MIN_POINTS or len(frames) < 3:
        return None
    start = solve_rotations(own, focal, seen.principal, MAX_POINTS)
    observed, unit = start.observations, seen.unit
    extent = _extent(observed, len(frames))
    if not extent >= MIN_EXTENT_PX:
        return None
    config = BundleConfig(refine_focal=False, robust_px=1.0, relief=extent / focal)
    body, bulge = _resolve_mirror(start.bundle, observed, config, seen.from_outline[frames][:, order] / unit)
    errors = body.errors(observed)
    usual = float(np.median(errors))
    follows = _median_by(observed.point, errors, len(order)) < INLIER_PX
    if usual > MAX_ERROR_PX or follows.mean() < MIN_INLIERS or not bulge >= MIN_BULGE:
        return None
    kept = observed.keep(follows[observed.point])
    if _relief(body, kept) > MAX_RELIEF or not _turns_steadily(body, seen.world_to_camera[frames]):
        return None
    return _in_every_frame(_at_all_frames(body, frames, order[follows], follows, tracks, seen), tracks, seen, usual)


def _resolve_mirror(
    start: Bundle, observations: Observations, config: BundleConfig, from_outline: np.ndarray
) -> tuple[Bundle, float]:
    """Return the solution or its mirror image, chosen by their errors and by which one bulges towards the camera, and its bulge."""
    first = adjust_coarse_to_fine(start, observations, config)
    pair = [first, adjust_coarse_to_fine(mirrored(first), observations, config, first=1)]
    bulges = [_bulge(one, observations, from_outline) for one in pair]
    costs = [total_cost(one, observations, config) for one in pair]
    odds = np.log(costs[1] / costs[0]) / ERROR_SCALE + BULGE_WEIGHT * (bulges[0] - bulges[1]) / 2
    chosen = 1 if odds < 0 else 0
    return pair[chosen], bulges[chosen]


def _extent(observations: Observations, frames: int) -> float:
    """Return the pixels by which sightings of one frame deviate from their middle (half of 16..84 %), mean of both axes and frames.

    NaN where no frame has more than three."""
    spans = [
        np.subtract(*np.percentile(observations.uv[observations.frame == frame], (84, 16), axis=0))
        for frame in range(frames)
        if (observations.frame == frame).sum() > 3
    ]
    return float(np.sqrt(np.prod(np.median(spans, axis=0)))) / 2 if spans else np.nan


def _relief(bundle: Bundle, observations: Observations) -> float:
    """Return the ratio of a body's depth to its width and height (16..84 %), median over the frames."""
    local, found = bundle.local(observations), []
    for frame in range(len(bundle.center)):
        here = local[observations.frame == frame]
        if len(here) >= MIN_SAMPLES // 2:
            width, height = np.subtract(*np.percentile(here[:, :2] / here[:, 2:], (84, 16), axis=0))
            depth = np.subtract(*np.percentile(here[:, 2], (84, 16))) / np.median(here[:, 2])
            found.append(depth / max(np.sqrt(width * height), 1e-9))
    return float(np.median(found)) if found else np.inf


def _bulge(bundle: Bundle, observations: Observations, from_outline: np.ndarray) -> float:
    """Return the mean rank correlation of nearness with the distance from the outline `(f, p)` over the frames, 0 if unknown."""
    z, found = bundle.local(observations)[:, 2], []
    distance = np.minimum(from_outline[observations.frame, observations.point], OUTLINE_PX)
    for frame in range(len(bundle.center)):
        here = (observations.frame == frame) & (z > 0)
        if here.sum() >= MIN_SAMPLES and np.ptp(distance[here]) > 0:
            found.append(rank_correlation(1 / z[here], distance[here]))
    return float(np.mean(found)) if found else 0.0


def _turns_steadily(bundle: Bundle, world_to_camera: np.ndarray) -> bool:
    """Return True if the body's turn in the world goes somewhere: what bends and is taken for a turn swings to and fro."""
    turns = np.einsum("fji,fjk->fik", world_to_camera[:, :3, :3], bundle.rotation)
    steps = angles_between(turns[1:], turns[:-1]).sum()
    apart = max(float(angles_between(turns, one).max()) for one in turns)
    return bool(steps < LITTLE_TURN or apart > np.pi - 0.1 or apart >= STEADY * steps)


def _median_by(point: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return the median of the values of each point, `(count,)`; infinite without any."""
    order = np.lexsort((values, point))
    length = np.bincount(point, minlength=count)
    median, has = np.full(count, np.inf), length > 0
    median[has] = values[order][(np.cumsum(length) - length + length // 2)[has]]
    return median


def _at_all_frames(
    body: Bundle, frames: np.ndarray, order: np.ndarray, follows: np.ndarray, tracks: np.ndarray, seen: TracksOnObject
) -> Bundle:
    """Return cameras of all frames: frames that were not sampled are resected, starting at the nearest sampled one."""
    nearest = np.abs(np.arange(len(tracks))[:, None] - frames).argmin(1)
    whole = replace(body, rotation=body.rotation[nearest], center=body.center[nearest], points=body.points[follows])
    others = np.setdiff1d(np.arange(len(tracks)), frames)
    frame, point = np.nonzero(seen.visible[:, order])
    sighted = Observations(frame, point, tracks[:, order][frame, point].astype(np.float64), np.ones(len(frame)))
    for scale in (32.0, 2.0) if len(others) else ():
        whole = resect(whole, sighted, others, 30, scale)
    return whole


def _in_every_frame(whole: Bundle, tracks: np.ndarray, seen: TracksOnObject, usual: float) -> OwnMotion | None:
    """Return all tracks triangulated from all frames, and the depth of those that follow the body."""
    count = tracks.shape[1]
    frame, point = np.nonzero(seen.visible)
    sighted = Observations(frame, point, tracks[frame, point].astype(np.float64), np.ones(len(frame)))
    points, spread = triangulate(whole, sighted, count)
    whole = replace(whole, points=np.where(np.isfinite(points), points, 0.0))
    errors = np.where(np.isfinite(points).all(1)[point], whole.errors(sighted), np.inf)
    follows = _median_by(point, errors, count) < INLIER_PX
    local = np.einsum("fj,fnj->fn", whole.rotation[:, 2], whole.points - whole.center[:, None])
    follows &= spread >= NARROW * np.median(spread[follows]) if follows.any() else follows
    follows &= (np.where(seen.visible, local, 1.0) > 0).all(0) & (seen.visible.sum(0) >= 3)
    degrees = float(np.degrees(np.median(spread[follows]))) if follows.any() else 0.0
    if follows.sum() < MIN_POINTS or degrees < MIN_DEGREES:
        return None
    z = np.where(follows & (local > 0), local, np.nan)
    return OwnMotion(z, follows, degrees, usual)
