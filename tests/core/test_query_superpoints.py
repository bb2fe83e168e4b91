"""Superpoints and what a prompt makes of them, against loops over Gaussians, groups and pixels."""

import cmath
import math
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from f4x_core.errors import F4xError
from f4x_core.geometry import spherical_harmonics
from f4x_core.query import k_means, objects
from f4x_core.query.marks import Box, Brush, Lasso, Mask, Point, check_marks
from f4x_core.query.objects import Graph, Superpoints, point_out, superpoints_of
from f4x_core.query.select_config import MOVING, SELECT, STATIC, Cutting, KindConfig

GRAPH = SELECT.graph

MADE = (21, 26)
"""Moving and static Gaussians of the made-up scene: odd numbers, so that means and medians differ."""


class MadeUp:
    """As much of a scene as superpoints need: random places and presence, looks and colours, some out of range."""

    def __init__(self, seed, static=MADE[1], features=True):
        random = np.random.default_rng(seed)
        count = MADE[0] + static
        self.ids = np.arange(count)
        self.moving = random.permutation(count) < MADE[0]
        # Small numbers: lengths below 1, which a bound must not lift.
        self.places = {time: 0.03 * random.normal(size=(count, 3)) + (0, 0, 0.1) for time in np.arange(8.0)}
        shown = random.random((8, MADE[0])) * (random.random((8, MADE[0])) < 0.5)
        self.dynamic = SimpleNamespace(presence=lambda time: shown[int(time)])
        self.colours = random.uniform(-0.4, 1.4, (count, 3))
        self.latents = lambda: 0.2 * latents + 0.4
        latents = random.normal(size=(count, 5)) * (2, 1.5, 1, 0.4, 0.3)
        decode = lambda head, latents: latents.copy()  # noqa: E731
        self.features = SimpleNamespace(names=("visual",), decode=decode) if features else None
        self.cameras = Cameras(random.normal(size=3) * 0.02)

    def posed(self, time):
        sh = np.stack([spherical_harmonics.dc_from_rgb(self.colours + time), np.ones_like(self.colours)], 1)
        return SimpleNamespace(means=self.places[time], sh=sh)


class Cameras:
    """Of eight frames; the first one's centre is known, no other camera is."""

    width, height, times = 64, 40, np.arange(8.0)

    def __init__(self, centre):
        self._centre = centre

    def __len__(self):
        return 8

    def __getitem__(self, frame):
        assert frame == 4  # the middle one
        return SimpleNamespace(center=self._centre)


@pytest.fixture
def light(monkeypatch):
    """Of the Gaussians of the made-up scene: blend weights of very unequal size, one of them 0, how much their pixels differ, and
    what part of these lies between parts of a thing."""
    random = np.random.default_rng(5)
    weights, differs = random.random(sum(MADE)) ** 6, 0.2 * random.random(sum(MADE))
    held = random.random(sum(MADE))
    weights[3] = 0

    def difference(scene, views, columns):
        assert (views, columns) == (GRAPH.views, GRAPH.columns)
        count = len(scene.ids)
        return weights[:count].copy(), (weights * differs)[:count]

    def between(scene, thing, views, columns):
        assert (views, columns) == (GRAPH.glances, GRAPH.columns)
        assert not thing[~scene.moving].any()
        count = len(scene.ids)
        return weights[:count].copy(), (weights * held)[:count]

    monkeypatch.setattr(objects, "difference", difference)
    monkeypatch.setattr(objects, "between", between)
    return weights, differs, held


def group_by_loops(place, appearance, weights, count):
    """`_group`: k-means from the same random rows, groups in the order of their first row's number."""
    colours = [row[-3:] / GRAPH.colour for row in appearance]
    joint = np.float32([[*p, *(GRAPH.features * a[:-3]), *c]
                        for p, a, c in zip(place, appearance, colours, strict=True)])  # fmt: skip
    centres = joint[np.random.default_rng(0).permutation(len(joint))[:count]].astype(float)

    def nearest():
        return np.array([np.argmin([((row - centre) ** 2).sum() for centre in centres]) for row in joint.astype(float)])

    for _ in range(GRAPH.rounds):
        index = nearest()
        centres = np.array(
            [joint[index == k].mean(0) if (index == k).any() else 0 * joint[0] for k in range(len(centres))]
        )
    index = np.unique(nearest(), return_inverse=True)[1]
    members = [index == k for k in range(index.max() + 1)]
    means = [np.array([np.average(values[rows], axis=0, weights=weights[rows]) for rows in members])
             for values in (place, appearance)]  # fmt: skip
    return index, np.array([weights[rows].sum() for rows in members]), *means


