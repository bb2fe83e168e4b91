"""Solves for the colors of a fitted scene over time: shadows, ripples, an audience, blur, what the geometry misses. No torch.

The background of a fit stands still and has one color for all of the clip, so its pictures leave a residual which neighbouring
frames share (correlation .4 to .9 from one frame to the next on seven real clips) and distant ones do not (0 eight frames later).
With the geometry fixed, a picture is linear in the colors: each knot's tints are the least squares solution for its frame, by
conjugate gradients with the weights of each Gaussian as preconditioner. They are kept if they predict the frames between them.
The static scene learns nothing where something moves before it, else the mover's errors would stay behind when it is taken out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter

from ..clip import Clip
from ..geometry.arrays import evenly_spaced
from ..parallel import in_threads, side_by_side, thread_count
from ..priors.config import USUAL_FRAMES
from ..progress import Progress, silent
from ..raster.blend_weights import BlendWeights
from ..scene import Scene
from ..scene.tints import LEVELS, quantized, with_tints
from ..scene.view import fitted_config
from .needs import Need


@dataclass(frozen=True)
class TintConfig:
    """Colors over time."""

    enabled: bool = True
    """Look for them: shadows, ripples, an audience, blur, which one color for the whole clip cannot show."""
    min_gain: float = 0.2
    """PSNR (dB) that they must bring to frames between the moments at which they were found, or they are left out."""
    megabytes: float = 48.0
    """Most that they may take, for each hundred of the used frames where there are more. Where they would take more, fewer of the
    used frames are such moments."""
    iterations: int = 4
    """Iterations of conjugate gradients. A fifth brings at most .03 dB to frames between the moments, twelve 2 dB to those at them
    alone."""
    damping: float = 0.05
    """Squared weight, in pixels, below which a Gaussian's color hardly follows. Four times as much loses .1 to .4 dB."""

    def bytes_for(self, frames: int) -> float:
        """Return the bytes that the colors of so many used frames may take."""
        return 1e6 * self.megabytes * max(frames / USUAL_FRAMES, 1)


SHOWS = 0.5
"""Alpha of the dynamic Gaussians from which a pixel is theirs. At .02 an audience of which a little moves stays blurred: breakdance
loses .5 dB; the masks hold moving objects as a whole."""
AROUND = 0.008
"""Widths of the picture by which the pixels of moving objects are widened: outlines err by two pixels of 480 (J .8 to .9)."""
SOFTENED = 0.1
"""Pixels added to each Gaussian's summed weight in the preconditioner, for those that hardly show."""
PIXELS_AT_ONCE = 4e6
"""Pixels of the frames that are solved side by side: each takes 170 bytes, or 600 where Gaussians outnumber them."""
JUDGED = 6
"""Knots that are predicted from their neighbours to judge."""
MIN_ERROR = 1e-8
"""Mean square; keeps the logarithm finite."""


@dataclass(eq=False)
class Tinting:
    """The tints of a scene, found in one part of its clip after the other."""

    scene: Scene
    config: TintConfig
    backend: str = "auto"

    def __post_init__(self) -> None:
        """Choose the knots: evenly among the used frames, as many as there is room for."""
        held = set(self.scene.held_out)
        used = np.array([frame for frame in range(len(self.scene.cameras)) if frame not in held])
        room = self.config.bytes_for(len(used)) / (3 * max(len(self.scene.ids), 1))
        self.knots = used[evenly_spaced(len(used), max(int(room), 1))]
        self.values = np.zeros((len(self.scene.ids), len(self.knots), 3), np.int8)
        self.targets: dict[int, tuple[np.ndarray, np.ndarray | None]] = {}
        judged = np.arange(1, len(self.knots) - 1)
        self.judged = judged[evenly_spaced(len(judged), JUDGED)] if len(judged) else judged

    def add(
        self,
        clip: Clip,
        masks: Mapping[int, np.ndarray] | None = None,
        first: int = 0,
        progress: Progress = silent,
    ) -> None:
        """Solve for the knots in `clip`, whose first frame is frame `first` of the scene.

        `masks`: frame of `clip` -> (H,W) bool of moving objects there, in addition to the dynamic Gaussians.
        """
        inside = (self.knots >= first) & (self.knots < first + len(clip))
        rows = np.flatnonzero(inside)

        def solve(row: int) -> None:
            frame = int(self.knots[row])
            target, seen = _frame(clip, frame - first)
            view, picture = self._view(frame, seen, None if masks is None else masks.get(frame - first))
            self.values[:, row] = quantized(view.solved(target - picture, self.config))
            if row in self.judged:
                self.targets[row] = target, seen

        at_once = min(thread_count(), max(int(PIXELS_AT_ONCE / (clip.width * clip.height)), 1))
        with side_by_side(at_once):
            in_threads(solve, rows.tolist(), lambda done: progress("colors over time", done, len(rows)))

    def finish(self) -> Scene:
        """Return the scene with its tints, if they pay, and with what decided among its needs."""
        if not len(self.judged) or not self.targets:
            return self.scene
        gain = float(np.mean([self._gain(row) for row in self.judged if row in self.targets]))
        pays = gain >= self.config.min_gain
        size = self.values.nbytes / 1e6
        need = Need(
            "colors over time",
            f"of {len(self.knots)} moments: shadows, ripples, blur" if pays else "none",
            f"{gain:+.2f} dB on frames between the moments; wanted {self.config.min_gain:g}",
            "nothing" if pays else f"{size:.0f} MB",
        )
        scene = replace(self.scene, needs=(*self.scene.needs, need.row()))
        return with_tints(scene, scene.cameras.times[self.knots], self.values) if pays else scene

    def _view(self, frame: int, seen: np.ndarray | None, mask: np.ndarray | None = None) -> tuple[_View, np.ndarray]:
        """Return a frame of the clip as it is seen, and its picture (H,W,3) without tints."""
        scene, camera, time = self.scene, self.scene.cameras[frame], float(self.scene.cameras.times[frame])
        posed = scene.posed(time)
        moves = posed.dynamic[:, None].astype(np.float32)
        channels = 6 if posed.dynamic.any() else 3
        weights = BlendWeights(posed, camera, channels, fitted_config(scene, camera, time), self.backend)
        drawn = weights.picture(np.concatenate([scene.colors(posed, camera), moves], 1))
        size = camera.height, camera.width
        counts = np.ones((*size, 1), np.float32) if seen is None else seen[..., None].astype(np.float32)
        moving = (drawn[..., 3] > SHOWS) if mask is None else (drawn[..., 3] > SHOWS) | mask
        wide = 2 * round(AROUND * camera.width) + 1
        moving = maximum_filter(moving.astype(np.uint8), wide).astype(bool)
        return _View(weights, moves, counts, counts * ~moving[..., None]), drawn[..., :3]

    def _gain(self, row: int) -> float:
        """Return the PSNR (dB) that the tints of the knots before and after bring to that of `row`."""
        frame, (target, seen) = int(self.knots[row]), self.targets[row]
        view, picture = self._view(frame, seen)
        times = self.scene.cameras.times[self.knots[row - 1 : row + 2]]
        later = (times[1] - times[0]) / (times[2] - times[0])
        tint = (1 - later) * self.values[:, row - 1] + later * self.values[:, row + 1]
        predicted = picture + view.weights.picture((tint / LEVELS).astype(np.float32))
        errors = [_error(each, target, seen) for each in (picture, predicted)]
        return float(10 * np.log10(errors[0] / errors[1]))


