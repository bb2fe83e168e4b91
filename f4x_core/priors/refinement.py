"""Cameras of all frames from those of some: resected, adjusted together, grown where they miss, and made sharper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..parallel import in_threads
from ..progress import silent
from .bundle import MIN_SEEN, Bundle, BundleConfig, Observations, adjust, resect, total_cost, triangulate
from .camera_problem import Attempt, CameraProblem, rounded
from .config import USUAL_FRAMES
from .contact import MOVING_MARGIN
from .flow import long_flows
from .mirror import decide
from .moving_people import dilate_masks
from .point_tracks import PointTracks
from .rematch import match_anew
from .sfm import Solution, TrackSightings, best_focal, choose_covering_points, refocused, sightings, with_points_ahead
from .short_tracks import Neighbourhood, sharpened
from .trusted import frame_errors, grow_trusted

ADJUSTED_TRACKS = 2000
"""Largest number of tracks in the final adjustment; more cost time and do not improve the cameras."""
TRACK_FRAMES = 24
"""Frames of the pieces that tracks are cut into for the final adjustment of a clip of more than `USUAL_FRAMES`. Errors of
chained flow add up, .35 px over 24 frames and 1.9 over 200, and the tracks that live longest are those that stick to the picture.
By whole tracks a rendered walk of 200 frames whose noise stays in its place turns by .85 degrees (rms) too much or too little, by
pieces of 60, 36 and 24 frames by .54, .37 and .25; a walk with noise as a camera's by .06 and .05 (36). A real clip of 80 frames,
played to and fro for 300, closes alike. Clips that are no longer were measured with whole tracks."""
TRACK_WEIGHT = 0.2
"""Weight of a track's sighting against a matched feature's: chained flow drifts, and its errors are shared over time."""
SETTLED_PX, MIN_SETTLING, MORE_ROUNDS = 1.0, 0.05, 3
"""Median error of the worst frame up to which cameras are not adjusted again, the fraction of it that another round must save,
and the largest number of these. On parkour a round takes the worst frame from 2.4 to 1.4 px (judged on scooter-black: 2.0 to 1.0);
frames of ten other clips are within .8 px, and breakdance would lose by another round."""
REMATCHED_ROUNDS = 2
"""Adjustments on sightings that are matched anew: by the first one others are outliers."""
MIN_REMATCHED = 0.2
"""Fraction of the sightings that have to be matched anew: .36 and more are on rendered clips."""


def refined(job: CameraProblem, start: Attempt) -> Attempt:
    """Return a moving camera of some frames as one of all, adjusted together and made as sharp as the pictures allow."""
    job.progress("cameras", 3, 4, "refine the path")
    found = _completed(job, start)
    for step in (_trusted, _rematched, _refocused, _sharpened):
        found = step(job, found)
    return found


def complete(solution: Solution, tracks: PointTracks, times: np.ndarray, lens: BundleConfig | None = None) -> Solution:
    """Return all frames registered and adjusted together on the solution's own observations and the static tracks.

    Missing frames start from the interpolated path, the ones next to a known camera first, and are resected. `lens`: whether
    the focal length is adjusted with them; held when left out.
    """
    lens = lens or BundleConfig(refine_focal=False)
    longest = TRACK_FRAMES if len(tracks) > USUAL_FRAMES else None
    some = sightings(tracks, ADJUSTED_TRACKS, longest)
    bundle, own = solution.bundle, _limited_observations(solution, ADJUSTED_TRACKS)
    offset = len(bundle.points)
    registered = solution.registered.copy()
    observations = own.followed_by(replace(some.seen, weight=TRACK_WEIGHT * some.seen.weight), offset)
    bundle = replace(bundle, points=np.vstack([bundle.points, np.full((len(some.tracks), 3), np.nan)]))
    while not registered.all():
        bundle = _triangulated(bundle, observations, registered, offset)
        missing, known = np.flatnonzero(~registered), np.flatnonzero(registered)
        distance = abs(missing[:, None] - known).min(1)
        ring = missing[distance == distance.min()]
        bundle = _interpolated(bundle, registered, ring, times)
        bundle = resect(bundle, observations, ring)
        registered[ring] = True
    bundle = _triangulated(bundle, observations, registered, offset)
    found = Solution(bundle, observations, registered).without_outliers()
    found = replace(found, bundle=adjust(found.bundle, found.observations, replace(lens, iterations=10)))
    every = sightings(tracks, tracks.uv.shape[1], longest)
    return _settled(found.without_outliers(), every, some.seen, lens)


def _settled(solution: Solution, every: TrackSightings, some: Observations, lens: BundleConfig) -> Solution:
    """Return the solution, adjusted anew on `some` of `every` sighting of static tracks while a frame is left that misses its own.

    In a long sweep what a far frame misses is the first to be dropped as an outlier, and nothing draws that frame back.
    """
    worst = _worst_frame(solution.bundle, every.seen, len(every.tracks))
    for _ in range(MORE_ROUNDS):
        if worst <= SETTLED_PX:
            break
        found = replace(solution, observations=some).adjusted_anew(replace(lens, iterations=10))
        left = _worst_frame(found.bundle, every.seen, len(every.tracks))
        if left > (1 - MIN_SETTLING) * worst:
            break
        solution, worst = found.without_outliers(), left
    return solution


def _worst_frame(bundle: Bundle, seen: Observations, count: int) -> float:
    """Return the pixels by which the worst frame misses its sightings (median) of `count` points, triangulated anew."""
    return float(np.nanmax(frame_errors(bundle, seen, count), initial=0.0))


def _completed(job: CameraProblem, start: Attempt) -> Attempt:
    """Return all frames of the solution, or of its rival where that explains the static tracks of all frames better.

    A sample of frames hardly tells the two apart where there is little translation. On scooter-black the errors of a sample
    differ by 2 % or 9 %, those of all frames by 40 to 60 %.
    """

    def completed(one: Solution) -> Solution:
        return complete(one, job.tracks, job.times, job.lens)

    if start.solution.rival is None:
        return replace(start, solution=completed(start.solution))
    found = in_threads(completed, (start.solution, start.solution.rival))
    sighted = sightings(job.tracks, ADJUSTED_TRACKS)
    seen = sighted.seen

    def on_the_same_tracks(one: Solution) -> Bundle:
        points, _ = triangulate(one.bundle, seen, len(sighted.tracks))
        bundle = with_points_ahead(replace(one.bundle, points=points), seen)
        return adjust(bundle, seen, replace(job.lens, iterations=10))

    whole = in_threads(on_the_same_tracks, found)
    first, second = sorted(whole, key=lambda bundle: total_cost(bundle, seen, job.lens))
    decision = decide(first, second, seen, job.lens, job.cues(np.arange(len(job.tracks))))
    noted = start.noting(mirror=decision.summary() | {"sample": start.statistics["mirror"]})
    return replace(noted, solution=found[0] if decision.bundle is whole[0] else found[1])


def _trusted(job: CameraProblem, start: Attempt) -> Attempt:
    """Return the attempt, its cameras grown from the frames that it meets where it misses some.

    It notes `registered`, the number of frames that their cameras meet, and `grown`.
    """
    longest = TRACK_FRAMES if len(job.tracks) > USUAL_FRAMES else None
    pieces, whole = (sightings(job.tracks, job.tracks.uv.shape[1], most) for most in (longest, None))
    found = grow_trusted(start.solution, pieces, whole, job.lens)
    noted = start.noting(registered=int(found.solution.registered.sum()))
    return replace(noted.noting(grown=True) if found.grown else noted, solution=found.solution)


def _rematched(job: CameraProblem, start: Attempt) -> Attempt:
    """Return the attempt adjusted on sightings that are matched anew (`rematch`), unless few are or a frame that was met is missed
    by them; it notes `rematched`: the fraction of sightings, and pixels by which the worst frame is missed before and after."""
    solution = start.solution
    seen = match_anew(job.pictures, solution.observations)
    matched = float((seen.weight == 1).mean()) if len(seen.weight) else 0.0
    if matched < MIN_REMATCHED:
        return start
    lens = replace(job.sharp_lens, iterations=10)
    found = replace(solution, observations=seen).adjusted_anew(lens, REMATCHED_ROUNDS)
    before, after = (_worst_frame(one.bundle, seen, len(solution.bundle.points)) for one in (solution, found))
    noted = start.noting(rematched={"part": rounded(matched), "before_px": rounded(before), "after_px": rounded(after)})
    return replace(noted, solution=found) if after <= max(before, SETTLED_PX) else noted


def _refocused(job: CameraProblem, start: Attempt) -> Attempt:
    """Return the attempt adjusted anew from the focal length that its sightings prefer (`best_focal`), unless that is given or the
    background is in doubt; it notes `focal_search`."""
    solution = start.solution
    if not job.lens.refine_focal or "focal_search" in start.statistics or start.in_doubt:
        return start
    job.progress("cameras", 3, 4, "focal length")
    focal, search = best_focal(solution, job.sharp_lens)
    noted = start.noting(focal_search=search)
    if focal == solution.bundle.focal:
        return noted
    lens = replace(job.sharp_lens, iterations=15)
    return replace(noted, solution=refocused(solution, focal).adjusted_anew(lens, REMATCHED_ROUNDS))


def _sharpened(job: CameraProblem, start: Attempt) -> Attempt:
    """Return the attempt adjusted on short tracks as well, if there is flow and the background is not in doubt, of which short
    tracks cannot tell."""
    priors = job.priors
    if start.in_doubt or priors.flow_forward is None or len(job.tracks) < MIN_SEEN:
        return start
    blocked = np.zeros(job.pictures.shape, bool)
    if priors.mask is not None and not job.tracks.static.all():
        blocked = dilate_masks(priors.mask, MOVING_MARGIN)
    if job.clip.hidden is not None:
        blocked = blocked | job.clip.hidden[priors.frames]
    around = Neighbourhood(job.pictures, long_flows(job.clip, priors, job.config, silent), blocked)
    return replace(start, solution=sharpened(start.solution, around.sightings(), job.sharp_lens))


def _limited_observations(solution: Solution, max_points: int) -> Observations:
    """Return the solution's observations of at most `max_points` finite points that hold all its frames."""
    seen = solution.observations
    visible = seen.visible(len(solution.registered), len(solution.bundle.points))
    visible &= np.isfinite(solution.bundle.points).all(1) & (visible.sum(0) > 2)
    chosen = np.zeros(visible.shape[1], bool)
    chosen[choose_covering_points(visible, max_points)] = True
    return seen.keep(chosen[seen.point])


def _triangulated(bundle: Bundle, observations: Observations, registered: np.ndarray, offset: int) -> Bundle:
    """Return the points from number `offset` on triangulated anew from the registered cameras."""
    seen = observations.keep(registered[observations.frame])
    points, _ = triangulate(bundle, seen, len(bundle.points))
    points[:offset] = bundle.points[:offset]
    return replace(bundle, points=points)


def _interpolated(bundle: Bundle, registered: np.ndarray, frames: np.ndarray, times: np.ndarray) -> Bundle:
    """Return the cameras `frames` put on the smooth path through the registered ones."""
    size = (2 * bundle.principal).astype(int)
    path = bundle.path(times, *size)
    known = replace(
        path,
        intrinsics=path.intrinsics[registered],
        world_to_camera=path.world_to_camera[registered],
        times=times[registered],
    )
    cameras = [known.at(times[frame]) for frame in frames]
    found = replace(
        bundle.of_frames(frames),
        rotation=np.stack([camera.world_to_camera[:3, :3] for camera in cameras]),
        center=np.stack([camera.center for camera in cameras]),
    )
    return bundle.with_frames(frames, found)
