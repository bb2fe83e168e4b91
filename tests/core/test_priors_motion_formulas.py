"""What moves by itself: every formula of the score, the cut and the tracks against its plain form."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from f4x_core.priors import MotionConfig, Priors, PriorsConfig, TracksConfig, flow
from f4x_core.priors import motion as module
from f4x_core.priors import tracks as tracks_room
from f4x_core.progress import silent

from .warped_clip import warped_clip

HEIGHT, WIDTH, FRAMES = 40, 56, 6


def sampled(image, point):
    """Bilinear sample of (H,W), border repeated."""
    height, width = image.shape
    x, y = np.clip(np.asarray(point, float) - 0.5, 0, [width - 1, height - 1])
    c, r = min(int(x), width - 2), min(int(y), height - 2)
    u, v, four = x - c, y - r, image[r : r + 2, c : c + 2].astype(float)
    return np.array([1 - v, v]) @ four @ np.array([1 - u, u])


def some_tracks(count=30, seed=0):
    rng = np.random.default_rng(seed)
    tracks = rng.uniform([-2, -2], [WIDTH + 2, HEIGHT + 2], (FRAMES, count, 2)).astype(np.float32)
    visible = rng.random((FRAMES, count)) < 0.6
    visible[:, 0], visible[:, 1] = False, True
    return tracks, visible


def test_a_tracks_motion_is_the_mean_of_its_larger_half():
    tracks, visible = some_tracks()
    score = np.random.default_rng(1).uniform(0, 1, (FRAMES, HEIGHT, WIDTH))
    found = module.tracks_motion(tracks, visible, score)
    assert found[0] == 0 and found.dtype == np.float32
    for n in range(1, 30):
        values = sorted((sampled(score[t], tracks[t, n]) for t in np.flatnonzero(visible[:, n])), reverse=True)
        assert found[n] == pytest.approx(np.mean(values[: (len(values) + 1) // 2]), abs=1e-6)
    assert module.tracks_motion(tracks, visible, 3 * score + 1).max() == 1


def test_tracks_vote_around_their_places():
    tracks, visible = some_tracks()
    score = np.random.default_rng(1).uniform(0, 1, (FRAMES, HEIGHT, WIDTH)).astype(np.float32)
    motion, found = module.tracks_motion(tracks, visible, score), module.vote(score, tracks, visible)
    least = 0.1 / (2 * np.pi * 16)
    for t in range(FRAMES):
        count, total = np.zeros((2, HEIGHT, WIDTH), np.float32)
        for n in np.flatnonzero(visible[t]):
            x, y = np.floor(tracks[t, n]).astype(int)
            x, y = min(max(x, 0), WIDTH - 1), min(max(y, 0), HEIGHT - 1)
            count[y, x] += 1
            total[y, x] += motion[n]
        count, total = (cv2.GaussianBlur(one, (0, 0), 4) for one in (count, total))
        reached = count > least
        assert 0.1 < reached.mean() < 1
        np.testing.assert_allclose(found[t][reached], (total / count)[reached], rtol=1e-4)
        np.testing.assert_array_equal(found[t][~reached], score[t][~reached])


def random_flows(gaps=(1, 2), seed=0):
    rng = np.random.default_rng(seed)
    signed = [sign * gap for gap in gaps for sign in (1, -1)]
    return {gap: rng.normal(0.7 * gap, 0.5, (FRAMES, HEIGHT, WIDTH, 2)).astype(np.float16) for gap in signed}


@pytest.mark.parametrize("gaps", [(1, 2), (2,), (1, 4)])
def test_scores_are_carried_along_the_flow_with_half_the_weight(gaps):
    flows, score = (
        random_flows(gaps),
        np.random.default_rng(1).uniform(0, 1, (FRAMES, HEIGHT, WIDTH)).astype(np.float32),
    )
    found = module._smooth_in_time(score, flows)
    for t in range(FRAMES):
        for y, x in ((0, 0), (20, 30), (39, 55), (11, 47)):
            values, weights = [score[t, y, x]], [1.0]
            for gap in (-2, -1, 1, 2):
                if gap in flows and 0 <= t + gap < FRAMES:
                    place = np.array((x + 0.5, y + 0.5)) + flows[gap][t, y, x].astype(float)
                    values.append(sampled(score[t + gap], place))
                    weights.append(0.5)
            assert found[t, y, x] == pytest.approx(np.average(values, weights=weights), abs=0.02)  # remap's fractions


def test_the_score_is_the_trusted_mean_of_e_over_e_and_noise():
    rng = np.random.default_rng(0)
    residual, trust = rng.exponential(1.0, (3, 4, 50)), rng.choice([0, 0.05, 1], (3, 4, 50))
    residual[0] *= 0.1
    residual[1, 2] *= 30
    trust[0, :, 5] = 0
    found = module.score_of_residuals(residual, trust, 1.5)
    for f in range(3):
        for p in range(50):
            parts = []
            for k in range(4):
                noise = min(max(3 * np.median(residual[f, k]), 1.5), 4.5)
                parts.append(trust[f, k, p] * residual[f, k, p] / (residual[f, k, p] + noise))
            expected = sum(parts) / trust[f, :, p].sum() if trust[f, :, p].any() else 0
            assert found[f, p] == pytest.approx(expected)


def test_otsus_threshold_is_the_one_that_parts_the_classes_most():
    rng = np.random.default_rng(0)
    for low, high, share in ((0.2, 0.7, 0.3), (0.3, 0.62, 0.5), (0.25, 0.55, 0.8), (0.05, 0.1, 0.5), (0.8, 0.95, 0.5)):
        score = np.where(rng.random(4000) < share, rng.normal(high, 0.07, 4000), rng.normal(low, 0.05, 4000)).clip(0, 1)
        levels = np.clip((score * 256).astype(int), 0, 255)
        best = (-1.0, 0.0)
        for level in range(256):
            below, above = levels[levels <= level], levels[levels > level]
            if len(below) and len(above):
                between = len(below) * len(above) * (above.mean() - below.mean()) ** 2
                best = max(best, (between, -level))  # the first of equals
        expected = min(max((-best[1] + 0.5) / 256 + 0.05, 0.35), 0.6)
        assert module.find_threshold(score) == pytest.approx(expected, abs=1e-9)
    assert module.find_threshold(np.zeros(0)) == 0.35
    assert module._median(np.zeros(0)) == 0 and module._median(np.array([3.0, 1, 2])) == 2


def test_samples_are_enlarged_between_their_places():
    rows, columns = np.mgrid[:10, :14]
    x, y = 4 * columns + 2.5, 4 * rows + 2.5  # where the samples lie: pixel 2, 6, 10, ...
    found = module.enlarge(0.3 * x - 0.2 * y, HEIGHT, WIDTH)
    pixels_y, pixels_x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    expected = 0.3 * pixels_x.clip(2.5, 54.5) - 0.2 * pixels_y.clip(2.5, 38.5)
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize(
    ("rows", "columns", "top", "side"), [(10, 34, 1, 3), (24, 16, 2, 2), (3, 4, 1, 1), (26, 4, 3, 1)]
)
def test_the_border_is_a_tenth_wide(rows, columns, top, side):
    expected = [
        [y < top or y >= rows - top or x < side or x >= columns - side for x in range(columns)] for y in range(rows)
    ]
    np.testing.assert_array_equal(module.border_of(rows, columns), expected)


def test_flow_beyond_the_homography_of_most_points():
    rng = np.random.default_rng(0)
    points = rng.uniform([0, 0], [WIDTH, HEIGHT], (300, 2))
    homography = np.array([[1.02, 0.01, 2], [-0.01, 0.99, -1], [1e-4, 2e-4, 1]])
    there = cv2.perspectiveTransform(points[:, None], homography)[:, 0]
    own = np.zeros((300, 2))
    own[:60] = [6, -4]
    good = np.ones(300, bool)
    good[60:75] = False  # neither believed nor asked
    own[60:75] = rng.normal(0, 30, (15, 2))
    left, share = module._off_homography(points, there + own - points, good, 1.0)
    np.testing.assert_allclose(left, own, atol=0.05)
    assert share == pytest.approx(np.mean(np.linalg.norm(own[good][::3], axis=1) < 1), abs=0.02)
    flow = rng.normal(size=(300, 2))
    none, share = module._off_homography(points, flow, np.arange(300) < 3, 1.0)
    np.testing.assert_array_equal(none, flow)
    assert share == 0


def parallax(seed=0, points=240, gaps=4):
    """Residuals of points at different depths before a camera that steps aside and ahead; some move by themselves."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([0, 0], [WIDTH, HEIGHT], (points, 2))
    x = (places - places.mean(0)) / np.ptp(places[:, 0])
    rho = rng.uniform(-1, 2, points)
    a, b = rng.normal(0, 4, (gaps, 2)), rng.normal(0, 3, gaps)
    residual = rho[None, :, None] * (a[:, None] + b[:, None, None] * x) + rng.normal(0, 0.2, (gaps, points, 2))
    residual[:, :30] += rng.normal(0, 5, (gaps, 30, 2))
    trust = rng.choice([0.05, 1.0], (gaps, points), p=[0.1, 0.9])
    trust[1] = 0  # a gap that leads out of the clip
    return residual.astype(np.float32), trust.astype(np.float32), places


