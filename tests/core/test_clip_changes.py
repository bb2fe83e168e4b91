"""Cuts and exposure: found where they are, and nowhere else."""

import cv2
import numpy as np
import pytest
from warped_clip import texture, warped_clip

from f4x_core.clip.changes import find_changes


def shot(seed: int, frames: int = 6, speed: int = 2) -> np.ndarray:
    """(frames,90,160,3) uint8: a window that slides over a picture of its own."""
    picture = texture(100, 260, seed)
    return np.stack([picture[5:95, speed * t : speed * t + 160] for t in range(frames)])


@pytest.mark.parametrize("lengths", [(6, 5), (1, 6), (6, 1), (4, 3, 5)])
def test_cuts_are_found(lengths):
    clip = np.concatenate([shot(seed, length) for seed, length in enumerate(lengths)])
    assert find_changes(clip).cuts.tolist() == list(np.cumsum(lengths)[:-1])


@pytest.mark.parametrize("speed", [0, 2, 12])
def test_motion_is_no_cut(speed):
    changes = find_changes(shot(0, 9, speed))
    assert len(changes.cuts) == 0 and changes.exposure < 1.03


def test_a_moving_object_is_no_cut():
    clip, _ = warped_clip()
    assert len(find_changes(clip.frames).cuts) == 0


def jerky_shot(seed: int, picture_seed: int, frames: int = 16) -> np.ndarray:
    """(frames,90,160,3) uint8: a window that jumps, rolls and zooms over a picture in every second frame, smeared as it goes."""
    random, picture = np.random.default_rng(seed), texture(300, 480, picture_seed)
    center, roll, zoom, clip = np.array([240.0, 150.0]), 0.0, 1.0, []
    for t in range(frames):
        jump = random.normal(0, (30, 18)) * (t % 2)
        center = np.clip(center + jump, (160, 100), (320, 200))
        roll, zoom = np.clip(
            [roll + random.normal(0, 8) * (t % 2), zoom + random.normal(0, 0.1) * (t % 2)], (-20, 0.8), (20, 1.3)
        )
        move = cv2.getRotationMatrix2D(tuple(center), roll, zoom)
        move[:, 2] += (80, 45) - center
        path = max(1, int(np.abs(jump).max() / 4))  # a quarter of the way while the shutter is open
        clip.append(cv2.blur(cv2.warpAffine(picture, move, (160, 90)), (path, 1)))
    return np.stack(clip)


@pytest.mark.parametrize("seed", range(4))
def test_jerks_within_a_shot_are_no_cut_and_a_cut_among_jerks_is_one(seed):
    one, other = jerky_shot(seed, 0), jerky_shot(seed + 10, 1)
    assert len(find_changes(one).cuts) == 0
    assert find_changes(np.concatenate([one, other])).cuts.tolist() == [16]


def test_a_logo_in_two_shots_does_not_hide_the_cut():
    clip = np.concatenate([shot(0), shot(1)])
    clip[:, 4:24, 4:24] = texture(20, 20, 9)
    assert find_changes(clip).cuts.tolist() == [6]


def test_one_spoilt_frame_a_flash_and_flat_pictures_are_no_cut():
    clip = shot(0, 8)
    clip[3] = 0
    clip[6] = np.minimum(clip[6].astype(int) * 2, 255)
    assert len(find_changes(clip).cuts) == 0
    assert len(find_changes(np.full((5, 40, 64, 3), 90, np.uint8)).cuts) == 0


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_short_clips(frames):
    changes = find_changes(shot(0, frames))
    assert len(changes.cuts) == 0 and changes.gain.shape == (frames,) and changes.exposure >= 1


@pytest.mark.parametrize("size", [(16, 16), (17, 23), (1, 40)])
def test_small_and_odd_pictures(size):
    assert len(find_changes(np.full((3, *size, 3), 7, np.uint8)).cuts) == 0


def test_exposure_is_measured_on_the_same_things_and_within_a_shot():
    gain = np.linspace(1, 0.5, 6)
    dimmed = (shot(0) * gain[:, None, None, None]).astype(np.uint8)
    np.testing.assert_allclose(find_changes(dimmed).gain, gain, rtol=0.06)
    two = find_changes(np.concatenate([shot(0), shot(1) // 3]))
    assert two.cuts.tolist() == [6] and two.exposure < 1.06 and two.gain[6] == 1
