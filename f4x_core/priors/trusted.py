"""Cameras of frames that the joint adjustment misses, found from points that the frames which it meets have seen.

Near things that somebody holds and a body that breathes fill most of a picture and rest for a while. Their tracks count as standing
then, outnumber those of the ground, and draw the cameras of these frames with them. Frames before and after, in which they move,
know better: the points of the ground seen there are seen here, too, and those of the thing are not among them. So cameras grow from
the frames that meet their tracks, one neighbour after the other, as in incremental structure from motion (Schoenberger and Frahm,
"Structure-from-Motion Revisited", 2016), and tracks that miss their point in the end do not stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy import ndimage

from .bundle import Bundle, BundleConfig, Observations, adjust, resect, triangulate
from .points import SLIP_PX, TRACK_OUTLIER_PX
from .sfm import Solution, TrackSightings, beside

MISSED_PX = 1.5
"""Median error of a frame's sightings from which cameras do not meet that frame: the worst of the twelve real clips have 1.4."""
MET_PX = 1.0
"""Median error up to which a frame's camera is trusted from the start."""
MIN_MET = 0.5
"""Fraction of a frame's sightings of trusted points that its camera must meet within `MISSED_PX`."""
MIN_TRUSTED, MIN_RUN = 8, 2
"""Fewest frames that cameras can grow from, and of them in a row: over fewer whatever moves evenly is explained by some point.
Short runs hold a long chain: a pillow's cameras grow from 61 of 129 frames to 119, from its runs of eight and more only to 88."""
MIN_SIGHTINGS, MIN_SEEN = 12, 3
"""Fewest trusted points that a camera is found from, and sightings of one of them in trusted frames."""
FIRST_PX = 8.0
"""Scale of the robust error with which a camera is looked for from its neighbour's place, before the usual one."""
FITTING_ROUNDS = 8
"""Rounds in which the points come to know the frames that miss them."""
GROWTH = 1.25
"""Trusted frames over those at the last adjustment, at which all are adjusted again by static points."""
OUTLIER_PX = 4.0
"""Error from which a single sighting of a point that stands is left out: there its track slips."""
WORST_PX = 10.0
"""Errors count up to this much: the few sightings of a frame that is lost do not decide about a point."""


@dataclass(frozen=True)
class Trusted:
    """Cameras and the frames that they meet."""

    solution: Solution
    """All frames; `registered`: those whose camera meets what it sees."""
    grown: bool
    """True where cameras had to grow from the frames that were met."""


def frame_errors(bundle: Bundle, seen: Observations, count: int, rounds: int = 0) -> np.ndarray:
    """Return the median reprojection error `(F,)` in pixels of `count` points triangulated anew; NaN where a frame sees none.

    In so many further `rounds` sightings that miss their point count less: frames whose cameras are wrong do not move points.
    """
    weighed = seen
    for left in range(rounds, -1, -1):
        points, _ = triangulate(bundle, weighed, count)
        error = np.nan_to_num(replace(bundle, points=points).errors(seen), nan=np.inf, posinf=np.inf)
        if left:
            weighed = replace(seen, weight=seen.weight / (1 + np.minimum(error, WORST_PX) ** 2 / SLIP_PX**2))
    frames = (error[seen.frame == frame] for frame in range(len(bundle.center)))
    return np.array([np.median(one) if len(one) else np.nan for one in frames])


def grow_trusted(solution: Solution, pieces: TrackSightings, whole: TrackSightings, lens: BundleConfig) -> Trusted:
    """Return the solution, its cameras grown from the frames that it meets where it misses some.

    pieces, whole: every sighting of the tracks that may stand: cut into pieces where tracks are long, by
    which cameras are asked whether they meet a frame, and as they are, by which frames are trusted. lens: how the focal length is
    adjusted.
    """
    met = _within(solution.bundle, pieces, MISSED_PX)
    if met.all():
        return Trusted(replace(solution, registered=met), False)
    seen, count = whole.seen, len(whole.tracks)
    trusted = _in_runs(_within(solution.bundle, whole, MET_PX))
    if not trusted.any():  # wrong cameras of some frames move all points
        trusted = _in_runs(_within(solution.bundle, whole, MET_PX, FITTING_ROUNDS))
    if not trusted.any():
        return Trusted(replace(solution, registered=met), False)
    bundle, kept, before = solution.bundle, seen, 0
    while trusted.sum() > before:
        before = trusted.sum()
        bundle = _grow(bundle, seen, trusted)
        points, kept = _what_stands(bundle, seen, count, trusted)
        used, kept = kept.of_points()
        bundle = adjust(replace(bundle, points=points[used]), kept, replace(lens, iterations=10))
    if trusted.sum() <= met.sum():
        return Trusted(replace(solution, registered=met), False)
    return Trusted(Solution(_follow(solution.bundle, bundle, seen, trusted), kept, trusted), True)


