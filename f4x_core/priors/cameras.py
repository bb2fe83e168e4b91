"""Camera path of the supervised frames from pictures and tracks (provider `classical`).

1. The camera stands, as points looked for again in far frames tell (`standing`), or nothing static moves -> `static`: nothing
   is solved, and a jitter of pixels becomes turns. 2. Otherwise a first solution: aligned depth where a depth prior exists;
   else a camera that only turns, all its frames at once set free to move (as structure from small motion does: Yu and
   Gallup, "3D Reconstruction from Accidental Motion", 2014; Ha et al., "High-Quality Depth from Uncalibrated Small Motion
   Clip", 2016); else pycolmap on keyframes, or own incremental structure from motion. 3. It is compared with its mirror image
   in depth (`mirror`). 4. Where moving explains the tracks no better than turning, or than turning and zooming (`zoom`), the
   clip is a `pan`, else `moving`, however little. 5. All frames are resected and adjusted together on static tracks, the
   focal length with them; frames that are missed are found from the points of the others (`trusted`), and sightings are
   matched anew with one picture of their track (`rematch`). 6. Where moving objects fill the picture's border, cameras of all
   tracks are tried, too (`rigid`).
7. What moving cameras explain as static is taken out of the moving mask (`second_look`).

Held-out frames are never looked at; how much real shake their interpolated cameras will miss is measured
(`statistics["cameras"]["interpolation_px"]`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry import quaternion
from ..geometry.arrays import evenly_spaced
from ..geometry.camera import CameraPath
from ..parallel import in_threads, thread_count
from ..progress import Progress, silent
from .bundle import (
    MIN_SEEN,
    Bundle,
    BundleConfig,
    Observations,
    adjust,
    adjust_anew,
    resect,
    total_cost,
    triangulate,
    without_outliers,
)
from .config import USUAL_FRAMES, CamerasConfig, PriorsConfig
from .contact import MOVING_MARGIN
from .flow import grey, long_flows, sample, texture
from .folder import SEEN_DEPTH
from .lens import measure
from .mirror import DepthCues, choose_orientation, decide, guess_inverse_distance
from .motion import REFERENCE_WIDTH
from .moving_people import dilate_masks
from .rematch import match_anew
from .rigid import explained_fraction, track_error
from .second_look import join_resting, mask_in_doubt, release_static
from .sfm import (
    DEFAULT_FOCAL,
    FOCALS,
    ColmapSettings,
    Solution,
    best_focal,
    choose_covering_points,
    refocused,
    search_focal,
    sightings,
    solve_rotations,
    solve_with_colmap,
    solve_with_depth,
    solve_with_tracks,
    subset,
    with_points_ahead,
)
from .short_tracks import Neighbourhood, sharpened
from .standing import StillnessTest
from .trusted import frame_errors, grow_trusted
from .zoom import MIN_COST_LEFT_BY_MOVING, Zoom, find_zoom, mean_cost, zoomed

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

STATIC_PX = 0.5
"""A clip is static when no pair of frames shifts its static tracks by this much (median over the tracks)."""
MAYBE_STANDING_PX = 6.0
"""... and may stand when they shift by less than this (480 wide), which is more than chained tracks of a tripod drift in ten
seconds: then the pictures are compared (`standing`)."""
SAMPLED_POINTS, SAMPLED_FRAMES = 500, 24
"""Points and frames on which solutions are compared: 500 x 24 take two seconds, and find what 2,000 x 90 find."""
MIN_SAMPLED_POINTS, MIN_POINTS_PER_FRAME, MAX_SAMPLED_FRAMES = 200, 150, 96
"""More frames are sampled, up to `MAX_SAMPLED_FRAMES`, where fewer than `MIN_SAMPLED_POINTS` points are seen in three of them or
one of them sees fewer than `MIN_POINTS_PER_FRAME`, as in a sweep (86 to 142 on three real clips, 258 and more on the others)."""
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
STATIC_MOTION = 0.5
"""Tracks with a motion score below this are static: cameras are solved from them."""

MIN_REGISTERED = 0.9
MAX_ERROR_PX = 1.5
"""A solution is accepted with at least this fraction of the frames and at most this reprojection error."""
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
MIN_LINKED = 0.5
"""Neighbouring frames that share a smaller fraction of their static tracks are not linked by them: then pictures are matched.
Frames of the real clips share .8 and more, those whose flow is lost .08."""
MIN_TEXTURED = 0.1
"""With a smaller fraction of the static tracks on enough texture for flow (`flow.texture` of one half, median over a track's
sightings) the tracks drift with moving objects beside them: 3 % in a sky behind a mover, 56 % and more in the real clips."""
SETTLED_PX, MIN_SETTLING, MORE_ROUNDS = 1.0, 0.05, 3
"""Median error of the worst frame up to which cameras are not adjusted again, the fraction of it that another round must save,
and the largest number of these. On parkour a round takes the worst frame from 2.4 to 1.4 px (judged on scooter-black: 2.0 to 1.0);
frames of ten other clips are within .8 px, and breakdance would lose by another round."""
REMATCHED_ROUNDS, REMATCHED_PX = 2, 0.5
"""Adjustments on sightings that are matched anew (by the first one others are outliers), and the scale in pixels of their robust
error. Chosen on nine rendered clips, mean error of the camera's place .58 % of the path's reach without, .29 with a scale of 1 and
.25 with .5."""
SHARP_FOCAL_PRIOR = 0.02
"""Weight of the usual focal length against these (`bundle.FOCAL_PRIOR`), chosen on rendered horizon, knight, orbit, fox and walk
through lenses of .89, 1.39 and 2 picture widths, and on blackswan, whose water draws the lens from 2.1 to 2.3 with half of it, so
that its relief doubles. Judged through lenses of .61 and 1.39, static depth errs by 2.6 and 1.6 %, with twice the weight by 3.2 and
2.9."""
MIN_REMATCHED = 0.2
"""Fraction of the sightings that have to be matched anew: .36 and more are on rendered clips."""
MIN_EXPLAINED_MORE, ENOUGH_EXPLAINED = 0.05, 0.85
"""Fraction of the picture that cameras of all tracks must explain beyond what those of the static ones do, to be preferred;
they are not looked for where so much is explained already."""
MAX_LESS_SHARP = 1.3
"""... and the largest number of times as many pixels by which they may miss the static tracks themselves (`track_error`).
Cameras that share their errors with a mover that fills half of the picture miss them by 1.4 to 4.6 times as many (three rendered
clips through a lens of 2 widths, three of 24 rooms of cards), those that are rightly preferred by no more than the cameras of the
static tracks."""
MIN_STANDING = 0.6
"""Fraction of the picture that cameras of all tracks must explain at least: by them hardly anything moves. Where cards that all
move fill it they explain .53."""
MIN_TRACKS = 12
"""Static tracks that the motion of the camera needs at least."""


def provide(
    clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress, first: Solution | None = None
) -> None:
    """Fill `cameras`, `camera_kind` and `statistics["cameras"]` (provider `classical`).

    `first`: what another provider found for all frames; a moving clip starts from it, and its focal length is kept.
    """
    settings = config.cameras
    progress("cameras", 0, 4, "what moves")
    tracks, visible, static = static_tracks(priors)
    focal = settings.focal * priors.width if settings.focal else DEFAULT_FOCAL * max(priors.width, priors.height)
    if first is not None:
        first = refocused(first, focal) if settings.focal else first
        focal = first.bundle.focal

    shift = static_shift(tracks, visible, static)
    statistics: dict[str, Any] = {"static_tracks": int(static.sum()), "static_shift_px": _json(shift)}
    job = _CameraProblem(clip, priors, config, tracks, visible, static, focal, first, statistics, [], progress)
    times = job.times
    standing = _standing_camera(job, shift)
    solution, kind = _solve_what_stands_still(job, shift) if standing is None else (standing, "static")
    if standing is None and first is None and settings.kind in (None, "moving") and mask_in_doubt(priors):
        solution, kind = _solve_everything(job, solution, kind)
    if kind != "static" and first is None:
        _measure_bend(job, solution.bundle, kind)
    for line in job.warnings:
        priors.warn(line)
    if kind != "static" and solution is not first:
        solution = replace(solution, bundle=_first_camera_at_origin(solution.bundle))
        inliers = solution.bundle.errors(solution.observations)
        if len(inliers):
            middle, outer = np.percentile(inliers, (50, 90))
            statistics["reprojection_px"] = {"median": _json(middle), "p90": _json(outer)}
        statistics["interpolation_px"] = interpolation_error(solution.bundle, solution.observations, times)
    path = solution.bundle.path(times, priors.width, priors.height)
    depth = _median_depth(solution)
    priors.cameras = path.scaled_world(1 / depth)
    priors.camera_kind = kind
    if statistics.get("grown") and mask_in_doubt(priors):
        statistics["joined"] = _json(join_resting(clip, priors, config, progress))
    elif kind == "moving":
        statistics["released"] = _json(release_static(clip, priors, config, progress))
    step = np.linalg.norm(np.diff(priors.cameras.centers, axis=0), axis=1)
    statistics |= {
        "kind": kind,
        "focal_over_width": round(solution.bundle.focal / priors.width, 4),
        "fov_degrees": round(float(np.rad2deg(2 * np.arctan(priors.width / 2 / solution.bundle.focal))), 2),
        "path_length": _json(step.sum()),
        "turn_degrees": _json(np.rad2deg(_turns(priors.cameras)).sum()),
    }
    priors.statistics["cameras"] = statistics
    progress("cameras", 4, 4, f"{kind}, focal length {statistics['focal_over_width']:.2f} of the width")


def _standing_camera(job: _CameraProblem, shift: float) -> Solution | None:
    """Return the camera of a clip whose pictures show that it stands, turned by its jitter; None where they do not.

    `shift` is that of the static tracks (`static_shift`). The cameras of another provider and a kind that is given are kept.
    """
    unit = max(job.priors.width, job.priors.height) / REFERENCE_WIDTH
    if job.first is not None or job.settings.kind is not None or shift > MAYBE_STANDING_PX * unit:
        return None
    frames, supervised = len(job.tracks), np.asarray(job.clip.supervised)
    test = StillnessTest(lambda frame: grey(job.clip.frames[supervised[[frame]]])[0], frames, job.focal)
    measured = test.measure(lambda done: job.progress("cameras", 0, 4, f"how still it stands, {done} pairs"))
    job.statistics["standing"] = measured.summary()
    if not measured.stands:
        return None
    turns = test.turns(lambda done: job.progress("cameras", done, frames, "the camera stands"))
    job.statistics["standing"]["turned"] = bool((turns != np.eye(3)).any())
    return _static_camera(frames, job.focal, job.principal, turns)


def _measure_bend(job: _CameraProblem, bundle: Bundle, kind: str) -> None:
    """Measure the bend of straight lines in the pictures, and warn where it spoils the cameras of all frames, `bundle`."""
    bend = measure(bundle, job.tracks, job.visible, job.static, replace(job.lens, refine_centers=kind == "moving"))
    if bend is None:
        return
    job.statistics["bend"] = {name: _json(value) for name, value in asdict(bend).items()}
    if bend.certain:
        job.warnings.append(bend.advice(job.priors.width, job.priors.height))


def _why_motion_is_unknown(clip: Clip, tracks: np.ndarray, visible: np.ndarray, static: np.ndarray) -> str:
    """Return why the motion of the camera cannot be found from the static tracks; empty where it can."""
    if static.sum() < MIN_TRACKS:
        return "too few points stand still"
    pictures = grey(clip.frames[clip.supervised])
    held = np.full((len(tracks), int(static.sum())), np.nan, np.float32)
    for frame, picture in enumerate(pictures):
        seen = visible[frame, static]
        held[frame, seen] = sample(texture(picture), tracks[frame, static][seen])
    known = visible[:, static].any(0)
    on_texture = np.nanmedian(held[:, known], axis=0) > 0.5
    if known.any() and on_texture.mean() < MIN_TEXTURED:
        return "what stands still has almost no texture to follow"
    return ""


@dataclass(frozen=True)
class _CameraProblem:
    """Inputs of the camera solver for one clip."""

    clip: Clip
    priors: Priors
    config: PriorsConfig
    tracks: np.ndarray
    """(F, N, 2) pixels."""
    visible: np.ndarray
    """(F, N) bool."""
    static: np.ndarray
    """(N,) bool."""
    focal: float
    """Focal length in pixels: given by the user, or the first guess."""
    first: Solution | None
    """The solution of another provider, to start from."""
    statistics: dict[str, Any]
    """`statistics["cameras"]`, filled while solving."""
    warnings: list[str]
    """Sentences for the diagnostics page, filled while solving."""
    progress: Progress

    @property
    def settings(self) -> CamerasConfig:
        """Settings of this stage."""
        return self.config.cameras

    @property
    def lens(self) -> BundleConfig:
        """Adjustment of the focal length: fixed where it is given, else free with a prior around the expected one."""
        known = self.settings.focal is not None or self.first is not None
        return BundleConfig(refine_focal=not known, expected_focal=self.focal)

    @property
    def sharp_lens(self) -> BundleConfig:
        """The same for sightings that are matched anew, which err less and tell more of the lens."""
        return replace(self.lens, robust_px=REMATCHED_PX, focal_prior=SHARP_FOCAL_PRIOR)

    @cached_property
    def pictures(self) -> np.ndarray:
        """(F, H, W) uint8 grey levels."""
        return grey(self.clip.frames[self.clip.supervised])

    @property
    def times(self) -> np.ndarray:
        """(F,) clip frames."""
        return np.asarray(self.clip.times, np.float64)[self.clip.supervised]

    @property
    def principal(self) -> np.ndarray:
        """(2,) pixels."""
        return np.array([self.priors.width, self.priors.height]) / 2

    def cues(self, frames: np.ndarray) -> DepthCues:
        """Return the depth cues for the cameras of the supervised frames `frames`."""
        depth = self.priors.scratch.get(SEEN_DEPTH) if self.priors.depth is None else self.priors.depth
        return DepthCues(frames, self.tracks, self.visible, self.static, self.priors.mask, depth)


def static_tracks(priors: Priors) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return `tracks (F, N, 2)`, `visible (F, N)` and which tracks stand still `(N,)`; empty when there are none."""
    if priors.tracks is None or priors.tracks_visible is None:
        frames = len(priors.frames)
        return np.zeros((frames, 0, 2), np.float32), np.zeros((frames, 0), bool), np.zeros(0, bool)
    motion = priors.tracks_motion
    static = np.ones(priors.tracks.shape[1], bool) if motion is None else motion < STATIC_MOTION
    return priors.tracks, priors.tracks_visible, static


