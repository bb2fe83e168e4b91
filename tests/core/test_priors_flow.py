"""Dense flow and its tests against plain forms: loops over pixels, pictures whose motion is known."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from f4x_core.clip import Clip
from f4x_core.errors import F4xError
from f4x_core.priors import FlowConfig, MotionConfig, Priors, PriorsConfig, TracksConfig
from f4x_core.priors import flow as module
from f4x_core.progress import silent

from .warped_clip import texture, warped_clip

HEIGHT, WIDTH = 30, 44


def bilinear(image, x, y):
    """Centres at +0.5, border repeated, weight by weight."""
    total = 0.0
    x, y = min(max(x - 0.5, 0), image.shape[1] - 1), min(max(y - 0.5, 0), image.shape[0] - 1)
    for r in range(image.shape[0]):
        for c in range(image.shape[1]):
            total = total + max(1 - abs(x - c), 0) * max(1 - abs(y - r), 0) * image[r, c].astype(float)
    return total


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (1, 7), (5, 1), (2, 2, 2)])
def test_samples_are_bilinear(shape):
    rng = np.random.default_rng(0)
    image = rng.normal(size=shape)
    points = np.concatenate(
        [rng.uniform([-1, -1], [shape[1] + 1, shape[0] + 1], (40, 2)), [[shape[1], shape[0]], [0, 0]]]
    )
    expected = [bilinear(image, x, y) for x, y in points]
    np.testing.assert_allclose(module.sample(image, points), expected, atol=1e-12)
    for dtype in (np.float32, np.float16):  # compiled, where the library is
        stored = image.astype(dtype)
        plain = module._plain_sample(stored.astype(float), points)
        np.testing.assert_allclose(module.sample(stored, points), plain, atol=1e-5)
        np.testing.assert_allclose(module._plain_sample(stored, points), plain, atol=1e-5)
    on_grid = points[:40].reshape(8, 5, 2)
    found = module.look_up(image.astype(np.float32), on_grid)
    np.testing.assert_allclose(found, module.sample(image, on_grid), atol=0.15)  # remap counts in 32nds of a pixel
    assert np.abs(found - module.sample(image, on_grid)).mean() < 0.03


def test_lengths_and_what_is_inside():
    np.testing.assert_allclose(module.length(np.array([[3.0, 4], [-5, 12]])), [5, 13])
    points = np.array(
        [[0, 0], [44, 30], [-1e-3, 3], [3, -1e-3], [44.001, 3], [3, 30.001], [0.5, 0.5], [44, 0], [0, 30]]
    )
    np.testing.assert_array_equal(module.inside(points, 30, 44), [1, 1, 0, 0, 0, 0, 1, 1, 1])


def random_pair(seed=0):
    rng = np.random.default_rng(seed)
    there = rng.normal([1.5, -0.5], 1.0, (HEIGHT, WIDTH, 2)).astype(np.float32)
    back = rng.normal([-1.5, 0.5], 1.0, (HEIGHT, WIDTH, 2)).astype(np.float32)
    return there, back


def agrees(point, there, returned):
    size = 0.5 * (np.hypot(*there) + np.hypot(*returned)) + 0.5
    x, y = point + there
    return np.hypot(*(there + returned)) < size and 0 <= x <= WIDTH and 0 <= y <= HEIGHT


def test_flow_there_and_back_agrees_point_by_point():
    there, back = random_pair()
    rng = np.random.default_rng(1)
    points, steps = rng.uniform([0, 0], [WIDTH, HEIGHT], (200, 2)), rng.normal([1.5, -0.5], 1.0, (200, 2))
    found = module.consistent_at(points, steps, back)
    expected = [agrees(p, s, bilinear(back, *(p + s))) for p, s in zip(points, steps, strict=True)]
    np.testing.assert_array_equal(found, expected)
    assert 0.2 < found.mean() < 0.9
    dense = module.consistent(there, back)
    for y, x in np.random.default_rng(2).integers(0, [HEIGHT, WIDTH], (60, 2)):
        here = np.array([x + 0.5, y + 0.5])
        returned = module.look_up(back, (here + there[y, x])[None, None])[0, 0]
        assert dense[y, x] == agrees(here, there[y, x], returned)
        warped = bilinear(back, *(here + there[y, x]))
        np.testing.assert_allclose(module.warp(back, there)[y, x], warped, atol=0.12)
        chained = module.compose(there, back)[y, x]
        np.testing.assert_allclose(chained, there[y, x] + warped, atol=0.12)


def test_texture_is_the_spread_of_grey_levels_against_a_limit():
    picture = (127 + 8 * np.random.default_rng(0).normal(size=(HEIGHT, WIDTH))).clip(0, 255).astype(np.uint8)
    picture[:, :20] = picture[:, :20] // 20 + 100
    found = module.texture(picture)
    padded = np.pad(picture.astype(float), 3, mode="symmetric")
    for y, x in ((0, 0), (10, 8), (29, 43), (15, 30), (15, 20)):
        spread = padded[y : y + 7, x : x + 7].var()
        assert found[y, x] == pytest.approx(spread / (spread + 16), abs=2e-3)
    assert module.texture(np.full((9, 9), 200, np.uint8)).max() < 1e-2


@pytest.mark.parametrize("step", [1, 2, 3])
def test_texture_along_a_direction_is_the_slope_there(step):
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.uniform(0, 255, (HEIGHT, WIDTH)).astype(np.float32), (0, 0), 1.2).astype(np.uint8)
    direction = rng.normal(size=(HEIGHT // step, len(range(step // 2, WIDTH, step)), 2))
    direction[2, 3] = 0
    found = module.texture_along(picture, direction)
    padded = np.pad(picture.astype(float), 1, mode="reflect")
    kernel = np.array([[-3, 0, 3], [-10, 0, 10], [-3, 0, 3]]) / 32
    x_slope, y_slope = np.zeros((2, HEIGHT, WIDTH))
    for y, x in np.ndindex(HEIGHT, WIDTH):
        x_slope[y, x] = (kernel * padded[y : y + 3, x : x + 3]).sum()
        y_slope[y, x] = (kernel.T * padded[y : y + 3, x : x + 3]).sum()
    products = np.stack([x_slope**2, x_slope * y_slope, y_slope**2])
    products = np.pad(products, ((0, 0), (3, 3), (3, 3)), mode="symmetric")
    for row, column in ((0, 0), (2, 3), (5, 7), (9, 13)):
        y, x = step // 2 + step * row, step // 2 + step * column
        xx, xy, yy = products[:, y : y + 7, x : x + 7].mean((1, 2))
        u, v = direction[row, column] / max(np.hypot(*direction[row, column]), 1e-12)
        spread = module.GRAIN**2 * max(u * u * xx + 2 * u * v * xy + v * v * yy, 0)
        assert found[row, column] == pytest.approx(spread / (spread + 16), abs=1e-4)


class Engine:
    """Stands in for OpenCV's flow and remembers what it was told."""

    def __init__(self, preset):
        self.told = [preset]

    def setFinestScale(self, value):
        self.told.append(("finest", value))

    def setPatchStride(self, value):
        self.told.append(("stride", value))

    def setVariationalRefinementIterations(self, value):
        self.told.append(("rounds", value))

    def calc(self, first, second, start):
        return self.told


