"""Sightings of tracks matched anew: slips are taken back, what cannot be matched stays where it was and counts little."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from f4x_core.priors.bundle import Observations
from f4x_core.priors.rematch import FARTHEST_PX, UNMATCHED_WEIGHT, match_anew

FRAMES, HEIGHT, WIDTH = 9, 90, 130
STEP = np.array([1.3, -0.4])
"""Pixels by which the picture shifts from frame to frame."""


def pictures_and_sightings(seed=0):
    """(F, H, W) uint8 of a texture that shifts, and where 40 of its points are."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (HEIGHT, WIDTH)).astype(np.float32), (0, 0), 1.5)
    texture = np.clip(128 + 4 * (texture - texture.mean()), 0, 255)
    shifted = [
        cv2.warpAffine(
            texture,
            np.array([[1, 0, x], [0, 1, y]]),
            (WIDTH, HEIGHT),
            flags=cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REFLECT,
        )
        for x, y in STEP * (np.arange(FRAMES)[:, None] - FRAMES // 2)
    ]
    start = rng.uniform((25, 25), (WIDTH - 25, HEIGHT - 25), (40, 2))
    frame, point = (grid.ravel() for grid in np.meshgrid(np.arange(FRAMES), np.arange(40), indexing="ij"))
    uv = start[point] + STEP * (frame[:, None] - FRAMES // 2)
    return np.stack(shifted).astype(np.uint8), Observations(frame, point, uv, np.full(len(frame), 0.2))


def slipped(seen, pixels):
    """The sightings, moved by so many pixels from the first frame to the last."""
    return replace(seen, uv=seen.uv + pixels * (seen.frame / (FRAMES - 1) - 0.5)[:, None] * np.array([0.6, 0.8]))


def test_a_slip_is_taken_back():
    pictures, true = pictures_and_sightings()
    found = match_anew(pictures, slipped(true, 1.5))
    matched = found.weight == 1
    assert matched.mean() > 0.6

    def slip(seen):
        """(2, F) mean offset of the matched points in every frame, from that of all frames."""
        offset = (seen.uv - true.uv)[matched].T
        count = np.bincount(true.frame[matched])
        frames = np.stack([np.bincount(true.frame[matched], axis) / count for axis in offset])
        return frames - frames.mean(1, keepdims=True)

    assert abs(slip(slipped(true, 1.5))).max() > 0.5
    assert abs(slip(found)).max() < 0.1


@pytest.mark.parametrize("lost", ["plain", "far", "changed"])
def test_what_cannot_be_matched_stays_and_counts_little(lost):
    pictures, seen = pictures_and_sightings()
    patch = FRAMES // 2 // 4 * 4
    other = seen.frame != patch
    if lost == "plain":
        pictures[...] = 90
    elif lost == "far":
        seen = replace(seen, uv=seen.uv + (3 * FARTHEST_PX * other)[:, None])
    else:
        pictures[np.arange(FRAMES) != patch] = pictures_and_sightings(1)[0][0]
    found = match_anew(pictures, seen)
    assert (found.weight[other] == UNMATCHED_WEIGHT).mean() > 0.9
    still = found.weight == UNMATCHED_WEIGHT
    np.testing.assert_array_equal(found.uv[still], seen.uv[still])


def test_points_seen_in_other_frames_alone_have_a_patch_of_their_own():
    pictures, true = pictures_and_sightings()
    seen = slipped(true, 1.0)
    late = seen.keep(np.flatnonzero((seen.frame > 4) | (seen.point % 2 == 0))[::-1])
    found = match_anew(pictures, late)
    assert (found.weight == 1).mean() > 0.6
    assert set(found.frame[found.uv[:, 0] == late.uv[:, 0]]) >= {4, 8}


def test_nothing_seen_is_nothing_matched():
    nothing = Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    assert not len(match_anew(np.zeros((2, 8, 8), np.uint8), nothing).frame)
