"""Masks of an object through a video from feature maps: the interface, and the answer that needs no model.

Without a model, a cell of a new frame asks the cells of the frames before it that look most alike and lie near: they vote with
their masks (k nearest neighbours of unit features; label propagation, e.g. Jabri et al. 2020, sec. 4). Needs numpy alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..errors import F4xError
from ..features.text import unit
from .decoder_prompt import check_frame, check_prompt

BLOCK = 8
"""Cells are compared in square blocks of this side, so that the work is matrix products."""
NOBODY = 0.02
"""A cell is background where no cell in reach was covered by the object by more than this fraction."""


UNCERTAIN = 1e-4
"""Minimum distance of a probability from 0 and 1, so that logits stay finite."""


@dataclass(frozen=True)
class PropagationConfig:
    """Settings of masks that travel from frame to frame in feature space."""

    memory: int = 2
    """Frames before the present one that are asked, besides the prompted ones."""
    reach: int = 4
    """Cells that an object may move from one frame to the next."""
    neighbours: int = 30
    """Cells that vote on a cell."""
    temperature: float = 0.1
    """A vote weighs exp(cosine / temperature)."""


class FeaturePropagation:
    """Carries masks of one object through a video by nearest neighbours among feature maps (`visual` is best), numpy alone.

    `features(t)` gives the map (h,w,C) of frame t in [0, count), rendered or extracted, of any length per cell.
    """

    def __init__(
        self,
        features: Callable[[int], np.ndarray],
        count: int,
        size: tuple[int, int],
        config: PropagationConfig | None = None,
    ) -> None:
        self.count, self.size, self.config = count, size, config or PropagationConfig()
        self._features = features
        self._masks: dict[int, np.ndarray] = {}  # prompted frame -> (h,w) fraction of each cell that is the object

    def prompt(self, t: int, mask: np.ndarray) -> None:
        """Give the `mask (H,W)` bool of the object on frame `t`, in place of an earlier one there. F4xError: an empty one."""
        check_frame(t, self.count)
        prompt, cells = check_prompt(self.size, mask=mask), self._cells(t)
        assert prompt.mask is not None
        self._masks[t] = shrink(prompt.mask.astype(np.float32), (cells.shape[0], cells.shape[1]))

    def propagate(self) -> Iterator[tuple[int, np.ndarray]]:
        """Yield every frame once with its logits (H,W): from the first prompted one to the end, then back to frame 0."""
        if not self._masks:
            raise F4xError("Nothing is prompted yet: give a mask on some frame first.")
        start = min(self._masks)
        known = {t: _Masked(self._cells(t), fraction, self.config.reach) for t, fraction in self._masks.items()}
        yield start, self._logits(self._masks[start])
        for order in (range(start + 1, self.count), range(start - 1, -1, -1)):
            recent = [known[start]]
            for t in order:
                frame = known.get(t)
                if frame is None:
                    cells = self._cells(t)
                    frame = _Masked(cells, self._vote(cells, known.values(), recent), self.config.reach)
                recent = [*recent, frame][-self.config.memory :]
                yield t, self._logits(frame.fraction)

    def _vote(self, cells: np.ndarray, known: Collection[_Masked], recent: list[_Masked]) -> np.ndarray:
        """Return the fraction of the object (h,w) in the cells (h,w,C) of a frame, by the frames it can ask."""
        height, width = cells.shape[:2]
        here = _centre(recent[-1].fraction)
        asked = [frame.windows((0, 0)) for frame in recent]
        for frame in known:
            if all(frame is not other for other in recent):
                # The window into a prompted frame, perhaps long ago, goes along with the object.
                row, column = np.round(here - _centre(frame.fraction)).astype(int)
                asked.append(frame.windows((int(row), int(column))))
        votes = np.concatenate([vote for _, vote in asked], 1)  # (blocks,n)
        possible = votes.max(1) > NOBODY
        queries = windows(cells, 0)[possible]  # (p,64,C)
        cosine = np.concatenate([queries @ key[possible].swapaxes(1, 2) for key, _ in asked], 2)  # (p,64,n)
        rank = cosine.shape[2] - min(self.config.neighbours, cosine.shape[2])
        kth_cosine = np.partition(cosine, rank, axis=2)[:, :, rank, None]
        weight = np.exp((cosine - 1) / self.config.temperature) * (cosine >= kth_cosine)
        answer = np.zeros((len(votes), BLOCK * BLOCK), np.float32)
        answer[possible] = (weight @ votes[possible][..., None])[..., 0] / weight.sum(2)
        across = -(-width // BLOCK)
        rows = answer.reshape(-1, across, BLOCK, BLOCK).swapaxes(1, 2).reshape(-1, across * BLOCK)
        return rows[:height, :width]

    def _cells(self, t: int) -> np.ndarray:
        """Return the unit features (h,w,C) float32 of frame `t`."""
        return unit(np.asarray(self._features(t), np.float32))

    def _logits(self, fraction: np.ndarray) -> np.ndarray:
        probability = np.clip(enlarge(fraction, self.size), UNCERTAIN, 1 - UNCERTAIN)
        return np.log(probability / (1 - probability))


class _Masked:
    """A frame whose mask is known."""

    def __init__(self, cells: np.ndarray, fraction: np.ndarray, reach: int) -> None:
        self.cells, self.fraction, self.reach = cells, fraction, reach
        self._made: tuple[tuple[int, int], tuple[np.ndarray, np.ndarray]] | None = None

    def windows(self, move: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return features (blocks,n,C) and fractions (blocks,n) of its cells after a move by (rows, columns)."""
        if self._made is None or self._made[0] != move:
            features = windows(shifted(self.cells, move), self.reach)
            self._made = move, (features, windows(shifted(self.fraction, move)[..., None], self.reach)[..., 0])
        return self._made[1]