def left_by_hand(residual, trust, places, unit, seed):
    live = [k for k in range(len(trust)) if trust[k].any()]
    r, weight, scale = residual[live].astype(float), trust[live].astype(float), 0.7 * unit
    x = (places - places.mean(0)) / np.ptp(places[:, 0])
    some = list(range(0, len(places), 3))
    strong = [p for p in some if np.median(np.linalg.norm(r[:, p], axis=1)) > 2 * scale and (weight[:, p] == 1).all()]
    left = np.linalg.norm(residual, axis=-1)
    if len(strong) < 8:
        return left

    def fitted(field, p):
        rho = np.sum(weight[:, p, None] * r[:, p] * field) / max(np.sum(weight[:, p, None] * field**2), 1e-9)
        return rho, np.linalg.norm(r[:, p] - rho * field, axis=1)

    best = (-1.0, -1)
    for i in np.random.default_rng(seed).choice(strong, min(60, len(strong)), replace=False):
        misses = [fitted(r[:, i], p)[1] for p in some]
        total = sum((weight[:, p] / (1 + (miss / scale) ** 2)).sum() for p, miss in zip(some, misses, strict=True))
        if total > best[0]:
            best = total, i
    motion = np.column_stack([r[:, best[1]], np.zeros(len(r))])
    for _ in range(8):
        fits = [fitted(motion[:, :2] + motion[:, 2:] * x[p], p) for p in some]
        for k in range(len(r)):
            normal, right = 1e-9 * np.eye(3), np.zeros(3)
            for p, (rho, miss) in zip(some, fits, strict=True):
                robust = weight[k, p] / (1 + (miss[k] / scale) ** 2) ** 2
                design = rho * np.array([[1, 0, x[p, 0]], [0, 1, x[p, 1]]])
                normal += robust * design.T @ design
                right += robust * design.T @ r[k, p]
            motion[k] = np.linalg.solve(normal, right)
    for p in range(len(places)):
        left[live, p] = fitted(motion[:, :2] + motion[:, 2:] * x[p], p)[1]
    return left


