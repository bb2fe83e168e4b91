"""Static bundle adjustment: cameras, focal length and points from 2-D observations of what does not move.

`u = f * x / z + principal` with `x = R (X - c)`: R world-to-camera, c the camera centre. Levenberg-Marquardt on the
robust squared error, the points eliminated by the Schur complement (Triggs et al. 2000, section 6.1). The camera system is
small and dense (6 F + 1 unknowns), so plain BLAS is fastest and nothing but numpy and scipy is needed. Points couple only the
cameras that see them, so they are eliminated in groups that are seen in the same run of frames: memory and time of a long clip
grow with the length of its tracks and not with that of the clip. A lens that zooms has a focal length in every frame, one
unknown more per frame.

While they are adjusted, points are homogeneous unit 4-vectors `(X, w)`, `x = R (X - w c)`, and steps are taken in their
tangent space (Triggs et al. 2000, section 2.2): a point at infinity is nothing special, so a camera that hardly moves is
solved as well as one that walks. With points `(X, 1)` a few steps carried far points past infinity, and the solution of a
clip with little translation depended on where it started.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ..geometry import pose, quaternion
from ..geometry.camera import CameraPath
from ..native import open_library
from ..native.bundle import F4X_BUNDLE_COSTS, F4X_BUNDLE_EQUATIONS, SIGHTINGS

ROBUST_PX = 1.0
"""Cauchy scale in pixels: good tracks stay below, a wrong one soon stops pulling."""
MIN_DEPTH = 1e-6
"""Points nearer to a camera plane than this carry no weight in that view."""
MAX_POINT_DISTANCE = 1e4
"""Points stay within this many median distances: beyond, nothing tells them from infinity."""
FOCAL_PRIOR, FOCAL_SPREAD, DEPTH_PRIOR, PATH_PRIOR = 0.04, 0.15, 0.002, 0.01
"""Weights of the priors, as fractions of the squared error that a violation must save: a focal length
whose logarithm is `FOCAL_SPREAD` away from the expected one (with long tails: lenses differ), inverse distances that vary by
their median, and a path as large as the median distance. They decide only what observations leave open (bas-relief: with
little translation depth, path and focal length trade for each other). On rendered clips focal lengths 14 % apart fit tracks
within 0.3 % of the cost."""
FOCAL_REACH = float(np.log(4))
"""Logarithm of the largest ratio to the expected focal length that real lenses have: wide angles of phones and their longest
lenses are within a factor of 3.7 of the usual one. Beyond, the prior grows with the square, or cameras of a world without relief
flee to infinity."""
ZOOM_PRIOR, ZOOM_CHANGE = 0.01, 0.005
"""Weight of the prior of a zoom, as a fraction of the squared error like `FOCAL_PRIOR`: second differences over the frames
of the logarithm of the focal length are about `ZOOM_CHANGE`; a zoom by 1.5 that starts and stops within half a second has 0.006."""
UPPER = np.triu_indices(3)
"""Rows and columns of the six different entries of a symmetric matrix."""
BEHIND_PX = 1000.0
"""A point behind a camera that saw it costs as much as a miss by this many pixels."""
MIN_SEEN = 3
"""Frames that must see a point: two rays alone fit wrong cameras, except across the epipolar line."""
RUN_STEP = 16
"""Points are grouped by the first and the last frame that see them, in steps of so many frames."""


@dataclass(frozen=True)
class Observations:
    """Sightings of points in pictures, one row each."""

    frame: np.ndarray
    """(O,) int, which camera."""
    point: np.ndarray
    """(O,) int, which point."""
    uv: np.ndarray
    """(O, 2) float64 pixels, pixel centres at +0.5."""
    weight: np.ndarray
    """(O,) float64 trust."""

    def keep(self, chosen: np.ndarray) -> Observations:
        """Return the chosen rows (mask or indices)."""
        return Observations(self.frame[chosen], self.point[chosen], self.uv[chosen], self.weight[chosen])

    def followed_by(self, other: Observations, first: int) -> Observations:
        """Return these sightings, then those of `other`, whose points are numbered from `first` on."""
        return Observations(
            np.concatenate([self.frame, other.frame]),
            np.concatenate([self.point, other.point + first]),
            np.concatenate([self.uv, other.uv]),
            np.concatenate([self.weight, other.weight]),
        )

    def by_frame(self, frames: int) -> list[Observations]:
        """Return the sightings of each frame."""
        order = np.argsort(self.frame, kind="stable")
        ends = np.searchsorted(self.frame[order], np.arange(frames + 1))
        return [self.keep(order[start:end]) for start, end in pairwise(ends)]

    def of_points(self) -> tuple[np.ndarray, Observations]:
        """Return the indices of the points that are sighted at all, and the sightings with points counted among these."""
        used, point = np.unique(self.point, return_inverse=True)
        return used, replace(self, point=point)

    def visible(self, frames: int, points: int) -> np.ndarray:
        """Return (frames, points) bool: which point was seen in which frame."""
        seen = np.zeros((frames, points), bool)
        seen[self.frame, self.point] = True
        return seen


@dataclass(frozen=True)
class Bundle:
    """Cameras and points that belong together, in any world unit."""

    focal: float
    """Pixels, the same in x and y; where the lens zooms, the geometric mean over the frames."""
    principal: np.ndarray
    """(2,) pixels."""
    rotation: np.ndarray
    """(F, 3, 3) world to camera."""
    center: np.ndarray
    """(F, 3) camera centres in the world."""
    points: np.ndarray
    """(P, 3) world."""
    zoom: np.ndarray | None = None
    """(F,) focal length of every frame over `focal`; None = the lens does not zoom."""

    @property
    def focals(self) -> np.ndarray:
        """(F,) focal lengths in pixels."""
        return self.focal * (np.ones(len(self.center)) if self.zoom is None else self.zoom)

    @property
    def world_to_camera(self) -> np.ndarray:
        """(F, 4, 4) rigid matrices."""
        matrix = np.tile(np.eye(4), (len(self.center), 1, 1))
        matrix[:, :3, :3] = self.rotation
        matrix[:, :3, 3] = -np.einsum("fij,fj->fi", self.rotation, self.center)
        return matrix

    @property
    def intrinsics(self) -> np.ndarray:
        """(F, 3, 3) pixels."""
        lens = np.tile(np.eye(3), (len(self.center), 1, 1))
        lens[:, 0, 0] = lens[:, 1, 1] = self.focals
        lens[:, :2, 2] = self.principal
        return lens

    def path(self, times: np.ndarray, width: int, height: int) -> CameraPath:
        """Return the cameras at their `times (F,)` in clip frames."""
        return CameraPath(self.intrinsics, self.world_to_camera, np.asarray(times, np.float64), width, height)

    def of_frames(self, frames: np.ndarray) -> Bundle:
        """Return the cameras `frames` (mask or indices) alone, with all points."""
        zoom = None if self.zoom is None else self.zoom[frames]
        return replace(self, rotation=self.rotation[frames], center=self.center[frames], zoom=zoom)

    def with_frames(self, frames: np.ndarray, found: Bundle) -> Bundle:
        """Return all cameras, those of `frames` as in `found`, which gives the focal length, too; the points stay."""
        rotation, center = self.rotation.copy(), self.center.copy()
        rotation[frames], center[frames] = found.rotation, found.center
        zoom = self.zoom
        if found.zoom is not None:
            zoom = self.focals / found.focal
            zoom[frames] = found.zoom
        return replace(self, focal=found.focal, rotation=rotation, center=center, zoom=zoom)

    def local(self, observations: Observations) -> np.ndarray:
        """Return the observed points in the axes of their cameras, `(O, 3)`."""
        offset = self.points[observations.point] - self.center[observations.frame]
        return np.einsum("oij,oj->oi", self.rotation[observations.frame], offset)

    def residuals(self, observations: Observations) -> np.ndarray:
        """Return the projection minus observation in pixels, `(O, 2)`; infinite behind the camera."""
        local = self.local(observations)
        ahead = local[:, 2:] > MIN_DEPTH
        focal = self.focals[observations.frame, None]
        projected = focal * local[:, :2] / np.where(ahead, local[:, 2:], 1.0) + self.principal
        return np.where(ahead, projected - observations.uv, np.inf)

    def errors(self, observations: Observations) -> np.ndarray:
        """Return the reprojection error in pixels, `(O,)`."""
        return np.linalg.norm(self.residuals(observations), axis=1)


@dataclass(frozen=True)
class BundleConfig:
    """Settings of `adjust`."""

    iterations: int = 20
    """Most Levenberg-Marquardt steps; it stops earlier when the error falls by less than 1e-4 of itself."""
    refine_focal: bool = True
    """Solve for the focal length too."""
    refine_zoom: bool = False
    """Solve for a focal length in every frame."""
    refine_centers: bool = True
    """Solve for camera centres; off, only rotations move (pan-only clips: points are directions)."""
    robust_px: float = ROBUST_PX
    """Cauchy scale in pixels."""
    expected_focal: float | None = None
    """Focal length in pixels that is believed as far as observations leave it open; None = no belief."""
    focal_prior: float = FOCAL_PRIOR
    """Fraction of the squared error that another focal length must save (`FOCAL_PRIOR`)."""
    relief: float = 1.0
    """Expected deviation of inverse distances from their median, relative to it (`DEPTH_PRIOR`): 1 for a world around the
    camera, less for one object seen from afar, whose depth is about what its width and height are."""

    @property
    def unknowns(self) -> int:
        """Number of unknowns of one camera: rotation, centre and, where the lens zooms, the logarithm of its focal length."""
        return 7 if self.refine_zoom else 6


def rays(bundle: Bundle, observations: Observations) -> np.ndarray:
    """Return unit viewing directions in the world, `(O, 3)`."""
    plane = (observations.uv - bundle.principal) / bundle.focals[observations.frame, None]
    local = np.column_stack([plane, np.ones(len(plane))])
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    return np.einsum("oji,oj->oi", bundle.rotation[observations.frame], local)


def triangulate(
    bundle: Bundle, observations: Observations, count: int, rounds: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points nearest to their viewing rays: `(count, 3)` and the spread of the rays `(count,)` in radians.

    `X = argmin sum w |(I - d d^T)(X - c)|^2 / distance^2`, the distances from the round before, so that the error is
    angular. Spread is the largest angle to the point's mean ray, doubled. Points seen less than twice are NaN.
    """
    directions, centers = rays(bundle, observations), bundle.center[observations.frame]
    sums = _incidence(observations.point, count)
    across = np.eye(3)[UPPER] - directions[:, UPPER[0]] * directions[:, UPPER[1]]  # (O, 6) of I - d d^T
    right = centers - directions * np.einsum("oi,oi->o", directions, centers)[:, None]
    terms = np.concatenate([across, right], 1)  # one sparse product adds up both sides
    weight, points, normal = observations.weight, np.zeros((count, 3)), np.empty((count, 3, 3))
    for _ in range(rounds):
        summed = sums @ (terms * weight[:, None])
        normal[:, UPPER[0], UPPER[1]] = normal[:, UPPER[1], UPPER[0]] = summed[:, :6]
        right = summed[:, 6:]
        scale = np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-300
        points = np.linalg.solve(normal / scale + 1e-12 * np.eye(3), right[..., None] / scale)[..., 0]
        distance = np.linalg.norm(points[observations.point] - centers, axis=1)
        weight = observations.weight / np.maximum(distance, 1e-9) ** 2
    mean = sums @ (directions * observations.weight[:, None])
    mean /= np.linalg.norm(mean, axis=1, keepdims=True) + 1e-300
    cosine = np.clip((mean[observations.point] * directions).sum(1), -1, 1)
    spread = np.zeros(count)
    np.maximum.at(spread, observations.point, 2 * np.arccos(cosine))
    points[np.bincount(observations.point, minlength=count) < 2] = np.nan
    return points, spread


