"""Alignment of tracks with the pictures of their anchors: drift goes, what looks different stays where the chain put it."""

import numpy as np
import pytest

from f4x_core.priors import alignment as module
from f4x_core.priors.alignment import MAX_CORRECTION_PX, align_tracks

cv2 = pytest.importorskip("cv2")
FRAMES, HEIGHT, WIDTH = 20, 96, 128


def texture(seed=0):
    noise = np.random.default_rng(seed).uniform(0, 255, (HEIGHT + 64, WIDTH + 64)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 1.5) * 3 - 255


def film(speed=(0.7, -0.4)):
    """Pictures (F, H, W) of a texture that slides, and true tracks (F, N, 2)."""
    wide, pictures = texture(), []
    for t in range(FRAMES):
        shift = np.float32([[1, 0, t * speed[0] - 24], [0, 1, t * speed[1] - 24]])
        pictures.append(
            cv2.warpAffine(wide, shift, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8)
        )
    grid = np.stack(np.meshgrid(np.arange(24.5, WIDTH - 24, 8), np.arange(24.5, HEIGHT - 24, 8)), -1).reshape(-1, 2)
    return np.stack(pictures), (grid[None] + np.arange(FRAMES)[:, None, None] * np.array(speed)).astype(np.float32)


def test_drift_is_taken_out():
    pictures, true = film()
    lag = np.linspace(0, 0.4, FRAMES, dtype=np.float32)[:, None, None] * np.array([-1, 1], np.float32)
    drifted = true + lag - lag[8]  # the anchor is where it should be
    aligned = align_tracks(drifted, np.ones(true.shape[:2], bool), pictures)
    before, after = (np.linalg.norm(tracks - true, axis=-1) for tracks in (drifted, aligned))
    assert np.median(before[-1]) > 0.3
    assert np.percentile(after[-1], 90) < 0.12, "warped pictures are exact to 0.03 px, and two anchors are chained"


def test_what_is_hidden_or_looks_different_stays():
    pictures, true = film()
    pictures[12:] = 255 - pictures[12:]
    visible = np.ones(true.shape[:2], bool)
    visible[3] = False
    aligned = align_tracks(true, visible, pictures)
    np.testing.assert_array_equal(aligned[3], true[3])
    np.testing.assert_array_equal(aligned[12:16], true[12:16])
    assert np.linalg.norm(aligned - true, axis=-1).max() < MAX_CORRECTION_PX


@pytest.mark.parametrize("frames", [1, 2, 17])
def test_clips_of_any_length_and_pictures_without_texture(frames):
    _, true = film()
    plain = np.full((frames, HEIGHT, WIDTH), 90, np.uint8)
    np.testing.assert_array_equal(
        align_tracks(true[:frames], np.ones((frames, true.shape[1]), bool), plain), true[:frames]
    )


@pytest.mark.parametrize(("frames", "expected"), [
    (3, {2: [1, 0]}),
    (8, {7: [6, 5, 4, 3, 2, 1, 0]}),
    (24, {8: [*range(7, -1, -1), *range(9, 24)]}),
    (26, {8: [*range(7, -1, -1), *range(9, 16), 24], 24: [*range(23, 15, -1), 25]}),
    (42, {8: [*range(7, -1, -1), *range(9, 16), 24], 24: [*range(23, 15, -1), *range(25, 32), 40], 40: [*range(39, 31, -1), 41]}),
])  # fmt: skip
def test_anchors_lie_in_the_middle_of_sixteen_frames(monkeypatch, frames, expected):
    """Every frame is aligned with the anchor of its stretch, and an anchor with the one before it first."""
    asked = {}

    def aligned(there, here, before, guess, gap):
        asked.setdefault(int(there[0, 0]), []).append(int(here[0, 0]))
        assert gap == abs(int(there[0, 0]) - int(here[0, 0]))
        np.testing.assert_array_equal(before, np.full_like(before, 100 if there[0, 0] in moved else 0))
        moved.add(int(here[0, 0]))
        return guess + 100

    moved = set()
    monkeypatch.setattr(module, "_aligned", aligned)
    pictures = np.arange(frames, dtype=np.uint8)[:, None, None] * np.ones((1, 4, 4), np.uint8)
    visible = np.ones((frames, 3), bool)
    visible[:, 2] = False
    found = align_tracks(np.zeros((frames, 3, 2), np.float32), visible, pictures)
    assert asked == expected
    times = [sum(order.count(t) for order in expected.values()) for t in range(frames)]
    np.testing.assert_array_equal(found[:, 0, 0], 100.0 * np.array(times))
    assert not found[:, 2].any()


def test_corrections_are_believed_within_their_limits(monkeypatch):
    """OpenCV's answer counts pixel centres from 0; it is kept where it succeeded, looks alike and is near."""
    guess = np.arange(12.0).reshape(6, 2)
    shift = np.array([[0.4, 0.5], [0.5, 0.53], [0.1, 0], [0.1, 0], [0.1, 0], [0.0, 0.69]])
    asked = {}

    def lucas_kanade(there, here, points, near, **settings):
        asked.update(settings, points=points, near=near.copy())
        status = np.array([1, 1, 0, 1, 1, 1])[:, None]
        difference = np.array([1.0, 1, 1, 12, 11.9, 1])[:, None]
        return near + shift[:, None].astype(np.float32), status, difference

    monkeypatch.setattr(cv2, "calcOpticalFlowPyrLK", lucas_kanade)
    found = module._aligned(None, None, guess + 3, guess, 2)  # 0.5 and twice 0.1 pixels
    believed = np.array([True, False, False, False, True, True])
    np.testing.assert_allclose(found, np.where(believed[:, None], guess + shift, guess), atol=1e-5)
    np.testing.assert_allclose(asked["points"][:, 0], guess + 2.5)
    np.testing.assert_allclose(asked["near"][:, 0], guess - 0.5)
    assert asked["winSize"] == (11, 11) and asked["maxLevel"] == 0 and asked["minEigThreshold"] == 2e-4
    assert asked["criteria"] == (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.005)
    assert asked["flags"] == cv2.OPTFLOW_USE_INITIAL_FLOW
