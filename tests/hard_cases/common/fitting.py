"""Fits a film through the whole pipeline with a very small profile, and asks what the program says about it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.hard_cases import Check, limited, reported, that, within
from f4x_core.errors import F4xError
from f4x_core.evaluation.evaluate import Figures, blend_by_flow, evaluate, path_error
from f4x_core.evaluation.truth import MIN_PATH_SPREAD, align_cameras, into_scene, rotation_error
from f4x_core.fit.config import FitConfig, profile
from f4x_core.fit.pipeline import FitResult, fit_clip
from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import Camera
from f4x_core.priors import Priors
from f4x_core.report.advice import WATCHABLE_PSNR, findings
from f4x_core.scene import Scene
from f4x_core.scene.view import render

from .film import Film

STEPS = 350
"""An ordinary film then shows unseen frames at 29 dB, their flow blend is at 26.5 and the nearest used frame at 23.6; after 120
steps the blend was better. Rounding alone moves the score by up to 1.5 dB."""
ASIDE = 4.0
"""Degrees by which a view lies above and below the path, about the place in the picture's middle at the median depth."""
MIN_GAIN = 2.0
"""How many times the squared error of the scene must go into that of the best picture that needs no 3D, in views aside."""
SAME_DEPTH = 0.05
"""Relative difference of depths below which two frames see the same place."""
STILL, MOVING = "what stands still", "what moves"
MOVING_GUESSED = "The depth of what moves is a guess"
WRONG_PATH, WRONG_TURN, WRONG_LENS = 0.05, 1.0, 0.1
"""Most by which cameras that were found may be off: share of the path's length, degrees, share of the focal length."""


def small(focal: float | None = None, **priors: Any) -> FitConfig:
    """The quick profile made as small as these films; `focal` in picture widths, None to find it out; `priors` are its files
    (`depth=folder`, ...)."""
    config = profile("quick")
    # pycolmap wants larger pictures, and seconds to start.
    cameras = replace(config.priors.cameras, solver="tracks", focal=focal)
    tracks = replace(config.priors.tracks, count=1200)
    files = {name: str(path) for name, path in priors.items()}
    return replace(
        config,
        steps=STEPS,
        threads=1,
        checkpoint_every=10**6,
        measure_every=STEPS,
        priors=replace(config.priors, tracks=tracks, cameras=cameras, files=files),
        scaffold=replace(config.scaffold, max_nodes=24, geometry_steps=40, following_steps=40),
        spawn_static=replace(config.spawn_static, max_count=1500),
        spawn_dynamic=replace(config.spawn_dynamic, max_count=500),
        density_static=replace(config.density_static, max_count=2000),
        density_dynamic=replace(config.density_dynamic, max_count=800),
    )


@dataclass(frozen=True)
class Fitted:
    """A fitted film and what was measured and said about it."""

    film: Film
    result: FitResult
    scene: Scene
    metrics: dict[str, Any]

    @property
    def priors(self) -> Priors:
        """What the fit was given."""
        return self.result.priors

    @property
    def messages(self) -> list[str]:
        """The sentences of the diagnostics page that are no praise."""
        found = findings(self.priors, self.result.scene.scaffold, self.metrics)
        return [finding.what for finding in found if finding.weight != "good"]

    def picture(self, frame: int) -> np.ndarray:
        """(H, W, 3) in [0, 1]: a frame as the scene shows it."""
        cameras = self.scene.cameras
        return render(self.scene, cameras[frame], float(cameras.times[frame]), ("rgb",))["rgb"].clip(0, 1)

    @property
    def psnr(self) -> float:
        """Of unseen frames, dB."""
        return self.metrics["held_out_psnr"]


