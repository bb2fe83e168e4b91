"""Superpixels of a picture and what clicks on static things mean, against loops and on made-up pictures and scenes."""

import math

import numpy as np
import pytest
from labelled_scene import labelled_scene, square_mask

from f4x_core.query import objects, superpixels
from f4x_core.query.marks import Box, Brush, Lasso, Point
from f4x_core.query.objects import point_out
from f4x_core.query.prompts import select_by_points
from f4x_core.query.score import overlap
from f4x_core.query.select_config import SELECT
from f4x_core.query.superpixels import Superpixels, _Size, basins, cut_picture, superpixels_of

PICTURE = SELECT.picture
RNG = np.random.default_rng(3)


def windows_by_loops(values, y, x, rows, columns):
    """(n,C): the values of a window beside a pixel, those at the rim repeated beyond it."""
    height, width = values.shape[:2]
    return np.array(
        [
            values[min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)]
            for dy in range(rows[0], rows[1] + 1)
            for dx in range(columns[0], columns[1] + 1)
        ]
    )


@pytest.mark.parametrize(("rows", "columns"), [((-1, 1), (-1, 1)), ((0, 0), (-3, 0)), ((-2, 2), (1, 4))])
def test_means_over_windows_by_loops(rows, columns):
    values = RNG.random((5, 7, 2))
    found = superpixels._box(values, rows, columns)
    for y, x in np.ndindex(5, 7):
        np.testing.assert_allclose(found[y, x], windows_by_loops(values, y, x, rows, columns).mean(0))