def squares(one, other):
    return np.array([[((a - b) ** 2).sum() for b in other] for a in one])


def ways_by_loops(places, presence, index, weights):
    """(P,T,3) places of groups of `places (n,T,3)`, and (P,T) whether they are there."""
    ways, there = [], []
    for k in range(index.max() + 1):
        own = index == k
        held = weights[own, None] * (presence[own] + GRAPH.absent)
        ways.append([np.average(places[own, t], axis=0, weights=held[:, t]) for t in range(places.shape[1])])
        share = np.average(presence[own], axis=0, weights=weights[own])
        there.append(share >= GRAPH.present * share.max())
    return np.array(ways), np.array(there)


def apart_by_loops(ways, there):
    far = np.full((len(ways), len(ways)), np.inf)
    for i, j in np.ndindex(far.shape):
        if (both := there[i] & there[j]).any():
            far[i, j] = ((ways[i] - ways[j])[both] ** 2).sum(1).mean()
    return far


def bonds_by_loops(far, appearance, neighbours):
    unlike = squares(appearance, appearance)
    count = min(neighbours, len(far) - 1)
    reach = np.array([sorted(np.delete(far[i], i))[count - 1] for i in range(len(far))])
    pairs = [(i, j) for i, j in np.ndindex(far.shape) if i != j and far[i, j] <= max(reach[i], reach[j])]
    pairs, reach = [pair for pair in pairs if np.isfinite(far[pair])], reach[np.isfinite(reach)]
    unit = np.median([unlike[pair] for pair in pairs])
    bonds, near = np.zeros(far.shape), np.zeros(far.shape)
    for pair in pairs:
        near[pair] = math.exp(-far[pair] / np.median(reach))
        bonds[pair] = near[pair] * math.exp(-unlike[pair] / unit)
    return bonds, near


def pieces(tracks, near):
    """(P,) int: the pieces of superpoints along `tracks` whose neighbours are `near (P,P)` > 0."""
    return objects._pieces(objects._changes(tracks, near), len(near), GRAPH)


def strengthened_by_loops(bonds, near, ways, there):
    pairs = [(i, j) for i in range(len(near)) for j in range(len(near)) if near[i, j] > 0]
    far = [
        [np.linalg.norm(ways[i, t] - ways[j, t]) for t in range(there.shape[1]) if there[i, t] and there[j, t]]
        for i, j in pairs
    ]
    usual = np.median(np.concatenate(far))
    changes = [(max(own) - min(own)) / (np.mean(own) + usual) for own in far]
    bonds = bonds.copy()
    for (i, j), change in zip(pairs, changes, strict=True):
        steady = math.exp(-((change / max(GRAPH.rigid, np.median(changes))) ** 2))
        bonds[i, j] += GRAPH.together * steady * (near[i, j] - bonds[i, j])
    return bonds


def appearance_by_loops(scene, directions):
    """As inner products of all rows: the directions of the features are known up to their signs."""
    colours = 0.7 * np.clip(scene.colours, 0, 1)
    if scene.features is None:
        return colours @ colours.T
    features = scene.latents() - scene.latents().mean(0)
    features = features / np.linalg.norm(features, axis=1, keepdims=True)
    left, size, _ = np.linalg.svd(features, full_matrices=False)
    kept = left[:, :directions] * size[:directions]
    return kept @ kept.T + colours @ colours.T


def sweep_by_loops(strength, most, order, fits, contrast):
    """The number of superpoints in the set whose cut bonds are the weakest."""
    best = (np.inf, len(order))
    for size in np.flatnonzero(fits) + 1:
        inside = np.isin(np.arange(len(order)), order[:size])
        cut, could = (part[inside][:, ~inside].sum() + out[inside].sum() for part, out in (strength, most))
        volume = strength[0][inside].sum() + strength[1][inside].sum()
        best = min(best, ((cut / could) ** contrast * (cut / volume) ** (1 - contrast), size))
    return best[1]


