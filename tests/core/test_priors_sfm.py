"""Structure from motion step by step: robust rotations and alignments by loops, pairs and frames that are chosen, what a
child process is asked."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from test_priors_cameras import FOCAL, HEIGHT, PRINCIPAL, WIDTH, observe, project, truth

from f4x_core.errors import F4xError
from f4x_core.geometry import pose, quaternion
from f4x_core.priors import sfm as module
from f4x_core.priors.bundle import Bundle, BundleConfig, Observations, adjust, rays, triangulate
from f4x_core.priors.point_tracks import PointTracks
from f4x_core.priors.sfm import Solution
from f4x_core.report.diagnostics import _field_of_view


def solution_of(bundle, noise=0.0, registered=None):
    registered = np.ones(len(bundle.center), bool) if registered is None else registered
    return Solution(bundle, observe(bundle, noise), registered)


def test_the_error_of_a_solution_counts_large_misses_as_ten_pixels():
    true = truth(frames=5, points=40)
    points = true.points.copy()
    points[3], points[4] = np.nan, [0, 0, -9]  # not known, and behind
    seen = observe(true, noise=1.0)
    registered = np.array([True, True, False, True, True])
    found = Solution(replace(true, points=points), seen, registered).error
    errors = replace(true, points=points).errors(seen)
    kept = [min(e, 10) for e, f, p in zip(errors, seen.frame, seen.point, strict=True) if registered[f] and p != 3]
    assert found == pytest.approx(np.sqrt(np.mean(np.square(kept))))
    assert Solution(true, seen, np.zeros(5, bool)).error == np.inf


def test_sightings_are_of_tracks_seen_three_times():
    tracks, visible = project(truth(frames=5, points=30))
    chosen = np.arange(30) % 5 > 0
    visible[:, 6], visible[:, 7] = [1, 1, 0, 0, 0], [1, 1, 1, 0, 0]
    sighted = module.sightings(PointTracks(tracks, visible, chosen), 1000)
    seen, order = sighted.seen, sighted.tracks
    expected = [n for n in range(30) if chosen[n] and visible[:, n].sum() >= 3]
    np.testing.assert_array_equal(order, expected)
    assert 7 in order and 6 not in order
    rows = [(f, p) for f in range(5) for p, n in enumerate(order) if visible[f, n]]
    np.testing.assert_array_equal(np.column_stack([seen.frame, seen.point]), rows)
    np.testing.assert_array_equal(seen.uv, [tracks[f, order[p]] for f, p in rows])
    assert (seen.weight == 1).all() and len(module.sightings(PointTracks(tracks, visible, chosen), 9).tracks) == 9
    two = module.sightings(PointTracks(tracks[:2], visible[:2], chosen), 1000).tracks
    np.testing.assert_array_equal(two, [n for n in range(30) if chosen[n] and visible[:2, n].all()])


def test_bearings_and_lifted_points():
    uv, z = np.array([[10.0, 20], [300, 100]]), np.array([2.0, 3])
    for one, depth, ray, point in zip(
        uv, z, module.bearings(uv, 50.0, PRINCIPAL), module._lift(uv, z, 50.0, PRINCIPAL), strict=True
    ):
        plane = np.array([*(one - PRINCIPAL) / 50, 1])
        np.testing.assert_allclose(ray, plane / np.linalg.norm(plane))
        np.testing.assert_allclose(point, plane * depth)


def kabsch(a, b, weight):
    u, _, vt = np.linalg.svd(sum(w * np.outer(y, x) for w, x, y in zip(weight, a, b, strict=True)))
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt


def test_rotations_between_views_follow_the_majority():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(60, 3)) * [1, 1, 0.2] + [0, 0, 2]
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    true = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.1, -0.2, 0.05])))
    b = a @ true.T + 0.003 * rng.normal(size=a.shape)
    b[:15] += [0.1, 0, 0]
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    found, residual = module.rotation_between(a, b, 100.0)
    weight = np.ones(60)
    for _ in range(8):
        rotation = kabsch(a, b, weight)
        expected = 100 * np.linalg.norm(b - a @ rotation.T, axis=1)
        weight = 1 / (1 + (expected / max(np.median(expected), 0.1)) ** 2)
    np.testing.assert_allclose(found, rotation, atol=1e-9)
    np.testing.assert_allclose(residual, expected, atol=1e-7)
    exact, residual = module.rotation_between(a, a @ true.T, 1.0)
    np.testing.assert_allclose(exact, true, atol=1e-9)
    assert residual.max() < 1e-9
    once, _ = module.rotation_between(a, b, 100.0, rounds=1)
    np.testing.assert_allclose(once, kabsch(a, b, np.ones(60)), atol=1e-9)


def test_turns_are_chained_from_frame_to_frame():
    true = truth(frames=6, travel=0.0, turn=0.5, points=80)
    tracks, visible = project(true)
    static = np.arange(80) > 3
    tracks[:, :4] += np.arange(6)[:, None, None] * 9  # they move
    found = module.solve_rotations(PointTracks(tracks, visible, static), FOCAL, PRINCIPAL)
    relative = true.rotation @ true.rotation[0].T
    np.testing.assert_allclose(found.bundle.rotation, relative, atol=1e-4)
    assert not found.bundle.center.any() and found.registered.all() and found.bundle.focal == FOCAL
    np.testing.assert_allclose(np.linalg.norm(found.bundle.points, axis=1), 1)
    assert found.bundle.errors(found.observations).max() < 0.1
    sighted = module.sightings(PointTracks(tracks, visible, static), 1000)
    expected, order = sighted.seen, sighted.tracks
    np.testing.assert_array_equal(found.observations.uv, expected.uv)
    directions = rays(found.bundle, expected)
    for point in range(len(order)):
        mean = directions[expected.point == point].sum(0)
        np.testing.assert_allclose(found.bundle.points[point], mean / np.linalg.norm(mean), atol=1e-9)
    torn = visible.copy()
    torn[3] = False
    torn[3, np.flatnonzero(visible[2:5].all(0) & static)[:4]] = True  # four tracks are enough
    np.testing.assert_allclose(
        module.solve_rotations(PointTracks(tracks, torn, static), FOCAL, PRINCIPAL).bundle.rotation, relative, atol=1e-2
    )
    torn[3, np.flatnonzero(torn[3])[0]] = False  # three are not: no turn is known
    lost = module.solve_rotations(PointTracks(tracks, torn, static), FOCAL, PRINCIPAL).bundle.rotation
    np.testing.assert_array_equal(lost[3], lost[2])
    np.testing.assert_array_equal(lost[4], lost[2])
    assert len(module.solve_rotations(PointTracks(tracks, visible, static), FOCAL, PRINCIPAL, 20).bundle.points) == 20


@pytest.mark.parametrize("translating", [True, False])
def test_another_focal_length_turns_the_cameras_less(translating):
    true = truth(frames=5, points=40)
    solution = solution_of(true)
    found = module.refocused(solution, 1.3 * FOCAL, translating).bundle
    middle = true.rotation[2]
    for before, after in zip(true.rotation, found.rotation, strict=True):
        turn = quaternion.to_rotation_vector(quaternion.from_matrix(before @ middle.T))
        again = quaternion.to_rotation_vector(quaternion.from_matrix(after @ middle.T))
        np.testing.assert_allclose(again, turn / 1.3, atol=1e-9)
    assert found.focal == 1.3 * FOCAL
    start = replace(true, rotation=found.rotation, focal=found.focal)
    if translating:
        seen = solution.observations.keep(solution.observations.point != 4)
        points, _ = triangulate(start, seen, 40)
        found = module.refocused(Solution(true, seen, solution.registered), 1.3 * FOCAL).bundle
        np.testing.assert_allclose(found.points[4], true.points[4])
        rest = np.isfinite(points).all(1)
        np.testing.assert_allclose(found.points[rest], points[rest])
    else:
        distance = np.linalg.norm(found.points[np.unique(solution.observations.point)], axis=1)
        np.testing.assert_allclose(distance, 1)


def test_the_focal_length_is_the_one_with_the_least_penalised_error():
    true = truth(frames=6, points=60, travel=0.8)
    solution = solution_of(replace(true, focal=FOCAL), noise=0.3)
    candidates = [0.5, 0.72, 0.81, 1.2, 2.5]
    for expected in (0.9, 1e9):
        found, curve = module.search_focal(solution, WIDTH, candidates, expected)
        errors = []
        for factor in candidates:
            sample, _ = module.subset(solution, 400, 24)
            start = module.refocused(sample, factor * WIDTH, translating=False)
            config = BundleConfig(iterations=8, refine_focal=False, refine_centers=False)
            errors.append(replace(start, bundle=adjust(start.bundle, start.observations, config)).error)
        penalised = [e * (1 + 0.1 * np.log(c / expected) ** 2) for e, c in zip(errors, candidates, strict=True)]
        assert found.bundle.focal == candidates[int(np.argmin(penalised))] * WIDTH
        assert curve["focal_over_width"] == candidates
        np.testing.assert_allclose(curve["error_px"], errors, atol=6e-5)
    nothing = Solution(
        true, solution.observations.keep(np.zeros(len(solution.observations.frame), bool)), np.ones(6, bool)
    )
    assert module.search_focal(nothing, WIDTH, candidates)[1] == {}


@pytest.mark.parametrize(("travel", "turn", "seed"), [(0.02, 0.2, 0), (0.01, 0.15, 1), (0.03, 0.25, 2)])
def test_a_pan_through_a_long_lens_is_told_from_a_walk_along_a_wall(travel, turn, seed):
    true = replace(truth(frames=16, travel=travel, turn=turn, points=600, seed=seed), focal=2.0 * WIDTH)
    lens = BundleConfig(expected_focal=0.9 * WIDTH, robust_px=0.5, focal_prior=0.01)
    start = module.refocused(solution_of(true, noise=0.1), 0.9 * WIDTH)
    wall = module.with_points_ahead(start.bundle, start.observations)
    wall = replace(start, bundle=adjust(wall, start.observations, replace(lens, refine_focal=False)))
    focal, curve = module.best_focal(wall, lens)
    assert abs(np.log(focal / (2 * WIDTH))) < np.log(module.FOCAL_STEP) < abs(np.log(0.9 / 2))
    assert focal == pytest.approx(WIDTH * curve["focal_over_width"][int(np.argmin(curve["error_px"]))], rel=1e-3)
    assert len(curve["error_px"]) == module.LONGER + module.SHORTER + 1
    again = module.refocused(wall, focal)
    bundle = again.adjusted_anew(lens, 2).bundle
    assert bundle.focal == pytest.approx(2 * WIDTH, rel=0.05)
    nothing = replace(wall, observations=wall.observations.keep(np.zeros(len(wall.observations.frame), bool)))
    assert module.best_focal(nothing, lens) == (wall.bundle.focal, {})


def test_before_a_wall_the_usual_lens_stays():
    true = truth(frames=16, travel=0.6, turn=0.0, points=600)
    points = true.points * [1.5, 1.5, 0.02] + [0, 0, 2]
    wall = solution_of(replace(true, points=points, focal=0.9 * WIDTH), noise=0.1)
    lens = BundleConfig(expected_focal=0.9 * WIDTH, robust_px=0.5, focal_prior=0.02)
    focal, curve = module.best_focal(wall, lens)
    assert focal == pytest.approx(0.9 * WIDTH) and np.ptp(curve["error_px"]) < 0.01  # any lens shows the same


def test_a_flat_curve_is_decided_by_the_usual_focal_length(monkeypatch):
    """Errors that differ by 4 %: a focal length e^1 from the usual one must save a tenth."""
    errors = {0.9: 1.04, 0.9 * np.e: 1.0, 0.9 / np.e**0.5: 1.0}

    class Fixed(Solution):
        error = property(lambda self: errors[min(errors, key=lambda c: abs(c * WIDTH - self.bundle.focal))])

    true = truth(frames=4, points=40)
    monkeypatch.setattr(
        module,
        "replace",
        lambda one, **more: Fixed(**(one.__dict__ | more)) if "registered" in one.__dict__ else replace(one, **more),
    )
    found, _ = module.search_focal(solution_of(true), WIDTH, list(errors))
    assert found.bundle.focal == pytest.approx(0.9 / np.e**0.5 * WIDTH)
    errors[0.9 / np.e**0.5] = 1.02
    assert module.search_focal(solution_of(true), WIDTH, list(errors))[0].bundle.focal == pytest.approx(0.9 * WIDTH)


def test_only_known_frames_and_points_are_adjusted():
    true = truth(frames=6, points=60)
    rng = np.random.default_rng(0)
    points = true.points + 0.02 * rng.standard_normal(true.points.shape)
    points[5] = np.nan
    start, registered = replace(true, points=points), np.array([1, 1, 0, 1, 0, 1], bool)
    seen, config = observe(true), BundleConfig(iterations=5, refine_focal=False)
    found = module.adjust_known(start, seen, registered, config)
    frames = np.flatnonzero(registered)
    kept = [
        (list(frames).index(f), p - (p > 5), uv)
        for f, p, uv in zip(seen.frame, seen.point, seen.uv, strict=True)
        if registered[f] and p != 5
    ]
    part = Observations(
        np.array([k[0] for k in kept]),
        np.array([k[1] for k in kept]),
        np.array([k[2] for k in kept]),
        np.ones(len(kept)),
    )
    small = Bundle(FOCAL, PRINCIPAL, true.rotation[frames], true.center[frames], np.delete(points, 5, 0))
    expected = adjust(small, part, config)
    np.testing.assert_allclose(np.delete(found.points, 5, 0), expected.points, rtol=1e-6)
    np.testing.assert_allclose(found.center[frames], expected.center, atol=1e-8)
    np.testing.assert_array_equal(found.center[[2, 4]], true.center[[2, 4]])
    assert np.isnan(found.points[5]).all()
    assert module.adjust_known(start, seen, np.zeros(6, bool), config) is start


def test_a_subset_is_the_same_geometry():
    true = truth(frames=9, points=50)
    points = true.points.copy()
    points[7] = np.nan
    registered = np.arange(9) != 4
    solution = Solution(replace(true, points=points), observe(true), registered)
    rare = solution.observations.keep(~((solution.observations.point == 8) & (solution.observations.frame > 1)))
    sample, kept = module.subset(replace(solution, observations=rare), 30, 5)
    assert len(kept) == 5 and registered[kept].all() and kept[0] == 0 and kept[-1] == 8
    assert len(sample.bundle.points) == 30 and sample.registered.shape == (5,)
    assert np.isfinite(sample.bundle.points).all()
    assert not (np.abs(sample.bundle.points - true.points[8]) < 1e-12).all(1).any()  # seen twice
    np.testing.assert_array_equal(sample.bundle.center, true.center[kept])
    assert sample.bundle.errors(sample.observations).max() < 1e-3
    assert (np.bincount(sample.observations.point) >= 3).all()
    every, _ = module.subset(replace(solution, observations=rare), 100, 100)
    often = np.bincount(rare.point[registered[rare.frame]], minlength=50) >= 3
    assert len(every.bundle.points) == (often & (np.arange(50) != 7)).sum()


def test_structure_drops_narrow_rays_and_large_errors():
    true = truth(frames=6, points=60)
    far = true.points.copy()
    far[:10] *= 400  # their rays are parallel
    true = replace(true, points=far)
    seen = observe(true, noise=0.3)
    uv = seen.uv.copy()
    wrong = np.isin(seen.point, range(20, 28))
    uv[wrong] += np.random.default_rng(0).normal(0, 20, (wrong.sum(), 2))
    seen, registered = replace(seen, uv=uv), np.array([1, 1, 1, 1, 0, 0], bool)
    found = module._structure(true, seen, registered).points
    part = seen.keep(registered[seen.frame])
    points, spread = triangulate(true, part, 60)
    errors = replace(true, points=points).errors(part)
    dropped = []
    for point in range(60):
        own = np.sort(np.nan_to_num(errors[part.point == point], nan=np.inf))
        dropped.append(not len(own) or spread[point] < np.deg2rad(0.5) or own[len(own) // 2] > 3)
    np.testing.assert_array_equal(np.isnan(found).any(1), np.array(dropped) | np.isnan(points).any(1))
    assert all(dropped[:10]) and 12 < sum(dropped) < 40
    kept = ~np.isnan(found).any(1)
    np.testing.assert_array_equal(found[kept], points[kept])


def test_the_first_pair_has_the_most_parallax():
    true = truth(frames=14, points=120, travel=0.9, turn=0.2)
    tracks, visible = project(true, noise=0.1)
    visible[9:, :65] = False
    best = (-1.0, 0, 0)
    for i in range(14):
        for j in range(i + 1, 14):
            shared = visible[i] & visible[j]
            if shared.sum() >= 60:
                a, b = (module.bearings(tracks[k, shared].astype(float), FOCAL, PRINCIPAL) for k in (i, j))
                residual = module.rotation_between(a, b, FOCAL)[1]
                score = min(np.percentile(residual, 75), 0.05 * FOCAL) * np.sqrt(shared.sum())
                best = (score, i, j) if score > best[0] else best
    i, j, rotation, translation = module._first_pair(tracks, visible, FOCAL, PRINCIPAL, 0)
    assert (i, j) == best[1:]
    np.testing.assert_allclose(rotation, true.rotation[j] @ true.rotation[i].T, atol=0.03)
    step = true.rotation[j] @ (true.center[i] - true.center[j])
    assert translation @ step / np.linalg.norm(step) > 0.97
    few = np.zeros_like(visible)
    few[:, np.flatnonzero(visible[:9].all(0))[:59]] = True
    assert module._first_pair(tracks, few, FOCAL, PRINCIPAL, 0) is None
    few[:, np.flatnonzero(visible[:9].all(0))[59]] = True
    assert module._first_pair(tracks, few, FOCAL, PRINCIPAL, 0) is not None  # sixty are enough
    wild = np.random.default_rng(0).uniform([0, 0], [WIDTH, HEIGHT], tracks.shape)
    assert module._first_pair(wild, few, FOCAL, PRINCIPAL, 0) is None  # no two views of one world
    sparse = module._first_pair(np.repeat(tracks, 2, 0), np.repeat(visible, 2, 0), FOCAL, PRINCIPAL, 0)
    assert sparse[0] % 2 == sparse[1] % 2 == 0  # every second of 28 frames is tried


def test_parallax_saturates_at_a_twentieth_of_the_focal_length():
    """Frame 2 is far away and sees few of the points, frame 1 nearer and sees all of them."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -0.6, 2], [1, 0.6, 5], (200, 3))
    center = np.array([[0, 0, 0], [0.6, 0, 0], [1.2, 0, 0.0]])
    true = Bundle(FOCAL, PRINCIPAL, np.tile(np.eye(3), (3, 1, 1)), center, points)
    tracks, visible = project(true)
    visible[:] = True
    visible[2, 80:] = False
    assert module._first_pair(tracks, visible, FOCAL, PRINCIPAL, 0)[:2] == (0, 1)


