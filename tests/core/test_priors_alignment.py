"""Alignment of tracks with the pictures of their anchors: drift goes, what looks different stays where the chain put it."""

import numpy as np
import pytest

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