def test_the_engine_gets_its_settings(monkeypatch):
    made = []
    monkeypatch.setattr(cv2.DISOpticalFlow, "create", lambda preset: made.append(preset) or Engine(preset))
    medium = cv2.DISOPTICAL_FLOW_PRESET_MEDIUM
    large, small = np.zeros((60, 80), np.uint8), np.zeros((30, 40), np.uint8)
    fine = module.dis("fine", 5)
    assert fine(large, large) == [medium, ("finest", 0), ("stride", 4), ("rounds", 5)]
    assert fine(large, large) and made == [medium]  # one engine, used again
    assert (
        fine(small, small) and made == [medium] * 2
    )  # but not for another size: small pictures lower its scales for good
    assert module.dis("medium", 3)(large, large) == [medium, ("rounds", 3)]
    assert module.dis("fast", 1)(large, large)[0] == cv2.DISOPTICAL_FLOW_PRESET_FAST
    assert module.dis("ultrafast", 1)(large, large)[0] == cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST
    with pytest.raises(F4xError, match="no flow preset 'best'"):
        module.dis("best", 1)


def with_flow(frames=6, seed=0):
    rng = np.random.default_rng(seed)
    priors = Priors(WIDTH, HEIGHT, np.arange(frames))
    priors.flow_forward = rng.normal(1.0, 0.5, (frames - 1, HEIGHT, WIDTH, 2)).astype(np.float16)
    priors.flow_backward = rng.normal(-1.0, 0.5, (frames - 1, HEIGHT, WIDTH, 2)).astype(np.float16)
    return priors


