"""Superpoints and what a prompt makes of them, against loops over Gaussians, groups and pixels."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from f4x_core.features.models.prompt import check_prompt
from f4x_core.geometry import spherical_harmonics
from f4x_core.query import objects
from f4x_core.query.objects import Superpoints, point_out, superpoints_of

MADE = (21, 26)
"""Moving and static Gaussians of the made-up scene: odd numbers, so that means and medians differ."""


class MadeUp:
    """As much of a scene as superpoints need: random places at three times, looks and colours, some out of range."""

    def __init__(self, seed, static=MADE[1], features=True):
        random = np.random.default_rng(seed)
        count = MADE[0] + static
        self.ids = np.arange(count)
        self.moving = random.permutation(count) < MADE[0]
        # Small numbers: lengths below 1, which a bound must not lift.
        self.places = {time: 0.03 * random.normal(size=(count, 3)) + (0, 0, 0.1) for time in (0.0, 4.0, 7.0)}
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
        assert frame == 0
        return SimpleNamespace(center=self._centre)


@pytest.fixture
def light(monkeypatch):
    """Blend weights of the made-up scene's Gaussians: of very unequal size, one of them 0."""
    weights = np.random.default_rng(5).random(sum(MADE)) ** 6
    weights[3] = 0

    def total(scene, views, columns):
        assert (views, columns) == (objects.VIEWS, objects.COLUMNS)
        return weights[: len(scene.ids)].copy()

    monkeypatch.setattr(objects, "total_blend_weights", total)
    return weights


def group_by_loops(place, appearance, weights, count):
    """`_group`: k-means from the same random rows, groups in the order of their first row's number."""
    colours = [row[-3:] / objects.COLOUR for row in appearance]
    joint = np.float32([[*(objects.PLACED * p), *(objects.SEEN * a[:-3]), *c]
                        for p, a, c in zip(place, appearance, colours, strict=True)])  # fmt: skip
    centres = joint[np.random.default_rng(0).permutation(len(joint))[:count]].astype(float)

    def nearest():
        return np.array([np.argmin([((row - centre) ** 2).sum() for centre in centres]) for row in joint.astype(float)])

    for _ in range(objects.ROUNDS):
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


def bonds_by_loops(place, appearance):
    far, unlike = squares(place, place), squares(appearance, appearance)
    count = min(objects.NEIGHBOURS, len(place) - 1)
    reach = [sorted(np.delete(far[i], i))[count - 1] for i in range(len(place))]
    pairs = [
        (i, j) for i in range(len(place)) for j in range(len(place)) if i != j and far[i, j] <= max(reach[i], reach[j])
    ]
    unit = np.median([unlike[pair] for pair in pairs])
    bonds = np.zeros(far.shape)
    for pair in pairs:
        bonds[pair] = math.exp(-far[pair] / np.median(reach) - unlike[pair] / unit)
    return bonds, unit


def appearance_by_loops(scene):
    """As inner products of all rows: the directions of the features are known up to their signs."""
    colours = 0.7 * np.clip(scene.colours, 0, 1)
    if scene.features is None:
        return colours @ colours.T
    features = scene.latents() - scene.latents().mean(0)
    features = features / np.linalg.norm(features, axis=1, keepdims=True)
    left, size, _ = np.linalg.svd(features, full_matrices=False)
    kept = left[:, : objects.DIRECTIONS] * size[: objects.DIRECTIONS]
    return kept @ kept.T + colours @ colours.T


def sweep_by_loops(bonds, out, score, weight):
    order, best = sorted(range(len(score)), key=lambda i: -score[i]), (np.inf, 0)
    for size in range(1, len(order) + 1):
        inside = np.isin(np.arange(len(order)), order[:size])
        if weight[inside].sum() >= objects.MIN_FRACTION * weight.sum():
            leaving = bonds[inside][:, ~inside].sum() + out[inside].sum()
            best = min(best, (leaving / (bonds[inside].sum() + out[inside].sum()), size))
    return np.isin(np.arange(len(order)), order[: best[1]])


def walk_by_loops(superpoints, marked, against):
    """Scores of the superpoints that are not `against`: the random walk summed up step by step."""
    free = np.flatnonzero(~against)
    steps, lost = superpoints.steps, superpoints.lost
    leaving = [(1 + objects.ESCAPE) * (steps[i].sum() + lost[i]) for i in free]
    walkers = marked[free].astype(float)
    visits = walkers.copy()
    for _ in range(4000):
        walkers = np.array([sum(steps[i, j] * walkers[b] / leaving[b] for b, j in enumerate(free) if steps[i, j])
                            for i in free])  # fmt: skip
        visits += walkers
        if walkers.sum() < 1e-13 * visits.sum():
            break
    return np.array([visit / out if out else 0 for visit, out in zip(visits, leaving, strict=True)])


