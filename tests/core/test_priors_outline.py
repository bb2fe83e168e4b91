"""Outlines of what moves against a background that other frames show: shadows, halos, thin legs, what cannot be told."""

import numpy as np

from f4x_core.geometry.camera import CameraPath
from f4x_core.priors.outline import refine_mask

FRAMES, HEIGHT, WIDTH, FOCAL = 14, 80, 120, 90.0
BODY, LEG, SHADOW = np.s_[20:48, 0:24], np.s_[48:66, 8:15], np.s_[48:66, 15:40]
"""Rows and columns of a mover, of what its mask lacks, and of its shadow, from its left side on."""


def walk(seed=0, step=4):
    """A mover with a leg and a shadow before a wall that a camera passes: frames, inverse depth, mask, cameras, truth.

    step: pixels a frame by which it moves.
    """
    rng = np.random.default_rng(seed)
    wall = np.kron(rng.integers(60, 200, (27, 70, 3)), np.ones((3, 3, 1))).astype(np.uint8)
    lens = np.tile(np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]), (FRAMES, 1, 1))
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 0, 3] = -np.arange(FRAMES) * 2 / FOCAL  # two pixels a frame at depth 1
    frames = np.stack([wall[:HEIGHT, 2 * t : 2 * t + WIDTH] for t in range(FRAMES)])
    mask, true = np.zeros((2, FRAMES, HEIGHT, WIDTH), bool)
    for t in range(FRAMES):
        left = 4 + step * t
        body, leg, shadow = ((rows, slice(c.start + left, c.stop + left)) for rows, c in (BODY, LEG, SHADOW))
        frames[t][shadow] = 0.6 * frames[t][shadow]
        frames[t][body] = frames[t][leg] = (230, 30, 40)
        true[t][body] = true[t][leg] = True
        mask[t][body] = mask[t][shadow] = True
    cameras = CameraPath(lens, poses, np.arange(float(FRAMES)), WIDTH, HEIGHT)
    return frames, np.ones(mask.shape, np.float32), mask, cameras, true


def overlap(one, other):
    return (one & other).sum() / (one | other).sum()


def test_shadows_leave_the_mask_and_legs_join_it():
    frames, inverse, mask, cameras, true = walk()
    found = refine_mask(frames, inverse, mask, None, cameras)
    assert overlap(mask, true) < 0.6 and overlap(found, true) > 0.9


def test_what_nobody_sees_behind_keeps_its_mask():
    """A mover that stays where it is hides its background in all frames, and two frames are too near to each other."""
    frames, inverse, mask, cameras, _ = walk()
    two = CameraPath(cameras.intrinsics[:2], cameras.world_to_camera[:2], cameras.times[:2], WIDTH, HEIGHT)
    np.testing.assert_array_equal(refine_mask(frames[:2], inverse[:2], mask[:2], None, two), mask[:2])
    stays = np.zeros_like(mask)
    stays[:, 20:60, 40:80] = True
    still = CameraPath(cameras.intrinsics, np.tile(np.eye(4), (FRAMES, 1, 1)), cameras.times, WIDTH, HEIGHT)
    np.testing.assert_array_equal(refine_mask(frames[:1].repeat(FRAMES, 0), inverse, stays, None, still), stays)


def test_a_plain_back_that_the_mask_lacks_is_no_background():
    """In other frames the dent in the mask shows the mover, which would look like what stands."""
    frames, inverse, mask, cameras, true = walk(step=2)
    for t in range(FRAMES):
        mask[t, 20:40, 4 + 2 * t : 20 + 2 * t] = False
    assert overlap(refine_mask(frames, inverse, mask, None, cameras), true) > 0.85


def test_the_half_of_a_ball_that_the_mask_lacks_joins_it_and_its_shadow_does_not():
    """It has the wall's colors, so hardly a pixel of it differs from all that is near."""
    frames, inverse, mask, cameras, true = walk()
    rng = np.random.default_rng(5)
    body = np.kron(rng.integers(60, 200, (4, 3, 3)), np.ones((7, 8, 1)))
    for t in range(FRAMES):
        left = 4 + 4 * t
        frames[t][20:48, left : left + 24] = body
        mask[t] = False
        mask[t, 20:48, left + 12 : left + 24] = True
    found = refine_mask(frames, inverse, mask, None, cameras)
    assert overlap(mask, true) < 0.5 and overlap(found, true) > 0.8
