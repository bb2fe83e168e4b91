"""Chooses between a solution for the cameras and its mirror image in depth (Necker reversal).

With little translation `u ~ R + t / z`, so `(t, 1/z)` and `(-t, c - 1/z)` explain tracks alike but for perspective, and
an adjustment stays with the one it started near: perhaps sky in front and foreground behind. Here both are adjusted and
compared by their errors and by depth cues: what is lower in the image is nearer, what occludes is nearer, moving objects
are in front of their background, and the depth agrees with a depth prior where there is one. The margin of
the decision is the sum of log-odds; the scales of its terms were chosen on bedroom, blackswan, camel, car-shadow, dog and
train (DAVIS and SAM 2 clips), not on the clips that they are judged on.
Source: Szeliski and Kang, "Shape ambiguities in structure from motion", 1997 (bas-relief, Necker reversal).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.arrays import rank_correlation
from ..parallel import in_threads
from .bundle import Bundle, BundleConfig, Observations, adjust, sighting_costs, total_cost, triangulate
from .point_tracks import PointTracks

GRADUAL_PX, GRADUAL_STEPS = (16.0, 4.0, 1.0), (12, 12, 25)
"""Cauchy scales in pixels, coarse first, and the steps spent at each: parallax of tens of pixels must not look like outliers
to a start that knows no translation."""
EXTREMES = (2, 98)
"""Percentiles of inverse distance between which the mirror image is taken."""
MIN_MIRRORED_INVERSE = 0.02
"""Least inverse distance in the mirror image, as a fraction of the largest."""
ERROR_WEIGHT, ERROR_LIMIT = 0.4, 8.0
"""Log-odds per standard error by which the robust squared errors of one solution are smaller, over the parts of the picture
(`PARTS`), and the most that errors may say. Tracks of one part err together: on a thing that moves a little by itself, along an
edge, or where the lens bends. So a wrong solution had up to 14 % less error in real clips (camel, with a longer lens), 18 % in
rendered rooms: 2.4 and 3.6 such standard errors. The weight was chosen on 37 decisions on whole and halved clips and 35 on noisy
rooms. What is believed of the lens is left out: a focal length 2.5 times the expected one would overrule blackswan's errors."""
PARTS = (8, 5)
"""Columns and rows of the parts of the picture whose tracks are taken to err alike."""
MIN_PARTS = 6
"""Parts below which errors say nothing."""
LOWER_WEIGHT = 3.0
"""Log-odds where inverse depth grows a little with the image row in one solution and falls as much in the other, per rank
correlation."""
LOWER_CLEAR = 1.5
"""A clear order from top to bottom says more than in proportion: the rating of a rank correlation r is r (1 + 1.5 r^2). Hardly a
scene is farther below throughout. Of car-shadow's every third frame the wrong way round errs by 8 % less, at r = -.82 against +.82;
of 19 decisions on real clips this one alone changed."""
MOVER_WEIGHT = 1.5
"""Log-odds where every mover stands on ground that is nearer than what is beside its upper half in one solution only."""
OCCLUSION_WEIGHT, OCCLUSION_LIMIT = 0.5, 3.0
"""Log-odds per standard deviation by which tracks end at nearer neighbours more often than at farther ones, and the most."""
DEPTH_PRIOR_WEIGHT = 8.0
"""Log-odds where a depth prior agrees with one solution (rank correlation +1) and contradicts the other."""
ANOTHER_WORLD = 0.5
"""Rank correlation of two solutions' distances below which they are two worlds and not one."""
DEPENDENT_TRACKS = 10.0
"""Tracks that end at the same edge are not independent: so many count as one."""
SURE, LIKELY = 4.6, 1.1
"""Log-odds of 99 : 1 and of 3 : 1."""
NEIGHBOUR_PX, APPROACH_PX = 20.0, 0.1
"""Largest distance between a track and one that it hides, and least speed of their approach per frame, in a picture 480 wide."""
RIM_PX = 10.0
"""Tracks that end within so many pixels (480 wide) of the rim or of a mover do so for reasons of their own."""
MIN_SAMPLES = 20
"""Smallest number of points or events that counts as evidence."""


