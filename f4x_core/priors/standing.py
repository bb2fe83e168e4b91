"""Measures whether the camera stands, from points that are looked for again in far frames.

Chained tracks drift (1.9 pixels over 200 frames), so in a clip of ten seconds they cannot tell a tripod from a slow dolly. A
point that is looked for where it was does not drift. Points found again either shift with the whole picture, as far as a turn
of the camera explains, or show parallax or their own motion. Nothing is solved, and no more than the pictures is held in
memory: a clip of 287 frames takes two seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..parallel import in_threads
from .motion import REFERENCE_WIDTH
from .sfm import bearings, rotation_between

SAMPLED_FRAMES = 24
"""Frames that are compared, each with the first, the middle and the last of them."""
MAX_POINTS, QUALITY, APART_PX = 1000, 0.005, 8.0
"""Corners of a picture that are looked for again, the weakest of them against the strongest, and their distance."""
WINDOW_PX, MIN_WINDOW, RETURN_PX = 21, 5, 0.7
"""Side of the window that is compared, in a small picture at least the second; a point is found when looking back ends this
close to the start."""
STILL_PX = 0.75
"""A point stands when it is found within this distance of where the turn of the whole picture puts it."""
MIN_STANDING, MIN_COVERED, MAX_JITTER_PX = 0.5, 0.3, 3.0
"""The camera stands when, in nine of ten pairs of frames, at least the first fraction of the points that are found again stands,
standing points hold the second fraction of the tiles of the picture, and the picture shifts by no more than the third.
Four clips of a standing camera have .93 and .57 and more, breakdance among a crowd that sways .68 and .38; rendered dollies of 5,
15 and 40 cm at 5 m .34, .08 and .00, and .20, .05 and .00; eleven hand-held clips at most .20 and .18."""
TILES, MIN_TILE_POINTS, TILE_FRACTION = (8, 5), 3, 0.3
"""Columns and rows of tiles, the points that a tile needs to count, and the fraction of them that stands in one that holds."""
MIN_FOUND = 50
"""A pair of frames in which fewer points are found again tells nothing."""
NOISE_PX = 0.15
"""Jitter (rms) up to which the camera is held exactly still: what the measurement itself errs by."""

ReadPicture = Callable[[int], np.ndarray]
"""Number of a frame -> its grey picture (H,W) uint8."""


@dataclass(frozen=True)
class Standing:
    """Measurements of how still the camera stands. Pixels are those of the pictures."""

    standing: float
    """Fraction of the points found again that stand, in the worst of ten pairs of frames."""
    covered: float
    """Fraction of the picture's tiles that standing points hold, likewise."""
    jitter: float
    """Pixels by which the picture shifts between two frames, in nine of ten pairs."""
    limit: float
    """Pixels of jitter up to which the camera stands."""

    @property
    def stands(self) -> bool:
        """True where the camera stands."""
        return self.standing >= MIN_STANDING and self.covered >= MIN_COVERED and self.jitter <= self.limit

    def summary(self) -> dict[str, Any]:
        """Return plain values for the statistics of the priors."""
        jitter = round(self.jitter, 3) if np.isfinite(self.jitter) else None
        fractions = {"standing": round(self.standing, 3), "covered": round(self.covered, 3)}
        return {"stands": self.stands, "jitter_px": jitter} | fractions