def adjust(bundle: Bundle, observations: Observations, config: BundleConfig | None = None) -> Bundle:
    """Move cameras, focal length and points to the least robust reprojection error.

    World unit, origin and axes are only held by the damping. There is no smoothness prior on the path: on rendered truth
    any weight moved the cameras away from it, because hand shake is real. Source: Triggs et al., "Bundle Adjustment - A
    Modern Synthesis", 2000.
    """
    if not len(observations.frame):
        return bundle
    config = config or BundleConfig()
    origin, unit = bundle.center[len(bundle.center) // 2], _unit(bundle)
    problem, groups = _Problem.of(bundle, origin, unit), _grouped(observations, len(bundle.points))
    damping, cost = 1e-4, _costs(problem, observations, config).sum()
    for _ in range(config.iterations):
        belief = cost  # priors weigh as much as a fraction of the present error
        total = cost + _prior_cost(problem, config, belief)
        equations = _normal_equations(problem, groups, config, belief)
        for _ in range(8):
            moved = problem.moved(*_solve(equations, damping, len(problem.center)), config)
            moved_cost = _costs(moved, observations, config).sum()
            moved_total = moved_cost + _prior_cost(moved, config, belief)
            if moved_total < total:
                break
            damping *= 8
        else:
            break
        finished = total - moved_total < 1e-4 * total
        problem, cost, damping = moved.centred(), moved_cost, max(damping / 5, 1e-9)
        if finished:
            break
    return problem.bundle(origin, unit, bundle.zoom is not None or config.refine_zoom)


def total_cost(bundle: Bundle, observations: Observations, config: BundleConfig) -> float:
    """Return the cost that `adjust` minimises, per observation (px^2): robust squared error and the priors of lens and world."""
    problem = _Problem.of(bundle, bundle.center[len(bundle.center) // 2], _unit(bundle)).centred()
    cost = _costs(problem, observations, config).sum()
    return (cost + _prior_cost(problem, config, cost)) / max(len(observations.frame), 1)


def sighting_costs(bundle: Bundle, observations: Observations, config: BundleConfig) -> np.ndarray:
    """Return robust squared error of every sighting, `(O,)` px^2, by its weight."""
    return observations.weight * _robust((bundle.residuals(observations) ** 2).sum(1), config)


def resect(
    bundle: Bundle, observations: Observations, frames: np.ndarray, iterations: int = 15, robust_px: float = 2.0
) -> Bundle:
    """Return the cameras `frames` re-solved from known points, each by itself, starting where it stands; all others stay."""
    chosen = np.isin(observations.frame, frames) & np.isfinite(bundle.points[observations.point]).all(1)
    seen, config = observations.keep(chosen), BundleConfig(refine_focal=False, robust_px=robust_px)
    if not len(seen.frame):
        return bundle
    used, seen = seen.of_points()
    problem = _Problem.of(replace(bundle, points=bundle.points[used]), np.zeros(3), 1.0)
    damping, cost = 1e-3, _costs(problem, seen, config)
    for _ in range(iterations):
        sums = _sums(problem, seen, config, held_points=True)
        normal, gradient = sums.blocks[:, :6, :6], sums.slopes[:, :6]
        diagonal = np.einsum("fii->fi", normal)
        damped = normal + damping * diagonal[:, :, None] * np.eye(6) + 1e-9 * np.eye(6)
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        turn = quaternion.to_matrix(quaternion.from_rotation_vector(step[:, :3]))
        moved = replace(problem, rotation=turn @ problem.rotation, center=problem.center + step[:, 3:])
        moved_cost = _costs(moved, seen, config)
        better = moved_cost < cost  # (F,)
        problem = replace(
            problem,
            rotation=np.where(better[:, None, None], moved.rotation, problem.rotation),
            center=np.where(better[:, None], moved.center, problem.center),
        )
        cost = np.where(better, moved_cost, cost)
        damping = damping / 3 if better.any() else damping * 10
    return replace(bundle, rotation=problem.rotation, center=problem.center)


def _incidence(index: np.ndarray, count: int) -> csr_matrix:
    """Return the sparse `(count, O)` matrix that adds up the rows with equal index."""
    order = np.arange(len(index))
    return csr_matrix((np.ones(len(index)), (index, order)), shape=(count, len(index)))


def _unit(bundle: Bundle) -> float:
    """Return the median distance of the finite points from the middle camera; 1 without any."""
    distance = np.linalg.norm(bundle.points - bundle.center[len(bundle.center) // 2], axis=1)
    distance = distance[np.isfinite(distance)]
    return max(float(np.median(distance)), 1e-12) if len(distance) else 1.0


@dataclass(frozen=True)
class _Problem:
    """A bundle while it is adjusted: the middle camera near the origin, median distance near 1, homogeneous points."""

    focal: float
    zoom: np.ndarray
    """(F,) focal length of every frame over `focal`."""
    principal: np.ndarray
    rotation: np.ndarray
    """(F, 3, 3) world to camera."""
    center: np.ndarray
    """(F, 3)."""
    points: np.ndarray
    """(P, 4) of length 1, the last one not negative."""
    origin: np.ndarray
    """(3,) where its origin lies in the axes it began with."""
    unit: float
    """Its unit in the one it began with."""

    @classmethod
    def of(cls, bundle: Bundle, origin: np.ndarray, unit: float) -> _Problem:
        points = np.column_stack([(bundle.points - origin) / unit, np.ones(len(bundle.points))])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        center = (bundle.center - origin) / unit
        zoom = bundle.focals / bundle.focal
        return cls(bundle.focal, zoom, bundle.principal, bundle.rotation, center, points, np.zeros(3), 1.0)

    def bundle(self, origin: np.ndarray, unit: float, zooms: bool) -> Bundle:
        """Return the solution in the world that `of` was given, with its `origin` and `unit`; `zooms`: with the zooms."""

        def outside(xyz: np.ndarray) -> np.ndarray:
            return origin + unit * (self.origin + self.unit * xyz)

        distance = np.linalg.norm(self.points[:, :3], axis=1, keepdims=True)
        points = self.points[:, :3] / np.maximum(self.points[:, 3:], np.maximum(distance, 1e-12) / MAX_POINT_DISTANCE)
        zoom = self.zoom if zooms else None
        return Bundle(self.focal, self.principal, self.rotation, outside(self.center), outside(points), zoom)

    @property
    def focals(self) -> np.ndarray:
        """(F,) focal lengths in pixels."""
        return self.focal * self.zoom

    @property
    def inverse_distance(self) -> np.ndarray:
        """(P,) inverse distances of the points from the origin."""
        return self.points[:, 3] / np.maximum(np.linalg.norm(self.points[:, :3], axis=1), 1e-9)

    @property
    def tangents(self) -> np.ndarray:
        """(P, 4, 3) orthonormal directions in which a point of the unit sphere can move (a Householder reflection)."""
        normal = self.points.copy()
        normal[:, 3] += 1.0
        reflection = np.eye(4) - 2 * normal[:, :, None] * normal[:, None, :] / (normal**2).sum(1)[:, None, None]
        return reflection[:, :, :3]

    def part(self, group: _Group) -> _Problem:
        """Return the cameras and points of a group."""
        run = group.run
        return replace(
            self,
            zoom=self.zoom[run],
            rotation=self.rotation[run],
            center=self.center[run],
            points=self.points[group.points],
        )

    def local(self, frame: int, points: np.ndarray) -> np.ndarray:
        """Return homogeneous `points (n, 4)` in the axes of a camera, `(3, n)`, scaled by the length of the homogeneous vector."""
        return self.rotation[frame] @ (points[:, :3] - points[:, 3:] * self.center[frame]).T

    def moved(self, cameras: np.ndarray, focal: float, points: np.ndarray, config: BundleConfig) -> _Problem:
        """Return the problem after a step of the cameras `(F, 6)`, or `(F, 7)` with the logarithm of their zoom, of the logarithm
        of the focal length, and of the points `(P, 3)`."""
        turn = quaternion.to_matrix(quaternion.from_rotation_vector(cameras[:, :3]))
        stepped = self.points + np.einsum("pij,pj->pi", self.tangents, points)
        farthest = np.linalg.norm(stepped[:, :3], axis=1) / MAX_POINT_DISTANCE
        stepped[:, 3] = np.maximum(stepped[:, 3], farthest)  # nothing lies beyond infinity
        return replace(
            self,
            rotation=np.einsum("fij,fjk->fik", turn, self.rotation),
            center=self.center + cameras[:, 3:6] if config.refine_centers else self.center,
            zoom=self.zoom * np.exp(np.clip(cameras[:, 6], -0.3, 0.3)) if config.refine_zoom else self.zoom,
            focal=self.focal * float(np.exp(np.clip(focal, -0.3, 0.3))),
            points=stepped / np.linalg.norm(stepped, axis=1, keepdims=True),
        )

    def centred(self) -> _Problem:
        """Return the same with the middle camera at the origin, the median inverse distance 1 and the mean zoom 1."""
        shift = self.center[len(self.center) // 2]
        xyz = self.points[:, :3] - self.points[:, 3:] * shift
        inverse = self.points[:, 3] / np.maximum(np.linalg.norm(xyz, axis=1), 1e-9)
        factor = max(float(np.median(inverse)), 1e-3)
        points = np.column_stack([xyz, self.points[:, 3] / factor])
        usual = float(np.exp(np.log(self.zoom).mean()))
        return replace(
            self,
            focal=self.focal * usual,
            zoom=self.zoom / usual,
            center=(self.center - shift) * factor,
            points=points / np.linalg.norm(points, axis=1, keepdims=True),
            origin=self.origin + self.unit * shift,
            unit=self.unit / factor,
        )


def _robust(squared: np.ndarray, config: BundleConfig) -> np.ndarray:
    """Return the Cauchy cost of squared errors (px^2); infinite ones count as misses by `BEHIND_PX`."""
    scale = config.robust_px**2
    return scale * np.log1p(np.where(np.isfinite(squared), squared, BEHIND_PX**2) / scale)


def _costs(problem: _Problem, observations: Observations, config: BundleConfig) -> np.ndarray:
    """Return (F,) cost of the sightings of every frame."""
    if open_library()[0] is None:
        return _plain_costs(problem, observations, config)
    costs = np.empty(len(problem.center))
    F4X_BUNDLE_COSTS(_sightings(problem, observations, config, costs=costs))
    return costs


def _plain_costs(problem: _Problem, observations: Observations, config: BundleConfig) -> np.ndarray:
    costs = np.zeros(len(problem.center))
    for frame, seen in enumerate(observations.by_frame(len(costs))):
        local = problem.local(frame, problem.points[seen.point])
        ahead = local[2] > MIN_DEPTH
        plane = problem.focals[frame] * local[:2] / np.where(ahead, local[2], 1.0) + problem.principal[:, None]
        squared = np.where(ahead, ((plane - seen.uv.T) ** 2).sum(0), np.inf)
        costs[frame] = (seen.weight * _robust(squared, config)).sum()
    return costs


def _sightings(problem: _Problem, observations: Observations, config: BundleConfig, **outputs: np.ndarray) -> Any:
    """Return the problem of the compiled sums: what they read, and in `outputs` the arrays that they write."""
    return SIGHTINGS(
        count=len(observations.frame),
        frames=len(problem.center),
        points=len(problem.points),
        unknowns=config.unknowns,
        centers=config.refine_centers,
        lens=config.refine_focal or config.refine_zoom,
        shared=config.refine_focal,
        robust=config.robust_px,
        behind=BEHIND_PX,
        min_depth=MIN_DEPTH,
        principal=tuple(problem.principal),
        frame=np.ascontiguousarray(observations.frame, np.int64),
        point=np.ascontiguousarray(observations.point, np.int64),
        uv=np.ascontiguousarray(observations.uv, np.float64),
        weight=np.ascontiguousarray(observations.weight, np.float64),
        rotation=np.ascontiguousarray(problem.rotation, np.float64),
        center=np.ascontiguousarray(problem.center, np.float64),
        focal=problem.focals,
        homogeneous=problem.points,
        **outputs,
    )


def _depth_prior(config: BundleConfig) -> float:
    """Return the fraction of the squared error that inverse distances which vary by their median must save."""
    return DEPTH_PRIOR / config.relief**2


def _prior_cost(problem: _Problem, config: BundleConfig, belief: float) -> float:
    """Return the cost of what is believed beforehand, in units of `belief`."""
    cost = np.mean((problem.inverse_distance - 1) ** 2) * _depth_prior(config) if config.refine_centers else 0.0
    if config.refine_centers:
        cost += PATH_PRIOR * np.mean((problem.center**2).sum(1))
    if config.refine_focal and config.expected_focal:
        away = np.log(problem.focal / config.expected_focal)
        cost += config.focal_prior * (np.log1p((away / FOCAL_SPREAD) ** 2) + (_beyond_reach(away) / FOCAL_SPREAD) ** 2)
    if config.refine_zoom:
        cost += ZOOM_PRIOR * np.square(_bends(len(problem.zoom)) @ np.log(problem.zoom) / ZOOM_CHANGE).sum()
    return belief * float(cost)


def _beyond_reach(away: float) -> float:
    """Return by how much a logarithm of a ratio of focal lengths lies beyond `FOCAL_REACH`, with its sign; 0 within."""
    return float(np.sign(away) * max(abs(away) - FOCAL_REACH, 0.0))


def _bends(frames: int) -> np.ndarray:
    """Return `(F, F)` matrix of second differences over the frames, and the mean, which is held at 0; all over the root of F."""
    rows = np.zeros((frames, frames))
    for row in range(frames - 2):
        rows[row, row : row + 3] = 1, -2, 1
    rows[-1] = 1 / frames
    return rows / np.sqrt(frames)


class _Linear(NamedTuple):
    """The n sightings of one camera and how they change with it and with the points."""

    residual: np.ndarray
    """(2, n) pixels."""
    to_camera: np.ndarray
    """(2, 7, n): by rotation, centre, log focal length."""
    to_point: np.ndarray
    """(2, 3, n): by the point, along its tangents."""
    weight: np.ndarray
    """(n,)"""


def _linearise(
    problem: _Problem, frame: int, seen: Observations, tangents: np.ndarray, config: BundleConfig
) -> _Linear:
    """Return the derivatives of the sightings `seen` of a frame; `tangents (P, 4, 3)` of the problem.

    Sightings are the last axis: numpy works on long rows, faster than on as many small matrices.
    """
    rotation, focal = problem.rotation[frame], problem.focals[frame]
    points = problem.points[seen.point]
    local, length = problem.local(frame, points), points[:, 3]
    ahead = local[2] > MIN_DEPTH
    z = np.where(ahead, local[2], 1.0)
    x, y = plane = local[:2] / z
    projected = focal * plane
    residual = np.where(ahead, projected + problem.principal[:, None] - seen.uv.T, 0.0)
    turned = focal / z * (rotation[:2, :, None] - plane[:, None] * rotation[2][:, None])  # to the point in world axes
    to_camera = np.empty((2, 7, len(z)))
    to_camera[:, :3] = focal * np.stack([[-x * y, 1 + x * x, -y], [-1 - y * y, x * y, x]])  # for R <- exp(omega) R
    np.multiply(turned, -length, out=to_camera[:, 3:6])
    to_camera[:, 6] = projected
    steps = tangents[seen.point]
    shifts = steps[:, :3] - problem.center[frame][:, None] * steps[:, 3:]  # (n, 3, 3): of the point from the camera
    to_point = np.einsum("ajn,njk->akn", turned, shifts)
    weight = seen.weight / (1 + (residual**2).sum(0) / config.robust_px**2) * ahead
    if not config.refine_centers:
        to_camera[:, 3:6] = 0
    if not config.refine_focal and not config.refine_zoom:
        to_camera[:, 6] = 0
    return _Linear(residual, to_camera, to_point, weight)


class _Sums(NamedTuple):
    """Products of the derivatives of all sightings, added up by camera and by point."""

    blocks: np.ndarray
    """(F, 7, 7) of the cameras: rotation, centre, log focal length."""
    slopes: np.ndarray
    """(F, 7) of the cameras with the residuals."""
    coupling: np.ndarray
    """(3, 6F+1, P) of points and cameras, (3, 7F+1, P) where the lens zooms; the last row is the focal length of all."""
    points: np.ndarray
    """(P, 3, 3)"""
    point_slopes: np.ndarray
    """(P, 3)"""

    @classmethod
    def none(cls, frames: int, points: int, config: BundleConfig) -> _Sums:
        """Return sums of zeros."""
        shapes = (frames, 7, 7), (frames, 7), (3, config.unknowns * frames + 1, points), (points, 3, 3), (points, 3)
        return cls(*map(np.zeros, shapes))


def _sums(problem: _Problem, observations: Observations, config: BundleConfig, held_points: bool = False) -> _Sums:
    """Return the sums at `problem`; of points that are held nothing need be added up."""
    if open_library()[0] is None:
        return _plain_sums(problem, observations, config)
    sums = _Sums.none(len(problem.center), 0 if held_points else len(problem.points), config)
    outputs = {"blocks": sums.blocks, "slopes": sums.slopes}
    if not held_points:
        outputs |= {"coupling": sums.coupling, "point_blocks": sums.points, "point_slopes": sums.point_slopes}
        outputs["tangents"] = np.ascontiguousarray(problem.tangents)
    F4X_BUNDLE_EQUATIONS(_sightings(problem, observations, config, **outputs))
    return sums


def _plain_sums(problem: _Problem, observations: Observations, config: BundleConfig) -> _Sums:
    frames, tangents = len(problem.center), problem.tangents
    sums = _Sums.none(frames, len(problem.points), config)
    for frame, seen in enumerate(observations.by_frame(frames)):
        residual, to_camera, to_point, weight = _linearise(problem, frame, seen, tangents, config)
        weighted, scaled = to_camera * weight, to_point * weight
        sums.blocks[frame] = (weighted @ to_camera.transpose(0, 2, 1)).sum(0)
        sums.slopes[frame] = (weighted @ residual[:, :, None]).sum(0)[:, 0]
        # A point is sighted once per frame, so that no index stands twice.
        own = slice(config.unknowns * frame, config.unknowns * (frame + 1))
        products = sum(to_point[axis, :, None] * weighted[axis] for axis in (0, 1))  # (3, 7, n)
        sums.coupling[:, own, seen.point] = products[:, : config.unknowns]
        if config.refine_focal:
            sums.coupling[:, -1, seen.point] += products[:, 6]
        sums.points[seen.point] += np.einsum("ain,ajn->nij", scaled, to_point)
        sums.point_slopes[seen.point] += (scaled * residual[:, None]).sum(0).T
    return sums


class _Group(NamedTuple):
    """Points that are seen in one run of frames."""

    points: np.ndarray
    """(n,) int, which of all points."""
    run: slice
    """The frames."""
    seen: Observations
    """Their sightings; frames and points are counted within the group."""

    def unknowns(self, each: int) -> np.ndarray:
        """Return (each * frames + 1,) int: the places of its cameras' unknowns, `each` per camera, then that of the common focal
        length, counted from the end."""
        return np.append(np.arange(each * self.run.start, each * self.run.stop), -1)


def _grouped(observations: Observations, count: int) -> list[_Group]:
    """Return the `count` points in groups by the first and the last frame that see them, in steps of `RUN_STEP`."""
    first, last = np.full(count, np.iinfo(np.int64).max), np.zeros(count, np.int64)
    np.minimum.at(first, observations.point, observations.frame)
    np.maximum.at(last, observations.point, observations.frame)
    first = np.minimum(first, last)  # of points that nothing sees
    _, group = np.unique(np.stack([first, last]) // RUN_STEP, axis=1, return_inverse=True)
    place = np.empty(count, np.int64)
    sightings = np.argsort(group[observations.point], kind="stable")
    ends = np.searchsorted(group[observations.point][sightings], np.arange(group.max(initial=-1) + 2))
    groups = []
    for index, (start, end) in enumerate(pairwise(ends)):
        points = np.flatnonzero(group == index)
        run = slice(int(first[points].min()), int(last[points].max()) + 1)
        place[points] = np.arange(len(points))
        seen = observations.keep(sightings[start:end])
        groups.append(_Group(points, run, replace(seen, frame=seen.frame - run.start, point=place[seen.point])))
    return groups


class _NormalEquations(NamedTuple):
    """Normal equations of F cameras and P points.

    A camera has seven unknowns in place of six where its zoom is refined; the focal length of all comes last.
    """

    camera: np.ndarray
    """(6F+1, 6F+1)."""
    gradient: np.ndarray
    """(6F+1,) of the cameras."""
    points: np.ndarray
    """(P, 3, 3) blocks."""
    point_gradient: np.ndarray
    """(P, 3)."""
    coupling: list[tuple[_Group, np.ndarray]]
    """Coupling `(3, 6f+1, n)` of every group between its f cameras, with the focal length of all, and its n points."""


def _normal_equations(problem: _Problem, groups: list[_Group], config: BundleConfig, belief: float) -> _NormalEquations:
    """Return the normal equations of half the cost at `problem`, its priors included."""
    frames, each = len(problem.center), config.unknowns
    size, count = each * frames, len(problem.points)
    blocks, slopes = np.zeros((frames, 7, 7)), np.zeros((frames, 7))
    points, point_gradient, coupling = np.zeros((count, 3, 3)), np.zeros((count, 3)), []
    for group in groups:
        sums = _sums(problem.part(group), group.seen, config)
        blocks[group.run] += sums.blocks
        slopes[group.run] += sums.slopes
        points[group.points], point_gradient[group.points] = sums.points, sums.point_slopes
        coupling.append((group, sums.coupling))
    camera, gradient = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
    for f in range(frames):
        own = slice(each * f, each * (f + 1))
        camera[own, own] = blocks[f, :each, :each]
    gradient[:size] = slopes[:, :each].ravel()
    if config.refine_focal:
        camera[:size, size] = camera[size, :size] = blocks[:, :each, 6].ravel()
        camera[size, size], gradient[size] = blocks[:, 6, 6].sum(), slopes[:, 6].sum()
    equations = _NormalEquations(camera, gradient, points, point_gradient, coupling)
    _add_priors(problem, config, belief, equations)
    return equations


def _add_priors(problem: _Problem, config: BundleConfig, belief: float, equations: _NormalEquations) -> None:
    """Add derivatives of `_prior_cost` / 2 to the normal equations, in place."""
    camera, gradient = equations.camera, equations.gradient
    frames, count = len(problem.center), len(problem.points)
    if config.refine_focal and config.expected_focal:
        away = np.log(problem.focal / config.expected_focal)
        beyond, pull = _beyond_reach(away), belief * config.focal_prior / (FOCAL_SPREAD**2 + away**2)
        steep = belief * config.focal_prior / FOCAL_SPREAD**2 * (beyond != 0)
        camera[-1, -1] += pull + steep
        gradient[-1] += pull * away + steep * beyond
    own_count = (len(camera) - 1) // frames
    if config.refine_zoom:
        places = own_count * np.arange(frames) + 6
        bends = _bends(frames) * np.sqrt(belief * ZOOM_PRIOR) / ZOOM_CHANGE
        camera[np.ix_(places, places)] += bends.T @ bends
        gradient[places] += bends.T @ bends @ np.log(problem.zoom)
    if not config.refine_centers:
        return
    places = (own_count * np.arange(frames)[:, None] + np.arange(3, 6)).ravel()
    camera[places, places] += belief * PATH_PRIOR / frames
    gradient[places] += belief * PATH_PRIOR / frames * problem.center.ravel()
    distance = np.maximum(np.linalg.norm(problem.points[:, :3], axis=1), 1e-9)
    inverse = problem.inverse_distance
    slope = np.column_stack([-(inverse / distance**2)[:, None] * problem.points[:, :3], 1 / distance])
    slope = np.einsum("pi,pij->pj", slope, problem.tangents)
    weight = belief * _depth_prior(config) / count
    equations.points[:] += weight * slope[:, :, None] * slope[:, None, :]
    equations.point_gradient[:] += weight * slope * (inverse - 1)[:, None]


def _solve(equations: _NormalEquations, damping: float, cameras: int) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the steps of the cameras `(F, 6)` or `(F, 7)`, the log focal length and the points `(P, 3)`; `cameras` is F."""
    camera, gradient, points, point_gradient, couplings = equations
    floor = 1e-9 * max(float(np.einsum("pii->pi", points).mean()), 1e-12)
    diagonal = np.einsum("pii->pi", points)
    lower = np.linalg.cholesky(points + (damping * diagonal + floor)[:, :, None] * np.eye(3))
    # inverse = root root^T, so C inverse C^T takes half the products
    root = _inverse_of_lower(lower).transpose(0, 2, 1)
    along = np.einsum("pij,pi->jp", root, point_gradient)
    own, each = np.diag(camera), (len(camera) - 1) // cameras
    # Unknowns that are held fixed have empty rows: a unit pivot keeps them at zero.
    system = camera + np.diag(damping * own + np.where(own > 0, 1e-9 * own.mean(), 1.0))
    reduced = gradient.copy()
    for group, coupling in couplings:
        rows, parts = group.unknowns(each), _eliminated(coupling, root[group.points])
        system[np.ix_(rows, rows)] -= sum(part @ part.T for part in parts)
        reduced[rows] -= sum(part @ one for part, one in zip(parts, along[:, group.points], strict=True))
    step = -np.linalg.solve(system, reduced)
    pulled = point_gradient.copy()
    for group, coupling in couplings:
        pulled[group.points] += (step[group.unknowns(each)] @ coupling).T
    moved = -np.einsum("pij,pj->pi", root @ root.transpose(0, 2, 1), pulled)
    return step[:-1].reshape(cameras, -1), float(step[-1]), moved


def _eliminated(coupling: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Return `(3, m, n)`: the coupling of m unknowns and n points, times the upper triangles `root (n, 3, 3)`."""
    parts = np.empty_like(coupling)
    for j in range(3):
        np.multiply(coupling[0], root[:, 0, j], out=parts[j])
    for i, j in ((1, 1), (1, 2), (2, 2)):
        parts[j] += coupling[i] * root[:, i, j]
    return parts


def _inverse_of_lower(lower: np.ndarray) -> np.ndarray:
    """Return the inverses of lower triangles `(P, 3, 3)`; `numpy.linalg.inv`, with pivots, takes 10 to 100 times as long."""
    (a, _, _), (b, c, _), (d, e, f) = np.moveaxis(lower, 0, -1)
    inverse = np.zeros_like(lower)
    inverse[:, 0, 0], inverse[:, 1, 1], inverse[:, 2, 2] = 1 / a, 1 / c, 1 / f
    inverse[:, 1, 0] = -b / (a * c)
    inverse[:, 2, 1] = -e / (c * f)
    inverse[:, 2, 0] = (b * e - c * d) / (a * c * f)
    return inverse


def from_matrices(
    world_to_camera: np.ndarray, focal: float, principal: np.ndarray, points: np.ndarray | None = None
) -> Bundle:
    """Return the bundle of rigid matrices `(F, 4, 4)`."""
    q, center = pose.invert(*pose.from_matrix(world_to_camera))
    return Bundle(
        focal,
        np.asarray(principal, np.float64),
        quaternion.to_matrix(quaternion.conjugate(q)),
        center,
        np.zeros((0, 3)) if points is None else points,
    )
