"""First cameras of a clip: by aligned depth, by freeing a camera that only turns, or by structure from motion.

Each is compared with its mirror image in depth (`mirror`), and with a camera that only turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..parallel import thread_count
from .bundle import Bundle, adjust, triangulate
from .camera_problem import MIN_TRACKS, Attempt, CameraProblem, rounded
from .mirror import choose_orientation, guess_inverse_distance
from .moving_people import dilate_masks
from .pan import adjusted_pan, moving_explains_more, panned, search_lens, zoom_of
from .sfm import (
    SAMPLED_POINTS,
    ColmapSettings,
    Solution,
    refocused,
    sampled,
    sightings,
    solve_rotations,
    solve_with_colmap,
    solve_with_depth,
    solve_with_tracks,
    subset,
)
from .zoom import mean_cost

TRANSLATION_GAIN = 0.1
"""A camera moves when that lowers the squared error of one that only turns by this fraction, beyond what its unknowns win
on noise."""
TRANSLATION_PX = 0.5
"""... and when its path shifts near against far by this many pixels (rms): less is what flow errs by. A rendered turn on the spot
gives 0.4 px, the least of the real clips that step as well 0.7 px (blackswan)."""
TURNED_PX = 1.0
"""Nine in ten tracks of a camera that only turned are met within this; rendered turns on the spot give 0.4 px."""
LARGE_TRANSLATION_PX = 8.0
"""Translation in pixels from which it is `large`: enough to measure depth."""
MIN_REGISTERED = 0.9
MAX_ERROR_PX = 1.5
"""A solution is accepted with at least this fraction of the frames and at most this reprojection error."""
MIN_LINKED = 0.5
"""Neighbouring frames that share a smaller fraction of their static tracks are not linked by them: then pictures are matched.
Frames of the real clips share .8 and more, those whose flow is lost .08."""


@dataclass(frozen=True)
class Translation:
    """By how much moving explains the tracks better than turning alone."""

    size_px: float
    """Shift of near against far by the path, pixels (rms)."""
    gain: float
    """Fraction of the squared error that moving saves, beyond what its unknowns win on noise."""

    @property
    def real(self) -> bool:
        """Return True if the camera moves."""
        return self.gain >= TRANSLATION_GAIN and self.size_px >= TRANSLATION_PX

    def summary(self) -> dict[str, Any]:
        """Return the row `translation` of the statistics."""
        verdict = "large" if self.size_px >= LARGE_TRANSLATION_PX else "small"
        return {
            "size_px": rounded(self.size_px),
            "gain": rounded(self.gain),
            "verdict": verdict if self.real else "none",
        }


def first_solution(job: CameraProblem) -> Attempt:
    """Return a solution of some frames, its depth not mirrored; of kind `pan` or `moving`."""
    turning = solve_rotations(job.tracks, job.focal, job.principal, 4 * SAMPLED_POINTS)
    sample, search = search_lens(job, turning)
    focal, errors = sample.bundle.focal, sample.bundle.errors(sample.observations)
    parallax = float(np.percentile(errors, 90)) if len(errors) else 0.0
    start = Attempt(turning, "pan", {"parallax_px": rounded(parallax), "pan_focal_search": search})
    zoom = zoom_of(job, turning)
    if job.settings.kind == "pan":
        return panned(job, start, focal, zoom)

    moved = _moving(job, refocused(turning, job.focal, translating=False))
    if moved is None:
        if parallax > TURNED_PX:
            start = start.noting(assumed="it could not be reconstructed from what stands still")
        start = start.warning(
            "The camera's motion could not be reconstructed (too little parallax or texture); only its turning is kept and"
            " the background becomes flat. Give cameras of another program if you have them."
        )
        return replace(start, solution=adjusted_pan(turning, focal))
    start = replace(start.noting(**moved.statistics), warnings=moved.warnings)
    if zoom is not None and moving_explains_more(zoom, moved.solution):
        zoom = None
    if job.settings.kind is None:
        if zoom is not None:
            return panned(job, start, focal, zoom)
        translation = translation_of(job, moved.solution)
        start = start.noting(translation=translation.summary())
        if not translation.real:
            return panned(job, start, focal)
    return replace(start, solution=moved.solution, kind="moving")


def translation_of(job: CameraProblem, moved: Solution) -> Translation:
    """Return by how much translating explains the tracks of `moved` better than turning alone."""
    sample, _ = subset(moved, len(moved.bundle.points), int(moved.registered.sum()))
    bundle, seen = sample.bundle, sample.observations
    still = refocused(Solution(bundle, seen, sample.registered), bundle.focal, translating=False).bundle
    still = replace(still, center=np.zeros_like(still.center))
    fixed = replace(job.lens, refine_centers=False, iterations=20)
    still = adjust(still, seen, fixed)
    unknowns = 3 * len(bundle.center) + len(bundle.points)
    gain = 1 - mean_cost(bundle, seen, unknowns) / max(mean_cost(still, seen), 1e-12)
    z = bundle.local(seen)[:, 2]
    inverse = 1 / np.maximum(z, 1e-9)
    spread = float(np.clip(inverse, *np.percentile(inverse, (2, 98))).std())
    reach = np.sqrt(((bundle.center - bundle.center.mean(0)) ** 2).sum(1).mean())
    size = float(bundle.focal * spread * reach)
    return Translation(size, float(gain))


def linked(visible: np.ndarray) -> bool:
    """Return True if all neighbouring frames share enough of the tracks `visible (F, N)` to tell the camera's turn between them."""
    shared = (visible[1:] & visible[:-1]).sum(1)
    fewer = np.minimum(visible[1:].sum(1), visible[:-1].sum(1))
    return bool((shared >= np.maximum(MIN_TRACKS, MIN_LINKED * fewer)).all())