def walk_by_loops(superpoints, marked, against):
    """Scores of the superpoints that are not `against`: the random walk summed up step by step."""
    free = np.flatnonzero(~against)
    bonds = superpoints.bonds
    leaving = [(1 + superpoints.kind.escape) * (bonds[i].sum() + superpoints.blend[i]) for i in free]
    walkers = marked[free].astype(float)
    visits = walkers.copy()
    for _ in range(4000):
        walkers = np.array([sum(bonds[i, j] * walkers[b] / leaving[b] for b, j in enumerate(free) if bonds[i, j])
                            for i in free])  # fmt: skip
        visits += walkers
        if walkers.sum() < 1e-13 * visits.sum():
            break
    return np.array([visit / out if out else 0 for visit, out in zip(visits, leaving, strict=True)])


def grow_by_loops(superpoints, marked, against, filled=0.0):
    """`Superpoints.grow`, of that walk."""
    chosen, free = np.zeros(len(marked), bool), np.flatnonzero(~against)
    if marked[free].any():
        order = np.argsort(-walk_by_loops(superpoints, marked, against), kind="stable")
        strength, most = (
            (part[np.ix_(free, free)], out[free] + [part[i][against].sum() for i in free])
            for part, out in (
                (superpoints.bonds, superpoints.blend),
                (superpoints.near, np.full(len(marked), GRAPH.blending)),
            )
        )
        fits = []
        for size in range(1, len(order) + 1):
            inside = free[order[:size]]
            share = superpoints.weight[inside].sum() / superpoints.weight.sum()
            held = marked[inside].sum() / marked[free].sum()
            large = share > superpoints.kind.sizes[1] and size > 1
            fits.append(share >= superpoints.kind.sizes[0] and not large and held >= filled - 1e-12)
        chosen[free[order[: sweep_by_loops(strength, most, order, fits, superpoints.kind.cutting.contrast)]]] = True
    return chosen


def random_superpoints(seed, count=9, **fields):
    """Superpoints along a line, bonds between those that are near, some much like the background."""
    random = np.random.default_rng(seed)
    place = np.sort(random.random(count))
    near = np.exp(-(((place[:, None] - place) / 0.12) ** 2))
    alike = random.random((count, count))
    np.fill_diagonal(near, 0)
    bonds, blend = near * (alike + alike.T) / 2, 3 * random.random(count) ** 4
    weight = random.random(count) ** 3
    cast = np.zeros(count, bool)
    return Superpoints(np.arange(count), np.arange(count), weight, bonds, near, blend, cast, **fields)


@pytest.mark.parametrize("escape", [1e-3, 0.3])
@pytest.mark.parametrize("filled", [0.0, 0.9])
@pytest.mark.parametrize("contrast", [0.0, 0.9])
def test_a_thing_grows_as_the_walk_and_the_cut_say(escape, filled, contrast):
    sizes = set()
    for seed in range(30):
        kind = KindConfig(escape, (0.1, 0.6), 0.0, Cutting(contrast, 0.0))
        superpoints = random_superpoints(seed, kind=kind)
        random = np.random.default_rng(seed)
        marked = random.random(9) * (random.random(9) < 0.25)
        against = random.random(9) < 0.2
        expected = grow_by_loops(superpoints, marked, against, filled)
        np.testing.assert_array_equal(superpoints.grow(marked, against, filled=filled), expected)
        sizes.add(int(expected.sum()))
    assert len(sizes) > 4


def test_other_evidence_counts_like_blending_in():
    superpoints, nobody = random_superpoints(3), np.zeros(9, bool)
    doubt = np.random.default_rng(4).random(9)
    blended = replace(superpoints, blend=superpoints.blend + GRAPH.blending * doubt)
    marked = np.eye(9)[4]
    twice = GRAPH.blending * 2  # what both could be
    found = superpoints.grow(marked, nobody, doubt)
    order = np.argsort(-walk_by_loops(blended, marked, nobody), kind="stable")
    fits = np.cumsum(superpoints.weight[order]) / superpoints.weight.sum() >= MOVING.sizes[0]
    count = sweep_by_loops((blended.bonds, blended.blend), (blended.near, np.full(9, twice)), order, fits, 0.0)
    assert set(np.flatnonzero(found)) == set(order[:count])


