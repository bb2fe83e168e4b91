"""The formulas of bundle adjustment, each against its plain form: loops, finite differences, dense systems."""

from dataclasses import replace

import numpy as np
import pytest
from test_priors_cameras import FOCAL, PRINCIPAL, observe, project, truth

from f4x_core.geometry import quaternion
from f4x_core.priors import bundle as module
from f4x_core.priors.bundle import Bundle, BundleConfig, Observations, adjust, resect, total_cost, triangulate

FRAMES, POINTS = 4, 15


@pytest.fixture(params=["plain", "compiled"])
def sums(request, monkeypatch):
    """Both ways to add sightings up."""
    if request.param == "plain":
        monkeypatch.setattr(module, "open_library", lambda: (None, "not for this test"))
    elif module.open_library()[0] is None:
        pytest.skip(module.open_library()[1])


def disturbed(zoom=True):
    """Cameras and points that miss what was seen by a few pixels, and the sightings, of different weights."""
    rng = np.random.default_rng(7)
    true = truth(frames=FRAMES, points=POINTS)
    true = replace(true, zoom=np.array([0.9, 1.0, 1.2, 1.1]) if zoom else None)
    seen = observe(true, noise=2.0)
    weight = rng.uniform(0.3, 2.0, len(seen.frame))
    moved = replace(true, points=true.points + 0.01 * rng.standard_normal(true.points.shape))
    return moved, replace(seen, weight=weight)


def seen_by_hand(bundle, seen):
    """Points in camera axes and their pixels, sighting by sighting."""
    local, pixels = [], []
    for frame, point in zip(seen.frame, seen.point, strict=True):
        x, y, z = bundle.rotation[frame] @ (bundle.points[point] - bundle.center[frame])
        local.append((x, y, z))
        pixels.append(bundle.focals[frame] * np.array([x, y]) / z + bundle.principal)
    return np.array(local), np.array(pixels)


def test_residuals_are_projections_minus_sightings_and_infinite_behind():
    bundle, seen = disturbed()
    local, pixels = seen_by_hand(bundle, seen)
    np.testing.assert_allclose(bundle.local(seen), local, atol=1e-12)
    np.testing.assert_allclose(bundle.residuals(seen), pixels - seen.uv, atol=1e-9)
    np.testing.assert_allclose(bundle.errors(seen), np.hypot(*(pixels - seen.uv).T), atol=1e-9)
    behind = replace(
        bundle, points=2 * bundle.center[0] - bundle.points, rotation=np.tile(bundle.rotation[0], (4, 1, 1))
    )
    first = seen.keep(seen.frame == 0)
    assert np.isinf(behind.errors(first)).all()
    near = Bundle(2.0, np.zeros(2), np.eye(3)[None], np.zeros((1, 3)), np.array([[0, 0, 0.5], [0, 0, 1.01e-6]]))
    sighting = Observations(np.zeros(2, int), np.arange(2), np.ones((2, 2)), np.ones(2))
    np.testing.assert_allclose(near.errors(sighting), np.sqrt(2))


def test_cameras_of_some_frames_are_taken_out_and_put_back():
    bundle, _ = disturbed()
    frames = np.array([1, 3])
    part = bundle.of_frames(frames)
    np.testing.assert_array_equal(part.zoom, [1.0, 1.1])
    np.testing.assert_array_equal(part.center, bundle.center[frames])
    moved = replace(part, focal=2 * part.focal, center=part.center + 1, zoom=np.array([3.0, 4.0]))
    back = bundle.with_frames(frames, moved)
    expected = bundle.focals
    expected[frames] = 2 * FOCAL * np.array([3.0, 4.0])
    np.testing.assert_allclose(back.focals, expected)
    np.testing.assert_array_equal(back.center[frames], bundle.center[frames] + 1)
    np.testing.assert_array_equal(back.center[[0, 2]], bundle.center[[0, 2]])
    assert bundle.with_frames(frames, replace(part, zoom=None)).zoom is bundle.zoom


