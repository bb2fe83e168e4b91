"""Dense optical flow between consecutive supervised frames by OpenCV's DIS, both ways, with its consistency masks.

DIS loses pictures that shift by more than a tenth of their width. Where forward and backward flow disagree on much of a pair, as in
a fast pan, it is looked for once more after the second picture was brought over the first one by a homography of matched
features; every pixel takes the one of the two that explains its grey levels better, so that objects that move along keep their
flow.

DIS goes from coarse to fine: a thing that moves by more than half its size against its surroundings is blurred away before the
search could reach it, and gets their flow, in both directions alike. That flow misses the grey levels where the thing was and
where it went. There the second picture is laid over the first by the motion of the surroundings, and every shift of what is left
over is compared (`_find_lost`); DIS runs once more from the best one.
"""

from __future__ import annotations

import math
import os
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage

from ..errors import F4xError
from ..geometry.arrays import evenly_spaced
from ..native.library import open_library
from ..native.maps import F4X_SAMPLE_MAP, SAMPLES
from ..parallel import in_threads
from ..progress import Progress
from .config import PriorsConfig

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

FEATURELESS = 4.0
"""Grey-level gradient (standard deviation over 7 px) at which flow is trusted half."""
GRAIN = 2.5
"""Pixels over which grey levels change by their standard deviation: what makes of a slope a spread that `FEATURELESS` is about."""
MIN_CONSISTENT = 0.85
"""With a smaller consistent fraction of its pixels a pair of pictures is looked at once more. Ordinary pairs of the real clips have
.88 and more, pairs of fast pans .3 to .8."""
FEATURES, FEATURE_RATIO, MIN_MATCHES = 2000, 0.8, 20
"""SIFT features per picture, Lowe's ratio, and inliers that a homography between two pictures needs."""
EXPLAINED_WINDOW = 7
"""Side in pixels of the window in which two flows are compared."""
SLIP = 0.5
"""Pixels that flow may err by: what that does to grey levels is no sign of another motion."""
MISSED = 8.0
"""Mean grey levels, beyond those of `SLIP`, by which flow misses what it has lost; noise of pictures stays below half of it."""
COARSE = 2
"""Shifts are compared in pictures smaller by this factor."""
REACH, KNOWN_SHIFT = 0.1, 4
"""Longest shift against the surroundings, as a fraction of the longer side, and one (small pixels) below which flow
itself finds what is large enough."""
ALIKE = 12.0
"""Grey levels, beyond those of `SLIP`, by which a thing no longer looks like itself in the next picture."""
MIN_LOST = 0.0005
"""Fraction of the picture that must be explained anew; a moving region has twice as much (`motion.MIN_AREA_FRACTION`)."""
MAX_LOST, MAX_COMPARED = 4, 400
"""Regions of a picture that are looked at, the largest first, and pixels of one whose shifts are compared."""
RING, MARGIN = 4, 16
"""Small pixels around a region that tell how its surroundings move, and pixels around it in which flow is made anew."""
Flow = Callable[[np.ndarray, np.ndarray], np.ndarray]