@dataclass(frozen=True)
class Evidence:
    """One kind of evidence for which of two solutions is the right way round."""

    what: str
    """Name of the kind of evidence."""
    log_odds: float
    """Natural logarithm of the odds, positive in favour of the first solution."""
    detail: str
    """The measurement behind it."""


@dataclass(frozen=True)
class DepthCues:
    """Inputs besides the sampled observations that show what is near and what is far. F frames, N tracks."""

    frames: np.ndarray
    """(S,) which of the F frames the sampled cameras belong to."""
    tracks: PointTracks
    """Tracks of all frames."""
    mask: np.ndarray | None = None
    """(F, H, W) bool, moving objects."""
    depth: np.ndarray | None = None
    """(F, H, W) a depth prior in any unit."""


@dataclass(frozen=True)
class Decision:
    """The solution that was chosen, and the evidence that it is the right way round."""

    bundle: Bundle
    mirrored: bool
    """True when the mirror image of the solution with the least error was chosen."""
    evidence: tuple[Evidence, ...]
    """Positive log-odds speak for the chosen solution."""
    rejected: Bundle | None = None
    """The solution that lost; None where there was only one."""

    @property
    def margin(self) -> float:
        """Total log-odds in favour of the chosen solution."""
        return sum(item.log_odds for item in self.evidence)

    @property
    def verdict(self) -> str:
        """`sure`, `likely` or `toss-up`."""
        return "sure" if self.margin >= SURE else "likely" if self.margin >= LIKELY else "toss-up"

    def summary(self) -> dict[str, Any]:
        """Return plain values for the statistics of the priors."""
        return {
            "verdict": self.verdict,
            "chosen": "mirrored" if self.mirrored else "least error",
            "margin": round(self.margin, 2),
            "evidence": [
                {"what": item.what, "for": round(item.log_odds, 2), "detail": item.detail} for item in self.evidence
            ],
        }


def adjust_coarse_to_fine(bundle: Bundle, observations: Observations, config: BundleConfig, first: int = 0) -> Bundle:
    """Adjust a rough start with a robust scale that falls along `GRADUAL_PX`, from entry `first` to the last."""
    for scale, steps in zip(GRADUAL_PX[first:], GRADUAL_STEPS[first:], strict=True):
        bundle = adjust(bundle, observations, replace(config, robust_px=scale, iterations=steps))
    return bundle


def mirrored(bundle: Bundle) -> Bundle:
    """Return the mirror image in depth: centres reflected at the middle camera's, inverse distance -> largest + smallest - it.

    Each camera is turned so that its points stay where they were seen, as well as a turn can do it.
    """
    middle = bundle.center[len(bundle.center) // 2]
    offset = bundle.points - middle
    distance = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-12)
    inverse = 1 / distance
    smallest, largest = np.percentile(inverse, EXTREMES)
    flipped = np.maximum(smallest + largest - inverse, MIN_MIRRORED_INVERSE * largest)
    points = middle + offset / distance / flipped
    centers = 2 * middle - bundle.center
    rotations = bundle.rotation.copy()
    for frame, rotation in enumerate(bundle.rotation):
        before, after = bundle.points - bundle.center[frame], points - centers[frame]
        seen = before @ rotation[2] > 0.5 * np.linalg.norm(before, axis=1)
        if seen.sum() >= 3:
            before, after = (side[seen] / np.linalg.norm(side[seen], axis=1, keepdims=True) for side in (before, after))
            u, _, vt = np.linalg.svd(before.T @ after)
            rotations[frame] = rotation @ (u @ np.diag([1, 1, np.linalg.det(u) * np.linalg.det(vt)]) @ vt)
    return replace(bundle, rotation=rotations, center=centers, points=points)