def test_rays_go_through_their_pixels():
    bundle, seen = disturbed()
    found = module.rays(bundle, seen)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    ahead = np.einsum("oij,oj->oi", bundle.rotation[seen.frame], found)
    pixels = bundle.focals[seen.frame, None] * ahead[:, :2] / ahead[:, 2:] + bundle.principal
    np.testing.assert_allclose(pixels, seen.uv, atol=1e-9)
    assert (ahead[:, 2] > 0).all()


def test_triangulated_points_are_nearest_to_their_rays_by_angle():
    bundle, seen = disturbed()
    once, twice = np.flatnonzero(seen.point == 3)[:1], np.flatnonzero(seen.point == 5)[:2]
    rest = np.flatnonzero(~np.isin(seen.point, (3, 5)))
    seen = seen.keep(np.concatenate([rest, once, twice]))
    seen = replace(seen, uv=seen.uv + 30 * np.random.default_rng(0).standard_normal(seen.uv.shape))  # rounds differ
    found, spread = triangulate(bundle, seen, POINTS)
    directions = module.rays(bundle, seen)
    for point in range(POINTS):
        own = np.flatnonzero(seen.point == point)
        if len(own) < 2:
            assert np.isnan(found[point]).all()
            continue
        x = None
        for _ in range(3):
            normal, right = np.zeros((3, 3)), np.zeros(3)
            for o in own:
                c, d, w = bundle.center[seen.frame[o]], directions[o], seen.weight[o]
                w = w if x is None else w / np.sum((x - c) ** 2)
                across = np.eye(3) - np.outer(d, d)
                normal, right = normal + w * across, right + w * across @ c
            x = np.linalg.solve(normal, right)
        np.testing.assert_allclose(found[point], x, rtol=1e-6)
        mean = (seen.weight[own, None] * directions[own]).sum(0)
        mean /= np.linalg.norm(mean)
        assert spread[point] == pytest.approx(2 * max(np.arccos(directions[own] @ mean)), rel=1e-6)
    assert np.isfinite(found[5]).all()
    still = replace(bundle, center=np.zeros_like(bundle.center))
    assert triangulate(replace(still, rotation=bundle.rotation), seen, POINTS)[1][3] < 1e-6  # a single ray


def local_of(problem, seen):
    """(3,O) sighted points in the axes of their camera."""
    pairs = zip(seen.frame, seen.point, strict=True)
    return np.stack([problem.local(frame, problem.points[[point]])[:, 0] for frame, point in pairs], 1)


def problem_of(bundle):
    return module._Problem.of(bundle, np.array([0.1, -0.2, 0.3]), 1.7)