def grow_by_loops(superpoints, marked, against):
    """`Superpoints.grow`, of that walk."""
    chosen, free = np.zeros(len(marked), bool), np.flatnonzero(~against)
    if marked[free].any():
        out = np.array([superpoints.blend[i] + superpoints.bonds[i][against].sum() for i in free])
        score = walk_by_loops(superpoints, marked, against)
        chosen[free] = sweep_by_loops(superpoints.bonds[np.ix_(free, free)], out, score, superpoints.weight[free])
    return chosen


def random_superpoints(seed, count=9):
    """Superpoints along a line, bonds and steps between those that are near, some much like the background."""
    random = np.random.default_rng(seed)
    place = np.sort(random.random(count))
    near = np.exp(-(((place[:, None] - place) / 0.12) ** 2))
    bonds, steps = (near * (part + part.T) for part in random.random((2, count, count)))
    np.fill_diagonal(bonds, 0)
    np.fill_diagonal(steps, 0)
    blend, lost = 3 * random.random(count) ** 4, 0.3 * random.random(count) ** 2
    return Superpoints(np.arange(count), np.arange(count), random.random(count) ** 3, bonds, blend, steps, lost)


@pytest.mark.parametrize("escape", [1e-3, 0.3])
def test_a_thing_grows_as_the_walk_and_the_cut_say(monkeypatch, escape):
    monkeypatch.setattr(objects, "ESCAPE", escape)
    monkeypatch.setattr(objects, "MIN_FRACTION", 0.1)
    sizes = set()
    for seed in range(30):
        superpoints, random = random_superpoints(seed), np.random.default_rng(seed)
        marked = random.random(9) * (random.random(9) < 0.25)
        against = random.random(9) < 0.2
        expected = grow_by_loops(superpoints, marked, against)
        np.testing.assert_array_equal(superpoints.grow(marked, against), expected)
        sizes.add(int(expected.sum()))
    assert len(sizes) > 4


def test_the_score_of_the_walk_is_its_visits(monkeypatch):
    monkeypatch.setattr(objects, "ESCAPE", 0.3)
    scores = []
    sweep = objects._sweep
    monkeypatch.setattr(objects, "_sweep", lambda *parts: scores.append(parts[2]) or sweep(*parts))
    superpoints, marked, against = random_superpoints(3), np.arange(9.0), np.arange(9) == 5
    superpoints.grow(marked, against)
    np.testing.assert_allclose(scores[0], walk_by_loops(superpoints, marked, against), rtol=1e-6)


def test_a_superpoint_that_no_walker_reaches_is_not_chosen():
    superpoints = random_superpoints(0)
    superpoints.steps[4] = superpoints.steps[:, 4] = superpoints.lost[4] = 0
    superpoints.bonds[4] = superpoints.bonds[:, 4] = 0
    nobody = np.zeros(9, bool)
    for start in (1, 7):
        found = superpoints.grow(np.eye(9)[start], nobody)
        assert found[start] and not found[4]
        np.testing.assert_array_equal(found, grow_by_loops(superpoints, np.eye(9)[start], nobody))


def test_a_sweep_takes_the_set_with_the_lowest_conductance(monkeypatch):
    monkeypatch.setattr(objects, "MIN_FRACTION", 0.2)
    sizes = []
    for seed in range(40):
        made, random = random_superpoints(seed, 12), np.random.default_rng(seed)
        score = -abs(np.arange(12) - random.integers(12)) + random.normal(size=12)
        weight, blend = made.weight * (0.2 if seed % 2 else 5), made.blend * (1 + seed % 3)
        expected = sweep_by_loops(made.bonds, blend, score, weight)
        np.testing.assert_array_equal(objects._sweep(made.bonds, blend, score, weight), expected)
        sizes.append(int(expected.sum()))
    assert len(set(sizes)) > 5


def test_a_sweep_takes_one_of_fifty_equal_superpoints():
    """Without bonds no set is better than another, and the first has just the least fraction of the weights, 1 of 50."""
    found = objects._sweep(np.zeros((50, 50)), np.ones(50), -abs(np.arange(50) - 7.0), np.ones(50))
    assert np.flatnonzero(found).tolist() == [7]


