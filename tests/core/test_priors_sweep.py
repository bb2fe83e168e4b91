"""The plane sweep: silhouettes that flow smears, a sweep that is not to be believed."""

import cv2
import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig
from f4x_core.priors.depth import provide
from f4x_core.priors.surfaces import join
from f4x_core.priors.sweep import Samples, Swept, confirmed
from f4x_core.progress import silent

WIDTH, HEIGHT, FRAMES, FOCAL, STEP = 128, 96, 8, 100.0, 0.06
NEAR, FAR = 1.0, 0.4
"""Inverse depth of a box and of the wall behind it."""
BOX = np.s_[30:70, 50:80]
"""Pixels of the box in the middle frame."""


def path():
    matrices = np.tile(np.eye(4), (FRAMES, 1, 1))
    matrices[:, 0, 3] = -STEP * (np.arange(FRAMES) - FRAMES // 2)
    lens = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return CameraPath(np.tile(lens, (FRAMES, 1, 1)), matrices, np.arange(float(FRAMES)), WIDTH, HEIGHT)


def box_before_a_wall():
    """Clip, and priors whose flow is smeared over the box's edges as that of patches is."""
    rng = np.random.default_rng(4)
    wall, box = (
        cv2.GaussianBlur(rng.uniform(0, 255, (HEIGHT, 3 * WIDTH)).astype(np.float32), (0, 0), 1.2) for _ in range(2)
    )
    wall, box = ((127 + 3 * (one - one.mean())).clip(0, 255) for one in (wall, box))
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    inside = np.zeros((HEIGHT, WIDTH), np.float32)
    inside[BOX] = 1
    pictures, inverse = [], []
    for frame in range(FRAMES):
        moved = FOCAL * STEP * (frame - FRAMES // 2)
        covered = cv2.remap(inside, x + moved * NEAR, y, cv2.INTER_NEAREST)
        layers = [
            cv2.remap(one, x + WIDTH + moved * rho, y, cv2.INTER_LINEAR) for one, rho in ((wall, FAR), (box, NEAR))
        ]
        pictures.append(np.where(covered > 0, layers[1], layers[0]))
        inverse.append(np.where(covered > 0, NEAR, FAR))
    pictures = np.repeat(np.stack(pictures)[..., None], 3, 3).astype(np.uint8)
    clip = Clip("box", pictures, np.arange(float(FRAMES)), 24.0, np.zeros(FRAMES, bool), "box")
    priors = Priors.empty(clip)
    priors.cameras, priors.camera_kind = path(), "moving"
    priors.provenance["cameras"] = {"provider": "user"}
    priors.mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    smeared = np.stack([cv2.blur(cv2.dilate(one, np.ones((7, 7))), (5, 5)) for one in np.stack(inverse)])
    flows = {}
    for gap in (1, 2, 4):
        for signed in (gap, -gap):
            flows[signed] = np.zeros((FRAMES, HEIGHT, WIDTH, 2), np.float16)
            flows[signed][..., 0] = -FOCAL * STEP * signed * smeared
    priors.scratch.long_flows = flows
    return clip, priors, np.stack(inverse)


def test_the_wall_beside_a_box_is_not_drawn_to_it():
    clip, priors, inverse = box_before_a_wall()
    provide(clip, priors, PriorsConfig(), silent)
    frame = FRAMES // 2
    box = inverse[frame] == NEAR
    around = cv2.dilate(box.astype(np.uint8), np.ones((9, 9))) > 0
    beside = around & ~(cv2.dilate(box.astype(np.uint8), np.ones((3, 3))) > 0)
    found = 1 / priors.depth[frame]
    assert np.median(abs(found[beside] / FAR - 1)) < 0.1
    assert (abs(found[beside] / FAR - 1) < 0.2).mean() > 0.8
    assert np.median(abs(found[box] / NEAR - 1)) < 0.05


def samples(inverse):
    ones = np.ones_like(inverse)
    return Samples(inverse, 1e4 * ones, ones)


def swept(inverse, better):
    ones = np.ones_like(inverse)
    return Swept(inverse, 0.01, 100 * ones, better * ones, ones > 0)


@pytest.mark.parametrize(("better", "taken"), [(10.0, True), (0.5, False)])
def test_a_sweep_that_contradicts_flow_counts_where_it_explains_the_pictures_better(better, taken):
    flow, sweep = np.full((20, 30), 0.5), np.full((20, 30), 0.5)
    sweep[5:9, 5:9] = 1.0
    joined = join(samples(flow), swept(sweep, better), np.ones(flow.shape, bool))
    np.testing.assert_allclose(joined.inverse[5:9, 5:9], 1.0 if taken else 0.5, rtol=0.03)
    np.testing.assert_allclose(joined.inverse[12:], 0.5)
    hidden = join(samples(flow), swept(sweep, better), np.zeros(flow.shape, bool))
    np.testing.assert_array_equal(hidden.inverse, flow)


def test_a_sweep_that_is_off_on_most_of_a_frame_is_not_believed():
    flow = np.full((20, 30), 0.5)
    joined = join(samples(flow), swept(1.15 * flow, 10.0), np.ones(flow.shape, bool))
    np.testing.assert_allclose(joined.inverse, flow, rtol=1e-3)
    assert joined.trust.max() < 0.01


def test_depth_that_another_frame_does_not_have_is_not_confirmed():
    cameras, maps = path(), np.full((FRAMES, HEIGHT // 2, WIDTH // 2), FAR, np.float32)
    maps[4, 10:20, 20:30] = NEAR
    known = confirmed(cameras, maps, [0.01] * FRAMES, 4, 2)
    assert not known[10:20, 20:30].any()
    assert known[25:, 10:-10].all()
    assert not confirmed(cameras, maps[:1], [0.01], 0, 2).any()
