"""The camera solver's problem for one clip, and an attempt to solve it, which its stages pass on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..progress import Progress
from .bundle import BundleConfig
from .config import CamerasConfig, PriorsConfig
from .flow import grey
from .mirror import DepthCues
from .point_tracks import PointTracks
from .sfm import Solution

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

MIN_TRACKS = 12
"""Static tracks that the motion of the camera needs at least."""
REMATCHED_PX = 0.5
"""Scale in pixels of the robust error of sightings that are matched anew. Chosen on nine rendered clips, mean error of the camera's
place .58 % of the path's reach without them, .29 with a scale of 1 and .25 with .5."""
SHARP_FOCAL_PRIOR = 0.02
"""Weight of the usual focal length against these (`bundle.FOCAL_PRIOR`), chosen on rendered horizon, knight, orbit, fox and walk
through lenses of .89, 1.39 and 2 picture widths, and on blackswan, whose water draws the lens from 2.1 to 2.3 with half of it, so
that its relief doubles. Judged through lenses of .61 and 1.39, static depth errs by 2.6 and 1.6 %, with twice the weight by 3.2 and
2.9."""


@dataclass(frozen=True)
class CameraProblem:
    """Inputs of the camera solver for one clip."""

    clip: Clip
    priors: Priors
    config: PriorsConfig
    tracks: PointTracks
    """Point tracks of the supervised frames."""
    focal: float
    """Focal length in pixels: given by the user, or the first guess."""
    first: Solution | None
    """The solution of another provider, to start from."""
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
        depth = self.priors.scratch.seen_depth if self.priors.depth is None else self.priors.depth
        return DepthCues(frames, self.tracks, self.priors.mask, depth)


@dataclass(frozen=True)
class Attempt:
    """Cameras that one way of solving found, with what it measured and has to say."""

    solution: Solution
    kind: str = "moving"
    """`static`, `pan` or `moving`."""
    statistics: Mapping[str, Any] = field(default_factory=dict)
    """Rows of `Priors.statistics["cameras"]`."""
    warnings: tuple[str, ...] = ()
    """Sentences for the diagnostics page."""

    def noting(self, **statistics: Any) -> Attempt:
        """Return the attempt with further rows of statistics."""
        return replace(self, statistics={**self.statistics, **statistics})

    def without(self, *names: str) -> Attempt:
        """Return the attempt without the statistics of these names."""
        return replace(self, statistics={key: value for key, value in self.statistics.items() if key not in names})

    def warning(self, sentence: str) -> Attempt:
        """Return the attempt with one more sentence for the diagnostics page."""
        return replace(self, warnings=(*self.warnings, sentence))

    @property
    def in_doubt(self) -> bool:
        """Return True if cameras of frames are missing or had to grow: then the background is in doubt."""
        return not self.solution.registered.all() or bool(self.statistics.get("grown"))


def static_shift(tracks: PointTracks, max_frames: int = 24) -> float:
    """Return the largest median displacement (pixels) of static tracks between two of at most `max_frames` evenly spaced frames.

    NaN when no two frames share enough tracks.
    """
    frames, seen = evenly_spaced(len(tracks), max_frames), tracks.seen
    shifts = [np.nan]
    for a, i in enumerate(frames):
        for j in frames[a + 1 :]:
            shared = seen[i] & seen[j]
            if shared.sum() >= MIN_TRACKS:
                shifts.append(float(np.median(np.linalg.norm(tracks.uv[j, shared] - tracks.uv[i, shared], axis=1))))
    return float(np.nanmax(shifts)) if len(shifts) > 1 else float("nan")


def rounded(value: float) -> float | None:
    """Return a number for statistics, None where it is not finite."""
    return round(float(value), 4) if np.isfinite(value) else None
