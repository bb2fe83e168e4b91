"""Masks that travel by votes, connected regions, and the grids below them, against loops over cells."""

import math

import numpy as np
import pytest

from f4x_core.query import segmentation
from f4x_core.query.segmentation import (
    BLOCK,
    NOBODY,
    UNCERTAIN,
    FeaturePropagation,
    PropagationConfig,
    connected_regions,
    shrink,
    sums_around,
    windows,
)

GRID, SIZE, COUNT = (11, 19), (23, 31), 5


def features(t):
    """(h,w,4) of small length: two looks that move apart, and noise."""
    random = np.random.default_rng(t)
    kind = (np.arange(GRID[1]) + t) // 6 % 2
    looks = np.random.default_rng(9).normal(size=(2, 4))[kind]
    return 0.03 * (looks + 0.5 * random.normal(size=(*GRID, 4)))


def unit(cells):
    return np.float32(cells) / np.linalg.norm(cells, axis=-1, keepdims=True)


def bilinear(values, size):
    """`enlarge` at one pixel after another."""

    def between(place, length):
        place = min(max(place, 0), length - 1)
        low = min(int(place), max(length - 2, 0))
        return low, min(low + 1, length - 1), place - low

    result = np.zeros(size)
    for y, x in np.ndindex(size):
        top, bottom, v = between((y + 0.5) * values.shape[0] / size[0] - 0.5, values.shape[0])
        left, right, u = between((x + 0.5) * values.shape[1] / size[1] - 0.5, values.shape[1])
        upper = (1 - u) * values[top, left] + u * values[top, right]
        lower = (1 - u) * values[bottom, left] + u * values[bottom, right]
        result[y, x] = (1 - v) * upper + v * lower
    return result


def centre(fraction):
    rows, columns = np.indices(fraction.shape)
    return np.array([(rows * fraction).sum(), (columns * fraction).sum()]) / fraction.sum()


def vote_by_loops(cells, asked, config):
    """Each cell by the cells around its block in `asked` [(cells, fraction, move)]; 0 where a block has nobody in reach."""
    answer = np.zeros(GRID)
    for row, column in np.ndindex(GRID):
        top, left = row // BLOCK * BLOCK, column // BLOCK * BLOCK
        votes = []
        for others, fraction, (down, right) in asked:
            for y in range(top - config.reach, top + BLOCK + config.reach):
                for x in range(left - config.reach, left + BLOCK + config.reach):
                    at = y - down, x - right  # what is at (y, x) after the move
                    seen = all(0 <= p < n and 0 <= q < n for p, q, n in zip(at, (y, x), GRID, strict=True))
                    votes.append((cells[row, column] @ others[at], fraction[at]) if seen else (0.0, 0.0))
        if max(vote for _, vote in votes) > NOBODY:
            least = sorted((cosine for cosine, _ in votes), reverse=True)[: config.neighbours][-1]
            weights = [math.exp((cosine - 1) / config.temperature) * (cosine >= least) for cosine, _ in votes]
            answer[row, column] = np.average([vote for _, vote in votes], weights=weights)
    return answer


def propagate_by_loops(masks, config):
    """{frame: fraction}: both ways from the first prompted frame, which all other frames may ask."""
    start, found = min(masks), dict(masks)
    for frames in (range(start + 1, COUNT), range(start - 1, -1, -1)):
        recent = [start]
        for t in frames:
            if t not in masks:
                asked = [(unit(features(r)), found[r], (0, 0)) for r in recent]
                for prompted in masks:
                    if prompted not in recent:
                        move = np.round(centre(found[recent[-1]]) - centre(masks[prompted])).astype(int)
                        asked.append((unit(features(prompted)), masks[prompted], move.tolist()))
                found[t] = vote_by_loops(unit(features(t)), asked, config)
            recent = [*recent, t][-config.memory :]
    return found


@pytest.mark.parametrize(
    ("prompted", "settings"),
    [
        ((2,), {"memory": 1, "reach": 2, "neighbours": 5}),
        ((0,), {"memory": 2, "reach": 1, "neighbours": 8, "temperature": 0.5}),
        ((1, 4), {"memory": 1, "reach": 1, "neighbours": 1000}),
        ((0, 1), {"memory": 2, "reach": 3, "neighbours": 12}),
    ],
)
def test_votes_by_loops(prompted, settings):
    config = PropagationConfig(**settings)
    decoder = FeaturePropagation(features, COUNT, SIZE, config)
    masks = {}
    for t in prompted:
        mask = np.zeros(SIZE, bool)
        mask[2 * t : 2 * t + 7, 4 + 3 * t : 11 + 4 * t] = True
        decoder.prompt(t, mask=mask)
        masks[t] = shrink(mask.astype(np.float32), GRID)
    expected = propagate_by_loops(masks, config)
    found = dict(decoder.propagate())
    assert list(found) == [*range(min(prompted), COUNT), *range(min(prompted) - 1, -1, -1)]
    for t, logits in found.items():
        probability = np.clip(bilinear(expected[t], SIZE), UNCERTAIN, 1 - UNCERTAIN)
        np.testing.assert_allclose(1 / (1 + np.exp(-logits)), probability, atol=2e-5)