def test_parallax_is_one_depth_per_point_beside_a_motion_per_gap():
    residual, trust, places = parallax()
    found = module._off_parallax(residual, trust, places, 1.3, 5)
    np.testing.assert_allclose(found, left_by_hand(residual, trust, places, 1.3, 5), rtol=1e-5, atol=1e-6)
    live = trust.any(1)
    assert np.median(found[live][:, 30:]) < 0.4 < 2 < np.median(found[live][:, :30])
    still = residual / 40  # hardly any residual: nothing to fit
    np.testing.assert_allclose(
        module._off_parallax(still, trust, places, 1.3, 5), np.linalg.norm(still, axis=-1), rtol=1e-6
    )
    both = module._left_by_parallax(
        np.array([1, 0]), np.stack([residual, still]), np.stack([trust, trust]), places, 1.3
    )
    np.testing.assert_allclose(both[1], module._off_parallax(residual, trust, places, 1.3, 0))
    np.testing.assert_allclose(both[0], module._off_parallax(still, trust, places, 1.3, 1))


def test_few_strong_residuals_are_no_parallax():
    residual, trust, places = parallax()
    trust[trust > 0] = 1
    weak = np.full(residual.shape, 0.01, np.float32)
    for count, fitted in ((7, False), (8, True)):
        some = weak.copy()
        some[:, : 3 * count : 3] = residual[:, : 3 * count : 3] + 9
        found = module._off_parallax(some, trust, places, 1.0, 0)
        plain = np.linalg.norm(some, axis=-1)
        assert (abs(found - plain).max() > 0.1) == fitted