def test_long_flows_are_chained_from_half_ones():
    priors, reports = with_flow(), []
    config = PriorsConfig(tracks=TracksConfig(gaps=(1, 2)), motion=MotionConfig(gaps=(4,)))
    flows = module.long_flows(None, priors, config, lambda *all: reports.append(all))
    assert sorted(flows) == [-4, -2, -1, 1, 2, 4]
    np.testing.assert_array_equal(flows[1][:5], priors.flow_forward)
    np.testing.assert_array_equal(flows[-1][1:], priors.flow_backward)
    for gap, half in ((2, 1), (4, 2)):
        for sign in (1, -1):
            for t in range(6):
                if not 0 <= t + sign * gap < 6:
                    assert not flows[sign * gap][t].any()
                    continue
                first, second = flows[sign * half][t], flows[sign * half][t + sign * half]
                expected = module.compose(first.astype(np.float32), second.astype(np.float32))
                np.testing.assert_array_equal(flows[sign * gap][t], expected.astype(np.float16))
    assert not flows[1][5].any() and not flows[-1][0].any()
    assert module.long_flows(None, priors, config, silent) is flows
    assert [report[1] for report in reports] == [0, 1, 2, 3] and reports[-1][2] == 3
    short = module.long_flows(
        None, with_flow(2), PriorsConfig(tracks=TracksConfig(gaps=(1,)), motion=MotionConfig(gaps=(1,))), silent
    )
    assert sorted(short) == [-1, 1]
    with pytest.raises(F4xError, match="power of two"):
        module.long_flows(None, with_flow(), PriorsConfig(motion=MotionConfig(gaps=(6,))), silent)


def test_scratch_is_reserved_on_the_disk(monkeypatch):
    asked = []
    monkeypatch.setattr(
        module.os, "posix_fallocate", lambda file, start, size: asked.append((start, size)), raising=False
    )
    found = module.scratch_array((3, 4, 5, 2))
    assert found.shape == (3, 4, 5, 2) and found.dtype == np.float16 and not found.any()
    assert asked == [(0, 240)]  # two bytes each

    def full(*all):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module.os, "posix_fallocate", full, raising=False)
    with pytest.raises(F4xError, match="no room for 3 MiB"):
        module.scratch_array((3 << 19, 1))


def turned_picture(homography):
    """A picture, and what it looks like through a homography of its pixels."""
    wide = cv2.cvtColor(texture(120, 176, 4), cv2.COLOR_RGB2GRAY)
    return wide, cv2.warpPerspective(wide, homography, (176, 120), borderMode=cv2.BORDER_REPLICATE)


def test_a_homography_is_found_from_features():
    true = np.array([[1.05, 0.03, 9.0], [-0.02, 0.98, -6], [1e-4, 5e-5, 1]])
    first, second = turned_picture(true)
    found = module._homography(first, second)
    corners = np.array([[[20.0, 20], [150, 20], [150, 100], [20, 100]]])
    apart = cv2.perspectiveTransform(corners, found) - cv2.perspectiveTransform(corners, true)
    assert abs(apart).max() < 1
    assert module._homography(first, np.full_like(first, 9)) is None
    assert module._homography(np.full_like(first, 9), second) is None
    other = cv2.cvtColor(texture(120, 176, 5), cv2.COLOR_RGB2GRAY)
    assert module._homography(first, other) is None