def static_shift(tracks: np.ndarray, visible: np.ndarray, static: np.ndarray, max_frames: int = 24) -> float:
    """Return the largest median displacement (pixels) of static tracks between two of at most `max_frames` evenly spaced frames.

    `tracks (F, N, 2)`, `visible (F, N)`, `static (N,)`. NaN when no two frames share enough tracks.
    """
    frames = evenly_spaced(len(tracks), max_frames)
    shifts = [np.nan]
    for a, i in enumerate(frames):
        for j in frames[a + 1 :]:
            shared = visible[i] & visible[j] & static
            if shared.sum() >= MIN_TRACKS:
                shifts.append(float(np.median(np.linalg.norm(tracks[j, shared] - tracks[i, shared], axis=1))))
    return float(np.nanmax(shifts)) if len(shifts) > 1 else float("nan")


def linked(visible: np.ndarray) -> bool:
    """Return True if all neighbouring frames share enough of the tracks `visible (F, N)` to tell the camera's turn between them."""
    shared = (visible[1:] & visible[:-1]).sum(1)
    fewer = np.minimum(visible[1:].sum(1), visible[:-1].sum(1))
    return bool((shared >= np.maximum(MIN_TRACKS, MIN_LINKED * fewer)).all())


def complete(
    solution: Solution,
    tracks: np.ndarray,
    visible: np.ndarray,
    static: np.ndarray,
    times: np.ndarray,
    lens: BundleConfig | None = None,
) -> Solution:
    """Return all frames registered and adjusted together on the solution's own observations and the static tracks.

    Missing frames start from the interpolated path, the ones next to a known camera first, and are resected. `lens`: whether
    the focal length is adjusted with them; held when left out.
    """
    lens = lens or BundleConfig(refine_focal=False)
    longest = TRACK_FRAMES if len(tracks) > USUAL_FRAMES else None
    extra, order = sightings(tracks, visible, static, ADJUSTED_TRACKS, longest)
    bundle, own = solution.bundle, _limited_observations(solution, ADJUSTED_TRACKS)
    offset = len(bundle.points)
    registered = solution.registered.copy()
    observations = own.followed_by(replace(extra, weight=TRACK_WEIGHT * extra.weight), offset)
    bundle = replace(bundle, points=np.vstack([bundle.points, np.full((len(order), 3), np.nan)]))
    while not registered.all():
        bundle = _triangulated(bundle, observations, registered, offset)
        missing, known = np.flatnonzero(~registered), np.flatnonzero(registered)
        distance = abs(missing[:, None] - known).min(1)
        ring = missing[distance == distance.min()]
        bundle = _interpolated(bundle, registered, ring, times)
        bundle = resect(bundle, observations, ring)
        registered[ring] = True
    bundle = _triangulated(bundle, observations, registered, offset)
    bundle, observations = without_outliers(bundle, observations)
    refined = adjust(bundle, observations, replace(lens, iterations=10))
    solution = Solution(*without_outliers(refined, observations), registered)
    return _settled(solution, sightings(tracks, visible, static, tracks.shape[1], longest), (extra, order), lens)


