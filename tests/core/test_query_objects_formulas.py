"""The steps by which a pointed-out thing is found, each against its formula written out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import labelled_scene, square_mask

from f4x_core.query import objects
from f4x_core.query.blend_weights import blend_weight_sums
from f4x_core.query.decoder_prompt import Prompt, check_prompt
from f4x_core.query.marks import Box, Brush, Mask, Point, marks_of
from f4x_core.query.objects import Graph, Superpoints, point_out
from f4x_core.query.select_config import MOVING, SELECT, STATIC, Cutting

from .test_query_superpoints import pieces


@pytest.mark.parametrize(
    ("prompt", "kinds"),
    [
        (check_prompt((12, 16), points=[(1, 2), (3, 4)], labels=[1, 0]), [(Point, True), (Point, False)]),
        (check_prompt((12, 16), points=[(1, 2)], box=(0, 0, 5, 6)), [(Point, True), (Box, True)]),
        (check_prompt((12, 16), mask=np.eye(12, 16)), [(Mask, True)]),
    ],
)
def test_a_decoders_prompt_says_where_the_thing_is(prompt: Prompt, kinds):
    marks = marks_of(3, prompt)
    assert [(type(mark), mark.on) for mark in marks] == kinds and {mark.frame for mark in marks} == {3}


GRAPH = SELECT.graph
TWO_BLEND = np.array([0.0, 0.0, 0.5, 0.5])
"""Of four superpoints the last two look like the background, so that the whole of them is no thing."""
RNG = np.random.default_rng(5)


def chain(weights, strengths, **fields):
    """Superpoints of one Gaussian each, in a row; `strengths`: the bonds between one and the next."""
    count = len(weights)
    bonds = np.zeros((count, count))
    for k, strength in enumerate(strengths):
        bonds[k, k + 1] = bonds[k + 1, k] = strength
    rows = np.arange(count)
    given = {"blend": np.zeros(count), "near": (bonds > 0) * 1.0, "cast": np.zeros(count, bool)} | fields
    return Superpoints(rows, rows, np.asarray(weights, float), bonds, **given)


def always(places):
    """Tracks of superpoints that are always there."""
    return objects._Tracks(places, np.ones(places.shape[:2]), GRAPH)


def test_pieces_are_what_keeps_its_distances():
    """Two rods side by side; one turns and goes away. Neighbours within 1.1 of each other."""
    x = np.arange(4.0)
    still = np.stack([np.stack([x, 0 * x, 0 * x], 1)] * 3, 1)
    angles = np.array([0.0, 0.5, 1.0])
    turning = np.stack(
        [x[:, None] * np.cos(angles), 1 + angles + x[:, None] * np.sin(angles), 0 * x[:, None] + 0 * angles], 2
    )
    places = np.concatenate([still, turning])
    near = (np.linalg.norm(places[:, None, 0] - places[:, 0], axis=2) < 1.1) * (1 - np.eye(8))
    np.testing.assert_array_equal(pieces(always(places), near), [0, 0, 0, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(pieces(always(places), np.zeros((8, 8))), np.arange(8))


@pytest.mark.parametrize(("change", "together"), [(0.305, True), (0.355, False)])
def test_how_much_a_distance_may_change(change, together):
    """Of seven gaps of 1 six keep their length: the limit is .15 of length plus median, here 2 + change / 3."""
    places = np.zeros((8, 3, 3))
    places[:, :, 0] = np.arange(8.0)[:, None]
    places[4:, 2, 0] += change
    near = np.eye(8, k=1) + np.eye(8, k=-1)
    assert pieces(always(places), near).max() == (0 if together else 1)


def test_noise_of_all_neighbours_raises_the_limit():
    places = np.zeros((8, 2, 3))
    places[:, :, 0] = np.stack([np.arange(8.0), np.arange(8.0) * 1.5], 1)  # all gaps change by .5 of 1 to 1.5
    near = np.eye(8, k=1) + np.eye(8, k=-1)
    assert pieces(always(places), near).max() == 0


def test_what_is_absent_keeps_no_distance():
    """One of two goes away when the other is gone; two that never meet are no neighbours."""
    places = np.zeros((3, 4, 3))
    places[:, :, 0] = [[0, 0, 0, 9], [1, 1, 1, 1], [2, 2, 2, 2]]
    tracks = objects._Tracks(places, np.array([[1.0, 1, 1, 0], [1, 1, 1, 1], [0, 0, 0, 1]]), GRAPH)
    far = tracks.apart()
    np.testing.assert_allclose(far, [[0, 1, np.inf], [1, 0, 1], [np.inf, 1, 0]])
    bonds, near = objects._bonds(far, np.zeros((3, 2)), 12)
    np.testing.assert_allclose(near, np.exp(-1) * np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]))
    np.testing.assert_allclose(bonds, near)
    row = np.zeros((6, 4, 3))
    row[:, :, 0] = np.arange(6)[:, None]
    row[0, 3, 0] = 9
    gone = np.ones((6, 4))
    gone[0, 3] = 0
    chained = np.eye(6, k=1) + np.eye(6, k=-1)
    assert pieces(objects._Tracks(row, gone, GRAPH), chained).tolist() == [0] * 6
    assert pieces(always(row), chained).tolist() == [0] + [1] * 5
    parted = objects._Tracks(places, np.eye(3, 4), GRAPH)
    assert not objects._bonds(parted.apart(), np.zeros((3, 2)), 12)[1].any()


def test_a_superpoint_is_where_those_are_who_are_there():
    places = np.arange(24.0).reshape(4, 2, 3)
    presence = np.array([[1.0, 0], [0.5, 0], [0, 1], [0, 0.4]])
    found = objects._Tracks(places, presence, GRAPH).means(np.array([0, 0, 0, 1]), np.array([1.0, 2, 1, 5]), 2)
    np.testing.assert_allclose(found.places[0, 0], (places[0, 0] + places[1, 0]) / 2, rtol=0.01)
    np.testing.assert_allclose(found.places[0, 1], places[2, 1], rtol=0.01)
    np.testing.assert_allclose(found.places[1], places[3])  # where nobody is there, the absent ones
    np.testing.assert_array_equal(found.presence, [[1, 1], [0, 1]])


@pytest.mark.parametrize("contrast", [0.0, 0.3, 0.9])
def test_the_weakest_outline_weighs_conductance_and_contrast_and_of_weak_ones_the_smallest_is_meant(contrast):
    for _ in range(20):
        near = RNG.random((7, 7))
        near = np.triu(near, 1) + np.triu(near, 1).T
        likeness = RNG.random((7, 7))
        bonds, out, most = near * (likeness + likeness.T) / 2, RNG.random(7), np.full(7, 4.0)
        order, fits = RNG.permutation(7), RNG.random(7) > 0.3
        if not fits.any():
            continue
        (cut, volume), (limit, _) = objects._cuts(bonds, out, order), objects._cuts(near, most, order)
        value = (cut / limit) ** contrast * (cut / volume) ** (1 - contrast)
        best = min(np.flatnonzero(fits), key=lambda size: value[size])
        assert objects._sweep((bonds, out), (near, most), order, fits, Cutting(contrast, 0.0)) == best + 1
        best = next(size for size in np.flatnonzero(fits) if value[size] <= max(0.5, value[best]))
        while best + 1 in np.flatnonzero(fits) and value[best + 1] < value[best]:
            best += 1
        assert objects._sweep((bonds, out), (near, most), order, fits, Cutting(contrast, 0.5)) == best + 1


def test_other_pieces_than_the_most_marked_one_are_apart():
    marked = np.array([1.0, 1.0, 1.5, 0.0])
    assert not chain(np.ones(4), [1, 1, 1]).apart(marked).any()
    assert not chain([], [], piece=np.zeros(0, int)).apart(np.zeros(0)).any()
    pieces = chain(np.ones(4), [1, 1, 1], piece=np.array([0, 0, 1, 2]))
    np.testing.assert_array_equal(pieces.apart(marked), [False, False, True, True])
    np.testing.assert_array_equal(pieces.apart(np.array([1.0, 0, 1.5, 0.0])), [True, True, False, True])


def test_a_thing_is_neither_too_small_nor_too_large():
    """Without limits the weakest bond ends it after the first two; the fractions of weight are .1, .2, .5 and 1."""
    marked, against = np.eye(4)[0], np.zeros(4, bool)

    def taken(sizes=(0.0, 1.0)):
        return (
            chain([1, 1, 3, 5], [1, 0.01, 0.1], blend=TWO_BLEND, kind=replace(MOVING, sizes=sizes))
            .grow(marked, against)
            .sum()
        )

    assert taken() == 2
    assert taken(sizes=(0.2, 1.0)) == 2 and taken(sizes=(0.21, 1.0)) > 2
    assert taken(sizes=(0.0, 0.2)) == 2 and taken(sizes=(0.0, 0.19)) == 1
    assert taken(sizes=(0.0, 0.01)) == 1  # one superpoint may be larger than the limit


def test_what_is_cast_is_no_part_of_a_thing_and_a_thing_no_part_of_it():
    """A thing of two superpoints in a row with its shadow of two."""
    row = chain(np.ones(4), [1, 1, 1], blend=np.array([0.0, 0.0, 2.0, 2.0]), cast=np.array([False, False, True, True]))
    nobody = np.zeros(4, bool)
    assert row.grow(np.array([1.0, 0, 0, 0]), nobody).tolist() == [True, True, False, False]
    assert row.grow(np.array([0, 0.6, 0.4, 0]), nobody).tolist() == [True, True, False, False]
    assert row.grow(np.array([0, 0.4, 0.6, 0]), nobody).tolist() == [False, False, True, True]
    assert row.grow(np.array([0, 0.4, 0.6, 0]), np.arange(4) == 2).tolist() == [True, True, False, False]


def test_cast_is_what_differs_little_and_the_unsure_are_like_their_neighbours():
    differs = np.array([0.02, 0.08, 0.09, 0.3])
    none = np.zeros((4, 4))
    assert objects._cast(differs, np.ones(4), none, GRAPH).tolist() == [True, True, False, False]
    to_shadow = np.zeros((4, 4))
    to_shadow[2, 0] = to_shadow[0, 2] = 100 / GRAPH.vote  # so strong a bond makes two alike
    assert objects._cast(differs, np.ones(4), to_shadow, GRAPH).tolist() == [True, True, True, False]
    assert objects._cast(np.zeros(0), np.zeros(0), np.zeros((0, 0)), GRAPH).tolist() == []
    # Of two that are bound, the heavier decides.
    pair, strong = np.array([0.0, 0.3]), 1e6 * (1 - np.eye(2))
    assert objects._cast(pair, np.array([1.0, 3.0]), strong, GRAPH).tolist() == [False, False]
    assert objects._cast(pair, np.array([3.0, 1.0]), strong, GRAPH).tolist() == [True, True]


def test_sums_and_means_over_superpoints():
    superpoints = Superpoints(
        np.array([4, 1, 2]), np.array([0, 1, 1]), np.ones(2), *np.zeros((2, 2, 2)), *np.zeros((2, 2))
    )
    weights = np.array([9.0, 1.0, 3.0, 9.0, 2.0])
    np.testing.assert_array_equal(superpoints.gather(weights), [2, 4])
    np.testing.assert_array_equal(superpoints.spread(np.array([5.0, 7.0]), 6), [0, 7, 7, 0, 5, 0])
    np.testing.assert_allclose(superpoints.means(np.array([0, 1.0, 2.0, 0, 6.0]), weights), [6, 7 / 4])
    assert superpoints.means(weights, np.zeros(5)).tolist() == [0, 0]


def test_signs_are_blend_weights_under_the_marks():
    scene = labelled_scene(features=False)
    size = (scene.cameras.height, scene.cameras.width)

    def under(mask, frame):
        return blend_weight_sums(scene, float(scene.cameras.times[frame]), frame, mask[..., None].astype(np.float32))[
            :, 0
        ]

    box, point, beside = Box(2, True, (5, 5, 40, 30)), Point(2, True, (20, 20)), Point(2, False, (24, 20))
    stroke = Brush(4, True, [(30, 20), (40, 20)], 2.0)
    signs = objects._signs(scene, [box, point, beside, stroke])
    inside, everywhere = box.pixels(size), np.ones(size, bool)
    np.testing.assert_allclose(signs.seen, under(everywhere, 2) + under(everywhere, 4), atol=1e-4)
    np.testing.assert_allclose(signs.inside, under(inside, 2), atol=1e-4)
    np.testing.assert_allclose(signs.outside, under(~inside, 2), atol=1e-4)
    starts = [point.pixels(size) & inside, stroke.pixels(size)]
    for found, mask, frame in zip(signs.starts, starts, (2, 4), strict=True):
        np.testing.assert_allclose(found, under(mask, frame), atol=1e-5)
    np.testing.assert_allclose(signs.beside, [under(beside.pixels(size) & inside, 2)], atol=1e-5)
    np.testing.assert_allclose(signs.exact, [under(stroke.pixels(size), 4)], atol=1e-5)
    alone = objects._signs(scene, [box])
    np.testing.assert_allclose(alone.starts, [under(inside, 2)], atol=1e-4)
    assert not alone.exact and not alone.beside
    assert not objects._signs(scene, [stroke]).inside.any()


def test_how_much_of_a_mark_must_move():
    box, point, mask = Box(0, True, (1, 1, 9, 9)), Point(0, True, (3, 3)), Mask(0, True, square_mask(0))
    stroke, beside = Brush(0, True, [(3, 3)], 1.0), Point(0, False, (3, 3))
    for marks, share in (
        ([point], 0.2), ([box, point], 0.2), ([stroke], 0.2), ([box], 0.25), ([box, mask], 0.25), ([mask], 0.5),
        ([mask, beside], 0.5), ([box, beside], 0.25),
    ):  # fmt: skip
        assert objects._moving_fraction(marks, SELECT.thing) == share


class Pointing:
    """A scene of eight Gaussians, the first four of which stand; the graph and the blend weights are given."""

    def __init__(self, monkeypatch, moving, static):
        self.monkeypatch = monkeypatch
        self.scene = SimpleNamespace(ids=np.arange(8), moving=np.arange(8) > 3)
        graph = Graph(replace(moving, rows=moving.rows + 4), static)
        monkeypatch.setattr(objects, "graph_of", lambda scene, config: graph)
        # There is no picture: see test_query_superpixels.
        monkeypatch.setattr(objects, "_by_picture", lambda marks: False)

    def __call__(self, marks, likely=None, **signs):
        given = {
            "starts": [],
            "started_by": [],
            "beside": [],
            "exact": [],
            "inside": np.zeros(8),
            "outside": np.zeros(8),
            "seen": np.ones(8),
        }
        self.monkeypatch.setattr(objects, "_signs", lambda scene, marks: objects._Signs(**(given | signs)))
        found = point_out(self.scene, marks, likely)
        return None if found is None else np.flatnonzero(found).tolist()


@pytest.fixture
def pointing(monkeypatch):
    """Of what moves, and of what stands: two pairs of strong bonds with a weak one between them."""
    pairs = chain(np.ones(4), [1, 0.01, 1], blend=TWO_BLEND)
    return Pointing(monkeypatch, pairs, replace(pairs, kind=replace(MOVING, filled=STATIC.filled)))


POINT, STROKE = Point(0, True, (3, 3)), Brush(0, True, [(3, 3)], 1.0)
BOX = Box(0, True, (1, 1, 9, 9))


def weights(**given):
    values = np.zeros(8)
    for row, value in given.items():
        values[int(row[1:])] = value
    return values


@pytest.mark.parametrize(("near", "rest", "first", "both"), [(4, 6, 0.91, 0.89), (0, 2, 0.71, 0.69)])
def test_a_thing_fills_its_box(pointing, near, rest, first, both):
    """Of what moves in a box nine tenths belong to the thing; of what stands seven. A point asks for nothing of the kind."""
    pair = [near, near + 1]
    for fraction, expected in ((first, pair), (both, [*pair, rest, rest + 1])):
        start = weights(**{f"r{near}": fraction, f"r{rest}": 1 - fraction})
        found = pointing([BOX], starts=[start], inside=start)
        assert found == expected or (fraction == both and set(pair) < set(found))
        assert pointing([POINT], starts=[start]) == pair


def test_what_an_exact_mark_covers_is_held_but_for_what_is_against(pointing):
    start = weights(r4=1.0)
    assert pointing([STROKE], starts=[start], exact=[weights(r7=0.51)]) == [4, 5, 7]
    assert pointing([STROKE], starts=[start], exact=[weights(r7=0.49)]) == [4, 5]
    assert pointing([STROKE, STROKE], starts=[start], exact=[weights(r6=0.51), weights(r7=0.51)]) == [4, 5, 6, 7]
    assert pointing([STROKE], starts=[start], exact=[weights(r7=0.6)], beside=[weights(r7=0.6)]) == [4, 5]
    assert pointing([STROKE], starts=[start], exact=[weights(r7=0.6)], seen=weights(r4=1.0, r5=1.0)) == [4, 5]


def test_each_point_is_within_one_piece(monkeypatch):
    pairs = chain(np.ones(4), [1, 0.9, 1], piece=np.array([0, 0, 0, 1]), kind=replace(MOVING, sizes=(0.8, 1.0)))
    pointing = Pointing(monkeypatch, pairs, pairs)
    assert pointing([POINT], starts=[weights(r4=1.0)]) == [4, 5, 6]
    assert pointing([BOX], starts=[weights(r4=1.0)], inside=np.ones(8)) == [4, 5, 6, 7]
    assert pointing([POINT], starts=[weights(r4=1.0), weights(r7=1.0)]) == [4, 5, 6, 7]


def test_words_are_evidence_against_what_they_do_not_mean(monkeypatch):
    whole = chain(np.ones(4), [1, 1, 1])
    pointing = Pointing(monkeypatch, whole, whole)
    likely = weights(r4=1.0, r5=0.9, r6=0.1, r7=0.0)
    assert pointing([POINT], likely, starts=[weights(r4=1.0)]) == [4, 5]


MOVERS = np.array([0, 0, 1, 1])


def test_a_click_means_one_of_the_movers_and_all_of_it(pointing):
    """The second superpoint of the first mover comes to light later: no bond leads to it."""
    lone = chain(np.ones(4), [0, 1, 1], mover=MOVERS)
    given = Pointing(pointing.monkeypatch, lone, lone)
    assert given([POINT], starts=[weights(r4=1.0)], seen=weights(r4=1.0, r6=1.0, r7=1.0)) == [4, 5]
    assert given([POINT], starts=[weights(r6=1.0)], seen=weights(r4=1.0, r6=1.0, r7=1.0)) == [6, 7]
    alone = Pointing(pointing.monkeypatch, replace(lone, mover=None), lone)
    assert alone([POINT], starts=[weights(r6=1.0)]) == [5, 6, 7]


def test_a_box_leaves_out_a_mover_that_lies_outside_of_it(pointing):
    linked = chain(np.ones(4), [1, 1, 1], mover=MOVERS)
    given, start = Pointing(pointing.monkeypatch, linked, linked), weights(r4=1.0, r5=1.0, r6=0.4)
    assert given([BOX], starts=[start], inside=start, outside=weights(r7=1.0)) == [4, 5]
    unknown = Pointing(pointing.monkeypatch, replace(linked, mover=np.full(4, -1)), linked)
    assert unknown([BOX], starts=[start], inside=start, outside=weights(r7=1.0)) == [4, 5, 6]


def test_a_mover_is_held_by_what_is_seen_of_it():
    superpoints = chain(np.ones(5), [1, 1, 1, 1], mover=np.array([0, 0, 1, 1, -1]))
    seen = np.array([1.0, 3.0, 1.0, 1.0, 5.0])
    held, others = superpoints.held_movers(seen * [0, 1, 0, 1, 1], seen)
    assert held.tolist() == [True, True, False, False, False] and others.tolist() == [False, False, True, True, False]
    for alone in (None, np.array([0, 0, 0, 0, -1])):
        assert not np.any(replace(superpoints, mover=alone).held_movers(seen, seen))