def choose_orientation(
    starts: Sequence[Bundle], observations: Observations, config: BundleConfig, cues: DepthCues
) -> Decision:
    """Adjust `starts` and their mirror images, and choose between the two orientations by their errors and the depth cues.

    Each orientation is represented by its solution with the least cost, because an adjustment may stop early.
    """
    config = replace(config, robust_px=GRADUAL_PX[-1])

    def both(start: Bundle) -> tuple[Bundle, Bundle]:
        """Return a start adjusted, and its mirror image."""
        own = adjust_coarse_to_fine(start, observations, config)
        # At the coarsest scale a mirror image slips back to where it came from.
        return own, adjust_coarse_to_fine(mirrored(own), observations, config, first=1)

    found = [bundle for pair in zip(*in_threads(both, starts), strict=True) for bundle in pair]
    found.sort(key=lambda bundle: total_cost(bundle, observations, config))
    first = found[0]
    agreement = [_agreement(first, bundle) for bundle in found]
    # The other way round where there is one, else another world at least.
    limit = next((limit for limit in (0.0, ANOTHER_WORLD) if min(agreement) < limit), None)
    second = None if limit is None else found[next(i for i, value in enumerate(agreement) if value < limit)]
    if second is None:
        alone = Evidence("reprojection", ERROR_LIMIT, "the mirrored solution turns back into this one by itself")
        return Decision(first, False, (alone,))
    return decide(first, second, observations, config, cues)


def decide(
    first: Bundle, second: Bundle, observations: Observations, config: BundleConfig, cues: DepthCues
) -> Decision:
    """Choose between two solutions of the same observations, the `first` of which costs less (`total_cost`)."""
    evidence = compare_orientations(first, second, observations, config, cues)
    if sum(item.log_odds for item in evidence) >= 0:
        return Decision(first, False, tuple(evidence), second)
    return Decision(second, True, tuple(replace(item, log_odds=-item.log_odds) for item in evidence), first)


def compare_orientations(
    first: Bundle, second: Bundle, observations: Observations, config: BundleConfig, cues: DepthCues
) -> list[Evidence]:
    """Return all evidence about two solutions of the same observations, positive in favour of `first`."""
    errors = [float(np.median(bundle.errors(observations))) for bundle in (first, second)]
    apart = _standard_errors(first, second, observations, config)
    found = [
        Evidence(
            "reprojection",
            float(np.clip(ERROR_WEIGHT * apart, -ERROR_LIMIT, ERROR_LIMIT)),
            f"{errors[0]:.3f} px against {errors[1]:.3f} px (median), better by {apart:+.1f} standard errors over the picture",
        )
    ]
    found += _rating_evidence("lower is nearer", LOWER_WEIGHT, _lower_is_nearer, first, second, observations)
    dense, other = (_track_depths(bundle, cues) for bundle in (first, second))
    if cues.mask is not None and cues.mask.any():
        found += _rating_evidence("movers stand in front", MOVER_WEIGHT, _movers_in_front, dense, other, cues)
    found += _tracks_end_behind(dense, other, cues)
    if cues.depth is not None:
        found += _rating_evidence("depth prior", DEPTH_PRIOR_WEIGHT, _agrees_with_prior, dense, other, cues)
    return found


def _standard_errors(first: Bundle, second: Bundle, observations: Observations, config: BundleConfig) -> float:
    """Return by how many standard errors `first` explains the picture better, its parts as independent (Vuong's statistic).

    Source: Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", 1989.
    """
    gains = sighting_costs(second, observations, config) - sighting_costs(first, observations, config)
    point, size = observations.point, 2 * first.principal
    count = np.maximum(np.bincount(point), 1)
    place = np.stack([np.bincount(point, axis) / count for axis in observations.uv.T], 1)
    column, row = np.clip(place / size * PARTS, 0, np.array(PARTS) - 1).astype(int).T
    _, part = np.unique((column * PARTS[1] + row)[point], return_inverse=True)
    sums = np.bincount(part, gains)
    spread = float(np.std(sums, ddof=1)) if len(sums) >= MIN_PARTS else 0.0
    return float(sums.sum() / (spread * np.sqrt(len(sums)))) if spread else 0.0


@dataclass(frozen=True)
class _TrackDepths:
    """Inverse depth of all static tracks in one solution."""

    inverse: np.ndarray
    """(F, N) in the camera of each sampled frame, NaN where unknown."""