def _settled(
    solution: Solution,
    every: tuple[Observations, np.ndarray],
    some: tuple[Observations, np.ndarray],
    lens: BundleConfig,
) -> Solution:
    """Return the solution, adjusted anew on `some` of `every` sighting of static tracks while a frame is left that misses its own.

    In a long sweep what a far frame misses is the first to be dropped as an outlier, and nothing draws that frame back.
    """
    worst = _worst_frame(solution.bundle, *every)
    for _ in range(MORE_ROUNDS):
        if worst <= SETTLED_PX:
            break
        bundle, kept = adjust_anew(solution.bundle, some[0], replace(lens, iterations=10))
        found = _worst_frame(bundle, *every)
        if found > (1 - MIN_SETTLING) * worst:
            break
        solution, worst = Solution(*without_outliers(bundle, kept), solution.registered), found
    return solution


def _worst_frame(bundle: Bundle, seen: Observations, tracks: np.ndarray) -> float:
    """Return the pixels by which the worst frame misses its sightings (median), the points of `tracks` triangulated anew."""
    return float(np.nanmax(frame_errors(bundle, seen, len(tracks)), initial=0.0))


def _triangulated_anew(bundle: Bundle, seen: Observations, tracks: np.ndarray) -> Bundle:
    """Return the cameras with one point for each of the `tracks`."""
    return replace(bundle, points=triangulate(bundle, seen, len(tracks))[0])