@pytest.mark.parametrize("side", [1, 2, 4])
def test_borders_compare_means_with_the_variance_around_them(side):
    colour = 0.1 * RNG.random((6, 8, 3))
    found = superpixels._differ(colour, side, PICTURE.noise)
    tall = (-(side // 2), side // 2) if side > 1 else (0, 0)
    assert found.shape == (6, 7)
    for y, x in np.ndindex(6, 7):
        left, right = (windows_by_loops(colour, y, x, tall, columns) for columns in ((1 - side, 0), (1, side)))
        squares = (left.mean(0) - right.mean(0)) ** 2 / (PICTURE.noise**2 + left.var(0) + right.var(0))
        assert found[y, x] == pytest.approx(1 - math.exp(-squares.sum() / 2), abs=1e-9)


def test_borders_across_and_down_are_the_same_of_a_turned_picture():
    colour = RNG.random((6, 9, 3))
    across, down = superpixels._borders(colour, (1, 2), PICTURE.noise)
    turned = superpixels._borders(colour.swapaxes(0, 1), (1, 2), PICTURE.noise)
    np.testing.assert_allclose(turned[0].T, down)
    np.testing.assert_allclose(turned[1].T, across)


def test_basins_run_down_to_the_same_place():
    """Two flat fields between which one column of borders stands."""
    across, down = np.zeros((6, 9)), np.zeros((5, 10))
    across[:, 4] = 1
    label = basins(across, down)
    assert label.min() == 0 and len(np.unique(label)) == label.max() + 1
    assert not set(label[:, :4].ravel()) & set(label[:, 6:].ravel())
    # each pixel but the lowest has a neighbour of its basin
    for y, x in np.ndindex(*label.shape):
        around = label[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        assert (around == label[y, x]).sum() > 1 or (label == label[y, x]).sum() == 1


def test_neighbours_by_loops():
    label = RNG.integers(0, 4, (5, 6))
    label.flat[:4] = range(4)
    across, down = RNG.random((5, 5)), RNG.random((4, 6))
    pairs, strength, length = superpixels._neighbours(label, across, down)
    expected: dict[tuple[int, int], list[float]] = {}
    for y, x in np.ndindex(5, 6):
        for (dy, dx), border in (((0, 1), across), ((1, 0), down)):
            if y + dy < 5 and x + dx < 6 and label[y, x] != label[y + dy, x + dx]:
                pair = tuple(sorted((int(label[y, x]), int(label[y + dy, x + dx]))))
                expected.setdefault(pair, []).append(border[y, x])
    assert sorted(expected) == list(zip(*pairs.tolist(), strict=True))
    for pair, mean, count in zip(pairs.T.tolist(), strength, length, strict=True):
        assert count == len(expected[tuple(pair)]) and mean == pytest.approx(np.mean(expected[tuple(pair)]))


def test_histograms_hold_every_pixel_between_two_bins():
    colour = (RNG.random((4, 5, 3))) @ superpixels.OPPONENT.T
    label = np.repeat([[0, 0, 1, 1, 1]], 4, 0)
    found = superpixels._histograms(colour, label, PICTURE.bins)
    bins = PICTURE.bins
    for k in (0, 1):
        expected = np.zeros((3, bins))
        for pixel in colour[label == k]:
            for channel, (value, low, high) in enumerate(zip(pixel, (0, -1.5, -1.2), (1, 1.5, 1.2), strict=True)):
                place = (value - low) / (high - low) * (bins - 1)
                lower = min(int(place), bins - 2)
                expected[channel, lower] += 1 - (place - lower)
                expected[channel, lower + 1] += place - lower
        np.testing.assert_allclose(found[k], expected.ravel() / expected.sum(), atol=1e-12)


def row_of(count, bonds, lengths):
    """Superpixels of 100 pixels each in a row, in a picture with much besides."""
    label = np.repeat(np.arange(count)[None], 100, 0)
    pairs = np.stack([np.arange(count - 1), np.arange(1, count)])
    return Superpixels(label, pairs, np.asarray(lengths, float), np.asarray(bonds, float))


def test_the_walk_solves_its_equations():
    one = row_of(6, RNG.random(5), np.ones(5))
    start, free = RNG.random(6), np.array([True, True, True, True, False, True])
    start[~free] = 0
    bonds = np.zeros((6, 6))
    bonds[one.pairs[0], one.pairs[1]] = bonds[one.pairs[1], one.pairs[0]] = one.bond
    matrix = np.diag((1 + PICTURE.leak) * bonds.sum(1)) - bonds * np.outer(free, free)
    np.testing.assert_allclose(one._walk(start, free), np.linalg.solve(matrix, start), rtol=1e-6, atol=1e-9)
    assert not one._walk(np.zeros(6), free).any()


def test_cuts_are_sums_over_the_pairs_that_a_set_parts():
    one = row_of(7, RNG.random(6), RNG.integers(1, 9, 6))
    rank = RNG.permutation(7)
    for values in (one.bond, one.length):
        found = one._cut(rank, values)
        for size in range(1, 8):
            parted = (rank[one.pairs[0]] < size) != (rank[one.pairs[1]] < size)
            assert found[size - 1] == pytest.approx(values[parted].sum())


def mark(shape, at, radius=3.0):
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return (x - at[0]) ** 2 + (y - at[1]) ** 2 <= radius**2


SHAPE = (120, 200)
NOBODY = np.zeros(SHAPE, bool)
DISC, OTHER = mark(SHAPE, (60, 60), 22), mark(SHAPE, (150, 60), 16)


def discs(grain=0.02, other=(0.2, 0.3, 0.7)):
    """A picture of a red and another disc on grainy sand."""
    picture = np.full((*SHAPE, 3), (0.6, 0.55, 0.45))
    picture[DISC], picture[OTHER] = (0.7, 0.2, 0.2), other
    return picture + grain * np.random.default_rng(1).normal(size=picture.shape)


@pytest.mark.parametrize("grain", [0.0, 0.03, 0.08])
def test_a_click_on_a_disc_means_the_disc(grain):
    picture = cut_picture(discs(grain), np.zeros(SHAPE))
    for disc, at in ((DISC, (64, 57)), (OTHER, (147, 62))):
        assert overlap(picture.meant([mark(SHAPE, at)], NOBODY), disc) > 0.85


def test_two_clicks_mean_both_and_one_beside_leaves_it_out():
    picture = cut_picture(discs(), np.zeros(SHAPE))
    on, other = mark(SHAPE, (60, 60)), mark(SHAPE, (150, 60))
    both = picture.meant([on, other], NOBODY)
    assert both[DISC].mean() > 0.9 and both[OTHER].mean() > 0.9
    sand = mark(SHAPE, (105, 20))
    assert overlap(picture.meant([on, other], sand), DISC | OTHER) > overlap(both, DISC | OTHER) - 1e-9
    assert not picture.meant([on], sand)[sand].any()


def test_several_clicks_tell_how_large_the_thing_is():
    """On tiles, a click means one of them; a click on each of the corners all of the floor, and not the wall above it."""
    picture = np.full((*SHAPE, 3), (0.25, 0.3, 0.5))
    floor = np.zeros(SHAPE, bool)
    floor[30:] = True
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    random = np.random.default_rng(2)
    shade = random.random((5, 8))
    picture[floor] = (0.55 + 0.1 * shade[np.minimum(y // 25, 4), x // 25])[floor, None] * (1, 0.95, 0.8)
    parts = cut_picture(picture + 0.04 * random.normal(size=picture.shape), np.zeros(SHAPE))
    corners = [mark(SHAPE, at) for at in ((12, 40), (188, 40), (12, 110), (188, 110))]
    assert overlap(parts.meant(corners[:1], NOBODY), floor) < 0.1
    assert overlap(parts.meant(corners, NOBODY), floor) > 0.9


def test_a_stroke_tells_how_large_the_thing_is_and_keeps_what_it_covers():
    """One stroke over both discs means both; a click on one of them means that one."""
    picture = cut_picture(discs(), np.zeros(SHAPE))
    stroke = np.zeros(SHAPE, bool)
    stroke[56:64, 60:150] = True
    meant = picture.meant([stroke], NOBODY)
    assert meant[stroke].mean() > 0.8 and meant[DISC].mean() > 0.9 and meant[OTHER].mean() > 0.9
    assert not picture.meant([mark(SHAPE, (60, 60))], NOBODY)[OTHER].any()


def test_the_size_that_marks_tell_is_that_of_the_box_around_them():
    dot, two = (np.zeros((40, 200), bool) for _ in range(2))
    dot[2, 3:8] = True
    click = _Size.of_marks(dot, PICTURE)  # up to a fortieth of the width
    assert click == _Size(PICTURE.usual, PICTURE.size, PICTURE.sizes[1])
    two[2, 3], two[11, 102] = True, True
    both = _Size.of_marks(two, PICTURE)
    assert both.usual == pytest.approx(10 * 100 / 8000) and both.weight > click.weight and both.most > click.most
    dot[2, 8] = True
    stroke = _Size.of_marks(dot, PICTURE)
    assert stroke.usual == click.usual and stroke.weight == both.weight


def test_features_part_what_has_one_colour():
    """Two halves of a plain picture that look alike but for their features."""
    picture = np.full((*SHAPE, 3), 0.5) + 0.02 * np.random.default_rng(2).normal(size=(*SHAPE, 3))
    looks = np.zeros((12, 20, 2))
    looks[..., 0], looks[4:8, 4:10] = 1.0, (0.0, 1.0)
    truth = np.zeros(SHAPE, bool)
    truth[40:80, 40:100] = True
    at = [mark(SHAPE, (70, 60))]
    found, plain = (cut_picture(picture, np.zeros(SHAPE), features).meant(at, NOBODY) for features in (looks, None))
    assert overlap(found, truth) > 0.7 > overlap(plain, truth)


def test_what_moves_is_no_part_and_no_border():
    moving = np.zeros(SHAPE)
    moving[:, 100:] = 1
    picture = cut_picture(discs(), moving)
    shows = np.bincount(picture.label.ravel(), moving.ravel()) <= 0.5 * np.bincount(picture.label.ravel())
    hidden = ~shows[picture.pairs].all(0)
    assert hidden.any() and not picture.length[hidden].any() and not picture.bond[hidden].any()
    found = picture.meant([mark(SHAPE, (60, 60))], NOBODY)
    assert overlap(found, DISC) > 0.85


def test_a_picture_is_cut_once_and_at_one_width():
    scene = labelled_scene(features=False)
    picture = superpixels_of(scene, 2)
    assert picture.label.shape[1] == PICTURE.columns and superpixels_of(scene, 2) is picture
    assert superpixels_of(scene, 3) is not picture


@pytest.mark.parametrize(
    ("marks", "by_picture"),
    [
        ([Point(0, True, (3, 3))], True),
        ([Point(0, True, (3, 3)), Point(0, False, (9, 9))], True),
        ([Point(0, True, (3, 3)), Point(4, False, (9, 9))], False),
        ([Point(0, True, (3, 3)), Box(0, True, (0, 0, 9, 9))], False),
        ([Brush(0, True, [(3, 3)], 2.0), Point(0, False, (9, 9))], True),
        ([Brush(0, True, [(3, 3)], 2.0), Lasso(0, True, [(0, 0), (9, 0), (9, 9)])], False),
    ],
)
def test_clicks_and_strokes_on_marked_frames_are_looked_up_in_pictures(marks, by_picture):
    assert objects._by_picture(marks) == by_picture


def test_who_is_hidden_goes_with_its_superpoint(monkeypatch):
    """Gaussians 0 to 3 are static, two to a superpoint; 1 and 3 hardly show."""
    scene = labelled_scene(features=False)
    graph = objects.graph_of(scene)
    still = np.flatnonzero(~scene.moving)[:4]
    index = np.array([0, 0, 1, 1])
    some = objects.Superpoints(
        still, index, np.ones(2), np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2), np.zeros(2, bool)
    )
    monkeypatch.setattr(objects, "graph_of", lambda scene, config: objects.Graph(graph.moving, some))
    fraction, seen = np.zeros(len(scene.ids)), np.zeros(len(scene.ids))
    fraction[still], seen[still] = (0.9, 0.0, 0.2, 0.9), (1.0, 0.0, 1.0, 0.04)
    fraction[scene.moving], seen[scene.moving] = 1.0, 1.0
    monkeypatch.setattr(objects, "static_part", lambda scene, marks, config: (fraction, seen))
    found = point_out(scene, [Point(0, True, (58.0, 5.0))])
    assert np.flatnonzero(found).tolist() == still[:2].tolist()
    fraction[:] = 0
    assert point_out(scene, [Point(0, True, (58.0, 5.0))]) is None


def test_a_click_on_the_wall_takes_nothing_that_moves():
    scene = labelled_scene(features=False)
    found = select_by_points(scene, [(56.0, 8.0)], 0)
    assert found.chosen.any() and not found.chosen[scene.moving].any()
    assert not square_mask(0.0)[8, 56]


def test_the_first_click_says_whether_what_is_meant_moves():
    """A later one on the other kind changes nothing, on the same frame or an earlier one."""
    scene = labelled_scene(features=False)
    row, column = np.argwhere(square_mask(0.0)).mean(0)
    wall, square = [(56.0, 8.0)], [(column, row)]
    for one, other in ((wall, square), (square, wall)):
        alone = select_by_points(scene, one, 0).chosen
        assert alone.any() and (select_by_points(scene, one + other, 0).chosen == alone).all()
    later = [Point(2, True, wall[0]), Point(0, True, square[0])]
    assert (point_out(scene, later) == point_out(scene, later[:1])).all()
