"""Static bundle adjustment: cameras, focal length and points from 2-D observations of what does not move.

`u = f * x / z + principal` with `x = R (X - c)`: R world-to-camera, c the camera centre. Levenberg-Marquardt on the
robust squared error, the points eliminated by the Schur complement (Triggs et al. 2000, section 6.1). The camera system is
small and dense (6 F + 1 unknowns), so plain BLAS is fastest and nothing but numpy and scipy is needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from ..geometry import pose, quaternion
from ..geometry.camera import CameraPath

ROBUST_PX = 1.0
"""Cauchy scale in pixels: good tracks stay below, a wrong one soon stops pulling."""
MIN_DEPTH = 1e-6
"""Points nearer to a camera plane than this carry no weight in that view."""


@dataclass(frozen=True)
class Observations:
    """Where points were seen: one row per sighting."""

    frame: np.ndarray
    """(O,) int, which camera."""
    point: np.ndarray
    """(O,) int, which point."""
    uv: np.ndarray
    """(O, 2) float64 pixels, pixel centres at +0.5."""
    weight: np.ndarray
    """(O,) float64 trust."""

    def keep(self, chosen: np.ndarray) -> Observations:
        """The chosen rows (mask or indices)."""
        return Observations(self.frame[chosen], self.point[chosen], self.uv[chosen], self.weight[chosen])


@dataclass(frozen=True)
class Bundle:
    """Cameras and points that belong together, in any world unit."""

    focal: float
    """Pixels, the same in x and y and in every frame."""
    principal: np.ndarray
    """(2,) pixels."""
    rotation: np.ndarray
    """(F, 3, 3) world to camera."""
    center: np.ndarray
    """(F, 3) camera centres in the world."""
    points: np.ndarray
    """(P, 3) world."""

    @property
    def world_to_camera(self) -> np.ndarray:
        """(F, 4, 4) rigid matrices."""
        matrix = np.tile(np.eye(4), (len(self.center), 1, 1))
        matrix[:, :3, :3] = self.rotation
        matrix[:, :3, 3] = -np.einsum("fij,fj->fi", self.rotation, self.center)
        return matrix

    @property
    def intrinsics(self) -> np.ndarray:
        """(3, 3) pixels."""
        return np.array([[self.focal, 0, self.principal[0]], [0, self.focal, self.principal[1]], [0, 0, 1.0]])

    def path(self, times: np.ndarray, width: int, height: int) -> CameraPath:
        """The cameras at their `times (F,)` in clip frames."""
        intrinsics = np.tile(self.intrinsics, (len(times), 1, 1))
        return CameraPath(intrinsics, self.world_to_camera, np.asarray(times, np.float64), width, height)

    def local(self, observations: Observations) -> np.ndarray:
        """Observed points in the axes of their camera, `(O, 3)`."""
        offset = self.points[observations.point] - self.center[observations.frame]
        return np.einsum("oij,oj->oi", self.rotation[observations.frame], offset)

    def residuals(self, observations: Observations) -> np.ndarray:
        """Projection minus observation in pixels, `(O, 2)`; infinite behind the camera."""
        local = self.local(observations)
        ahead = local[:, 2:] > MIN_DEPTH
        projected = self.focal * local[:, :2] / np.where(ahead, local[:, 2:], 1.0) + self.principal
        return np.where(ahead, projected - observations.uv, np.inf)

    def errors(self, observations: Observations) -> np.ndarray:
        """Reprojection error in pixels, `(O,)`."""
        return np.linalg.norm(self.residuals(observations), axis=1)


@dataclass(frozen=True)
class BundleConfig:
    """Settings of `adjust`."""

    iterations: int = 20
    """Most Levenberg-Marquardt steps; it stops earlier when the error falls by less than 1e-4 of itself."""
    refine_focal: bool = True
    """Solve for the focal length too."""
    refine_centers: bool = True
    """Solve for camera centres; off, only rotations move (pan-only clips: points are directions)."""
    robust_px: float = ROBUST_PX
    """Cauchy scale in pixels."""


def rays(bundle: Bundle, observations: Observations) -> np.ndarray:
    """Unit viewing directions in the world, `(O, 3)`."""
    local = np.column_stack([(observations.uv - bundle.principal) / bundle.focal, np.ones(len(observations.uv))])
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    return np.einsum("oji,oj->oi", bundle.rotation[observations.frame], local)


def triangulate(
    bundle: Bundle, observations: Observations, count: int, rounds: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Points nearest to their viewing rays: `(count, 3)` and the spread of the rays `(count,)` in radians.

    `X = argmin sum w |(I - d d^T)(X - c)|^2 / distance^2`, the distances from the round before, so that the error is
    angular. Spread is the largest angle to the point's mean ray, doubled. Points seen less than twice are NaN.
    """
    directions, centers = rays(bundle, observations), bundle.center[observations.frame]
    sums = _incidence(observations.point, count)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]  # (O, 3, 3)
    weight, points = observations.weight, np.zeros((count, 3))
    for _ in range(rounds):
        weighted = across * weight[:, None, None]
        normal = (sums @ weighted.reshape(-1, 9)).reshape(-1, 3, 3)
        right = sums @ np.einsum("oij,oj->oi", weighted, centers)
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
    damping, cost = 1e-4, _cost(bundle, observations, config)
    for _ in range(config.iterations):
        system = _normal_equations(bundle, observations, config)
        for _ in range(8):
            step = _solve(*system, damping)
            moved = _moved(bundle, *step, config)
            moved_cost = _cost(moved, observations, config)
            if moved_cost < cost:
                break
            damping *= 8
        else:
            return bundle
        finished = cost - moved_cost < 1e-4 * cost
        bundle, cost, damping = moved, moved_cost, max(damping / 5, 1e-9)
        if finished:
            return bundle
    return bundle


