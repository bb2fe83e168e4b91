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

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry import quaternion
from ..geometry.camera import CameraPath
from ..progress import Progress
from .bundle import Bundle, Observations
from .camera_problem import MIN_TRACKS, Attempt, CameraProblem, rounded, static_shift
from .config import PriorsConfig
from .flow import grey, sample, texture
from .lens import measure
from .motion import REFERENCE_WIDTH
from .point_tracks import PointTracks
from .refinement import refined
from .rigid import explained_fraction, track_error
from .second_look import join_resting, mask_in_doubt, release_static
from .sfm import DEFAULT_FOCAL, Solution, refocused
from .standing import StillnessTest
from .structure import first_solution, translation_of

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

STATIC_PX = 0.5
"""A clip is static when no pair of frames shifts its static tracks by this much (median over the tracks)."""
MAYBE_STANDING_PX = 6.0
"""... and may stand when they shift by less than this (480 wide), which is more than chained tracks of a tripod drift in ten
seconds: then the pictures are compared (`standing`)."""
MIN_TEXTURED = 0.1
"""With a smaller fraction of the static tracks on enough texture for flow (`flow.texture` of one half, median over a track's
sightings) the tracks drift with moving objects beside them: 3 % in a sky behind a mover, 56 % and more in the real clips."""
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


def provide(
    clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress, first: Solution | None = None
) -> None:
    """Fill `cameras`, `camera_kind` and `statistics["cameras"]` (provider `classical`).

    `first`: what another provider found for all frames; a moving clip starts from it, and its focal length is kept.
    """
    settings = config.cameras
    progress("cameras", 0, 4, "what moves")
    focal = settings.focal * priors.width if settings.focal else DEFAULT_FOCAL * max(priors.width, priors.height)
    if first is not None:
        first = refocused(first, focal) if settings.focal else first
        focal = first.bundle.focal
    job = CameraProblem(clip, priors, config, PointTracks.of(priors), focal, first, progress)
    found = _solved(job)
    if found.kind != "static" and first is None:
        found = _with_bend(job, found)
    for line in found.warnings:
        priors.warn(line)
    solution, kind = found.solution, found.kind
    statistics: dict[str, Any] = dict(found.statistics)
    if kind != "static" and solution is not first:
        solution = replace(solution, bundle=_first_camera_at_origin(solution.bundle))
        statistics |= _errors(solution, job.times)
    path = solution.bundle.path(job.times, priors.width, priors.height)
    priors.cameras = path.scaled_world(1 / _median_depth(solution))
    priors.camera_kind = kind
    if statistics.get("grown") and mask_in_doubt(priors):
        statistics["joined"] = rounded(join_resting(clip, priors, config, progress))
    elif kind == "moving":
        statistics["released"] = rounded(release_static(clip, priors, config, progress))
    step = np.linalg.norm(np.diff(priors.cameras.centers, axis=0), axis=1)
    statistics |= {
        "kind": kind,
        "focal_over_width": round(solution.bundle.focal / priors.width, 4),
        "fov_degrees": round(float(np.rad2deg(2 * np.arctan(priors.width / 2 / solution.bundle.focal))), 2),
        "path_length": rounded(step.sum()),
        "turn_degrees": rounded(np.rad2deg(_turns(priors.cameras)).sum()),
    }
    priors.statistics["cameras"] = statistics
    progress("cameras", 4, 4, f"{kind}, focal length {statistics['focal_over_width']:.2f} of the width")


def _solved(job: CameraProblem) -> Attempt:
    """Return the cameras of all frames."""
    shift = static_shift(job.tracks)
    noted: dict[str, Any] = {"static_tracks": int(job.tracks.static.sum()), "static_shift_px": rounded(shift)}
    test = _stillness_test(job, shift)
    if test is not None:
        measured = test.measure(lambda done: job.progress("cameras", 0, 4, f"how still it stands, {done} pairs"))
        noted["standing"] = measured.summary()
        if measured.stands:
            frames = len(job.tracks)
            turns = test.turns(lambda done: job.progress("cameras", done, frames, "the camera stands"))
            noted["standing"]["turned"] = bool((turns != np.eye(3)).any())
            return Attempt(_static_camera(turns, job), "static", noted)
    found = _solve_static_tracks(job, shift)
    if job.first is None and job.settings.kind in (None, "moving") and mask_in_doubt(job.priors):
        found = _or_of_all_tracks(job, found)
    return found.noting(**noted)


def _stillness_test(job: CameraProblem, shift: float) -> StillnessTest | None:
    """Return the test of pictures that shows if the camera stands, turned by its jitter; None where there is nothing to test.

    `shift` is that of the static tracks (`static_shift`). The cameras of another provider and a kind that is given are kept.
    """
    unit = max(job.priors.width, job.priors.height) / REFERENCE_WIDTH
    if job.first is not None or job.settings.kind is not None or shift > MAYBE_STANDING_PX * unit:
        return None
    supervised = np.asarray(job.clip.supervised)
    return StillnessTest(lambda frame: grey(job.clip.frames[supervised[[frame]]])[0], len(job.tracks), job.focal)