def _track_depths(bundle: Bundle, cues: DepthCues) -> _TrackDepths:
    """Return the static tracks triangulated from the sampled cameras, and their inverse depth there."""
    frames, kept = cues.frames, np.flatnonzero(cues.tracks.static & (cues.tracks.visible[cues.frames].sum(0) > 2))
    frame, point = np.nonzero(cues.tracks.visible[frames][:, kept])
    uv = cues.tracks.uv[frames][:, kept][frame, point].astype(np.float64)
    points, _ = triangulate(bundle, Observations(frame, point, uv, np.ones(len(frame))), len(kept))
    z = np.einsum("fj,fnj->fn", bundle.rotation[:, 2], points[None] - bundle.center[:, None])
    inverse = np.full(cues.tracks.visible.shape, np.nan)
    inverse[frames[:, None], kept] = np.where(z > 0, 1 / np.where(z > 0, z, 1), np.nan)
    return _TrackDepths(inverse)


def _rating_evidence(
    what: str, weight: float, rate: Callable[..., float], first: Any, second: Any, *more: Any
) -> list[Evidence]:
    """Return the evidence from `rate`, which rates a solution from -1 (wrong) to 1 (right); empty where either has no rating."""
    ratings = rate(first, *more), rate(second, *more)
    if not np.isfinite(ratings).all():
        return []
    return [Evidence(what, weight * (ratings[0] - ratings[1]) / 2, f"{ratings[0]:+.2f} against {ratings[1]:+.2f}")]


