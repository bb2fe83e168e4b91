"""Dense depth of the supervised frames from geometry alone (provider `classical`).

Static pixels: inverse depth is triangulated from flow over many frame gaps and from static tracks, then spread over the
picture by an edge-aware smoothness term weighed against the measured precision. Moving pixels carry no depth signal; what is
honest is plausible: contact with the ground below, the change of size over time, one depth per object and frame, and a low
confidence. Clips from a standing camera get a guessed ground and background (`standing_world`), turning ones a gentle
ground-like prior with almost no confidence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import ndimage
from scipy.sparse import dia_array, diags_array
from scipy.sparse.linalg import cg

from ..geometry.camera import Camera, CameraPath
from ..native.library import open_library
from ..native.maps import F4X_SMOOTH_MAP, SMOOTHING
from ..parallel import in_threads
from ..progress import Progress
from .config import PriorsConfig
from .contact import GUESS_CONFIDENCE, MOVING_MARGIN
from .flow import agree, grey, long_flows, look_up, pixel_grid, texture_along
from .movers import place_objects
from .moving_people import dilate_masks, shows_people
from .outline import refine_mask
from .point_tracks import PointTracks
from .points import TRACK_OUTLIER_PX, fit_points
from .second_look import JOINED_MOTION, mask_is_given, revise_mask
from .standing_world import guess_world, slope
from .surfaces import join, pyramid_mean, surface_guide
from .sweep import Samples, sweep
from .uprights import feet_of_uprights

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

GUESSED_MOVERS = "Depth of moving objects is a plausible guess (ground contact and change of size), not a measurement."
"""Warning where anything but their own motion decided."""
STRIDE = 2
"""Depth is measured and solved on every second pixel: flow is no finer."""
FLOW_NOISE_PX = 0.4
"""Standard deviation of static flow that passed the forward-backward test."""
FLOW_OUTLIER_PX = 1.5
"""Cauchy scale of reprojection residuals when gaps are combined."""
MISS_LIMIT_PX = 5.0
"""A gap whose flow misses by more counts as a miss by this much."""
PLAIN_NOISE, PLAIN_SAMPLES = 0.4, 300
"""Uncertainty of unmeasured inverse depth, as a fraction of the median, and number of usual samples. Unmeasured depth is that of
a plane below and a wall above; both are fitted to what is measured, against these usual samples. With 20 doubtful ones decide:
the water of blackswan, which mirrors what is far, lay behind its bank."""
TRACK_NOISE_PX = 0.4
MAX_DEPTH = 50.0
"""Depths beyond this many median depths cannot be told apart; sky is put here."""
SAMPLE_NOISE = 0.005
"""Least relative error of one sample: errors of flow are shared by neighbours, so no sample outweighs them without limit."""
SLOPE, CURVATURE = 0.03, 0.01
"""Usual first and second difference of inverse depth along a line of samples, relative to it; planes have no second one."""
BANDS = ("itself", "right", "right_two", "below", "below_two")
"""Entries of the normal matrix of smoothness by what a pixel is linked with."""
MISS_LEFT = 1e-5
"""Conjugate gradients stop when so small a part of the right-hand side is missed."""
COARSEST_SIDE = 16
"""Samples along the shorter side of the coarsest grid that depth is filled on."""
EDGE_GREY, EDGE_SLACK = 10.0, 0.003
"""Grey step that weakens smoothness by 1/e, and the fraction of smoothness that survives the strongest step."""


def provide(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `depth`, `depth_confidence`, `statistics["depth"]`, and set the world unit of the cameras (median depth 1)."""
    assert priors.cameras is not None
    cameras = priors.cameras
    frames = len(priors.frames)
    moving = priors.mask if priors.mask is not None else np.zeros((frames, priors.height, priors.width), bool)
    seen = np.ones_like(moving) if clip.hidden is None else ~clip.hidden[priors.frames]
    statistics: dict[str, Any] = {}
    outlined = clip.hidden is None and priors.motion is not None and moving.any() and not mask_is_given(priors)
    if outlined and priors.camera_kind != "moving":  # such a camera sees what is behind at any depth
        moving = _with_outlines(clip, priors, np.ones(moving.shape, np.float32), moving)
    if priors.camera_kind == "moving":
        inverse, confidence = _static_depth(clip, priors, config, moving | ~seen, progress, statistics)
        if outlined:
            moving = _with_outlines(clip, priors, inverse, moving)
    elif priors.camera_kind == "static":
        inverse, confidence = _before_standing_camera(clip, priors, cameras, statistics)
    else:
        inverse, confidence = ground_prior(cameras), np.full(moving.shape, GUESS_CONFIDENCE, np.float32)
        priors.warn("Without parallax no depth can be measured: depth is a ground-like guess with low confidence.")
    progress("depth", frames, frames + 1, "moving objects")
    objects = place_objects(inverse, confidence, moving, priors)
    progress("depth", frames + 1, frames + 1)
    depth = 1 / inverse
    median = float(np.median(depth if clip.hidden is None or not seen.any() else depth[seen]))
    unit = priors.store_depth(depth, confidence, median)
    assert priors.depth is not None
    for mover in objects:
        for name in ("depth", "ground"):
            over_time = mover["over_time"]
            over_time[name] = [None if one is None else round(one / unit, 4) for one in over_time[name]]
    if any(mover["decided_by"] != "its own motion" for mover in objects):
        priors.warn(GUESSED_MOVERS)
    percentiles = np.percentile(priors.depth[:, ::4, ::4], (2, 50, 98))
    priors.statistics["depth"] = statistics | {
        "moving_objects": len(objects),
        "movers": objects,
        "percentiles_2_50_98": [round(float(value), 3) for value in percentiles],
        "mean_confidence": round(float(confidence.mean()), 3),
    }


