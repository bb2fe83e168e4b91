"""The request of a fit: the clip, the folder, and everything that decides what becomes of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..clip import Clip, read_clip, usual_width
from ..clip.read import parse_span
from ..clip.stream import reported_frame_count
from ..errors import F4xError
from ..fit.budget import ClipSize, Grant
from ..fit.config import THREADS, FitConfig
from ..fit.pipeline import NOT_DECIDING
from ..fit.settings import list_settings
from ..progress import Progress, silent
from ..windows.plan import LENGTHS, usual_length, usual_overlap
from ..windows.resuming import AT_ONCE, WINDOW, window_of


@dataclass(frozen=True)
class ClipOptions:
    """The pictures of a clip that are used, and their size."""

    frames: str | None = None
    """First frame, end and step as `A:B:S`; None: all."""
    width: int | None = None
    """Width of the pictures in pixels; None: 480 along the longer side. Pictures are never enlarged."""
    hold_out: int | None = None
    """Frames with index % N == N - 1 are kept for measuring; None: no frame, or those of the data set."""
    masks: str | None = None
    """Folder of masks of what moves, `layout` for the data set's own, or `alpha` for the clip's own alpha."""

    def read(self, source: Path | str, progress: Progress = silent) -> Clip:
        """Return the clip at `source`."""
        return read_clip(source, self.frames, self.width_of(source), self.hold_out, self.masks, progress)

    def width_of(self, source: Path | str) -> int:
        """Return the width in pixels at which the clip at `source` is fitted."""
        return usual_width(source) if self.width is None else self.width

    def first_picture(self, source: Path | str, width: int | None = None) -> Clip:
        """Return the first of the pictures that are used, `width` pixels wide or as it is."""
        start = parse_span(self.frames).start or 0
        return read_clip(source, f"{start}:{start + 1}", width)


@dataclass(frozen=True)
class FitOptions:
    """Everything that decides a fit besides its clip and its folder; `f4x fit --help` has the same options."""

    config: FitConfig = field(default_factory=FitConfig)
    """Settings, for example `fit.config.profile("quick")`."""
    clip: ClipOptions = field(default_factory=ClipOptions)
    """The pictures that are used."""
    resume: bool = False
    """Continue the fit that was interrupted in the folder."""
    minutes: float | None = None
    """Wall time that it may take, about; None: as much as the settings ask for."""
    memory: float | None = None
    """Gigabytes that it may take, about; None: most of the machine's."""
    window: int | None = None
    """Frames of a window of a long clip; 0: all at once; None: by the clip's length and the memory."""
    overlap: int | None = None
    """Frames that neighbouring windows share; None: 12, or nearly half of a shorter window."""
    features: tuple[str, ...] = ()
    """Teachers whose features are distilled into the scene afterwards."""
    linear_light: bool = False
    """Also refit the scene for renderers that blend in linear light."""

    def __post_init__(self) -> None:
        """Raise F4xError for numbers that no fit can take."""
        for name in ("seed", THREADS):
            value = getattr(self.config, name)
            if value is not None and value < 0:
                raise F4xError(f"--{name} {value}: give a number that is not negative.")
        for name in ("minutes", "memory"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise F4xError(f"--{name} {value:g}: give a number above 0.")

    @property
    def grant(self) -> Grant:
        """Minutes and memory that it may take."""
        return Grant(self.minutes, self.memory)


@dataclass(frozen=True)
class WindowSize:
    """Lengths of the windows of a clip."""

    length: int
    """Frames of a window; 0 for a clip that is fitted at once."""
    overlap: int
    """Frames that neighbouring windows share."""


@dataclass(frozen=True)
class FitRequest:
    """Request of a fit: a clip, a folder and the options."""

    source: Path
    """Video file, folder of images or data set."""
    folder: Path
    """For the scene, its page, priors and checkpoints."""
    options: FitOptions = field(default_factory=FitOptions)
    """The settings that decide it."""

    def window_size(self) -> WindowSize:
        """Return the size asked for, that of the fit that is continued, or what is usual for such a clip."""
        options = self.options
        length = options.window
        if length is None and options.resume:
            length = window_of(self.folder)
        if length is None:
            frames, length = reported_frame_count(self.source, options.clip.frames), 0
            if frames > LENGTHS[-1]:
                first = options.clip.first_picture(self.source, options.clip.width_of(self.source))
                length = usual_length(ClipSize(frames, first.width, first.height), options.config, options.memory)
        return WindowSize(length, usual_overlap(length) if options.overlap is None else options.overlap)

    def made_with(self, windows: WindowSize) -> dict[str, str]:
        """Return the options that decide what a fit becomes, or the windows of a long clip: name on the command line -> text."""
        clip, config = self.options.clip, self.options.config
        span = parse_span(clip.frames)
        settings = [s for s in list_settings(config) if s.settable and s.name.rpartition(".")[2] != THREADS]
        if windows.length:
            of_its_kind = {WINDOW: str(windows.length), "--overlap": str(windows.overlap)}
        else:
            priors = " ".join(f"{name}={path}" for name, path in config.priors.files.items())
            of_its_kind = {WINDOW: AT_ONCE, "CLIP": str(self.source), "--masks": str(clip.masks or "none")}
            of_its_kind["--prior"] = priors or "none"
            settings = [setting for setting in settings if setting.name not in NOT_DECIDING]
        return {
            **of_its_kind,
            "--frames": f"{span.start or 0}:{'' if span.stop is None else span.stop}:{span.step or 1}",
            "--width": str(clip.width_of(self.source)),
            "--hold-out": str(clip.hold_out or 0),
            "--profile": config.name,
            **{f"--set {setting.name}": setting.text for setting in settings},
        }
