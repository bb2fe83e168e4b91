"""Finds pixels that move by themselves: a homography of the background leaves them over, and parallax cannot explain them.

Two-view geometry at several frame gaps. The background is first explained by one homography per gap (exact for a turning
camera or a flat scene). Epipolar geometry alone would be blind to everything that moves along with the camera, so what the
homography leaves over is forgiven as parallax only where the picture's border - rarely filled by moving objects - shows
that there is parallax, and only as far as one inverse depth per pixel explains all gaps together (plane + parallax,
Irani & Anandan 1996).

Flow is a guess where nothing has texture: beside a mover, asphalt, sky and walls are dragged along. So a pixel moves only
as far as the background's motion misses its colours by more than the flow does, where nothing that moves is in the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage

from ..parallel import in_threads
from ..progress import Progress
from .alignment import align_tracks
from .config import PriorsConfig
from .flow import consistent_at, grey, inside, length, long_flows, look_up, pixel_grid, sample, warp
from .moving_people import dilate_masks, shows_people, with_people
from .tracks import continue_lost, relink, seed_and_track, thinned

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

STEP = 4
"""Distance in pixels of the samples on which residuals are computed; flow is no finer."""
REFERENCE_WIDTH = 480
"""Longer picture side at which the pixel constants below were tuned; they grow with the picture."""
STATIC_PIXELS = 0.3
"""Median border flow below which the camera stands still and the flow itself is the residual."""
MAGSAC_PIXELS, MAGSAC_ITERATIONS, FITTED_EVERY = 1.0, 300, 3
NOISE_SCALE, NOISE_PIXELS = 3.0, (1.0, 3.0)
"""A residual of 3 x its median over the picture, within 1..3 px, scores one half."""
DOUBT = 0.05
"""Weight of flow that failed the forward-backward test: it counts only where nothing better is known."""
BORDER = 0.1
"""Width of the border used for camera and parallax tests, as a fraction of the image width."""
PARALLAX_FRACTION = 0.15
"""Fraction of the border that parallax must explain, and the homography not, before parallax counts as static everywhere."""
PARALLAX_EVERY = 4
"""Every so many-th frame shows whether there is parallax to forgive."""
PARALLAX_PIXELS, PARALLAX_HYPOTHESES, PARALLAX_ITERATIONS = 0.7, 60, 8
"""Scale of the robust weights, directions tried and refinements of the parallax fit."""
EVIDENCE_BLUR, EVIDENCE_WINDOW = 1.0, 3
"""Colours are compared after a blur by this many pixels, and over a square of so many samples."""
EVIDENCE_CONTRAST, EVIDENCE_GAPS = 0.28, 3
"""The background's motion has to miss the colours by this fraction of the clip's standard deviation more than the flow does before
a pixel is free to move, mean over the gaps that speak most for it: over short gaps a plain side still lies on itself. Chosen on
blackswan, camel, car-shadow, dog and train; there J against DAVIS' masks rises from .64 to .73, on six other clips from .43 to
.60. A fifth of it leaves the asphalt in, and twice as much takes the plain flanks of dog and camel out."""
PEOPLE_COVER = 18
"""Pixels around people that they cover too: a comparison of what is beside them with a place so near to them is none."""
COVERING, ENCLOSED = 0.6, 5
"""Score from which a mover covers what is behind it. Where the background's motion leads there, colours tell nothing of the pixel
that it comes from, which soon disappears behind the mover; gaps of up to so many samples are closed. Chosen, with the width around
people and `AS_SURE`, on blackswan, camel, dog, dance-twirl, parkour, breakdance, horsejump-high and five rendered clips (mean J of
the first masks .56 -> .71); car-shadow, drift-straight, scooter-black and nine other rendered ones .72 -> .77, none worse."""
THRESHOLD_RANGE = (0.35, 0.6)
"""Bounds of the threshold found by Otsu's method: below lies noise, above is certainly motion."""
THRESHOLD_LIFT = 0.05
"""Added to Otsu's threshold: between the classes lies the blurred flow around silhouettes, which is mostly background."""
VOTE_SIGMA = 4.0
"""Gaussian (pixels) by which a track's vote spreads; half the spacing of the seeds."""
SURE = 0.15
"""Score above the threshold from which a pixel is foreground whatever its colour; half the threshold is background."""
CUT_SCALE, CUT_ROUNDS, CUT_MARGIN = 2, 2, 12
"""GrabCut works at half size, for two rounds, this many (small) pixels around the region."""
AGREEMENT = 0.4
"""Weighted fraction of the masks of five neighbouring frames, carried along the flow, that makes a pixel foreground."""
MIN_AREA_FRACTION = 0.001
"""Regions and whole masks smaller than this fraction of the image are noise."""
STATIC_TRACK = 0.5
"""`tracks_motion` above which a track of the uniform pass is replaced by tracks that know the mask."""
MAX_DYNAMIC_FRACTION = 0.6
"""Largest fraction of `TracksConfig.count` that tracks on moving objects may take."""