def test_specks_go_and_gaps_close():
    mask = np.zeros((100, 100), bool)
    mask[10:30, 10:30] = True
    mask[20, 10:30] = False  # a gap one pixel wide
    mask[60:65, 60:62] = True  # 10 pixels: a thousandth of the picture
    mask[80:83, 80:83] = True  # 9 pixels
    expected = mask.copy()
    expected[20, 10:30], expected[80:83, 80:83] = True, False
    np.testing.assert_array_equal(module.without_specks(mask), expected)
    score = np.where(mask, 0.9, 0.1).astype(np.float32)
    none = np.full((2, 100, 100), 0.1)
    assert not module.cut_out(np.zeros((2, 100, 100, 3), np.uint8), none, 0.5).any()
    assert module.cut_out(np.zeros((2, 100, 100, 3), np.uint8), np.stack([score, score]), 0.5).any()


def cut_case():
    rng = np.random.default_rng(0)
    frame = rng.integers(0, 60, (90, 120, 3), np.uint8)
    frame[30:60, 40:80] += 150
    score = cv2.GaussianBlur(np.pad(np.full((34, 44), 1.0, np.float32), ((28, 28), (38, 38))), (0, 0), 5)
    return frame, score, score > 0.45


def test_grab_cut_gets_what_is_sure_and_what_is_in_doubt(monkeypatch):
    frame, score, mask = cut_case()
    threshold, asked = 0.45, []

    def grab(picture, labels, nothing, background, foreground, rounds, mode):
        asked.append((picture.copy(), labels.copy(), rounds, mode, background.shape, foreground.shape))
        labels[:] = np.where((labels == cv2.GC_PR_FGD) & (np.arange(labels.shape[1]) % 3 == 0), cv2.GC_PR_BGD, labels)

    monkeypatch.setattr(cv2, "grabCut", grab)
    found = module._cut(frame, score, mask, threshold)
    ((picture, labels, rounds, mode, *models),) = asked
    size = (60, 45)
    small, region = (
        cv2.resize(score, size),
        cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0,
    )
    square = np.ones((3, 3), bool)
    sure = ndimage.binary_erosion(region & (small > threshold + module.SURE), square, border_value=1)
    near = ndimage.binary_dilation(region, square, iterations=3)
    expected = np.where(region, cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    expected[~near | (small < threshold / 2)] = cv2.GC_BGD
    expected[sure] = cv2.GC_FGD
    assert {cv2.GC_PR_BGD, cv2.GC_PR_FGD, cv2.GC_BGD, cv2.GC_FGD} == set(np.unique(expected))
    rows, columns = np.nonzero(region)
    box = np.s_[max(rows.min() - 12, 0) : rows.max() + 13, max(columns.min() - 12, 0) : columns.max() + 13]
    np.testing.assert_array_equal(labels, expected[box])
    np.testing.assert_array_equal(picture, cv2.resize(frame, size, interpolation=cv2.INTER_AREA)[box])
    assert (rounds, mode, *models) == (2, cv2.GC_INIT_WITH_MASK, (1, 65), (1, 65))
    after = expected.copy()
    doubt = (expected[box] == cv2.GC_PR_FGD) & (np.arange(labels.shape[1]) % 3 == 0)
    after[box][doubt] = cv2.GC_PR_BGD
    cut = cv2.resize(np.isin(after, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.float32), (120, 90)) > 0.5
    np.testing.assert_array_equal(found, module.without_specks(cut))


def test_nothing_is_cut_where_there_is_nothing_to_compare():
    frame, score, mask = cut_case()
    np.testing.assert_array_equal(module._cut(frame, np.ones_like(score), np.ones_like(mask), 0.5), np.ones_like(mask))
    low = np.full_like(score, 0.1)
    np.testing.assert_array_equal(module._cut(frame, low, mask, 0.5), mask)  # all of it is background by its score
    flat = np.full_like(frame, 90)
    assert module._cut(flat[:1, :1], score[:1, :1], np.ones((1, 1), bool), 0.5).shape == (1, 1)


def test_the_cut_follows_the_colours():
    frame, score, mask = cut_case()
    true = np.zeros((90, 120), bool)
    true[30:60, 40:80] = True
    found = module._cut(frame, score, mask, 0.45)
    assert (found & true).sum() / (found | true).sum() > 0.95 > (mask & true).sum() / (mask | true).sum()
    soft = module._softened(np.stack([true, ~true]))
    np.testing.assert_allclose(soft[0], cv2.GaussianBlur(true.astype(np.float32), (0, 0), 2), atol=1e-6)
    np.testing.assert_allclose(soft[0] + soft[1], 1, atol=1e-5)


def mean_around(values, known, y, x):
    """Mean of the known values of the 3 x 3 samples around (y, x), the outermost repeated."""
    values, known = (np.pad(one, 1, "symmetric")[y : y + 3, x : x + 3] for one in (values, known))
    return values[known].mean()


def scored_by_hand(pictures, flows, gaps):
    """The score of every pixel and what was measured, frame by frame and gap by gap."""
    frames, height, width = flows[1].shape[:3]
    signed = [sign * gap for gap in gaps for sign in (1, -1) if gap < frames]
    rows, columns = np.arange(2, height, 4), np.arange(2, width, 4)
    grid = np.stack(np.meshgrid(columns + 0.5, rows + 0.5), -1).astype(np.float32)
    points, unit = grid.reshape(-1, 2), max(height, width) / 480
    border = module.border_of(len(rows), len(columns)).ravel()
    longest = max((1, *signed))

    def lengths(gap):
        kept = [flows[gap][t][rows[:, None], columns].astype(float).reshape(-1, 2)[border] for t in range(frames - gap)]
        return np.linalg.norm(np.concatenate(kept), axis=1)

    border_flow = np.median(lengths(1))
    static = border_flow < 0.3 * unit and np.median(lengths(longest)) < 0.6 * unit
    residual = np.zeros((frames, len(signed), len(points), 2), np.float32)
    trust = np.zeros(residual.shape[:3], np.float32)
    missed, off = np.full((2, *residual.shape[:3]), np.nan, np.float32)
    inliers = {}
    soft = [cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32) for picture in pictures]
    for t in range(frames):
        for j, gap in enumerate(signed):
            if not 0 <= t + gap < frames:
                continue
            flow = flows[gap][t][rows[:, None], columns].reshape(-1, 2).astype(float)
            good = module.consistent_at(points, flow, flows[-gap][t + gap])
            residual[t, j], share = (flow, 1.0) if static else module._off_homography(points, flow, good, unit)
            inliers.setdefault(str(gap), []).append(share)
            trust[t, j] = np.where(good, 1, 0.05)
            background = points + flow - residual[t, j]
            for p in np.flatnonzero(good & module.inside(background, height, width)):
                here = module.look_up(soft[t], points[p][None, None])
                seen = [
                    module.look_up(soft[t + gap], place[None, None]) for place in (background[p], points[p] + flow[p])
                ]
                missed[t, j, p] = abs(seen[0] - here).mean() - abs(seen[1] - here).mean()
                off[t, j, p] = abs(seen[0] - here).mean()
    score = module.score_of_residuals(np.linalg.norm(residual, axis=-1), trust, unit)
    unexplained = score[:, border] > 0.5
    last = np.array([abs(gap) == max(gaps) for gap in signed])
    at_border = np.linalg.norm(residual[:, last][:, :, border], axis=-1)[trust[:, last][..., border] == 1]
    statistics = {
        "static_camera": static,
        "border_flow": border_flow,
        "homography_residual": np.median(at_border),
        "border_unexplained": unexplained.mean(),
        "border_parallax": 0.0,
        "parallax": False,
    }
    statistics |= {f"inliers {gap}": np.mean(shares) for gap, shares in inliers.items()}
    if not static and unexplained.mean() > 0.15:
        some = np.arange(0, frames, 4)
        left = [module._off_parallax(residual[t], trust[t], points, unit, int(t)) for t in range(frames)]
        forgiven = module.score_of_residuals(np.array(left), trust, unit)
        statistics["border_parallax"] = (unexplained[some] & (forgiven[some][:, border] < 0.25)).mean()
        if statistics["border_parallax"] > 0.15:
            score, statistics["parallax"] = np.sqrt(score * forgiven), True
    contrast = max(np.mean([pictures[:, ::4, ::4, c].std() for c in range(3)]), 1)
    shape = (frames, len(signed), len(rows), len(columns))
    score = score.reshape(frames, len(rows), len(columns))
    missed, off, enough = missed.reshape(shape), off.reshape(shape), 0.28 * contrast
    evidence = module._evidence(missed, enough)
    wide = [cv2.dilate(one.astype(np.float32), np.ones((3, 3), np.uint8)) for one in (score * evidence > 0.6)]
    free = missed.copy()
    for t, j, y, x in np.ndindex(shape):
        if 0 <= t + signed[j] < frames:
            moved = flows[signed[j]][t][rows[y], columns[x]].astype(float) - residual[t, j, y * len(columns) + x]
            if module.look_up(wide[t + signed[j]], np.array([[(x, y) + moved / 4 + 0.5]])) > 0.5:
                free[t, j, y, x] = np.nan
    anew, found = module._evidence(free, enough), evidence.copy()
    for t, y, x in np.ndindex(score.shape):
        for j in range(len(signed)):
            if np.isfinite(free[t, j, y, x]) and mean_around(off[t, j], np.isfinite(free[t, j]), y, x) < enough:
                found[t, y, x] = anew[t, y, x]
    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    closed = np.array([cv2.morphologyEx(one.astype(np.float32), cv2.MORPH_CLOSE, ellipse) for one in found])
    score = score * np.minimum(closed, np.maximum(evidence, found))
    return module._smooth_in_time(np.stack([module.enlarge(one, height, width) for one in score]), flows), statistics


