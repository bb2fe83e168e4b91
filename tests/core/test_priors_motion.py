"""Flow, tracks and motion on warped textures with known truth."""

import numpy as np
import pytest
import scipy.ndimage

from f4x_core.errors import F4xError
from f4x_core.priors import FlowConfig, MotionConfig, Priors, PriorsConfig, TracksConfig, flow, motion, tracks
from f4x_core.progress import silent

from .warped_clip import HEIGHT, SIDE, WIDTH, fast_ball_clip, square_corner, warped_clip

CONFIG = PriorsConfig(tracks=TracksConfig(count=3000))
PAN, SPEED = (1.5, 0.4), (2.5, 0.7)


def run(clip, config=CONFIG, mask=None):
    priors = Priors.empty(clip)
    priors.mask = mask
    for stage in (flow, tracks, motion):
        stage.provide(clip, priors, config, silent)
    priors.validate()
    return priors


@pytest.fixture(scope="module")
def moving():
    clip, mask = warped_clip(pan=PAN, speed=SPEED)
    return clip, mask, run(clip)


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


def test_sample_is_exact_on_linear_functions_at_pixel_centres():
    grid = flow.pixel_grid(7, 9).astype(np.float64)
    linear = 2 * grid[..., 0] - 3 * grid[..., 1]
    points = np.random.default_rng(0).uniform(0.5, 6.5, (50, 2))
    np.testing.assert_allclose(flow.sample(linear, points), 2 * points[:, 0] - 3 * points[:, 1], atol=1e-12)
    np.testing.assert_array_equal(flow.sample(linear, grid), linear)


def test_flow_matches_the_true_shift_and_its_mask_marks_the_occluded(moving):
    _, mask, priors = moving
    inside = np.s_[20:-20, 20:-20]
    wall = ~np.maximum(mask[0], mask[1])[inside]
    error = np.linalg.norm(priors.flow_forward[0][inside] - (-np.array(PAN)), axis=-1)
    assert np.median(error[wall]) < 0.1
    error = np.linalg.norm(priors.flow_forward[0] - np.array(SPEED), axis=-1)
    assert np.median(error[mask[0]]) < 0.4  # half of the small square lies within a DIS patch of its edge
    error = np.linalg.norm(priors.flow_backward[0] + np.array(SPEED), axis=-1)
    assert np.median(error[mask[1]]) < 0.4
    assert priors.flow_forward_mask[:, 20:-20, 20:-20].mean() > 0.95


def test_flow_never_looks_at_held_out_frames():
    clip, _ = warped_clip(hold_out=(3, 7))
    before = flow_of(clip)
    clip.frames[clip.held_out] = 0
    np.testing.assert_array_equal(before, flow_of(clip))


def wide_pan():
    """A clip whose pictures shift by more than a quarter of their width, with a square that stays in the picture, and its mask."""
    return warped_clip(frames=4, pan=(50.0, 3.0), speed=(-2.0, 1.0))


def test_flow_follows_a_fast_pan_and_what_moves_with_it():
    clip, mask = wide_pan()
    priors = Priors.empty(clip)
    flow.provide(clip, priors, CONFIG, silent)
    stays = flow.inside(
        flow.pixel_grid(HEIGHT, WIDTH) - np.array([55.0, 6.0]), HEIGHT, WIDTH
    )  # the wall that both show
    for pair in range(3):
        wall = stays & ~(mask[pair] | mask[pair + 1])
        error = np.linalg.norm(priors.flow_forward[pair] - np.array([-50.0, -3.0]), axis=-1)
        assert np.median(error[wall]) < 0.3
        error = np.linalg.norm(priors.flow_forward[pair] - np.array([-2.0, 1.0]), axis=-1)
        assert np.median(error[mask[pair]]) < 0.5


def test_pictures_without_matches_keep_their_flow():
    rng = np.random.default_rng(0)
    clip, _ = warped_clip(frames=3)
    clip.frames[:] = rng.integers(0, 255, clip.frames.shape, np.uint8)  # nothing in common, and no homography
    clip.frames[1] = 127  # no features at all
    assert np.isfinite(flow_of(clip)).all()