def interpolation_error(bundle: Bundle, observations: Observations, times: np.ndarray) -> dict[str, float] | None:
    """Return the error in pixels of cameras that are interpolated from the other frames; None for too few frames.

    Each inner frame is left out in turn; its error is the median, over its points, of the difference between the projections
    by both cameras. The result has the mean and the 90th percentile over frames. On rendered truth it equals the error of the
    true path: it is real shake, which held-out cameras will miss.
    """
    path = bundle.path(times, *(2 * bundle.principal).astype(int))
    errors = []
    for i in range(2, len(times) - 2):
        seen = np.unique(observations.point[observations.frame == i])
        if len(seen) < MIN_TRACKS:
            continue
        keep = np.arange(len(times)) != i
        rest = replace(
            path, intrinsics=path.intrinsics[keep], world_to_camera=path.world_to_camera[keep], times=times[keep]
        )
        there, _ = rest.at(times[i]).project(bundle.points[seen])
        here, _ = path[i].project(bundle.points[seen])
        errors.append(float(np.median(np.linalg.norm(there - here, axis=1))))
    if not errors:
        return None
    return {"mean": round(float(np.mean(errors)), 3), "p90": round(float(np.percentile(errors, 90)), 3)}


def _solve_what_stands_still(job: _CameraProblem, shift: float) -> tuple[Solution, str]:
    """Return the cameras of all frames by the static tracks, which shift by `shift` pixels (`static_shift`), and their kind."""
    kind, frames = job.settings.kind, len(job.tracks)
    if job.first is not None and kind in (None, "moving") and job.static.sum() < MIN_TRACKS:
        job.statistics["solver"] = job.settings.provider
        job.warnings.append(
            f"Too few points stand still to refine the cameras of {job.settings.provider}; they are taken as they are."
        )
        return job.first, "moving"
    unknown = "" if job.first is not None else _why_motion_is_unknown(job.clip, job.tracks, job.visible, job.static)
    if kind == "static" or (kind is None and (unknown or not shift >= STATIC_PX)):
        if kind is None and unknown and frames > 1:
            job.statistics["assumed"] = unknown
            job.warnings.append(f"How the camera moved is not known, because {unknown}; it is taken to stand still.")
        return _static_camera(frames, job.focal, job.principal), "static"
    return _solve(job)