def resect(
    bundle: Bundle, observations: Observations, frames: np.ndarray, iterations: int = 15, robust_px: float = 2.0
) -> Bundle:
    """Cameras `frames` re-solved from known points, each by itself, starting where it stands; all others stay."""
    chosen = np.isin(observations.frame, frames) & np.isfinite(bundle.points[observations.point]).all(1)
    seen, config = observations.keep(chosen), BundleConfig(refine_focal=False, robust_px=robust_px)
    if not len(seen.frame):
        return bundle
    count = len(bundle.center)
    damping, cost = 1e-3, _frame_cost(bundle, seen, config)
    for _ in range(iterations):
        residual, jacobian, _, weight = _linearise(bundle, seen, config)
        sums = _incidence(seen.frame, count)
        cameras, scaled = jacobian[:, :, :6], jacobian[:, :, :6] * weight[:, None, None]
        normal = (sums @ np.einsum("oki,okj->oij", scaled, cameras).reshape(-1, 36)).reshape(-1, 6, 6)
        gradient = sums @ np.einsum("oki,ok->oi", scaled, residual)
        diagonal = np.einsum("fii->fi", normal)
        damped = normal + damping * diagonal[:, :, None] * np.eye(6) + 1e-9 * np.eye(6)
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        moved = _moved(bundle, step, 0.0, np.zeros_like(bundle.points), config)
        moved_cost = _frame_cost(moved, seen, config)
        better = moved_cost < cost  # (F,)
        bundle = replace(
            bundle,
            rotation=np.where(better[:, None, None], moved.rotation, bundle.rotation),
            center=np.where(better[:, None], moved.center, bundle.center),
        )
        cost = np.where(better, moved_cost, cost)
        damping = damping / 3 if better.any() else damping * 10
    return bundle


def _incidence(index: np.ndarray, count: int) -> csr_matrix:
    """Sparse `(count, O)` matrix that adds up the rows with equal index."""
    order = np.arange(len(index))
    return csr_matrix((np.ones(len(index)), (index, order)), shape=(count, len(index)))


def _robust(squared: np.ndarray, config: BundleConfig) -> np.ndarray:
    """Cauchy cost of squared errors; points behind the camera cost as much as a miss of 1000 px."""
    scale = config.robust_px**2
    return scale * np.log1p(np.where(np.isfinite(squared), squared, 1e6) / scale)


def _cost(bundle: Bundle, observations: Observations, config: BundleConfig) -> float:
    return float((observations.weight * _robust((bundle.residuals(observations) ** 2).sum(1), config)).sum())


def _frame_cost(bundle: Bundle, observations: Observations, config: BundleConfig) -> np.ndarray:
    cost = observations.weight * _robust((bundle.residuals(observations) ** 2).sum(1), config)
    return np.bincount(observations.frame, cost, len(bundle.center))