def test_the_next_frame_is_beside_and_sees_most():
    true = truth(frames=6, points=60)
    points = true.points.copy()
    points[40:] = np.nan
    bundle, visible = replace(true, points=points), np.ones((6, 60), bool)
    visible[1, :10], visible[4, :5], visible[5, :3] = False, False, False

    def next_of(*registered):
        known = np.isin(np.arange(6), registered)
        frame, point = np.nonzero(visible)
        return module._next_frame(
            known, Observations(frame, point, np.zeros((len(frame), 2)), np.ones(len(frame))), bundle
        )

    assert next_of(2, 3) == 4  # 35 points against 30
    assert next_of(2, 3, 4) == 5
    assert next_of(2, 3, 4, 5) == 1
    assert next_of(0, 1, 2, 3, 4, 5) is None
    visible[:, :25] = False  # 15 known points are left
    assert next_of(2) in (1, 3)
    visible[:, 25] = False
    assert next_of(2) is None


def test_alignments_weigh_points_by_their_depth():
    rng = np.random.default_rng(0)
    a = rng.uniform([-1, -1, 1], [1, 1, 6], (50, 3))
    true = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.1, 0.3, -0.2])))
    for scaled, scale in ((True, 1.3), (False, 1.0)):
        b = scale * a @ true.T + [0.1, -0.2, 0.3] + 0.02 * rng.normal(size=a.shape)
        b[:8] += [0.5, 0.4, 0.3]
        weight = 1 / b[:, 2] ** 2
        for _ in range(6):
            s, r, t = pose.align_similarity(a, b, weight, scaled)
            miss = np.array([np.linalg.norm(y - (s * r @ x + t)) / y[2] for x, y in zip(a, b, strict=True)])
            weight = 1 / b[:, 2] ** 2 / (1 + (miss / max(np.median(miss), 1e-4)) ** 2)
        found = module._robust_alignment(a, b, scaled)
        for one, other in zip(found, (s, r, t), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9)
        assert abs(found[0] - scale) < 0.02
    exact = module._robust_alignment(a, a @ true.T + 1.0, False)
    np.testing.assert_allclose(exact[1], true, atol=1e-6)