def test_a_superpoint_that_no_walker_reaches_is_not_chosen():
    superpoints = random_superpoints(0)
    superpoints.blend[4] = 0
    for bonds in (superpoints.bonds, superpoints.near):
        bonds[4] = bonds[:, 4] = 0
    for start in (1, 7):
        found = superpoints.grow(np.eye(9)[start], np.zeros(9, bool))
        assert found[start] and not found[4]


def test_where_no_set_fits_it_is_everything():
    nothing = np.zeros((3, 3)), np.ones(3)
    assert objects._sweep(nothing, nothing, np.arange(3), np.zeros(3, bool), Cutting(0.5, 0.0)) == 3
    assert objects._sweep(nothing, nothing, np.arange(3), np.array([False, True, True]), Cutting(0.5, 0.0)) == 2


@pytest.mark.parametrize(("static", "features"), [(MADE[1], True), (MADE[1], False), (0, True)])
def test_superpoints_of_a_scene_by_loops(monkeypatch, light, static, features):
    few = replace(GRAPH, moving=9, static=7, neighbours=3, directions=2)
    scene = MadeUp(0, static, features)
    moving, rest = np.flatnonzero(scene.moving), np.flatnonzero(~scene.moving)
    looks, weights, differs = objects._appearance(scene, few), light[0][: len(scene.ids)] + objects.UNSEEN, light[1]
    places = np.stack([scene.places[time][moving] for time in range(8)], 1)
    places /= math.sqrt(sum(column.var() for column in places.reshape(-1, 24).T) / 8)  # of a place: mean over times
    joint = np.concatenate([places[:, time] for time in (0, 4, 7)], 1) / math.sqrt(3)
    index, weight, _, mine = group_by_loops(joint, looks[moving], weights[moving], 9)
    presence = np.stack([scene.dynamic.presence(time) for time in range(8)], 1)
    ways = ways_by_loops(places, presence, index, weights[moving])
    bonds, near = bonds_by_loops(apart_by_loops(*ways), mine, 3)
    bonds = strengthened_by_loops(bonds, near, *ways)
    sums = [sum(light[0][row] * differs[row] for row in moving[index == k]) for k in range(len(weight))]
    blend = [
        GRAPH.blending * math.exp(-((part / whole / GRAPH.differs) ** 2))
        for part, whole in zip(sums, weight, strict=True)
    ]
    cast = objects._cast(np.array(sums) / weight, weight, bonds, few)
    for k in np.flatnonzero(cast):
        own = moving[index == k]
        cast[k] = (light[0] * light[2])[own].sum() <= 0.5 * light[0][own].sum()
    assert 0 < weight[cast].sum() < 0.5 * weight.sum()
    if static:
        away = [row - scene.cameras[4].center for row in scene.places[4.0][rest]]
        far = [np.linalg.norm(row) for row in away]
        sight = np.array([[*(8 * row / d), 1.5 * math.log(d)] for row, d in zip(away, far, strict=True)])
        outlines = looks[rest].copy()
        outlines[:, :-3] *= GRAPH.static_features
        groups, mass, sights, standing = group_by_loops(sight, outlines, weights[rest], 7)
    moving_ones, static_ones = superpoints_of(scene, replace(SELECT, graph=few))
    np.testing.assert_array_equal(moving_ones.rows, moving)
    np.testing.assert_array_equal(moving_ones.index, index)
    expected = {"weight": weight, "bonds": bonds, "near": near, "blend": blend}
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(moving_ones, name), values, rtol=1e-4, atol=1e-7, err_msg=name)
    np.testing.assert_array_equal(moving_ones.cast, cast)
    assert cast.any() and not cast.all()
    np.testing.assert_array_equal(static_ones.rows, rest)
    if static:
        np.testing.assert_array_equal(static_ones.index, groups)
        bonds, near = bonds_by_loops(squares(sights, sights), standing, 3)
        for name, values in {"weight": mass, "bonds": bonds, "near": near, "blend": np.zeros(7)}.items():
            np.testing.assert_allclose(getattr(static_ones, name), values, rtol=1e-4, atol=1e-7, err_msg=name)