def _moving(job: CameraProblem, turning: Solution) -> Attempt | None:
    """Return a solution that translates, its depth not mirrored, by the first solver that succeeds; None where none does."""
    settings, priors = job.settings, job.priors
    job.progress("cameras", 1, 4, "first cameras")
    if job.first is not None:
        given = _resolve_mirror(job, _with_sightings(job, job.first)) or Attempt(job.first)
        return given.noting(solver=settings.provider)
    measured: dict[str, Any] = {}
    if priors.depth is not None and settings.solver in ("auto", "depth"):
        known = job.focal if settings.focal else None
        solution, measured["focal_search"] = solve_with_depth(job.tracks, priors.depth, known, priors.width)
        if solution.error < 4 * MAX_ERROR_PX:  # the final adjustment no longer leans on the depth and comes below
            found = _resolve_mirror(job, solution)
            return None if found is None else found.noting(**measured, solver="depth")
    direct = None
    if settings.solver in ("auto", "direct"):
        direct = _resolve_mirror(job, turning)
        if direct is not None:
            direct = direct.noting(**measured, solver="direct")
            good = direct.solution.error < 2 * MAX_ERROR_PX and linked(job.tracks.seen)
            if good or settings.solver == "direct":
                return direct
    start = _solve_incrementally(job)
    if start is None:
        return direct
    found = _resolve_mirror(job, start.solution)
    return None if found is None else replace(found.noting(**measured, **start.statistics), warnings=start.warnings)


def _solve_incrementally(job: CameraProblem) -> Attempt | None:
    """Return the better of pycolmap on keyframes and the own incremental structure from motion; None if both fail."""
    settings = job.settings
    tried: list[Attempt] = []
    keyframes = evenly_spaced(len(job.tracks), settings.keyframes)
    if settings.solver in ("auto", "colmap"):
        found = _solve_keyframes(job, keyframes)
        if found is not None:
            tried.append(Attempt(found, statistics={"solver": "colmap"}))
            if found.registered.sum() >= MIN_REGISTERED * len(keyframes) and found.error < MAX_ERROR_PX:
                return tried[0]
    if settings.solver in ("auto", "tracks"):
        found = solve_with_tracks(job.tracks, job.focal, job.principal, settings.seed)
        if found is not None:
            tried.append(Attempt(found, statistics={"solver": "tracks"}))

    def accepted(one: Solution) -> bool:
        return one.error < 2 * MAX_ERROR_PX

    def merit(one: Attempt) -> tuple[bool, float]:
        return accepted(one.solution), _covered(one.solution.registered)

    best = max(tried, key=merit, default=None)
    if best is None or not accepted(best.solution) or _covered(best.solution.registered) < 0.5:
        return None
    wanted = len(keyframes) if best.statistics["solver"] == "colmap" else len(job.tracks)
    if best.solution.registered.sum() < MIN_REGISTERED * wanted:
        return best.warning(
            "Some cameras could not be solved from the pictures and are continued from their neighbours."
        )
    return best


