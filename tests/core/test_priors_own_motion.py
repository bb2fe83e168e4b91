"""Structure of movers from their own motion, and where they are put: made-up bodies seen by a camera that stands still."""

from dataclasses import replace

import numpy as np
import pytest

from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors
from f4x_core.priors.movers import one_scale, place_objects
from f4x_core.priors.own_motion import TracksOnObject, solve

FRAMES, WIDTH, HEIGHT, FOCAL = 12, 240, 136, 220.0
CENTRE = np.array([WIDTH, HEIGHT]) / 2


def ball(seed=0, count=160, degrees=60.0, noise=0.15, at=(0.0, 0.0, 8.0)):
    """Tracks `(F, n, 2)` of a ball of radius 1 that turns about a tilted axis, where they are visible, and their depth."""
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    axis = np.array([0.1, 0.97, 0.2])
    angles = np.radians(degrees) * np.linspace(-0.5, 0.5, FRAMES)
    turns = quaternion.to_matrix(quaternion.from_rotation_vector(angles[:, None] * axis / np.linalg.norm(axis)))
    path = np.array(at) + np.linspace(-1, 1, FRAMES)[:, None] * np.array([1.0, 0.0, 0.4])
    xyz = points @ turns.transpose(0, 2, 1) + path[:, None]
    visible = (xyz * (xyz - path[:, None])).sum(-1) < -0.25 * np.linalg.norm(xyz, axis=-1)  # turned to the camera
    tracks = CENTRE + FOCAL * xyz[..., :2] / xyz[..., 2:] + noise * random.normal(size=(FRAMES, count, 2))
    return tracks, visible, xyz[..., 2], path


def disc(path, radius=1.0):
    """(F, H, W) bool: the ball's outline."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    centre = CENTRE + FOCAL * path[:, :2] / path[:, 2:]
    reach = FOCAL * radius / path[:, 2]
    return np.stack([np.hypot(x - c[0], y - c[1]) < r for c, r in zip(centre, reach, strict=True)])


def on_object(tracks, visible, path):
    centre = CENTRE + FOCAL * path[:, :2] / path[:, 2:]
    outline = np.maximum((FOCAL / path[:, 2])[:, None] - np.linalg.norm(tracks - centre[:, None], axis=-1), 0.1)
    return TracksOnObject(
        tracks, visible, outline * visible, np.full(FRAMES, FOCAL), CENTRE, np.tile(np.eye(4), (FRAMES, 1, 1))
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_turning_ball_bulges_towards_the_camera(seed):
    tracks, visible, z, path = ball(seed)
    found = solve(on_object(tracks, visible, path))
    assert found is not None and found.degrees > 10 and found.error_px < 0.5
    seen = visible & found.inliers
    ratio = (found.z / z)[seen]
    assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.01  # of its distance; its own depth is an eighth of that
    shape = [np.corrcoef(found.z[f, seen[f]], z[f, seen[f]])[0, 1] for f in range(FRAMES)]
    assert np.median(shape) > 0.9
    drift = [np.median((found.z / z)[f, seen[f]]) for f in range(FRAMES)]
    assert np.std(np.log(drift)) < 0.02


def test_what_does_not_turn_or_bends_has_no_structure():
    tracks, visible, _, path = ball(degrees=0.0)
    still = np.tile(path[:1], (FRAMES, 1))
    assert solve(on_object(tracks - tracks.mean(1, keepdims=True) + tracks[0].mean(0), visible, still)) is None
    wobble = 9 * np.sin(np.arange(FRAMES)[:, None, None] + tracks[:1, :, ::-1] / 5)
    assert solve(on_object(tracks + wobble, visible, path)) is None
    assert solve(on_object(tracks[:, :10], visible[:, :10], path)) is None


def scene(noise=0.15):
    """Priors of the ball on a ground plane 1 below the camera's axis, seen by a camera that is known to move."""
    tracks, visible, z, path = ball(noise=noise, at=(0.0, 0.0, 8.0))
    mask = disc(path)
    rows = np.arange(HEIGHT) + 0.5
    ground = np.maximum((rows - CENTRE[1]) / FOCAL, 0.02)  # y = 1: z = f / (row - centre)
    inverse = np.tile(ground[:, None], (FRAMES, 1, WIDTH)).astype(np.float32)
    intrinsics = np.tile(np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1]]), (FRAMES, 1, 1))
    priors = Priors(WIDTH, HEIGHT, np.arange(10, 10 + FRAMES))
    times = np.arange(10.0, 10 + FRAMES)
    priors.cameras = CameraPath(intrinsics, np.tile(np.eye(4), (FRAMES, 1, 1)), times, WIDTH, HEIGHT)
    priors.camera_kind, priors.mask = "moving", mask
    priors.tracks, priors.tracks_visible = tracks.astype(np.float32), visible
    priors.tracks[~visible] = np.nan
    return priors, inverse, z, path


