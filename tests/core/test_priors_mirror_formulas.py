"""What speaks for one of two mirror images: every cue against its plain form on made-up tracks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation
from scipy.stats import spearmanr
from test_priors_cameras import HEIGHT, WIDTH, observe, project
from test_priors_mirror import cues, ground

from f4x_core.geometry import quaternion
from f4x_core.priors import mirror as module
from f4x_core.priors.bundle import BundleConfig, Observations, sighting_costs, triangulate
from f4x_core.priors.mirror import Decision, DepthCues, Evidence
from f4x_core.priors.point_tracks import PointTracks


def test_rough_starts_are_adjusted_at_falling_scales(monkeypatch):
    asked = []
    monkeypatch.setattr(
        module, "adjust", lambda bundle, seen, config: asked.append((config.robust_px, config.iterations)) or bundle
    )
    bundle = ground()
    module.adjust_coarse_to_fine(bundle, None, BundleConfig())
    assert asked == [(16, 12), (4, 12), (1, 25)]
    asked.clear()
    module.adjust_coarse_to_fine(bundle, None, BundleConfig(), first=1)
    assert asked == [(4, 12), (1, 25)]


def test_the_mirror_image_turns_inverse_distance_about():
    bundle = ground(travel=0.4, points=60, frames=5)
    bundle = replace(
        bundle,
        center=bundle.center + np.array([0.2, -0.1, 0.3]),
        points=np.vstack([bundle.points[:-3], [[0, 0, 40], [3, 1, 90], [0.3, 0.2, -2]]]),
    )
    found = module.mirrored(bundle)
    middle = bundle.center[2]
    inverse = 1 / np.linalg.norm(bundle.points - middle, axis=1)
    low, high = np.percentile(inverse, (2, 98))
    for before, after, one in zip(bundle.points, found.points, inverse, strict=True):
        turned = max(low + high - one, 0.02 * high)
        np.testing.assert_allclose(after, middle + (before - middle) / np.linalg.norm(before - middle) / turned)
    np.testing.assert_allclose(found.center, 2 * middle - bundle.center)
    for frame in range(5):
        a, b = bundle.points - bundle.center[frame], found.points - found.center[frame]
        seen = [n for n in range(60) if a[n] @ bundle.rotation[frame, 2] > 0.5 * np.linalg.norm(a[n])]
        assert 3 <= len(seen) < 60
        normal = sum(np.outer(a[n] / np.linalg.norm(a[n]), b[n] / np.linalg.norm(b[n])) for n in seen)
        u, _, vt = np.linalg.svd(normal)
        expected = bundle.rotation[frame] @ u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        np.testing.assert_allclose(found.rotation[frame], expected, atol=1e-9)
    for count, turned in ((2, False), (3, True)):
        few = replace(bundle, points=bundle.points[:count])
        assert (abs(module.mirrored(few).rotation - bundle.rotation).max() > 1e-9) == turned
    np.testing.assert_allclose(np.linalg.det(found.rotation), 1)


def chosen(monkeypatch, costs, agreement, evidence):
    """The decision between solutions known by their costs; `agreement` with the best one, in the order of costs."""
    bundle = ground(frames=3, points=5)
    made = [replace(bundle, focal=cost) for cost in costs]
    queue = list(made)
    monkeypatch.setattr(
        module,
        "adjust_coarse_to_fine",
        lambda start, seen, config, first=0: asked.append((first, config.robust_px)) or queue.pop(0),
    )
    monkeypatch.setattr(module, "mirrored", lambda one: one)
    monkeypatch.setattr(module, "total_cost", lambda one, seen, config: one.focal)
    ordered = sorted(costs)
    monkeypatch.setattr(module, "_agreement", lambda a, b: agreement[ordered.index(b.focal)])
    compared = []
    monkeypatch.setattr(
        module,
        "compare_orientations",
        lambda a, b, *more: compared.append((a.focal, b.focal)) or [Evidence("it", evidence, "")],
    )
    asked = []
    found = module.choose_orientation([bundle] * (len(costs) // 2), None, BundleConfig(robust_px=9.0), None)
    assert asked == [(0, 1.0), (1, 1.0)] * (len(costs) // 2)
    return found, compared


def test_the_other_way_round_is_compared_with_the_best(monkeypatch):
    for agreement, against in (
        ([1, 0.4, -0.2, -0.9], 3.0),
        ([1, 0.9, 0.4, 0.2], 3.0),
        ([1, 0.4, 0.9, 0.1], 2.0),
        ([1, 0.9, 0.0, 0.6], 3.0),
    ):
        found, compared = chosen(monkeypatch, [2.0, 1.0, 4.0, 3.0], agreement, 0.0)
        assert compared == [(1.0, against)] and not found.mirrored and found.bundle.focal == 1.0
        found, _ = chosen(monkeypatch, [2.0, 1.0, 4.0, 3.0], agreement, -0.5)
        assert found.mirrored and found.bundle.focal == against and found.margin == 0.5
    found, compared = chosen(monkeypatch, [2.0, 1.0], [1, 0.5], 0.0)
    assert not compared and found.margin == 8 and not found.mirrored  # no other world
    summary = Decision(found.bundle, True, (Evidence("a", 1.23456, "d"), Evidence("b", -0.3, "e"))).summary()
    assert summary["chosen"] == "mirrored" and summary["margin"] == 0.93
    assert summary["evidence"] == [{"what": "a", "for": 1.23, "detail": "d"}, {"what": "b", "for": -0.3, "detail": "e"}]


def test_errors_count_by_their_standard_error_over_the_parts_of_the_picture():
    true = ground()
    seen, config = observe(true, noise=0.3), BundleConfig()
    tracks, visible = project(true, noise=0.3)
    for shift in (0.0005, 0.5):
        other = replace(true, center=true.center + shift * np.random.default_rng(0).standard_normal(true.center.shape))
        found = module.compare_orientations(true, other, seen, config, cues(tracks, visible))
        gains = sighting_costs(other, seen, config) - sighting_costs(true, seen, config)
        parts: dict[tuple[int, int], float] = {}
        for point in np.unique(seen.point):
            x, y = seen.uv[seen.point == point].mean(0)
            part = (min(int(x / WIDTH * 8), 7), min(int(y / HEIGHT * 5), 4))
            parts[part] = parts.get(part, 0.0) + gains[seen.point == point].sum()
        sums = np.array(list(parts.values()))
        worth = 0.4 * sums.mean() / (sums.std(ddof=1) / np.sqrt(len(sums)))
        assert found[0].what == "reprojection" and found[0].log_odds == pytest.approx(min(worth, 8))
        back = module.compare_orientations(other, true, seen, config, cues(tracks, visible))
        assert back[0].log_odds == pytest.approx(max(-worth, -8))
        assert [item.what for item in found] == ["reprojection", "lower is nearer"]
    lower = (module._lower_is_nearer(true, seen) - module._lower_is_nearer(other, seen)) / 2 * 3
    assert found[1].log_odds == pytest.approx(lower)
    mask = np.zeros((len(tracks), HEIGHT, WIDTH), bool)
    mask[:, 60:120, 140:180] = True
    depth = np.ones(mask.shape) + np.arange(HEIGHT)[:, None]
    more = module.compare_orientations(true, other, seen, config, cues(tracks, visible, mask=mask, depth=depth))
    assert [item.what for item in more][2:] == ["movers stand in front", "depth prior"]
    rated = [module._track_depths(one, cues(tracks, visible, mask=mask, depth=depth)) for one in (true, other)]
    for item, weight, rate in ((more[2], 1.5, module._movers_in_front), (more[3], 8, module._agrees_with_prior)):
        ratings = [rate(one, cues(tracks, visible, mask=mask, depth=depth)) for one in rated]
        assert item.log_odds == pytest.approx(weight * (ratings[0] - ratings[1]) / 2)
    assert len(module.compare_orientations(true, other, seen, config, cues(tracks, visible, mask=mask & False))) == 2
    assert module._rating_evidence("x", 3.0, lambda one: one, 0.5, np.nan) == []
    (one,) = module._rating_evidence("x", 3.0, lambda one, more: one * more, 0.5, -0.2, 2.0)
    assert one.log_odds == pytest.approx(2.1)


def test_tracks_are_triangulated_in_the_sampled_frames():
    true = ground(travel=0.3, points=40, frames=9)
    tracks, visible = project(true, noise=0.1)
    frames = np.array([1, 4, 6, 8])
    static = np.arange(40) > 2
    visible[:, 5], visible[[1, 4], 5] = False, True  # seen twice among them
    visible[:, 6], visible[[1, 4, 6], 6] = False, True
    part = true.of_frames(frames)
    part = replace(part, rotation=part.rotation.copy())
    part.rotation[3] = np.diag([-1.0, 1, -1]) @ part.rotation[3]  # it looks back
    found = module._track_depths(part, DepthCues(frames, PointTracks(tracks, visible, static))).inverse
    kept = [n for n in range(40) if static[n] and visible[frames, n].sum() > 2]
    assert 6 in kept and 5 not in kept
    for n in range(40):
        if n not in kept:
            assert np.isnan(found[:, n]).all()
            continue
        rows = [k for k in range(4) if visible[frames[k], n]]
        seen = Observations(
            np.array(rows), np.zeros(len(rows), int), tracks[frames[rows], n].astype(float), np.ones(len(rows))
        )
        (point,), _ = triangulate(part, seen, 1)
        for k, f in enumerate(frames):
            z = part.rotation[k, 2] @ (point - part.center[k])
            np.testing.assert_allclose(found[f, n], 1 / z if z > 0 else np.nan, rtol=1e-6)
    assert np.isnan(found[[0, 2, 3, 5, 7]]).all()


def test_orders_are_rank_correlations():
    rng = np.random.default_rng(0)
    true = ground(frames=3, points=60)
    seen = observe(true)
    few = seen.keep((seen.frame != 1) | (seen.point < 19))
    behind = replace(true, points=np.where(np.arange(60)[:, None] % 7 == 0, -true.points, true.points))
    for one in (true, behind):
        for sightings in (seen, few):
            found = []
            for frame in range(3):
                own = sightings.keep(sightings.frame == frame)
                z = one.local(own)[:, 2]
                if (z > 0).sum() >= 20:
                    found.append(spearmanr(own.uv[z > 0, 1], 1 / z[z > 0])[0])
            assert len(found) == (3 if sightings is seen else 2)
            expected = np.mean(found) * (1 + 1.5 * np.mean(found) ** 2)
            assert module._lower_is_nearer(one, sightings) == pytest.approx(expected)
    assert np.isnan(module._lower_is_nearer(true, few.keep(few.frame == 1)))
    least = seen.keep((seen.frame == 0) & (np.cumsum(seen.frame == 0) <= 20))
    assert np.isfinite(module._lower_is_nearer(true, least))
    other = replace(true, points=true.points[rng.permutation(60)])
    distances = [np.linalg.norm(one.points - one.center[1], axis=1) for one in (true, other)]
    assert module._agreement(true, other) == pytest.approx(spearmanr(*distances)[0])


def scattered(frames=4, count=400, seed=0):
    rng = np.random.default_rng(seed)
    tracks = rng.uniform([0, 0], [WIDTH, HEIGHT], (frames, count, 2))
    inverse = rng.uniform(0.2, 1, (frames, count))
    inverse[rng.random(inverse.shape) < 0.1] = np.nan
    return tracks, inverse


def test_movers_are_compared_with_what_is_beside_them():
    tracks, inverse = scattered()
    mask = np.zeros((4, HEIGHT, WIDTH), bool)
    mask[0, 60:120, 140:180], mask[1, 20:150, 10:300], mask[2, 80:90, 100:104] = True, True, True
    shade = np.random.default_rng(2).uniform(0, 0.6, (4, 1))
    inverse += shade * (tracks[..., 1] / HEIGHT - 0.4)
    known = cues(tracks, np.isfinite(inverse), mask=mask)
    signs = []
    for f in range(3):
        rows, columns = np.nonzero(mask[f])
        top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
        half = max((right - left) / 2, 20)
        below, beside = [], []
        for (x, y), one in zip(tracks[f], inverse[f], strict=True):
            if np.isfinite(one) and left - half < x < right + half:
                if bottom - 0.1 * (bottom - top) < y < bottom + half:
                    below.append(one)
                if top - half < y < (top + bottom) / 2:
                    beside.append(one)
        if len(below) >= 3 and len(beside) >= 3:
            signs.append(np.sign(np.median(below) - np.median(beside)))
    assert len(signs) >= 2
    assert module._movers_in_front(module._TrackDepths(inverse), known) == pytest.approx(np.mean(signs))
    none = replace(known, mask=mask & False)
    assert np.isnan(module._movers_in_front(module._TrackDepths(inverse), none))
    assert np.isnan(module._movers_in_front(module._TrackDepths(inverse * np.nan), known))


@pytest.mark.parametrize("below", [2, 3])
def test_three_tracks_on_each_side_are_enough(below):
    mask = np.zeros((1, HEIGHT, WIDTH), bool)
    mask[0, 60:101, 140:181] = True
    places = [*[[150, 105], [160, 110], [170, 99]][:below], [130, 70], [190, 60], [160, 50]]
    inverse = np.array([[1.0] * below + [0.5] * 3])
    known = cues(np.array([places], float), np.ones((1, below + 3), bool), mask=mask)
    found = module._movers_in_front(module._TrackDepths(inverse), known)
    assert found == 1 if below == 3 else np.isnan(found)
    for edge, place in (
        (0, [119.9, 105]),
        (0, [201, 105]),
        (0, [150, 95.9]),
        (0, [150, 120.1]),
        (3, [119, 70]),
        (3, [150, 80.5]),
        (3, [150, 39.9]),
    ):
        if below == 3:
            moved = np.array([places], float)
            moved[0, edge] = place  # just outside
            assert np.isnan(
                module._movers_in_front(
                    module._TrackDepths(inverse), replace(known, tracks=replace(known.tracks, uv=moved))
                )
            )


def ending(seed=0, frames=9, count=260, masked=True):
    """Tracks that drift towards each other; many end before the clip does."""
    rng = np.random.default_rng(seed)
    tracks = rng.uniform([0, 0], [WIDTH, HEIGHT], (count, 2)) + np.cumsum(rng.normal(0, 1.2, (frames, count, 2)), 0)
    last = rng.integers(2, 2 * frames, count)
    visible = np.arange(frames)[:, None] < last
    visible[rng.random(visible.shape) < 0.05] = False
    tracks[~visible] = np.nan
    mask = np.zeros((frames, HEIGHT, WIDTH), bool)
    mask[:, 40:80, 100:150] = True
    static = rng.random(count) < 0.9
    return DepthCues(np.array([0, 2, 3, 5, 6, 8]), PointTracks(tracks, visible, static), mask if masked else None)


def inside_by_hand(known, frame):
    if known.mask is None:
        unit = max(np.nanmax(known.tracks.uv), 1) / 480
        low, high = np.nanmin(known.tracks.uv, (0, 1)), np.nanmax(known.tracks.uv, (0, 1))
    else:
        unit, low, high = max(HEIGHT, WIDTH) / 480, np.zeros(2), np.array([WIDTH, HEIGHT])
    margin, found = 10 * unit, []
    blocked = None if known.mask is None else binary_dilation(known.mask[frame], iterations=max(round(margin), 1))
    for x, y in np.nan_to_num(known.tracks.uv[frame], nan=-1.0):
        fine = low[0] + margin < x < high[0] - margin and low[1] + margin < y < high[1] - margin
        if blocked is not None:
            fine = fine and not blocked[int(min(max(y, 0), HEIGHT - 1)), int(min(max(x, 0), WIDTH - 1))]
        found.append(fine)
    return np.array(found), unit


@pytest.mark.parametrize("masked", [True, False])
def test_tracks_end_beside_the_neighbours_that_approach_them(masked):
    known = ending(masked=masked)
    expected = []
    visible, frames = known.tracks.seen, len(known.tracks)
    for before, after in zip(known.frames[:-1], known.frames[1:], strict=True):
        inside, unit = inside_by_hand(known, before)
        np.testing.assert_array_equal(module._inside(known, before), inside)
        assert module._unit(known) == pytest.approx(unit)
        past = max(before - 3, 0)
        if past == before:
            continue
        ends = [
            n
            for n in np.flatnonzero(visible[before] & inside & visible[past])
            if not visible[after : min(after + 3, frames), n].any()
        ]
        lives = np.flatnonzero(visible[before] & visible[after] & visible[past])
        for end in ends:
            away = np.linalg.norm(known.tracks.uv[before, lives] - known.tracks.uv[before, end], axis=1)
            for k in np.argsort(away)[:4]:
                then = np.linalg.norm(known.tracks.uv[past, lives[k]] - known.tracks.uv[past, end])
                if away[k] < 20 * unit and then - away[k] > 0.1 * unit * (before - past):
                    expected.append((before, end, lives[k]))
    found = module._endings(known)
    assert len(expected) > 20
    assert sorted(map(tuple, found.tolist())) == sorted((int(a), int(b), int(c)) for a, b, c in expected)
    rng = np.random.default_rng(1)
    depths = [module._TrackDepths(rng.uniform(0, 1, visible.shape)) for _ in range(2)]
    depths[0].inverse[:, ::9] = np.nan
    scores = []
    for one in depths:
        votes = [np.sign(one.inverse[f, n] - one.inverse[f, e]) for f, e, n in expected]
        votes = [vote for vote in votes if np.isfinite(vote)]
        scores.append(sum(votes) / np.sqrt(10 * len(votes)))
    (item,) = module._tracks_end_behind(*depths, known)
    assert item.log_odds == pytest.approx(0.5 * (scores[0] - scores[1]) / 2)
    hidden = np.isin(np.arange(visible.shape[1]), found[:, 1])
    sure = module._TrackDepths(np.tile(np.where(hidden, 0.1, 1.0), (frames, 1)))
    (most,) = module._tracks_end_behind(sure, module._TrackDepths(-sure.inverse), known)
    assert most.log_odds <= 3
    unknown = module._TrackDepths(depths[0].inverse * np.nan)
    assert module._tracks_end_behind(depths[0], unknown, known) == []
    assert module._tracks_end_behind(*depths, replace(known, frames=known.frames[:1])) == []
    assert module._unit(
        replace(known, tracks=replace(known.tracks, uv=known.tracks.uv[:, :0]), mask=None)
    ) == pytest.approx(1 / 480)


@pytest.mark.parametrize(("count", "worth"), [(19, None), (20, 0.5 * np.sqrt(2)), (800, 3.0)])
def test_endings_are_counted_from_twenty_on(monkeypatch, count, worth):
    monkeypatch.setattr(module, "_endings", lambda known: np.tile([[0, 0, 1]], (count, 1)))
    one, other = (module._TrackDepths(np.array([[a, 1.0]])) for a in (0.5, 2.0))
    found = module._tracks_end_behind(one, other, None)
    back = module._tracks_end_behind(other, one, None)
    assert (not found and not back) if worth is None else found[0].log_odds == pytest.approx(worth) == -back[0].log_odds


def test_a_depth_prior_is_compared_rank_by_rank():
    tracks, inverse = scattered(count=60)
    tracks[:, 0], tracks[:, 1] = [-4, 50], [WIDTH + 3, HEIGHT + 3]
    depth = np.random.default_rng(1).uniform(0.5, 3, (4, HEIGHT, WIDTH))
    depth[:, ::3], depth[:, 1::7] = np.nan, 0
    depth[2] = np.nan
    depth[3, :, : WIDTH - 70] = np.nan  # few are left
    inverse[0] = np.linspace(0.1, 1, 60)
    known, ratings = cues(tracks, np.isfinite(inverse), depth=depth), []
    for f in range(4):
        pairs = []
        for (x, y), one in zip(tracks[f], inverse[f], strict=True):
            prior = depth[f, int(min(max(y, 0), HEIGHT - 1)), int(min(max(x, 0), WIDTH - 1))]
            if np.isfinite(one) and prior > 0:
                pairs.append((one, 1 / prior))
        if len(pairs) >= 20:
            ratings.append(spearmanr(*np.array(pairs).T)[0])
    assert len(ratings) == 2
    assert module._agrees_with_prior(module._TrackDepths(inverse), known) == pytest.approx(np.mean(ratings))
    assert np.isnan(module._agrees_with_prior(module._TrackDepths(inverse), replace(known, depth=depth * np.nan)))


def test_the_world_is_guessed_nearer_below():
    turns = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([[0.2, 0, 0.1], [0.4, 0.1, 0]])))
    down = turns[0, 1] + turns[1, 1]
    down /= np.linalg.norm(down)
    rays = np.random.default_rng(0).normal(size=(50, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    expected = [min(max(1 + ray @ down, 0.3), 3) for ray in rays]
    np.testing.assert_allclose(module.guess_inverse_distance(rays, turns), expected)
    assert min(expected) == 0.3
    assert module.guess_inverse_distance(3 * down[None], turns)[0] == 3


def test_in_a_small_picture_the_pixel_beside_a_mover_is_not_inside():
    """Of 24 x 18 pixels the margin is half a pixel; a mover's outline still grows by one."""
    mask = np.zeros((1, 18, 24), bool)
    mask[0, 9, 9] = True
    tracks = np.array(
        [[[0.3, 9.5], [0.7, 9.5], [9.5, 9.5], [10.5, 9.5], [11.5, 9.5], [9.5, 11.5], [23.3, 9], [23.7, 9]]]
    )
    seen = DepthCues(np.arange(1), PointTracks.all_static(tracks, np.ones((1, 8), bool)), mask)
    assert module._inside(seen, 0).tolist() == [False, True, False, False, True, True, True, False]
