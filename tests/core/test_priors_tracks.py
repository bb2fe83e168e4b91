"""Point tracks against their plain forms: loops over points, pairs and pixels in made-up pictures and flows."""

import cv2
import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.priors import Priors, PriorsConfig, TracksConfig
from f4x_core.priors import tracks as module
from f4x_core.progress import silent

HEIGHT, WIDTH, FRAMES = 20, 26, 7


def random_flows(seed=0, gaps=(1, 2), noise=0.35):
    """Flows that drift to the lower right, agree with each other in most places, and are lost in some."""
    rng = np.random.default_rng(seed)
    flows = {}
    for gap in (*gaps, *(-gap for gap in gaps)):
        smooth = rng.normal(0, noise, (FRAMES, HEIGHT, WIDTH, 2))
        smooth[:, 12:15, 9:12] += 4  # nothing comes back from here
        flows[gap] = (np.array([1.1, 0.6]) * gap + smooth).astype(np.float16)
    return flows


def at(image, point):
    """Bilinear sample of (H,W,2), border repeated."""
    x, y = np.clip(point - 0.5, 0, [WIDTH - 1, HEIGHT - 1])
    c, r = min(int(x), WIDTH - 2), min(int(y), HEIGHT - 2)
    u, v, image = x - c, y - r, image.astype(np.float64)
    top = image[r, c] * (1 - u) + image[r, c + 1] * u
    return top * (1 - v) + (image[r + 1, c] * (1 - u) + image[r + 1, c + 1] * u) * v


def inside(point):
    return bool((point >= 0).all() and point[0] <= WIDTH and point[1] <= HEIGHT)


def followed(flows, start, origin, gaps, pull=None):
    """Position (F,2) and visibility (F,) of one point: the step with the least accumulated error reaches every frame."""
    pull = pull or (lambda point, frame: point)
    position, visible = np.full((FRAMES, 2), np.nan), np.zeros(FRAMES, bool)
    position[start], visible[start] = pull(origin, start), True
    for sign in (1, -1):
        drift = {start: 0.0}
        for t in range(start + sign, FRAMES if sign > 0 else -1, sign):
            best = np.inf
            for gap in gaps:
                source = t - sign * gap
                if source not in drift:
                    continue
                step = at(flows[sign * gap][source], position[source])
                there = position[source] + step
                error = np.linalg.norm(step + at(flows[-sign * gap][t], there))
                limit = max(module.RETURN_PIXELS, module.RETURN_FRACTION * np.linalg.norm(step))
                believed = visible[source] and inside(there) and error < limit
                total = drift[source] + error + (0 if believed else module.LOST_ERROR)
                if total < best:
                    best, place, seen = total, there, believed
            drift[t] = best
            position[t], visible[t] = pull(place, t), seen
    offset = origin - position[start]
    return position + offset, visible & [inside(one) for one in position + offset]


@pytest.mark.parametrize("gaps", [(1, 2), (1, 2, 4), (1,)])
def test_points_take_the_steps_that_err_least(gaps):
    flows, rng = random_flows(gaps=gaps), np.random.default_rng(1)
    queries = np.column_stack([rng.integers(0, FRAMES, 60), rng.uniform([0, 0], [WIDTH, HEIGHT], (60, 2))])
    found, visible = module.track_points(flows, queries, TracksConfig(gaps=gaps))
    assert 0.3 < visible.mean() < 0.95
    for n, (start, *origin) in enumerate(queries):
        position, seen = followed(flows, int(start), np.array(origin), gaps)
        np.testing.assert_allclose(found[:, n], position, atol=1e-4)
        np.testing.assert_array_equal(visible[:, n], seen)


def moving_mask():
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    for t in range(FRAMES - 1):  # it is gone from the last frame
        mask[t, 3 + t : 10 + t, 5 + t : 14 + t] = True
    mask[2, 3:8, 19:25] = True
    return mask


