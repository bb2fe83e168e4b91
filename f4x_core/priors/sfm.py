"""Structure from motion: first cameras and points of a clip, from tracks, from tracks with depth, or from pycolmap.

Every solver returns a `Solution` in its own world unit; `cameras.py` chooses between them, completes and refines it.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..geometry import pose, quaternion
from ..geometry.arrays import GOLDEN_RATIO, evenly_spaced
from ..parallel import in_threads
from .bundle import (
    MIN_SEEN,
    Bundle,
    BundleConfig,
    Observations,
    adjust,
    from_matrices,
    rays,
    resect,
    total_cost,
    triangulate,
)
from .point_tracks import PointTracks
from .tracks import best_rank, longest_first

MATCH_GAPS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
"""Keyframe distances whose pictures are matched: dense nearby, sparse for loops; all pairs would cost 5x the time."""
FOCALS = (0.5, 0.6, 0.72, 0.86, 1.0, 1.2, 1.45, 1.75, 2.1, 2.5)
"""Candidate focal lengths in longer sides of the picture (90 to 23 degrees across), about 20 % apart."""
DEFAULT_FOCAL = 0.9
"""Focal length in longer sides of the picture (58 degrees across) where nothing tells it: a phone's main camera films at 0.75 to
0.9, upright as across."""
FOCAL_PRIOR = 0.1
"""Relative error that a focal length `e` times away from the default must save: decides only where pictures do not."""
FOCAL_STEP, LONGER, SHORTER, HELD_ITERATIONS = 1.35, 3, 2, 12
"""Ratio of the focal lengths that `best_focal` holds one after the other, how many are longer and shorter than the one found, and
steps of each adjustment."""
FLAT, BELIEF_IN_FLAT = 0.08, 0.25
"""Spread of inverse depth between the 10th and the 90th percentile, relative to the median, below which a world has no relief
(camel's is .04, that of 31 other clips .11 and more), and the part of the belief in the usual lens that is left then."""
OUTLIERS, MIN_OUTLIER_PX = 4.0, 3.0
"""Sightings that miss by so many median errors, and by at least so many pixels, are left out."""
SAMPLED_POINTS, SAMPLED_FRAMES = 500, 24
"""Points and frames on which solutions are compared: 500 x 24 take two seconds, and find what 2,000 x 90 find."""
MIN_SAMPLED_POINTS, MIN_POINTS_PER_FRAME, MAX_SAMPLED_FRAMES = 200, 150, 96
"""More frames are sampled, up to `MAX_SAMPLED_FRAMES`, where fewer than `MIN_SAMPLED_POINTS` points are seen in three of them or
one of them sees fewer than `MIN_POINTS_PER_FRAME`, as in a sweep (86 to 142 on three real clips, 258 and more on the others)."""
MIN_SHARED = 30
"""Fewest tracks two frames must share to be related to each other."""
MIN_SPREAD = np.deg2rad(0.5)
"""Smallest angle between the viewing rays of a point whose depth is believed during reconstruction."""
INFINITY = 1e4
"""Distance, in radii of the camera's path, from which the path shifts nothing by as much as a tenth of a pixel."""
MAX_ERROR_PX = 3.0
"""Median reprojection error above which a track is not a static point."""


@dataclass(frozen=True)
class Solution:
    """Cameras of some frames, and the points and observations that hold them."""

    bundle: Bundle
    """All F frames; those not `registered` hold whatever stood there."""
    observations: Observations
    registered: np.ndarray
    """(F,) bool."""
    rival: Solution | None = None
    """Nearly as good a solution that is the other way round in depth, where it is in doubt which one is right."""

    @property
    def error(self) -> float:
        """Root mean square reprojection error in pixels over the registered frames, misses above 10 px counted as 10."""
        known = np.isfinite(self.bundle.points).all(1)
        seen = self.observations.keep(self.registered[self.observations.frame] & known[self.observations.point])
        return float(np.sqrt(np.mean(np.minimum(self.bundle.errors(seen), 10.0) ** 2))) if len(seen.frame) else np.inf

    def without_outliers(self) -> Solution:
        """Return the solution without sightings off by more than `OUTLIERS` times the median and points seen too rarely then."""
        bundle, seen = self.bundle, self.observations
        error = np.nan_to_num(bundle.errors(seen), nan=np.inf, posinf=np.inf)
        usual = np.median(error) if len(error) else 0.0
        seen = seen.keep(error < max(MIN_OUTLIER_PX, OUTLIERS * usual if np.isfinite(usual) else 0.0))
        enough = np.bincount(seen.point, minlength=len(bundle.points)) >= min(MIN_SEEN, len(bundle.center))
        seen = seen.keep(enough[seen.point])
        row = np.cumsum(enough) - 1
        bundle = replace(bundle, points=bundle.points[enough])
        return replace(self, bundle=bundle, observations=replace(seen, point=row[seen.point]))

    def adjusted_anew(self, config: BundleConfig, rounds: int = 1) -> Solution:
        """Return the solution adjusted with points triangulated anew, without outliers.

        In each further one of the `rounds` all sightings count again: wrong cameras make outliers of good sightings.
        """
        count, found = self.observations.point.max(initial=-1) + 1, self
        for _ in range(rounds):
            points, _ = triangulate(found.bundle, self.observations, count)
            found = replace(self, bundle=replace(found.bundle, points=points)).without_outliers()
            found = replace(found, bundle=adjust(found.bundle, found.observations, config))
        return found


@dataclass(frozen=True)
class TrackSightings:
    """Sightings of tracks, each of which is a point, or several where it is cut."""

    seen: Observations
    tracks: np.ndarray
    """(P,) index of each point's track."""


def sightings(tracks: PointTracks, max_count: int, longest: int | None = None) -> TrackSightings:
    """Return those of at most `max_count` of the static tracks (`choose_covering_points`).

    Only tracks seen at least three times (or in every frame) count. With `longest`
    they are cut into pieces of at most so many frames, each of them a point.
    """
    visible = tracks.visible
    enough = tracks.static & (visible.sum(0) >= min(3, len(tracks)))
    order = choose_covering_points(visible & enough, max_count)
    frame, point = np.nonzero(visible[:, order])
    uv = tracks.uv[:, order][frame, point].astype(np.float64)
    seen = Observations(frame, point, uv, np.ones(len(frame)))
    whole = TrackSightings(seen, order)
    return whole if longest is None else _in_pieces(whole, longest)


def _in_pieces(whole: TrackSightings, longest: int) -> TrackSightings:
    """Return the sightings with each track cut into pieces of `longest` frames that are points of their own.

    No two neighbouring tracks are cut at the same frames, so that every pair of frames shares points. Pieces seen less than three
    times are left out.
    """
    seen, tracks = whole.seen, whole.tracks
    offset = (np.arange(len(tracks)) * GOLDEN_RATIO % 1 * longest).astype(int)
    piece = (seen.frame + offset[seen.point]) // longest
    most = piece.max(initial=0) + 1
    named, point, count = np.unique(seen.point * most + piece, return_inverse=True, return_counts=True)
    often = count >= 3
    kept = replace(seen, point=(np.cumsum(often) - 1)[point]).keep(often[point])
    return TrackSightings(kept, tracks[named[often] // most])


def choose_covering_points(visible: np.ndarray, max_count: int) -> np.ndarray:
    """Return indices `(P,)`, ascending, of at most `max_count` of the points `visible (F, N)`, so that every frame sees some.

    They are the q longest seen points of every frame, q as large as fits. The longest of all would leave frames without any
    point where tracks are short, as in a fast pan.
    """
    order = longest_first(visible)
    order = order[: np.count_nonzero(visible.any(0))]  # those that no frame sees come last
    frame, point = np.nonzero(visible[:, order])
    best = best_rank(frame, point, len(order))
    return np.sort(order[np.argsort(best, kind="stable")[:max_count]])


def bearings(uv: np.ndarray, focal: float, principal: np.ndarray) -> np.ndarray:
    """Return unit viewing directions `(n, 3)` in camera axes."""
    local = np.concatenate([(uv - principal) / focal, np.ones_like(uv[:, :1])], axis=1)
    return local / np.linalg.norm(local, axis=1, keepdims=True)


def rotation_between(a: np.ndarray, b: np.ndarray, focal: float, rounds: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Return robust rotation `(3, 3)` with `b ~ R a` of unit directions `(n, 3)`, and the residuals `(n,)` in pixels.

    Kabsch with Cauchy reweighting at the median residual: it follows the far majority and leaves parallax as residual.
    """
    weight, rotation, residual = np.ones(len(a)), np.eye(3), np.zeros(len(a))
    for _ in range(rounds):
        u, _, vt = np.linalg.svd((b * weight[:, None]).T @ a)
        rotation = u @ np.diag([1, 1, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
        residual = focal * np.linalg.norm(b - a @ rotation.T, axis=1)
        weight = 1 / (1 + (residual / max(float(np.median(residual)), 0.1)) ** 2)
    return rotation, residual


def solve_rotations(tracks: PointTracks, focal: float, principal: np.ndarray, max_count: int = 1000) -> Solution:
    """Return a camera that only turns: rotations chained over neighbouring frames, to be adjusted by the caller.

    Centres are zero and points lie at distance 1.
    """
    rotation, seen = [np.eye(3)], tracks.seen
    for i in range(len(tracks) - 1):
        shared = seen[i] & seen[i + 1]
        turn = np.eye(3)
        if shared.sum() >= 4:
            a, b = (bearings(tracks.uv[k, shared].astype(np.float64), focal, principal) for k in (i, i + 1))
            turn, _ = rotation_between(a, b, focal)
        rotation.append(turn @ rotation[-1])
    sighted = sightings(tracks, max_count)
    points = np.zeros((len(sighted.tracks), 3))
    bundle = Bundle(focal, principal, np.array(rotation), np.zeros((len(rotation), 3)), points)
    return Solution(on_sphere(bundle, sighted.seen), sighted.seen, np.ones(len(rotation), bool))


def solve_with_tracks(tracks: PointTracks, focal: float, principal: np.ndarray, seed: int = 0) -> Solution | None:
    """Solve structure from motion incrementally on static tracks; None where no pair of frames shows parallax.

    The pair with the most parallax gives two cameras (five-point essential matrix); the others follow outwards, each
    resected from the points known so far, with a bundle adjustment whenever a quarter more cameras are in.
    """
    sighted = sightings(tracks, 2500)
    observations, chosen = sighted.seen, sighted.tracks
    frames, count = len(tracks), len(chosen)
    start = _first_pair(tracks.uv[:, chosen], tracks.visible[:, chosen], focal, principal, seed)
    if start is None:
        return None
    i, j, rotation, translation = start
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    matrices[j, :3, :3], matrices[j, :3, 3] = rotation, translation
    bundle = from_matrices(matrices, focal, principal, np.full((count, 3), np.nan))
    registered = np.zeros(frames, bool)
    registered[[i, j]] = True
    bundle, adjusted = _structure(bundle, observations, registered), 2
    while not registered.all():
        frame = _next_frame(registered, observations, bundle)
        if frame is None:
            break
        near = np.flatnonzero(registered)[np.argsort(abs(np.flatnonzero(registered) - frame), kind="stable")]
        bundle = _set_pose(bundle, frame, bundle.rotation[near[0]], bundle.center[near[0]])
        bundle = resect(bundle, observations, np.array([frame]), iterations=30, robust_px=8.0)
        registered[frame] = True
        bundle = _structure(bundle, observations, registered)
        if registered.sum() >= 1.25 * adjusted or registered.all():
            bundle = adjust_known(bundle, observations, registered, BundleConfig(iterations=8, refine_focal=False))
            bundle, adjusted = _structure(bundle, observations, registered), int(registered.sum())
    return Solution(bundle, observations, registered)


def solve_with_depth(
    tracks: PointTracks, depth: np.ndarray, focal: float | None, width: int
) -> tuple[Solution, dict[str, list[float]]]:
    """Return the cameras from tracks and a depth prior: field-of-view search, chained alignments, points from depth.

    `depth (F, H, W)` in any unit. Pairs of frames 10 and 20 apart are aligned by a similarity of their
    lifted tracks for every candidate field of view; the least symmetric reprojection error wins (as in MoSca).
    Returns the solution in the unit of the depth, and the search curve.
    """
    height = depth.shape[1]
    side, principal = max(width, height), np.array([width / 2, height / 2])
    sighted = sightings(tracks, 4000)
    observations, chosen = sighted.seen, sighted.tracks
    uv, visible = tracks.uv[:, chosen], tracks.visible[:, chosen]
    column = np.clip(np.nan_to_num(uv[..., 0]).astype(int), 0, width - 1)
    row = np.clip(np.nan_to_num(uv[..., 1]).astype(int), 0, height - 1)
    z = depth[np.arange(len(uv))[:, None], row, column].astype(np.float64)
    visible = visible & (z > 0)  # NaN compares false

    longest = max((len(tracks) - 1) // 2, 1)
    gaps = sorted({min(gap, longest) for gap in (10, 20)})
    pairs = [(i, i + gap) for gap in gaps for i in range(0, len(tracks) - gap, max(gap // 4, 1))]
    fovs = np.deg2rad(np.linspace(20, 90, 72)[1:-1])
    candidates = [focal] if focal else list(side / 2 / np.tan(fovs / 2))
    curve = [_alignment_error(uv, visible, z, pairs, candidate, principal) for candidate in candidates]
    best = int(np.argmin(curve))
    found = float(candidates[best])
    if 0 < best < len(curve) - 1:  # parabola through the three lowest: finer than the 1-degree steps
        a, b, c = curve[best - 1 : best + 2]
        found = float(side / 2 / np.tan((fovs[best] + 0.5 * (a - c) / (a - 2 * b + c) * (fovs[1] - fovs[0])) / 2))
    elif not focal and not np.isfinite(curve[best]):
        found = DEFAULT_FOCAL * side

    matrices = [np.eye(4)]
    for i in range(len(tracks) - 1):
        shared = visible[i] & visible[i + 1]
        step = np.eye(4)
        if shared.sum() >= 4:
            here, there = (_lift(uv[k, shared], z[k, shared], found, principal) for k in (i, i + 1))
            step[:3, :3], step[:3, 3] = _robust_alignment(here, there, with_scale=False)[1:]
        matrices.append(step @ matrices[-1])
    bundle = from_matrices(np.array(matrices), found, principal, np.zeros((len(chosen), 3)))
    lifted = np.einsum("fji,fnj->fni", bundle.rotation, _lift(uv, z, found, principal)) + bundle.center[:, None]
    points = np.nanmedian(np.where(visible[..., None], lifted, np.nan), axis=0)
    known = np.isfinite(points).all(1)
    bundle = replace(bundle, points=np.where(known[:, None], points, 0.0))
    observations = observations.keep(known[observations.point])
    errors = [float(min(value, 1e3)) for value in curve]
    search = {"focal_over_width": [float(candidate / width) for candidate in candidates], "error_px": errors}
    return Solution(bundle, observations, np.ones(len(tracks), bool)), search


@dataclass(frozen=True)
class ColmapSettings:
    """Settings of incremental mapping by pycolmap."""

    focal: float
    """Pixels."""
    focal_known: bool
    """`focal` is more than a guess."""
    features: int
    """At most this many per picture."""
    threads: int
    seed: int


def solve_with_colmap(
    pictures: Sequence[np.ndarray], masks: np.ndarray | None, settings: ColmapSettings
) -> Solution | None:
    """Return incremental mapping by pycolmap in a child process; None when pycolmap is missing or finds nothing.

    `pictures` are (H, W, 3) uint8 RGB, `masks (F, H, W)` bool the moving pixels, which are ignored. First the focal length
    is held at the given value, which keeps turning cameras from collapsing; when that leaves frames out and the value is
    only a guess, a second run solves for it.
    """
    import cv2

    height, width = pictures[0].shape[:2]
    with tempfile.TemporaryDirectory(prefix="f4x-cameras-") as name:
        folder = Path(name)
        names = [f"{i:05d}.png" for i in range(len(pictures))]
        (folder / "images").mkdir()
        for file, picture in zip(names, pictures, strict=True):
            cv2.imwrite(str(folder / "images" / file), cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2BGR))
        if masks is not None and masks.any():
            (folder / "masks").mkdir()
            for file, mask in zip(names, masks, strict=True):
                cv2.imwrite(str(folder / "masks" / f"{file}.png"), np.where(mask, 0, 255).astype(np.uint8))
        request = {
            "folder": name,
            "names": names,
            "pairs": [(i, i + gap) for gap in MATCH_GAPS for i in range(len(names) - gap)],
            "focal": settings.focal,
            "refine_focal": False,
            "max_features": settings.features,
            "threads": settings.threads,
            "seed": settings.seed,
        }
        best = _ask_colmap(request, (width, height))
        if not settings.focal_known and (best is None or best.registered.mean() < 0.9):
            free = _ask_colmap(request | {"refine_focal": True}, (width, height))
            plausible = free is not None and FOCALS[0] <= free.bundle.focal / max(width, height) <= FOCALS[-1]
            if plausible and (best is None or free.registered.sum() > best.registered.sum()):  # type: ignore[union-attr]
                best = free
    return best


def search_focal(
    solution: Solution, width: int, candidates: Sequence[float], expected: float = DEFAULT_FOCAL
) -> tuple[Solution, dict[str, list[float]]]:
    """Return a sample of a turning camera adjusted at the focal length its observations prefer, and the curve of errors.

    `candidates` and `expected` are in picture widths. For each the turns and directions of the sample are adjusted with the focal
    length held; `FOCAL_PRIOR` decides where the curve is flat (little rotation).
    """
    sample, _ = subset(solution, 400, 24)
    if not len(sample.observations.frame):
        return sample, {}
    settings = BundleConfig(iterations=8, refine_focal=False, refine_centers=False)

    def held(factor: float) -> Solution:
        start = refocused(sample, factor * width, translating=False)
        return replace(start, bundle=adjust(start.bundle, start.observations, settings))

    found = in_threads(held, candidates)
    errors = np.array([solution.error for solution in found])
    penalised = errors * (1 + FOCAL_PRIOR * np.log(np.array(candidates) / expected) ** 2)
    curve = {"focal_over_width": list(candidates), "error_px": errors.round(4).tolist()}
    return found[int(np.argmin(penalised))], curve


def sampled(solution: Solution) -> tuple[Solution, np.ndarray]:
    """Return a smaller solution and its frames; more frames are sampled where tracks are too short to be seen in three of them."""
    frames = SAMPLED_FRAMES
    while True:
        sample, kept = subset(solution, SAMPLED_POINTS, frames)
        holding = np.bincount(sample.observations.frame, minlength=len(kept))
        enough = len(sample.bundle.points) >= MIN_SAMPLED_POINTS and (holding >= MIN_POINTS_PER_FRAME).all()
        if enough or len(kept) == solution.registered.sum() or frames >= MAX_SAMPLED_FRAMES:
            return sample, kept
        frames *= 2


def best_focal(solution: Solution, lens: BundleConfig) -> tuple[float, dict[str, list[float]]]:
    """Return the focal length in pixels at which a sample of the solution costs least, and the curve of errors.

    Through a long lens a pan looks like a walk along a wall: both are minima of their own, with nothing in between that leads from
    one to the other. So focal lengths are held one after the other, each from the cameras found with the one before. A world
    without relief is as unusual as a long lens: there the usual one is hardly believed.
    """
    sample, _ = subset(solution, 400, 24)
    if not len(sample.observations.frame):
        return solution.bundle.focal, {}
    held = replace(lens, iterations=HELD_ITERATIONS, refine_focal=False)
    inverse = 1 / np.maximum(sample.bundle.local(sample.observations)[:, 2], 1e-9)
    far, usual, near = np.percentile(inverse, (10, 50, 90))
    flat = near - far < FLAT * usual
    believed = replace(lens, focal_prior=BELIEF_IN_FLAT * lens.focal_prior) if flat else lens

    def tried(steps: range) -> list[Solution]:
        found, one = [], sample
        for step in steps:
            start = refocused(one, sample.bundle.focal * FOCAL_STEP**step)
            one = replace(
                start, bundle=adjust(with_points_ahead(start.bundle, start.observations), start.observations, held)
            )
            found.append(one)
        return found

    longer, shorter = in_threads(tried, (range(LONGER + 1), range(-1, -SHORTER - 1, -1)))
    found = sorted([*longer, *shorter], key=lambda one: one.bundle.focal)
    best = min(found, key=lambda one: total_cost(one.bundle, one.observations, believed))
    curve = {
        "focal_over_width": [round(one.bundle.focal / (2 * one.bundle.principal[0]), 4) for one in found],
        "error_px": [round(one.error, 4) for one in found],
    }
    return best.bundle.focal, curve


def refocused(solution: Solution, focal: float, translating: bool = True) -> Solution:
    """Return the solution with another focal length: rotations shrink or grow so that the picture turns as fast as before."""
    bundle, middle = solution.bundle, len(solution.bundle.rotation) // 2
    reference = bundle.rotation[middle]
    relative = quaternion.to_rotation_vector(quaternion.from_matrix(bundle.rotation @ reference.T))
    turned = quaternion.to_matrix(quaternion.from_rotation_vector(relative * bundle.focal / focal))
    bundle = replace(bundle, rotation=turned @ reference, focal=focal)
    if not translating:
        return replace(solution, bundle=on_sphere(bundle, solution.observations))
    points, _ = triangulate(bundle, solution.observations, len(bundle.points))
    return replace(solution, bundle=replace(bundle, points=np.where(np.isfinite(points), points, bundle.points)))


def adjust_known(bundle: Bundle, observations: Observations, registered: np.ndarray, config: BundleConfig) -> Bundle:
    """Run `bundle.adjust` on the registered frames and finite points alone; the others stay unchanged."""
    frames, points = np.flatnonzero(registered), np.flatnonzero(np.isfinite(bundle.points).all(1))
    seen = observations.keep(registered[observations.frame] & np.isin(observations.point, points))
    if not len(seen.frame):
        return bundle
    frame_row, point_row = np.zeros(len(registered), int), np.zeros(len(bundle.points), int)
    frame_row[frames], point_row[points] = np.arange(len(frames)), np.arange(len(points))
    part = replace(bundle.of_frames(frames), points=bundle.points[points])
    seen = replace(seen, frame=frame_row[seen.frame], point=point_row[seen.point])
    part = adjust(part, seen, config)
    xyz = bundle.points.copy()
    xyz[points] = part.points
    return replace(bundle.with_frames(frames, part), points=xyz)


def mean_directions(bundle: Bundle, observations: Observations) -> np.ndarray:
    """Return unit mean directions of the sightings of each point in the world, `(P, 3)`; 0 for a point that nobody sees."""
    directions = np.zeros_like(bundle.points)
    np.add.at(directions, observations.point, rays(bundle, observations))
    return directions / (np.linalg.norm(directions, axis=1, keepdims=True) + 1e-12)


def with_points_ahead(bundle: Bundle, seen: Observations) -> Bundle:
    """Return the points with those behind a camera that saw them moved to infinity: their rays diverge by noise alone."""
    behind = np.zeros(len(bundle.points), bool)
    behind[seen.point[bundle.local(seen)[:, 2] <= 0]] = True
    middle = bundle.center.mean(0)
    reach = np.linalg.norm(bundle.center - middle, axis=1).max()
    far = middle + INFINITY * reach * mean_directions(bundle, seen)
    return replace(bundle, points=np.where(behind[:, None], far, bundle.points))


def on_sphere(bundle: Bundle, observations: Observations) -> Bundle:
    """Return the points at distance 1 in the mean direction of their sightings: a world without depth."""
    return replace(bundle, points=mean_directions(bundle, observations))


def subset(solution: Solution, points: int, frames: int) -> tuple[Solution, np.ndarray]:
    """Return a smaller problem with the same geometry, and its frames: evenly spaced ones, and points that hold them all."""
    registered = np.flatnonzero(solution.registered)
    kept = registered[evenly_spaced(len(registered), frames)]
    finite = np.isfinite(solution.bundle.points).all(1)
    seen = solution.observations.keep(np.isin(solution.observations.frame, kept) & finite[solution.observations.point])
    often = np.bincount(seen.point, minlength=len(finite)) >= 3
    chosen = choose_covering_points(seen.visible(len(solution.registered), len(finite))[kept] & often, points)
    seen = seen.keep(np.isin(seen.point, chosen))
    bundle = replace(solution.bundle.of_frames(kept), points=solution.bundle.points[chosen])
    seen = replace(seen, frame=np.searchsorted(kept, seen.frame), point=np.searchsorted(chosen, seen.point))
    return Solution(bundle, seen, np.ones(len(kept), bool)), kept


def _structure(bundle: Bundle, observations: Observations, registered: np.ndarray) -> Bundle:
    """Return the points triangulated from the registered frames; those with narrow rays or large errors are NaN."""
    seen = observations.keep(registered[observations.frame])
    points, spread = triangulate(bundle, seen, len(bundle.points))
    bundle = replace(bundle, points=points)
    error = np.nan_to_num(bundle.errors(seen), nan=np.inf)
    order = np.lexsort((error, seen.point))
    length = np.bincount(seen.point, minlength=len(points))
    median = np.full(len(points), np.inf)
    first = np.cumsum(length) - length
    has = length > 0
    median[has] = error[order][(first + length // 2)[has]]
    points[(spread < MIN_SPREAD) | (median > MAX_ERROR_PX)] = np.nan
    return bundle


def _first_pair(
    tracks: np.ndarray, visible: np.ndarray, focal: float, principal: np.ndarray, seed: int
) -> tuple[int, int, np.ndarray, np.ndarray] | None:
    """Return two frames with parallax and their relative pose (first camera at the origin), or None."""
    import cv2

    best: tuple[float, int, int] | None = None
    step = max(len(tracks) // 12, 1)
    for i in range(0, len(tracks), step):
        for j in range(i + step, len(tracks), step):
            shared = visible[i] & visible[j]
            if shared.sum() < 2 * MIN_SHARED:
                continue
            a, b = (bearings(tracks[k, shared].astype(np.float64), focal, principal) for k in (i, j))
            _, residual = rotation_between(a, b, focal)
            # Parallax saturates: beyond 5 % of the focal length more shared tracks are worth more.
            score = min(float(np.percentile(residual, 75)), 0.05 * focal) * np.sqrt(shared.sum())
            if best is None or score > best[0]:
                best = (score, i, j)
    if best is None:
        return None
    _, i, j = best
    shared = visible[i] & visible[j]
    matrix = np.array([[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1.0]])
    a, b = tracks[i, shared].astype(np.float64), tracks[j, shared].astype(np.float64)
    cv2.setRNGSeed(seed)
    try:
        essential, inliers = cv2.findEssentialMat(a, b, matrix, cv2.RANSAC, 0.999, 1.0)
        if essential is None or essential.shape != (3, 3):
            return None
        good, rotation, translation, _ = cv2.recoverPose(essential, a, b, matrix, mask=inliers)
    except cv2.error:  # degenerate correspondences
        return None
    return (i, j, rotation, translation[:, 0]) if good >= MIN_SHARED else None


def _next_frame(registered: np.ndarray, observations: Observations, bundle: Bundle) -> int | None:
    """Return the unregistered frame that sees most known points, among those next to a registered one."""
    known = np.isfinite(bundle.points).all(1)
    count = np.bincount(observations.frame[known[observations.point]], minlength=len(registered))
    count = np.where(beside(registered) & ~registered, count, 0)
    return int(np.argmax(count)) if count.max() >= MIN_SHARED // 2 else None


def beside(chosen: np.ndarray) -> np.ndarray:
    """Return (F,) bool: frames one before or behind a chosen one."""
    near = np.zeros_like(chosen)
    near[1:] |= chosen[:-1]
    near[:-1] |= chosen[1:]
    return near


def _set_pose(bundle: Bundle, frame: int, rotation: np.ndarray, center: np.ndarray) -> Bundle:
    rotations, centers = bundle.rotation.copy(), bundle.center.copy()
    rotations[frame], centers[frame] = rotation, center
    return replace(bundle, rotation=rotations, center=centers)


def _lift(uv: np.ndarray, z: np.ndarray, focal: float, principal: np.ndarray) -> np.ndarray:
    """Return the points `(..., 3)` in camera axes."""
    return np.concatenate([(uv - principal) / focal, np.ones_like(uv[..., :1])], axis=-1) * z[..., None]


def _robust_alignment(a: np.ndarray, b: np.ndarray, with_scale: bool) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the similarity `b ~ s R a + t` with Cauchy weights relative to depth, so that far points do not dominate."""
    weight = 1 / b[:, 2] ** 2
    for _ in range(6):
        scale, rotation, shift = pose.align_similarity(a, b, weight, with_scale)
        residual = np.linalg.norm(b - (scale * a @ rotation.T + shift), axis=1) / b[:, 2]
        weight = 1 / b[:, 2] ** 2 / (1 + (residual / max(float(np.median(residual)), 1e-4)) ** 2)
    return scale, rotation, shift


def _alignment_error(
    tracks: np.ndarray,
    visible: np.ndarray,
    z: np.ndarray,
    pairs: list[tuple[int, int]],
    focal: float,
    principal: np.ndarray,
) -> float:
    """Return the median symmetric reprojection error in pixels after aligning the lifted tracks of every pair, averaged."""
    errors = []
    for i, j in pairs:
        shared = visible[i] & visible[j]
        if shared.sum() < MIN_SHARED:
            continue
        a, b = (_lift(tracks[k, shared].astype(np.float64), z[k, shared], focal, principal) for k in (i, j))
        scale, rotation, shift = _robust_alignment(a, b, with_scale=True)
        there, back = scale * a @ rotation.T + shift, (b - shift) @ rotation / scale
        pixels = [
            focal * np.linalg.norm(p[:, :2] / np.maximum(p[:, 2:], 1e-6) - q[:, :2] / q[:, 2:], axis=1)
            for p, q in ((there, b), (back, a))
        ]
        errors.append(float(np.median(pixels)))
    return float(np.mean(errors)) if errors else np.inf


def _ask_colmap(request: dict, size: tuple[int, int]) -> Solution | None:
    """Run the child on a request; None when pycolmap is not installed, fails, or registers fewer than three frames."""
    folder = Path(request["folder"])
    (folder / "request.json").write_text(json.dumps(request))
    # A script path with -P instead of -m: the package may be nested in another one, and this room holds names like `files`.
    script = Path(__file__).with_name("colmap_child.py")
    command = [sys.executable, "-P", str(script), str(folder / "request.json")]
    try:
        child = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise F4xError(
            f"{sys.executable} cannot be started for the camera solver ({error}); repair the environment."
        ) from error
    if child.returncode or not (folder / "answer.npz").exists():
        return None
    with np.load(folder / "answer.npz") as answer:
        registered = np.zeros(len(request["names"]), bool)
        registered[answer["registered"]] = True
        matrices = np.tile(np.eye(4), (len(registered), 1, 1))
        matrices[answer["registered"]] = answer["world_to_camera"]
        principal = np.array(size, np.float64) / 2
        bundle = from_matrices(matrices, float(answer["focal"]), principal, answer["points"])
        # A feature with two orientations can sight one point twice in a frame; the solver wants it once.
        _, once = np.unique(answer["frame"] * (len(answer["points"]) + 1) + answer["point"], return_index=True)
        uv = answer["uv"][once]
        observations = Observations(answer["frame"][once], answer["point"][once], uv, np.ones(len(once)))
    return Solution(bundle, observations, registered) if registered.sum() >= 3 else None