def provide(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `motion`, `mask` and `tracks_motion`, and densify the tracks on moving objects (provider `classical`).

    A mask that is given stays, and the dense tracks lie on it.
    """
    flows = long_flows(clip, priors, config, progress)
    everyone = shows_people(priors)
    score, statistics = motion_score(clip.frames[clip.supervised], flows, config.motion.gaps, progress, everyone)
    assert priors.tracks is not None and priors.tracks_visible is not None
    score = (score + vote(score, priors.tracks, priors.tracks_visible)) / 2
    threshold = statistics["threshold"] = config.motion.threshold or find_threshold(score)
    crisp = cut_out(clip.frames[clip.supervised], score, threshold)
    crisp = _smooth_in_time(crisp.astype(np.float32), flows) > AGREEMENT  # colours mislead in single frames
    motion = (score + _softened(crisp)) / 2
    whole = with_people(crisp, motion, priors)
    if whole is not crisp:
        motion = (score + _softened(whole)) / 2
    if priors.mask is None:
        priors.mask = whole
    priors.motion = np.clip(motion if whole.any() else score, 0, 1).astype(np.float16)
    statistics["share"] = float(priors.mask.mean())
    statistics["moving"] = bool(priors.mask.any())
    priors.statistics["motion"] = statistics
    if not priors.mask.any():
        priors.warn("Nothing in this clip moves by itself; if something should, give a mask.")
    densify(clip, priors, config, flows, progress)
    _align_static(clip, priors)


def motion_score(
    pictures: np.ndarray,
    flows: dict[int, np.ndarray],
    gaps: tuple[int, ...],
    progress: Progress,
    people: np.ndarray | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the score (F,H,W) float32 in 0..1 that a pixel of `pictures (F,H,W,3)` uint8 moves by itself, and evidence as JSON.

    people: (F,H,W) bool, pixels that show somebody, if known.

    Evidence: `static_camera`, `border_flow` (px, median, gap 1), `homography_residual` (px, median over the border at the
    longest gap), `homography_inliers` (fraction per gap), `border_unexplained` (fraction of border the homography misses),
    `border_parallax` (fraction of border that only parallax explains), `parallax` (whether it was forgiven).
    """
    import cv2

    cv2.setRNGSeed(0)  # MAGSAC draws samples; the same clip must give the same mask
    samples = _Samples.of(flows, gaps)
    (frames, height, width), (rows, columns) = flows[1].shape[:3], samples.grid.shape[:2]
    static, border_flow = samples.camera_stands()
    beyond = _compare(pictures, flows, samples, static, people, progress)
    score = beyond.score()  # (F,P)
    statistics = {"static_camera": static, "border_flow": border_flow} | beyond.border_statistics(score)
    if not static and statistics["border_unexplained"] > PARALLAX_FRACTION:
        score, statistics["border_parallax"] = beyond.forgive_parallax(score)
    statistics["parallax"] = statistics["border_parallax"] > PARALLAX_FRACTION
    contrast = max(float(pictures[:, ::STEP, ::STEP].std((0, 1, 2)).mean()), 1.0)
    score, enough = score.reshape(frames, rows, columns), EVIDENCE_CONTRAST * contrast
    missed, off = (levels.reshape(frames, -1, rows, columns) for levels in (beyond.missed, beyond.off))
    evidence = _evidence(missed, enough)
    hidden = _hidden(score * evidence > COVERING, samples.flows, beyond.residual, samples.gaps)
    score = score * _without_covered(evidence, missed, off, hidden, enough)
    return _smooth_in_time(np.stack(in_threads(lambda one: enlarge(one, height, width), score)), flows), statistics


@dataclass(frozen=True)
class _Samples:
    """The P = h w pixels, one in `STEP` each way, at which motions are compared, and the flow there."""

    grid: np.ndarray
    """(h,w,2) x, y of the pixels."""
    gaps: tuple[int, ...]
    """The K gaps compared, ahead and back."""
    flows: dict[int, np.ndarray]
    """Gap -> (F,h,w,2) pixels, of gap 1 and of `gaps`."""
    unit: float
    """Factor by which constants in pixels grow with the picture."""

    @classmethod
    def of(cls, flows: dict[int, np.ndarray], gaps: tuple[int, ...]) -> _Samples:
        """Sample the `flows` (gap -> (F,H,W,2)) at those of `gaps` that the clip has."""
        frames, height, width = flows[1].shape[:3]
        gaps, every = both_ways(gaps, frames), slice(STEP // 2, None, STEP)
        samples = {gap: flows[gap][:, every, every] for gap in (1, *gaps)}
        return cls(pixel_grid(height, width)[every, every], gaps, samples, max(height, width) / REFERENCE_WIDTH)

    @property
    def points(self) -> np.ndarray:
        """(P,2) the pixels in one row."""
        return self.grid.reshape(-1, 2)

    @property
    def border(self) -> np.ndarray:
        """(P,) bool: the pixel lies on the frame around the picture."""
        return border_of(*self.grid.shape[:2]).ravel()

    def camera_stands(self) -> tuple[bool, float]:
        """Return True if the border hardly flows, and its median flow in pixels over one frame."""
        near, far = (self._border_flow(gap) for gap in (1, max((1, *self.gaps))))
        border_flow = float(np.median(near)) if near.size else 0.0
        # A slow pan also has little flow per frame; it shows over the longest gap.
        slow = not far.size or float(np.median(far)) < 2 * STATIC_PIXELS * self.unit
        return border_flow < STATIC_PIXELS * self.unit and slow, border_flow

    def _border_flow(self, gap: int) -> np.ndarray:
        """Return the lengths (F - gap, b) of the border's flow over `gap` frames."""
        flow = self.flows[gap]
        return length(flow[: len(flow) - gap][:, border_of(*self.grid.shape[:2])].astype(np.float32))


@dataclass(frozen=True)
class _Beyond:
    """Flow beyond the background's motion at the P pixels of `samples`, F frames and K gaps, and what the colours say of both."""

    samples: _Samples
    residual: np.ndarray
    """(F,K,P,2) float32 pixels; 0 where the clip has no such frame."""
    trust: np.ndarray
    """(F,K,P) float32: 1 where the flow returns, `DOUBT` where it does not, 0 where there is none."""
    missed: np.ndarray
    """(F,K,P) float32 levels by which the background's motion misses the colours more than the flow does; NaN = not compared."""
    off: np.ndarray
    """(F,K,P) float32 levels by which the background's motion misses the colours."""
    inliers: np.ndarray
    """(F,K) fraction of the flow that the homography explains; NaN where there is none."""

    @classmethod
    def empty(cls, samples: _Samples) -> _Beyond:
        """Return one to be filled."""
        shape = len(samples.flows[1]), len(samples.gaps), len(samples.points)
        residual, trust = np.zeros((*shape, 2), np.float32), np.zeros(shape, np.float32)
        missed, off = np.full((2, *shape), np.nan, np.float32)
        return cls(samples, residual, trust, missed, off, np.full(shape[:2], np.nan))

    def score(self) -> np.ndarray:
        """Return (F,P) in 0..1, how surely a pixel does not move like the background."""
        return score_of_residuals(length(self.residual), self.trust, self.samples.unit)

    def border_statistics(self, score: np.ndarray) -> dict[str, Any]:
        """Return how well one homography explains the border: the evidence of `motion_score` before parallax is looked at."""
        gaps, edge = self.samples.gaps, self.samples.border
        last = np.abs(gaps) == max(np.abs(gaps), default=1)
        return {
            "homography_residual": _median(
                length(self.residual[:, last][:, :, edge])[self.trust[:, last][..., edge] == 1]
            ),
            "homography_inliers": {
                str(gap): float(np.nanmean(found))
                for gap, found in zip(gaps, self.inliers.T, strict=True)
                if np.isfinite(found).any()
            },
            "border_unexplained": float((score[:, edge] > 0.5).mean()),
            "border_parallax": 0.0,
        }

    def forgive_parallax(self, score: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the `score (F,P)`, less where parallax explains it, and the fraction of the border that parallax alone explains.

        Of a border with too little parallax the score comes back as it is.
        """
        some, edge = np.arange(0, len(score), PARALLAX_EVERY), self.samples.border
        forgiven = self._score_by_parallax(some)
        parallax = float(((score[some][:, edge] > 0.5) & (forgiven[:, edge] < 0.25)).mean())
        if parallax > PARALLAX_FRACTION:
            score = np.sqrt(score * self._score_by_parallax(np.arange(len(score))))
        return score, parallax

    def _score_by_parallax(self, frames: np.ndarray) -> np.ndarray:
        """Return (f,P): `score` of what one inverse depth per pixel does not explain in `frames (f,)`."""
        samples = self.samples
        left = _left_by_parallax(frames, self.residual, self.trust, samples.points, samples.unit)
        return score_of_residuals(left, self.trust[frames], samples.unit)


def _compare(
    pictures: np.ndarray,
    flows: dict[int, np.ndarray],
    samples: _Samples,
    static: bool,
    people: np.ndarray | None,
    progress: Progress,
) -> _Beyond:
    """Compare the flow with the background's motion: one homography per frame and gap, none for a `static` camera.

    Where the background's motion leads to one of the `people (F,H,W)` from a pixel that shows none, colours are not compared.
    """
    import cv2

    (frames, height, width), grid, points = flows[1].shape[:3], samples.grid, samples.points
    beyond = _Beyond.empty(samples)
    soft = np.stack(in_threads(lambda picture: cv2.GaussianBlur(picture, (0, 0), EVIDENCE_BLUR), pictures))
    if people is not None:
        around = dilate_masks(people, round(PEOPLE_COVER * samples.unit)).astype(np.float32)
        shown = people[:, STEP // 2 :: STEP, STEP // 2 :: STEP].reshape(frames, -1)

    def compare(t: int) -> None:
        own = look_up(soft[t].astype(np.float32), grid)
        for j, gap in enumerate(samples.gaps):
            if not 0 <= t + gap < frames:
                continue
            flow = samples.flows[gap][t].reshape(-1, 2).astype(np.float64)
            good = consistent_at(points, flow, flows[-gap][t + gap])
            left, beyond.inliers[t, j] = (flow, 1.0) if static else _off_homography(points, flow, good, samples.unit)
            beyond.residual[t, j], beyond.trust[t, j] = left, np.where(good, 1.0, DOUBT)
            by_flow, by_background = points + flow, points + flow - beyond.residual[t, j]
            there = soft[t + gap].astype(np.float32)
            more, less = (
                abs(look_up(there, seen.reshape(grid.shape)) - own).mean(-1) for seen in (by_background, by_flow)
            )
            compared = good & inside(by_background, height, width)
            if people is not None:
                compared &= shown[t] | (look_up(around[t + gap], by_background.reshape(grid.shape)) == 0).ravel()
            beyond.missed[t, j] = np.where(compared, (more - less).ravel(), np.nan)
            beyond.off[t, j] = more.ravel()

    in_threads(compare, range(frames), lambda done: progress("motion", done, frames))
    return beyond


def both_ways(gaps: tuple[int, ...], frames: int) -> tuple[int, ...]:
    """Return the gaps that a clip of `frames` has, ahead and back."""
    return tuple(sign * gap for gap in gaps for sign in (1, -1) if gap < frames)


def border_of(rows: int, columns: int) -> np.ndarray:
    """Return (rows,columns) bool: the frame around the picture."""
    border = np.ones((rows, columns), bool)
    top, side = max(1, round(BORDER * rows)), max(1, round(BORDER * columns))
    border[top : rows - top, side : columns - side] = False
    return border


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if values.size else 0.0


def _off_homography(points: np.ndarray, flow: np.ndarray, good: np.ndarray, unit: float) -> tuple[np.ndarray, float]:
    """Return (P,2) flow beyond the homography of the background, in pixels, and the fraction of inliers."""
    import cv2

    fitted = np.nonzero(good)[0][::FITTED_EVERY]
    target = points + flow
    try:
        homography, inlier = cv2.findHomography(
            points[fitted], target[fitted], cv2.USAC_MAGSAC, MAGSAC_PIXELS * unit, maxIters=MAGSAC_ITERATIONS
        )
    except cv2.error:  # USAC throws on degenerate input
        homography = None
    if homography is None:  # no common motion at all: compare with standing still
        return flow, 0.0
    return target - cv2.perspectiveTransform(points[:, None].astype(np.float64), homography)[:, 0], float(inlier.mean())


def _left_by_parallax(
    frames: np.ndarray, residual: np.ndarray, trust: np.ndarray, points: np.ndarray, unit: float
) -> np.ndarray:
    """Return (f,K,P) what `_off_parallax` leaves of `residual (F,K,P,2)` in the frames `(f,)`."""
    return np.stack(in_threads(lambda t: _off_parallax(residual[t], trust[t], points, unit, int(t)), frames))


def _off_parallax(residual: np.ndarray, trust: np.ndarray, points: np.ndarray, unit: float, seed: int) -> np.ndarray:
    """Return (K,P) pixels left when one relative depth per point explains its residuals (K,P,2) of all gaps.

    Model: r_k(x) = rho(x) (a_k + b_k (x - centre)): plane + parallax with the epipole at -a_k / b_k.
    """
    live = trust.any(1)
    r, weight = residual[live].astype(np.float64), trust[live].astype(np.float64)
    scale, x = PARALLAX_PIXELS * unit, (points - points.mean(0)) / np.ptp(points[:, 0])
    some, left = np.arange(0, len(points), 3), length(residual)
    motion = _common_parallax(r[:, some], weight[:, some], x[some], scale, seed)
    if motion is not None:
        left[live] = _fit_depths(r, weight, motion[:, None, :2] + motion[:, None, 2:] * x)[1]
    return left


def _fit_depths(r: np.ndarray, weight: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the depths rho (P,) by which `field (K,P,2)` explains the residuals `r (K,P,2)` best, and pixels left (K,P)."""
    rho = np.einsum("kpc,kpc,kp->p", r, field, weight) / np.maximum(
        np.einsum("kpc,kpc,kp->p", field, field, weight), 1e-9
    )
    return rho, length(r - rho[:, None] * field)


def _common_parallax(r: np.ndarray, weight: np.ndarray, x: np.ndarray, scale: float, seed: int) -> np.ndarray | None:
    """Return (K,3) a_k and b_k of `_off_parallax`, robustly; None where too few residuals `r (K,P,2)` are above `scale` pixels.

    The residuals of one point, of several at random that which explains the most, are where the fit starts.
    """
    strong = np.flatnonzero((np.median(length(r), axis=0) > 2 * scale) & (weight == 1).all(0))
    if len(strong) < 8:
        return None
    chosen = np.random.default_rng(seed).choice(strong, min(PARALLAX_HYPOTHESES, len(strong)), replace=False)
    fits = [_fit_depths(r, weight, np.repeat(r[:, [i]], len(x), 1))[1] for i in chosen]
    best = chosen[int(np.argmax([(weight / (1 + (fit / scale) ** 2)).sum() for fit in fits]))]
    motion = np.column_stack([r[:, best], np.zeros(len(r))])
    for _ in range(PARALLAX_ITERATIONS):
        rho, error = _fit_depths(r, weight, motion[:, None, :2] + motion[:, None, 2:] * x)
        robust = weight / (1 + (error / scale) ** 2) ** 2
        design = np.zeros((len(x), 2, 3))
        design[:, 0, 0] = design[:, 1, 1] = rho
        design[:, :, 2] = rho[:, None] * x
        for k in range(len(r)):
            weighted = design * robust[k][:, None, None]
            normal = np.einsum("pci,pcj->ij", weighted, design) + 1e-9 * np.eye(3)
            motion[k] = np.linalg.solve(normal, np.einsum("pci,pc->i", weighted, r[k]))
    return motion


def score_of_residuals(residual: np.ndarray, trust: np.ndarray, unit: float) -> np.ndarray:
    """Return (F,K,P) pixels to (F,P) in 0..1: mean over the gaps of e / (e + noise)."""
    noise = NOISE_SCALE * np.median(residual, axis=-1, keepdims=True)
    noise = np.clip(noise, NOISE_PIXELS[0] * unit, NOISE_PIXELS[1] * unit)
    return (trust * residual / (residual + noise)).sum(1) / np.maximum(trust.sum(1), 1e-6)


def _evidence(missed: np.ndarray, enough: float) -> np.ndarray:
    """Return (F,h,w) in 0..1: the evidence of colors for a motion of its own.

    `missed (F,K,h,w)`: levels by which the background's motion misses the colors, more than the flow does; NaN = not compared.
    `enough` levels are certain.
    """
    known = np.isfinite(missed)
    near = _near(missed, known)
    surest = np.sort(np.where(known, np.clip(near / enough, 0, 1), 0), axis=1)[:, -EVIDENCE_GAPS:].sum(1)
    return surest / np.clip(known.sum(1), 1, EVIDENCE_GAPS)


def _near(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return (F,K,h,w) mean of what is `known` of `values` over a square of `EVIDENCE_WINDOW` samples."""
    window = (0, 0, EVIDENCE_WINDOW, EVIDENCE_WINDOW)
    total = ndimage.uniform_filter(np.where(known, values, 0), window)
    return total / np.maximum(ndimage.uniform_filter(known.astype(np.float32), window), 1e-3)


def _hidden(
    covering: np.ndarray, flow: dict[int, np.ndarray], residual: np.ndarray, gaps: tuple[int, ...]
) -> np.ndarray:
    """Return (F,K,h,w) bool: the background's motion leads behind what is `covering (F,h,w)` in the other frame, a sample wide.

    flow: per gap (F,h,w,2) pixels; residual: (F,K,h*w,2) pixels beyond the background's motion.
    """
    frames, rows, columns = covering.shape
    wide = ndimage.maximum_filter(covering.astype(np.float32), (0, 3, 3), mode="nearest")
    grid, hidden = pixel_grid(rows, columns), np.zeros((frames, len(gaps), rows, columns), bool)

    def look(t: int) -> None:
        for j, gap in enumerate(gaps):
            if 0 <= t + gap < frames:
                behind = grid + (flow[gap][t] - residual[t, j].reshape(grid.shape)) / STEP
                hidden[t, j] = look_up(wide[t + gap], behind) > 0.5

    in_threads(look, range(frames))
    return hidden


def _without_covered(
    evidence: np.ndarray, missed: np.ndarray, off: np.ndarray, hidden: np.ndarray, enough: float
) -> np.ndarray:
    """Return `evidence (F,h,w)` without `hidden` comparisons, where the background's motion explains one of the others.

    missed, off: (F,K,h,w) levels by which the background's motion misses the colours, more than the flow does and in all; what
    is as enclosed by evidence as `ENCLOSED` samples keeps its own: sides of an animal that look like the wall behind it.
    """
    import cv2

    free = np.where(hidden, np.nan, missed)
    known = np.isfinite(free)
    explained = (known & (_near(off, known) < enough)).any(1)
    found = np.where(explained, _evidence(free, enough), evidence).astype(np.float32)
    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (ENCLOSED, ENCLOSED))
    closed = np.stack(in_threads(lambda one: cv2.morphologyEx(one, cv2.MORPH_CLOSE, ellipse), found))
    return np.minimum(closed, np.maximum(evidence, found))


def enlarge(coarse: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return (H,W) float32 of samples every `STEP` pixels (offset STEP / 2)."""
    return sample(coarse, (pixel_grid(height, width) - STEP // 2 - 0.5) / STEP + 0.5).astype(np.float32)


def _smooth_in_time(score: np.ndarray, flows: dict[int, np.ndarray]) -> np.ndarray:
    """Return the mean of each frame's score with its neighbours' (half the weight), carried along the flow."""
    frames = len(score)

    def mean(t: int) -> np.ndarray:
        there = [gap for gap in (-2, -1, 1, 2) if gap in flows and 0 <= t + gap < frames]
        carried = [0.5 * warp(score[t + gap], flows[gap][t].astype(np.float32)) for gap in there]
        return sum(carried, score[t]) / (1 + 0.5 * len(there))

    return np.stack(in_threads(mean, range(frames)))


def vote(score: np.ndarray, tracks: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return (F,H,W) float32: `tracks_motion` of the tracks (F,N,2) around each pixel, so that what rests for a while is kept."""
    import cv2

    frames, height, width = score.shape
    motion = tracks_motion(tracks, visible, score)
    min_count = 0.1 / (2 * np.pi * VOTE_SIGMA**2)  # a tenth of one track at its own place

    def around(t: int) -> np.ndarray:
        column, row = np.clip(np.floor(tracks[t, visible[t]]), 0, (width - 1, height - 1)).astype(int).T
        count, total = np.zeros((2, height, width), np.float32)
        np.add.at(count, (row, column), 1)
        np.add.at(total, (row, column), motion[visible[t]])
        count, total = (cv2.GaussianBlur(one, (0, 0), VOTE_SIGMA) for one in (count, total))
        return np.where(count > min_count, total / np.maximum(count, min_count), score[t])

    return np.stack(in_threads(around, range(frames)))


def find_threshold(score: np.ndarray) -> float:
    """Return Otsu's threshold of a score in 0..1, raised by `THRESHOLD_LIFT` and kept within `THRESHOLD_RANGE`."""
    count, edges = np.histogram(score, 256, (0, 1))
    fraction, centre = count / max(count.sum(), 1), (edges[1:] + edges[:-1]) / 2
    below, mean = np.cumsum(fraction), np.cumsum(fraction * centre)
    between = (mean[-1] * below - mean) ** 2 / np.maximum(below * (1 - below), 1e-9)
    return float(np.clip(centre[between.argmax()] + THRESHOLD_LIFT, *THRESHOLD_RANGE))


def cut_out(frames: np.ndarray, score: np.ndarray, threshold: float) -> np.ndarray:
    """Return (F,H,W) bool: score above the threshold, cut along colour edges (GrabCut), without specks.

    Empty when next to nothing is left. frames: (F,H,W,3) uint8.
    """
    mask = np.stack(in_threads(lambda one: without_specks(one > threshold), score))
    if mask.mean() < MIN_AREA_FRACTION:
        return np.zeros_like(mask)
    return np.stack(in_threads(lambda t: _cut(frames[t], score[t], mask[t], threshold), range(len(frames))))


def without_specks(mask: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: small gaps closed, small regions dropped."""
    import cv2

    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, ellipse)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(closed)
    return (statistics[:, cv2.CC_STAT_AREA] >= MIN_AREA_FRACTION * mask.size)[labels] & (labels > 0)


def _cut(frame: np.ndarray, score: np.ndarray, mask: np.ndarray, threshold: float) -> np.ndarray:
    """Return (H,W) bool: `mask` moved to the colour edges of `frame` where the score leaves room for doubt."""
    import cv2

    size = max(mask.shape[1] // CUT_SCALE, 1), max(mask.shape[0] // CUT_SCALE, 1)
    picture = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
    small, region = cv2.resize(score, size), cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    square = np.ones((3, 3), np.uint8)
    sure = cv2.erode(region * (small > threshold + SURE).astype(np.uint8), square) > 0
    labels = np.where(region > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[cv2.dilate(region, square, iterations=3) == 0] = cv2.GC_BGD
    labels[small < threshold / 2] = cv2.GC_BGD
    labels[sure] = cv2.GC_FGD
    x, y, w, h = cv2.boundingRect(region)
    box = np.s_[max(y - CUT_MARGIN, 0) : y + h + CUT_MARGIN, max(x - CUT_MARGIN, 0) : x + w + CUT_MARGIN]
    inside, models = labels[box].copy(), np.zeros((2, 1, 65))
    foreground = (inside == cv2.GC_FGD) | (inside == cv2.GC_PR_FGD)
    if not foreground.any() or foreground.all():
        return mask
    cv2.setRNGSeed(0)  # of this thread: colour models begin with random means
    try:
        cv2.grabCut(np.ascontiguousarray(picture[box]), inside, None, *models, CUT_ROUNDS, cv2.GC_INIT_WITH_MASK)  # type: ignore[call-overload]
    except cv2.error:  # too few pixels for its colour models
        return mask
    labels[box] = inside
    cut = ((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)).astype(np.float32)
    return without_specks(cv2.resize(cut, mask.shape[::-1]) > 0.5)


def _softened(mask: np.ndarray) -> np.ndarray:
    """Return (F,H,W) float32: the mask with edges two pixels wide."""
    import cv2

    return np.stack(in_threads(lambda one: cv2.GaussianBlur(one.astype(np.float32), (0, 0), 2), mask))


def tracks_motion(tracks: np.ndarray, visible: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return (N,) float32: mean of the larger half of `motion` (F,H,W) along the visible samples - what rests at times moves."""
    frames, count = visible.shape
    along = np.full((frames, count), -1.0)
    for t in range(frames):
        along[t, visible[t]] = sample(motion[t].astype(np.float32), tracks[t, visible[t]])
    along = -np.sort(-along, axis=0)
    half = np.maximum((visible.sum(0) + 1) // 2, 1)  # (N,)
    return np.clip((np.maximum(along, 0) * (np.arange(frames)[:, None] < half)).sum(0) / half, 0, 1).astype(np.float32)


def densify(
    clip: Clip,
    priors: Priors,
    config: PriorsConfig,
    flows: dict[int, np.ndarray],
    progress: Progress,
    known: np.ndarray | None = None,
) -> None:
    """Replace the uniform pass's tracks on moving objects by denser ones that know the mask; fill `tracks_motion`.

    known: indices of further tracks that stand still, which stay.
    """
    mask, given = priors.mask, priors.provenance.get("tracks", {}).get("provider") in ("user", "files")
    assert mask is not None and priors.motion is not None and priors.tracks is not None
    assert priors.tracks_visible is not None
    evidence = mask.astype(np.float32)
    priors.tracks_motion = tracks_motion(priors.tracks, priors.tracks_visible, evidence)
    if given or not mask.any():
        return
    uniform = priors.statistics.get("tracks", {}).get("uniform", priors.tracks.shape[1])
    static = np.nonzero(priors.tracks_motion[:uniform] <= STATIC_TRACK)[0]
    static = static if known is None else np.union1d(static, known)
    dense, seen = seed_and_track(flows, config.tracks.dynamic_spacing, config.tracks, mask, progress)
    joins = continued = 0
    if config.tracks.relink_gap > 0:
        pictures, gap = grey(clip.frames[clip.supervised]), config.tracks.relink_gap
        dense, seen, joins = relink(dense, seen, pictures, gap, progress)
        dense, seen, continued = continue_lost(dense, seen, pictures, gap, progress)
    dense, seen = thinned(dense, seen, int(MAX_DYNAMIC_FRACTION * config.tracks.count))
    background = thinned(
        priors.tracks[:, static], priors.tracks_visible[:, static], config.tracks.count - dense.shape[1]
    )
    priors.tracks = np.concatenate([background[0], dense], 1)
    priors.tracks_visible = np.concatenate([background[1], seen], 1)
    priors.tracks_motion = tracks_motion(priors.tracks, priors.tracks_visible, evidence)
    priors.statistics["tracks"] |= {
        "uniform": background[0].shape[1],
        "dynamic": dense.shape[1],
        "dynamic_joins": joins,
        "dynamic_continued": continued,
    }


def _align_static(clip: Clip, priors: Priors) -> None:
    """Remove the drift from static tracks; tracks that the user gave stay unchanged."""
    assert priors.tracks is not None and priors.tracks_visible is not None and priors.tracks_motion is not None
    if priors.provenance.get("tracks", {}).get("provider") in ("user", "files"):
        return
    still = np.flatnonzero(priors.tracks_motion <= STATIC_TRACK)
    tracks = priors.tracks.copy()
    tracks[:, still] = align_tracks(
        tracks[:, still], priors.tracks_visible[:, still], grey(clip.frames[clip.supervised])
    )
    priors.tracks = tracks