@pytest.mark.parametrize(("like", "cast"), [(10, True), (11, False)])
def test_where_most_of_what_moves_is_like_the_background_nothing_is_cast(monkeypatch, light, like, cast):
    """Of 21 Gaussians of equal weight some do not differ from what is behind."""
    scene, weights = MadeUp(0), np.ones(sum(MADE))
    differs = np.ones(sum(MADE))
    differs[np.flatnonzero(scene.moving)[:like]] = 0
    monkeypatch.setattr(objects, "difference", lambda *_: (weights.copy(), differs))
    monkeypatch.setattr(objects, "between", lambda *_: (weights, 0 * weights))
    assert superpoints_of(scene).moving.cast.any() == cast


@pytest.mark.parametrize("features", [True, False])
def test_appearance_is_the_main_directions_of_features_and_colours(features):
    scene = MadeUp(1, features=features)
    found = objects._appearance(scene, replace(GRAPH, directions=3))
    assert found.dtype == np.float32 and found.shape == (len(scene.ids), 6 if features else 3)
    np.testing.assert_allclose(found @ found.T, appearance_by_loops(scene, 3), atol=1e-5)


def test_another_head_tells_nothing_of_looks():
    scene = MadeUp(1)
    scene.features.names = ("text",)
    np.testing.assert_allclose(objects._appearance(scene, GRAPH), 0.7 * np.clip(scene.colours, 0, 1), atol=1e-6)


def test_no_rows_make_no_groups():
    index, weight, place, looks = objects._group(np.zeros((0, 3)), np.zeros((0, 8)), np.zeros(0), 4, GRAPH)
    assert (index.shape, weight.shape, place.shape, looks.shape) == ((0,), (0,), (0, 3), (0, 8))


@pytest.mark.parametrize("block", [3, 4096])
def test_the_nearest_centre_by_loops(monkeypatch, block):
    monkeypatch.setattr(k_means, "BLOCK", block)
    random = np.random.default_rng(2)
    points, centres = random.normal(size=(11, 3)), 2 * random.normal(size=(6, 3))
    expected = [np.argmin(np.linalg.norm(centres - point, axis=1)) for point in points]
    np.testing.assert_array_equal(k_means.nearest(points, centres), expected)


def test_means_are_weighted_and_those_of_nobody_are_0():
    index, weight = np.array([0, 2, 2]), np.array([0.1, 0.1, 0.3])
    values = np.array([[1.0, 5], [2, 6], [6, 8]])
    np.testing.assert_allclose(k_means.means(index, weight, values, 4), [[1, 5], [0, 0], [5, 7.5], [0, 0]])


@pytest.mark.parametrize(("count", "neighbours"), [(12, 4), (12, 12), (3, 12), (2, 12)])
def test_bonds_lead_to_neighbours_that_look_alike(count, neighbours):
    random = np.random.default_rng(count)
    place, looks = random.normal(size=(count, 3)), 0.1 * random.normal(size=(count, 4))
    bonds, near = objects._bonds(objects._squares(place, place), looks, neighbours)
    expected, expected_near = bonds_by_loops(squares(place, place), looks, neighbours)
    np.testing.assert_allclose(bonds, expected, atol=1e-12)
    np.testing.assert_allclose(near, expected_near, atol=1e-12)
    np.testing.assert_allclose(
        objects._bonds(1e-6 * objects._squares(place, place), looks, neighbours)[0], expected, atol=1e-9
    )


def test_one_superpoint_alone_has_no_bonds():
    bonds, near = objects._bonds(np.zeros((1, 1)), np.ones((1, 4)), 12)
    assert bonds.tolist() == near.tolist() == [[0]]
    bonds, near = objects._bonds(1 - np.eye(3), np.ones((3, 4)), 12)  # equal looks: nothing is unlike
    np.testing.assert_array_equal(bonds, near)


SIZE = (12, 20)