def test_a_rolling_ball_is_put_on_its_ground_with_its_own_shape():
    priors, inverse, _, path = scene()
    confidence = np.full(inverse.shape, 0.8, np.float32)
    rows = place_objects(inverse, confidence, priors.mask, priors)
    assert [row["decided_by"] for row in rows] == ["its own motion"]
    assert rows[0]["frames"] == [10, 10 + FRAMES - 1] and rows[0]["emf_degrees"] > 10
    middle = CENTRE + FOCAL * path[:, :2] / path[:, 2:]
    front = np.array([1 / inverse[f, int(y), int(x)] for f, (x, y) in enumerate(middle)])
    np.testing.assert_allclose(front, path[:, 2] - 1, rtol=0.08)  # nearer than its middle by its radius
    assert np.std(np.log(front / (path[:, 2] - 1))) < 0.02
    assert confidence[priors.mask].min() > 0.5


def test_without_tracks_it_is_one_card_per_frame():
    priors, inverse, _, _ = scene()
    priors.tracks_visible[:] = False
    confidence = np.full(inverse.shape, 0.8, np.float32)
    rows = place_objects(inverse, confidence, priors.mask, priors)
    assert [row["decided_by"] for row in rows] == ["ground contact"] and rows[0]["emf_degrees"] == 0
    assert confidence[priors.mask].max() <= 0.2
    above = replace(priors, mask=np.zeros_like(priors.mask))
    above.mask[:, -30:, 100:140] = True  # it leaves the picture below: nothing of its ground is seen
    rows = place_objects(inverse, confidence, above.mask, above)
    assert [row["decided_by"] for row in rows] == ["surroundings"]


def test_two_that_meet_in_one_region_are_placed_apart():
    near, far = ball(0, at=(-1.0, 0.0, 6.0)), ball(1, at=(1.5, -0.2, 14.0))
    priors, inverse, _, _ = scene()
    priors.mask = disc(near[3]) | disc(far[3])
    priors.mask[FRAMES // 2] |= np.abs(np.arange(HEIGHT) - CENTRE[1])[:, None] < 4  # they touch in one frame
    priors.tracks = np.concatenate([near[0], far[0]], 1).astype(np.float32)
    priors.tracks_visible = np.concatenate([near[1], far[1]], 1)
    rows = place_objects(inverse, np.full(inverse.shape, 0.8, np.float32), priors.mask, priors)
    assert len(rows) == 2
    depths = [np.median(1 / inverse[2][disc(one[3])[2]]) for one in (near, far)]
    assert depths[1] > 1.5 * depths[0]


def test_the_scale_comes_from_frames_with_contact():
    asked = np.array([0.6, 0.62, 1.0, 1.01, 0.99, 1.0, 0.7, 1.02, 1.0, 0.98])
    assert one_scale(asked, np.ones(10)) == pytest.approx(1.0, abs=0.02)
    trust = np.where(asked > 1, 0.0, 1.0)
    assert one_scale(asked, trust) <= 1.0