@pytest.mark.parametrize(("static", "features"), [(MADE[1], True), (MADE[1], False), (0, True)])
def test_superpoints_of_a_scene_by_loops(monkeypatch, light, static, features):
    for name, value in {"SUPERPOINTS": 9, "BACKDROP": 7, "NEIGHBOURS": 3, "DIRECTIONS": 2}.items():
        monkeypatch.setattr(objects, name, value)
    scene = MadeUp(0, static, features)
    moving, rest = np.flatnonzero(scene.moving), np.flatnonzero(~scene.moving)
    looks, weights = objects._appearance(scene), light[: len(scene.ids)] + objects.UNSEEN
    tracks = np.concatenate([scene.places[time][moving] for time in (0.0, 4.0, 7.0)], 1)
    spread = math.sqrt(sum(column.var() for column in tracks.T) / 3)  # of a place, as a mean over the times
    index, weight, centres, mine = group_by_loops(tracks / math.sqrt(3) / spread, looks[moving], weights[moving], 9)
    sight = scene.places[0.0][rest] - scene.cameras[0].center
    sight = np.array([2 * row / np.linalg.norm(row) for row in sight]).reshape(-1, 3)
    backdrop, theirs = np.zeros(0), np.zeros((0, looks.shape[1]))
    if static:
        _, backdrop, _, theirs = group_by_loops(sight, looks[rest], weights[rest], 7)
    bonds, unit = bonds_by_loops(centres, mine)
    blend, lost, steps = np.zeros(len(mine)), np.zeros(len(mine)), np.zeros(bonds.shape)
    sharp = np.median(squares(mine, mine)) / objects.SHARP
    mass, other = (np.minimum(part, np.quantile(part, 0.95)) if len(part) else part for part in (weight, backdrop))
    mass, other = mass / mass.sum(), other / other.sum() if static else other
    for i, look in enumerate(mine):
        apart = [((look - another) ** 2).sum() for another in theirs]
        blend[i] = objects.BLENDING * math.exp(-np.mean(sorted(apart)[:3]) / unit) if static else 0
        lost[i] = mass[i] * sum(share * math.exp(-far / sharp) for share, far in zip(other, apart, strict=True))
        for j in range(len(mine)):
            steps[i, j] = math.exp(-((look - mine[j]) ** 2).sum() / sharp) * math.sqrt(mass[i] * mass[j]) * (i != j)
    found = superpoints_of(scene)
    np.testing.assert_array_equal(found.rows, moving)
    np.testing.assert_array_equal(found.index, index)
    for name, expected in {"weight": weight, "bonds": bonds, "blend": blend, "steps": steps, "lost": lost}.items():
        np.testing.assert_allclose(getattr(found, name), expected, rtol=1e-4, atol=1e-7, err_msg=name)


@pytest.mark.parametrize("features", [True, False])
def test_appearance_is_the_main_directions_of_features_and_colours(monkeypatch, features):
    monkeypatch.setattr(objects, "DIRECTIONS", 3)
    scene = MadeUp(1, features=features)
    found = objects._appearance(scene)
    assert found.dtype == np.float32 and found.shape == (len(scene.ids), 6 if features else 3)
    np.testing.assert_allclose(found @ found.T, appearance_by_loops(scene), atol=1e-5)


def test_another_head_tells_nothing_of_looks():
    scene = MadeUp(1)
    scene.features.names = ("text",)
    np.testing.assert_allclose(objects._appearance(scene), 0.7 * np.clip(scene.colours, 0, 1), atol=1e-6)