def test_points_on_an_object_keep_to_its_flow_and_to_it():
    flows, mask, config = random_flows(), moving_mask(), TracksConfig(gaps=(1, 2))
    surface = module.ObjectFlows(flows, mask, config)
    rng = np.random.default_rng(1)
    start = rng.integers(0, 3, 30)
    queries = np.column_stack([start, rng.uniform([4, 2], [15, 11], (30, 2)) + start[:, None]])
    found, visible = module.track_points(flows, queries, config, mask)

    def pull(point, frame):
        return surface.pull(np.asarray(point)[None], frame)[0]

    for n, (first, *origin) in enumerate(queries):
        position, seen = followed(surface.flows, int(first), np.array(origin), (1, 2), pull)
        np.testing.assert_allclose(found[:, n], position, atol=1e-4)
        np.testing.assert_array_equal(visible[:, n], seen)


def test_a_silhouette_point_that_leaves_the_picture_before_its_object_is_lost():
    frames, height, width, speed = 4, 14, 24, -3.5
    flows = {gap: np.full((frames, height, width, 2), (speed * gap, 0.0), np.float16) for gap in (1, -1)}
    mask = np.zeros((frames, height, width), bool)
    for t in range(frames):
        left = int(10 + speed * t)
        mask[t, 3:11, max(left, 0) : left + 7] = True
    found, visible = module.track_points(flows, np.array([[0, 9.5, 7.5]]), TracksConfig(gaps=(1,)), mask)
    np.testing.assert_allclose(
        found[:, 0, 0], 9.5 + speed * np.arange(frames), atol=0.02
    )  # 2 pixels beside the object's inside
    assert visible[:, 0].tolist() == [True, True, True, False]