def depth_case(frames=26, points=120):
    """Tracks with the depth under them, a little wrong, and a depth map that holds it."""
    true = truth(frames=frames, travel=0.9, points=points)
    tracks, visible = project(true)
    rng = np.random.default_rng(1)
    local = np.einsum("fij,fnj->fni", true.rotation, true.points[None] - true.center[:, None])[..., 2]
    depth = np.full((frames, HEIGHT, WIDTH), np.nan, np.float32)
    for f in range(frames):
        x, y = tracks[f, visible[f]].astype(int).T
        depth[f, y, x] = local[f, visible[f]] * np.exp(0.01 * rng.standard_normal(visible[f].sum()))
        depth[f] *= np.exp(0.02 * np.sin(f))  # every frame has a scale of its own
    return true, tracks, visible, depth


def alignment_error_by_hand(tracks, visible, z, pairs, focal):
    errors = []
    for i, j in pairs:
        shared = np.flatnonzero(visible[i] & visible[j])
        if len(shared) < 30:
            continue
        a, b = (module._lift(tracks[k, shared].astype(float), z[k, shared], focal, PRINCIPAL) for k in (i, j))
        s, r, t = module._robust_alignment(a, b, True)
        pixels = []
        for x, y in zip(a, b, strict=True):
            there, back = s * r @ x + t, r.T @ (y - t) / s
            pixels.append(focal * np.linalg.norm(there[:2] / there[2] - y[:2] / y[2]))
            pixels.append(focal * np.linalg.norm(back[:2] / back[2] - x[:2] / x[2]))
        errors.append(np.median(pixels))
    return np.mean(errors) if errors else np.inf