def fit(film: Film, lens_known: bool = True, **priors: Any) -> Fitted:
    """Priors, fit and evaluation; `priors` are arrays or files that the user gives.

    The lens (of the first frame, where it zooms) is given unless it is what a case is about: pictures as small as these hardly
    tell it (`lens_not_known.py`).
    """
    with tempfile.TemporaryDirectory() as folder:
        focal = float(film.cameras.intrinsics[0, 0, 0]) / film.clip.width if lens_known else None
        files = {name: _file(Path(folder) / name, value) for name, value in priors.items()}
        try:
            result = fit_clip(film.clip, Path(folder) / "fit", small(focal, **files))
        except F4xError as reason:  # without the name of a folder that is another one every time
            raise F4xError(str(reason).replace(folder, "films")) from reason
    scene = result.scene
    return Fitted(film, result, scene, evaluate(scene, film.clip, Figures(baselines=True)))


def _file(path: Path, value: Any) -> Path:
    """An array as `.npy`, a camera path as `.json`."""
    path = path.with_suffix(".npy" if isinstance(value, np.ndarray) else ".json")
    if isinstance(value, np.ndarray):
        np.save(path, value)
    else:
        value.write(path)
    return path


def judge(fitted: Fitted, cause: str = "", known: str = "", at_most: float = 1.0) -> Iterator[Check]:
    """Finite arrays; right by `against_truth`, or a sentence that matches `cause`.

    Views aside of what moves may also be wrong where it is said that its depth is a guess: one moving camera cannot measure it.
    `known`: the sentence of a known limit, where nothing is said of it; no error may then be more than `at_most` times what
    is allowed.
    """
    scene = fitted.scene
    arrays = [scene.static.means, scene.static.scales, scene.dynamic.means, scene.cameras.world_to_camera]
    yield that("every array is finite", all(np.isfinite(array).all() for array in arrays))
    checks = list(against_truth(fitted))
    for index, check in enumerate(checks):
        if check.outcome == "wrong" and check.what.startswith(MOVING):
            guessed = reported(_missed(check), MOVING_GUESSED, fitted.messages)
            checks[index] = guessed if guessed.outcome == "told" else check
    short = [check for check in checks if check.outcome == "wrong"]
    if short and (cause or known):
        missed = "; ".join(map(_missed, short))
        cause_told = reported(f"{missed}; the cause is said", cause, fitted.messages) if cause else None
        if cause_told is not None and (cause_told.outcome == "told" or not known):
            yield cause_told
        else:
            yield limited(missed, all(check.error <= at_most * check.allowed for check in short), known)
        checks = [check for check in checks if check.outcome != "wrong"]
    yield from checks
    scene_db, blend_db = (
        fitted.metrics.get(f"held_out_psnr{name}_registered", fitted.metrics[f"held_out_psnr{name}"])
        for name in ("", "_flow_blend")
    )
    if scene_db < blend_db:  # with registered cameras where they are found, as the page compares them
        yield reported("it is said that unseen frames are worse than blended ones", "Simply blending", fitted.messages)


def _missed(check: Check) -> str:
    return f"{check.what}: {check.error:.3g} where {check.allowed:.3g} is allowed"


def against_truth(fitted: Fitted) -> Iterator[Check]:
    """Unseen frames; cameras where they were found and not given; and, where the camera moved, views aside of its path.

    Unseen frames must be watchable and better than without 3D, views aside clearly better.
    """
    scores = fitted.metrics
    plain = max(scores["held_out_psnr_nearest"], scores["held_out_psnr_flow_blend"])
    yield within(f"squared error of unseen frames, in that of {WATCHABLE_PSNR:g} dB", _times(WATCHABLE_PSNR, fitted), 1)
    yield within("squared error of unseen frames, in that without 3D", _times(plain, fitted), 1)
    truth, found = fitted.film.cameras, fitted.scene.cameras
    moves = _spread(truth.centers) > 0
    lens = float(np.median(found.intrinsics[:, 0, 0] / truth.intrinsics[:, 0, 0]))
    similarity = align_cameras(found, truth)
    if fitted.priors.provenance["cameras"]["provider"] == "classical":
        if moves:
            yield within("cameras, in the path's length", path_error(found, truth)["ate_fraction"], WRONG_PATH)
        yield within("cameras, degrees", rotation_error(found, truth, similarity), WRONG_TURN)
        if fitted.priors.camera_kind != "static":  # one that stands still shows nothing of its lens, and needs none
            yield within("focal length, relative", abs(lens - 1), WRONG_LENS)
    if moves:
        errors = {STILL: float("inf")}
        if _spread(found.centers) >= MIN_PATH_SPREAD:
            errors = _aside(fitted, lambda camera: into_scene(camera, similarity, lens))
        for what, error in errors.items():
            yield within(f"{what} {ASIDE:g} degrees aside, squared error in that without 3D", error, 1 / MIN_GAIN)


