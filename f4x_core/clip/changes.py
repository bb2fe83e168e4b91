"""Finds hard cuts and changes of brightness in a clip, from its frames at low resolution."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, product, repeat

import numpy as np

COLUMNS = 48
"""Cells across of the small pictures."""
SHIFT = 4
"""Cells by which the picture may move from one frame to the next, in any direction."""
DIFFERENT = 0.7
"""Thumbnails that correlate less than this at every shift show different scenes. Measured on six clips: neighbouring frames
correlate by 0.95 or more, frames of different places by 0.66 or less."""
AROUND = 3
"""Frames compared on either side of a cut: the one next to it may be blurred by a jerk of the camera."""
FLAT = 0.5
"""Standard deviation of the cells (of 255) below which a picture shows nothing to compare."""
DARK = 4.0
"""Brightness (of 255) added before a ratio is taken, so that black cells have no influence."""

FEATURE_WIDTH = 320
"""Pixels across of the pictures whose SIFT features confirm or refute a suspected cut."""
MAX_FEATURES = 800
"""SIFT features per picture; more cost time and decide nothing."""
MIN_CONTRAST = 0.02
"""Half of OpenCV's threshold: pictures blurred by a jerk have faint features."""
MAX_RATIO = 0.8
"""Lowe's ratio test: distance to the nearest descriptor against that to the second nearest."""
MATCH_PIXELS = 6.0
"""Matches agree on one shift, turn and zoom to within so many pixels: what is near shifts more than what is far."""
MAX_ZOOM = 2.0
"""Largest zoom, in or out, from one frame to the next."""
BLOCK = 20
"""Matches are counted once per square of so many pixels: a logo in the corner of two shots fills few of them."""
MIN_BLOCKS = 6
"""Squares with agreeing matches that two views of one place have at least. Measured on six clips: 985 pairs of pictures of
different places have at most 4, sharp pictures of one clip up to 16 frames apart at least 15."""


@dataclass(frozen=True, eq=False)
class Changes:
    """Cuts and brightness of a clip of T frames."""

    cuts: np.ndarray
    """(C,) int64 first frames of the shots after the first."""
    gain: np.ndarray
    """(T,) float64 brightness relative to the first frame of the shot, of the same things in both."""

    @property
    def exposure(self) -> float:
        """Brightest over darkest `gain` within one shot, at least 1."""
        shots = np.split(self.gain, self.cuts)
        return max(float(shot.max() / shot.min()) for shot in shots)


def find_changes(frames: Iterable[np.ndarray]) -> Changes:
    """Return cuts and brightness of `frames (T, H, W, 3)` uint8, or of frames that come one at a time.

    Thumbnails of neighbouring frames are compared at the shift at which they fit best. Two frames belong to one shot when
    their thumbnails correlate (whatever the exposure) or when matched features show the same place. A cut lies between t - 1
    and t when no frame shortly before belongs to one shot with any frame shortly after, while t - 1 and t each belong to one
    shot with another frame on their own side; a blurred, flashing or damaged frame belongs to no shot and makes no cut.
    Brightness is the median ratio of the thumbnails' cells. Only one frame and a few thumbnails are in memory at a time.
    """
    cuts: list[int] = []
    ratios = [0.0]  # [t] = t - 1 against t
    for t, (before, after) in enumerate(_surroundings(_View(frame) for frame in frames), 1):
        likeness, ratio = _match(before[-1].cells, after[0].cells)
        ratios.append(ratio)
        if (
            likeness < DIFFERENT
            and not any(_one_shot(a, b) for a, b in product(before, after))
            and _known(before[::-1])
            and _known(after)
        ):
            cuts.append(t)
    steps, starts = np.array(ratios), np.zeros(len(ratios), np.int64)
    steps[cuts], starts[cuts] = 0.0, cuts
    total = np.cumsum(steps)
    return Changes(np.array(cuts, np.int64), np.exp(total - total[np.maximum.accumulate(starts)]))


class _View:
    """Thumbnail and features of one frame (H, W, 3) uint8; the frame itself is not kept."""

    def __init__(self, frame: np.ndarray) -> None:
        import cv2

        height, width = frame.shape[:2]
        size = (FEATURE_WIDTH, max(1, round(height * FEATURE_WIDTH / width)))
        self.cells = _cells(frame)
        self.grey = cv2.cvtColor(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)

    @cached_property
    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """SIFT key points (K,2) in pixels of a picture `FEATURE_WIDTH` wide and descriptors (K,128), both float32."""
        import cv2

        sift = cv2.SIFT.create(MAX_FEATURES, contrastThreshold=MIN_CONTRAST)
        found, descriptors = sift.detectAndCompute(self.grey, None)  # type: ignore[call-overload]
        points = np.array([point.pt for point in found], np.float32).reshape(-1, 2)
        return points, np.zeros((0, 128), np.float32) if descriptors is None else descriptors