@pytest.mark.parametrize(("frames", "known"), [(26, None), (26, 0.9 * FOCAL), (13, None)])
def test_cameras_from_depth_are_chained_alignments(frames, known):
    _, tracks, visible, depth = depth_case(frames)
    static = np.arange(tracks.shape[1]) > 0
    found, search = module.solve_with_depth(PointTracks(tracks, visible, static), depth, known, WIDTH)
    order = module.sightings(PointTracks(tracks, visible, static), 4000).tracks
    tracks, visible = tracks[:, order], visible[:, order].copy()
    z = np.full(visible.shape, np.nan)
    for f, n in np.argwhere(visible):
        x, y = tracks[f, n].astype(int)
        z[f, n] = depth[f, min(y, HEIGHT - 1), min(x, WIDTH - 1)]
    visible &= np.nan_to_num(z) > 0
    if frames == 26:
        pairs = [(i, i + 10) for i in range(0, 16, 2)] + [(i, i + 12) for i in range(0, 14, 3)]
    else:
        pairs = [(i, i + 6) for i in range(7)]
    fovs = np.deg2rad(np.linspace(20, 90, 72)[1:-1])
    focals = [known] if known else WIDTH / 2 / np.tan(fovs / 2)
    np.testing.assert_allclose(search["focal_over_width"], np.array(focals) / WIDTH)
    assert "<svg" in _field_of_view(
        SimpleNamespace(statistics={"cameras": {"focal_search": search}})
    )  # as the page draws it
    best = int(np.argmin(search["error_px"]))
    for one in {best, 0, len(focals) - 1}:
        expected = alignment_error_by_hand(tracks, visible, z, pairs, focals[one])
        assert search["error_px"][one] == pytest.approx(min(expected, 1e3), rel=1e-6)
    focal = known
    if not known:
        assert 0 < best < 69
        a, b, c = search["error_px"][best - 1 : best + 2]
        fov = fovs[best] + 0.5 * (a - c) / (a - 2 * b + c) * np.deg2rad(70 / 71)
        focal = WIDTH / 2 / np.tan(fov / 2)
    assert found.bundle.focal == pytest.approx(focal, rel=1e-9)
    matrix, lifted = np.eye(4), []
    for f in range(frames):
        if f:
            shared = visible[f - 1] & visible[f]
            here, there = (module._lift(tracks[k, shared], z[k, shared], focal, PRINCIPAL) for k in (f - 1, f))
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = module._robust_alignment(here, there, False)[1:]
            matrix = step @ matrix
        np.testing.assert_allclose(found.bundle.world_to_camera[f], matrix, atol=1e-6)
        local = np.column_stack([module._lift(tracks[f], z[f], focal, PRINCIPAL), np.ones(len(order))])
        lifted.append(np.where(visible[f, :, None], (local @ np.linalg.inv(matrix).T)[:, :3], np.nan))
    with np.errstate(all="ignore"):
        middle = np.nanmedian(lifted, axis=0)
    np.testing.assert_allclose(found.bundle.points, np.where(np.isfinite(middle), middle, 0), atol=1e-6)
    assert np.isfinite(middle[found.observations.point]).all() and found.registered.all()