def flow_of(clip):
    priors = Priors.empty(clip)
    flow.provide(clip, priors, CONFIG, silent)
    return priors.flow_forward


def test_long_flows_compose_to_the_true_displacement(moving):
    _, mask, priors = moving
    flows = priors.scratch.long_flows
    for gap in (2, -2, 4, 8):
        t = 0 if gap > 0 else 4
        inner = mask[t] & np.roll(mask[t], (4, 4), (0, 1)) & np.roll(mask[t], (-4, -4), (0, 1))
        error = np.linalg.norm(flows[gap][t].astype(np.float32) - gap * np.array(SPEED), axis=-1)
        assert np.median(error[inner]) < 0.3, gap
        assert not flows[gap][-1 if gap > 0 else 0].any()


def test_points_are_followed_both_ways_in_time(moving):
    _, _, priors = moving
    corner = square_corner(6, SPEED)
    queries = np.array([[6, *(corner + 18)], [6, 150.0, 90.0]])
    found, visible = tracks.track_points(priors.scratch.long_flows, queries)
    steps = np.arange(12) - 6
    assert visible[:, 0].all()
    assert np.abs(found[:, 0] - (corner + 18 + steps[:, None] * SPEED)).max() < 0.5
    wall = queries[1, 1:] - steps[:, None] * PAN
    assert np.abs(found[:, 1] - wall)[visible[:, 1]].max() < 0.5
    assert visible[:, 1].sum() >= 10


def test_object_flow_keeps_silhouette_points_on_the_object(moving):
    _, mask, priors = moving
    corner = square_corner(0, SPEED)
    edge = corner + np.stack([np.zeros(9) + 0.3, np.linspace(4, SIDE - 4, 9)], -1)
    queries = np.column_stack([np.zeros(9), edge])
    truth = edge + 11 * np.array(SPEED)
    loose, _ = tracks.track_points(priors.scratch.long_flows, queries)
    held, _ = tracks.track_points(priors.scratch.long_flows, queries, mask=mask)
    assert np.linalg.norm(loose[-1] - truth, axis=-1).min() > 30  # the wall takes them along
    assert np.linalg.norm(held[-1] - truth, axis=-1).max() < 8
    assert np.linalg.norm(held[-1] - truth, axis=-1).mean() < 4