def _with_outlines(clip: Clip, priors: Priors, inverse: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Return the mask `moving (F, H, W)` refined by the background of `inverse (F, H, W)` depth; update `priors.mask`, `motion`."""
    assert priors.cameras is not None and priors.motion is not None
    mask = refine_mask(clip.frames[priors.frames], inverse, moving, shows_people(priors), priors.cameras)
    motion = np.where(mask & ~moving, np.maximum(priors.motion, JOINED_MOTION), priors.motion)
    revise_mask(priors, mask, np.where(moving & ~mask, 0, motion))
    return mask


def _before_standing_camera(
    clip: Clip, priors: Priors, cameras: CameraPath, statistics: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Return guessed inverse depth and confidence `(F, H, W)` of the world before a camera that stands."""
    world = guess_world(priors)
    statistics["guess"] = world.summary()
    whence = "where what moves touches it" if world.known else "where it usually lies, as little tells where it is"
    priors.warn(f"The camera stands, so no depth can be measured: depth is a guess, with the ground {whence}.")
    inverse = world.inverse_depth(cameras, feet_of_uprights(clip, priors, world.base))
    return inverse, np.tile(world.confidence()[:, None].astype(np.float32), (len(inverse), 1, inverse.shape[2]))


def inverse_depth_from_flow(
    cameras: CameraPath, frame: int, pixels: np.ndarray, targets: list[tuple[int, np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse depth `(n,)` of static `pixels (n, 2)` of a frame, and its precision `(n,)` (1 / variance).

    `targets` lists (other frame, where the pixels are seen there `(n, 2)`, weight `(n,)`). With the ray `r`, `x = R r +
    rho t` in the other camera and `(u, v)` the normalised sighting, `rho (t_x - u t_z) = u a_z - a_x`, `a = R r`, is linear
    in rho; all gaps are combined by least squares with Cauchy weights on the residual in pixels.
    """
    here = cameras[frame]
    rays = np.ones((3, len(pixels)))
    rays[:2] = here.on_plane(pixels).T
    gain, offset = np.empty((2, 2, len(targets), len(pixels)), np.float64)  # (x and y, g, n)
    for row, (other, seen, _) in enumerate(targets):
        there = cameras[other]
        relative = there.world_to_camera @ here.camera_to_world
        ahead = relative[:3, :3] @ rays  # (3, n)
        ahead[:2] /= ahead[2]
        plane = there.on_plane(seen).T
        gain[:, row] = (relative[:2, 3:] - plane * relative[2, 3]) / ahead[2]
        offset[:, row] = plane - ahead[:2]
    given, focal = np.stack([weight for _, _, weight in targets]), here.intrinsics[0, 0]  # (g, n)
    square, along = (gain**2).sum(0), (gain * offset).sum(0)
    # Least absolute deviations to start with, a weighted median over the gaps: the longest gap alone could pull squares away.
    each = along / np.maximum(square, 1e-20)
    order = np.argsort(each, axis=0)
    half = np.cumsum(np.take_along_axis(given * np.sqrt(square), order, axis=0), axis=0)
    middle = np.argmax(half >= half[-1] / 2, axis=0)
    inverse = np.take_along_axis(each, np.take_along_axis(order, middle[None], axis=0), axis=0)[0]
    for _ in range(4):
        squared = focal**2 * ((gain * inverse - offset) ** 2).sum(0)  # of the miss in pixels
        weight = given / (1 + squared / FLOW_OUTLIER_PX**2)
        inverse = (weight * along).sum(0) / np.maximum((weight * square).sum(0), 1e-20)
    # A point that moves a little by itself meets no epipolar line at all gaps: misses beyond noise tell how wrong its depth may be.
    missed = (given * np.minimum(squared, MISS_LIMIT_PX**2)).sum(0) / np.maximum(given.sum(0), 1e-20)
    doubt = np.maximum(missed / FLOW_NOISE_PX**2, 1)
    # Errors of flow are shared by its gaps: the best gap tells the precision, more gaps only help against outliers.
    precision = (weight * square).max(0) * (focal / FLOW_NOISE_PX) ** 2 / doubt
    return inverse, precision


def epipolar_direction(cameras: CameraPath, frame: int, pixels: np.ndarray, others: list[int]) -> np.ndarray:
    """Return (..., 2) along which `pixels (..., 2)` of a frame would shift with their depth, seen from the farthest of the frames
    `others`; 0 without any."""
    if not others:
        return np.zeros(pixels.shape)
    here = cameras[frame]
    steps = (cameras.centers[others] - cameras.centers[frame]) @ here.world_to_camera[:3, :3].T
    step = steps[np.argmax(np.linalg.norm(steps, axis=1))]
    plane = here.on_plane(pixels)
    return step[:2] - plane * step[2]


def fill_inverse_depth(
    inverse: np.ndarray, precision: np.ndarray, guide: np.ndarray, iterations: int = 60, curvature: float = CURVATURE
) -> np.ndarray:
    """Return the inverse depth everywhere `(h, w)` from samples of different precision.

    `guide (h, w)` are grey levels 0..255, whose steps `dI` count as `d = |dI| / EDGE_GREY`, or `(h, w, 3)`: levels whose steps
    `dS` are those of surfaces, how far these are trusted, `t` in 0..1, and grey levels: `d = t |dS| + (1 - t) |dI| / EDGE_GREY`.
    `argmin sum precision (rho - sample)^2 + sum e^{-d} ((rho_p - rho_q)^2 / s^2 + (rho_p - 2 rho_q + rho_r)^2 / c^2)`
    over neighbours along rows and columns, `s` and `c` from `SLOPE` and `curvature` (the inverse depth of a plane is linear
    in the picture), by conjugate gradients started at the solution for half the size; three rounds reweigh outliers.
    Unknown samples have precision 0.
    """
    import cv2

    height, width = inverse.shape
    if min(height, width) >= 2 * COARSEST_SIDE:
        half = (width // 2, height // 2)
        mean = cv2.resize(precision.astype(np.float64), half, interpolation=cv2.INTER_AREA)
        total = cv2.resize(precision * inverse, half, interpolation=cv2.INTER_AREA)
        coarse = fill_inverse_depth(
            np.divide(total, mean, out=np.zeros_like(total), where=mean > 0),
            4 * mean,
            cv2.resize(guide, half, interpolation=cv2.INTER_AREA),
            2 * iterations,
            2
            * curvature,  # the same surface bends four times as much between samples twice as far apart, a quarter as many
        )
        start = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
    else:
        start = pyramid_mean(inverse, precision)
    usual = max(float(np.median(start)), 1e-6)
    bands = _roughness(guide, 1 / (SLOPE * usual) ** 2, 1 / (curvature * usual) ** 2)
    solve = _plain_smooth_map if open_library()[0] is None else _smooth_map
    data, solution = precision.astype(np.float64), start
    limit = 1 / (SAMPLE_NOISE * usual) ** 2
    trusted = np.minimum(data, limit)
    for _ in range(3):
        miss = (inverse - solution) * np.sqrt(np.minimum(data, 6 * limit))
        solution = solve(bands, trusted / (1 + (miss / 3) ** 2), inverse, solution, iterations // 3)
    return solution


def _roughness(guide: np.ndarray, smooth: float, flat: float) -> dict[str, np.ndarray]:
    """Return the normal matrix of the smoothness terms: differences of neighbours, and of those differences along lines.

    Its entries `(h, w)` are those of a pixel with itself and with the one or two to its right or below; 0 where there is none.
    """
    levels = guide.astype(np.float64)
    along, down = (_line_roughness(lines, smooth, flat) for lines in (levels, levels.swapaxes(0, 1)))
    down = down.transpose(0, 2, 1)
    entries = (along[0] + down[0], *along[1:], *down[1:])
    return dict(zip(BANDS, map(np.ascontiguousarray, entries), strict=True))


def _smooth_map(
    bands: dict[str, np.ndarray], weight: np.ndarray, sample: np.ndarray, start: np.ndarray, iterations: int
) -> np.ndarray:
    """Return `(h, w)` where `(matrix of bands + weight) map = weight sample`, by conjugate gradients from `start`."""
    solution, (height, width) = np.array(start, np.float64, order="C"), start.shape
    arrays = {"weight": weight, "sample": np.ascontiguousarray(sample, np.float64), "solution": solution}
    F4X_SMOOTH_MAP(SMOOTHING(width=width, height=height, iterations=iterations, tolerance=MISS_LEFT, **bands, **arrays))
    return solution


def _plain_smooth_map(
    bands: dict[str, np.ndarray], weight: np.ndarray, sample: np.ndarray, start: np.ndarray, iterations: int
) -> np.ndarray:
    """Return the same by scipy."""
    count, width = weight.size, weight.shape[1]
    diagonal = (bands["itself"] + weight).ravel()
    matrix = dia_array((diagonal[None], [0]), shape=(count, count))
    for step, name in zip((1, 2, width, 2 * width), BANDS[1:], strict=True):  # an entry links the pixel p with p + step
        lower = bands[name].ravel()
        upper = np.concatenate([np.zeros(step), lower])[:count]
        matrix = matrix + dia_array((np.stack([lower, upper]), [-step, step]), shape=(count, count))
    wanted, scale = (weight * sample).ravel(), diags_array(1 / diagonal)
    return cg(matrix, wanted, start.ravel(), rtol=MISS_LEFT, maxiter=iterations, M=scale)[0].reshape(weight.shape)


def _line_roughness(levels: np.ndarray, smooth: float, flat: float) -> np.ndarray:
    """Return (3,h,w) entries of the normal matrix along rows of `levels` (h,w[,3]): with itself, the next, the one after."""
    steps = abs(np.diff(levels, axis=1))
    if levels.ndim == 3:
        trust = np.minimum(levels[:, 1:, 1], levels[:, :-1, 1])
        steps = EDGE_GREY * trust * steps[..., 0] + (1 - trust) * steps[..., 2]
    same = np.exp(-steps / EDGE_GREY)  # (h, w-1)
    bend = flat * np.minimum(same[:, :-1], same[:, 1:])  # (h, w-2), weight of (1, -2, 1)
    link = smooth * (EDGE_SLACK + (1 - EDGE_SLACK) * same)  # weight of (-1, 1)
    entries = np.zeros((3, *levels.shape[:2]))
    itself, following, second = entries
    itself[:, :-1] += link
    itself[:, 1:] += link
    itself[:, :-2] += bend
    itself[:, 1:-1] += 4 * bend
    itself[:, 2:] += bend
    following[:, :-1] -= link
    following[:, :-2] -= 2 * bend
    following[:, 1:-1] -= 2 * bend
    second[:, :-2] += bend
    return entries


def ground_prior(cameras: CameraPath) -> np.ndarray:
    """Return the inverse depth `(F, H, W)` of a made-up world: ground below the camera, a far sphere above its horizon.

    Inverse distance is `0.7 + s`, s that of `below_horizon`.
    """
    down, every = cameras.mean_down, pixel_grid(cameras.height, cameras.width)

    def plain(frame: int) -> np.ndarray:
        below = below_horizon(cameras[frame], every, down)
        return (0.7 * below[..., 1] + below[..., 0]).astype(np.float32)

    return np.stack(in_threads(plain, range(len(cameras))))


def below_horizon(camera: Camera, pixels: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Return (..., 2): the sine of the direction of `pixels (..., 2)` below the horizon, 0 above it, and 1; times the ray's length.

    An inverse depth that is linear in them is that of a ground plane below and of a sphere above. `down (3,)` in the world.
    """
    local = camera.on_plane(pixels)
    return np.stack([np.maximum(slope(camera, pixels, down), 0), np.sqrt(1 + (local**2).sum(-1))], -1)


def plain_world(inverse: np.ndarray, precision: np.ndarray, below: np.ndarray, usual: float) -> np.ndarray:
    """Fit a ground plane and a far sphere to samples `inverse (h, w)`, and return their inverse depth `(h, w)`.

    `below (h, w, 2)` as of `below_horizon`; `usual` is the median inverse depth. `PLAIN_SAMPLES` of the plain world of
    `ground_prior` count with the samples.
    """
    shape, values = below.reshape(-1, 2).astype(np.float64), inverse.ravel() / usual
    believed = np.array([1.0, 0.7]) / max(float(np.median(shape @ [1.0, 0.7])), 1e-9)
    trust = np.minimum(precision.ravel() * usual**2, 1 / SAMPLE_NOISE)
    factors = believed
    for _ in range(4):
        weight = trust / (trust + 1 / PLAIN_NOISE**2) / (1 + ((values - shape @ factors) / PLAIN_NOISE) ** 2)
        normal = (shape * weight[:, None]).T @ shape + PLAIN_SAMPLES * np.eye(2)
        factors = np.linalg.solve(normal, (shape * weight[:, None]).T @ values + PLAIN_SAMPLES * believed)
    return usual * (shape @ factors).reshape(inverse.shape)


def _static_depth(
    clip: Clip, priors: Priors, config: PriorsConfig, moving: np.ndarray, progress: Progress, statistics: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse depth and confidence `(F, H, W)` of the static world, also where it is hidden or not seen."""
    import cv2

    assert priors.cameras is not None
    cameras, pictures = priors.cameras, grey(clip.frames[clip.supervised])
    frames, height, width = moving.shape
    blocked = dilate_masks(moving, MOVING_MARGIN)
    samples = _measure(clip, priors, config, pictures, blocked, progress)
    usual = [one.usual for one in samples]
    hidden = None if clip.hidden is None else clip.hidden[priors.frames]
    swept = sweep(cameras, pictures, hidden, samples, STRIDE, lambda done: progress("depth", frames + done, 3 * frames))
    down, grid = cameras.mean_down, sample_grid(height, width)
    inverse, confidence = np.empty((2, *moving.shape), np.float32)

    def solve(i: int) -> float:
        """Write inverse depth and confidence of a frame; returns the fraction of it that is known to better than 10 %."""
        free, min_rho = ~moving[i][SAMPLED], usual[i] / MAX_DEPTH
        joined = join(samples[i], swept[i], free)
        rho, known = np.clip(joined.inverse, min_rho, 1e3 * usual[i]), joined.precision
        plain = np.maximum(plain_world(rho, known, below_horizon(cameras[i], grid, down), usual[i]), min_rho)
        belief = 1 / (PLAIN_NOISE * usual[i]) ** 2
        rho, precision = (known * rho + belief * plain) / (known + belief), known + belief
        looks = cv2.GaussianBlur(pictures[i], (3, 3), 0)[SAMPLED]
        guide = surface_guide(swept[i], joined.trust, ~blocked[i][SAMPLED], looks)
        filled = np.maximum(fill_inverse_depth(rho, precision, guide), min_rho)
        trust = _confidence(filled, rho, known)
        inverse[i] = between_samples(filled, height, width)
        confidence[i] = between_samples(trust, height, width)
        return float((known * filled**2 > 100).mean())

    measured = float(
        np.mean(in_threads(solve, range(frames), lambda done: progress("depth", 2 * frames + done, 3 * frames)))
    )
    statistics["measured_fraction"] = round(measured, 3)
    if measured < 0.2:
        priors.warn(
            f"Depth could be measured on only {100 * measured:.0f} % of the picture (little parallax or texture);"
            " the rest is interpolated."
        )
    return inverse, confidence


SAMPLED = np.s_[STRIDE // 2 :: STRIDE, STRIDE // 2 :: STRIDE]
"""The pixels of a picture on which depth is measured."""


def sample_grid(height: int, width: int) -> np.ndarray:
    """Return (h, w, 2) pixels (x, y) on which depth is measured."""
    return pixel_grid(height, width)[SAMPLED].astype(np.float64)


def between_samples(values: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return (height, width) float32: `values (h, w)` on the `SAMPLED` pixels, linear between them.

    A sample is the value of its own pixel. Taken as that of the square of pixels that it stands for it would lie half a pixel too
    high, and on ground seen at a grazing angle that is 1 % too near.
    """
    import cv2

    step, first = 1 / STRIDE, -(STRIDE // 2) / STRIDE
    how = {"flags": cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, "borderMode": cv2.BORDER_REPLICATE}
    return cv2.warpAffine(
        values.astype(np.float32), np.array([[step, 0, first], [0, step, first]]), (width, height), **how
    )


def _measure(
    clip: Clip, priors: Priors, config: PriorsConfig, pictures: np.ndarray, blocked: np.ndarray, progress: Progress
) -> list[Samples]:
    """Return the samples of every frame from flow and tracks; none where `blocked (F, H, W)`."""
    assert priors.cameras is not None
    cameras, flows, tracks = priors.cameras, long_flows(clip, priors, config, progress), track_samples(priors)
    grid = sample_grid(*blocked.shape[1:])

    def measure(i: int) -> Samples:
        targets = _targets(i, flows, blocked, grid)
        rho, precision = np.zeros((2, *grid.shape[:2]))
        if targets:
            rho, precision = (
                part.reshape(grid.shape[:2])
                for part in inverse_depth_from_flow(cameras, i, grid.reshape(-1, 2), targets)
            )
        along = epipolar_direction(cameras, i, grid, [other for other, _, _ in targets])
        held = texture_along(pictures[i], along)
        precision *= held * ~blocked[i][SAMPLED]
        _add_tracks(rho, precision, tracks[i], blocked[i], held)
        return Samples(rho, precision, held)

    frames = len(blocked)
    return in_threads(measure, range(frames), lambda done: progress("depth", done, 3 * frames))


def _targets(
    frame: int, flows: dict[int, np.ndarray], blocked: np.ndarray, grid: np.ndarray
) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Return (frame, pixels, weights) of the grid in each other frame; weight 0: flow is inconsistent or lands on a mover."""
    _, height, width = blocked.shape
    some = np.s_[STRIDE // 2 :: STRIDE, STRIDE // 2 :: STRIDE]
    targets = []
    for gap, flow in flows.items():
        other = frame + gap
        if not 0 <= other < len(blocked):
            continue
        there, back = flow[frame][some].astype(np.float32), flows[-gap][other].astype(np.float32)
        seen = grid + there
        good = agree(grid, there, look_up(back, seen), height, width)
        x, y = np.clip(seen[..., 0].astype(int), 0, width - 1), np.clip(seen[..., 1].astype(int), 0, height - 1)
        # Flow over a long gap is refined on the pictures but errs more; trust falls with the distance it had to bridge.
        weight = good * ~blocked[other][y, x] / (1 + (abs(gap) / 16) ** 2)
        targets.append((other, seen.reshape(-1, 2).astype(np.float64), weight.ravel()))
    return targets


class TrackSamples(NamedTuple):
    """Static tracks that one frame sees, triangulated over the clip."""

    uv: np.ndarray
    """(n, 2) float64 pixels."""
    inverse: np.ndarray
    """(n,) float64 inverse depth."""
    precision: np.ndarray
    """(n,) float64: 1 / variance of the inverse depth."""


def track_samples(priors: Priors) -> list[TrackSamples]:
    """Return the static tracks of every frame as samples of its inverse depth."""
    assert priors.cameras is not None
    cameras = priors.cameras
    tracks = PointTracks.of(priors)
    frames, nothing = len(cameras), TrackSamples(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    seen = tracks.seen & (tracks.seen.sum(0) >= 3)
    if not seen.any():
        return [nothing] * frames
    fitted = fit_points(cameras, tracks.uv, seen)
    frame, point, z = fitted.frame, fitted.point, fitted.z
    good = fitted.rms < TRACK_OUTLIER_PX
    # Angular noise over the spread of the rays is the relative error of the distance.
    focal = cameras.intrinsics[frame][:, [0, 1], [0, 1]].mean()
    relative = (TRACK_NOISE_PX + fitted.rms) / focal / np.maximum(fitted.spread, 1e-6)
    samples: list[TrackSamples] = []
    for i in range(frames):
        chosen = (frame == i) & good[point]
        inverse = 1 / z[chosen]
        precision: np.ndarray = 1 / (relative[point[chosen]] * inverse) ** 2
        samples.append(TrackSamples(tracks.uv[i, point[chosen]].astype(np.float64), inverse, precision))
    return samples


def _add_tracks(
    rho: np.ndarray, precision: np.ndarray, samples: TrackSamples, blocked: np.ndarray, held: np.ndarray
) -> None:
    """Merge track samples into the grid in place, weighted by precision and by how well the picture holds them, `held (h, w)`."""
    x, y = np.clip(samples.uv.astype(int), 0, np.array(blocked.shape[::-1]) - 1).T
    free = ~blocked[y, x]
    row = np.minimum(y[free] // STRIDE, rho.shape[0] - 1)
    column = np.minimum(x[free] // STRIDE, rho.shape[1] - 1)
    total, sure = rho * precision, samples.precision[free] * held[row, column]
    np.add.at(total, (row, column), samples.inverse[free] * sure)
    np.add.at(precision, (row, column), sure)
    np.divide(total, precision, out=rho, where=precision > 0)


def _confidence(filled: np.ndarray, rho: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Return 0..1 from the relative precision gathered around a pixel, less where samples contradict the filled map."""
    relative = precision * filled**2  # 1 / (relative error)^2
    known = ndimage.gaussian_filter(np.minimum(relative, 400.0), 3)
    miss = ndimage.gaussian_filter(np.where(precision > 0, np.minimum(abs(rho / filled - 1), 1), 0), 1.5)
    return known / (known + 50.0) / (1 + (miss / 0.2) ** 2)