def _linearise(
    bundle: Bundle, observations: Observations, config: BundleConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Residuals `(O, 2)`, Jacobians to (rotation, centre, focal) `(O, 2, 7)` and point `(O, 2, 3)`, weights `(O,)`."""
    local = bundle.local(observations)
    ahead = local[:, 2] > MIN_DEPTH
    z = np.where(ahead, local[:, 2], 1.0)
    plane = local[:, :2] / z[:, None]
    residual = np.where(ahead[:, None], bundle.focal * plane + bundle.principal - observations.uv, 0.0)
    project = np.zeros((len(z), 2, 3))  # d uv / d local
    project[:, 0, 0] = project[:, 1, 1] = bundle.focal / z
    project[:, :, 2] = -bundle.focal * plane / z[:, None]
    to_point = np.einsum("oij,ojk->oik", project, bundle.rotation[observations.frame])
    to_rotation = np.cross(local[:, None, :], project)  # d local / d omega = -[local]x for R <- exp(omega) R
    to_camera = np.concatenate([to_rotation, -to_point, plane[:, :, None]], axis=2)
    weight = observations.weight / (1 + (residual**2).sum(1) / config.robust_px**2) * ahead
    return residual, to_camera, to_point, weight


def _normal_equations(
    bundle: Bundle, observations: Observations, config: BundleConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Camera block `(6F+1, 6F+1)`, its gradient, coupling `(6F+1, P, 3)`, point blocks `(P, 3, 3)`, point gradient."""
    frames, count = len(bundle.center), len(bundle.points)
    residual, to_camera, to_point, weight = _linearise(bundle, observations, config)
    if not config.refine_centers:
        to_camera[:, :, 3:6] = 0
    if not config.refine_focal:
        to_camera[:, :, 6] = 0
    weighted = to_camera * weight[:, None, None]
    by_frame, by_point = _incidence(observations.frame, frames), _incidence(observations.point, count)
    blocks = (by_frame @ np.einsum("oki,okj->oij", weighted, to_camera).reshape(-1, 49)).reshape(-1, 7, 7)
    camera_gradient = by_frame @ np.einsum("oki,ok->oi", weighted, residual)  # (F, 7)
    size = 6 * frames
    camera, gradient = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
    for f in range(frames):
        own = slice(6 * f, 6 * f + 6)
        camera[own, own] = blocks[f, :6, :6]
        camera[own, size] = camera[size, own] = blocks[f, :6, 6]
    camera[size, size], gradient[size] = blocks[:, 6, 6].sum(), camera_gradient[:, 6].sum()
    gradient[:size] = camera_gradient[:, :6].ravel()

    coupling_rows = np.einsum("oki,okj->oij", weighted, to_point)  # (O, 7, 3)
    coupling = np.zeros((frames, 6, count, 3))
    # A point is sighted once per frame, so plain assignment adds nothing up twice.
    coupling[observations.frame, :, observations.point] = coupling_rows[:, :6]
    focal_row = (by_point @ coupling_rows[:, 6]).reshape(1, count, 3)
    coupling = np.concatenate([coupling.reshape(size, count, 3), focal_row])
    scaled = to_point * weight[:, None, None]
    points = (by_point @ np.einsum("oki,okj->oij", scaled, to_point).reshape(-1, 9)).reshape(-1, 3, 3)
    point_gradient = by_point @ np.einsum("oki,ok->oi", scaled, residual)
    return camera, gradient, coupling, points, point_gradient


def _solve(
    camera: np.ndarray,
    gradient: np.ndarray,
    coupling: np.ndarray,
    points: np.ndarray,
    point_gradient: np.ndarray,
    damping: float,
) -> tuple[np.ndarray, float, np.ndarray]:
    """Steps of the cameras `(F, 6)`, the focal length and the points `(P, 3)`."""
    floor = 1e-9 * max(float(np.einsum("pii->pi", points).mean()), 1e-12)
    diagonal = np.einsum("pii->pi", points)
    inverse = np.linalg.inv(points + (damping * diagonal + floor)[:, :, None] * np.eye(3))
    eliminated = np.einsum("cpi,pij->cpj", coupling, inverse)
    flat = eliminated.reshape(len(camera), -1)
    own = np.diag(camera)
    # Unknowns that are held fixed have empty rows: a unit pivot keeps them at zero.
    system = camera + np.diag(damping * own + np.where(own > 0, 1e-9 * own.mean(), 1.0))
    system -= flat @ coupling.reshape(len(camera), -1).T
    step = -np.linalg.solve(system, gradient - flat @ point_gradient.ravel())
    moved = -np.einsum("pij,pj->pi", inverse, point_gradient + np.einsum("c,cpi->pi", step, coupling))
    return step[:-1].reshape(-1, 6), float(step[-1]), moved


def _moved(bundle: Bundle, cameras: np.ndarray, focal: float, points: np.ndarray, config: BundleConfig) -> Bundle:
    turn = quaternion.to_matrix(quaternion.from_rotation_vector(cameras[:, :3]))
    return replace(
        bundle,
        rotation=np.einsum("fij,fjk->fik", turn, bundle.rotation),
        center=bundle.center + cameras[:, 3:] if config.refine_centers else bundle.center,
        focal=bundle.focal * float(np.exp(np.clip(focal / bundle.focal, -0.3, 0.3))),
        points=bundle.points + points,
    )


def from_matrices(
    world_to_camera: np.ndarray, focal: float, principal: np.ndarray, points: np.ndarray | None = None
) -> Bundle:
    """Bundle of rigid matrices `(F, 4, 4)`."""
    q, center = pose.invert(*pose.from_matrix(world_to_camera))
    return Bundle(
        focal,
        np.asarray(principal, np.float64),
        quaternion.to_matrix(quaternion.conjugate(q)),
        center,
        np.zeros((0, 3)) if points is None else points,
    )