def _grow(bundle: Bundle, seen: Observations, trusted: np.ndarray) -> Bundle:
    """Return the cameras with those beside `trusted (F,)` frames found anew, outwards; what is found is marked in `trusted`.

    It ends when there are enough more to be adjusted with the others: errors of points and cameras add up on the way.
    """
    tried: set[tuple[int, int]] = set()
    enough = GROWTH * trusted.sum()
    while trusted.sum() < enough:
        known = np.flatnonzero(trusted)
        pairs = [
            (int(frame + side), int(frame)) for side in (1, -1) for frame in known if 0 <= frame + side < len(trusted)
        ]
        ring = [pair for pair in pairs if not trusted[pair[0]] and pair not in tried]
        if not ring:
            break
        for frame, near in ring:
            if not trusted[frame]:
                bundle, met = _register(bundle, seen, trusted, frame, near)
                trusted[frame] = met >= MIN_MET
        tried.update(ring)
    return bundle


def _within(bundle: Bundle, sighted: TrackSightings, limit: float, rounds: int = 0) -> np.ndarray:
    """Return (F,) bool: frames that see enough of the tracks and miss them by at most `limit` pixels (`frame_errors`)."""
    enough = np.bincount(sighted.seen.frame, minlength=len(bundle.center)) >= MIN_SIGHTINGS
    return enough & (frame_errors(bundle, sighted.seen, len(sighted.tracks), rounds) <= limit)  # NaN compares false


def _in_runs(chosen: np.ndarray) -> np.ndarray:
    """Return (F,) bool: chosen frames of which at least `MIN_RUN` follow each other; none if they are fewer than `MIN_TRUSTED`."""
    runs, _ = ndimage.label(chosen)
    kept = chosen & (np.bincount(runs) >= MIN_RUN)[runs]
    return kept if kept.sum() >= MIN_TRUSTED else np.zeros_like(kept)


def _register(bundle: Bundle, seen: Observations, trusted: np.ndarray, frame: int, near: int) -> tuple[Bundle, float]:
    """Return the cameras with that of `frame` found from points of the `trusted (F,)` ones, from its own place or that of the frame
    `near` it, and the fraction of these points that it meets; 0 where there are too few."""
    here = seen.keep(seen.frame == frame)
    known = seen.keep(trusted[seen.frame] & np.isin(seen.point, here.point))
    used, known = known.of_points()
    points, _ = triangulate(bundle, known, len(used))
    bundle = replace(bundle, points=points)
    here = here.keep(np.isin(here.point, used[_steady(bundle, known)]))
    here = replace(here, point=np.searchsorted(used, here.point))
    if len(here.frame) < MIN_SIGHTINGS:
        return bundle, 0.0
    found = []
    for start, scales in product((frame, near), ((FIRST_PX, TRACK_OUTLIER_PX), (TRACK_OUTLIER_PX,))):
        moved = bundle.with_frames(np.array([frame]), bundle.of_frames(np.array([start])))
        for robust_px in scales:
            moved = resect(moved, here, np.array([frame]), iterations=25, robust_px=robust_px)
        found.append((float((moved.errors(here) <= MISSED_PX).mean()), moved))
    met, best = max(found, key=lambda one: one[0])
    return best, met


def _steady(bundle: Bundle, seen: Observations) -> np.ndarray:
    """Return (P,) bool: which points of the bundle are met by most of what is `seen` of them."""
    error = np.nan_to_num(bundle.errors(seen), nan=WORST_PX, posinf=WORST_PX)
    count = np.bincount(seen.point, minlength=len(bundle.points))
    square = np.bincount(seen.point, np.minimum(error, WORST_PX) ** 2, len(bundle.points))
    return (count >= MIN_SEEN) & (square <= TRACK_OUTLIER_PX**2 * count)


def _what_stands(
    bundle: Bundle, seen: Observations, count: int, trusted: np.ndarray
) -> tuple[np.ndarray, Observations]:
    """Return `count` points by the `trusted (F,)` frames and what these have `seen` of those that stand."""
    known = seen.keep(trusted[seen.frame])
    bundle = replace(bundle, points=triangulate(bundle, known, count)[0])
    close = np.nan_to_num(bundle.errors(known), nan=np.inf) < OUTLIER_PX
    return bundle.points, known.keep(_steady(bundle, known)[known.point] & close)


def _follow(before: Bundle, bundle: Bundle, seen: Observations, trusted: np.ndarray) -> Bundle:
    """Return the cameras with all that are not `trusted (F,)` beside those that are: found from the trusted ones' points as far as
    these are seen, else moved on as `before`. The points stay."""
    placed, points = trusted.copy(), bundle.points
    while not placed.all():
        frame = int(np.flatnonzero(beside(placed) & ~placed)[0])
        near = frame + 1 if frame + 1 < len(placed) and placed[frame + 1] else frame - 1
        turn = before.rotation[frame] @ before.rotation[near].T
        step = before.rotation[near] @ (before.center[frame] - before.center[near])
        carried = replace(
            bundle.of_frames(np.array([near])),
            rotation=turn @ bundle.rotation[[near]],
            center=bundle.center[[near]] + step @ bundle.rotation[near],
        )
        bundle, _ = _register(bundle.with_frames(np.array([frame]), carried), seen, trusted, frame, near)
        placed[frame] = True
    return replace(bundle, points=points)
