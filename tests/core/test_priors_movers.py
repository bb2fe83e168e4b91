"""Where moving objects are put, against plain forms: loops over pixels, tracks and frames, dense equations, worked cases."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.interpolate import RBFInterpolator

from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors
from f4x_core.priors import contact as touching
from f4x_core.priors import movers as module
from f4x_core.priors.heading import Extents, turn_along_way
from f4x_core.priors.own_motion import OwnMotion

HEIGHT, WIDTH, FRAMES = 60, 80, 4
LENS = np.array([[70.0, 0, 40], [0, 70, 30], [0, 0, 1]])


def world(frames=FRAMES, seed=0, kind="moving"):
    """Priors with a moving square, and maps of the inverse depth of an uneven ground."""
    rng = np.random.default_rng(seed)
    mask = np.zeros((frames, HEIGHT, WIDTH), bool)
    for t in range(frames):
        mask[t, 10:30, 20 + 2 * t : 36 + 2 * t] = True
        mask[t, 30:34, 24 + 2 * t : 28 + 2 * t] = True  # a foot
    lens = np.tile(LENS, (frames, 1, 1))
    cameras = CameraPath(lens, np.tile(np.eye(4), (frames, 1, 1)), np.arange(float(frames)), WIDTH, HEIGHT)
    priors = Priors(WIDTH, HEIGHT, np.arange(5, 5 + frames), mask=mask, cameras=cameras, camera_kind=kind)
    ground = np.linspace(0.2, 1.4, HEIGHT)[:, None] + np.linspace(0, 0.2, WIDTH)
    inverse = (ground * np.exp(0.01 * rng.standard_normal((frames, HEIGHT, WIDTH)))).astype(np.float32)
    confidence = rng.uniform(0.3, 0.9, (frames, HEIGHT, WIDTH)).astype(np.float32)
    return priors, inverse, confidence


def edge_by_hand(inverse, confidence, moving, own):
    """Columns of a region, their place beside its mean column, the ground carried up to its lower edge, trust."""
    columns = [x for x in range(WIDTH) if own[:, x].any()]
    bottom = [max(y for y in range(HEIGHT) if own[y, x]) for x in columns]
    middle = np.mean([x for y in range(HEIGHT) for x in range(WIDTH) if own[y, x]])
    deepest = max(bottom) + touching.MOVING_MARGIN + round(touching.GROUND_FRACTION * HEIGHT)
    rows, values, given = [], [], []
    for y in range(HEIGHT):
        for x, low in zip(columns, bottom, strict=True):
            if low + touching.MOVING_MARGIN < y <= deepest and not moving[y, x]:
                rows.append((1, x - middle, y - max(bottom) - 1))
                values.append(float(inverse[y, x]))
                given.append(float(confidence[y, x]) ** 2 + 1e-3)
    rows, values, given = np.array(rows), np.array(values), np.array(given)
    weight = given
    for _ in range(6):
        normal = np.einsum("p,pi,pj->ij", weight, rows, rows) + np.diag([0, 1, 1]) * given.sum()
        plane = np.linalg.solve(normal, np.einsum("p,pi,p->i", weight, rows, values))
        weight = given / (1 + ((values - rows @ plane) / (touching.GROUND_NOISE * abs(plane[0]))) ** 2)
    run = np.array(columns) - middle
    edge = plane[0] + plane[1] * run + plane[2] * (np.array(bottom) - max(bottom))
    hidden = np.mean([low >= HEIGHT - 2 for low in bottom])
    trust = min(max(1 - 2 * hidden, 0.1), 1) * min(max(np.sqrt(given.mean()), 0.1), 1)
    return columns, run, edge, trust


@pytest.mark.parametrize("low", [34, 58, 59])
def test_the_ground_below_a_region_is_carried_up_to_its_edge(low):
    priors, inverse, confidence = world()
    own = priors.mask[1].copy()
    own[30:low, 26:30] = True  # the foot leaves the picture, or nearly
    moving = own.copy()
    moving[45:50, 20:24] = True
    inverse[1, 44:48, 26:30] += 2  # something stands there
    found = touching.ground_edge(inverse[1], confidence[1], moving, own)
    columns, run, edge, trust = edge_by_hand(inverse[1], confidence[1], moving, own)
    np.testing.assert_array_equal(found.columns, columns)
    np.testing.assert_allclose(found.run, run)
    np.testing.assert_allclose(found.ground, edge, rtol=1e-6)
    assert found.trust == pytest.approx(trust, rel=1e-6)


def test_too_little_ground_is_none():
    own = np.zeros((HEIGHT, WIDTH), bool)
    own[40 : HEIGHT - touching.MOVING_MARGIN - 1, 10:18] = True  # one row of eight pixels is left below
    maps = np.linspace(0.2, 1.4, HEIGHT)[:, None] * np.ones(WIDTH), np.ones((HEIGHT, WIDTH))
    assert touching.ground_edge(*maps, own, own) is not None
    own[40 : HEIGHT - touching.MOVING_MARGIN - 1, 17] = False
    assert touching.ground_edge(*maps, own, own) is None
    inverse = np.arange(HEIGHT * WIDTH, dtype=float).reshape(HEIGHT, WIDTH)
    moving = own.copy()
    moving[:30] = True
    rim = ndimage.binary_dilation(own, iterations=12) & ~moving
    assert contact(inverse, maps[1], moving, own) == (np.median(inverse[rim]), touching.NO_CONTACT)
    everything = np.ones((HEIGHT, WIDTH), bool)
    assert contact(inverse, maps[1], everything, own)[0] == np.median(inverse)


@pytest.mark.parametrize(("side", "boxes", "columns"), [((20, 36), 1, 0), ((20, 23), 1, 13), ((20, 36), 4, 16)])
def test_what_is_upright_before_a_region_is_no_ground(side, boxes, columns):
    """The side of a box, as near above as below, hides the feet: all of them, or those of some columns. In all frames it tells
    that depth is poor."""
    _, inverse, confidence = world(seed=2)
    own = np.zeros((HEIGHT, WIDTH), bool)
    own[10:30, 20:36] = True
    inverse[:boxes, 30:, slice(*side)] = 2.0
    edges = [touching.ground_edge(*maps, own, own) for maps in zip(inverse, confidence, strict=True)]
    found = touching.without_upright(edges, np.tile(LENS, (FRAMES, 1, 1)))
    assert (0 if found[0] is None else len(found[0].columns)) == columns and len(found[3].columns) == 16


def contact(inverse, confidence, moving, own):
    return module._contact(inverse, moving, own, touching.ground_edge(inverse, confidence, moving, own))


def contact_by_hand(inverse, confidence, moving, own):
    _, run, edge, trust = edge_by_hand(inverse, confidence, moving, own)
    best = None
    for step in range(31):
        turn = (-1.5 + 0.1 * step) / WIDTH
        touching = np.quantile(edge / (1 + turn * run), 0.98)
        gap = 1 - edge / (touching * (1 + turn * run))
        score = np.mean(np.exp(-((gap / 0.03) ** 2))) - 0.05 * (turn * WIDTH) ** 2
        if best is None or score > best[0] + 1e-12:
            best = score, touching
    return max(best[1], 0.3 * edge.max()), trust


def test_a_region_is_turned_until_most_of_it_touches_the_ground():
    priors, inverse, confidence = world()
    tilted = inverse[0] * np.linspace(0.6, 1.5, WIDTH)
    for ground in (inverse[0], tilted):
        found = contact(ground, confidence[0], priors.mask[0], priors.mask[0])
        np.testing.assert_allclose(
            found, contact_by_hand(ground, confidence[0], priors.mask[0], priors.mask[0]), rtol=1e-6
        )
    assert found[1] > 0
    steep = 3 * np.maximum(inverse[0] * np.linspace(-8, 1.0, WIDTH) ** 3, 1e-3)  # hardly any ground but on one side
    found = contact(steep, confidence[0], priors.mask[0], priors.mask[0])
    np.testing.assert_allclose(found, contact_by_hand(steep, confidence[0], priors.mask[0], priors.mask[0]), rtol=1e-6)


def smoothed_by_hand(contact, trust, growth):
    count, logarithm = len(contact), np.log(contact)
    x = np.full(count, (logarithm * (trust + 1e-6)).sum() / (trust + 1e-6).sum())
    for _ in range(5):
        normal, right = np.zeros((count, count)), np.zeros(count)
        for i in range(count - 1):
            known = np.isfinite(growth[i])
            weight = 1 / touching.SIZE_NOISE**2 if known else 1 / (5 * touching.SIZE_NOISE) ** 2
            row = np.zeros(count)
            row[i : i + 2] = -1, 1
            normal += weight * np.outer(row, row)
            right += weight * row * (growth[i] if known else 0)
        for i in range(count - 2):
            row = np.zeros(count)
            row[i : i + 3] = 1, -2, 1
            normal += np.outer(row, row) / touching.PATH_NOISE**2
        for i in range(count):
            weight = (trust[i] + 1e-3) / touching.CONTACT_NOISE**2
            weight /= 1 + ((logarithm[i] - x[i]) / (2 * touching.CONTACT_NOISE)) ** 2
            weight *= touching.BEHIND_WEIGHT if logarithm[i] < x[i] else 1
            normal[i, i] += weight
            right[i] += weight * logarithm[i]
        x = np.linalg.solve(normal, right)
    return np.exp(x)


def test_an_objects_depth_over_time_is_its_robust_least_squares():
    rng = np.random.default_rng(0)
    contact, trust = np.exp(0.3 * rng.standard_normal(9)), rng.uniform(0.02, 1, 9)
    growth = 0.1 * rng.standard_normal(8)
    growth[[2, 5]] = np.nan
    found, certain = touching.smooth_object_depth(contact, trust, growth)
    np.testing.assert_allclose(found, smoothed_by_hand(contact, trust, growth), rtol=1e-9)
    np.testing.assert_allclose(certain, [min(max(one, 0.25), 1) for one in trust])
    assert certain.min() == 0.25 < certain.max()


def test_a_bodys_scale_is_a_weighted_quantile():
    rng = np.random.default_rng(0)
    for _ in range(20):
        ratio, trust = rng.uniform(0.5, 2, 11), rng.uniform(0, 1, 11) * (rng.random(11) < 0.7)
        total, goal = 0.0, 0.7 * (trust + 1e-3).sum()
        for nth in np.argsort(ratio):
            total += trust[nth] + 1e-3
            if total >= goal - 1e-12:
                break
        assert module.one_scale(ratio, trust) == ratio[nth]
    assert module.one_scale(np.array([1.0, 3.0]), np.zeros(2)) == 3  # all the same where none is trusted


def grown(factor, turn=0.1, spoilt=5):
    """Priors whose flow turns a region and lets it grow, wrong in some pixels."""
    priors, _, _ = world()
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    offset = (x - 25) + 1j * (y - 15)
    moved = factor * np.exp(1j * turn) * offset + 3 - 2j - offset
    flow = np.stack([moved.real, moved.imag], -1)
    flow[28:30] += spoilt
    priors.flow_forward = np.tile(flow, (FRAMES - 1, 1, 1, 1)).astype(np.float32)
    priors.flow_forward_mask = np.ones((FRAMES - 1, HEIGHT, WIDTH), bool)
    return priors


def growth_by_hand(priors, own):
    rows = [(x + 0.5, y + 0.5, *priors.flow_forward[0][y, x]) for y, x in np.argwhere(own)]
    here = np.array([x + 1j * y for x, y, _, _ in rows])
    there = here + np.array([u + 1j * v for _, _, u, v in rows])
    weight = np.ones(len(rows))
    for _ in range(4):
        a = here - (weight * here).sum() / weight.sum()
        b = there - (weight * there).sum() / weight.sum()
        factor = (weight * b * a.conj()).sum() / (weight * abs(a) ** 2).sum()
        weight = 1 / (1 + abs(b - factor * a) ** 2)
    return np.log(abs(factor))


def test_growth_is_that_of_a_robust_similarity():
    for factor in (1.06, 0.93):
        priors = grown(factor)
        found = touching.growth(priors, 0, priors.mask[0])
        assert found == pytest.approx(growth_by_hand(priors, priors.mask[0]), abs=1e-6)
        assert found == pytest.approx(np.log(factor), abs=0.02)
    assert touching.growth(grown(1.5, 0, 0), 0, priors.mask[0]) == pytest.approx(0.2)
    assert touching.growth(grown(0.6, 0, 0), 0, priors.mask[0]) == pytest.approx(-0.2)
    rolling = grown(1.0, 0, 0)
    rolling.flow_forward[..., 0] *= np.cos(np.arange(WIDTH))[:, None].T
    assert np.isnan(touching.growth(rolling, 0, priors.mask[0]))
    few = np.zeros((HEIGHT, WIDTH), bool)
    few[10, 20:50] = True
    priors = grown(1.05, spoilt=0)
    assert touching.growth(priors, 0, few) == pytest.approx(np.log(1.05), abs=1e-3)
    priors.flow_forward_mask[0, 10, 49] = False  # 29 pixels are too few
    assert np.isnan(touching.growth(priors, 0, few))
    assert np.isnan(touching.growth(replace(priors, flow_forward=None), 0, few))
    assert np.isnan(touching.growth(replace(priors, flow_forward_mask=None), 0, few))


def test_values_between_points_are_those_of_the_kernel_on_a_grid():
    rng = np.random.default_rng(0)
    points, values = rng.uniform([10, 5], [40, 30], (450, 2)), rng.uniform(1, 2, 450)
    x, y = rng.integers(11, 39, 70), rng.integers(6, 29, 70)
    found = module._smooth(points, values, y, x)
    smooth = RBFInterpolator(points[::3], values[::3], kernel="linear", smoothing=module.SMOOTH_PX)
    low, high = np.percentile(values, (2, 98))
    for n in range(70):
        column, row = (x[n] - x.min()) / 4, (y[n] - y.min()) / 4
        left, top = int(column), int(row)
        u, v = column - left, row - top
        nodes = np.array([(c, r) for r in (top, top + 1) for c in (left, left + 1)])
        at = nodes * 4 + (x.min() + 0.5, y.min() + 0.5)
        four = smooth(at)
        value = (1 - v) * ((1 - u) * four[0] + u * four[1]) + v * ((1 - u) * four[2] + u * four[3])
        assert found[n] == pytest.approx(min(max(value, low), high), rel=1e-6)
    slope = np.linspace(0, 1, 450)[np.argsort(np.argsort(points[:, 0]))]  # the first column lies beyond 2 and 98 %
    for values_there, limit in ((slope, 2), (-slope, 98)):
        found = module._smooth(points, values_there, np.full(30, 15), np.arange(10, 40))
        assert found[0] == pytest.approx(np.percentile(values_there, limit), rel=1e-9)
    few = module._smooth(points[:200], values[:200], y, x)
    all_used = RBFInterpolator(points[:200], values[:200], kernel="linear", smoothing=module.SMOOTH_PX)
    corner = np.flatnonzero((x - x.min()) % 4 + (y - y.min()) % 4 == 0)[0]
    expected = all_used(np.array([[x[corner] + 0.5, y[corner] + 0.5]]))[0]
    assert few[corner] == pytest.approx(np.clip(expected, *np.percentile(values[:200], (2, 98))), rel=1e-6)


def with_tracks(count=40, seed=0):
    priors, inverse, confidence = world()
    rng = np.random.default_rng(seed)
    start = rng.uniform([14, 6], [42, 36], (count, 2))
    priors.tracks = (start + 2 * np.arange(FRAMES)[:, None, None] * [1, 0]).astype(np.float32)
    priors.tracks[:, 0], priors.tracks[:, 1] = [-3.0, 20], [WIDTH + 4.0, HEIGHT + 4.0]
    priors.tracks_visible = rng.random((FRAMES, count)) < 0.8
    priors.tracks_motion = np.ones(count, np.float32)
    return priors, inverse, confidence


def test_tracks_belong_to_what_lies_under_most_of_their_samples():
    priors, _, _ = with_tracks()
    labels = ndimage.label(priors.mask)[0]
    labels[:, HEIGHT - 1, WIDTH - 1], labels[:, 20, 0] = 7, 9  # what lies outside counts with the rim
    labels[:, 0, 50], labels[:, 0, 0] = 8, 5
    priors.tracks[:, 2], priors.tracks[:, 3] = [50.5, -2.0], [-1.0, -1.0]
    found = module._labels_of_tracks(labels, priors)
    for t in range(FRAMES):
        for n in range(priors.tracks.shape[1]):
            x, y = np.floor(priors.tracks[t, n]).astype(int)
            expected = labels[t, min(max(y, 0), HEIGHT - 1), min(max(x, 0), WIDTH - 1)]
            assert found[t, n] == (expected if priors.tracks_visible[t, n] else 0)
    assert (found[:, :4].max(0) == [9, 7, 8, 5]).all()
    inside, seen = np.zeros((10, 5), bool), np.ones((10, 5), bool)
    inside[:6, 0] = True  # no more than 60 %
    inside[:7, 1] = True
    inside[:2, 2], seen[2:, 2] = True, False  # all, but only two
    inside[:3, 3], seen[3:, 3] = True, False
    priors.tracks_visible = seen
    np.testing.assert_array_equal(module._tracks_mostly_inside(inside, priors), [False, True, False, True, False])
    nothing = Priors(WIDTH, HEIGHT, np.arange(FRAMES))
    assert module._labels_of_tracks(labels, nothing).shape == (FRAMES, 0)
    assert module._tracks_mostly_inside(inside, nothing).shape == (0,)


def test_tracks_in_one_piece_of_the_mask_most_of_the_time_are_one_object():
    one, other = np.ones((8, 3), int), np.ones((8, 4), int)
    other[:2] = 2  # apart in two frames of eight
    other[:, 0], one[:, 0] = 0, 0
    assert module._in_one_component(one, other)
    other[2, 1:] = 2
    assert not module._in_one_component(one, other)
    one[:, 1] = 2  # a vote for every piece: the first of them
    assert not module._in_one_component(one, other)
    one[3:] = 0  # seen together in the first three alone, never in the same piece
    assert not module._in_one_component(one, other)
    one[:] = 0
    assert module._in_one_component(one, other), "never seen together: nothing tells them apart"


def test_tracks_with_neighbours_of_their_own_are_a_separate_object():
    rng = np.random.default_rng(0)
    count = 40
    priors = Priors(WIDTH, HEIGHT, np.arange(3))
    frames, some, others = np.arange(3), np.arange(count), np.arange(count, 2 * count)
    for apart, expected in ((60, True), (0, False)):
        left, right = rng.uniform(0, 20, (count, 2)), rng.uniform(0, 20, (count, 2)) + np.array([apart, 0])
        priors.tracks = np.tile(np.concatenate([left, right]), (3, 1, 1))
        priors.tracks_visible = np.ones((3, 2 * count), bool)
        assert module._is_separate_object(some, others, frames, priors) == expected
        assert not module._is_separate_object(some[:29], others, frames, priors), "too few tracks"
        assert module._is_separate_object(some[:30], others, frames, priors) == expected
    priors.tracks_visible[:, 6:count] = False
    priors.tracks[:, count:, 0] += 60
    assert not module._is_separate_object(some, others, frames, priors), "too few of them are ever seen at once"
    priors.tracks_visible[1, :7] = True
    assert module._is_separate_object(some, others, frames, priors)
    priors.tracks_visible[:] = True
    priors.tracks_visible[0, others[1:]] = False
    assert module._is_separate_object(some, others, frames[:1], priors), "one other is enough to compare with"
    mixed = priors.tracks.copy()
    priors.tracks_visible[0, others] = False
    priors.tracks[1, some] = priors.tracks[1, others] + 0.1
    often = np.array([0] * 9 + [1])
    assert not module._is_separate_object(some, others, often, priors), "a frame without others tells nothing"
    priors.tracks_visible[:] = True
    for share, expected in ((0.1, True), (0.35, False)):  # some of them lie among the others
        priors.tracks = mixed.copy()
        strays = some[: round(share * count)]
        priors.tracks[:, strays] = priors.tracks[:, others[: len(strays)]] + 0.1
        alike = []
        for n in some:
            away = np.linalg.norm(priors.tracks[0] - priors.tracks[0, n], axis=1)
            alike.append(np.mean(np.argsort(away)[1:7] < count))
        assert (np.mean(alike) >= module.MIN_APART) == expected
        assert module._is_separate_object(some, others, frames, priors) == expected


def moving_object(priors, tracks=None, motion=None):
    tracks = np.arange(priors.tracks.shape[1]) if tracks is None else tracks
    return module._MovingObject(np.arange(FRAMES), priors.mask, tracks, motion)


def test_tracks_on_an_object_know_how_far_its_outline_is():
    priors, _, _ = with_tracks()
    intrinsics = priors.cameras.intrinsics.copy()
    intrinsics[:, 0, 0], intrinsics[:, 0, 2] = [60, 62, 64, 66], [38, 39, 40, 41]
    priors.cameras = replace(priors.cameras, intrinsics=intrinsics)
    chosen = np.array([0, 3, 5, 8, 20, 30, 31, 32])
    mover = replace(moving_object(priors, chosen), frames=np.array([1, 3]), masks=priors.mask[[1, 3]])
    priors.mask[:, 55:, 3:6], priors.mask[:, 30:33, :3] = True, True
    priors.tracks[:, 3], priors.tracks[:, 5] = [4.5, HEIGHT - 0.2], [0.4, 31.5]
    priors.tracks[:, 8] = [4.5, HEIGHT + 3.0]
    mover = replace(mover, masks=priors.mask[[1, 3]])
    found = module._tracks_on(mover, priors)
    inside_any = False
    for i, t in enumerate((1, 3)):
        outside = np.argwhere(~np.pad(priors.mask[t], 1)) - 1
        for k, n in enumerate(chosen):
            x, y = np.floor(priors.tracks[t, n]).astype(int).clip(0, [WIDTH - 1, HEIGHT - 1])
            inside = priors.tracks_visible[t, n] and priors.mask[t, y, x]
            assert found.visible[i, k] == inside
            inside_any |= inside
            distance = np.linalg.norm(outside - (y, x), axis=1).min() if inside else 0
            assert found.from_outline[i, k] == pytest.approx(distance, abs=0.05)
    assert inside_any
    np.testing.assert_array_equal(found.focal, [62, 66])
    np.testing.assert_array_equal(found.principal, [40, 30])
    np.testing.assert_array_equal(found.tracks, priors.tracks[[1, 3]][:, chosen].astype(float))


def test_pixels_go_to_the_body_with_the_nearest_track():
    priors, _, _ = with_tracks()
    motion = OwnMotion(np.arange(FRAMES * 10.0).reshape(FRAMES, 10), np.ones(10, bool), 20.0, 0.3)
    region = moving_object(priors)
    bodies = [replace(region, tracks=np.arange(2, 12), motion=motion), replace(region, tracks=np.arange(12, 30))]
    priors.tracks_visible[2, 2:30] = False  # no tracks: all is the first body's
    priors.tracks_visible[3, 2:12] = False  # the first body is not seen
    parts = module._split(region, bodies, priors)
    np.testing.assert_array_equal(parts[0].frames, [0, 1, 2])
    np.testing.assert_array_equal(parts[1].frames, [0, 1, 3])
    np.testing.assert_array_equal(parts[0].motion.z, motion.z[:3])
    assert parts[1].motion is None
    np.testing.assert_array_equal(parts[0].masks[2], priors.mask[2])
    np.testing.assert_array_equal(parts[1].masks[2], priors.mask[3])
    for row, t in enumerate((0, 1)):
        seen = [n for n in range(2, 30) if priors.tracks_visible[t, n]]
        for y, x in np.argwhere(priors.mask[t]):
            away = np.linalg.norm(priors.tracks[t, seen] - (x + 0.5, y + 0.5), axis=1)
            first = seen[int(away.argmin())] < 12
            assert (parts[0].masks[row, y, x], parts[1].masks[row, y, x]) == (first, not first)
        assert not (parts[0].masks[row] & ~priors.mask[t]).any()


def maps_of(priors, inverse, confidence):
    return touching.DepthMaps(inverse, confidence, confidence.copy(), priors.mask)


def bulge_by_hand(mask):
    """Pixels by which a body is nearer than its feet: balls as wide as the mask, flattened, in the order of `np.argwhere`."""
    outside = np.argwhere(~np.pad(mask, 1)) - 1
    inside = np.array([np.linalg.norm(outside - pixel, axis=1).min() for pixel in np.argwhere(mask)])
    radius = inside.max()
    return module.ROUND * (np.sqrt(radius**2 - (radius - inside) ** 2) - module.FEET_LEVEL * radius)


@pytest.mark.parametrize("kind", ["moving", "static"])
def test_an_upright_plane_per_frame_stands_on_its_contacts_and_faces_its_way(kind):
    priors, inverse, confidence = world(frames=6, kind=kind)
    priors.mask[:, 12:18, 20:60] = True
    inverse *= np.linspace(0.7, 1.4, WIDTH, dtype=np.float32)
    priors.flow_forward = np.tile(np.float32([2, 0]), (5, HEIGHT, WIDTH, 1))
    priors.flow_forward_mask = np.ones((5, HEIGHT, WIDTH), bool)
    mover = module._MovingObject(np.arange(6), priors.mask, np.zeros(0, int))
    before = inverse.copy()
    contacts = np.array([contact(before[f], confidence[f], priors.mask[f], priors.mask[f]) for f in range(6)])
    growth = np.array([touching.growth(priors, f, priors.mask[f]) for f in range(5)])
    solved, certain = touching.smooth_object_depth(contacts[:, 0], contacts[:, 1], growth)
    turns = turn_along_way(Extents.of(priors.mask), solved, priors.cameras)
    assert module._place_upright_plane(mover, maps_of(priors, inverse, confidence), priors) == "ground contact"
    assert abs(turns).max() > 1e-4
    for f in range(6):
        middle, bulge = np.nonzero(priors.mask[f])[1].mean(), bulge_by_hand(priors.mask[f])
        for (y, x), nearer in zip(np.argwhere(priors.mask[f]), bulge, strict=True):
            expected = solved[f] * (1 + turns[f] * (x - middle)) / (1 - nearer / 70)
            assert inverse[f, y, x] == pytest.approx(expected, rel=1e-5)
        sure = touching.MOVING_CONFIDENCE * certain[f] if kind == "moving" else touching.GUESS_CONFIDENCE
        np.testing.assert_allclose(confidence[f][priors.mask[f]], sure, rtol=1e-5)
        np.testing.assert_array_equal(inverse[f][~priors.mask[f]], before[f][~priors.mask[f]])


@pytest.mark.parametrize(("standing", "word"), [(0, "surroundings"), (1, "size"), (2, "ground contact")])
def test_what_decided_a_planes_depth(standing, word, monkeypatch):
    """A quarter of eight frames with contact are enough to speak of it."""
    priors, inverse, confidence = world(frames=8)
    rows = [(1.0, 0.8 if f < standing else touching.NO_CONTACT) for f in range(8)]
    monkeypatch.setattr(module, "_contact", lambda *all: rows.pop(0))
    mover = module._MovingObject(np.arange(8), priors.mask, np.zeros(0, int))
    assert module._place_upright_plane(mover, maps_of(priors, inverse, confidence), priors) == word


def rigid():
    """A body whose points' depths are known, in its own unit; in one frame too few of them are seen."""
    priors, inverse, confidence = with_tracks(count=60, seed=4)
    chosen = np.arange(5, 50)
    rng = np.random.default_rng(0)
    z = 3 + 0.4 * rng.standard_normal((FRAMES, 45)) + 0.5 * np.arange(FRAMES)[:, None]
    z[:, 7] = np.nan
    priors.tracks_visible[1, chosen[5:]] = False
    priors.tracks_visible[1, chosen[:5]] = True
    motion = OwnMotion(z, np.ones(45, bool), 25.04, 0.3)
    return priors, inverse, confidence, moving_object(priors, chosen, motion)