def test_depth_that_relates_no_frames_gives_the_usual_focal_length():
    _, tracks, visible, depth = depth_case(9, 25)
    found, search = module.solve_with_depth(PointTracks.all_static(tracks, visible), depth, None, WIDTH)
    assert found.bundle.focal == 0.9 * WIDTH and set(search["error_px"]) == {1e3}
    single, _ = module.solve_with_depth(PointTracks.all_static(tracks[:1], visible[:1]), depth[:1], None, WIDTH)
    assert len(single.bundle.center) == 1


def test_cameras_are_added_from_the_pair_outwards(monkeypatch):
    true = truth(frames=12, points=150, travel=0.8)
    tracks, visible = project(true, noise=0.1)
    counts, resected = [], []
    adjusted, solved = module.adjust_known, module.resect

    def adjust_known(bundle, seen, registered, config):
        counts.append(int(registered.sum()))
        assert (config.iterations, config.refine_focal) == (8, False)
        return adjusted(bundle, seen, registered, config)

    def resect(bundle, seen, frames, iterations, robust_px):
        (frame,) = frames
        registered = [*start, *[one for one, _ in resected]]
        near = min(registered, key=lambda one: (abs(one - frame), one))
        np.testing.assert_array_equal(bundle.rotation[frame], bundle.rotation[near])
        np.testing.assert_array_equal(bundle.center[frame], bundle.center[near])
        resected.append((int(frame), (iterations, robust_px)))
        return solved(bundle, seen, frames, iterations=iterations, robust_px=robust_px)

    start = module._first_pair(tracks, visible, FOCAL, PRINCIPAL, 0)[:2]
    monkeypatch.setattr(module, "adjust_known", adjust_known)
    monkeypatch.setattr(module, "resect", resect)
    found = module.solve_with_tracks(PointTracks.all_static(tracks, visible), FOCAL, PRINCIPAL)
    assert found.registered.all() and len(resected) == 10
    assert {settings for _, settings in resected} == {(30, 8.0)}
    assert counts == [3, 4, 5, 7, 9, 12]  # a quarter more each time
    assert (
        np.median(
            found.bundle.errors(
                found.observations.keep(np.isfinite(found.bundle.points).all(1)[found.observations.point])
            )
        )
        < 0.3
    )
    assert (
        module.solve_with_tracks(PointTracks.all_static(tracks, visible & (np.arange(150) < 50)), FOCAL, PRINCIPAL)
        is None
    )