def windows(values: np.ndarray, reach: int) -> np.ndarray:
    """Return (blocks, (BLOCK + 2 reach)^2, C): the cells in each square block of (h,w,C) and `reach` around it."""
    height, width, channels = values.shape
    down, across = -(-height // BLOCK), -(-width // BLOCK)
    padded = np.zeros((down * BLOCK + 2 * reach, across * BLOCK + 2 * reach, channels), np.float32)
    padded[reach : reach + height, reach : reach + width] = values
    side = BLOCK + 2 * reach
    views = sliding_window_view(padded, (side, side), (0, 1))[::BLOCK, ::BLOCK]  # type: ignore[call-overload]  # (down,across,C,side,side)
    return np.moveaxis(views, 2, -1).reshape(down * across, side * side, channels)


def shifted(values: np.ndarray, move: tuple[int, int]) -> np.ndarray:
    """Return (h,w,...) moved by (rows, columns); zeros come in at the rim."""
    if move == (0, 0):
        return values
    result = np.zeros_like(values)
    target, source = zip(*(_overlap(move[axis], values.shape[axis]) for axis in (0, 1)), strict=True)
    result[target] = values[source]
    return result


def sums_around(cells: np.ndarray) -> np.ndarray:
    """Return the sums of `cells (h,w,C)` over 3 x 3 cells; those of the edge are repeated beyond it."""
    height, width = cells.shape[:2]
    padded = np.pad(cells, ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = (padded[y : y + height, x : x + width] for y in range(3) for x in range(3))
    return sum(around, np.zeros_like(cells))


def connected_regions(kind: np.ndarray) -> np.ndarray:
    """Return (h,w) int: one number for each 4-connected region of equal `kind (h,w)`."""
    number = np.arange(kind.size).reshape(kind.shape)
    ways = ((number, kind[1:] == kind[:-1]), (number.T, (kind[:, 1:] == kind[:, :-1]).T))
    while True:
        before = number.copy()
        for view, alike in ways:
            rows = range(len(alike))
            for row in (*rows, *reversed(rows)):  # the smallest number runs along whole columns at once
                lower_label = np.minimum(view[row], view[row + 1])
                view[row] = np.where(alike[row], lower_label, view[row])
                view[row + 1] = np.where(alike[row], lower_label, view[row + 1])
        if (before == number).all():
            return number


def shrink(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the means (h,w,...) of `values (H,W,...)` over the cells of a coarser grid, whole or in part."""
    down, across = (_area_matrix(new, old) for new, old in zip(size, values.shape[:2], strict=True))
    rows = (down @ values.reshape(len(values), -1)).reshape(size[0], values.shape[1], -1)  # (h,W,C)
    return (across @ rows).reshape(*size, *values.shape[2:])


def enlarge(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return `values (h,w)` interpolated bilinearly to (H,W), corners of both grids on each other."""
    down, across = (_linear_matrix(new, old) for new, old in zip(size, values.shape, strict=True))
    return down @ values @ across.T


def _area_matrix(new: int, old: int) -> np.ndarray:
    """Return (new,old): the fraction of each old cell in the mean over a new one."""
    edges, low = np.arange(new + 1) * old / new, np.arange(old)
    covered = np.minimum(edges[1:, None], low + 1) - np.maximum(edges[:-1, None], low)
    return (np.maximum(covered, 0) * new / old).astype(np.float32)


def _linear_matrix(new: int, old: int) -> np.ndarray:
    """Return (new,old): weights of linear interpolation at the centres of the new cells."""
    place = np.clip((np.arange(new) + 0.5) * old / new - 0.5, 0, old - 1)
    return np.maximum(0, 1 - abs(place[:, None] - np.arange(old))).astype(np.float32)


def _centre(fraction: np.ndarray) -> np.ndarray:
    """Return (row, column) of the centre of mass of `fraction (h,w)`."""
    total = max(float(fraction.sum()), 1e-12)
    rows, columns = fraction.sum(1), fraction.sum(0)
    return np.array([rows @ np.arange(len(rows)), columns @ np.arange(len(columns))]) / total


def _overlap(move: int, length: int) -> tuple[slice, slice]:
    """Return the slices to which and from which values go when they move by `move` cells."""
    move = int(np.clip(move, -length, length))
    return slice(max(move, 0), length + min(move, 0)), slice(max(-move, 0), length - max(move, 0))