@pytest.mark.parametrize(("rows", "count"), [(30, 6), (30, 30), (5, 9), (1, 4)])
def test_groups_are_those_of_k_means(rows, count):
    random = np.random.default_rng(rows + count)
    parts = random.normal(size=(rows, 4)), random.normal(size=(rows, 5)), random.random(rows)
    found, expected = objects._group(*parts, count), group_by_loops(*parts, count)
    np.testing.assert_array_equal(found[0], expected[0])
    for one, other in zip(found[1:], expected[1:], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


def test_no_rows_make_no_groups():
    index, weight, place, looks = objects._group(np.zeros((0, 3)), np.zeros((0, 8)), np.zeros(0), 4)
    assert (index.shape, weight.shape, place.shape, looks.shape) == ((0,), (0,), (0, 3), (0, 8))


@pytest.mark.parametrize("block", [3, 4096])
def test_the_nearest_centre_by_loops(monkeypatch, block):
    monkeypatch.setattr(objects, "BLOCK", block)
    random = np.random.default_rng(2)
    points, centres = random.normal(size=(11, 3)), 2 * random.normal(size=(6, 3))
    expected = [np.argmin(np.linalg.norm(centres - point, axis=1)) for point in points]
    np.testing.assert_array_equal(objects._nearest(points, centres), expected)


def test_means_are_weighted_and_those_of_nobody_are_0():
    index, weight = np.array([0, 2, 2]), np.array([0.1, 0.1, 0.3])
    values = np.array([[1.0, 5], [2, 6], [6, 8]])
    np.testing.assert_allclose(objects._means(index, weight, values, 4), [[1, 5], [0, 0], [5, 7.5], [0, 0]])


def test_mass_is_clipped_at_a_quantile():
    weights = np.array([0.1, 0.2, 0.3, 0.1, 9.0])
    clipped = np.minimum(weights, np.quantile(weights, 0.95))
    np.testing.assert_allclose(objects._mass(0.01 * weights), clipped / clipped.sum())
    assert objects._mass(np.zeros(3)).tolist() == [0, 0, 0] and objects._mass(np.zeros(0)).shape == (0,)


@pytest.mark.parametrize(("count", "neighbours"), [(12, 4), (12, 12), (3, 12), (2, 12)])
def test_bonds_lead_to_neighbours_that_look_alike(monkeypatch, count, neighbours):
    monkeypatch.setattr(objects, "NEIGHBOURS", neighbours)
    random = np.random.default_rng(count)
    place, looks = random.normal(size=(count, 3)), 0.1 * random.normal(size=(count, 4))
    bonds, unit = objects._bonds(place, looks)
    expected, expected_unit = bonds_by_loops(place, looks)
    np.testing.assert_allclose(bonds, expected, atol=1e-12)
    assert unit == pytest.approx(expected_unit)
    np.testing.assert_allclose(objects._bonds(1e-3 * place, looks)[0], expected, atol=1e-9)


def test_one_superpoint_alone_has_no_bonds():
    bonds, unit = objects._bonds(np.ones((1, 3)), np.ones((1, 4)))
    assert bonds.tolist() == [[0]] and unit == 1
    assert objects._bonds(np.eye(3), np.ones((3, 4)))[1] < 1e-6  # equal looks: any difference would count


SIZE = (12, 20)


def marks_by_loops(prompt, size):
    """(H,W,3+n): every pixel's centre against every mark."""
    positive = prompt.points[prompt.labels]
    result = np.zeros((*size, 3 + max(1, len(positive))))
    reach = max(1, 0.006 * size[1])
    for y in range(size[0]):
        for x in range(size[1]):
            at = np.array([x + 0.5, y + 0.5])
            box = prompt.box
            inside = box is None or bool((box[:2] <= at).all() and (at <= box[2:]).all())
            on = [inside and math.dist(at, point) <= reach for point in positive] or [inside]
            beside = any(math.dist(at, point) <= reach for point in prompt.points[~prompt.labels])
            result[y, x] = [beside, not inside, inside, *on]
    return result


@pytest.mark.parametrize("size", [SIZE, (8, 400)])
@pytest.mark.parametrize(
    "marks",
    [
        {"points": [[3.5, 4.5], [9.2, 6.1]], "labels": [True, False]},
        {"points": [[3.5, 4.5], [4.5, 4.5], [12.0, 7.0]], "labels": [True, True, True]},
        {"box": [2.5, 1.5, 9.5, 6.5]},
        {"box": [2.5, 1.5, 9.5, 6.5], "points": [[9.5, 6.5], [2.0, 1.0], [5.5, 3.5]], "labels": [True, False, False]},
    ],
)
def test_marks_by_loops(marks, size):
    prompt = check_prompt(0, 1, size, **marks)
    found = objects._marks(prompt, size)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, marks_by_loops(prompt, size))