def shapes_by_hand(priors, mover):
    level, enough = [], []
    for f in range(FRAMES):
        own = [
            1 / z
            for n, z in zip(mover.tracks, mover.motion.z[f], strict=True)
            if priors.tracks_visible[f, n] and np.isfinite(z)
        ]
        level.append(np.log(np.median(own)))
        enough.append(len(own) >= 6)
    assert enough == [True, False, True, True]
    found = []
    for f in range(FRAMES):
        y, x = np.nonzero(mover.masks[f])
        seen = priors.tracks_visible[f, mover.tracks] & np.isfinite(mover.motion.z[f])
        if enough[f]:
            points = priors.tracks[f, mover.tracks[seen]].astype(float)
            found.append(module._smooth(points, 1 / mover.motion.z[f, seen], y, x))
        else:
            found.append(np.full(len(y), np.exp((level[f - 1] + level[f + 1]) / 2)))
    return found


def test_a_bodys_pixels_follow_its_points_and_its_neighbouring_frames():
    priors, _, _, mover = rigid()
    for one, other in zip(module._relative_inverse(mover, priors), shapes_by_hand(priors, mover), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


@pytest.mark.parametrize("kind", ["moving", "static"])
def test_a_rigid_body_has_one_scale_that_its_contacts_give(kind):
    priors, inverse, confidence, mover = rigid()
    priors.camera_kind = kind
    priors.mask[2] = False
    priors.mask[2, 36:60, 20:40] = True  # nothing of its ground is seen
    inverse[3, 45:, 30:34] += 3
    before, trusted = inverse.copy(), confidence.copy()
    shapes = module._relative_inverse(mover, priors)
    ratio, trust = [], []
    for f in range(FRAMES):
        mask = priors.mask[f]
        edge = touching.ground_edge(before[f], trusted[f], priors.mask[f], mask)
        if f == 2:
            assert edge is None
            rim = ndimage.binary_dilation(mask, iterations=12) & ~mask
            ratio.append(np.median(before[f][rim]) / np.median(shapes[f]))
            trust.append(touching.NO_CONTACT)
            continue
        values = np.zeros((HEIGHT, WIDTH))
        values[mask] = shapes[f]
        lowest = [values[np.flatnonzero(mask[:, x])[-1], x] for x in edge.columns]
        ratio.append(np.quantile(edge.ground / lowest, 0.98))
        trust.append(edge.trust)
    scale = module.one_scale(np.array(ratio), np.array(trust))
    assert module._place_rigid_body(mover, maps_of(priors, inverse, confidence), priors) == "its own motion"
    for f in range(FRAMES):
        np.testing.assert_allclose(inverse[f][priors.mask[f]], scale * shapes[f], rtol=1e-5)
        sure = module.BODY_CONFIDENCE if kind == "moving" else touching.GUESS_CONFIDENCE
        np.testing.assert_allclose(confidence[f][priors.mask[f]], sure, rtol=1e-6)


def test_bodies_are_taken_out_one_after_the_other(monkeypatch):
    """Four at most, while enough tracks are left; what is left is one more where it is a separate object."""
    priors, _, _ = with_tracks(count=300)
    asked = []

    def found(seen):
        count = seen.tracks.shape[1]
        asked.append(count)
        inliers = np.arange(count) < 40
        return OwnMotion(np.ones((FRAMES, count)), inliers, 20.0, 0.3)

    monkeypatch.setattr(module, "solve", found)
    split = []
    monkeypatch.setattr(module, "_split", lambda region, bodies, priors: split.append(len(bodies)) or bodies)
    monkeypatch.setattr(module, "_is_separate_object", lambda some, *more: len(some) > 100)
    bodies = module._rigid_bodies(moving_object(priors), priors)
    assert asked == [300, 260, 220, 180] and len(bodies) == 5
    np.testing.assert_array_equal(bodies[1].tracks, np.arange(40, 80))
    assert bodies[1].motion.z.shape == (FRAMES, 40) and bodies[4].motion is None and len(bodies[4].tracks) == 140
    asked.clear()
    bodies = module._rigid_bodies(moving_object(priors, np.arange(110)), priors)
    assert asked == [110, 70, 30] and len(bodies) == 3
    asked.clear()
    (alone,) = module._rigid_bodies(moving_object(priors, np.arange(69)), priors)
    assert asked == [69] and len(alone.tracks) == 40 and split == [5, 3]
    monkeypatch.setattr(module, "solve", lambda seen: None)
    region = moving_object(priors, np.arange(69))
    assert module._rigid_bodies(region, priors)[0] is region


def two_in_one(apart, together=0, sizes=(40, 40)):
    """Tracks on two squares that are `apart` in so many of ten frames (they touch in the others)."""
    rng = np.random.default_rng(0)
    mask = np.zeros((10, HEIGHT, WIDTH), bool)
    mask[:, 10:30, 5:30], mask[:, 10:30, 40:65] = True, True
    mask[apart:, 18:22, 30:40] = True
    left, right = rng.uniform([6, 11], [29, 29], (sizes[0], 2)), rng.uniform([41, 11], [64, 29], (sizes[1], 2))
    priors = Priors(WIDTH, HEIGHT, np.arange(10), mask=mask)
    priors.tracks = np.tile(np.concatenate([left, right]), (10, 1, 1)).astype(np.float32)
    priors.tracks_visible = np.ones((10, sum(sizes)), bool)
    return priors, module._MovingObject(np.arange(10), mask, np.arange(sum(sizes)))


def test_a_region_is_split_into_what_is_apart_in_most_frames():
    for apart, sizes, count in (
        (10, (40, 40), 2),
        (3, (40, 40), 2),
        (2, (40, 40), 1),
        (0, (40, 40), 1),
        (10, (40, 29), 1),
        (10, (30, 30), 2),
        (10, (45, 14), 1),
    ):
        priors, region = two_in_one(apart, sizes=sizes)
        parts = module._objects(region, priors)
        assert len(parts) == count, (apart, sizes)
        if count == 2:
            np.testing.assert_array_equal(parts[0].tracks, np.arange(sizes[0]))
            np.testing.assert_array_equal(parts[1].tracks, np.arange(sizes[0], sum(sizes)))
            assert parts[0].masks[0, 20, 10] and not parts[0].masks[0, 20, 50]
            assert parts[1].masks[0, 20, 50]
        else:
            assert parts[0] is region


def test_an_object_on_which_many_tracks_begin_later_is_still_one_of_two():
    """Tracks that are lost where so many begin keep a number of their own, on the same object."""
    priors, region = two_in_one(10, sizes=(260, 40))
    priors.tracks_visible[:5, 60:260] = False
    priors.tracks_visible[5, :30] = False
    left, right = module._objects(region, priors)
    assert sorted(len(part.tracks) for part in (left, right)) == [40, 260]


def test_tracks_join_the_object_that_most_of_their_piece_belongs_to():
    """Tracks first seen later count with the piece that they lie in, as long as its owners agree."""
    priors, region = two_in_one(10, sizes=(45, 45))
    priors.tracks_visible[:4, [3, 50]] = False
    parts = module._objects(region, priors)
    np.testing.assert_array_equal(parts[0].tracks, np.arange(45))
    # four tracks of the first object go over to the second piece: more than nine of ten there still agree
    priors.tracks[6:, :4] += [35, 0]
    priors.tracks_visible[:6, 60] = False
    late = module._objects(region, priors)
    np.testing.assert_array_equal(late[1].tracks, np.arange(45, 90))
    priors.tracks[6:, :8] = priors.tracks[0, :8] + [35, 0]
    torn = module._objects(region, priors)
    np.testing.assert_array_equal(torn[1].tracks, np.delete(np.arange(45, 90), 15))


def test_rows_tell_what_was_placed():
    priors, inverse, confidence = with_tracks(count=60)
    priors.mask[1:3, 50:56, 60:63] = True  # of 18 pixels: too small, and left alone
    before = inverse.copy()
    (row,) = module.place_objects(inverse, confidence, priors.mask, priors)
    path = row.pop("over_time")
    assert row == {"group": 0, "frames": [5, 8], "decided_by": "ground contact", "emf_degrees": 0.0}
    assert path["seen"] == [5, 6, 7, 8] and path["touches"] == [True] * 4
    np.testing.assert_allclose(path["depth"], path["ground"], rtol=touching.CONTACT_NOISE)
    np.testing.assert_array_equal(inverse[1, 50:56, 60:63], before[1, 50:56, 60:63])
    assert confidence[1, 50:56, 60:63].max() <= touching.GUESS_CONFIDENCE + 1e-6
    priors.mask[1:3, 50:56, 60:65] = True  # of 30 pixels: large enough
    rows = module.place_objects(before, confidence, priors.mask, priors)
    assert [row["frames"] for row in rows] == [[5, 8], [6, 7]] and [row["group"] for row in rows] == [0, 1]


def test_rows_tell_the_angle_that_a_body_was_seen_from(monkeypatch):
    priors, inverse, confidence, mover = rigid()
    asked = []
    monkeypatch.setattr(module, "_objects", lambda whole, priors: asked.append(whole) or [whole])
    monkeypatch.setattr(module, "_rigid_bodies", lambda one, priors: [mover])
    rows = module.place_objects(inverse, confidence, priors.mask, priors)
    assert rows[0]["decided_by"] == "its own motion" and rows[0]["emf_degrees"] == 25.0
    mostly = module._tracks_mostly_inside(module._labels_of_tracks(priors.mask.astype(int), priors) == 1, priors)
    np.testing.assert_array_equal(asked[0].tracks, np.flatnonzero(mostly))
    np.testing.assert_array_equal(asked[0].frames, np.arange(FRAMES))


def test_a_region_touches_the_ground_with_its_largest_piece():
    own = np.zeros((HEIGHT, WIDTH), bool)
    assert touching.largest_piece(own) is own
    own[10:30, 20:36] = True
    body = own.copy()
    own[50:54, 20:60] = True  # a shadow in front of it
    np.testing.assert_array_equal(touching.largest_piece(own), body)


def test_distances_to_an_outline_have_the_same_bits_whatever_opencv_makes_of_the_last_one(monkeypatch):
    """Two runs of one clip once had two depth maps: OpenCV's distances differed by one rounding."""
    import cv2

    mask = np.hypot(*np.mgrid[-30:31, -40:41]) < 25
    found, transform = module._from_outline(mask), cv2.distanceTransform
    true = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    np.testing.assert_array_equal(found, true.astype(np.float32))
    for rounding in (np.float32(1e30), np.float32(0)):
        monkeypatch.setattr(cv2, "distanceTransform", lambda *a, to=rounding: np.nextafter(transform(*a), to))
        assert module._from_outline(mask).tobytes() == found.tobytes()
