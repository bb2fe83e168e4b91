"""Solves for the colors of a fitted scene over time: shadows, ripples, an audience, blur, what the geometry misses. No torch.

The background of a fit stands still and has one color for all of the clip, so its pictures leave a residual which neighbouring
frames share (correlation .4 to .9 from one frame to the next on seven real clips) and distant ones do not (0 eight frames later).
With the geometry fixed, a picture is linear in the colors: each knot's tints are the least squares solution for its frame, by
conjugate gradients with the weights of each Gaussian as preconditioner. They are kept if they predict the frames between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..clip import Clip
from ..geometry.arrays import evenly_spaced
from ..parallel import in_threads
from ..progress import Progress, silent
from ..raster.blend_weights import BlendWeights
from ..scene import Scene
from ..scene.tints import LEVELS, steps_of, with_tints
from ..scene.view import fitted_config
from .needs import Need


@dataclass(frozen=True)
class TintConfig:
    """Colors over time."""

    min_gain: float = 0.2
    """PSNR (dB) that tints must bring to frames between their knots to be kept; infinity: none are tried."""
    megabytes: float = 48.0
    """Most that the tints may take. Where they would take more, every second used frame is a knot, or every third, and so on."""
    iterations: int = 5
    """Of conjugate gradients. Twelve bring 2 dB more at the knots and nothing between them."""
    damping: float = 0.05
    """Squared weight, in pixels, below which a Gaussian's color hardly follows. Four times as much loses .1 to .4 dB."""


SOFTENED = 0.1
"""Pixels added to each Gaussian's summed weight in the preconditioner, for those that hardly show."""
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
        room = self.config.megabytes * 1e6 / (3 * max(len(self.scene.ids), 1))
        stride = max(int(np.ceil(len(used) / max(room, 1))), 1)
        self.knots = used[::stride]
        self.values = np.zeros((len(self.scene.ids), len(self.knots), 3), np.int8)
        self.targets: dict[int, tuple[np.ndarray, np.ndarray | None]] = {}
        judged = np.arange(1, len(self.knots) - 1)
        self.judged = judged[evenly_spaced(len(judged), JUDGED)] if len(judged) else judged

    def add(self, clip: Clip, first: int = 0, progress: Progress = silent) -> None:
        """Solve for the knots in `clip`, whose first frame is frame `first` of the scene."""
        inside = (self.knots >= first) & (self.knots < first + len(clip))
        rows = np.flatnonzero(inside)

        def solve(row: int) -> None:
            frame = int(self.knots[row])
            target, seen = _frame(clip, frame - first)
            self.values[:, row] = steps_of(self._solved(frame, target, seen))
            if row in self.judged:
                self.targets[row] = target, seen

        in_threads(solve, rows.tolist(), lambda done: progress("tints", done, len(rows)))

    def finish(self) -> Scene:
        """The scene with its tints, if they pay, and with what decided among its needs."""
        if not len(self.judged) or not self.targets:
            return self.scene
        gain = float(np.mean([self._gain(row) for row in self.judged if row in self.targets]))
        pays = gain >= self.config.min_gain
        size = self.values.nbytes / 1e6
        need = Need(
            "colors over time",
            f"{len(self.knots)} moments" if pays else "none",
            f"{gain:+.2f} dB on frames between the moments; wanted {self.config.min_gain:g}",
            "nothing" if pays else f"{size:.0f} MB",
        )
        scene = replace(self.scene, needs=(*self.scene.needs, need.row()))
        return with_tints(scene, scene.cameras.times[self.knots], self.values) if pays else scene

    def _weights(self, frame: int) -> tuple[BlendWeights, np.ndarray]:
        """The blend weights in a frame of the clip, and the picture (H,W,3) without tints."""
        scene, camera, time = self.scene, self.scene.cameras[frame], float(self.scene.cameras.times[frame])
        posed = scene.posed(time)
        weights = BlendWeights(posed, camera, 3, fitted_config(scene, camera, time), self.backend)
        return weights, weights.picture(scene.colors(posed, camera))

    def _solved(self, frame: int, target: np.ndarray, seen: np.ndarray | None) -> np.ndarray:
        """(N,3) float32: what has to be added to the colors so that a frame looks like `target (H,W,3)` where it is `seen`."""
        weights, picture = self._weights(frame)
        left = _where_seen(target - picture, seen)
        total = weights.sums(_where_seen(np.ones_like(left), seen))
        precondition = 1 / (np.maximum(total, 0) + np.float32(SOFTENED))
        damping = np.float32(self.config.damping)
        tint = np.zeros_like(total)
        slope = weights.sums(left)
        step = precondition * slope
        length = _dot(slope, step)
        direction = step
        for _ in range(self.config.iterations):
            if length <= 0:
                break
            change = _where_seen(weights.picture(direction), seen)
            rate = np.float32(length / (_dot(change, change) + damping * _dot(direction, direction)))
            tint = tint + rate * direction
            left = left - rate * change
            slope = weights.sums(left) - damping * tint
            step = precondition * slope
            before, length = length, _dot(slope, step)
            direction = step + np.float32(length / before) * direction
        return tint

    def _gain(self, row: int) -> float:
        """PSNR (dB) that the tints of the knots before and after bring to that of `row`."""
        frame, (target, seen) = int(self.knots[row]), self.targets[row]
        weights, picture = self._weights(frame)
        times = self.scene.cameras.times[self.knots[row - 1 : row + 2]]
        later = (times[1] - times[0]) / (times[2] - times[0])
        tint = (1 - later) * self.values[:, row - 1] + later * self.values[:, row + 1]
        predicted = picture + weights.picture((tint / LEVELS).astype(np.float32))
        errors = [_error(each, target, seen) for each in (picture, predicted)]
        return float(10 * np.log10(errors[0] / errors[1]))


def tinted_scene(
    scene: Scene, clip: Clip, config: TintConfig, backend: str = "auto", progress: Progress = silent
) -> Scene:
    """The fitted, unedited scene with colors over time, if the frames of its whole clip ask for them."""
    if not np.isfinite(config.min_gain):
        return scene
    tinting = Tinting(scene, config, backend)
    tinting.add(clip, 0, progress)
    return tinting.finish()


def _frame(clip: Clip, index: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Frame `index` (H,W,3) float32 in [0, 1], and (H,W) bool where it was seen; None where all of it was."""
    return clip.frames[index].astype(np.float32) / 255, None if clip.hidden is None else ~clip.hidden[index]


def _where_seen(picture: np.ndarray, seen: np.ndarray | None) -> np.ndarray:
    return picture if seen is None else picture * seen[..., None]


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    """Sum of products in float64; numpy's pairwise sums do not depend on threads, a BLAS may."""
    return float(np.multiply(a, b).sum(dtype=np.float64))


def _error(picture: np.ndarray, target: np.ndarray, seen: np.ndarray | None) -> float:
    """Mean square of what the screen shows, at least `MIN_ERROR`."""
    left = _where_seen(np.clip(picture, 0, 1) - target, seen)
    return max(float(np.square(left).mean(dtype=np.float64)), MIN_ERROR)