def test_what_was_hardly_covered_is_background():
    decoder = FeaturePropagation(features, COUNT, SIZE)
    for fraction, others in ((NOBODY, 0), (1.01 * NOBODY, 1.01 * NOBODY)):
        decoder._masks = {0: np.full(GRID, fraction, np.float32)}
        logits = dict(decoder.propagate())[1]
        np.testing.assert_allclose(
            logits[12, 15], np.log(max(others, UNCERTAIN) / (1 - max(others, UNCERTAIN))), rtol=1e-3
        )


def test_logits_are_log_odds_within_a_bound():
    fraction = np.float32([[0, 0.2], [0.7, 1]])
    expected = [[math.log(p / (1 - p)) for p in row] for row in ((UNCERTAIN, 0.2), (0.7, 1 - UNCERTAIN))]
    np.testing.assert_allclose(FeaturePropagation(features, 1, (2, 2))._logits(fraction), expected, rtol=1e-3)


def test_features_get_unit_length_and_zeros_stay():
    cells = features(0)
    cells[3, 4] = 0
    expected = unit(np.where(cells == 0, 1e-30, cells)) * (cells != 0)
    np.testing.assert_allclose(FeaturePropagation(lambda t: cells, 1, SIZE)._cells(0), expected, atol=1e-6)


def test_windows_of_a_frame_are_made_once_for_each_move():
    cells, fraction = unit(features(0)), np.random.default_rng(0).random(GRID).astype(np.float32)
    frame = segmentation._Masked(cells, fraction, 2)
    for move in ((0, 0), (1, -2)):
        keys, votes = frame.windows(move)
        again = frame.windows(move)
        assert again[0] is keys and again[1] is votes
        np.testing.assert_array_equal(keys, windows(segmentation.shifted(cells, move), 2))
        np.testing.assert_array_equal(votes, windows(segmentation.shifted(fraction, move)[..., None], 2)[..., 0])


@pytest.mark.parametrize("grid", [(4, 5), (5, 7), (12, 15), (1, 2)])
def test_shrinking_is_the_mean_over_cells(grid):
    values = np.random.default_rng(3).random((12, 15, 2)).astype(np.float32)
    fine = values.repeat(grid[0], 0).repeat(grid[1], 1)  # as many parts of a pixel as there are new cells
    expected = fine.reshape(grid[0], 12, grid[1], 15, 2).mean((1, 3))
    np.testing.assert_allclose(shrink(values, grid), expected, atol=1e-5)
    np.testing.assert_allclose(shrink(values[..., 0], grid), expected[..., 0], atol=1e-5)


def regions_by_loops(kind):
    """The number of a region is that of its first cell, row by row."""
    number = np.full(kind.shape, -1)
    for first in np.ndindex(kind.shape):
        edge = [first] if number[first] < 0 else []
        while edge:
            y, x = edge.pop()
            number[y, x] = first[0] * kind.shape[1] + first[1]
            around = ((y + 1, x), (y - 1, x), (y, x + 1), (y, x - 1))
            inside = [at for at in around if 0 <= at[0] < kind.shape[0] and 0 <= at[1] < kind.shape[1]]
            edge += [at for at in inside if number[at] < 0 and kind[at] == kind[first]]
    return number


@pytest.mark.parametrize("seed", range(3))
def test_sums_around_and_regions_by_loops(seed):
    random = np.random.default_rng(seed)
    cells = random.normal(size=(6, 9, 2))
    padded = np.pad(cells, ((1, 1), (1, 1), (0, 0)), mode="edge")
    for y, x in np.ndindex(6, 9):
        np.testing.assert_allclose(sums_around(cells)[y, x], padded[y : y + 3, x : x + 3].sum((0, 1)), atol=1e-9)
    kind = random.integers(0, 2, (9, 14))
    np.testing.assert_array_equal(connected_regions(kind), regions_by_loops(kind))