def filmed(kind, frames=6):
    """Pictures and flows of a wall with a square that moves; the camera stands, pans, or passes a wall in two depths."""
    pan = (0.0, 0.0) if kind == "static" else (1.5, 0.4)
    clip, mask = warped_clip(frames=frames, pan=pan, speed=(2.5, 0.7))
    flows = {}
    for gap in (1, 2, 4):
        for signed in (gap, -gap):
            motion = np.where(mask[..., None], [2.5, 0.7], [-pan[0], -pan[1]]) * float(signed)
            if kind == "parallax":
                rng = np.random.default_rng(0)
                depth = rng.uniform(0, 4, (15, 22)).repeat(8, 0).repeat(8, 1)
                motion = motion + signed * depth[..., None] * [1.0, 0.3] * ~mask[..., None]
            flows[signed] = (motion + 0.05).astype(np.float16)
    return clip.frames, flows


@pytest.mark.parametrize("kind", ["static", "pan", "parallax"])
def test_the_score_is_put_together_frame_by_frame(kind):
    pictures, flows = filmed(kind)
    found, statistics = module.motion_score(pictures, flows, (1, 4, 8), silent)
    expected, by_hand = scored_by_hand(pictures, flows, (1, 4))
    np.testing.assert_allclose(found, expected, atol=2e-4)
    assert found.max() > 0.3
    assert statistics["static_camera"] == by_hand["static_camera"] == (kind == "static")
    assert statistics["parallax"] == by_hand["parallax"] == (kind == "parallax")
    for name in ("border_flow", "homography_residual", "border_unexplained", "border_parallax"):
        assert statistics[name] == pytest.approx(by_hand[name], rel=1e-3, abs=1e-6), name
    shares = {f"inliers {gap}": value for gap, value in statistics["homography_inliers"].items()}
    assert shares == pytest.approx({name: value for name, value in by_hand.items() if "inliers" in name}, abs=1e-6)