def test_a_problem_is_the_same_geometry_in_other_axes():
    bundle, seen = disturbed()
    problem = problem_of(bundle)
    np.testing.assert_allclose(np.linalg.norm(problem.points, axis=1), 1)
    xyz = problem.points[:, :3] / problem.points[:, 3:]
    np.testing.assert_allclose(xyz, (bundle.points - [0.1, -0.2, 0.3]) / 1.7, rtol=1e-12)
    np.testing.assert_allclose(problem.inverse_distance, 1 / np.linalg.norm(xyz, axis=1), rtol=1e-12)
    for one in (problem, problem.centred(), problem.centred().centred()):
        local = local_of(one, seen)
        np.testing.assert_allclose(
            one.focals[seen.frame] * local[:2] / local[2] + one.principal[:, None],
            seen_by_hand(bundle, seen)[1].T,
            rtol=1e-9,
        )
        back = one.bundle(np.array([0.1, -0.2, 0.3]), 1.7, True)
        for name in ("focals", "rotation", "center", "points"):
            np.testing.assert_allclose(getattr(back, name), getattr(bundle, name), rtol=1e-8, atol=1e-10)
        assert one.bundle(np.zeros(3), 1.0, False).zoom is None
    centred = problem.centred()
    np.testing.assert_allclose(centred.center[FRAMES // 2], 0, atol=1e-12)
    assert np.median(centred.inverse_distance) == pytest.approx(1)
    assert np.log(centred.zoom).mean() == pytest.approx(0, abs=1e-12)


def test_points_never_pass_infinity():
    far = Bundle(1.0, np.zeros(2), np.eye(3)[None], np.zeros((1, 3)), np.array([[0, 0, 3e6], [3.0, 0, 4.0]]))
    problem = module._Problem.of(far, np.zeros(3), 1.0)
    limit = module.MAX_POINT_DISTANCE
    np.testing.assert_allclose(problem.bundle(np.zeros(3), 1.0, False).points, [[0, 0, limit], [3, 0, 4]], rtol=1e-9)
    beyond = replace(problem, points=np.array([[0.0, 0, 1, 0], [0.6, 0, 0.8, 1e-9]]))
    np.testing.assert_allclose(
        beyond.bundle(np.zeros(3), 1.0, False).points, [[0, 0, limit], [0.6 * limit, 0, 0.8 * limit]]
    )
    moved = problem.moved(np.zeros((1, 6)), 0.0, np.zeros((2, 3)), BundleConfig())
    assert 1 / moved.inverse_distance[0] == pytest.approx(limit)
    assert 1 / moved.inverse_distance[1] == pytest.approx(5)


def test_a_step_turns_shifts_and_zooms():
    bundle, _ = disturbed()
    problem = problem_of(bundle)
    rng = np.random.default_rng(0)
    step, shift = 0.1 * rng.standard_normal((FRAMES, 7)), 0.1 * rng.standard_normal((POINTS, 3))
    step[0, 6], step[1, 6] = 2.0, -2.0  # more than a step may zoom
    moved = problem.moved(step, 0.2, shift, BundleConfig(refine_zoom=True))
    turn = quaternion.to_matrix(quaternion.from_rotation_vector(step[:, :3]))
    np.testing.assert_allclose(moved.rotation, turn @ problem.rotation, atol=1e-12)
    np.testing.assert_allclose(moved.center, problem.center + step[:, 3:6])
    np.testing.assert_allclose(moved.zoom, problem.zoom * np.exp(np.clip(step[:, 6], -0.3, 0.3)))
    assert moved.focal == pytest.approx(FOCAL * np.exp(0.2))
    points = problem.points + np.einsum("pij,pj->pi", problem.tangents, shift)
    np.testing.assert_allclose(moved.points, points / np.linalg.norm(points, axis=1, keepdims=True), atol=1e-12)
    for wild in (-5.0, 5.0):
        assert problem.moved(step, wild, shift, BundleConfig()).focal == pytest.approx(FOCAL * np.exp(0.06 * wild))
    held = problem.moved(step, 0.0, shift, BundleConfig(refine_centers=False))
    assert held.center is problem.center and held.zoom is problem.zoom
    directions = np.concatenate([problem.tangents, problem.points[:, :, None]], 2)
    np.testing.assert_allclose(
        directions.transpose(0, 2, 1) @ directions, np.tile(np.eye(4), (POINTS, 1, 1)), atol=1e-12
    )


def test_the_cost_is_cauchys_of_the_squared_errors(sums):
    bundle, seen = disturbed()
    config = BundleConfig(robust_px=1.7)
    squared = bundle.errors(seen) ** 2
    by_hand = seen.weight * 1.7**2 * np.log(1 + squared / 1.7**2)
    frames = [by_hand[seen.frame == frame].sum() for frame in range(FRAMES)]
    np.testing.assert_allclose(module._costs(problem_of(bundle), seen, config), frames, rtol=1e-9)
    behind = 1.7**2 * np.log(1 + module.BEHIND_PX**2 / 1.7**2)
    np.testing.assert_allclose(
        module._robust(np.array([np.inf, 3.0]), config), [behind, 1.7**2 * np.log(1 + 3 / 1.7**2)]
    )
    turned = replace(bundle, rotation=np.diag([1.0, -1.0, -1.0]) @ bundle.rotation)
    assert module._costs(problem_of(turned), seen, config).sum() == pytest.approx(seen.weight.sum() * behind)


def prior_by_hand(problem, config):
    cost = 0.0
    if config.refine_centers:
        away = problem.points[:, 3] / np.linalg.norm(problem.points[:, :3], axis=1) - 1
        cost += module.DEPTH_PRIOR / config.relief**2 * np.mean(away**2)
        cost += module.PATH_PRIOR * np.mean(np.linalg.norm(problem.center, axis=1) ** 2)
    if config.refine_focal and config.expected_focal:
        away = abs(np.log(problem.focal / config.expected_focal))
        cost += config.focal_prior * np.log(1 + (away / module.FOCAL_SPREAD) ** 2)
        cost += config.focal_prior * (max(away - np.log(4), 0) / module.FOCAL_SPREAD) ** 2
    if config.refine_zoom:
        logarithm = np.log(problem.zoom)
        bends = logarithm[2:] - 2 * logarithm[1:-1] + logarithm[:-2]
        cost += module.ZOOM_PRIOR * ((bends**2).sum() + logarithm.mean() ** 2) / FRAMES / module.ZOOM_CHANGE**2
    return cost


@pytest.mark.parametrize("zooms", [False, True])
def test_what_is_believed_costs_what_its_docstring_says(zooms):
    bundle, seen = disturbed()
    config = BundleConfig(expected_focal=1.3 * FOCAL, focal_prior=0.02, refine_zoom=zooms, relief=0.7)
    problem = problem_of(bundle)
    if not zooms:
        assert module._prior_cost(problem, replace(config, refine_centers=False, refine_focal=False), 1.0) == 0
    short, long = (replace(config, expected_focal=FOCAL * ratio) for ratio in (5.0, 0.2))
    for one in (config, replace(config, refine_centers=False), replace(config, refine_focal=False), short, long):
        assert module._prior_cost(problem, one, 3.0) == pytest.approx(3 * prior_by_hand(problem, one))
    centred = module._Problem.of(bundle, bundle.center[2], module._unit(bundle)).centred()
    cost = module._costs(centred, seen, config).sum()
    expected = cost * (1 + prior_by_hand(centred, config)) / len(seen.frame)
    assert total_cost(bundle, seen, config) == pytest.approx(expected)


def test_the_unit_is_the_median_distance_of_finite_points():
    bundle, _ = disturbed()
    distance = np.linalg.norm(bundle.points - bundle.center[2], axis=1)
    assert module._unit(bundle) == pytest.approx(np.median(distance))
    lost = bundle.points.copy()
    lost[:5] = np.nan
    assert module._unit(replace(bundle, points=lost)) == pytest.approx(np.median(distance[5:]))
    assert module._unit(replace(bundle, points=lost[:5])) == 1
    matrices = bundle.world_to_camera
    np.testing.assert_allclose(module.from_matrices(matrices, 3.0, PRINCIPAL).center, bundle.center, atol=1e-12)
    np.testing.assert_allclose(module.from_matrices(matrices, 3.0, PRINCIPAL).rotation, bundle.rotation, atol=1e-12)
    assert module.from_matrices(matrices, 3.0, PRINCIPAL).points.shape == (0, 3)
    assert module.from_matrices(matrices, 3.0, PRINCIPAL, bundle.points).points is bundle.points
    assert replace(bundle, zoom=None).of_frames(np.array([1])).zoom is None
    small = replace(bundle, points=bundle.center[2] + 0.01 * (bundle.points - bundle.center[2]))
    assert module._unit(small) == pytest.approx(0.01 * np.median(distance))


def residuals_of(problem, seen):
    local = local_of(problem, seen)
    return (problem.focals[seen.frame] * local[:2] / local[2] + problem.principal[:, None] - seen.uv.T).T.ravel()


def equations_of(problem, seen, config, belief):
    return module._normal_equations(problem, module._grouped(seen, len(problem.points)), config, belief)


def whole_coupling(equations):
    """(3, 6F+1, P) of the groups of normal equations."""
    size, count = len(equations.gradient), len(equations.points)
    whole = np.zeros((3, size, count))
    for group, coupling in equations.coupling:
        whole[np.ix_(range(3), group.unknowns((size - 1) // FRAMES) % size, group.points)] += coupling
    return whole


def dense_normal_equations(problem, seen, config):
    """Jacobian of all residuals by finite differences, and the weights of Cauchy's cost."""
    own = 7 if config.refine_zoom else 6
    sizes = (FRAMES * own, 1, 3 * POINTS)
    columns = []
    for index in range(sum(sizes)):
        sides = []
        for h in (1e-6, -1e-6):
            step = np.zeros(sum(sizes))
            step[index] = h
            cameras, focal, points = np.split(step, np.cumsum(sizes)[:2])
            moved = problem.moved(cameras.reshape(FRAMES, own), focal[0], points.reshape(-1, 3), config)
            sides.append(residuals_of(moved, seen))
        columns.append((sides[0] - sides[1]) / 2e-6)
    residual = residuals_of(problem, seen)
    weight = seen.weight / (1 + (residual.reshape(-1, 2) ** 2).sum(1) / config.robust_px**2)
    jacobian = np.stack(columns, 1)
    if not config.refine_focal:
        jacobian[:, sizes[0]] = 0
    weighted = np.repeat(weight, 2)[:, None] * jacobian
    return weighted.T @ jacobian, weighted.T @ residual


@pytest.mark.parametrize("changes", [{}, {"refine_zoom": True}, {"refine_focal": False}, {"refine_centers": False}])
def test_normal_equations_are_those_of_the_dense_jacobian(changes, sums):
    bundle, seen = disturbed()
    config = replace(BundleConfig(robust_px=1.5), **changes)
    problem = problem_of(bundle)
    equations = equations_of(problem, seen, config, 0.0)
    camera, gradient, points, point_gradient, _ = equations
    normal, right = dense_normal_equations(problem, seen, config)
    size = len(gradient)
    scale = abs(normal).max()
    np.testing.assert_allclose(camera, normal[:size, :size], atol=1e-7 * scale)
    np.testing.assert_allclose(gradient, right[:size], atol=1e-6 * abs(right).max())
    np.testing.assert_allclose(point_gradient.ravel(), right[size:], atol=1e-6 * abs(right).max())
    found = whole_coupling(equations).transpose(1, 2, 0).reshape(size, -1)
    np.testing.assert_allclose(found, normal[:size, size:], atol=1e-7 * scale)
    for point in range(POINTS):
        own = slice(size + 3 * point, size + 3 * point + 3)
        np.testing.assert_allclose(points[point], normal[own, own], atol=1e-7 * scale)


@pytest.mark.parametrize("zooms", [False, True])
def test_beliefs_pull_as_their_derivatives_do(zooms):
    """Least squares: a belief (x / s)^2 adds its weight to the diagonal, and weight times distance to the gradient."""
    bundle, seen = disturbed()
    config = BundleConfig(expected_focal=1.3 * FOCAL, focal_prior=0.02, refine_zoom=zooms, relief=0.7)
    problem, belief = problem_of(bundle), 40.0
    plain = equations_of(problem, seen, replace(config, expected_focal=None), 0.0)
    found = equations_of(problem, seen, config, belief)
    camera, gradient, points, point_gradient = (b - a for a, b in zip(plain[:4], found[:4], strict=True))
    own = 7 if zooms else 6
    expected, right = np.zeros_like(camera), np.zeros_like(gradient)
    for frame in range(FRAMES):
        for axis in range(3):
            row = own * frame + 3 + axis
            expected[row, row] = belief * module.PATH_PRIOR / FRAMES
            right[row] = belief * module.PATH_PRIOR / FRAMES * problem.center[frame, axis]
    away = np.log(problem.focal / config.expected_focal)
    pull = belief * config.focal_prior / (module.FOCAL_SPREAD**2 + away**2)
    expected[-1, -1], right[-1] = pull, pull * away
    if zooms:
        rows = np.array([[1, -2, 1, 0], [0, 1, -2, 1], [0.25] * 4]) / 2  # over the root of four frames
        weight = belief * module.ZOOM_PRIOR / module.ZOOM_CHANGE**2
        places = 7 * np.arange(FRAMES) + 6
        expected[np.ix_(places, places)] += weight * rows.T @ rows
        right[places] += weight * rows.T @ rows @ np.log(problem.zoom)
    np.testing.assert_allclose(camera, expected, atol=1e-6)
    np.testing.assert_allclose(gradient, right, atol=1e-6)
    np.testing.assert_array_equal(whole_coupling(plain), whole_coupling(found))
    weight = belief * module.DEPTH_PRIOR / 0.49 / POINTS
    for point in range(POINTS):
        slope = np.zeros(3)
        for axis in range(3):
            sides = []
            for h in (1e-6, -1e-6):
                step = np.zeros((POINTS, 3))
                step[point, axis] = h
                sides.append(problem.moved(np.zeros((FRAMES, own)), 0.0, step, config).inverse_distance[point])
            slope[axis] = (sides[0] - sides[1]) / 2e-6
        np.testing.assert_allclose(points[point], weight * np.outer(slope, slope), atol=1e-8)
        miss = problem.inverse_distance[point] - 1
        np.testing.assert_allclose(point_gradient[point], weight * slope * miss, atol=1e-8)
    still = replace(config, refine_centers=False, refine_focal=False, refine_zoom=False)
    for a, b in zip(*(equations_of(problem, seen, still, belief)[:4] for belief in (0.0, 9.0)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("fixed", [False, True])
def test_the_step_solves_the_damped_dense_system(fixed):
    bundle, seen = disturbed()
    config = BundleConfig(refine_centers=not fixed, refine_focal=not fixed)
    equations = equations_of(problem_of(bundle), seen, config, 10.0)
    camera, gradient, points, point_gradient, _ = equations
    damping, size = 0.05, len(gradient)
    dense = np.zeros((size + 3 * POINTS,) * 2)
    own = np.diag(camera)
    dense[:size, :size] = camera + np.diag(damping * own + np.where(own > 0, 1e-9 * own.mean(), 1.0))
    dense[:size, size:] = whole_coupling(equations).transpose(1, 2, 0).reshape(size, -1)
    dense[size:, :size] = dense[:size, size:].T
    floor = 1e-9 * np.mean([np.diag(block) for block in points])
    for point in range(POINTS):
        place = slice(size + 3 * point, size + 3 * point + 3)
        dense[place, place] = points[point] + np.diag(damping * np.diag(points[point]) + floor)
    step = np.linalg.solve(dense, -np.concatenate([gradient, point_gradient.ravel()]))
    cameras, focal, moved = module._solve(equations, damping, FRAMES)
    np.testing.assert_allclose(cameras.ravel(), step[: size - 1], rtol=1e-5, atol=1e-9)
    assert focal == pytest.approx(step[size - 1], rel=1e-5, abs=1e-9)
    np.testing.assert_allclose(moved.ravel(), step[size:], rtol=1e-5, atol=1e-9)
    assert cameras.shape == (FRAMES, 6) and not (fixed and cameras[:, 3:].any())


def test_points_in_groups_give_the_step_of_all_at_once(monkeypatch):
    """Points that some frames do not see, one that none sees, and two groups that end together."""
    bundle, seen = disturbed()
    hidden = (seen.point % 3 == 0) & (seen.frame < 2) | (seen.point % 3 == 1) & (seen.frame == 3) | (seen.point == 5)
    seen = seen.keep(~hidden)
    steps = []
    for run, count in ((1, 4), (16, 1)):
        monkeypatch.setattr(module, "RUN_STEP", run)
        groups = module._grouped(seen, POINTS)
        assert len(groups) == count and sum(len(group.seen.frame) for group in groups) == len(seen.frame)
        equations = module._normal_equations(problem_of(bundle), groups, BundleConfig(), 10.0)
        steps.append(module._solve(equations, 0.05, FRAMES))
    for one, other in zip(*steps, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-12)
    assert module._grouped(seen.keep(np.zeros(0, int)), 0) == []


class Recorder:
    """Stands in for the solver of `adjust`: remembers its damping, and answers with the real step or a bad one."""

    def __init__(self, good):
        self.good, self.damping, self.solve = list(good), [], module._solve

    def __call__(self, equations, damping, cameras):
        self.damping.append(damping)
        step = self.solve(equations, damping, cameras)
        good = self.good.pop(0) if self.good else True
        return step if good else (10 + 0 * step[0], 0.0, 0 * step[2])  # turned away from everything


def test_damping_grows_until_a_step_helps_and_falls_after_it(monkeypatch):
    bundle, seen = disturbed()
    solver = Recorder([False, False, True, True, False, True])
    monkeypatch.setattr(module, "_solve", solver)
    bundle = replace(bundle, center=bundle.center + 0.05 * np.random.default_rng(0).standard_normal((FRAMES, 3)))
    adjust(bundle, seen, BundleConfig(iterations=3))
    start, after = 1e-4 * np.array([1, 8, 64]), 1e-4 * 64 / 5
    np.testing.assert_allclose(solver.damping, [*start, after, after / 5, 8 * after / 5])


def test_adjusting_ends_where_no_step_helps(monkeypatch):
    bundle, seen = disturbed()
    solver = Recorder([False] * 50)
    monkeypatch.setattr(module, "_solve", solver)
    found = adjust(bundle, seen, BundleConfig(iterations=5))
    np.testing.assert_allclose(solver.damping, 1e-4 * 8.0 ** np.arange(8))
    np.testing.assert_allclose(found.points, bundle.points, rtol=1e-9)
    assert found.zoom is not None


def test_adjusting_ends_where_the_error_hardly_falls(monkeypatch):
    """The cost falls with every step, until the fall is less than 1e-4 of the cost before it."""
    true = truth(frames=FRAMES, points=60)
    seen = observe(true, noise=0.5)
    calls, linearised = [], module._normal_equations
    monkeypatch.setattr(module, "_normal_equations", lambda *all: calls.append(0) or linearised(*all))
    start = replace(true, points=true.points * 1.02)
    found = adjust(start, seen, BundleConfig(iterations=40, refine_focal=False))
    steps = len(calls)
    assert 2 < steps < 40
    held = BundleConfig(refine_focal=False)
    ends = [adjust(start, seen, replace(held, iterations=n)) for n in (steps - 2, steps - 1, steps)]
    costs = [total_cost(end, seen, held) for end in ends]
    assert costs[0] - costs[1] > 1e-4 * costs[0] and costs[1] - costs[2] < 1.01e-4 * costs[1]
    assert np.median(found.errors(seen)) < np.median(start.errors(seen))


def test_without_sightings_nothing_is_adjusted():
    bundle, seen = disturbed()
    nothing = seen.keep(np.zeros(len(seen.frame), bool))
    assert adjust(bundle, nothing) is bundle
    assert resect(bundle, nothing, np.arange(FRAMES)) is bundle
    assert np.isfinite(total_cost(bundle, nothing, BundleConfig()))


def resected_by_hand(bundle, seen, frame, iterations, damping=1e-3, robust=2.0):
    """Levenberg and Marquardt's steps of one camera, derivatives by finite differences."""
    own = seen.keep(seen.frame == frame)

    def moved(bundle, step):
        turn = quaternion.to_matrix(quaternion.from_rotation_vector(step[:3]))
        rotation, center = bundle.rotation.copy(), bundle.center.copy()
        rotation[frame], center[frame] = turn @ rotation[frame], center[frame] + step[3:]
        return replace(bundle, rotation=rotation, center=center)

    def cost(bundle):
        squared = np.minimum(bundle.errors(own), module.BEHIND_PX) ** 2
        return (own.weight * robust**2 * np.log(1 + squared / robust**2)).sum()

    now = cost(bundle)
    for _ in range(iterations):
        ahead = bundle.local(own)[:, 2] > 0
        front = own.keep(ahead)
        residual = bundle.residuals(front)
        weight = np.repeat(front.weight / (1 + (residual**2).sum(1) / robust**2), 2)[:, None]
        h = 1e-6 * np.eye(6)
        sides = [moved(bundle, e).residuals(front) - moved(bundle, -e).residuals(front) for e in h]
        jacobian = np.stack([side.ravel() / 2e-6 for side in sides], 1)
        normal = jacobian.T @ (weight * jacobian)
        normal += damping * np.diag(np.diag(normal)) + 1e-9 * np.eye(6)
        tried = moved(bundle, -np.linalg.solve(normal, jacobian.T @ (weight[:, 0] * residual.ravel())))
        better = cost(tried) < now
        if better:
            bundle, now = tried, cost(tried)
        damping = damping / 3 if better else damping * 10
    return bundle


@pytest.mark.parametrize(("iterations", "far"), [(1, 0.03), (3, 0.03), (8, 0.6)])
def test_resecting_is_levenberg_marquardt_of_one_camera(iterations, far, sums):
    bundle, seen = disturbed()
    rng = np.random.default_rng(5)
    center, rotation = bundle.center.copy(), bundle.rotation.copy()
    center[2] += far * rng.standard_normal(3)
    rotation[2] = quaternion.to_matrix(quaternion.from_rotation_vector(far * rng.standard_normal(3))) @ rotation[2]
    points = bundle.points.copy()
    points[4] = np.nan  # of no use
    points[6] = 2 * center[2] - points[6]  # behind the camera
    start = replace(bundle, center=center, rotation=rotation, points=points)
    found = resect(start, seen, np.array([2]), iterations)
    expected = resected_by_hand(start, seen.keep(seen.point != 4), 2, iterations)
    np.testing.assert_allclose(found.center, expected.center, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-6)
    assert (found.center[2] != start.center[2]).any()


def test_a_rejected_step_of_resecting_is_tried_again_with_ten_times_the_damping(monkeypatch):
    bundle, seen = disturbed()
    center = bundle.center.copy()
    center[2] += [0.03, -0.02, 0.01]
    start = replace(bundle, center=center)
    expected = resected_by_hand(start, seen, 2, 1, damping=0.1)
    costs, real = [0, 1, 1], module._costs  # the start's, then two steps that are refused
    monkeypatch.setattr(module, "_costs", lambda *all: real(*all) + (costs.pop(0) * 1e9 if costs else 0))
    found = resect(start, seen, np.array([2]), 3)
    np.testing.assert_allclose(found.center, expected.center, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-6)


def test_sightings_are_told_apart_by_frame_and_point():
    seen = project(truth(frames=3, points=9))[1]
    frame, point = np.nonzero(seen)
    all_seen = Observations(frame, point, np.zeros((len(frame), 2)), np.arange(1.0, len(frame) + 1))
    np.testing.assert_array_equal(all_seen.visible(3, 9), seen)
    mixed = all_seen.keep(np.random.default_rng(0).permutation(np.flatnonzero((frame != 1) & (point != 4))))
    views = mixed.by_frame(3)
    assert [len(view.frame) for view in views] == [sum(mixed.frame == 0), 0, sum(mixed.frame == 2)]
    for view in views[::2]:
        np.testing.assert_array_equal(view.weight, mixed.weight[mixed.frame == view.frame[0]])
    used, fewer = mixed.of_points()
    assert 4 not in used
    np.testing.assert_array_equal(used[fewer.point], mixed.point)


def test_a_point_behind_its_camera_pulls_nothing(sums):
    bundle, seen = disturbed()
    turned = replace(bundle, rotation=np.where(np.arange(4)[:, None, None] == 1, -1.0, 1.0) * bundle.rotation)
    found, without = (
        module._sums(problem_of(turned), part, BundleConfig(refine_zoom=True))
        for part in (seen, seen.keep(seen.frame != 1))
    )
    assert not found.blocks[1].any() and not found.slopes[1].any() and found.blocks[0].any()
    for one, other in zip(found, without, strict=True):
        np.testing.assert_array_equal(one, other)
    near = replace(problem_of(bundle), rotation=np.tile(np.eye(3), (4, 1, 1)), center=np.zeros((4, 3)))
    for z, counts in ((1.1e-6, True), (0.9e-6, False)):
        near.points[:] = 0.6, 0.8, z, 0.0
        assert module._sums(near, seen, BundleConfig()).blocks.any() == counts


def test_points_that_are_held_take_no_sums():
    problem, (_, seen) = problem_of(disturbed()[0]), disturbed()
    full, cameras = (module._sums(problem, seen, BundleConfig(), held) for held in (False, True))
    np.testing.assert_array_equal(full.blocks, cameras.blocks)
    np.testing.assert_array_equal(full.slopes, cameras.slopes)