def test_tracks_cover_every_frame(moving):
    _, mask, priors = moving
    for t in range(12):
        seen = priors.tracks[t][priors.tracks_visible[t]]
        cells = {tuple(cell) for cell in np.floor(seen / 16).astype(int)}
        assert len(cells) > 0.9 * (WIDTH // 16) * (HEIGHT // 16)
        assert mask[t][seen[:, 1].astype(int).clip(0, HEIGHT - 1), seen[:, 0].astype(int).clip(0, WIDTH - 1)].sum() > 40


@pytest.fixture
def behind_a_post():
    """(pictures, paths (F,n,2), where they are seen before and after a post (F,n), tracks and visible of `relink`)."""
    speed, post, frames = np.array([3.0, 0.0]), 94, 24
    clip, _ = warped_clip(frames=frames, pan=(0.0, 0.0), speed=tuple(speed), post=post)
    card = np.stack(np.meshgrid(np.arange(8, SIDE - 4, 6), np.arange(8, SIDE - 4, 6)), -1).reshape(-1, 2)
    path = square_corner(0, speed) + card + np.arange(frames)[:, None, None] * speed  # (F,n,2)
    wall = np.array([[x, y] for x in (20, 60, 150) for y in (15, 100)], float)
    before, after = path[..., 0] < post - 3, path[..., 0] > post + 17
    shuffle = np.random.default_rng(0).permutation(len(card))
    points = np.concatenate([path, path[:, shuffle], np.tile(wall, (frames, 1, 1))], 1).astype(np.float32)
    visible = np.concatenate([before, after[:, shuffle], np.ones((frames, len(wall)), bool)], 1)
    points[~visible] = np.nan
    return flow.grey(clip.frames), path, before, after, points, visible


def test_relink_joins_points_hidden_by_a_post_with_themselves(behind_a_post):
    pictures, path, before, after, points, visible = behind_a_post
    joined, seen, joins = tracks.relink(points, visible, pictures, 12)
    whole = np.nonzero(before.any(0) & (before.sum(0) >= 4) & (after.sum(0) >= 4))[0]
    assert joins == len(whole) > 8
    for point in whole:
        np.testing.assert_array_equal(seen[:, point], before[:, point] | after[:, point])
        np.testing.assert_allclose(joined[seen[:, point], point], path[seen[:, point], point], rtol=1e-6)
    assert tracks.relink(points, visible, pictures, 3)[2] == 0  # hidden for longer than allowed


def test_lost_points_go_on_with_what_is_nearest_where_they_are_seen_again(behind_a_post):
    pictures, path, before, after, points, visible = behind_a_post
    count = path.shape[1]
    points[:, count : 2 * count] += np.float32([1.5, 1.0])  # the later tracks are other points, beside the lost ones
    joined, seen, continued = tracks.continue_lost(points, visible, pictures, 12)
    long_enough = np.nonzero((before.sum(0) >= 4) & (after.sum(0) >= 8))[0]
    again = [point for point in long_enough if (seen[:, point] & after[:, point]).any()]
    assert continued >= len(again) > 0.7 * len(long_enough) > 5
    for point in again:
        last = np.flatnonzero(before[:, point])[-1]
        assert not seen[last - tracks.GAP_MARGIN + 1 : last + 1, point].any()  # the post may have dragged it
        assert not (seen[:, point] & ~before[:, point] & ~after[:, point]).any()  # nothing is invented
        np.testing.assert_allclose(joined[seen[:, point], point], path[seen[:, point], point], atol=0.7)
    assert tracks.continue_lost(points, visible, pictures, 3)[2] == 0  # hidden for longer than allowed


def test_lost_points_do_not_go_on_with_what_looks_different(behind_a_post):
    pictures, path, _, _, points, visible = behind_a_post
    swapped = pictures.copy()
    for t, corner in enumerate(square_corner(0, (3.0, 0.0)) + np.arange(len(path))[:, None] * (3.0, 0.0)):
        x, y = corner.astype(int)  # after the post the card shows something else
        if path[t, :, 0].min() > 94:
            swapped[t, y : y + SIDE, x : x + SIDE] = swapped[t, y : y + SIDE, x : x + SIDE][::-1, ::-1]
    assert tracks.continue_lost(points, visible, pictures, 12)[2] > 5
    assert tracks.continue_lost(points, visible, swapped, 12)[2] <= 1


def test_moving_square_is_found_under_a_pan(moving):
    _, mask, priors = moving
    assert iou(priors.mask, mask) > 0.7
    assert priors.mask[mask].mean() > 0.9
    assert not priors.statistics["motion"]["static_camera"]
    assert priors.statistics["motion"]["homography_residual"] < 0.5
    dynamic = priors.tracks_motion > 0.5
    inside = [
        mask[t][tuple(np.floor(p[::-1]).astype(int).clip(0, (HEIGHT - 1, WIDTH - 1)))]
        for t, p in samples(priors, dynamic)
    ]
    assert np.mean(inside) > 0.8
    assert dynamic.sum() > 60


@pytest.mark.parametrize("look", ["textured", "plain"])
def test_a_small_ball_that_flies_against_a_pan_is_found(look):
    clip, mask = fast_ball_clip(look)
    priors = run(clip)
    for flows, ball, speed in ((priors.flow_forward, mask[:-1], 14.0), (priors.flow_backward, mask[1:], -14.0)):
        error = np.linalg.norm(flows - np.array([speed, 0.0]), axis=-1)
        assert np.median(error[ball]) < 1.5
    assert iou(priors.mask, mask) > 0.7
    assert (priors.tracks_motion > 0.5).sum() > 20


def test_the_same_pan_without_the_ball_holds_nothing_that_moves():
    clip, _ = fast_ball_clip(None)
    noise = np.random.default_rng(0).normal(0, 2, clip.frames.shape)
    clip.frames[:] = np.clip(clip.frames + noise, 0, 255).astype(np.uint8)
    priors = run(clip)
    assert not priors.mask.any()
    inside = np.s_[:, 8:-8, 8:-8]
    assert np.abs(priors.flow_forward[inside] - np.array([-3.0, 0.0])).max() < 1.0


def samples(priors, chosen):
    for track in np.nonzero(chosen)[0]:
        for t in np.nonzero(priors.tracks_visible[:, track])[0]:
            yield t, priors.tracks[t, track]


@pytest.mark.parametrize("pan", [(0.0, 0.0), (1.5, 0.4)])
def test_nothing_moving_gives_an_empty_mask_and_says_so(pan):
    clip, _ = warped_clip(pan=pan, speed=None)
    noise = np.random.default_rng(0).normal(0, 2, clip.frames.shape)
    clip.frames[:] = np.clip(clip.frames + noise, 0, 255).astype(np.uint8)
    priors = run(clip)
    assert not priors.mask.any()
    assert priors.tracks_motion.max() < 0.5
    assert priors.statistics["motion"]["static_camera"] == (pan == (0.0, 0.0))
    assert any("Nothing in this clip moves" in line for line in priors.warnings)


def test_static_camera_uses_the_flow_itself():
    clip, mask = warped_clip(pan=(0.0, 0.0), speed=SPEED)
    priors = run(clip)
    assert priors.statistics["motion"]["static_camera"]
    assert iou(priors.mask, mask) > 0.7


def test_given_mask_decides():
    clip, mask = warped_clip()
    given = np.zeros_like(mask)
    given[:, 80:110, 10:60] = True
    priors = run(clip, mask=given.copy())
    np.testing.assert_array_equal(priors.mask, given)
    dynamic = priors.tracks_motion > 0.5
    assert dynamic.any()
    assert np.mean([p[1] > 78 and p[0] < 62 for _, p in samples(priors, dynamic)]) > 0.9


def test_settings_that_cannot_work_are_named():
    clip, _ = warped_clip(frames=3)
    with pytest.raises(F4xError, match="'best'"):
        run(clip, PriorsConfig(flow=FlowConfig(preset="best")))
    with pytest.raises(F4xError, match="power of two"):
        run(clip, PriorsConfig(tracks=TracksConfig(gaps=(1, 3))))


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_very_short_clips_survive(frames):
    priors = run(warped_clip(frames=frames)[0])
    assert priors.tracks.shape[0] == frames
    assert priors.mask.shape == (frames, HEIGHT, WIDTH)


def test_threshold_of_the_user_wins(moving):
    clip, _, _ = moving
    config = PriorsConfig(tracks=CONFIG.tracks, motion=MotionConfig(threshold=0.99))
    assert run(clip, config).statistics["motion"]["threshold"] == 0.99


def dragged(plain):
    """A clip of a pan with its flows, whose flow below the square wrongly goes with it, and where that is `(T,H,W)`; the wall is
    `plain` down there, or has its texture."""
    clip, mask = warped_clip(pan=PAN, speed=SPEED)
    pictures, frames, lowest = clip.frames.copy(), len(clip.frames), 86
    beside = np.zeros_like(mask)
    for t in range(frames):
        x = round(square_corner(t, SPEED)[0])
        beside[t, lowest : lowest + 20, x : x + SIDE] = True
    if plain:
        pictures[:, lowest - 2 :] = 127
    flows = {}
    for gap in (1, 2, 4, 8):
        for signed in (gap, -gap):
            flows[signed] = np.where((mask | beside)[..., None], np.array(SPEED), -np.array(PAN)) * float(signed)
            flows[signed] = flows[signed].astype(np.float16)
    return pictures, flows, mask, beside


@pytest.mark.parametrize("plain", [True, False])
def test_flow_alone_is_no_evidence_of_motion(plain):
    pictures, flows, mask, beside = dragged(plain)
    score, _ = motion.motion_score(pictures, flows, (1, 2, 4, 8), silent)
    inner = np.stack(
        [scipy.ndimage.binary_erosion(one, iterations=5) for one in beside]
    )  # the window reaches over the edge
    assert score[mask].mean() > 0.6
    assert score[inner].mean() < 0.15


def test_a_dark_clip_shows_the_same_motion():
    clip, mask = warped_clip()
    clip.frames[:] = clip.frames // 6
    assert iou(run(clip).mask, mask) > 0.7


def test_evidence_is_the_mean_of_the_gaps_that_speak_most_for_motion():
    rng = np.random.default_rng(0)
    missed = rng.uniform(-5, 25, (2, 5, 6, 7)).astype(np.float32)
    missed[rng.uniform(size=missed.shape) < 0.2] = np.nan
    missed[1, 2:] = np.nan  # the last frame of a clip has few gaps
    found = motion._evidence(missed.copy(), 10.0)
    padded = np.pad(missed, ((0, 0), (0, 0), (1, 1), (1, 1)), mode="symmetric")
    for t, row, column in ((0, 2, 3), (0, 0, 0), (1, 5, 6)):
        gaps = []
        for k in range(5):
            if np.isfinite(missed[t, k, row, column]):
                gaps.append(min(max(np.nanmean(padded[t, k, row : row + 3, column : column + 3]) / 10, 0), 1))
        surest = sorted(gaps)[-3:]
        expected = np.sum(surest) / max(len(surest), 1)
        assert found[t, row, column] == pytest.approx(expected, abs=1e-5)


def test_thinned_tracks_keep_the_longest_of_every_place_in_every_frame():
    rng = np.random.default_rng(0)
    frames, long, short = 24, 300, 200
    places = np.concatenate([rng.uniform([0, 0], [60, 120], (long, 2)), rng.uniform([100, 40], [130, 70], (short, 2))])
    points = np.tile(places, (frames, 1, 1)).astype(np.float32)
    visible = np.zeros((frames, long + short), bool)
    visible[:, :long] = True  # stands still on the left
    for i in range(short):  # turns on the right: five frames each
        first = rng.integers(0, frames - 4)
        visible[first : first + 5, long + i] = True
    kept, seen = tracks.thinned(points, visible, 120)
    assert kept.shape[1] == 120
    right = kept[0, :, 0] > 90
    assert seen[:, right].sum(1).min() >= 3  # by length alone there would be none
    assert right.sum() < 90
    same, _ = tracks.thinned(points, visible, 1000)
    np.testing.assert_array_equal(same, points)  # nothing goes where there is room
    visible[:, 0] = False
    visible[:3, 0] = True  # too few samples
    assert tracks.thinned(points, visible, 1000)[0].shape[1] == long + short - 1


def test_thinned_tracks_are_those_of_least_rank():
    """Against the plain form: rank every track among those of its square in every frame, by length; the best rank counts for half
    of them, length for the others."""
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 100, (6, 60, 2)).astype(np.float32)
    visible = rng.uniform(size=(6, 60)) < 0.8
    length = visible.sum(0)
    best, golden = {}, (5**0.5 - 1) / 2
    tie = {int(track): i * golden % 1 for i, track in enumerate(np.flatnonzero(length >= tracks.MIN_SAMPLES))}
    for track in tie:
        ranks = []
        for frame in np.flatnonzero(visible[:, track]):
            square = points[frame, track] // tracks.PLACE
            others = [
                other
                for other in np.flatnonzero(visible[frame] & (length >= tracks.MIN_SAMPLES))
                if (points[frame, other] // tracks.PLACE == square).all()
            ]
            ranks.append(sorted(others, key=lambda other: (-length[other], tie[other])).index(track))
        best[track] = min(ranks)
    expected = sorted(best, key=lambda track: (best[track], -length[track], tie[track]))[:10]
    expected += sorted(set(best) - set(expected), key=lambda track: (-length[track], tie[track]))[:10]
    expected.sort()
    kept, _ = tracks.thinned(points, visible, 20)
    np.testing.assert_array_equal(kept, points[:, expected])