def marked_by_loops(mark, size):
    """(H,W) bool: every pixel's centre against the mark, sides of a lasso by winding angles."""
    result = np.zeros(size, bool)
    reach = max(1, 0.006 * size[1])
    for y, x in np.ndindex(*size):
        at = np.array([x + 0.5, y + 0.5])
        if isinstance(mark, Point):
            result[y, x] = math.dist(at, mark.at) <= reach
        elif isinstance(mark, Box):
            result[y, x] = (mark.corners[:2] <= at).all() and (at <= mark.corners[2:]).all()
        elif isinstance(mark, Brush):
            steps = np.linspace(0, 1, 2001)[:, None]
            path = np.concatenate([(1 - steps) * a + steps * b for a, b in pairwise(np.array(mark.path))])
            result[y, x] = np.linalg.norm(path - at, axis=1).min() <= max(reach, mark.radius)
        else:
            corners = [complex(*(corner - at)) for corner in np.array(mark.outline)]
            turns = [cmath.phase(b / a) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
            result[y, x] = abs(sum(turns)) > math.pi
    return result


@pytest.mark.parametrize("size", [SIZE, (8, 400)])
@pytest.mark.parametrize(
    "mark",
    [
        Point(0, True, [3.5, 4.5]),
        Box(0, True, np.array([2.5, 1.5, 9.5, 6.5])),
        Brush(0, True, [[2.2, 2.1], [9.3, 6.2], [12.1, 2.3]], 1.7),
        Brush(0, True, [[2.2, 2.1], [9.3, 6.2]]),
        Lasso(0, True, [[2.2, 1.1], [11.3, 2.4], [9.7, 6.9], [6.1, 3.3], [1.3, 7.2]]),
    ],
)
def test_marks_by_loops(mark, size):
    np.testing.assert_array_equal(mark.pixels(size), marked_by_loops(mark, size))


@pytest.mark.parametrize(
    ("marks", "words"),
    [
        ([], "Nothing says where the thing is"),
        ([Point(0, False, (3, 3))], "Nothing says where the thing is"),
        ([Point(5, True, (3, 3))], "no frame 5"),
        ([Point(0, True, (30, 3))], "outside the picture"),
        ([Box(0, True, (5, 5, 5, 9))], "left, top, right, bottom"),
        ([Box(0, True, (50, 5, 60, 9))], "marks no pixel"),
        ([Brush(0, True, [])], "at least 1 points"),
        ([Brush(0, True, [[-9, -9]])], "marks no pixel"),
        ([Lasso(0, True, [[1, 1], [5, 5]])], "at least 3 points"),
        ([Lasso(0, True, [[1, 1], [5, 5], [np.nan, 2]])], "at least 3 points"),
        ([Mask(0, True, np.ones((3, 3)))], "shape"),
        ([Mask(0, True, np.zeros(SIZE))], "empty"),
    ],
)
def test_marks_that_mean_nothing_are_named(marks, words):
    with pytest.raises(F4xError, match=words):
        [mark.pixels(SIZE) for mark in check_marks(marks, 5)]


class Pointed:
    """Six Gaussians, two of them static, each moving one a superpoint; what they weigh in the marks is given."""

    def __init__(self, monkeypatch, sums, piece=None):
        self.ids, self.moving = np.arange(6), np.arange(6) > 1
        self.cameras = SimpleNamespace(height=SIZE[0], width=SIZE[1], times=10 + np.arange(5.0))
        bonds = np.zeros((4, 4))
        bonds[[0, 1, 2, 3], [1, 0, 3, 2]] = 1  # two pairs
        blend = np.full(4, 0.1)
        none = np.zeros(4, bool)
        moving = Superpoints(np.arange(2, 6), np.arange(4), np.ones(4), bonds, bonds, blend, none, piece=piece)
        wall = np.ones((2, 2)) - np.eye(2)
        static = Superpoints(
            np.arange(2),
            np.arange(2),
            np.ones(2),
            wall,
            wall,
            np.full(2, 0.1),
            none[:2],
            replace(MOVING, filled=STATIC.filled),
        )
        monkeypatch.setattr(objects, "graph_of", lambda scene, config: Graph(moving, static))
        monkeypatch.setattr(
            objects, "_by_picture", lambda marks: False
        )  # there is no picture: see test_query_superpixels
        monkeypatch.setattr(
            objects, "blend_weight_sums", lambda scene, time, frame, layers: self.sums(time, frame, layers)
        )
        self.given = sums

    def sums(self, time, frame, layers):
        assert time == 10 + frame
        result = np.array(self.given[frame], float).T
        assert layers.shape == (*SIZE, result.shape[1])
        return result

    def asked(self, *marks):
        found = point_out(self, marks)
        return None if found is None else np.flatnonzero(found).tolist()


NOWHERE, EVERYWHERE = [0, 0, 0, 0, 0, 0], [4, 4, 4, 4, 4, 4]


def point(frame, on=True):
    return Point(frame, on, (3, 3))


def box(frame):
    return Box(frame, True, (1, 1, 5, 5))


def test_each_point_on_every_frame_grows_a_thing_of_its_own(monkeypatch):
    first = [EVERYWHERE, EVERYWHERE, [0, 0, 2, 0, 0, 0]]
    second = [EVERYWHERE, EVERYWHERE, [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 3]]
    third = [EVERYWHERE, EVERYWHERE, [0, 0, 0, 0, 0, 3]]
    pointed = Pointed(monkeypatch, {1: first, 3: second, 4: third})
    assert pointed.asked(point(1)) == [2, 3]
    assert pointed.asked(point(3), point(3)) == [2, 3, 4, 5]
    assert pointed.asked(point(1), point(4)) == [2, 3, 4, 5]


def test_a_prompt_on_what_mostly_stands_means_nothing_that_moves(monkeypatch):
    """At a point a fifth of the weights is enough; in a box a quarter, unless a point goes with it; of a mask half."""
    on = [0, 4, 1, 0, 0, 0]
    pointed = Pointed(monkeypatch, {0: [EVERYWHERE, EVERYWHERE, on, NOWHERE]})
    assert pointed.asked(point(0), point(0, on=False)) == [2, 3]
    on[0] = 0.01
    assert pointed.asked(point(0), point(0, on=False)) == [0, 1]
    boxed = Pointed(monkeypatch, {0: [EVERYWHERE, EVERYWHERE, on]})
    on[:2] = 2, 1
    assert boxed.asked(box(0)) == [2, 3]
    on[0] = 2.01
    assert boxed.asked(box(0)) == [0, 1]
    mask = Mask(0, True, np.ones(SIZE))
    on[:2] = 0.5, 0.5
    assert boxed.asked(mask) == [2, 3]
    on[0] = 0.51
    assert boxed.asked(mask) == [0, 1]
    both = Pointed(monkeypatch, {0: [EVERYWHERE, EVERYWHERE, on, EVERYWHERE]})
    on[:2] = 0.4, 0.4
    assert both.asked(point(0), box(0)) == [2, 3]
    on[0] = 4.7
    assert both.asked(point(0), box(0)) == [0, 1]
    on[:3] = 0, 0, 0  # nobody is there
    assert both.asked(point(0), box(0)) is None


def test_what_is_beside_and_what_is_outside_take_superpoints_out(monkeypatch):
    """Those with 0.3 of the most marked one's weights or half of their own; those with more weight outside than inside."""
    on, beside = np.eye(6)[2:], [5, 9, 0, 1.01, 0, 3]
    four = [point(0)] * 4
    pointed = Pointed(monkeypatch, {0: [EVERYWHERE, EVERYWHERE, *on, beside]})
    # The greatest weight is that of a superpoint, 3: 1.01 is more than 0.3 of it.
    assert pointed.asked(*four, point(0, on=False)) == [2, 4]
    beside[3] = 0.89
    assert pointed.asked(*four, point(0, on=False)) == [2, 3, 4]
    own = Pointed(monkeypatch, {0: [[4, 4, 4, 1.7, 4, 4], EVERYWHERE, *on, beside]})
    assert own.asked(*four, point(0, on=False)) == [2, 4]
    beside[3], beside[5] = 0.0, 0.0
    assert pointed.asked(*four, point(0, on=False)) == [2, 3, 4, 5]
    inside = [4, 4, 3, 1.99, 2.01, 4]
    pointed = Pointed(monkeypatch, {0: [EVERYWHERE, inside, *on, inside]})
    assert pointed.asked(*four, box(0)) == [2, 4, 5]
    # A frame without a box says nothing of inside and outside.
    pointed = Pointed(monkeypatch, {0: [EVERYWHERE, inside, inside], 1: [EVERYWHERE, EVERYWHERE, *on]})
    assert pointed.asked(box(0), *[point(1)] * 4) == [2, 4, 5]
    pointed = Pointed(monkeypatch, {0: [EVERYWHERE, NOWHERE, *on, NOWHERE]})
    assert pointed.asked(*four, box(0)) is None  # nothing is left