def _surroundings(views: Iterable[_View]) -> Iterator[tuple[list[_View], list[_View]]]:
    """Yield for every view but the first the at most `AROUND` ones before it, and as many from it on."""
    latest: deque[_View | None] = deque([None] * 2 * AROUND, maxlen=2 * AROUND)
    for view in chain(views, repeat(None, AROUND - 1)):
        latest.append(view)
        before, after = list(latest)[:AROUND], list(latest)[AROUND:]
        if before[-1] is not None and after[0] is not None:
            yield [view for view in before if view], [view for view in after if view]


def _known(side: list[_View]) -> bool:
    """Return True if the first view belongs to one shot with another view of the list, or is the only one."""
    return len(side) == 1 or any(_one_shot(side[0], other) for other in side[1:])


def _one_shot(a: _View, b: _View) -> bool:
    """Return True if two views look alike or show one place."""
    return _match(a.cells, b.cells)[0] >= DIFFERENT or _same_place(a, b)


def _same_place(a: _View, b: _View) -> bool:
    """Return True if features over much of the image match under one similarity (shift, rotation and zoom)."""
    import cv2

    (points, descriptors), (other_points, other_descriptors) = a.features, b.features
    if min(len(points), len(other_points)) < MIN_BLOCKS:
        return False
    nearest = cv2.BFMatcher().knnMatch(descriptors, other_descriptors, 2)
    back = [match.trainIdx for match in cv2.BFMatcher().match(other_descriptors, descriptors)]
    good = [
        best
        for best, second in nearest
        if best.distance < MAX_RATIO * second.distance and back[best.trainIdx] == best.queryIdx
    ]
    if len(good) < MIN_BLOCKS:
        return False
    here = points[[match.queryIdx for match in good]]
    there = other_points[[match.trainIdx for match in good]]
    motion, agree = cv2.estimateAffinePartial2D(here, there, method=cv2.RANSAC, ransacReprojThreshold=MATCH_PIXELS)
    if motion is None or not 1 / MAX_ZOOM < np.hypot(motion[0, 0], motion[1, 0]) < MAX_ZOOM:
        return False
    inliers = agree.ravel() > 0
    blocks = [len(np.unique(place[inliers] // BLOCK, axis=0)) for place in (here, there)]
    return min(blocks) >= MIN_BLOCKS


def _cells(frame: np.ndarray) -> np.ndarray:
    """Return (h, w) float64 mean brightness (of 255) of square cells of a frame (H, W, 3), softened so that half a cell of motion
    does not matter; rims that fill no cell are left out."""
    height, width = frame.shape[:2]
    side = max(1, round(width / COLUMNS))
    rows, columns = max(1, height // side), width // side
    kept = frame[: rows * side, : columns * side]
    cells = np.pad(kept.reshape(rows, -1, columns, side * 3).mean((1, 3), dtype=np.float64), 1, mode="edge")
    cells = (cells[:-2] + 2 * cells[1:-1] + cells[2:]) / 4
    return (cells[:, :-2] + 2 * cells[:, 1:-1] + cells[:, 2:]) / 4


def _match(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return the best correlation of two small pictures over all shifts, and the median log ratio of brightness b / a there."""
    tried: dict[tuple[int, int], float] = {}
    best, reach = (0, 0), range(-SHIFT, SHIFT + 1, 2)
    for places in (product(reach, repeat=2), product((-1, 0, 1), repeat=2)):  # every second one, then around the best
        for down, right in [(best[0] + y, best[1] + x) for y, x in places]:
            one, other = _overlap(a, down, right), _overlap(b, -down, -right)
            if one.size >= a.size / 2:
                tried[down, right] = _correlation(one, other)
        best = max(tried, key=lambda shift: tried[shift])
    one, other = _overlap(a, *best), _overlap(b, -best[0], -best[1])
    return tried[best], float(np.median(np.log((other + DARK) / (one + DARK))))


def _overlap(picture: np.ndarray, down: int, right: int) -> np.ndarray:
    """Return the part of a picture that another one, shifted by so many cells, covers."""
    rows, columns = picture.shape
    return picture[max(down, 0) : rows + min(down, 0), max(right, 0) : columns + min(right, 0)]


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return normalised correlation; two flat pictures are alike, a flat one and another are not."""
    a, b = a - a.mean(), b - b.mean()
    flat = a.std() < FLAT, b.std() < FLAT
    if any(flat):
        return float(all(flat))
    return float((a * b).mean() / (a.std() * b.std()))
