"""Cameras adjusted on points that flow follows through a few frames."""

import numpy as np
import pytest

from f4x_core.geometry import quaternion
from f4x_core.priors.bundle import MIN_SEEN, Bundle, BundleConfig, Observations
from f4x_core.priors.flow import pixel_grid
from f4x_core.priors.sfm import Solution
from f4x_core.priors.short_tracks import CELLS, GAPS, Neighbourhood, sharpened

WIDTH, HEIGHT, FRAMES, FOCAL = 96, 64, 12, 80.0
NEAR, FAR = 2.0, 12.0
"""Depths of a wall on the left half of the first picture and of the one behind it."""


@pytest.fixture(scope="module")
def true() -> Bundle:
    """Cameras that walk sideways and ahead while they turn by three degrees."""
    at = np.linspace(0, 1, FRAMES)[:, None]
    rotation = quaternion.to_matrix(quaternion.from_rotation_vector(at * [0.0, 0.05, 0.01]))
    return Bundle(FOCAL, np.array([WIDTH, HEIGHT]) / 2, rotation, at * [0.5, 0.05, 0.3], np.zeros((0, 3)))


def surface(bundle: Bundle, frame: int) -> np.ndarray:
    """(H,W,3) points that the pixels of a frame see: the near wall left of x = -.1, else the far one."""
    plane = (pixel_grid(HEIGHT, WIDTH).astype(float) - bundle.principal) / bundle.focal
    rays = np.concatenate([plane, np.ones((HEIGHT, WIDTH, 1))], -1) @ bundle.rotation[frame]
    center = bundle.center[frame]
    near, far = (center + rays * ((depth - center[2]) / rays[..., 2:]) for depth in (NEAR, FAR))
    return np.where(near[..., :1] < -0.1, near, far)


def seen_from(bundle: Bundle, points: np.ndarray, frame: int) -> np.ndarray:
    """(...,2) pixels of world points (...,3)."""
    local = (points - bundle.center[frame]) @ bundle.rotation[frame].T
    return bundle.focal * local[..., :2] / local[..., 2:] + bundle.principal


@pytest.fixture(scope="module")
def around(true) -> Neighbourhood:
    """Pictures of noise with true flow, and a corner in which something moves."""
    flows = {gap: np.zeros((FRAMES, HEIGHT, WIDTH, 2), np.float32) for gap in GAPS}
    for gap, flow in flows.items():
        for frame in range(max(0, -gap), min(FRAMES, FRAMES - gap)):
            flow[frame] = seen_from(true, surface(true, frame), frame + gap) - pixel_grid(HEIGHT, WIDTH)
    blocked = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    blocked[:, :16, 80:] = True
    pictures = np.random.default_rng(0).integers(0, 255, (FRAMES, HEIGHT, WIDTH), np.uint8)
    return Neighbourhood(pictures, flows, blocked)


def test_every_cell_gives_a_point_where_nothing_moves(around, true):
    seen = around.sightings()
    per_frame = np.bincount(seen.frame, minlength=FRAMES)
    assert per_frame.min() > 3 * CELLS
    assert np.bincount(seen.point).min() >= MIN_SEEN
    x, y = seen.uv.T
    assert not ((x > 80) & (y < 16)).any(), "what moves gives none"
    assert (x < WIDTH / 3).mean() > 0.2 and (y > HEIGHT / 2).mean() > 0.4, (
        "the near wall and the lower half have their say"
    )


def test_pictures_without_texture_give_none(around):
    plain = Neighbourhood(np.full_like(around.pictures, 90), around.flows, around.blocked)
    assert not len(plain.sightings().frame)


def test_flow_that_does_not_return_gives_none(around):
    lost = {gap: flow + (2.0 if gap > 0 else 0.0) for gap, flow in around.flows.items()}
    seen = Neighbourhood(around.pictures, lost, around.blocked).sightings()
    assert not len(seen.frame)


def test_they_find_the_direction_that_drifting_long_tracks_miss(around, true):
    """Long tracks of the near wall drift, so cameras adjusted on them alone err; short ones correct the path."""
    rng = np.random.default_rng(1)
    start = surface(true, 0)[rng.integers(0, HEIGHT, 120), rng.integers(0, WIDTH, 120)]
    uv = np.stack([seen_from(true, start, frame) for frame in range(FRAMES)]) + rng.normal(0, 0.1, (FRAMES, 120, 2))
    drift = np.arange(FRAMES)[:, None, None] * [0.15, 0.25]
    uv += np.where((start[:, 2] < FAR - 1)[None, :, None], drift, 0)
    frame, point = (index.ravel() for index in np.indices((FRAMES, 120)))
    long = Observations(frame, point, uv.reshape(-1, 2), np.ones(len(frame)))
    lens = BundleConfig(refine_focal=False)
    nothing = Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    first = Solution(true, long, np.ones(FRAMES, bool))
    alone = sharpened(first, nothing, lens)
    both = sharpened(Solution(alone.bundle, long, first.registered), around.sightings(), lens)

    def error(found: Bundle) -> float:
        """Degrees between the found and the true direction of the path, in the axes of the first camera."""
        ways = [one.rotation[0] @ (one.center[-1] - one.center[0]) for one in (found, true)]
        ways = [way / np.linalg.norm(way) for way in ways]
        return float(np.rad2deg(np.arccos(np.clip(ways[0] @ ways[1], -1, 1))))

    assert error(alone.bundle) > 3, "or there is nothing to correct"
    assert error(both.bundle) < 0.3 * error(alone.bundle)