@dataclass(frozen=True, eq=False)
class _View:
    """One frame as a linear map from the tints of N Gaussians: those that stand still count where nothing moves alone."""

    weights: BlendWeights
    """Blend weights of a frame: six channels where some Gaussians are dynamic, else three."""
    moves: np.ndarray
    """(N,1) float32 1 for dynamic Gaussians."""
    counts: np.ndarray
    """(H,W,1) float32 1 where the frame was seen."""
    still: np.ndarray
    """(H,W,1) float32 1 where in addition nothing moves."""

    def picture(self, tint: np.ndarray) -> np.ndarray:
        """Return (H,W,3): what `tint (N,3)` adds to the picture."""
        if not self.moves.any():
            return self.counts * self.weights.picture(tint)
        both = self.weights.picture(np.concatenate([tint, tint * self.moves], 1))
        return self.still * both[..., :3] + (self.counts - self.still) * both[..., 3:]

    def sums(self, picture: np.ndarray) -> np.ndarray:
        """Return (N,3): the transpose of `picture`, applied to (H,W,3)."""
        if not self.moves.any():
            return self.weights.sums(self.counts * picture)
        both = self.weights.sums(np.concatenate([self.still * picture, self.counts * picture], -1))
        return np.where(self.moves > 0, both[:, 3:], both[:, :3])

    def solved(self, left: np.ndarray, config: TintConfig) -> np.ndarray:
        """Return (N,3) float32 tints for `left (H,W,3)`, by preconditioned conjugate gradients on the normal equations."""
        left = self.counts * left
        precondition = 1 / (np.maximum(self.sums(np.ones_like(left)), 0) + np.float32(SOFTENED))
        damping = np.float32(config.damping)
        slope = self.sums(left)
        tint = np.zeros_like(slope)
        step = precondition * slope
        length = _dot(slope, step)
        direction = step
        for _ in range(config.iterations):
            if length <= 0:
                break
            change = self.picture(direction)
            rate = np.float32(length / (_dot(change, change) + damping * _dot(direction, direction)))
            tint = tint + rate * direction
            left = left - rate * change
            slope = self.sums(left) - damping * tint
            step = precondition * slope
            before, length = length, _dot(slope, step)
            direction = step + np.float32(length / before) * direction
        return tint


def tinted_scene(
    scene: Scene,
    clip: Clip,
    config: TintConfig,
    masks: Mapping[int, np.ndarray] | None = None,
    backend: str = "auto",
    progress: Progress = silent,
) -> Scene:
    """Return the fitted, unedited scene with colors over time, if the frames of its whole clip ask for them.

    `masks`: clip frame -> (H,W) bool of moving objects, in addition to the dynamic Gaussians.
    """
    if not config.enabled:
        return scene
    tinting = Tinting(scene, config, backend)
    tinting.add(clip, masks, 0, progress)
    return tinting.finish()


def _frame(clip: Clip, index: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Frame `index` (H,W,3) float32 in [0, 1], and (H,W) bool where it was seen; None where all of it was."""
    return clip.frames[index].astype(np.float32) / 255, None if clip.hidden is None else ~clip.hidden[index]


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    """Return the sum of products in float64; numpy's pairwise sums do not depend on threads, a BLAS may."""
    return float(np.multiply(a, b).sum(dtype=np.float64))


def _error(picture: np.ndarray, target: np.ndarray, seen: np.ndarray | None) -> float:
    """Return the mean square of what the screen shows, at least `MIN_ERROR`."""
    left = np.clip(picture, 0, 1) - target
    left = left if seen is None else left * seen[..., None]
    return max(float(np.square(left).mean(dtype=np.float64)), MIN_ERROR)
