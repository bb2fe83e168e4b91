"""Makes a scene with its pages of a clip: at once or in windows, with features and an appearance for linear light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..clip import Clip, read_clip
from ..clip.model import MIN_FRAMES
from ..clip.notes import Remark
from ..clip.stream import Survey, survey
from ..errors import F4xError
from ..evaluation.evaluate import Figures, evaluate, keep_measured
from ..features.models.providers import require_provider
from ..features.teachers import find_teacher, require_ready
from ..files import replace_file, sole_writer
from ..fit.budget import ClipSize
from ..fit.checkpoint import OtherSettingsError
from ..fit.config import FitConfig
from ..fit.distil_config import DistilConfig
from ..fit.linear_config import LinearConfig
from ..fit.pipeline import CHECKPOINT, fit_clip
from ..priors import Priors, build_priors
from ..priors.providers import STAGES
from ..progress import Progress, silent
from ..report.advice import about_cuts, quality, verdict
from ..report.fitted import FittedScene
from ..report.input_picture import write_input
from ..windows.plan import Shot, plan_shots, plan_windows
from ..windows.resuming import forget, remember, require_same, require_same_at_once
from ..windows.shots import LongFit, fit_long
from .checks import require_backend
from .distilling import Distilled, DistilRequest, distill
from .fit_options import FitOptions, FitRequest, WindowSize
from .granting import granted
from .refitting import Refitted, refit_file


@dataclass(frozen=True)
class Fitted:
    """The result of a fit."""

    path: Path
    """The scene file; of a clip with cuts that of the longest shot."""
    scenes: tuple[FittedScene, ...]
    """The scene, or one for each shot of a clip that was fitted in windows."""
    quality: str
    """`good`, `usable with limits` or `poor`."""
    verdict: str
    """The quality of the scene at `path` and its reason, in a sentence."""
    remarks: tuple[Remark, ...] = ()
    """Remarks on frames that were left out, mended or guessed while the clip was read."""
    notes: tuple[str, ...] = ()
    """Sentences about cuts in the clip."""
    cuts: tuple[int, ...] | None = None
    """Frames that begin a shot; None: the clip was fitted at once."""
    features: tuple[Distilled, ...] = ()
    """For each scene, where features were asked for."""
    linear_light: tuple[Refitted, ...] = ()
    """For each scene, where linear light was asked for."""

    @property
    def main(self) -> FittedScene:
        """The scene at `path`."""
        return max(self.scenes, key=len)


def make_scene(
    source: Path | str, folder: Path | str, options: FitOptions | None = None, progress: Progress = silent
) -> Fitted:
    """Turn a clip into `folder/scene.f4x`, with `metrics.json` and the page `diagnostics.html`, as `f4x fit` does.

    Args:
        source: video file, folder of images or data set.
        folder: where the result goes, priors and checkpoints too. An interrupted fit goes on from there with `resume`.
        options: which pictures, which settings, and what else is made.
        progress: is called `(stage, done, total, message)`; raising `errors.Cancelled` in it stops the fit.

    Raises:
        F4xError: a clip, options or a folder that cannot be used, or a fit that cannot be continued with these options.
    """
    request = FitRequest(Path(source), Path(folder), options or FitOptions())
    _require_possible(request)
    with sole_writer(request.folder):
        return _Fit(request, progress).run()


@dataclass(frozen=True)
class MadePriors:
    """The result of `make_priors`."""

    folder: Path
    """The priors folder."""
    priors: Priors
    """The arrays in it."""
    frames: int
    """Frames of the clip, held-out ones included."""
    size: tuple[int, int]
    """Width and height of its pictures."""
    remarks: tuple[Remark, ...]
    """Remarks on frames that were left out, mended or guessed while the clip was read."""


def make_priors(request: FitRequest, progress: Progress = silent) -> MadePriors:
    """Compute `folder/priors` of a clip and nothing else, as `f4x priors` does."""
    _require_possible(request)
    with sole_writer(request.folder):
        clip = request.options.clip.read(request.source, progress)
        clip.require_enough()
        folder = request.folder / "priors"
        priors = build_priors(clip, folder, request.options.config.priors_in_threads, progress)
        write_input(clip, request.folder)
        return MadePriors(folder, priors, len(clip), (clip.width, clip.height), clip.remarks)


def fit_at_once(
    clip: Clip, folder: Path, config: FitConfig, progress: Progress = silent, resume: bool = False
) -> Fitted:
    """Fit, measure, and leave `scene.f4x`, `metrics.json`, `diagnostics.html` and checkpoints in `folder`."""
    result = fit_clip(clip, folder, config, progress, resume)
    from ..report.diagnostics import (  # matplotlib: a second that the start need not wait
        render_previews,
        write_diagnostics,
    )

    wanted = Figures(baselines=True, masks=result.moving)
    metrics = evaluate(result.scene, clip, wanted, config.backend, progress)
    scene, figures = keep_measured(folder, result.scene, metrics, seconds=result.seconds)
    path = folder / "scene.f4x"
    images = render_previews(scene, metrics, config.backend)
    found = write_diagnostics(folder / "diagnostics.html", clip, result, metrics, images)
    notes = tuple(f"{cut.what} {cut.advice}" for cut in about_cuts(result.priors, clip.picked))
    made = FittedScene.of(path, scene, figures, (0, len(clip)))
    return Fitted(path, (made,), quality(metrics, found), verdict(metrics, found), clip.remarks, notes)


@dataclass(frozen=True)
class LongClip:
    """A clip that is fitted in windows, as it was surveyed."""

    survey: Survey
    """Length, cuts and times of the clip."""
    shots: tuple[Shot, ...]
    """With their windows, in order; those that are too short for any fit are left out."""

    def size(self, picture: Clip) -> ClipSize:
        """Return the size of the clip that is fitted, of pictures like `picture`."""
        windows = [end - start for shot in self.shots for start, end in shot.windows]
        return ClipSize(max(windows), picture.width, picture.height, len(windows))


def survey_long(request: FitRequest, size: WindowSize, progress: Progress = silent) -> LongClip | None:
    """Survey a clip that is fitted in windows, and find its shots; return None for one that is fitted at once."""
    if size.length == 0:
        return None
    plan_windows(0, size.length, size.length, size.overlap)  # a wrong pair is refused before the clip is read
    clip = request.options.clip
    if request.options.config.priors.files:
        raise F4xError("--prior cannot be cut into windows; fit with --window 0, or leave it out.")
    known = survey(request.source, clip.frames, clip.width_of(request.source), progress)
    shots = plan_shots(known.count, known.cuts, size.length, size.overlap)
    if not shots:
        raise F4xError(
            f"{request.source}: no shot of this clip has {MIN_FRAMES} frames; give --window 0 to fit it as one."
        )
    return LongClip(known, shots)


def fit_shots(request: FitRequest, long_clip: LongClip, config: FitConfig, progress: Progress = silent) -> Fitted:
    """Fit the shots of a long clip window by window."""
    known, folder, clip = long_clip.survey, request.folder, request.options.clip
    width, step = clip.width_of(request.source), clip.hold_out
    clocks = {shot: known.clock(shot.start, shot.end) for shot in long_clip.shots}

    def read(start: int, end: int) -> Clip:
        shot = next(shot for shot in long_clip.shots if shot.start <= start < shot.end)
        times, fps = clocks[shot].times[start - shot.start : end - shot.start], clocks[shot].fps
        part = read_clip(request.source, known.part(start, end), width, None, clip.masks, progress)
        held_out = np.arange(start, end) % step == step - 1 if step else part.held_out
        return replace(part, held_out=held_out, times=times - times[0], fps=fps, remarks=known.remarks)

    scenes = tuple(fit_long(long_clip.shots, LongFit(read, config, request.options.resume), folder, progress))
    path, longest = folder / "scene.f4x", max(scenes, key=len)
    middle = longest.frames[0] + len(longest) // 2
    write_input(read(middle, middle + 1), folder)
    notes = (f"{len(scenes)} shots; {path} is the longest, --frames {longest.picked}",) if len(scenes) > 1 else ()
    metrics = longest.metrics
    return Fitted(path, scenes, metrics["quality"], metrics["verdict"], known.remarks, notes, tuple(known.cuts))


def copy_longest(fitted: Fitted) -> None:
    """Copy the longest of several shots to the place of the scene of a clip without cuts."""
    for name in ("scene.f4x", "metrics.json") if len(fitted.scenes) > 1 else ():
        with replace_file(fitted.path.with_name(name)) as file:
            file.write(fitted.main.path.with_name(name).read_bytes())


def require_settings(config: FitConfig) -> None:
    """Raise F4xError where the raster backend or a provider of priors that the settings name cannot run here."""
    require_backend(config.backend)
    for stage in STAGES:
        require_provider(stage, getattr(config.priors, stage).provider)


def _require_possible(request: FitRequest) -> None:
    """Raise F4xError for what would fail in the middle of the fit, or after it."""
    options = request.options
    require_settings(options.config)
    for name in options.features:
        find_teacher(name)
        if not (request.folder / "features" / name / "spec.json").is_file():
            require_ready(name)


@dataclass(frozen=True)
class _Fit:
    """Fit that runs in a folder which no other fit writes into."""

    request: FitRequest
    progress: Progress

    def run(self) -> Fitted:
        """Fit the clip at once or in windows, then add features and linear light to what was fitted."""
        request = self.request
        windows = request.window_size()
        made_with = request.made_with(windows)
        if request.options.resume:
            require_same(request.folder, made_with)
        long_clip = survey_long(request, windows, self.progress)
        fitted = self._at_once(made_with) if long_clip is None else self._in_windows(long_clip, made_with)
        fitted = self._extended(fitted)
        copy_longest(fitted)
        return fitted

    def _at_once(self, made_with: dict[str, str]) -> Fitted:
        request, resume = self.request, self.request.options.resume
        clip = request.options.clip.read(request.source, self.progress)
        clip.require_enough()
        if not resume:
            forget(request.folder)
        config = granted(request, ClipSize(len(clip.supervised), clip.width, clip.height), self.progress)
        try:
            return fit_at_once(clip, request.folder, config, self.progress, resume)
        except OtherSettingsError:
            require_same_at_once(request.folder, made_with)
            raise
        finally:
            if not resume and (request.folder / CHECKPOINT).is_file():
                remember(request.folder, made_with)

    def _in_windows(self, long_clip: LongClip, made_with: dict[str, str]) -> Fitted:
        request, clip = self.request, self.request.options.clip
        remember(request.folder, made_with)
        first = clip.first_picture(request.source, clip.width_of(request.source))
        config = granted(request, long_clip.size(first), self.progress)
        return fit_shots(request, long_clip, config, self.progress)

    def _extended(self, fitted: Fitted) -> Fitted:
        """Add to every scene what the options ask for besides."""
        options, config = self.request.options, self.request.options.config
        features, refits = [], []
        for scene in fitted.scenes:
            if options.features:
                settings = DistilConfig(seed=config.seed, threads=config.threads, backend=config.backend)
                wanted = DistilRequest(
                    scene.path, options.features, clip=self.request.source, frames=scene.picked, config=settings
                )
                features.append(distill(wanted, self.progress))
            if options.linear_light:
                linear = LinearConfig(seed=config.seed, threads=config.threads or 0)
                refits.append(refit_file(scene.path, linear, options.resume, self.progress))
        return replace(fitted, features=tuple(features), linear_light=tuple(refits))