def _solve(job: _CameraProblem) -> tuple[Solution, str]:
    """Return all frames of a camera that is not static, its depth not mirrored, and its kind (`pan` or `moving`)."""
    solution, kind = _first_solution(job)
    job.progress("cameras", 3, 4, "refine the path")
    if kind == "moving":
        solution = _sharpened(job, _refocused(job, _rematched(job, _trusted(job, _completed(job, solution)))))
    return solution, kind


def _refocused(job: _CameraProblem, solution: Solution) -> Solution:
    """Return the solution adjusted anew from the focal length that its sightings prefer (`best_focal`), unless that is given or the
    background is in doubt; fill `focal_search`."""
    if not job.lens.refine_focal or "focal_search" in job.statistics or _in_doubt(job, solution):
        return solution
    job.progress("cameras", 3, 4, "focal length")
    focal, job.statistics["focal_search"] = best_focal(solution, job.sharp_lens)
    if focal == solution.bundle.focal:
        return solution
    start = refocused(solution, focal)
    bundle, kept = adjust_anew(
        start.bundle, start.observations, replace(job.sharp_lens, iterations=15), REMATCHED_ROUNDS
    )
    return Solution(bundle, kept, solution.registered)


def _in_doubt(job: _CameraProblem, solution: Solution) -> bool:
    """Return True if the solution misses frames or had to grow: then the background is in doubt."""
    return not solution.registered.all() or bool(job.statistics.get("grown"))


def _sharpened(job: _CameraProblem, solution: Solution) -> Solution:
    """Return the solution adjusted on short tracks as well, if there is flow and the background is not in doubt, of which short
    tracks cannot tell."""
    priors = job.priors
    if _in_doubt(job, solution) or priors.flow_forward is None or len(job.tracks) < MIN_SEEN:
        return solution
    blocked = np.zeros(job.pictures.shape, bool)
    if priors.mask is not None and not job.static.all():
        blocked = dilate_masks(priors.mask, MOVING_MARGIN)
    if job.clip.hidden is not None:
        blocked = blocked | job.clip.hidden[priors.frames]
    around = Neighbourhood(job.pictures, long_flows(job.clip, priors, job.config, silent), blocked)
    return sharpened(solution, around.sightings(), job.sharp_lens)


def _trusted(job: _CameraProblem, solution: Solution) -> Solution:
    """Return the solution, its cameras grown from the frames that it meets where it misses some; fill `registered`, the number
    of frames that their cameras meet, and `grown` of the statistics."""
    longest = TRACK_FRAMES if len(job.tracks) > USUAL_FRAMES else None
    pieces, whole = (
        sightings(job.tracks, job.visible, job.static, job.tracks.shape[1], most) for most in (longest, None)
    )
    found = grow_trusted(solution, pieces, whole, job.lens)
    job.statistics["registered"] = int(found.solution.registered.sum())
    if found.grown:
        job.statistics["grown"] = True
    return found.solution