def _agreement(a: Bundle, b: Bundle) -> float:
    """Return the rank correlation of the distances of two solutions' points from their middle cameras."""
    distances = [np.linalg.norm(one.points - one.center[len(one.center) // 2], axis=1) for one in (a, b)]
    return rank_correlation(*distances)


def _lower_is_nearer(bundle: Bundle, observations: Observations) -> float:
    """Return the mean rank correlation of image row and inverse depth over the frames, a clear one emphasised (`LOWER_CLEAR`)."""
    z = bundle.local(observations)[:, 2]
    found = []
    for frame in range(len(bundle.center)):
        seen = (observations.frame == frame) & (z > 0)
        if seen.sum() >= MIN_SAMPLES:
            found.append(rank_correlation(observations.uv[seen, 1], 1 / z[seen]))
    order = float(np.mean(found)) if found else np.nan
    return order * (1 + LOWER_CLEAR * order**2)


def _movers_in_front(dense: _TrackDepths, cues: DepthCues) -> float:
    """Return the mean over frames of +1 where the ground below a mover is nearer than what is beside its upper half, else -1."""
    assert cues.mask is not None
    signs = []
    for frame in cues.frames:
        rows, columns = np.nonzero(cues.mask[frame])
        known = np.isfinite(dense.inverse[frame])
        if not len(rows) or not known.any():
            continue
        top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
        half = max((right - left) / 2, 2 * RIM_PX)
        x, y = cues.tracks.uv[frame, known].T
        near_x = (x > left - half) & (x < right + half)
        below = near_x & (y > bottom - 0.1 * (bottom - top)) & (y < bottom + half)
        beside = near_x & (y < (top + bottom) / 2) & (y > top - half)
        if below.sum() >= 3 and beside.sum() >= 3:
            inverse = dense.inverse[frame, known]
            signs.append(np.sign(np.median(inverse[below]) - np.median(inverse[beside])))
    return float(np.mean(signs)) if signs else np.nan


def _tracks_end_behind(first: _TrackDepths, second: _TrackDepths, cues: DepthCues) -> list[Evidence]:
    """Return the tracks that end inside the picture while a neighbour approaches them: the neighbour is nearer."""
    pairs = _endings(cues)
    if len(pairs) < MIN_SAMPLES:
        return []
    frame, ending, neighbour = pairs.T
    scores, words = [], []
    for dense in (first, second):
        difference = dense.inverse[frame, neighbour] - dense.inverse[frame, ending]
        votes = np.sign(difference[np.isfinite(difference)])
        if len(votes) < MIN_SAMPLES:
            return []
        scores.append(float(votes.sum() / np.sqrt(len(votes) * DEPENDENT_TRACKS)))
        words.append(f"{np.mean(votes > 0):.0%}")
    worth = OCCLUSION_WEIGHT * (scores[0] - scores[1]) / 2
    worth = float(np.clip(worth, -OCCLUSION_LIMIT, OCCLUSION_LIMIT))
    detail = f"{words[0]} against {words[1]} of {len(pairs)} tracks end at something nearer"
    return [Evidence("tracks end behind", worth, detail)]


def _endings(cues: DepthCues) -> np.ndarray:
    """Return (E, 3) int: sampled frame before a static track ends, the track, and the neighbour that comes nearest to it."""
    tracks, seen, unit = cues.tracks.uv, cues.tracks.seen, _unit(cues)
    found = []
    for before, after in zip(cues.frames[:-1], cues.frames[1:], strict=True):
        ends = np.flatnonzero(seen[before] & ~seen[after : after + 3].any(0) & _inside(cues, before))
        lives = np.flatnonzero(seen[before] & seen[after])
        past = max(before - 3, 0)
        if not len(ends) or not len(lives) or past == before:
            continue
        ends, lives = ends[seen[past, ends]], lives[seen[past, lives]]
        if not len(ends) or not len(lives):
            continue
        distance, which = cKDTree(tracks[before, lives]).query(
            tracks[before, ends], 4, distance_upper_bound=NEIGHBOUR_PX * unit
        )
        for nth in range(4):
            near = np.isfinite(distance[:, nth])
            end, other = ends[near], lives[which[near, nth]]
            now, then = (np.linalg.norm(tracks[f, end] - tracks[f, other], axis=1) for f in (before, past))
            close = then - now > APPROACH_PX * unit * (before - past)
            found.append(np.stack([np.full(close.sum(), before), end[close], other[close]], 1))
    return np.concatenate(found) if found else np.zeros((0, 3), int)


def _inside(cues: DepthCues, frame: int) -> np.ndarray:
    """Return (N,) bool: tracks away from the rim of the picture and from moving objects."""
    from scipy.ndimage import binary_dilation

    margin = RIM_PX * _unit(cues)
    uv = np.nan_to_num(cues.tracks.uv[frame], nan=-1.0)
    if cues.mask is None:
        low, high = np.nanmin(cues.tracks.uv, (0, 1)), np.nanmax(cues.tracks.uv, (0, 1))
        return ((uv > low + margin) & (uv < high - margin)).all(1)
    height, width = cues.mask.shape[1:]
    inside = ((uv > margin) & (uv < np.array([width, height]) - margin)).all(1)
    blocked = binary_dilation(cues.mask[frame], iterations=max(round(margin), 1))
    column, row = np.clip(uv, 0, np.array([width, height]) - 1).astype(int).T
    return inside & ~blocked[row, column]


def _unit(cues: DepthCues) -> float:
    """Return the pixels of this clip per pixel of a picture 480 wide."""
    if cues.mask is not None:
        return max(cues.mask.shape[1:]) / 480
    return float(np.nanmax(cues.tracks.uv, initial=1.0)) / 480


def _agrees_with_prior(dense: _TrackDepths, cues: DepthCues) -> float:
    """Return the mean rank correlation of inverse depth with a depth prior over the frames."""
    assert cues.depth is not None
    found = []
    height, width = cues.depth.shape[1:]
    for frame in cues.frames:
        known = np.isfinite(dense.inverse[frame]) & np.isfinite(cues.tracks.uv[frame, :, 0])  # lost ones have no place
        column, row = np.clip(cues.tracks.uv[frame, known], 0, np.array([width, height]) - 1).astype(int).T
        prior = cues.depth[frame, row, column]
        good = prior > 0
        if good.sum() >= MIN_SAMPLES:
            found.append(rank_correlation(dense.inverse[frame, known][good], 1 / prior[good]))
    return float(np.mean(found)) if found else np.nan


def guess_inverse_distance(directions: np.ndarray, rotations: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """Return initial inverse distances `(P,)` without known depth: nearer below, for unit `directions (P, 3)`; 1 at the horizon.

    `rotations (F, 3, 3)` world to camera: their mean defines which way is down.
    """
    down = np.asarray(rotations)[:, 1].mean(0)
    down /= max(float(np.linalg.norm(down)), 1e-9)
    return np.clip(1 + directions @ down, 0.3, 3.0)