def _with_bend(job: CameraProblem, found: Attempt) -> Attempt:
    """Return the attempt with the bend of straight lines in the pictures, and a warning where it spoils the cameras."""
    lens = replace(job.lens, refine_centers=found.kind == "moving")
    bend = measure(found.solution.bundle, job.tracks, lens)
    if bend is None:
        return found
    found = found.noting(bend={name: rounded(value) for name, value in asdict(bend).items()})
    return found.warning(bend.advice(job.priors.width, job.priors.height)) if bend.certain else found


def _why_motion_is_unknown(clip: Clip, tracks: PointTracks) -> str:
    """Return why the motion of the camera cannot be found from the static tracks; empty where it can."""
    if tracks.static.sum() < MIN_TRACKS:
        return "too few points stand still"
    visible, uv = tracks.visible[:, tracks.static], tracks.uv[:, tracks.static]
    held = np.full(visible.shape, np.nan, np.float32)
    for frame, picture in enumerate(grey(clip.frames[clip.supervised])):
        held[frame, visible[frame]] = sample(texture(picture), uv[frame, visible[frame]])
    known = visible.any(0)
    on_texture = np.nanmedian(held[:, known], axis=0) > 0.5
    if known.any() and on_texture.mean() < MIN_TEXTURED:
        return "what stands still has almost no texture to follow"
    return ""


def _solve_static_tracks(job: CameraProblem, shift: float) -> Attempt:
    """Return the cameras of all frames by the static tracks, which shift by `shift` pixels (`static_shift`)."""
    kind, frames = job.settings.kind, len(job.tracks)
    if job.first is not None and kind in (None, "moving") and job.tracks.static.sum() < MIN_TRACKS:
        provider = job.settings.provider
        return Attempt(job.first, statistics={"solver": provider}).warning(
            f"Too few points stand still to refine the cameras of {provider}; they are taken as they are."
        )
    unknown = "" if job.first is not None else _why_motion_is_unknown(job.clip, job.tracks)
    if kind != "static" and (kind is not None or (not unknown and shift >= STATIC_PX)):
        return _solve(job)
    found = Attempt(_static_camera(np.tile(np.eye(3), (frames, 1, 1)), job), "static")
    if kind is not None or not unknown or frames < 2:
        return found
    return found.noting(assumed=unknown).warning(
        f"How the camera moved is not known, because {unknown}; it is taken to stand still."
    )


def _solve(job: CameraProblem) -> Attempt:
    """Return all frames of a camera that is not static, its depth not mirrored; of kind `pan` or `moving`."""
    found = first_solution(job)
    return refined(job, found) if found.kind == "moving" else found


def _or_of_all_tracks(job: CameraProblem, found: Attempt) -> Attempt:
    """Return `found`, or moving cameras of all tracks where those explain clearly more of the picture and the static tracks as
    sharply; either notes the fraction that it explains."""
    uv, visible = job.tracks.uv, job.tracks.visible
    best, most = found, explained_fraction(found.solution.bundle, uv, visible)
    static = uv[:, job.tracks.static], visible[:, job.tracks.static]
    for solver in ("direct", "tracks") if job.settings.solver == "auto" else (job.settings.solver,):
        if most >= ENOUGH_EXPLAINED:
            break
        settings = replace(job.settings, kind="moving", solver=solver)
        everything = replace(
            job, config=replace(job.config, cameras=settings), tracks=PointTracks.all_static(uv, visible)
        )
        other = _solve(everything)
        bundle = other.solution.bundle
        explained, more = explained_fraction(bundle, uv, visible), MIN_EXPLAINED_MORE * (best is found)
        if other.kind != "moving" or explained <= max(most + more, MIN_STANDING):
            continue
        if track_error(bundle, *static) > MAX_LESS_SHARP * track_error(found.solution.bundle, *static):
            continue
        translation = translation_of(everything, other.solution)
        if translation.real:
            best, most = other.noting(translation=translation.summary(), everything=True), explained
    return best.noting(explained=rounded(most))


def _static_camera(turns: np.ndarray, job: CameraProblem) -> Solution:
    """Return the camera that stands at the origin; `turns (F, 3, 3)`: its rotations."""
    bundle = Bundle(job.focal, job.principal, turns, np.zeros((len(turns), 3)), np.zeros((0, 3)))
    nothing = Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    return Solution(bundle, nothing, np.ones(len(turns), bool))


def _errors(solution: Solution, times: np.ndarray) -> dict[str, Any]:
    """Return the statistics of how well the cameras meet their sightings, and those that are left out."""
    found: dict[str, Any] = {}
    errors = solution.bundle.errors(solution.observations)
    if len(errors):
        middle, outer = np.percentile(errors, (50, 90))
        found["reprojection_px"] = {"median": rounded(middle), "p90": rounded(outer)}
    return found | {"interpolation_px": interpolation_error(solution.bundle, solution.observations, times)}


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