def _times(psnr: float, fitted: Fitted) -> float:
    """Squared error of unseen frames over that of `psnr`."""
    return 10 ** ((psnr - fitted.psnr) / 10)


def _spread(centers: np.ndarray) -> float:
    """Root mean square distance of (T,3) places from their mean."""
    return float(np.sqrt(centers.var(axis=0).sum()))


def _aside(fitted: Fitted, into: Callable[[Camera], Camera]) -> dict[str, float]:
    """Squared error of what stands still and of what moves (where something does) in views aside at the times of unseen
    frames, over that of the best picture that needs no 3D.

    That is, for every view, the best of all used frames as they are and of the blend of the two neighbours; the true
    picture chooses it. Of what stands still only what some used frame saw counts. `into` makes a true camera one of the
    scene.
    """
    film, clip = fitted.film, fitted.film.clip
    used = np.flatnonzero(~clip.held_out)
    sums: dict[str, list[np.ndarray]] = {STILL: [], MOVING: []}
    for t in np.flatnonzero(clip.held_out):
        before, after = used[used < t].max(), used[used > t].min()
        blend = blend_by_flow(clip.frames[before], clip.frames[after], (t - before) / (after - before))
        pictures = [*(clip.frames[used] / 255), blend]
        for angle in (-ASIDE, ASIDE):
            camera = _tilted(film.cameras[int(t)], np.deg2rad(angle), float(np.nanmedian(film.depth[t])))
            true, depth, moving = film.show(camera, float(t))
            still = ~moving & _was_seen(film, used, camera.unproject(camera.pixel_grid(), depth))
            seen = render(fitted.scene, into(camera), float(t), ("rgb",))["rgb"].clip(0, 1)
            for what, counts in ((STILL, still), (MOVING, moving)):
                scores = [np.square(picture - true / 255)[counts].sum() for picture in (seen, *pictures)]
                sums[what].append(np.array([scores[0], min(scores[1:])]))
    totals = {what: np.sum(pairs, axis=0) for what, pairs in sums.items()}
    return {what: float(error / plain) for what, (error, plain) in totals.items() if plain > 0}


def _was_seen(film: Film, frames: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(H,W) bool: some of the frames saw the point (H,W,3), taken to stand still: its depth is the picture's there."""
    height, width = points.shape[:2]
    seen = np.zeros((height, width), bool)
    for frame in frames:
        pixels, depth = film.cameras[int(frame)].project(points)
        inside = (pixels >= 0).all(-1) & (pixels[..., 0] < width) & (pixels[..., 1] < height) & (depth > 0)
        column, row = np.where(inside[..., None], pixels, 0).astype(int).transpose(2, 0, 1)
        seen |= inside & (abs(film.depth[frame][row, column] / depth - 1) < SAME_DEPTH)
    return seen


def _tilted(camera: Camera, angle: float, depth: float) -> Camera:
    """The camera carried up or down around the place straight ahead at `depth`, to which it still looks."""
    turn = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([angle, 0, 0])))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, [0, 0, depth] - turn @ [0, 0, depth]
    return replace(camera, world_to_camera=matrix @ camera.world_to_camera)