@pytest.mark.parametrize(
    ("matches", "inliers", "enough"), [(20, 20, True), (19, 19, False), (30, 19, False), (30, 20, True)]
)
def test_a_homography_needs_twenty_inliers(monkeypatch, matches, inliers, enough):
    true, asked = np.diag([2.0, 2.0, 1.0]), []

    class Sift:
        def detectAndCompute(self, picture, nothing):
            points = [cv2.KeyPoint(float(i), float(2 * i), 1.0) for i in range(40)]
            return points, np.zeros((40, 128), np.float32)

    class Matcher:
        def knnMatch(self, one, other, k):
            good = [(cv2.DMatch(i, i, 0.79), cv2.DMatch(i, i, 1.0)) for i in range(matches)]
            return (
                good
                + [(cv2.DMatch(i, i, 0.81), cv2.DMatch(i, i, 1.0)) for i in range(matches, 40)]
                + [(cv2.DMatch(0, 0, 0.1),)]
            )

    def find(here, seen, method, limit):
        asked.append((len(here), method, limit))
        return true, (np.arange(len(here)) < inliers).astype(np.uint8)[:, None]

    monkeypatch.setattr(cv2.SIFT, "create", lambda count: Sift() if count == 2000 else None)
    monkeypatch.setattr(cv2, "BFMatcher", Matcher)
    monkeypatch.setattr(cv2, "findHomography", find)
    found = module._homography(np.zeros((9, 9), np.uint8), np.zeros((9, 9), np.uint8))
    assert (found is true) == enough and asked == ([(matches, cv2.USAC_MAGSAC, 2.0)] if matches >= 20 else [])


def test_flow_beyond_a_homography_ends_where_it_leads():
    homography = np.array([[1.05, 0.03, 9.0], [-0.02, 0.98, -6], [1e-4, 5e-5, 1]])
    first, second = turned_picture(homography)
    brought = []

    def aside(one, other):
        brought.append(other)
        return np.full((*one.shape, 2), (1.5, -0.5), np.float32)

    found = module._beyond(first, second, homography, aside)
    inner = np.s_[20:-20, 20:-20]
    assert abs(brought[0][inner].astype(float) - first[inner]).mean() < 3
    for y, x in ((0, 0), (50, 90), (119, 175)):
        lifted = homography @ [x + 1.5, y - 0.5, 1]
        np.testing.assert_allclose(found[y, x], lifted[:2] / lifted[2] - (x, y), atol=1e-4)
    assert found.dtype == np.float32


def test_the_better_flow_is_the_one_that_explains_the_picture():
    rng = np.random.default_rng(0)
    first = rng.integers(0, 255, (HEIGHT, WIDTH), np.uint8)
    second = np.roll(first, (1, 2), (0, 1))
    one, other = np.zeros((2, HEIGHT, WIDTH, 2), np.float32)
    other[:] = 2, 1
    one[:, 20:] = 2, 1
    other[:, 30:] = 60, 1  # it leaves the picture
    found = module._better(first, second, one, other)
    missed = []
    for flow in (one, other):
        error = np.empty((HEIGHT, WIDTH))
        for y, x in np.ndindex(HEIGHT, WIDTH):
            place = np.array([x + 0.5, y + 0.5]) + flow[y, x]
            outside = not (0 <= place[0] <= WIDTH and 0 <= place[1] <= HEIGHT)
            seen = module.sample(second.astype(float), place)
            error[y, x] = 255 if outside else abs(seen - first[y, x])
        missed.append(ndimage.uniform_filter(error, 7))
    sure = abs(missed[1] - missed[0]) > 0.5
    expected = np.where((missed[1] < missed[0])[..., None], other, one)
    np.testing.assert_array_equal(found[sure], expected[sure])
    assert (found[5:-5, 5:18] == (2, 1)).all() and (found[5:-5, 35:] == (2, 1)).all()
    np.testing.assert_array_equal(module._better(first, second, one, one + 0), one)


