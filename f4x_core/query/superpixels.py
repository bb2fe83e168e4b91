"""The part of a picture that a click on something static means. Needs numpy alone.

A picture shows where a static thing ends more sharply than the Gaussians behind it. It is cut into superpixels, the basins of its
colour differences (a watershed). A random walk starts under the click and crosses borders the more easily the fainter they are
(Grady 2006). What is meant are the first superpixels in the order of the walk that have the strongest border around them, for a
thing of usual size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..clip.images import resize_nearest
from ..scene import Scene
from ..scene.view import render
from .blend_weights import lift_masks
from .kept import Kept
from .marks import Mark
from .pixels import head_map
from .segmentation import enlarge
from .select_config import SELECT, PictureConfig
from .smoothing import LOOKS_ALIKE, field_of_looks, solve

OPPONENT = np.array([[1 / 3, 1 / 3, 1 / 3], [1.5, -1.5, 0.0], [0.6, 0.6, -1.2]])
"""Light, red against green and yellow against blue of an sRGB colour: tints count more than in sRGB, as they do for the eye."""
TOLERANCE, STEPS = 1e-9, 2000
"""Of the conjugate gradients: far from the click scores are small, and their order counts."""


@dataclass(frozen=True)
class _Size:
    """Size of the object that marks mean, as a fraction of the picture."""

    usual: float
    """The likeliest size."""
    weight: float
    """Weight of the squared logarithm of another size (`PictureConfig.size`)."""
    most: float
    """The greatest one."""

    @classmethod
    def of_marks(cls, on: np.ndarray, config: PictureConfig) -> _Size:
        """Return the size that marks `on (H,W)` bool tell: none by a click; the box around several, or a stroke, is about as large.

        On six filmed clips five clicks find .58 of 38 things (.54 if they count for no size), a stroke .56.
        """
        rows, columns = np.nonzero(on)
        high, wide = np.ptp(rows) + 1, np.ptp(columns) + 1
        if max(high, wide) <= config.spread * on.shape[1]:
            return cls(config.usual, config.size, config.sizes[1])
        return cls(max(config.usual, float(high * wide / on.size)), config.spread_size, config.greatest)


@dataclass(frozen=True, eq=False)
class Superpixels:
    """Superpixels of a picture; P of them, with E pairs of neighbours."""

    label: np.ndarray
    """(H,W) int64: the superpixel of each pixel."""
    pairs: np.ndarray
    """(2,E) int64: neighbours, each pair once."""
    length: np.ndarray
    """(E,) float64: pixels along their common border; 0 for pairs with what moves, which says nothing of where a thing ends."""
    bond: np.ndarray
    """(E,) float64: the same, each pixel weighted by how faint the border is."""
    config: PictureConfig = SELECT.picture
    """The numbers that it was cut with."""

    def meant(self, on: Sequence[np.ndarray], beside: np.ndarray) -> np.ndarray:
        """Return the part (H,W) bool that all marks `on`, (H,W) bool each, mean and `beside (H,W)` bool does not.

        Empty where nothing is left.
        """
        count = int(self.label.max()) + 1
        starts = np.stack([np.bincount(self.label[mark], minlength=count) for mark in on]).astype(float)
        start, stop = starts.sum(0), np.bincount(self.label[beside], minlength=count).astype(float)
        free = (stop < self.config.marked * max(stop.max(), 1)) | (start >= stop)
        score = self._walk(start * free, free)
        order = np.flatnonzero(score > 0)[np.argsort(-score[score > 0], kind="stable")]
        if not len(order):
            return np.zeros(self.label.shape, bool)
        rank = np.full(count, len(order))
        rank[order] = np.arange(len(order))
        cut, length = (self._cut(rank, values)[: len(order)] for values in (self.bond, self.length))
        area = np.bincount(self.label.ravel())
        size = np.cumsum(area[order]) / self.label.size
        expected = _Size.of_marks(np.any(on, 0), self.config)
        held = (starts[:, order].cumsum(1) >= self.config.held * starts[:, order].sum(1, keepdims=True)).all(0)
        # An outline that movers hide altogether says nothing.
        faint = np.where(length > 0, np.maximum(cut, 1e-12) / np.maximum(length, 1), 1)
        worth = np.log(faint) + expected.weight * np.log(size / expected.usual) ** 2
        fits = held & (size >= self.config.sizes[0]) & (size <= expected.most)
        last = int(np.argmin(np.where(fits, worth, np.inf)) if fits.any() else np.argmax(held))
        under = (starts > self.config.held * area).any(0) & (start > stop)  # a stroke keeps what it covers
        return ((rank <= last) | under)[self.label]

    def _walk(self, start: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Return (P,): visits of walkers from `start (P,)` to a superpixel per bond; they end where not `free (P,)`."""
        if not start.any():
            return start
        ends = np.concatenate([self.pairs, self.pairs[::-1]], 1)
        bond = np.concatenate([self.bond, self.bond])
        degree = (1 + self.config.leak) * np.bincount(ends[0], bond, len(start)) + 1e-12
        held = bond * free[ends].all(0)

        def apply(x: np.ndarray) -> np.ndarray:
            return degree * x - np.bincount(ends[0], held * x[ends[1]], len(x))

        return solve(apply, degree, start, np.zeros(len(start)), STEPS, TOLERANCE)

    def _cut(self, rank: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the sums of `values (E,)` over pairs that part the first 1, 2, … superpixels by `rank (P,)` from the others."""
        first, last = np.sort(rank[self.pairs], 0)
        count = int(rank.max()) + 1
        return np.maximum(np.cumsum(np.bincount(first, values, count) - np.bincount(last, values, count)), 0)


_PICTURES: Kept[dict[int, Superpixels]] = Kept()


def static_part(
    scene: Scene, marks: Sequence[Mark], config: PictureConfig = SELECT.picture
) -> tuple[np.ndarray, np.ndarray]:
    """Return the fraction (N,) in [0, 1] of each Gaussian's blend weights in what `marks` mean, and their sum (N,) in pixels.

    On each frame that has marks on the thing the part of the picture that they mean together (`Superpixels.meant`).
    """
    size = (scene.cameras.height, scene.cameras.width)
    parts = {}
    for frame in sorted({mark.frame for mark in marks if mark.on}):
        picture = superpixels_of(scene, frame, config)
        height, width = picture.label.shape
        here = [(mark.on, resize_nearest(mark.pixels(size), width, height)) for mark in marks if mark.frame == frame]
        beside = np.any([np.zeros((height, width), bool), *(at for on, at in here if not on)], 0)
        parts[frame] = picture.meant([at for on, at in here if on], beside)
    return lift_masks(scene, parts)


def superpixels_of(
    scene: Scene, frame: int, config: PictureConfig = SELECT.picture, backend: str = "auto"
) -> Superpixels:
    """Return the superpixels of what clip `frame` shows of the scene; kept as long as the scene lives."""
    pictures = _PICTURES.get(scene, config, make=dict)
    if frame not in pictures:
        camera, time = scene.cameras[frame].of_width(config.columns), float(scene.cameras.times[frame])
        values = {"moving": scene.moving[:, None].astype(np.float32)}
        drawn = render(scene, camera, time, ("rgb",), backend, values=values)
        looks = None if field_of_looks(scene) is None else head_map(scene, LOOKS_ALIKE, camera, time, backend)
        pictures[frame] = cut_picture(drawn["rgb"], drawn["moving"][..., 0], looks, config)
    return pictures[frame]


def cut_picture(
    rgb: np.ndarray, moving: np.ndarray, looks: np.ndarray | None = None, config: PictureConfig = SELECT.picture
) -> Superpixels:
    """Cut a picture `rgb (H,W,3)` of which the fraction `moving (H,W)` moves, with features `looks (h,w,C)` or none."""
    colour = np.clip(rgb, 0, 1).astype(np.float64) @ OPPONENT.T
    label = basins(*_borders(colour, config.fine, config.noise))
    area = np.bincount(label.ravel()).astype(float)
    pairs, strength, length = _neighbours(label, *_borders(colour, config.coarse, config.noise))
    shows = np.bincount(label.ravel(), moving.ravel()) <= config.hidden * area
    length *= shows[pairs].all(0)
    shared = np.minimum(*_histograms(colour, label, config.bins)[pairs]).sum(1)
    unlike = strength / config.faint + (1 - shared) / config.alike
    if looks is not None:
        fine = np.stack([enlarge(channel, (len(label), label.shape[1])) for channel in np.moveaxis(looks, -1, 0)], -1)
        mean = np.stack([np.bincount(label.ravel(), channel.ravel()) for channel in np.moveaxis(fine, -1, 0)], 1)
        mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
        one, two = mean[pairs]
        unlike += (1 - np.einsum("ec,ec->e", one, two)) / config.looks
    return Superpixels(label, pairs, length, length * np.exp(-unlike), config)


def basins(across: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Return (H,W) int64, from 0: pixels that run down into the same lowest place of the strengths of borders around them.

    `across (H,W-1)`, `down (H-1,W)`: strengths between neighbours.
    """
    height, width = len(across), down.shape[1]
    steep = np.zeros((height, width))
    steep[:, 1:] += across
    steep[:, :-1] += across
    steep[1:] += down
    steep[:-1] += down
    steep = _box(steep[..., None], (-1, 1), (-1, 1))[..., 0]
    number = np.arange(steep.size).reshape(steep.shape)
    steep = steep + 1e-9 * number / steep.size  # no plains
    lowest, to = steep, number
    high, name = np.pad(steep, 1, constant_values=np.inf), np.pad(number, 1)
    for y, x in np.ndindex(3, 3):
        here = (slice(y, y + height), slice(x, x + width))
        lower = high[here] < lowest
        lowest, to = np.where(lower, high[here], lowest), np.where(lower, name[here], to)
    to = to.ravel()
    while (to[to] != to).any():
        to = to[to]
    return np.unique(to, return_inverse=True)[1].reshape(steep.shape)


def _borders(colour: np.ndarray, sides: tuple[int, ...], noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (H,W-1), (H-1,W) in [0, 1]: differences of colors (H,W,C) left and right, above and below, mean over windows."""
    across = np.mean([_differ(colour, side, noise) for side in sides], 0)
    down = np.mean([_differ(colour.swapaxes(0, 1), side, noise).T for side in sides], 0)
    return across, down


def _differ(colour: np.ndarray, side: int, noise: float) -> np.ndarray:
    """Return (H,W-1) in [0, 1]: the difference of mean colors in windows left and right, against the variance within them."""
    values = np.concatenate([colour, colour**2], -1)
    tall = (-(side // 2), side // 2) if side > 1 else (0, 0)
    left, right = _box(values, tall, (1 - side, 0)), _box(values, tall, (1, side))
    channels = colour.shape[-1]
    variance = sum(np.maximum(part[..., channels:] - part[..., :channels] ** 2, 0) for part in (left, right))
    squares = (left[..., :channels] - right[..., :channels]) ** 2 / (noise**2 + variance)
    return 1 - np.exp(-squares.sum(-1)[:, :-1] / 2)


def _box(values: np.ndarray, rows: tuple[int, int], columns: tuple[int, int]) -> np.ndarray:
    """Return the means (H,W,C) of `values (H,W,C)` over windows from the first to the last of `rows` and `columns` at a pixel."""
    height, width = values.shape[:2]
    before = [max(0, -first) for first, _ in (rows, columns)]
    after = [max(0, last) for _, last in (rows, columns)]
    padded = np.pad(values, (*zip(before, after, strict=True), (0, 0)), mode="edge")
    sums = np.pad(padded.cumsum(0).cumsum(1), ((1, 0), (1, 0), (0, 0)))
    (top, bottom), (left, right) = (
        (offset + first, offset + last + 1) for offset, (first, last) in zip(before, (rows, columns), strict=True)
    )
    low, high = slice(top, top + height), slice(bottom, bottom + height)
    near, far = slice(left, left + width), slice(right, right + width)
    total = sums[high, far] - sums[low, far] - sums[high, near] + sums[low, near]
    return total / ((bottom - top) * (right - left))


def _neighbours(label: np.ndarray, across: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pairs (2,E) of superpixels that touch, mean strength (E,) of their border and its length (E,) in pixels."""
    one = np.concatenate([label[:, :-1].ravel(), label[:-1].ravel()])
    two = np.concatenate([label[:, 1:].ravel(), label[1:].ravel()])
    apart = one != two
    count = int(label.max()) + 1
    key = (np.minimum(one, two) * count + np.maximum(one, two))[apart]
    keys, pair = np.unique(key, return_inverse=True)
    length = np.bincount(pair).astype(float)
    strength = np.bincount(pair, np.concatenate([across.ravel(), down.ravel()])[apart]) / np.maximum(length, 1)
    return np.stack(np.divmod(keys, count)), strength, length


def _histograms(colour: np.ndarray, label: np.ndarray, bins: int) -> np.ndarray:
    """Return (P,C bins): histograms of the colors (H,W,C) of superpixels; each row adds up to 1."""
    count, channels = int(label.max()) + 1, colour.shape[-1]
    span = np.abs(OPPONENT).sum(1) / 2
    low = np.minimum(OPPONENT, 0).sum(1)
    place = (colour - low) / (2 * span) * (bins - 1)
    lower = np.clip(place.astype(int), 0, bins - 2)
    part = place - lower
    cell = (label[..., None] * channels + np.arange(channels)) * bins + lower
    size = count * channels * bins
    sums = np.bincount(cell.ravel(), (1 - part).ravel(), size) + np.bincount(cell.ravel() + 1, part.ravel(), size)
    found = sums.reshape(count, -1)
    return found / found.sum(1, keepdims=True)