def dis(preset: str, refine_iterations: int) -> Flow:
    """Return a function (grey (H,W) uint8, grey (H,W) uint8) -> flow (H,W,2) float32, pixels; F4xError: unknown preset."""
    import cv2

    presets = {
        "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
        "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
        "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
        "fine": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
    }
    if preset not in presets:
        raise F4xError(f"There is no flow preset '{preset}'; choose one of: {', '.join(presets)}.")
    engines = threading.local()  # an engine keeps buffers of the pair that it works on

    def flow(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        if getattr(engines, "shape", None) != first.shape:  # for a small picture an engine lowers its scales for good
            engines.shape = first.shape
            engines.own = cv2.DISOpticalFlow.create(presets[preset])
            if preset == "fine":  # the presets stop at half resolution
                engines.own.setFinestScale(0)
                engines.own.setPatchStride(4)
            engines.own.setVariationalRefinementIterations(refine_iterations)
        return engines.own.calc(first, second, None)

    return flow


def grey(frames: np.ndarray) -> np.ndarray:
    """Return (F,H,W,3) uint8 RGB to (F,H,W) uint8."""
    import cv2

    return np.stack([cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames])


def sample(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Sample `image` (H,W) or (H,W,C) bilinearly at `points` (...,2) in pixels (centres at +0.5), border repeated.

    The result is float64 for a float16 or float32 image where the library is compiled, else of the more precise of both dtypes.
    """
    if image.dtype.name not in ("float16", "float32") or image.ndim > 3 or open_library()[0] is None:
        return _plain_sample(image, points)
    height, width = image.shape[:2]
    pixels = np.ascontiguousarray(image).reshape(height, width, -1)
    at = np.ascontiguousarray(points, np.float64).reshape(-1, 2)
    sizes = {"count": len(at), "width": width, "height": height, "channels": pixels.shape[2]}
    values = np.empty((len(at), pixels.shape[2]))
    F4X_SAMPLE_MAP(
        SAMPLES(**sizes, **{"halves" if image.itemsize == 2 else "floats": pixels}, points=at, values=values)
    )
    return values.reshape(*points.shape[:-1], *image.shape[2:])


def _plain_sample(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    height, width = image.shape[:2]
    x = np.clip(points[..., 0] - 0.5, 0, width - 1)
    y = np.clip(points[..., 1] - 0.5, 0, height - 1)
    column, row = np.minimum(x.astype(np.intp), max(width - 2, 0)), np.minimum(y.astype(np.intp), max(height - 2, 0))
    u, v = x - column, y - row
    if image.ndim == 3:
        u, v = u[..., None], v[..., None]
    right, below = np.minimum(column + 1, width - 1), np.minimum(row + 1, height - 1)
    top = image[row, column] * (1 - u) + image[row, right] * u
    bottom = image[below, column] * (1 - u) + image[below, right] * u
    return top * (1 - v) + bottom * v


@lru_cache(4)
def pixel_grid(height: int, width: int) -> np.ndarray:
    """Return (H,W,2) float32 pixel centres (x, y), not to be written to."""
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    grid = np.stack([columns, rows], -1).astype(np.float32)
    grid.setflags(write=False)
    return grid


def look_up(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return `image` (H,W[,C]) float32 at `points` (h,w,2) in pixels (centres at +0.5), border repeated: a faster `sample`."""
    import cv2

    target = (points - 0.5).astype(np.float32, copy=False)  # OpenCV counts from pixel centres
    return cv2.remap(image, target[..., 0], target[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def warp(image: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return `image` (H,W[,C]) float32 looked up at p + flow(p), border repeated."""
    return look_up(image, pixel_grid(*flow.shape[:2]) + flow)


def length(vectors: np.ndarray) -> np.ndarray:
    """Return (...,2) -> (...): Euclidean length, several times faster than `np.linalg.norm` over so short an axis."""
    return np.hypot(vectors[..., 0], vectors[..., 1])


def inside(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return (...,2) -> (...) bool: within the picture, its edges included."""
    x, y = points[..., 0], points[..., 1]
    return (x >= 0) & (y >= 0) & (x <= width) & (y <= height)


def consistent(there: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: |f(p) + b(p+f)| < 0.5 (|f| + |b|) + 0.5 px (MoSca's test), and p + f inside the picture."""
    return agree(pixel_grid(*there.shape[:2]), there, warp(back, there), *there.shape[:2])


def consistent_at(points: np.ndarray, there: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return the same test at `points` (...,2) with flow `there` (...,2), against the dense flow `back` (H,W,2)."""
    return agree(points, there, sample(back, points + there), *back.shape[:2])


def agree(points: np.ndarray, there: np.ndarray, returned: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return (...) bool: the same test of flow `there` (...,2) at `points` (...,2) and the flow `returned` (...,2) from there."""
    close = length(there + returned) < 0.5 * (length(there) + length(returned)) + 0.5
    return close & inside(points + there, height, width)


def texture(picture: np.ndarray) -> np.ndarray:
    """Return (H,W) in 0..1: how well flow holds on to a grey `picture` (H,W), by the standard deviation of its levels over 7 px."""
    values = picture.astype(np.float32)
    mean = ndimage.uniform_filter(values, 7)
    spread = np.sqrt(np.maximum(ndimage.uniform_filter(values**2, 7) - mean**2, 0))
    return spread**2 / (spread**2 + FEATURELESS**2)


def texture_along(picture: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return (h,w) in 0..1: the texture of `picture` (H,W) grey that flow needs along `direction` (h,w,2) on every (H/h)-th pixel.

    Along a line on the road there is none, however sharp the line is. `direction` may have any length.
    """
    import cv2

    values, step = picture.astype(np.float32), picture.shape[0] // direction.shape[0]
    slope = [cv2.Scharr(values, cv2.CV_32F, *axis) / 32 for axis in ((1, 0), (0, 1))]  # grey levels per pixel
    products = (slope[0] ** 2, slope[0] * slope[1], slope[1] ** 2)
    xx, xy, yy = (ndimage.uniform_filter(one, 7)[step // 2 :: step, step // 2 :: step] for one in products)
    x, y = np.moveaxis(direction / np.maximum(length(direction), 1e-12)[..., None], -1, 0)
    spread = GRAIN**2 * np.maximum(x * x * xx + 2 * x * y * xy + y * y * yy, 0)
    return spread / (spread + FEATURELESS**2)


def best_of_cells(held: np.ndarray, side: int, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column of the largest pixel of every square cell of `held` (H,W), `side` pixels wide, if above `least`."""
    rows, columns = (size // side for size in held.shape)
    cells = held[: rows * side, : columns * side].reshape(rows, side, columns, side).swapaxes(1, 2)
    cells = cells.reshape(rows, columns, side * side)
    row, column = np.nonzero(cells.max(2) > least)
    inner = cells[row, column].argmax(1)
    return row * side + inner // side, column * side + inner % side


def compose(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return flow a -> c from the flows a -> b and b -> c, all (H,W,2) float32."""
    return first + warp(second, first)


def long_flows(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> dict[int, np.ndarray]:
    """Return signed gap -> (F,H,W,2) float16 flows from frame t to t + gap (zeros where that frame does not exist).

    Gaps are powers of two up to the longest that `config` asks for, each chained from two half ones: with good flow at
    gap 1 that was as accurate as flow computed anew over the gap, at a twentieth of the time. They live in unnamed
    temporary files and, for later stages, in `priors.scratch`.
    """
    if priors.scratch.long_flows is not None:
        return priors.scratch.long_flows
    assert priors.flow_forward is not None and priors.flow_backward is not None
    frames = len(priors.frames)
    wanted = (1, *config.tracks.gaps, *config.motion.gaps)
    gaps = [2**power for power in range(max(wanted).bit_length())]
    if not set(wanted) <= set(gaps):
        raise F4xError(f"Every gap of the tracks and motion settings must be a power of two, got {wanted[1:]}.")
    flows: dict[int, np.ndarray] = {}
    for done, gap in enumerate(gaps):
        progress("long flows", done, len(gaps))
        for signed in (gap, -gap):
            flows[signed] = out = scratch_array((frames, priors.height, priors.width, 2))
            if gap == 1:
                out[slice(None, frames - 1) if signed > 0 else slice(1, None)] = (
                    priors.flow_forward if signed > 0 else priors.flow_backward
                )
                continue
            chain = partial(_chain, flows[signed // 2], signed // 2, out)  # exact: a power of two, either sign
            in_threads(chain, range(max(0, -signed), min(frames, frames - signed)))
    progress("long flows", len(gaps), len(gaps))
    priors.scratch.long_flows = flows
    return flows


def _chain(flows: np.ndarray, gap: int, out: np.ndarray, frame: int) -> None:
    """Write the flow of a frame over twice the `gap` of `flows` into `out`, both (F,H,W,2)."""
    out[frame] = compose(flows[frame].astype(np.float32), flows[frame + gap].astype(np.float32))


def scratch_array(shape: tuple[int, ...]) -> np.ndarray:
    """Return a float16 array of zeros in an unnamed temporary file: long clips would not fit into memory."""
    size = 2 * math.prod(shape)
    try:
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):  # else a disk that fills up later kills the process (SIGBUS)
                os.posix_fallocate(file.fileno(), 0, size)
            return np.memmap(file, np.float16, "w+", shape=shape)
    except OSError as error:
        raise F4xError(
            f"{tempfile.gettempdir()}: no room for {size >> 20} MiB of temporary flow ({error.strerror or error});"
            " free some, or set TMPDIR to another disk."
        ) from error


def provide(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill the four flow fields (provider `classical`)."""
    pictures, flow = grey(clip.frames[clip.supervised]), dis(config.flow.preset, config.flow.refine_iterations)
    pairs, height, width = len(pictures) - 1, *pictures.shape[1:]
    forward = np.zeros((pairs, height, width, 2), np.float16)
    backward = np.zeros_like(forward)
    masks = np.zeros((2, pairs, height, width), bool)

    def between(i: int) -> None:
        pair = pictures[i], pictures[i + 1]
        there, back = flow(*pair), flow(*pair[::-1])
        if (consistent(there, back).mean() + consistent(back, there).mean()) / 2 < MIN_CONSISTENT:
            there, back = _after_homography(*pair, flow, there, back)
        there, back = _find_lost(*pair, there, back, flow)
        masks[0, i], masks[1, i] = consistent(there, back), consistent(back, there)
        forward[i], backward[i] = there, back

    in_threads(between, range(pairs), lambda done: progress("flow", done, pairs))
    priors.flow_forward, priors.flow_backward = forward, backward
    priors.flow_forward_mask, priors.flow_backward_mask = masks


def _after_homography(
    first: np.ndarray, second: np.ndarray, flow: Flow, there: np.ndarray, back: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the flows `there` and `back` (H,W,2), replaced where flow after the background's homography is better."""
    homography = _homography(first, second)
    if homography is None:
        return there, back
    onward = _beyond(first, second, homography, flow)
    return _better(first, second, there, onward), _better(
        second, first, back, _beyond(second, first, np.linalg.inv(homography), flow)
    )


def _homography(first: np.ndarray, second: np.ndarray) -> np.ndarray | None:
    """Return (3,3) from the pixels of one picture to those of another by matched SIFT features; None where too few agree."""
    import cv2

    sift = cv2.SIFT.create(FEATURES)
    (points, words), (others, other_words) = (sift.detectAndCompute(picture, None) for picture in (first, second))
    if words is None or other_words is None or min(len(words), len(other_words)) < MIN_MATCHES:
        return None
    nearest = cv2.BFMatcher().knnMatch(words, other_words, k=2)
    sure = [two[0] for two in nearest if len(two) == 2 and two[0].distance < FEATURE_RATIO * two[1].distance]
    if len(sure) < MIN_MATCHES:
        return None
    cv2.setRNGSeed(0)  # the same pictures give the same flow
    here = np.array([points[match.queryIdx].pt for match in sure], np.float32)
    seen = np.array([others[match.trainIdx].pt for match in sure], np.float32)
    homography, inlier = cv2.findHomography(here, seen, cv2.USAC_MAGSAC, 2.0)
    return None if homography is None or inlier.sum() < MIN_MATCHES else homography


def _beyond(first: np.ndarray, second: np.ndarray, homography: np.ndarray, flow: Flow) -> np.ndarray:
    """Return (H,W,2) flow whose start is a homography between the pixels (centres at 0) of two pictures."""
    import cv2

    height, width = first.shape
    brought = cv2.warpPerspective(
        second,
        homography,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    grid = pixel_grid(height, width) - 0.5
    there = (grid + flow(first, brought)).reshape(-1, 1, 2).astype(np.float64)
    return (cv2.perspectiveTransform(there, homography).reshape(height, width, 2) - grid).astype(np.float32)


def _better(first: np.ndarray, second: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return (H,W,2) per pixel the flow that misses the grey levels around it by less; one that leaves the picture misses most."""
    missed = []
    for candidate in (one, other):
        error = abs(warp(second.astype(np.float32), candidate) - first)
        error[~inside(pixel_grid(*first.shape) + candidate, *first.shape)] = 255
        missed.append(ndimage.uniform_filter(error, EXPLAINED_WINDOW))
    return np.where((missed[1] < missed[0])[..., None], other, one)


@dataclass(frozen=True)
class _Shift:
    """Motion, in pixels (x, y), of the content of a box `low` to `high` of the first picture to the second, (2,) each."""

    motion: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def reversed(self) -> _Shift:
        """Return the same, seen from the second picture."""
        return _Shift(-self.motion, self.low + self.motion, self.high + self.motion)


def _find_lost(
    first: np.ndarray, second: np.ndarray, there: np.ndarray, back: np.ndarray, flow: Flow
) -> tuple[np.ndarray, np.ndarray]:
    """Return the flows `there` and `back` (H,W,2), replaced where something small moves that they miss."""
    missed_there, missed_back = _missed(first, second, there), _missed(second, first, back)
    shifts = _shifts(first, second, there, missed_there > MISSED)
    shifts += [shift.reversed() for shift in _shifts(second, first, back, missed_back > MISSED)]
    for shift in shifts:
        onward = _Anew.start(shift, first, second, missed_there, flow)
        backward = _Anew.start(shift.reversed(), second, first, missed_back, flow)
        if onward is None or backward is None:
            continue
        # What one direction finds is the other's, too.
        onward.replace(there, missed_there, onward.thing | _moved(backward.thing, shift.motion, first.shape))
        backward.replace(back, missed_back, backward.thing | _moved(onward.thing, -shift.motion, first.shape))
    return there, back


def _slip(picture: np.ndarray) -> np.ndarray:
    """Return (h,w) grey levels by which a `picture` (h,w) float32 changes over `SLIP` pixels."""
    import cv2

    return SLIP * cv2.magnitude(*(cv2.Scharr(picture, cv2.CV_32F, *axis) / 32 for axis in ((1, 0), (0, 1))))


def _missed(first: np.ndarray, second: np.ndarray, there: np.ndarray, low: Any = (0, 0)) -> np.ndarray:
    """Return (h,w) mean grey levels by which flow `there` (h,w,2) misses `second` (H,W); `first` (h,w) begins at pixel `low`."""
    import cv2

    target, own = pixel_grid(*first.shape) + np.float32(low) + there, first.astype(np.float32)
    error = np.maximum(abs(look_up(second.astype(np.float32), target) - own) - _slip(own), 0)
    error[~inside(target, *second.shape)] = 0  # what leaves the picture cannot be found
    return cv2.blur(error, (EXPLAINED_WINDOW, EXPLAINED_WINDOW))


def _shifts(first: np.ndarray, second: np.ndarray, there: np.ndarray, lost: np.ndarray) -> list[_Shift]:
    """Return the probable motions of the largest regions of `lost` (H,W) bool."""
    import cv2

    size = first.shape[1] // COARSE, first.shape[0] // COARSE
    region = cv2.resize(lost.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    if not region.any():
        return []
    small, other = (cv2.resize(one, size, interpolation=cv2.INTER_AREA).astype(np.float32) for one in (first, second))
    coarse = there[COARSE // 2 :: COARSE, COARSE // 2 :: COARSE][: size[1], : size[0]] / COARSE
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(_closed(region))
    area, found = statistics[:, cv2.CC_STAT_AREA] * (np.arange(len(statistics)) > 0), []
    for label in np.argsort(-area, kind="stable")[:MAX_LOST]:
        if area[label] < MIN_LOST * region.size:
            break
        low, reach = statistics[label, :2], round(REACH * max(size))
        high = low + statistics[label, 2:4]
        x, y = np.maximum(low - reach // 2, 0)
        box = np.s_[y : high[1] + reach // 2, x : high[0] + reach // 2]
        own = labels[box] == label
        around = (cv2.dilate(own.astype(np.uint8), np.ones((2 * RING + 1,) * 2)) > 0) & (labels[box] == 0)
        if not around.any():  # nothing but what is lost
            continue
        usual = np.median(coarse[box][around], axis=0)
        aligned = _moved(other, usual + np.array((x, y)), small[box].shape)
        shift = _best_shift(small[box], aligned, own, reach)
        if shift is not None:
            found.append(_Shift(COARSE * (usual + shift), COARSE * low - MARGIN, COARSE * high + MARGIN))
    return found


def _closed(region: np.ndarray) -> np.ndarray:
    """Return (h,w) uint8 of bool, holes and gaps of up to four pixels filled."""
    import cv2

    return cv2.morphologyEx(region.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))


def _moved(picture: np.ndarray, by: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return `picture` (H,W) looked up at p + `by` (x, y) for the pixels of `shape` (h,w), border repeated."""
    import cv2

    move = np.array([[1, 0, by[0]], [0, 1, by[1]]], np.float64)
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(picture, move, shape[::-1], flags=how, borderMode=cv2.BORDER_REPLICATE)


def _best_shift(picture: np.ndarray, aligned: np.ndarray, region: np.ndarray, reach: int) -> np.ndarray | None:
    """Return (2,) whole pixels up to `reach` that bring most of what is left over at a `region` (h,w) onto what is left over.

    `aligned` (h,w) is the other picture laid over `picture` (h,w) by the motion of the surroundings. Where a thing was and
    where it goes the two differ, and nowhere else. None: nothing is left over, or it hardly moves (`KNOWN_SHIFT`).
    """
    import cv2

    slip = _slip(picture)
    left = _closed(cv2.blur(np.maximum(abs(aligned - picture) - slip, 0), (3, 3)) > MISSED)
    _, labels = cv2.connectedComponents(left | region)
    y, x = np.nonzero((left > 0) & np.isin(labels, np.unique(labels[region])))
    if len(y) == 0:
        return None
    chosen = evenly_spaced(len(y), min(MAX_COMPARED, len(y)))
    y, x = y[chosen], x[chosen]
    others = np.pad(np.where(left > 0, aligned, np.inf).astype(np.float32), reach, constant_values=np.inf)
    side = 2 * reach + 1
    error = np.lib.stride_tricks.sliding_window_view(others, (side, side))[y, x].reshape(len(y), -1)
    error -= picture[y, x][:, None]
    np.abs(error, out=error)
    error -= slip[y, x][:, None]
    row, column = divmod(int(np.clip(error, 0, ALIKE, out=error).sum(0).argmin()), side)
    best = np.array([column, row]) - reach
    return best if abs(best).max() >= KNOWN_SHIFT else None


@dataclass(frozen=True)
class _Anew:
    """Flow that starts from a shift, in a box of the picture."""

    box: tuple[slice, slice]
    onward: np.ndarray
    """(h,w,2) pixels."""
    missed: np.ndarray
    """(h,w) grey levels by which it misses."""
    thing: np.ndarray
    """(H,W) uint8: what it explains and the flow before it did not, with what that encloses; empty where that is too little."""

    @classmethod
    def start(
        cls, shift: _Shift, first: np.ndarray, second: np.ndarray, missed: np.ndarray, flow: Flow
    ) -> _Anew | None:
        """Find the flow of a box anew from `shift`; None where too little of it is left in the picture.

        `missed` (H,W): by how much the flow so far misses the second picture.
        """
        import cv2

        ends = [np.clip(np.round(corner), 0, first.shape[::-1]).astype(int) for corner in (shift.low, shift.high)]
        if (ends[1] - ends[0] < 2 * MARGIN).any():
            return None
        box = np.s_[ends[0][1] : ends[1][1], ends[0][0] : ends[1][0]]
        own = np.ascontiguousarray(first[box])
        finer = flow(own, _moved(second, shift.motion + ends[0], own.shape)) * texture(own)[..., None]
        onward = shift.motion.astype(np.float32) + finer  # a plain side goes with its rim
        after, thing = _missed(own, second, onward, ends[0]), np.zeros(first.shape, np.uint8)
        explained = (after < MISSED / 2) & (missed[box] - after > MISSED / 2)
        if explained.sum() >= MIN_LOST * first.size:
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (MARGIN + 1, MARGIN + 1))
            padded = np.pad(explained, MARGIN).astype(np.uint8)
            thing[box] = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc)[MARGIN:-MARGIN, MARGIN:-MARGIN]
        return cls(box, onward, after, thing)

    def replace(self, flow: np.ndarray, missed: np.ndarray, thing: np.ndarray) -> None:
        """Write this flow into `flow` (H,W,2) on the `thing` (H,W), and at its rim where it is better; so `missed` (H,W)."""
        import cv2

        rim = cv2.dilate(thing[self.box], np.ones((EXPLAINED_WINDOW, EXPLAINED_WINDOW), np.uint8)) > 0
        better = rim & (self.missed < missed[self.box])
        taken = better | ((thing[self.box] > 0) & (self.missed < MISSED / 2))
        flow[self.box][taken], missed[self.box][taken] = self.onward[taken], self.missed[taken]