@pytest.mark.parametrize("pan", [(1.5, 0.4), (50.0, 3.0)])
def test_flow_of_every_pair_both_ways(pan):
    clip, _ = warped_clip(frames=3, pan=pan, speed=(-2.0, 1.0))
    priors, reports = Priors.empty(clip), []
    config = PriorsConfig(flow=FlowConfig(preset="ultrafast", refine_iterations=1))
    module.provide(clip, priors, config, lambda *all: reports.append(all))
    engine, pictures = module.dis("ultrafast", 1), module.grey(clip.frames)
    looked_again = 0
    for i in range(2):
        first, second = pictures[i], pictures[i + 1]
        there, back = engine(first, second), engine(second, first)
        masks = module.consistent(there, back), module.consistent(back, there)
        if np.mean(masks) < 0.85:
            looked_again += 1
            homography = module._homography(first, second)
            if homography is not None:
                inverse = np.linalg.inv(homography)
                there = module._better(first, second, there, module._beyond(first, second, homography, engine))
                back = module._better(second, first, back, module._beyond(second, first, inverse, engine))
        there, back = module._find_lost(first, second, there, back, engine)
        masks = module.consistent(there, back), module.consistent(back, there)
        np.testing.assert_array_equal(priors.flow_forward[i], there.astype(np.float16))
        np.testing.assert_array_equal(priors.flow_backward[i], back.astype(np.float16))
        np.testing.assert_array_equal(priors.flow_forward_mask[i], masks[0])
        np.testing.assert_array_equal(priors.flow_backward_mask[i], masks[1])
    assert looked_again == (2 if pan[0] > 9 else 0)
    assert [report[1] for report in reports] == [0, 1, 2]


def test_what_flow_misses_is_what_a_slip_cannot_explain():
    rng = np.random.default_rng(3)
    second = ndimage.gaussian_filter(rng.uniform(0, 255, (50, 60)), 2).astype(np.uint8)
    low, there = (7, 5), rng.normal(0, 4, (30, 40, 2)).astype(np.float32)
    first = np.ascontiguousarray(np.roll(second, 6, 1)[5:35, 7:47])
    found = module._missed(first, second, there, low)
    slopes = [cv2.Scharr(first.astype(np.float32), cv2.CV_32F, *axis) / 32 for axis in ((1, 0), (0, 1))]
    error = np.zeros(first.shape)
    for y, x in np.ndindex(*first.shape):
        place = np.array([x + 7.5, y + 5.5]) + there[y, x]
        if 0 <= place[0] <= 60 and 0 <= place[1] <= 50:
            off = abs(module.sample(second.astype(float), place) - first[y, x])
            error[y, x] = max(off - 0.5 * np.hypot(slopes[0][y, x], slopes[1][y, x]), 0)
    expected = ndimage.uniform_filter(error, 7, mode="mirror")
    np.testing.assert_allclose(found, expected, atol=0.1)  # remap rounds places to 1/32 pixel


@pytest.mark.parametrize("shift", [(9, -5), (-12, 3), (1, 1)])
def test_the_best_shift_brings_what_is_left_over_onto_what_is_left_over(shift):
    rng = np.random.default_rng(4)
    wall = ndimage.gaussian_filter(rng.uniform(0, 255, (60, 80)), 1.5).astype(np.float32) * 2
    thing = ndimage.gaussian_filter(rng.uniform(0, 255, (14, 14)), 1.5).astype(np.float32) * 2 - 100
    one, other, region = wall.copy(), wall.copy(), np.zeros(wall.shape, bool)
    one[20:34, 30:44], region[24:30, 34:40] = thing, True
    other[20 + shift[1] : 34 + shift[1], 30 + shift[0] : 44 + shift[0]] = thing
    found = module._best_shift(one, other, region, 14)
    assert found is None if max(abs(np.array(shift))) < module.KNOWN_SHIFT else found.tolist() == list(shift)
    assert module._best_shift(wall, wall, np.zeros(wall.shape, bool), 14) is None