def _rematched(job: _CameraProblem, solution: Solution) -> Solution:
    """Return the solution adjusted on sightings that are matched anew (`rematch`), unless few are or a frame that was met is missed
    by them; fill `rematched`: the fraction of sightings, and pixels by which the worst frame is missed before and after."""
    seen = match_anew(job.pictures, solution.observations)
    matched = float((seen.weight == 1).mean()) if len(seen.weight) else 0.0
    if matched < MIN_REMATCHED:
        return solution
    tracks, lens = np.arange(len(solution.bundle.points)), replace(job.sharp_lens, iterations=10)
    found = Solution(*adjust_anew(solution.bundle, seen, lens, REMATCHED_ROUNDS), solution.registered)
    before, after = (_worst_frame(one.bundle, seen, tracks) for one in (solution, found))
    job.statistics["rematched"] = {"part": _json(matched), "before_px": _json(before), "after_px": _json(after)}
    return found if after <= max(before, SETTLED_PX) else solution


def _completed(job: _CameraProblem, solution: Solution) -> Solution:
    """Return all frames of the solution, or of its rival where that explains the static tracks of all frames better.

    A sample of frames hardly tells the two apart where there is little translation. On scooter-black the errors of a sample
    differ by 2 % or 9 %, those of all frames by 40 to 60 %.
    """

    def completed(one: Solution) -> Solution:
        return complete(one, job.tracks, job.visible, job.static, job.times, job.lens)

    if solution.rival is None:
        return completed(solution)
    found = in_threads(completed, (solution, solution.rival))
    seen, order = sightings(job.tracks, job.visible, job.static, ADJUSTED_TRACKS)

    def on_the_same_tracks(one: Solution) -> Bundle:
        bundle = with_points_ahead(_triangulated_anew(one.bundle, seen, order), seen)
        return adjust(bundle, seen, replace(job.lens, iterations=10))

    whole = in_threads(on_the_same_tracks, found)
    first, second = sorted(whole, key=lambda bundle: total_cost(bundle, seen, job.lens))
    decision = decide(first, second, seen, job.lens, job.cues(np.arange(len(job.tracks))))
    job.statistics["mirror"] = decision.summary() | {"sample": job.statistics["mirror"]}
    return found[0] if decision.bundle is whole[0] else found[1]


def _solve_everything(job: _CameraProblem, found: Solution, kind: str) -> tuple[Solution, str]:
    """Return `found` and its `kind`, or cameras of all tracks that move, where those explain clearly more of the picture and the
    static tracks as sharply."""
    best, chosen, most = (found, kind), job, explained_fraction(found.bundle, job.tracks, job.visible)
    believed = job.tracks[:, job.static], job.visible[:, job.static]
    blurred = MAX_LESS_SHARP * track_error(found.bundle, *believed)
    for solver in ("direct", "tracks") if job.settings.solver == "auto" else (job.settings.solver,):
        if most >= ENOUGH_EXPLAINED:
            break
        other = replace(
            job,
            warnings=[],
            config=replace(job.config, cameras=replace(job.settings, kind="moving", solver=solver)),
            static=np.ones_like(job.static),
            statistics={key: job.statistics[key] for key in ("static_tracks", "static_shift_px")},
        )
        solution, other_kind = _solve(other)
        explained = explained_fraction(solution.bundle, job.tracks, job.visible)
        more = MIN_EXPLAINED_MORE if chosen is job else 0.0
        enough = explained > max(most + more, MIN_STANDING) and track_error(solution.bundle, *believed) <= blurred
        if other_kind == "moving" and enough and _translates(other, solution):
            best, chosen, most = (solution, other_kind), other, explained
    if chosen is not job:
        job.warnings[:] = chosen.warnings
        job.statistics.clear()
        job.statistics.update(chosen.statistics, everything=True)
    job.statistics["explained"] = _json(most)
    return best


def _first_solution(job: _CameraProblem) -> tuple[Solution, str]:
    """Return a solution of some frames, its depth not mirrored, and its kind."""
    turning = solve_rotations(job.tracks, job.visible, job.static, job.focal, job.principal, 4 * SAMPLED_POINTS)
    sample, search = _search(job, turning)
    errors = sample.bundle.errors(sample.observations)
    parallax = float(np.percentile(errors, 90)) if len(errors) else 0.0
    job.statistics.update({"parallax_px": _json(parallax), "pan_focal_search": search})
    zoom = _zoom(job, turning)
    if job.settings.kind == "pan":
        return _pan(job, turning, sample.bundle.focal, zoom), "pan"

    moved, solver = _moving(job, refocused(turning, job.focal, translating=False))
    if moved is None:
        if parallax > TURNED_PX:
            job.statistics["assumed"] = "it could not be reconstructed from what stands still"
        job.warnings.append(
            "The camera's motion could not be reconstructed (too little parallax or texture); only its turning is kept and"
            " the background becomes flat. Give cameras of another program if you have them."
        )
        return _adjusted_pan(turning, sample.bundle.focal), "pan"
    if zoom is not None and _moving_explains_more(zoom, moved):
        zoom = None
    if job.settings.kind is None and (zoom is not None or not _translates(job, moved)):
        return _pan(job, turning, sample.bundle.focal, zoom), "pan"
    job.statistics["solver"] = solver
    return moved, "moving"


def _zoom(job: _CameraProblem, turning: Solution) -> Zoom | None:
    """Return the zoom of a turning camera that explains most of the remaining error; None where another provider gave the lens."""
    sample, frames = _sampled(turning)
    if job.first is not None or not len(sample.observations.frame):
        return None
    zoom = find_zoom(sample, frames, job.lens)
    return zoom if zoom.explains else None