class StillnessTest:
    """Compares frames of a clip with a few reference frames of it."""

    def __init__(self, read: ReadPicture, frames: int, focal: float) -> None:
        """Find corners in the reference frames; `focal` in pixels hardly matters for shifts of few pixels."""
        import cv2

        self.read, self.frames, self.focal = read, frames, focal
        self.sampled = evenly_spaced(frames, SAMPLED_FRAMES)
        self.references = sorted({int(self.sampled[i]) for i in (0, len(self.sampled) // 2, -1)})
        self.pictures = {frame: read(frame) for frame in self.references}
        self.height, self.width = self.pictures[self.references[0]].shape
        self.unit = max(self.height, self.width) / REFERENCE_WIDTH
        self.points = {}
        for frame, picture in self.pictures.items():
            found = cv2.goodFeaturesToTrack(picture, MAX_POINTS, QUALITY, APART_PX * self.unit)
            self.points[frame] = np.zeros((0, 2), np.float32) if found is None else found[:, 0]

    def measure(self, report: Callable[[int], None] | None = None) -> Standing:
        """Compare the sampled frames with the references; points that mostly move are not looked for by `turns`.

        `report` is called with the number of comparisons done.
        """
        pairs = [(one, int(frame)) for one in self.references for frame in self.sampled if frame != one]
        if not pairs:
            return Standing(0.0, 0.0, np.inf, 0.0)
        found = in_threads(lambda pair: self._compare(*pair), pairs, report)
        for reference in self.references:
            votes = [one for one, (start, _) in zip(found, pairs, strict=True) if start == reference]
            stood, seen = np.sum([(one.stands, one.found & one.counts) for one in votes], axis=0)
            self.points[reference] = self.points[reference][2 * stood > np.maximum(seen, 1)]
        rows = np.array([(one.fraction, one.covered, one.shift) for one in found])
        standing, covered = np.percentile(rows[:, :2], 10, axis=0)
        jitter = np.sort(rows[:, 2])[9 * (len(rows) - 1) // 10]  # some are infinite
        return Standing(float(standing), float(covered), float(jitter), MAX_JITTER_PX * self.unit)

    def turns(self, report: Callable[[int], None] | None = None) -> np.ndarray:
        """Return (F, 3, 3) rotations from the axes of the first frame; exactly 1 where the jitter is noise.

        `report` is called with the number of frames done.
        """
        middle = self.references[len(self.references) // 2]
        start = {one: self._turn(middle, one) for one in self.references}

        def turn(frame: int) -> np.ndarray:
            nearest = min(self.references, key=lambda one: abs(one - frame))
            return self._turn(nearest, frame) @ start[nearest]

        found = np.stack(in_threads(turn, range(self.frames), report))
        shift = self.focal * (found - found.mean(0))[:, :2, 2]
        if float(np.sqrt((shift**2).sum(1).mean())) < NOISE_PX * self.unit:
            return np.tile(np.eye(3), (self.frames, 1, 1))
        turns = found @ found[0].T
        turns[0] = np.eye(3)
        return turns

    def _find(self, reference: int, frame: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the places `(n, 2)` of points of a reference in another frame, and whether they are found there `(n,)`."""
        import cv2

        if not len(points):
            return points, np.zeros(0, bool)
        side = max(2 * round((WINDOW_PX * self.unit - 1) / 2) + 1, MIN_WINDOW)
        before, after = self.pictures[reference], self.read(frame)

        def look(start: np.ndarray, end: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            there, found, _ = cv2.calcOpticalFlowPyrLK(start, end, places, None, winSize=(side, side), maxLevel=3)
            return there, found

        there, ahead = look(before, after, points)
        back, behind = look(after, before, there)
        close = np.linalg.norm(back - points, axis=1) < RETURN_PX * self.unit
        return there, (ahead[:, 0] > 0) & (behind[:, 0] > 0) & close

    def _rotation(self, here: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the turn that takes places `here (n, 2)` to `there (n, 2)`, and what it misses them by `(n,)` pixels."""
        middle = np.array([self.width, self.height]) / 2
        a, b = (bearings(uv.astype(np.float64), self.focal, middle) for uv in (here, there))
        return rotation_between(a, b, self.focal)

    def _compare(self, reference: int, frame: int) -> _Comparison:
        """Look for the points of a reference in another frame."""
        points = self.points[reference]
        there, found = self._find(reference, frame, points)
        stands = np.zeros(len(points), bool)
        if found.sum() < MIN_FOUND:
            return _Comparison(found, stands, 0.0, np.inf)
        stands[found] = self._rotation(points[found], there[found])[1] < STILL_PX * self.unit
        column, row = np.clip(points / (self.width, self.height) * TILES, 0, np.array(TILES) - 1).astype(int).T
        tile = row * TILES[0] + column
        every, held = (np.bincount(tile[some], minlength=TILES[0] * TILES[1]) for some in (slice(None), stands))
        counts = every >= MIN_TILE_POINTS
        covered = float((held >= TILE_FRACTION * every)[counts].mean()) if counts.any() else 0.0
        shift = np.linalg.norm(there[stands] - points[stands], axis=1)
        return _Comparison(found, stands, covered, float(np.median(shift)) if len(shift) else np.inf)

    def _turn(self, reference: int, frame: int) -> np.ndarray:
        """Return the rotation (3, 3) from the axes of a reference to those of another frame; 1 where too few points are found."""
        points = self.points[reference]
        there, found = self._find(reference, frame, points)
        if frame == reference or found.sum() < MIN_FOUND // 2:
            return np.eye(3)
        return self._rotation(points[found], there[found])[0]


@dataclass(frozen=True)
class _Comparison:
    """A reference and another frame; n points of the reference."""

    found: np.ndarray
    """(n,) bool: found again."""
    stands: np.ndarray
    """(n,) bool: where the turn of the whole picture puts them."""
    covered: float
    """Fraction of the tiles that standing points hold."""
    shift: float
    """Pixels by which they shift, median."""

    @property
    def counts(self) -> bool:
        """True where enough points are found to tell anything."""
        return self.found.sum() >= MIN_FOUND

    @property
    def fraction(self) -> float:
        """Fraction of the points found again that stand; 0 where it tells nothing."""
        return float(self.stands.sum() / self.found.sum()) if self.counts else 0.0
