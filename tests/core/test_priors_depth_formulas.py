"""The formulas of dense depth, each against its plain form: loops over pixels, dense matrices, worked cases."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import ndimage
from test_priors_depth import plane_priors

from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig
from f4x_core.priors import depth as module
from f4x_core.priors.bundle import Observations, from_matrices, triangulate
from f4x_core.progress import silent

WIDTH, HEIGHT = 40, 28


def path(frames=5, seed=0, zoom=0.0):
    """Cameras that step and turn, whose pixels are not square, with the centre beside the middle."""
    rng = np.random.default_rng(seed)
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    turns = 0.06 * rng.standard_normal((frames, 3))
    matrices[:, :3, :3] = quaternion.to_matrix(quaternion.from_rotation_vector(turns))
    matrices[:, :3, 3] = 0.15 * rng.standard_normal((frames, 3))
    lens = np.tile(np.array([[30.0, 0, 18], [0, 36.0, 15], [0, 0, 1]]), (frames, 1, 1))
    lens[:, 0, 0] *= 1 + zoom * np.arange(frames)
    lens[:, 1, 1] *= 1 + zoom * np.arange(frames)
    return CameraPath(lens, matrices, np.arange(float(frames)), WIDTH, HEIGHT)


def measured_by_hand(cameras, frame, pixel, targets):
    """Inverse depth of one pixel and its precision; `targets` are (other frame, (2,), weight)."""
    here = cameras[frame]
    fx, fy = here.intrinsics[0, 0], here.intrinsics[1, 1]
    ray = np.array([(pixel[0] - here.intrinsics[0, 2]) / fx, (pixel[1] - here.intrinsics[1, 2]) / fy, 1])
    gains, offsets, given = [], [], []
    for other, seen, weight in targets:
        there = cameras[other]
        relative = there.world_to_camera @ np.linalg.inv(here.world_to_camera)
        a, t = relative[:3, :3] @ ray, relative[:3, 3]
        u = (seen[0] - there.intrinsics[0, 2]) / there.intrinsics[0, 0]
        v = (seen[1] - there.intrinsics[1, 2]) / there.intrinsics[1, 1]
        gains.append(np.array([t[0] - u * t[2], t[1] - v * t[2]]) / a[2])
        offsets.append(np.array([u * a[2] - a[0], v * a[2] - a[1]]) / a[2])
        given.append(weight)
    gains, offsets, given = np.array(gains), np.array(offsets), np.array(given)
    square, along = (gains**2).sum(1), (gains * offsets).sum(1)
    each = along / square
    order = np.argsort(each)
    half = np.cumsum((given * np.sqrt(square))[order])
    rho = each[order][np.argmax(half >= half[-1] / 2)]
    for _ in range(4):
        miss = fx**2 * ((gains * rho - offsets) ** 2).sum(1)
        weight = given / (1 + miss / module.FLOW_OUTLIER_PX**2)
        rho = (weight * along).sum() / (weight * square).sum()
    missed = (given * np.minimum(miss, module.MISS_LIMIT_PX**2)).sum() / given.sum()
    doubt = max(missed / module.FLOW_NOISE_PX**2, 1)
    return rho, (weight * square).max() * (fx / module.FLOW_NOISE_PX) ** 2 / doubt


def test_flow_over_many_gaps_is_triangulated_pixel_by_pixel():
    cameras, rng = path(), np.random.default_rng(1)
    pixels, inverse = rng.uniform([0, 0], [WIDTH, HEIGHT], (60, 2)), rng.uniform(0.2, 1.5, 60)
    points = cameras[2].unproject(pixels, 1 / inverse)
    targets = []
    for other in (0, 1, 3, 4):
        seen = cameras[other].project(points)[0] + rng.normal(0, 0.4, (60, 2))
        seen[::7] += rng.normal(0, 8, (9, 2))  # what moves by itself, or flow that is wrong
        targets.append((other, seen, rng.uniform(0.1, 1, 60)))
    rho, precision = module.inverse_depth_from_flow(cameras, 2, pixels, targets)
    for pixel in range(60):
        own = [(other, seen[pixel], weight[pixel]) for other, seen, weight in targets]
        expected = measured_by_hand(cameras, 2, pixels[pixel], own)
        np.testing.assert_allclose((rho[pixel], precision[pixel]), expected, rtol=1e-9)
    nowhere = [(other, seen, np.zeros(60)) for other, seen, _ in targets]
    rho, precision = module.inverse_depth_from_flow(cameras, 2, pixels, nowhere)
    assert np.isfinite(rho).all() and not precision.any()


def test_the_epipolar_direction_is_where_a_shift_of_the_camera_moves_a_pixel():
    cameras, pixels = path(), np.array([[3.0, 4], [20, 25], [39, 1]])
    found = module.epipolar_direction(cameras, 2, pixels, [0, 1, 3])
    away = [np.linalg.norm(cameras[other].center - cameras[2].center) for other in (0, 1, 3)]
    step = cameras[2].world_to_camera[:3, :3] @ (cameras[(0, 1, 3)[np.argmax(away)]].center - cameras[2].center)
    fx, fy, cx, cy = 30.0, 36.0, 18.0, 15.0
    for pixel, one in zip(pixels, found, strict=True):
        ray = np.array([(pixel[0] - cx) / fx, (pixel[1] - cy) / fy, 1])
        sides = [(ray + h * step)[:2] / (ray + h * step)[2] for h in (1e-6, -1e-6)]
        np.testing.assert_allclose(one, (sides[0] - sides[1]) / 2e-6, rtol=1e-6)
    assert not module.epipolar_direction(cameras, 2, pixels, []).any()


def dense_roughness(guide, smooth, flat):
    """Normal matrix of the smoothness terms, term by term."""
    index, total = np.arange(guide.size).reshape(guide.shape), np.zeros((guide.size,) * 2)
    for lines in (np.arange(guide.size).reshape(guide.shape), index.T):
        levels = guide.ravel()[lines].astype(float)
        for line, grey in zip(lines, levels, strict=True):
            same = np.exp(-abs(np.diff(grey)) / module.EDGE_GREY)
            for i in range(len(line) - 1):
                slack = module.EDGE_SLACK + (1 - module.EDGE_SLACK) * same[i]
                total[np.ix_(line[i : i + 2], line[i : i + 2])] += smooth * slack * np.outer([1, -1], [1, -1])
            for i in range(len(line) - 2):
                weight = flat * min(same[i], same[i + 1])
                total[np.ix_(line[i : i + 3], line[i : i + 3])] += weight * np.outer([1, -2, 1], [1, -2, 1])
    return total


@pytest.mark.parametrize("shape", [(5, 7), (1, 6), (2, 2), (6, 1)])
def test_maps_are_smooth_as_the_sum_of_their_differences_asks(shape, either):
    rng = np.random.default_rng(0)
    guide = rng.uniform(0, 60, shape).astype(np.float32)
    weight, sample, start = rng.uniform(0.1, 3, shape), rng.normal(size=shape), rng.normal(size=shape)
    bands = module._roughness(guide, 2.0, 5.0)
    found = either(bands, weight, sample, start, 500)
    system = dense_roughness(guide, 2.0, 5.0) + np.diag(weight.ravel())
    np.testing.assert_allclose(found.ravel(), np.linalg.solve(system, (weight * sample).ravel()), rtol=1e-3, atol=1e-3)
    short = [solve(bands, weight, sample, start, 3) for solve in (either, module._plain_smooth_map)]
    np.testing.assert_allclose(*short, atol=1e-9)  # step by step the same
    np.testing.assert_array_equal(either(bands, weight, sample, start, 0), start)


def test_steps_of_surfaces_count_where_they_are_trusted():
    rng = np.random.default_rng(3)
    surface, grey = rng.uniform(0, 3, (5, 7)), rng.uniform(0, 60, (5, 7))
    for trust, alone in ((1.0, module.EDGE_GREY * surface), (0.0, grey)):
        mixed = module._roughness(np.stack([surface, np.full((5, 7), trust), grey], -1), 2.0, 5.0)
        for name, entries in module._roughness(alone, 2.0, 5.0).items():
            np.testing.assert_allclose(mixed[name], entries, rtol=1e-12, err_msg=name)


@pytest.fixture(params=["compiled", "plain"])
def either(request):
    """Both forms of the smooth map through samples."""
    if request.param == "compiled":
        request.getfixturevalue("native_library")
        return module._smooth_map
    return module._plain_smooth_map


def filled_by_hand(inverse, precision, guide, start, curvature):
    """The minimum by dense equations, three rounds of weights."""
    usual = np.median(start)
    system = dense_roughness(guide, 1 / (module.SLOPE * usual) ** 2, 1 / (curvature * usual) ** 2)
    limit, solution = 1 / (module.SAMPLE_NOISE * usual) ** 2, start.ravel()
    for _ in range(3):
        miss = (inverse.ravel() - solution) * np.sqrt(np.minimum(precision.ravel(), 6 * limit))
        weight = np.minimum(precision.ravel(), limit) / (1 + (miss / 3) ** 2)
        solution = np.linalg.solve(system + np.diag(weight), weight * inverse.ravel())
    return solution.reshape(inverse.shape)


def samples_to_fill(height, width, seed=0):
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:height, :width]
    true = 0.5 + 0.04 * rows + 0.02 * columns
    inverse = true * np.exp(0.02 * rng.standard_normal(true.shape))
    inverse[rng.random(true.shape) < 0.1] *= 1.6  # outliers
    precision = rng.uniform(10, 4e3, true.shape) * (rng.random(true.shape) < 0.6)
    precision[2, 3] = 1e9  # no sample outweighs the others without limit
    guide = (30 * (columns > width // 2) + 4 * rng.random(true.shape)).astype(np.float32)
    return inverse * (precision > 0), precision, guide


def test_filling_is_the_minimum_of_its_energy():
    inverse, precision, guide = samples_to_fill(14, 20)
    start = module.pyramid_mean(inverse, precision)
    found = module.fill_inverse_depth(inverse, precision, guide, 900, 0.02)
    np.testing.assert_allclose(found, filled_by_hand(inverse, precision, guide, start, 0.02), rtol=2e-4)
    defaults = module.fill_inverse_depth(inverse, precision, guide, 900)
    np.testing.assert_allclose(defaults, filled_by_hand(inverse, precision, guide, start, module.CURVATURE), rtol=2e-4)


def test_filling_starts_at_the_solution_for_half_the_size(monkeypatch):
    inverse, precision, guide = samples_to_fill(32, 32)
    rounds, solve = [], module._plain_smooth_map
    for name in ("_smooth_map", "_plain_smooth_map"):
        monkeypatch.setattr(module, name, lambda *args: rounds.append(args[-1]) or solve(*args))
    smaller = []
    fill = module.fill_inverse_depth
    monkeypatch.setattr(module, "fill_inverse_depth", lambda *args: smaller.append(args) or fill(*args))
    found = fill(inverse, precision, guide, 30, 0.02)
    assert rounds == [20, 20, 20, 10, 10, 10]
    ((rho, sure, grey, iterations, curvature),) = smaller
    cells = (precision.reshape(16, 2, 16, 2), (precision * inverse).reshape(16, 2, 16, 2))
    mean, total = (cell.mean((1, 3)) for cell in cells)
    known = mean > 0
    np.testing.assert_allclose(rho[known], (total / np.where(known, mean, 1))[known])
    assert not rho[~known].any() and (iterations, curvature) == (60, 0.04)
    np.testing.assert_allclose(sure, 4 * mean)
    np.testing.assert_allclose(grey, guide.reshape(16, 2, 16, 2).mean((1, 3)), rtol=1e-5)
    coarse = fill(rho, sure, grey, iterations, curvature)
    start = cv2.resize(coarse, (32, 32), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(
        fill(inverse, precision, guide, 900, 0.02)[4:-4, 4:-4],
        filled_by_hand(inverse, precision, guide, start, 0.02)[4:-4, 4:-4],
        rtol=3e-3,
    )
    assert found.shape == (32, 32)
    smaller.clear()
    fill(inverse[:31], precision[:31], guide[:31], 3)
    assert not smaller, "the coarsest grid has at least 16 samples along its shorter side"


def test_holes_take_the_mean_of_a_growing_neighbourhood():
    rng = np.random.default_rng(0)
    values, weight = rng.uniform(1, 2, (9, 12)), rng.uniform(0.5, 2, (9, 12)) * (rng.random((9, 12)) < 0.3)
    floor = 1e-3 * weight[weight > 0].mean()
    pyramid = [(values * weight, weight)]
    for _ in range(3):  # 9 x 12, 5 x 6, 3 x 3, 2 x 2
        pyramid.append(tuple(cv2.pyrDown(part) for part in pyramid[-1]))
    mean = np.full((2, 2), pyramid[-1][0].sum() / pyramid[-1][1].sum())
    for total, norm in pyramid[::-1]:
        mean = (total + floor * cv2.resize(mean, norm.shape[::-1])) / (norm + floor)
    found = module.pyramid_mean(values, weight)
    np.testing.assert_allclose(found, mean, rtol=1e-9)
    np.testing.assert_allclose(found[weight > 0], values[weight > 0], rtol=5e-3)
    np.testing.assert_array_equal(module.pyramid_mean(values, np.zeros((9, 12))), np.ones((9, 12)))
    np.testing.assert_allclose(module.pyramid_mean(values, 1e-4 * weight), found, rtol=1e-9)


def test_down_is_the_mean_of_the_cameras_downs():
    cameras = path()
    mean = sum(one[1, :3] for one in cameras.world_to_camera) / 5
    np.testing.assert_allclose(cameras.mean_down, mean / np.linalg.norm(mean))
    local = (np.array([7.0, 20]) - [18, 15]) / [30, 36]
    ray = np.array([*local, 1])
    down = cameras.world_to_camera[2, :3, :3] @ cameras.mean_down
    found = module.below_horizon(cameras[2], np.array([[7.0, 20], [18, -40]]), cameras.mean_down)
    np.testing.assert_allclose(found[0], [max(ray @ down, 0), np.linalg.norm(ray)])
    assert found[1, 0] == 0
    plain = module.ground_prior(cameras)[2, 19, 6]
    here = module.below_horizon(cameras[2], np.array([6.5, 19.5]), cameras.mean_down)
    assert plain == pytest.approx(0.7 * here[1] + here[0], rel=1e-6)


def test_the_plain_world_is_a_robust_ridge_regression():
    rng = np.random.default_rng(0)
    below = np.stack([np.maximum(np.linspace(-0.3, 0.6, 30), 0)[:, None] * np.ones(40), np.full((30, 40), 1.1)], -1)
    below[..., 1] += 0.1 * rng.random((30, 40))
    usual = 0.6
    inverse = usual * (1.5 * below[..., 0] + 0.4 * below[..., 1]) * np.exp(0.1 * rng.standard_normal((30, 40)))
    inverse[:6] *= 4
    precision = rng.uniform(0, 40, (30, 40)) / usual**2
    precision[20] = 1e6
    shape, values = below.reshape(-1, 2), inverse.ravel() / usual
    believed = np.array([1, 0.7]) / np.median(shape @ [1, 0.7])
    factors, trust = believed, np.minimum(precision.ravel() * usual**2, 1 / module.SAMPLE_NOISE)
    for _ in range(4):
        normal, right = module.PLAIN_SAMPLES * np.eye(2), module.PLAIN_SAMPLES * believed
        for row, value, sure in zip(shape, values, trust, strict=True):
            weight = sure / (sure + 1 / module.PLAIN_NOISE**2)
            weight /= 1 + ((value - row @ factors) / module.PLAIN_NOISE) ** 2
            normal, right = normal + weight * np.outer(row, row), right + weight * value * row
        factors = np.linalg.solve(normal, right)
    found = module.plain_world(inverse, precision, below, usual)
    np.testing.assert_allclose(found, usual * (below @ factors), rtol=1e-9)


def test_trust_falls_with_disagreement_and_with_what_is_known():
    rng = np.random.default_rng(0)
    filled = rng.uniform(0.5, 1, (20, 24))
    rho = filled * np.exp(0.2 * rng.standard_normal((20, 24)))
    rho[3, 4] = 5 * filled[3, 4]  # wrong beyond measure
    precision = rng.uniform(0, 900, (20, 24)) * (rng.random((20, 24)) < 0.7)
    known, miss = np.zeros((2, 20, 24))
    for y in range(20):
        for x in range(24):
            known[y, x] = min(precision[y, x] * filled[y, x] ** 2, 400)
            miss[y, x] = min(abs(rho[y, x] / filled[y, x] - 1), 1) if precision[y, x] > 0 else 0
    known, miss = ndimage.gaussian_filter(known, 3), ndimage.gaussian_filter(miss, 1.5)
    expected = known / (known + 50) / (1 + (miss / 0.2) ** 2)
    np.testing.assert_allclose(module._confidence(filled, rho, precision), expected, rtol=1e-9)


def test_targets_are_where_flow_agrees_and_nothing_moves():
    rng = np.random.default_rng(0)
    frames, height, width = 5, 12, 16
    flows = {gap: rng.normal(0.4 * gap, 0.5, (frames, height, width, 2)).astype(np.float16) for gap in (1, 4, -1, -4)}
    for gap in (1, 4):  # the way back agrees in half of the picture
        back = np.roll(flows[gap], gap, 0)
        flows[-gap][:, :, : width // 2] = -back[:, :, : width // 2]
    blocked = rng.random((frames, height, width)) < 0.2
    rows, columns = np.arange(1, height, 2), np.arange(1, width, 2)
    grid = np.stack(np.meshgrid(columns + 0.5, rows + 0.5), -1)
    for frame, others in ((0, [1, 4]), (2, [3, 1]), (4, [3, 0])):
        targets = module._targets(frame, flows, blocked, grid)
        assert [other for other, _, _ in targets] == others
        assert any(0 < weight.sum() < weight.size for _, _, weight in targets)
        for other, seen, weight in targets:
            gap = other - frame
            for n, pixel in enumerate(grid.reshape(-1, 2)):
                x, y = int(pixel[0]), int(pixel[1])
                there = flows[gap][frame, y, x].astype(np.float32)
                place = pixel + there
                np.testing.assert_allclose(seen[n], place, rtol=1e-6)
                back = module.look_up(flows[-gap][other].astype(np.float32), place[None, None])[0, 0]
                close = np.linalg.norm(there + back) < 0.5 * (np.linalg.norm(there) + np.linalg.norm(back)) + 0.5
                inside = (place >= 0).all() and place[0] <= width and place[1] <= height
                at = blocked[other, min(max(int(place[1]), 0), height - 1), min(max(int(place[0]), 0), width - 1)]
                expected = 1 / (1 + (gap / 16) ** 2) if close and inside and not at else 0
                assert weight[n] == pytest.approx(expected)


def tracked(zoom=0.1):
    """Priors with exact tracks of points, some of them spoilt, and the cameras that saw them."""
    rng = np.random.default_rng(3)
    cameras = path(zoom=zoom)
    points = rng.uniform([-0.8, -0.6, 1.2], [0.8, 0.6, 3], (30, 3))
    tracks = np.stack([cameras[t].project(points)[0] for t in range(5)])
    tracks += 0.2 * rng.standard_normal(tracks.shape)
    visible = rng.random((5, 30)) < 0.85
    visible[2:, 0] = False  # seen twice only
    visible[:3, 1], visible[3:, 1] = True, False  # seen three times
    tracks[:, 2, 1] += 4 * (-1.0) ** np.arange(5)  # it moves up and down, in front of the cameras
    motion = np.zeros(30, np.float32)
    motion[3] = 1
    priors = Priors(WIDTH, HEIGHT, np.arange(5), cameras=cameras)
    priors.tracks, priors.tracks_visible, priors.tracks_motion = tracks.astype(np.float32), visible, motion
    return priors


def test_tracks_become_samples_of_the_frames_that_see_them():
    priors = tracked()
    cameras, visible = priors.cameras, priors.tracks_visible
    samples = module.track_samples(priors)
    focal = np.concatenate(
        [
            np.full((visible[t] & (priors.tracks_motion < 0.5) & (visible.sum(0) >= 3)).sum(), f)
            for t, f in enumerate(cameras.intrinsics[:, [0, 1], [0, 1]].mean(1))
        ]
    ).mean()
    rows = [[] for _ in range(5)]
    for point in range(30):
        frames = np.flatnonzero(visible[:, point])
        if len(frames) < 3 or point == 3:
            continue
        plane = [
            (priors.tracks[t, point] - cameras.intrinsics[t, :2, 2]) / cameras.intrinsics[t, [0, 1], [0, 1]]
            for t in frames
        ]
        seen = Observations(frames, np.zeros(len(frames), int), np.array(plane), np.ones(len(frames)))
        bundle = from_matrices(cameras.world_to_camera, 1.0, np.zeros(2))
        (xyz,), (spread,) = triangulate(bundle, seen, 1)
        missed = [np.sum((cameras[t].project(xyz)[0] - priors.tracks[t, point]) ** 2) for t in frames]
        rms = np.sqrt(np.mean(missed))
        if rms >= module.TRACK_OUTLIER_PX:
            continue
        relative = (module.TRACK_NOISE_PX + rms) / focal / spread
        for t in frames:
            z = cameras[t].project(xyz)[1]
            rows[t].append((*priors.tracks[t, point], 1 / z, (z / relative) ** 2))
    assert not any((abs(priors.tracks[t, 2] - row[:2]) < 1e-6).all() for t in range(5) for row in rows[t])
    for sample, row in zip(samples, rows, strict=True):
        uv, inverse, precision = np.array(row)[:, :2], np.array(row)[:, 2], np.array(row)[:, 3]
        np.testing.assert_allclose(sample.uv, uv, rtol=1e-6)
        np.testing.assert_allclose(sample.inverse, inverse, rtol=1e-6)
        np.testing.assert_allclose(sample.precision, precision, rtol=1e-5)
    priors.tracks_visible = visible & (np.arange(5) < 2)[:, None]
    assert all(sample.uv.shape == (0, 2) and not len(sample.inverse) for sample in module.track_samples(priors))


def test_points_behind_a_camera_are_no_samples():
    priors = tracked(zoom=0.0)
    matrices = priors.cameras.world_to_camera.copy()
    matrices[4, :3, :3] = np.diag([-1.0, 1, -1]) @ matrices[4, :3, :3]  # the last camera looks back
    matrices[4, :3, 3] = np.diag([-1.0, 1, -1]) @ matrices[4, :3, 3]
    priors.cameras = replace(priors.cameras, world_to_camera=matrices)
    seen = priors.tracks_visible.copy()
    samples = module.track_samples(priors)
    kept = {tuple(uv) for uv in samples[0].uv}
    assert kept.isdisjoint({tuple(uv) for uv in priors.tracks[0, seen[4]].astype(float)})


def test_tracks_are_merged_by_their_precision():
    rng = np.random.default_rng(0)
    rho, precision, held = rng.uniform(0.5, 1, (6, 8)), rng.uniform(0, 100, (6, 8)), rng.uniform(0, 1, (6, 8))
    precision[2, 3], precision[4, 5] = 0, 0.4
    blocked = rng.random((13, 17)) < 0.3
    blocked[8:10, 10:12] = True
    uv = rng.uniform([-1, -1], [18, 14], (40, 2))
    samples = module.TrackSamples(uv, rng.uniform(0.5, 1, 40), rng.uniform(10, 100, 40))
    total, sure = rho * precision, precision.copy()
    for (u, v), value, certain in zip(uv, samples.inverse, samples.precision, strict=True):
        x, y = min(max(int(u), 0), 16), min(max(int(v), 0), 12)
        if not blocked[y, x]:
            cell = min(y // 2, 5), min(x // 2, 7)
            total[cell] += value * certain * held[cell]
            sure[cell] += certain * held[cell]
    expected = np.where(sure > 0, total / np.where(sure > 0, sure, 1), rho)
    module._add_tracks(rho, precision, samples, blocked, held)
    np.testing.assert_allclose(precision, sure)
    np.testing.assert_allclose(rho, expected)


def test_static_depth_merges_flow_tracks_and_the_plain_world():
    """One frame of a clip with a mover and tracks, put together step by step."""
    clip, priors, _ = plane_priors()
    height, width = priors.mask.shape[1:]
    rng = np.random.default_rng(2)
    priors.mask[:, 10:30, 40:56] = True
    tracks = rng.uniform([0, 0], [width, height], (40, 2))
    inverse = np.linspace(0.3, 1.5, height)[tracks[:, 1].astype(int)]
    priors.tracks = np.stack([tracks - [80 * 0.05 * t, 0] * inverse[:, None] for t in range(8)]).astype(np.float32)
    priors.tracks_visible, priors.tracks_motion = np.ones((8, 40), bool), np.zeros(40, np.float32)
    priors.scratch.long_flows[2][3, :, 70:] += 3  # it contradicts itself there
    statistics = {}
    found, confidence = module._static_depth(clip, priors, PriorsConfig(), priors.mask, silent, statistics)
    cameras, pictures, shares = priors.cameras, module.grey(clip.frames), []
    blocked = np.stack([ndimage.binary_dilation(one, np.ones((13, 13))) for one in priors.mask])
    rows, columns = np.arange(1, height, 2), np.arange(1, width, 2)
    measured = []
    grid = np.stack(np.meshgrid(columns + 0.5, rows + 0.5), -1)
    for i in range(8):
        targets = module._targets(i, priors.scratch.long_flows, blocked, grid)
        rho, precision = (
            part.reshape(grid.shape[:2])
            for part in module.inverse_depth_from_flow(cameras, i, grid.reshape(-1, 2), targets)
        )
        direction = module.epipolar_direction(cameras, i, grid, [target[0] for target in targets])
        held = module.texture_along(pictures[i], direction)
        precision = precision * held * ~blocked[i, 1::2, 1::2]
        module._add_tracks(rho, precision, module.track_samples(priors)[i], blocked[i], held)
        measured.append(module.Samples(rho, precision, held))
    swept = module.sweep(cameras, pictures, None, measured, 2)
    for i, samples in enumerate(measured):
        precision = samples.precision
        usual = 1 / np.median(1 / np.maximum(samples.inverse[precision > 0], 1e-6))
        joined = module.join(samples, swept[i], ~priors.mask[i, 1::2, 1::2])
        rho, precision = joined.inverse, joined.precision
        least = usual / module.MAX_DEPTH
        rho = np.clip(rho, least, 1e3 * usual)
        below = module.below_horizon(cameras[i], grid, cameras.mean_down)
        plain = np.maximum(module.plain_world(rho, precision, below, usual), least)
        belief = 1 / (module.PLAIN_NOISE * usual) ** 2
        known, rho = precision, (precision * rho + belief * plain) / (precision + belief)
        looks = cv2.GaussianBlur(pictures[i], (3, 3), 0)[1::2, 1::2]
        guide = module.surface_guide(swept[i], joined.trust, ~blocked[i, 1::2, 1::2], looks)
        filled = np.maximum(module.fill_inverse_depth(rho, known + belief, guide), least)
        np.testing.assert_allclose(found[i], module.between_samples(filled, height, width), rtol=1e-5)
        trust = module._confidence(filled, rho, known)
        np.testing.assert_allclose(confidence[i], module.between_samples(trust, height, width), rtol=1e-4, atol=1e-6)
        shares.append((known * filled**2 > 100).mean())  # known to better than 10 %
    assert statistics["measured_fraction"] == pytest.approx(np.mean(shares), abs=6e-4)
    assert not any("measured on only" in line for line in priors.warnings)


def test_a_clip_that_shows_little_says_so():
    clip, priors, _ = plane_priors(frames=3)
    clip.frames[:] = 90  # no texture
    module.provide(clip, priors, PriorsConfig(), silent)
    assert any("only 0 %" in line for line in priors.warnings)
    assert priors.statistics["depth"]["measured_fraction"] == 0
    assert np.isfinite(priors.depth).all()


def test_depth_and_statistics_of_a_standing_camera():
    clip, priors, _ = plane_priors(frames=3)
    priors.camera_kind, cameras = "static", priors.cameras
    priors.mask[:, 30:50, 40:56] = True
    module.provide(clip, priors, PriorsConfig(), silent)
    world = module.guess_world(priors)
    prior = 1 / world.inverse_depth(cameras, module.feet_of_uprights(clip, priors, world.base))
    still = ~priors.mask
    unit = np.median(prior[still] / priors.depth[still])
    np.testing.assert_allclose(priors.depth[still], (prior / unit)[still], rtol=1e-5)
    np.testing.assert_allclose(priors.cameras.centers, cameras.centers / unit, rtol=1e-5)
    assert (priors.depth_confidence == np.float16(module.GUESS_CONFIDENCE)).all()
    found = priors.statistics["depth"]
    assert found["guess"]["known"] is False and any("usually lies" in line for line in priors.warnings)
    assert found["moving_objects"] == len(found["movers"]) == 1
    sampled = np.percentile(priors.depth[:, ::4, ::4], (2, 50, 98))
    np.testing.assert_allclose(found["percentiles_2_50_98"], sampled, atol=6e-4)
    assert found["mean_confidence"] == pytest.approx(module.GUESS_CONFIDENCE, abs=6e-4)


@pytest.mark.parametrize("kind", ["static", "pan"])
def test_outlines_before_a_camera_that_stays_in_its_place(kind):
    """It sees what is behind a mover at any depth: a leg that the mask lacks comes back, before depth is guessed from the mask."""
    clip, priors, _ = plane_priors(frames=14, step=0.0)
    clip.frames[:] = clip.frames[0]
    priors.camera_kind = kind
    priors.motion = np.zeros(priors.mask.shape, np.float16)
    true = np.zeros_like(priors.mask)
    for t in range(14):
        left = 4 + 3 * t
        clip.frames[t, 10:34, left : left + 12] = clip.frames[t, 34:48, left + 4 : left + 8] = (230, 30, 40)
        true[t, 10:34, left : left + 12] = true[t, 34:48, left + 4 : left + 8] = True
        priors.mask[t, 10:34, left : left + 12] = True
    before = priors.mask.copy()
    module.provide(clip, priors, PriorsConfig(), silent)
    lacked = true & ~before
    assert (priors.mask & lacked).sum() > 0.9 * lacked.sum()
    assert (priors.motion[priors.mask & lacked] > 0.5).all()


def test_confidence_is_kept_between_nothing_and_certainty(monkeypatch):
    clip, priors, _ = plane_priors(frames=3)
    beyond = np.linspace(-0.5, 1.5, priors.mask.size).reshape(priors.mask.shape)
    monkeypatch.setattr(module, "_static_depth", lambda *given: (np.full(beyond.shape, 0.5), beyond))
    monkeypatch.setattr(module, "place_objects", lambda *given: [])
    module.provide(clip, priors, PriorsConfig(), silent)
    np.testing.assert_allclose(priors.depth_confidence, np.clip(beyond, 0, 1), atol=1e-3)


def test_given_cameras_decide_the_unit_of_depth():
    clip, priors, _ = plane_priors(frames=3)
    priors.camera_kind, priors.provenance["cameras"] = "pan", {"provider": "files"}
    cameras = priors.cameras
    module.provide(clip, priors, PriorsConfig(), silent)
    np.testing.assert_allclose(priors.depth, 1 / module.ground_prior(cameras), rtol=1e-6)
    assert priors.cameras is cameras


def test_a_sample_of_little_precision_fills_an_empty_cell():
    rho, precision, blocked = np.full((4, 5), 9.0), np.zeros((4, 5)), np.zeros((8, 10), bool)
    samples = module.TrackSamples(np.array([[3.0, 3.0]]), np.array([0.5]), np.array([0.25]))
    module._add_tracks(rho, precision, samples, blocked, np.ones((4, 5)))
    assert rho[1, 1] == pytest.approx(0.5) and precision.sum() == pytest.approx(0.25)
    assert (rho == 9).sum() == 19


@pytest.mark.parametrize("size", [(28, 40), (29, 41)])
def test_a_sample_is_the_value_of_its_own_pixel(size):
    """The inverse depth of ground is linear in the picture: between its samples it is what it is, not half a pixel beside."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    ground = 0.1 + 0.02 * rows + 0.003 * columns
    filled = module.between_samples(ground[module.SAMPLED], *size)
    inner = np.s_[1 : 2 * (size[0] // 2), 1 : 2 * (size[1] // 2)]
    np.testing.assert_allclose(filled[inner], ground[inner], atol=1e-6)