def fake(focal, registered):
    registered = np.array(registered, bool)
    count = len(registered)
    bundle = Bundle(focal, PRINCIPAL, np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), np.zeros((0, 3)))
    return Solution(bundle, Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0)), registered)


def asked_colmap(monkeypatch, answers, focal_known=False, masks=None):
    requests, files = [], {}

    def ask(request, size):
        requests.append(request)
        for file in Path(request["folder"]).rglob("*.png"):
            files[str(file.relative_to(request["folder"]))] = cv2.imread(str(file))
        assert size == (8, 6)
        return answers[len(requests) - 1]

    monkeypatch.setattr(module, "_ask_colmap", ask)
    pictures = np.random.default_rng(0).integers(0, 255, (10, 6, 8, 3), np.uint8)
    settings = module.ColmapSettings(5.0, focal_known, 700, 3, 4)
    return module.solve_with_colmap(list(pictures), masks, settings), requests, files, pictures


def test_pycolmap_is_asked_with_pictures_masks_and_pairs(monkeypatch):
    masks = np.zeros((10, 6, 8), bool)
    masks[3, 2:4, 5] = True
    best = fake(5.0, [1] * 9 + [0])
    found, (request,), files, pictures = asked_colmap(monkeypatch, [best], masks=masks)
    assert found is best  # nine of ten frames are enough
    assert request["pairs"] == [(i, i + gap) for gap in (1, 2, 3, 4, 6, 8) for i in range(10 - gap)]
    names = [f"{i:05d}.png" for i in range(10)]
    rest = {"focal": 5.0, "refine_focal": False, "max_features": 700, "threads": 3, "seed": 4, "names": names}
    assert {name: request[name] for name in rest} == rest
    for i, name in enumerate(names):
        np.testing.assert_array_equal(files[f"images/{name}"][..., ::-1], pictures[i])
        np.testing.assert_array_equal(files[f"masks/{name}.png"][..., 0], np.where(masks[i], 0, 255))
    _, _, files, _ = asked_colmap(monkeypatch, [best], masks=masks & False)
    assert not any("masks" in name for name in files)