class Pointed:
    """Six Gaussians, two of them static, each moving one a superpoint; what they weigh in the marks is given."""

    def __init__(self, monkeypatch, sums):
        self.ids, self.moving = np.arange(6), np.arange(6) > 1
        self.cameras = SimpleNamespace(height=SIZE[0], width=SIZE[1], times=10 + np.arange(5.0))
        bonds = np.zeros((4, 4))
        bonds[[0, 1, 2, 3], [1, 0, 3, 2]] = 1  # two pairs
        blend = np.full(4, 0.1)
        superpoints = Superpoints(np.arange(2, 6), np.arange(4), np.ones(4), bonds, blend, bonds, blend)
        monkeypatch.setattr(objects, "superpoints_of", lambda scene: superpoints)
        monkeypatch.setattr(
            objects, "blend_weight_sums", lambda scene, time, frame, layers: self.sums(time, frame, layers)
        )
        self.given = sums

    def sums(self, time, frame, layers):
        assert time == 10 + frame
        result = np.array(self.given[frame], float).T
        assert layers.shape == (*SIZE, result.shape[1])
        return result

    def asked(self, **prompts):
        found = point_out(self, {int(name[1:]): check_prompt(0, 1, SIZE, **marks) for name, marks in prompts.items()})
        return None if found is None else np.flatnonzero(found).tolist()


NOWHERE, EVERYWHERE = [0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1]
POINT, TWO, FOUR = ({"points": [[3, 3]] * count} for count in (1, 2, 4))


def test_each_point_on_every_frame_grows_a_thing_of_its_own(monkeypatch):
    first = [NOWHERE, NOWHERE, EVERYWHERE, [0, 0, 2, 0, 0, 0]]
    second = [NOWHERE, NOWHERE, EVERYWHERE, [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 3]]
    third = [NOWHERE, NOWHERE, EVERYWHERE, [0, 0, 0, 0, 0, 3]]
    pointed = Pointed(monkeypatch, {1: first, 3: second, 4: third})
    assert pointed.asked(_1=POINT) == [2, 3]
    assert pointed.asked(_3=TWO) == [2, 3, 4, 5]
    assert pointed.asked(_1=POINT, _4=POINT) == [2, 3, 4, 5]


def test_a_prompt_on_what_mostly_stands_means_nothing_that_moves(monkeypatch):
    """At a point half of the weights is enough; in a box a quarter, unless a point goes with it."""
    on = [0, 1, 1, 0, 0, 0]
    pointed = Pointed(monkeypatch, {0: [NOWHERE, NOWHERE, EVERYWHERE, on]})
    assert pointed.asked(_0=POINT) == [2, 3]
    on[0] = 0.01
    assert pointed.asked(_0=POINT) is None
    on[0] = 2
    assert pointed.asked(_0={"box": [1, 1, 5, 5]}) == [2, 3]
    on[0] = 2.01
    assert pointed.asked(_0={"box": [1, 1, 5, 5]}) is None
    on[:2] = 0.4, 0.4
    assert pointed.asked(_0={"box": [1, 1, 5, 5]} | POINT) == [2, 3]
    on[0] = 0.7
    assert pointed.asked(_0={"box": [1, 1, 5, 5]} | POINT) is None
    on[:3] = 0, 0, 0  # nobody is there
    assert pointed.asked(_0=POINT) is None


def test_negative_points_and_what_is_outside_take_superpoints_out(monkeypatch):
    """Those with 0.3 of the most marked one's weights; those with more weight outside the box than inside."""
    beside, outside, inside, on = [5, 9, 0, 1.01, 0, 3], NOWHERE, EVERYWHERE, np.eye(6)[2:]
    pointed = Pointed(monkeypatch, {0: [beside, outside, inside, *on]})
    # The greatest weight is that of a superpoint, 3: 1.01 is more than 0.3 of it.
    assert pointed.asked(_0=FOUR) == [2, 4]
    beside[3] = 0.89
    assert pointed.asked(_0=FOUR) == [2, 3, 4]
    beside[3], beside[5] = 0.0, 0.0
    assert pointed.asked(_0=FOUR) == [2, 3, 4, 5]
    outside = [0, 0, 1, 1.01, 0.99, 0]
    pointed = Pointed(monkeypatch, {0: [NOWHERE, outside, inside, *on]})
    assert pointed.asked(_0=FOUR) == [2, 4, 5]
    # Over all frames: the first one sees the third superpoint outside.
    third = [NOWHERE, [0, 0, 0, 0, 3, 0], EVERYWHERE, *on]
    pointed = Pointed(monkeypatch, {0: third, 1: [NOWHERE, outside, inside, *on]})
    assert pointed.asked(_0=FOUR, _1=FOUR) == [2, 3, 5]
    pointed = Pointed(monkeypatch, {0: [NOWHERE, [9] * 6, inside, *on]})
    assert pointed.asked(_0=FOUR) is None  # nothing is left