def test_an_objects_flow_is_that_of_its_inside():
    flows, mask = random_flows(), moving_mask()
    found = module.ObjectFlows(flows, mask, TracksConfig(gaps=(1, 2)))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for t in range(FRAMES):
        inner = cv2.erode(mask[t].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        places = np.argwhere(inner)
        for gap in (1, 2, -1, -2):
            expected, loose = flows[gap][t].astype(np.float64), np.zeros((HEIGHT, WIDTH), bool)
            for row, column in np.ndindex(HEIGHT, WIDTH) if len(places) and 0 <= t + gap < FRAMES else ():
                reach = (abs(places - (row, column)) <= 6).all(1)  # of the blur: four deviations
                weight = np.exp(-((places[reach] - (row, column)) ** 2).sum(1) / (2 * module.OBJECT_SIGMA**2))
                if weight.sum() / (2 * np.pi * module.OBJECT_SIGMA**2) > 1e-3:
                    own = flows[gap][t, places[reach][:, 0], places[reach][:, 1]].astype(np.float64)
                    expected[row, column] = weight @ own / weight.sum()
                else:
                    loose[row, column] = weight.sum() > 0  # hardly reached: no matter which
            np.testing.assert_allclose(found.flows[gap][t][~loose], expected[~loose], atol=0.03)
        points = np.stack([x + 0.7, y + 0.2], -1).reshape(-1, 2)
        pulled = found.pull(points, t)
        far = np.linalg.norm(found.nearest[t] - np.stack([x, y], -1), axis=-1) > module.MAX_SLIP  # a hole in the mask
        stay = (inner | far).ravel() if len(places) else np.ones(len(points), bool)
        np.testing.assert_array_equal(pulled[stay], points[stay])
        for point, one in zip(points[~stay], pulled[~stay], strict=True):
            target = np.floor(one).astype(int)
            assert (one == target + 0.5).all() and inner[target[1], target[0]]
            nearest = np.linalg.norm(places[:, ::-1] - np.floor(point), axis=1).min()
            assert np.linalg.norm(target - np.floor(point)) < 1.1 * nearest
    off = np.array([[-3.0, 30], [40, -2], [7.2, 8.1]])
    np.testing.assert_array_equal(found.pull(off, 0)[:2], off[:2])  # too far to have slipped
    both = found.pull_each(np.vstack([off, off]), np.array([0, 0, 0, 2, 2, 2]))
    np.testing.assert_array_equal(both, np.vstack([found.pull(off, 0), found.pull(off, 2)]))


def steady_flows(step=(1.5, 0.5), gaps=(1, 2)):
    return {
        sign * gap: np.tile(np.array(step) * sign * gap, (FRAMES, HEIGHT, WIDTH, 1)).astype(np.float16)
        for gap in gaps
        for sign in (1, -1)
    }


@pytest.mark.parametrize(("every", "masked"), [(3, False), (2, True), (50, False)])
def test_what_no_track_covers_is_seeded_again(every, masked):
    """Everything drifts by (1.5, 0.5): a seed's place in every frame is known, and so is what it covers."""
    spacing, step = 6.0, np.array([1.5, 0.5])
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    for t in range(FRAMES):
        mask[t] = np.mgrid[:HEIGHT, :WIDTH][1] < 13 + 1.5 * t
    config = TracksConfig(gaps=(1, 2), reseed_every=every)
    reports = []
    found, visible = module.seed_and_track(
        steady_flows(), spacing, config, mask if masked else None, lambda *all: reports.append(all)
    )
    expected = []
    centres = [(x, y) for y in (3.0, 9, 15) for x in (3.0, 9, 15, 21)]
    times = np.arange(FRAMES)
    for frame in sorted({*range(0, FRAMES, every), FRAMES - 1}):
        covered = set()
        for path in expected:
            if inside(path[frame]):
                covered.add((min(int(path[frame][0] // 6), 4), min(int(path[frame][1] // 6), 3)))
        fresh = [c for c in centres if (int(c[0] // 6), int(c[1] // 6)) not in covered]
        if masked:
            fresh = [c for c in fresh if mask[frame, int(c[1]), int(c[0])]]
        expected += [np.array(c) + (times[:, None] - frame) * step for c in fresh]
    assert found.shape[1] == len(expected) > 12 - 8 * masked
    for n, path in enumerate(expected):
        if not masked:
            there = np.array([inside(one) for one in path])
            np.testing.assert_array_equal(visible[:, n], there)
        np.testing.assert_allclose(found[visible[:, n], n], path[visible[:, n]], atol=0.6 if masked else 2e-3)
    assert np.isnan(found[~visible]).all()
    assert reports[-1][1] == reports[-1][2]


def picture(seed=0, height=60, width=80):
    noise = np.random.default_rng(seed).uniform(0, 255, (height, width)).astype(np.float32)
    return (cv2.GaussianBlur(noise, (0, 0), 1.5) * 3 - 255).clip(0, 255).astype(np.uint8)


def patch(image, point, half=7):
    """Grey levels within `half` pixels of a point, border repeated."""
    values, size = np.empty((2 * half + 1,) * 2), np.array(image.shape[::-1])
    for row, column in np.ndindex(values.shape):
        x, y = np.clip(np.add(point, (column - half, row - half)) - 0.5, 0, size - 1)
        c, r = min(int(x), size[0] - 2), min(int(y), size[1] - 2)
        u, v, four = x - c, y - r, image[r : r + 2, c : c + 2].astype(float)
        values[row, column] = np.array([1 - v, v]) @ four @ np.array([1 - u, u])
    return values


def correlation(a, b):
    a, b = a - a.mean(), b - b.mean()
    return (a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum())


def test_patches_are_normalised_so_that_products_correlate():
    pictures = np.stack([picture(0), picture(1)])
    tracks = np.random.default_rng(0).uniform([-3, -3], [83, 63], (2, 9, 2)).astype(np.float32)
    frames = np.array([0, 1, 1, 0, 0, 1, 0, 1, 1])
    tracks[1, 2] = np.nan
    found = module._patches(pictures, tracks, frames)
    for n, frame in enumerate(frames):
        if n == 2:
            assert not found[n].any()
            continue
        values = patch(pictures[frame], tracks[frame, n].astype(float))
        values -= values.mean()
        np.testing.assert_allclose(found[n], (values / (np.linalg.norm(values) + 7)).ravel(), atol=1e-4)


def test_a_patch_is_found_where_it_correlates_most():
    wide = picture(3, 90, 120)
    shift = np.array([2.3, -1.6])
    one = wide[10:70, 15:95]
    other = cv2.warpAffine(
        wide, np.float32([[1, 0, shift[0] - 15], [0, 1, shift[1] - 10]]), (80, 60), flags=cv2.INTER_CUBIC
    )
    rng = np.random.default_rng(0)
    points = rng.uniform([12, 12], [68, 48], (12, 2))
    near = points + shift + rng.uniform(-3, 3, points.shape)
    points[3], near[4], near[5] = np.nan, [-0.5, 20], [80.5, 20]
    near[6] = points[6] + shift + [5.7, 0]  # at the rim of what is searched
    found = module._find_patches(one, other, points, near, 5)
    for n in range(12):
        if n in (3, 4, 5, 6):
            assert np.isnan(found[n]).all()
            continue
        own, window = patch(one, points[n], 7), patch(other, near[n], 12)
        scores = np.array([[correlation(own, window[y : y + 15, x : x + 15]) for x in range(11)] for y in range(11)])
        line, column = np.unravel_index(scores.argmax(), scores.shape)
        place = np.add(near[n], (column - 5, line - 5))
        for axis, (ahead, middle, after) in enumerate(
            (scores[line, column - 1 : column + 2], scores[line - 1 : line + 2, column])
        ):
            place[axis] += (after - ahead) / (2 * (2 * middle - ahead - after))
        np.testing.assert_allclose(found[n], place, atol=0.02)
        np.testing.assert_allclose(found[n], points[n] + shift, atol=0.25)
    assert np.isnan(module._find_patches(one, picture(9), points, near, 5)).all()


def test_a_patch_at_the_rim_of_the_search_is_no_match():
    """The best of the searched places has neighbours on all sides, else a better one may lie outside."""
    one = picture(3)
    point = np.array([[40.5, 30.5]])
    for shift, found in (
        ((3, 0), True),
        ((-3, 0), True),
        ((0, 3), True),
        ((0, -3), True),
        ((4, 0), False),
        ((-4, 0), False),
        ((0, 4), False),
        ((0, -4), False),
    ):
        place = module._find_patches(one, one, point, point + shift, 4)
        assert np.isfinite(place).all() == found
        if found:
            np.testing.assert_allclose(place, point, atol=0.1)


def test_places_beside_the_picture_are_not_searched():
    one = picture(3)
    for point, near in (
        ((1.5, 30), (-0.5, 30)),
        ((1.5, 30), (0.0, 30)),
        ((78.5, 30), (80.5, 30)),
        ((78.5, 30), (80.0, 30)),
        ((40, 1.5), (40, -0.5)),
        ((40, 58.5), (40, 60.5)),
    ):
        places = np.array([point], float), np.array([near], float)
        assert np.isnan(module._find_patches(one, one, *places, 5)).all()
        back = np.clip(places[1], 1, [79, 59])
        np.testing.assert_allclose(module._find_patches(one, one, places[0], back, 5), places[0], atol=0.3)


def test_squares_of_a_wide_picture_are_told_apart():
    """One place is kept for every square, however many lie beside each other."""
    places = [(x * 32 + 5, y * 32 + 5) for y in range(3) for x in range(40)]
    tracks = np.tile(np.array(places + places, np.float32), (8, 1, 1))
    visible = np.ones((8, 240), bool)
    visible[6:, 120:] = False  # the second of every square is shorter
    kept, _ = module.thinned(tracks, visible, 240 - 1)
    assert kept.shape[1] == 239
    few, _ = module.thinned(tracks[:, ::-1], visible[:, ::-1], 120)
    np.testing.assert_array_equal(few, tracks[:, :120][:, ::-1])
    visible[:, :20] = True
    visible[7:, :20] = False  # of the first row only those that are longer than the second of every square
    few, _ = module.thinned(tracks, visible, 200)
    assert set(map(tuple, few[0])) == set(places)


def test_medians_of_the_first_of_a_row():
    rng = np.random.default_rng(0)
    values, count = rng.normal(size=(6, 8, 2)), np.array([1, 2, 3, 5, 7, 8])
    expected = [np.median(row[:n], axis=0) for row, n in zip(values, count, strict=True)]
    np.testing.assert_allclose(module._median_of_first(values, count), expected)


def expected_by_hand(tracks, visible, lost, before, end, begin):
    known = [n for n in range(tracks.shape[1]) if visible[before, n] and visible[end, n] and n not in set(lost)]
    places = []
    for point in lost:
        own = tracks[end, point] - tracks[before, point]
        near = sorted(known, key=lambda n: np.linalg.norm(tracks[end, n] - tracks[end, point]))[: module.NEAREST]
        unlike = {n: np.linalg.norm(tracks[end, n] - tracks[before, n] - own) for n in near}
        alike = [n for n in near if unlike[n] <= max(1.0, module.STEP_TOLERANCE * np.linalg.norm(own))]
        alike = sorted((n for n in alike if visible[begin, n]), key=unlike.get)[: module.NEIGHBOURS]
        shift = own * (begin - end) / max(end - before, 1)
        if len(alike) >= module.MIN_GUIDES:
            shift = np.median(tracks[begin, alike] - tracks[end, alike], axis=0)
        places.append(tracks[end, point] + shift)
    return np.array(places)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 12, 80])
def test_hidden_points_go_with_guides_that_moved_like_them(count):
    rng = np.random.default_rng(count)
    tracks = (
        rng.uniform(0, 60, (1, 90, 2))
        + np.cumsum(rng.normal(0, 1.0, (8, 90, 2)), 0)
        + np.arange(8)[:, None, None] * [2.0, 1]
    )
    lost, visible = np.arange(10), np.zeros((8, 90), bool)
    visible[:4, : 10 + count] = True
    visible[7, 10 : 10 + count] = rng.random(count) < 0.8
    company = module._Company(tracks, visible, lost, 1, 3)
    expected = expected_by_hand(tracks, visible, lost, 1, 3, 7)
    np.testing.assert_allclose(company.expected(7), expected, atol=1e-9)
    np.testing.assert_allclose(company.expected(7, np.array([7, 2])), expected[[7, 2]], atol=1e-9)
    nothing = module._Company(tracks, visible & False, lost, 3, 3)  # no step to learn from
    np.testing.assert_allclose(nothing.expected(7), tracks[3, lost], atol=1e-9)


def behind_bars(seed=0, frames=26):
    """A card that slides behind a bar: pictures, where its points are, and where they are seen."""
    rng = np.random.default_rng(seed)
    height, width = 60, 110
    wall, card = picture(5, height, width), picture(6, 40, 50)
    bars = picture(7, height, 9)
    points = np.stack(np.meshgrid(np.arange(5.5, 46, 5), np.arange(4.5, 38, 5)), -1).reshape(-1, 2)
    speed, pictures, truth = np.array([2.0, 0.0]), [], []
    for t in range(frames):
        one = wall.copy()
        x = 6 + 2 * t
        one[10:50, x : x + 50] = card
        one[:, 70:79] = bars
        pictures.append(one)
        truth.append(points + (6, 10) + t * speed)
    truth = np.stack(truth)
    clear = (truth[..., 0] < 70) | (truth[..., 0] > 79)
    still = np.column_stack([rng.uniform(2, 108, 14), rng.uniform([2], [14], 14)])
    still[:3, 0] = 5, 104, 20
    still[3:5] = (module.PATCH, 8.3), (width - module.PATCH, 8.6)
    truth = np.concatenate([truth, np.tile(still, (frames, 1, 1))], 1)
    clear = np.concatenate([clear, np.ones((frames, 14), bool)], 1)
    return np.stack(pictures), truth, clear


def torn(truth, clear, seed=0):
    """Tracks of `behind_bars` that begin anew behind the bar, a little beside, twice; some are not seen for a while."""
    rng = np.random.default_rng(seed)
    first = clear & (np.cumsum(~clear, 0) == 0)
    second = clear & (np.cumsum(~clear, 0) > 0)
    still = np.arange(truth.shape[1] - 14, truth.shape[1] - 6)  # near the rim; these end and begin again, too
    first[10:, still], second[14:, still] = False, True
    again = np.flatnonzero(second.sum(0) > 2)
    beside = [truth[:, again] + rng.normal(0, size, (1, len(again), 2)) for size in (0.4, 0.9)]
    tracks = np.concatenate([truth, *beside], 1)
    tracks = (tracks + rng.normal(0, 0.02, tracks.shape)).astype(np.float32)  # no two are equally near or equally alike
    visible = np.concatenate([first, second[:, again], second[:, again]], 1)
    tracks[~visible] = np.nan
    visible[rng.random(visible.shape) < 0.03] = False  # not seen, though it has a place
    rim = still[3:5]  # lost where a patch just touches the picture's edge
    tracks[:10, rim, 0], visible[:10, rim] = truth[:10, rim, 0], True
    return tracks, visible


def relinked_by_hand(tracks, visible, pictures, longest):
    frames, count = visible.shape
    height, width = pictures.shape[1:]
    first = [np.flatnonzero(visible[:, n])[0] if visible[:, n].any() else None for n in range(count)]
    last = [np.flatnonzero(visible[:, n])[-1] if visible[:, n].any() else None for n in range(count)]
    away, found = module.MIN_SAMPLES - 1, []

    patches = [module._patches(pictures, tracks, np.full(count, frame)) for frame in range(frames)]

    def is_lost(a):
        if last[a] is None or last[a] > frames - 3 or not visible[max(last[a] - away, 0), a]:
            return False
        here = tracks[last[a], a]
        return (here > 7).all() and here[0] < width - 7 and here[1] < height - 7

    gone = [a for a in range(count) if is_lost(a)]
    for a in gone:
        end, before = last[a], max(last[a] - away, 0)
        beside, expected = [a, *(other for other in gone if last[other] == end and other != a)], {}
        for b in range(count):
            if first[b] is None or not end < first[b] <= end + longest:
                continue
            begin, settled = first[b], min(first[b] + away, frames - 1)
            if not visible[settled, b]:
                continue
            if begin not in expected:
                expected[begin] = expected_by_hand(tracks, visible, beside, before, end, begin)[0]
            if np.linalg.norm(tracks[begin, b] - expected[begin]) <= module.LINK_RADIUS + 0.5 * (begin - end):
                same = max(patches[begin][b] @ patches[end][a], patches[settled][b] @ patches[before][a])
                found.append((same, end, a, b))
    tracks, visible = tracks.copy(), visible.copy()
    owner, joined = list(range(count)), []
    for same, _, a, b in sorted(found, key=lambda link: -link[0]):
        if same < module.MIN_CORRELATION or a in [one for one, _ in joined] or b in [two for _, two in joined]:
            continue
        joined.append((a, b))
        into, part = owner[a], visible[:, b].copy()
        tracks[part, into], visible[part, into] = tracks[part, b], True
        tracks[:, b], visible[:, b] = np.nan, False
        owner = [into if one == b else one for one in owner]
    return tracks, visible, len(joined)


@pytest.mark.parametrize(("longest", "seed"), [(24, 0), (24, 1), (5, 0)])
def test_relinked_tracks_are_those_of_the_plain_form(longest, seed):
    pictures, truth, clear = behind_bars()
    tracks, visible = torn(truth, clear, seed)
    found, seen, joins = module.relink(tracks, visible, pictures, longest)
    expected, there, count = relinked_by_hand(tracks, visible, pictures, longest)
    assert joins == count > (3 if longest > 9 else -1)
    np.testing.assert_array_equal(seen, there)
    np.testing.assert_array_equal(found, expected)


def seen_again(tracks, visible, pictures, lost, end, t, followed=None):
    company = module._Company(
        tracks, visible, np.array(lost if followed is None else followed), end - module.GAP_MARGIN, end
    )
    return module._seen_again(company, np.flatnonzero(np.isin(company.lost, lost)), pictures, t)


def seen_again_by_hand(tracks, visible, pictures, lost, end, t):
    before = end - module.GAP_MARGIN
    guides = np.flatnonzero(visible[before] & visible[end] & visible[t])
    expected = expected_by_hand(tracks, visible, lost, before, end, t)
    radius = int(module.LINK_RADIUS + 0.5 * (t - end))
    start = tracks[before, lost]
    places = module._find_patches(pictures[before], pictures[t], start, expected, radius)
    back = module._find_patches(pictures[t], pictures[before], places, start, radius)
    good = [n for n in range(len(lost)) if np.linalg.norm(back[n] - start[n]) <= module.RETURN_RADIUS]
    confirmed = np.full((len(lost), 2), np.nan)
    others = [(start[n], places[n] - start[n], n) for n in good] + [
        (tracks[before, g], tracks[t, g] - tracks[before, g], None) for g in guides
    ]
    for n in good:
        near = sorted(
            (float(np.linalg.norm(place - start[n])), float(np.linalg.norm(shift - (places[n] - start[n]))))
            for place, shift, who in others
            if who != n
        )[: module.NEIGHBOURS]
        near = [shift for away, shift in near if away < module.GROUP_RADIUS]
        if len(near) >= module.MIN_GUIDES and 2 * sum(one <= module.GROUP_PIXELS for one in near) >= len(near):
            confirmed[n] = places[n]
    return confirmed


def test_points_are_seen_again_where_patches_and_neighbours_agree():
    pictures, truth, clear = behind_bars()
    tracks, visible = torn(truth, clear)
    last = len(visible) - 1 - visible[::-1].argmax(0)
    tried = found = torn_apart = 0
    for end in range(3, 20):
        lost = np.flatnonzero((last == end) & visible[end - 3] & visible.any(0))
        for t in (end + 6, end + 9):
            if len(lost) and t < len(pictures):
                expected = seen_again_by_hand(tracks, visible, pictures, lost, end, t)
                again = seen_again(tracks, visible, pictures, lost, end, t)
                np.testing.assert_allclose(again, expected, atol=1e-6)
                tried, found = tried + len(lost), found + np.isfinite(again[:, 0]).sum()
                apart = tracks.copy()  # neighbours go their own ways
                apart[t:] += np.random.default_rng(end).normal(0, 2.5, (1, tracks.shape[1], 2))
                expected = seen_again_by_hand(apart, visible, pictures, lost, end, t)
                again = seen_again(apart, visible, pictures, lost, end, t)
                np.testing.assert_allclose(again, expected, atol=1e-6)
                torn_apart += np.isfinite(again[:, 0]).sum()
    assert 5 < found < tried and torn_apart < found


def continued_by_hand(tracks, visible, pictures, longest):
    frames, height, width = pictures.shape
    count = tracks.shape[1]
    spans = [np.flatnonzero(visible[:, n]) for n in range(count)]
    last = [span[-1] if len(span) else -1 for span in spans]
    joined, seen = tracks.copy(), visible.copy()
    holder, joins, margin = list(range(count)), 0, module.GAP_MARGIN
    for end in range(frames - 2, margin - 1, -1):
        lost = [n for n in range(count) if last[n] == end and visible[end - margin, n]]
        lost = [n for n in lost if (tracks[end, n] > 7).all() and (tracks[end, n] < (width - 7, height - 7)).all()]
        followed = lost.copy()
        for gap in module.SEARCH_AFTER:
            t = end + gap
            if gap > longest or t >= frames:
                continue
            settled = [
                n
                for n in range(count)
                if visible[t - margin : t + 1, n].all() and visible[min(t + margin, frames - 1), n]
            ]
            if not lost or not settled:
                continue
            places = seen_again(tracks, visible, pictures, np.array(lost), end, t, followed)
            for point, place in list(zip(lost, places, strict=True)):
                away = np.linalg.norm(tracks[t, settled] - place, axis=1)
                if not np.isfinite(place[0]) or away.min() > module.FOLLOW_RADIUS:
                    continue
                other = settled[int(away.argmin())]
                lost.remove(point)
                same, source = away.min() <= module.SAME_POINT_RADIUS, holder[other]
                joined[end - margin + 1 : end + 1, point], seen[end - margin + 1 : end + 1, point] = np.nan, False
                joined[t:, point] = joined[t:, source] + (0 if same else place - tracks[t, other])
                seen[t:, point] = seen[t:, source]
                if same and source == other and spans[other][0] > end:
                    joined[:, other], seen[:, other], holder[other] = np.nan, False, point
                joins += 1
    return joined, seen & np.isfinite(joined[..., 0]), joins


@pytest.mark.parametrize(("longest", "seed"), [(24, 0), (24, 1), (9, 0)])
def test_continued_tracks_are_those_of_the_plain_form(longest, seed):
    pictures, truth, clear = behind_bars()
    tracks, visible = torn(truth, clear, seed)
    found, seen, joins = module.continue_lost(tracks, visible, pictures, longest)
    expected, there, count = continued_by_hand(tracks, visible, pictures, longest)
    assert joins == count > (2 if longest > 9 else -1)
    np.testing.assert_array_equal(seen, there)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_ranks_are_the_least_in_any_group():
    group, item = np.array([0, 0, 0, 2, 2, 5]), np.array([4, 1, 3, 3, 0, 4])
    np.testing.assert_array_equal(module.best_rank(group, item, 6), [0, 0, 6, 1, 0, 6])


def test_short_clips_keep_tracks_that_are_seen_in_every_frame():
    tracks = np.random.default_rng(0).uniform(0, 60, (3, 12, 2)).astype(np.float32)
    visible = np.ones((3, 12), bool)
    visible[1, :4] = False
    kept, seen = module.thinned(tracks, visible, 8)
    np.testing.assert_array_equal(kept, tracks[:, 4:])
    assert seen.all()
    four = np.tile(visible[:1], (5, 1))
    four[0, :2], four[:2, 2] = False, False
    assert module.thinned(np.zeros((5, 12, 2), np.float32), four, 20)[0].shape[1] == 11  # three samples are too few


@pytest.mark.parametrize("relink_gap", [0, 24])
def test_the_statistics_tell_what_was_tracked(relink_gap):
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    clip = Clip("toy", frames, np.arange(FRAMES, dtype=float), 24.0, np.zeros(FRAMES, bool), "toy")
    priors = Priors.empty(clip)
    priors.scratch.long_flows = steady_flows(gaps=(1, 2, 4))
    config = PriorsConfig(tracks=TracksConfig(spacing=4.0, reseed_every=2, relink_gap=relink_gap))
    module.provide(clip, priors, config, silent)
    plain = module.seed_and_track(steady_flows(gaps=(1, 2, 4)), 4.0, config.tracks)
    if relink_gap:
        pictures = module.grey(frames)
        plain = module.relink(*plain, pictures, relink_gap)[:2]
    kept, seen = module.thinned(*plain, 12000)
    np.testing.assert_array_equal(priors.tracks, kept)
    found = priors.statistics["tracks"]
    assert found["uniform"] == kept.shape[1] > 20 and found["mean_length"] == pytest.approx(seen.sum(0).mean())
    assert found["joins"] == 0 or relink_gap