@pytest.mark.parametrize(
    ("first", "second", "known", "chosen"),
    [
        (fake(5.0, [1] * 8 + [0, 0]), fake(6.0, [1] * 9 + [0]), False, 1),
        (fake(5.0, [1] * 8 + [0, 0]), fake(6.0, [1] * 8 + [0, 0]), False, 0),
        (fake(5.0, [1] * 8 + [0, 0]), fake(6.0, [1] * 9 + [0]), True, 0),
        (None, fake(6.0, [1] * 3 + [0] * 7), False, 1),
        (None, fake(4.0, [1] * 10), False, 1),  # half the width: the shortest that is believed
        (None, fake(3.9, [1] * 10), False, 0),
        (None, fake(20.0, [1] * 10), False, 1),
        (None, fake(20.1, [1] * 10), False, 0),
        (None, None, False, 0),
    ],
)
def test_pycolmap_is_asked_again_for_the_focal_length(monkeypatch, first, second, known, chosen):
    found, requests, _, _ = asked_colmap(monkeypatch, [first, second], known)
    assert found is (first, second)[chosen]
    assert [request["refine_focal"] for request in requests] == ([False] if known else [False, True])


def answer_with(monkeypatch, code=0, write=True, count=3):
    asked = []

    def run(command, **settings):
        asked.append((command, settings))
        folder = Path(command[-1]).parent
        if write:
            registered = np.array([0, 2, 3])[:count]
            matrices = np.tile(np.eye(4), (len(registered), 1, 1))
            matrices[:, 0, 3] = -1.0 * registered
            frame, point = np.array([0, 2, 2, 3, 0]), np.array([0, 1, 1, 0, 1])
            uv = np.arange(10.0).reshape(5, 2)
            points = np.array([[0, 0, 5.0], [1, 1, 5]])
            np.savez(
                folder / "answer.npz",
                registered=registered,
                world_to_camera=matrices,
                focal=7.5,
                points=points,
                frame=frame,
                point=point,
                uv=uv,
            )
        return SimpleNamespace(returncode=code)

    monkeypatch.setattr(module.subprocess, "run", run)
    return asked