def _moving_explains_more(zoom: Zoom, moved: Solution) -> bool:
    """Return True if a moving camera leaves far less error than the zoom."""
    sample, _ = _sampled(moved)
    unknowns = 6 * len(sample.bundle.center) + 3 * len(sample.bundle.points)
    return mean_cost(sample.bundle, sample.observations, unknowns) < MIN_COST_LEFT_BY_MOVING * zoom.cost


def _pan(job: _CameraProblem, turning: Solution, focal: float, zoom: Zoom | None = None) -> Solution:
    job.statistics.pop("mirror", None)
    if zoom is not None:
        found = zoomed(turning, zoom, None if job.lens.refine_focal else job.focal)
        summary = job.statistics["zoom"] = zoom.summary(found.bundle, job.priors.width)
        job.statistics.pop("pan_focal_search", None)
        job.warnings.append(
            f"The lens zooms ({summary['factor']:.2f} times): a zoom looks like a step forward, so the camera is taken to stand"
            " and turn, and the depth of the background is a guess."
        )
        return found
    job.warnings.append(
        "The camera only turns (almost no parallax): the depth of the background cannot be measured, so it is a guess"
        " and views from other places will look flat."
    )
    return _adjusted_pan(turning, focal)


def _sampled(solution: Solution) -> tuple[Solution, np.ndarray]:
    """Return a smaller solution and its frames; more frames are sampled where tracks are too short to be seen in three of them."""
    frames = SAMPLED_FRAMES
    while True:
        sample, kept = subset(solution, SAMPLED_POINTS, frames)
        holding = np.bincount(sample.observations.frame, minlength=len(kept))
        enough = len(sample.bundle.points) >= MIN_SAMPLED_POINTS and (holding >= MIN_POINTS_PER_FRAME).all()
        if enough or len(kept) == solution.registered.sum() or frames >= MAX_SAMPLED_FRAMES:
            return sample, kept
        frames *= 2


def _resolve_mirror(job: _CameraProblem, start: Solution) -> Solution | None:
    """Return the solution, or its mirror image, adjusted on a sample of frames; None where no sample can be taken."""
    sample, frames = _sampled(start)
    if not len(sample.observations.frame):
        return None
    starts = [sample.bundle]
    if not start.bundle.center.any():  # it only turns yet: a world that is nearer below, and one that is nearer above
        directions = sample.bundle.points / np.linalg.norm(sample.bundle.points, axis=1, keepdims=True)
        below = guess_inverse_distance(directions, sample.bundle.rotation)
        starts = [replace(sample.bundle, points=directions / inverse[:, None]) for inverse in (below, 1 / below)]
    decision = choose_orientation(starts, sample.observations, job.lens, job.cues(frames))
    job.statistics["mirror"] = decision.summary()
    registered = np.zeros(len(job.tracks), bool)
    registered[frames] = np.bincount(sample.observations.frame, minlength=len(frames)) >= MIN_TRACKS
    observations = replace(sample.observations, frame=frames[sample.observations.frame])

    def of_all_frames(found: Bundle, rival: Solution | None = None) -> Solution:
        bundle = replace(start.bundle.with_frames(frames, found), points=found.points)
        return Solution(bundle, observations, registered, rival)

    if decision.rejected is None or decision.verdict == "sure":
        return of_all_frames(decision.bundle)
    return of_all_frames(decision.bundle, of_all_frames(decision.rejected))


def _with_sightings(job: _CameraProblem, solution: Solution) -> Solution:
    """Return a solution whose cameras have points: without their own those of the static tracks, triangulated."""
    if len(solution.observations.frame):
        return solution
    seen, order = sightings(job.tracks, job.visible, job.static, 4 * SAMPLED_POINTS)
    return replace(solution, bundle=_triangulated_anew(solution.bundle, seen, order), observations=seen)


def _translates(job: _CameraProblem, moved: Solution) -> bool:
    """Return True if translating explains the tracks better than turning alone; fills `statistics["cameras"]["translation"]`."""
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
    verdict = "large" if size >= LARGE_TRANSLATION_PX else "small"
    real = gain >= TRANSLATION_GAIN and size >= TRANSLATION_PX
    job.statistics["translation"] = {
        "size_px": _json(size),
        "gain": _json(gain),
        "verdict": verdict if real else "none",
    }
    return real


def _search(job: _CameraProblem, turning: Solution) -> tuple[Solution, dict[str, list[float]]]:
    """Return `search_focal` among lenses of films, or with the one that is known."""
    width, side = job.priors.width, max(job.priors.width, job.priors.height)
    candidates = [focal * side / width for focal in FOCALS] if job.lens.refine_focal else [job.focal / width]
    return search_focal(turning, width, candidates, DEFAULT_FOCAL * side / width)