def _solve_keyframes(job: CameraProblem, keyframes: np.ndarray) -> Solution | None:
    """Return the solution of pycolmap on the keyframes as one of all frames."""
    settings, priors = job.settings, job.priors
    pictures = [job.clip.frames[frame] for frame in np.asarray(job.clip.supervised)[keyframes]]
    # Features on the rim of a mover belong to it: its mask grows by 1 % of the width.
    margin = max(priors.width // 100, 1)
    masks = None if priors.mask is None else dilate_masks(priors.mask[keyframes], margin)
    known = settings.focal is not None
    found = solve_with_colmap(
        pictures, masks, ColmapSettings(job.focal, known, settings.features, thread_count(), settings.seed)
    )
    return None if found is None else _spread(found, keyframes, len(job.tracks))


def _resolve_mirror(job: CameraProblem, start: Solution) -> Attempt | None:
    """Return the solution, or its mirror image, adjusted on a sample of frames; None where no sample can be taken."""
    sample, frames = sampled(start)
    if not len(sample.observations.frame):
        return None
    starts = [sample.bundle]
    if not start.bundle.center.any():  # it only turns yet: a world that is nearer below, and one that is nearer above
        directions = sample.bundle.points / np.linalg.norm(sample.bundle.points, axis=1, keepdims=True)
        below = guess_inverse_distance(directions, sample.bundle.rotation)
        starts = [replace(sample.bundle, points=directions / inverse[:, None]) for inverse in (below, 1 / below)]
    decision = choose_orientation(starts, sample.observations, job.lens, job.cues(frames))
    registered = np.zeros(len(job.tracks), bool)
    registered[frames] = np.bincount(sample.observations.frame, minlength=len(frames)) >= MIN_TRACKS
    observations = replace(sample.observations, frame=frames[sample.observations.frame])

    def of_all_frames(found: Bundle, rival: Solution | None = None) -> Solution:
        bundle = replace(start.bundle.with_frames(frames, found), points=found.points)
        return Solution(bundle, observations, registered, rival)

    doubted = None if decision.verdict == "sure" else decision.rejected
    rival = None if doubted is None else of_all_frames(doubted)
    return Attempt(of_all_frames(decision.bundle, rival), statistics={"mirror": decision.summary()})


def _with_sightings(job: CameraProblem, solution: Solution) -> Solution:
    """Return a solution whose cameras have points: without their own those of the static tracks, triangulated."""
    if len(solution.observations.frame):
        return solution
    sighted = sightings(job.tracks, 4 * SAMPLED_POINTS)
    points, _ = triangulate(solution.bundle, sighted.seen, len(sighted.tracks))
    return replace(solution, bundle=replace(solution.bundle, points=points), observations=sighted.seen)


def _covered(registered: np.ndarray) -> float:
    """Return the fraction of the clip between the first and the last registered frame."""
    known = np.flatnonzero(registered)
    return (known[-1] - known[0] + 1) / len(registered) if len(known) else 0.0


def _spread(solution: Solution, keyframes: np.ndarray, frames: int) -> Solution:
    """Return a solution of keyframes as one of all frames."""
    rotation, center = np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 3))
    registered = np.zeros(frames, bool)
    rotation[keyframes], center[keyframes] = solution.bundle.rotation, solution.bundle.center
    registered[keyframes] = solution.registered
    observations = replace(solution.observations, frame=keyframes[solution.observations.frame])
    return Solution(replace(solution.bundle, rotation=rotation, center=center), observations, registered)