def test_the_answer_of_the_child_is_read(monkeypatch, tmp_path):
    request = {"folder": str(tmp_path), "names": ["a", "b", "c", "d", "e"]}
    asked = answer_with(monkeypatch)
    found = module._ask_colmap(request, (8, 6))
    np.testing.assert_array_equal(found.registered, [1, 0, 1, 1, 0])
    np.testing.assert_allclose(found.bundle.center[:, 0], [0, 0, 2, 3, 0])
    np.testing.assert_array_equal(found.bundle.principal, [4, 3])
    assert found.bundle.focal == 7.5
    seen = found.observations  # one sighting of a point in a frame, the first
    assert sorted(zip(seen.frame.tolist(), seen.point.tolist(), seen.uv[:, 0].tolist(), strict=True)) == [
        (0, 0, 0.0),
        (0, 1, 8.0),
        (2, 1, 2.0),
        (3, 0, 6.0),
    ]
    assert (seen.weight == 1).all()
    command, settings = asked[0]
    assert command[1] == "-P" and json.loads((tmp_path / "request.json").read_text()) == request
    assert settings == {"capture_output": True, "text": True, "check": False}


def test_a_child_that_fails_or_finds_too_little_is_none(monkeypatch, tmp_path):
    request = {"folder": str(tmp_path), "names": ["a", "b", "c", "d", "e"]}
    answer_with(monkeypatch, write=False)
    assert module._ask_colmap(request, (8, 6)) is None
    answer_with(monkeypatch, count=2)
    assert module._ask_colmap(request, (8, 6)) is None
    answer_with(monkeypatch, code=1)
    assert module._ask_colmap(request, (8, 6)) is None

    def broken(*all, **more):
        raise OSError("no interpreter")

    monkeypatch.setattr(module.subprocess, "run", broken)
    with pytest.raises(F4xError, match="cannot be started"):
        module._ask_colmap(request, (8, 6))


@pytest.mark.parametrize(
    ("frames", "gaps"), [(50, ((10, 2), (20, 5))), (31, ((10, 2), (15, 3))), (7, ((3, 1),)), (2, ((1, 1),))]
)
@pytest.mark.parametrize("slope", [1, -1])
def test_fields_of_view_are_tried_on_pairs_ten_and_twenty_apart(monkeypatch, frames, gaps, slope):
    asked = []

    def error(tracks, visible, z, pairs, focal, principal):
        asked.append(pairs)
        return slope * focal

    monkeypatch.setattr(module, "_alignment_error", error)
    tracks = np.tile(np.random.default_rng(0).uniform([0, 0], [WIDTH, HEIGHT], (20, 2)), (frames, 1, 1))
    visible, depth = np.ones((frames, 20), bool), np.ones((frames, HEIGHT, WIDTH), np.float32)
    found, _ = module.solve_with_depth(PointTracks.all_static(tracks, visible), depth, None, WIDTH)
    assert asked[0] == [(i, i + gap) for gap, step in gaps for i in range(0, frames - gap, step)]
    fov = 90 - 70 / 71 if slope > 0 else 20 + 70 / 71  # the best at an end is taken as it is
    assert found.bundle.focal == pytest.approx(WIDTH / 2 / np.tan(np.deg2rad(fov) / 2))


def test_points_seen_once_cover_too():
    visible = np.eye(4, 6, dtype=bool)
    np.testing.assert_array_equal(module.choose_covering_points(visible, 10), [0, 1, 2, 3])