def _moving(job: _CameraProblem, turning: Solution) -> tuple[Solution | None, str]:
    """Return a solution that translates, its depth not mirrored, by the first solver that succeeds, and the solver's name."""
    settings, priors = job.settings, job.priors
    job.progress("cameras", 1, 4, "first cameras")
    if job.first is not None:
        return _resolve_mirror(job, _with_sightings(job, job.first)) or job.first, settings.provider
    if priors.depth is not None and settings.solver in ("auto", "depth"):
        known = job.focal if settings.focal else None
        solution, job.statistics["focal_search"] = solve_with_depth(
            job.tracks, job.visible, job.static, priors.depth, known, priors.width
        )
        if solution.error < 4 * MAX_ERROR_PX:  # the final adjustment no longer leans on the depth and comes below
            return _resolve_mirror(job, solution), "depth"
    direct = None
    if settings.solver in ("auto", "direct"):
        direct = _resolve_mirror(job, turning)
        good = direct is not None and direct.error < 2 * MAX_ERROR_PX and linked(job.visible & job.static)
        if direct is not None and (good or settings.solver == "direct"):
            return direct, "direct"
    mirror = job.statistics.get("mirror")
    start, solver = _solve_incrementally(job)
    if start is not None:
        return _resolve_mirror(job, start), solver
    if mirror is not None:
        job.statistics["mirror"] = mirror
    return direct, "direct"


def _solve_incrementally(job: _CameraProblem) -> tuple[Solution | None, str]:
    """Return the better of pycolmap on keyframes and the own incremental structure from motion; None if both fail."""
    settings = job.settings
    tried: list[tuple[Solution, str]] = []
    keyframes = _keyframes(len(job.tracks), settings.keyframes)
    if settings.solver in ("auto", "colmap"):
        found = _solve_keyframes(job, keyframes)
        if found is not None:
            tried.append((found, "colmap"))
            if found.registered.sum() >= MIN_REGISTERED * len(keyframes) and found.error < MAX_ERROR_PX:
                return tried[0]
    if settings.solver in ("auto", "tracks"):
        found = solve_with_tracks(job.tracks, job.visible, job.static, job.focal, job.principal, settings.seed)
        if found is not None:
            tried.append((found, "tracks"))
    if not tried:
        return None, "none"
    best = max(tried, key=lambda entry: (entry[0].error < 2 * MAX_ERROR_PX, _covered(entry[0].registered)))
    if not best[0].error < 2 * MAX_ERROR_PX or _covered(best[0].registered) < 0.5:
        return None, "none"
    if best[0].registered.sum() < MIN_REGISTERED * (len(keyframes) if best[1] == "colmap" else len(job.tracks)):
        job.warnings.append(
            "Some cameras could not be solved from the pictures and are continued from their neighbours."
        )
    return best


def _solve_keyframes(job: _CameraProblem, keyframes: np.ndarray) -> Solution | None:
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


def _adjusted_pan(turning: Solution, focal: float) -> Solution:
    """Return the rotations of all frames adjusted at the focal length found."""
    turning = refocused(turning, focal, translating=False)
    settings = BundleConfig(iterations=8, refine_focal=False, refine_centers=False)
    return replace(turning, bundle=adjust(turning.bundle, turning.observations, settings))


def _static_camera(frames: int, focal: float, principal: np.ndarray, turns: np.ndarray | None = None) -> Solution:
    """Return the camera that stands at the origin; `turns (F, 3, 3)`: its rotations, when left out it does not turn."""
    turns = np.tile(np.eye(3), (frames, 1, 1)) if turns is None else turns
    bundle = Bundle(focal, principal, turns, np.zeros((frames, 3)), np.zeros((0, 3)))
    nothing = Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    return Solution(bundle, nothing, np.ones(frames, bool))


def _keyframes(frames: int, max_count: int) -> np.ndarray:
    """Return evenly spaced indices, first and last included, at most `max_count`."""
    return evenly_spaced(frames, max_count)


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


def _first_camera_at_origin(bundle: Bundle) -> Bundle:
    """Return the same geometry in the axes of the first camera."""
    turn, origin = bundle.rotation[0], bundle.center[0]
    return replace(
        bundle,
        rotation=bundle.rotation @ turn.T,
        center=(bundle.center - origin) @ turn.T,
        points=(bundle.points - origin) @ turn.T,
    )


def _median_depth(solution: Solution) -> float:
    """Return the median depth of the sightings; 1 without any."""
    depth = solution.bundle.local(solution.observations)[:, 2]
    depth = depth[depth > 0]
    return float(np.median(depth)) if len(depth) else 1.0


def _turns(path: CameraPath) -> np.ndarray:
    """Return the angles between neighbouring cameras in radians, `(F - 1,)`."""
    q = quaternion.from_matrix(path.world_to_camera[:, :3, :3])
    turn = quaternion.to_rotation_vector(quaternion.multiply(q[1:], quaternion.conjugate(q[:-1])))
    return np.linalg.norm(turn, axis=1)


def _json(value: float) -> float | None:
    """Return a rounded number, None where it is not finite."""
    return round(float(value), 4) if np.isfinite(value) else None