def test_grey_is_the_weighted_sum_of_red_green_and_blue():
    frames = np.random.default_rng(0).integers(0, 255, (2, 4, 5, 3), np.uint8)
    np.testing.assert_allclose(module.grey(frames), frames @ [0.299, 0.587, 0.114], atol=0.51)
    clip = Clip("one", frames[:1], np.zeros(1), 24.0, np.zeros(1, bool), "one")
    priors = Priors.empty(clip)
    module.provide(clip, priors, PriorsConfig(), silent)
    assert priors.flow_forward.shape == (0, 4, 5, 2)


def patchwork(*places, seed=7, side=24):
    """A grey wall of 96 x 160 with squares of different textures at `places` (x, y)."""
    wall, rng = np.full((96, 160), 100, np.float32), np.random.default_rng(seed)
    for x, y in places:
        wall[y : y + side, x : x + side] = cv2.GaussianBlur(
            rng.uniform(0, 255, (side, side)).astype(np.float32), (0, 0), 1
        )
    return wall


def test_what_is_left_over_elsewhere_does_not_count():
    """A small thing moves by 8; elsewhere two large ones move by 5 the other way. The region is wider than what is left over."""
    one, other = patchwork((30, 30), (90, 10), (90, 60)), patchwork((38, 30), (85, 10), (85, 60))
    one[30:46, 30:54], other[30:46, 38:62] = 100, 100  # a third of the thing is enough
    region = np.zeros(one.shape, bool)
    region[40:58, 26:58] = True
    assert module._best_shift(one, other, region, 12).tolist() == [8, 0]


@pytest.fixture
def lost():
    """Two pictures of 192 x 320 in which a square of 40 moves; flow says that all around it moves by (6, 4), far away nothing."""
    one, other = (cv2.resize(patchwork(place), (320, 192)).astype(np.uint8) for place in ((60, 40), (66, 40)))
    flow = np.zeros((192, 320, 2), np.float32)
    flow[72:134, 112:174] = 6, 4
    region = np.zeros((192, 320), bool)
    region[80:126, 120:166] = True
    return one, other, flow, region


def test_surroundings_are_a_ring_around_what_is_lost(lost, monkeypatch):
    monkeypatch.setattr(module, "_best_shift", lambda *given: np.array([1, 2]))
    (found,) = module._shifts(*lost)
    np.testing.assert_allclose(found.motion, [6 + 2, 4 + 4])
    np.testing.assert_allclose([found.low, found.high], [[120 - 16, 80 - 16], [166 + 16, 126 + 16]])


def test_what_is_not_lost_is_no_region(lost, monkeypatch):
    one, other, flow, region = lost
    regions = []
    monkeypatch.setattr(module, "_best_shift", lambda small, aligned, own, reach: regions.append(own) or None)
    assert module._shifts(one, other, flow, region) == []
    assert [own.sum() for own in regions] == [23 * 23]
    assert module._shifts(one, other, flow, np.ones_like(region)) == []  # there is nothing around it
    assert len(regions) == 1


@pytest.mark.parametrize(("before", "after", "taken"), [(20.0, 1.0, True), (4.5, 1.0, False), (20.0, 9.0, False)])
def test_flow_anew_explains_what_was_missed_and_is_not_any_longer(before, after, taken, monkeypatch):
    monkeypatch.setattr(module, "_missed", lambda first, *given: np.full(first.shape, after))
    shift = module._Shift(np.array([5.0, 0.0]), np.array([10, 10]), np.array([90, 80]))
    picture = np.zeros((96, 160), np.uint8)
    still = lambda first, second: np.zeros((*first.shape, 2), np.float32)  # noqa: E731
    found = module._Anew.start(shift, picture, picture, np.full(picture.shape, before), still)
    assert bool(found.thing.any()) == taken