@pytest.mark.parametrize("known", [False, True])
def test_a_plain_wall_that_a_mover_soon_covers_stands(known):
    """Flow drags the wall along for 12 pixels before the mover; where the mover is not in the way, the wall is where it was."""
    clip, mask = warped_clip(frames=8, pan=(0.0, 0.0), speed=(2.5, 0.0))
    pictures = np.where(mask[..., None], clip.frames, 90).astype(np.uint8)
    dragged = np.array([cv2.dilate(one.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0 for one in mask])
    flows = {gap: (dragged[..., None] * [2.5 * gap, 0.0]).astype(np.float16) for gap in (1, -1, 4, -4)}
    score, _ = module.motion_score(pictures, flows, (1, 4), silent, mask if known else None)
    inner = np.array([cv2.erode(one.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0 for one in mask])
    ahead = np.zeros_like(mask)
    ahead[:, :, 10:] = mask[:, :, :-10]
    ahead &= ~np.array([cv2.dilate(one.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0 for one in mask])
    middle = slice(2, 6)
    assert score[middle][inner[middle]].mean() > 0.4
    assert score[middle][ahead[middle]].mean() < 0.2, score[middle][ahead[middle]].mean()


def test_a_slow_pan_is_no_standing_camera():
    """Less than the limit from frame to frame, more than twice the limit over the longest gap."""
    pictures, _ = filmed("static")
    unit = 176 / 480
    for step, static in ((0.25, False), (0.12, True), (0.35, False)):
        flows = {gap: np.full((6, 120, 176, 2), 0.0, np.float16) for gap in (1, -1, 4, -4)}
        for gap, moves in flows.items():
            moves[..., 0] = step * unit * gap
        assert module.motion_score(pictures, flows, (1, 4), silent)[1]["static_camera"] == static
    flows = {gap: np.zeros((1, 120, 176, 2), np.float16) for gap in (1, -1)}
    found, statistics = module.motion_score(pictures[:1], flows, (1, 4), silent)
    assert not found.any() and statistics["static_camera"] and statistics["border_flow"] == 0


def made(given_tracks=False, threshold=None, gap=24):
    clip, mask = warped_clip(frames=7)
    config = PriorsConfig(
        tracks=TracksConfig(count=120, spacing=12.0, dynamic_spacing=6.0, relink_gap=gap),
        motion=MotionConfig(threshold=threshold),
    )
    priors = Priors.empty(clip)
    for stage in (flow, tracks_room):
        stage.provide(clip, priors, config, silent)
    if given_tracks:
        priors.provenance["tracks"] = {"provider": "user"}
    return clip, mask, config, priors


@pytest.mark.parametrize("gap", [0, 24])
def test_the_mask_the_motion_and_the_tracks_are_made_step_by_step(gap):
    clip, _, config, priors = made(gap=gap)
    before, seen_before = priors.tracks.copy(), priors.tracks_visible.copy()
    module.provide(clip, priors, config, silent)
    flows = priors.scratch.long_flows
    score, statistics = module.motion_score(clip.frames, flows, config.motion.gaps, silent)
    score = (score + module.vote(score, before, seen_before)) / 2
    threshold = module.find_threshold(score)
    crisp = module._smooth_in_time(module.cut_out(clip.frames, score, threshold).astype(np.float32), flows) > 0.4
    np.testing.assert_array_equal(priors.mask, crisp)
    np.testing.assert_allclose(priors.motion, np.clip((score + module._softened(crisp)) / 2, 0, 1), atol=2e-3)
    found = priors.statistics["motion"]
    assert found["threshold"] == threshold and found["share"] == pytest.approx(crisp.mean()) and found["moving"]
    assert found["border_flow"] == statistics["border_flow"]

    motion = module.tracks_motion(before, seen_before, crisp.astype(np.float32))
    still = np.flatnonzero(motion <= 0.5)
    pictures = module.grey(clip.frames)
    dense, seen = module.seed_and_track(flows, 6.0, config.tracks, crisp)
    joins = continued = 0
    if gap:
        dense, seen, joins = module.relink(dense, seen, pictures, gap)
        dense, seen, continued = module.continue_lost(dense, seen, pictures, gap)
    dense, seen = module.thinned(dense, seen, 72)  # six tenths of 120
    rest, rest_seen = module.thinned(before[:, still], seen_before[:, still], 120 - dense.shape[1])
    np.testing.assert_array_equal(priors.tracks_visible, np.concatenate([rest_seen, seen], 1))
    tracks = np.concatenate([rest, dense], 1)
    motion = module.tracks_motion(tracks, priors.tracks_visible, crisp.astype(np.float32))
    np.testing.assert_array_equal(priors.tracks_motion, motion)
    still = motion <= 0.5
    tracks[:, still] = module.align_tracks(tracks[:, still], priors.tracks_visible[:, still], pictures)
    np.testing.assert_array_equal(priors.tracks, tracks)
    found = priors.statistics["tracks"]
    assert (found["uniform"], found["dynamic"]) == (rest.shape[1], dense.shape[1])
    assert (found["dynamic_joins"], found["dynamic_continued"]) == (joins, continued)
    assert dense.shape[1] > 10 and not still.all() and len(motion) == 120


def test_tracks_of_the_user_stay():
    clip, _, config, priors = made(given_tracks=True, threshold=0.45)
    before = priors.tracks
    module.provide(clip, priors, config, silent)
    assert priors.tracks is before and priors.statistics["motion"]["threshold"] == 0.45
    expected = module.tracks_motion(before, priors.tracks_visible, priors.mask.astype(np.float32))
    np.testing.assert_array_equal(priors.tracks_motion, expected)


def test_where_nothing_moves_the_score_is_the_motion():
    clip, _, config, priors = made(threshold=0.99)
    tracks, seen = priors.tracks.copy(), priors.tracks_visible.copy()
    module.provide(clip, priors, config, silent)
    score, _ = module.motion_score(clip.frames, priors.scratch.long_flows, config.motion.gaps, silent)
    score = (score + module.vote(score, tracks, seen)) / 2
    assert not priors.mask.any() and not priors.statistics["motion"]["moving"]
    np.testing.assert_allclose(priors.motion, score, atol=1e-3)
    expected = module.align_tracks(tracks, seen, module.grey(clip.frames))
    np.testing.assert_array_equal(priors.tracks, expected)
