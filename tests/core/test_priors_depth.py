"""Depth from geometry, without pictures: exact triangulation, filling, objects that stand on the ground."""

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig
from f4x_core.priors.contact import smooth_object_depth
from f4x_core.priors.depth import ground_prior, inverse_depth_from_flow, provide
from f4x_core.progress import silent

WIDTH, HEIGHT = 96, 64
INTRINSICS = np.array([[80.0, 0, WIDTH / 2], [0, 80.0, HEIGHT / 2], [0, 0, 1]])


def sideways(frames, step):
    """A path that moves along +x without turning."""
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    matrices[:, 0, 3] = -step * np.arange(frames)
    return CameraPath(np.tile(INTRINSICS, (frames, 1, 1)), matrices, np.arange(float(frames)), WIDTH, HEIGHT)


def slanted_ground():
    """Inverse depth (H, W) of a plane that comes nearer towards the lower edge."""
    return np.tile(np.linspace(0.3, 1.5, HEIGHT)[:, None], (1, WIDTH))


def plane_priors(frames=8, step=0.05):
    """Clip and priors of a sideways path over a slanted ground, with exact flow."""
    cameras, inverse = sideways(frames, step), slanted_ground()
    rng = np.random.default_rng(0)
    pictures = rng.integers(0, 255, (frames, HEIGHT, WIDTH, 3)).astype(np.uint8)
    clip = Clip("plane", pictures, np.arange(float(frames)), 24.0, np.zeros(frames, bool), "plane")
    priors = Priors.empty(clip)
    priors.cameras, priors.camera_kind = cameras, "moving"
    shift = np.zeros((HEIGHT, WIDTH, 2))
    shift[..., 0] = -80 * step * inverse
    flow = np.tile(shift, (frames - 1, 1, 1, 1)).astype(np.float16)
    priors.flow_forward, priors.flow_backward = flow, -flow
    priors.flow_forward_mask = priors.flow_backward_mask = np.ones(flow.shape[:3], bool)
    priors.mask = np.zeros((frames, HEIGHT, WIDTH), bool)
    empty = np.zeros((frames, HEIGHT, WIDTH, 2), np.float16)
    flows = {}
    for gap in (1, 2, 4):
        for sign in (1, -1):
            flows[sign * gap] = (empty + sign * gap * shift).astype(np.float16)
    priors.scratch.long_flows = flows
    return clip, priors, inverse


def test_inverse_depth_from_flow_is_exact_and_robust():
    path = sideways(6, 0.1)
    rng = np.random.default_rng(0)
    pixels, inverse = rng.uniform([0, 0], [WIDTH, HEIGHT], (50, 2)), rng.uniform(0.2, 2, 50)
    points = path[0].unproject(pixels, 1 / inverse)
    targets = [(j, path[j].project(points)[0], np.ones(50)) for j in (1, 2, 3, 4, 5)]
    found, precision = inverse_depth_from_flow(path, 0, pixels, targets)
    np.testing.assert_allclose(found, inverse, rtol=1e-9)
    wild = [*targets[:3], (4, targets[3][1] + [40, 0], np.ones(50)), targets[4]]
    spoilt, _ = inverse_depth_from_flow(path, 0, pixels, wild)
    assert np.median(abs(spoilt / inverse - 1)) < 0.05
    _, narrow = inverse_depth_from_flow(path, 0, pixels, targets[:1])
    assert (narrow < precision).all()


def test_static_ground_is_measured_with_median_one():
    clip, priors, inverse = plane_priors()
    provide(clip, priors, PriorsConfig(), silent)
    priors.validate()
    assert np.median(priors.depth) == pytest.approx(1, abs=1e-3)
    inner = (slice(None), slice(8, -8), slice(20, -20))
    relative = priors.depth * np.median(1 / inverse) * inverse - 1
    scale = np.median(relative[inner]) + 1
    assert np.median(np.abs((relative[inner] + 1) / scale - 1)) < 0.02
    assert priors.depth_confidence[inner].mean() > 0.3
    # cameras took the same unit: flow of the picture's middle row still follows from depth and path
    step = np.linalg.norm(np.diff(priors.cameras.centers, axis=0), axis=1)[0]
    assert 80 * step / np.median(priors.depth[3, 32, 20:-20]) == pytest.approx(80 * 0.05 * inverse[32, 0], rel=0.03)


def test_moving_object_stands_on_the_ground_below_it():
    clip, priors, _ = plane_priors()
    priors.mask[:, 10:40, 40:56] = True
    provide(clip, priors, PriorsConfig(), silent)
    still = priors.depth[3, 46, 20:30]
    assert np.median(priors.depth[3, 12:38, 42:54]) == pytest.approx(np.median(still), rel=0.12)
    assert priors.depth_confidence[priors.mask].max() <= 0.2
    assert any("plausible" in line for line in priors.warnings)


def test_given_cameras_keep_their_unit():
    clip, priors, inverse = plane_priors()
    priors.provenance["cameras"] = {"provider": "user"}
    before = priors.cameras.world_to_camera.copy()
    provide(clip, priors, PriorsConfig(), silent)
    np.testing.assert_array_equal(priors.cameras.world_to_camera, before)
    inner = (3, slice(10, -10), slice(20, -20))
    assert np.median(np.abs(priors.depth[inner] * inverse[inner[1:]] - 1)) < 0.03


@pytest.mark.parametrize("kind", ["static", "pan"])
def test_without_parallax_depth_is_a_guess_that_says_so(kind):
    clip, priors, _ = plane_priors()
    priors.camera_kind, priors.cameras = kind, sideways(8, 0.0)
    priors.mask[:, 30:50, 40:56] = True
    provide(clip, priors, PriorsConfig(), silent)
    assert np.isfinite(priors.depth).all() and np.median(priors.depth) == pytest.approx(1, abs=1e-3)
    assert priors.depth_confidence.max() <= 0.06
    assert priors.depth[0, -1].mean() < priors.depth[0, 0].mean()
    assert any("guess" in line for line in priors.warnings)


def test_ground_prior_is_one_world_for_a_turning_camera():
    path = sideways(2, 0.0)
    matrices = path.world_to_camera.copy()
    c, s = np.cos(0.2), np.sin(0.2)
    matrices[1, :3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    path = CameraPath(path.intrinsics, matrices, path.times, WIDTH, HEIGHT)
    depth = 1 / ground_prior(path)
    pixel = np.array([60.5, 40.5])
    point = path[0].unproject(pixel, np.array(float(depth[0, 40, 60])))
    there, z = path[1].project(point)
    assert z == pytest.approx(depth[1, int(there[1]), int(there[0])], rel=0.02)


def test_what_hovers_is_not_put_on_the_ground_behind_it():
    contact = np.where(np.arange(12) % 6 == 0, 0.5, 0.35)  # it lands twice, and is seen before farther ground else
    found, _ = smooth_object_depth(contact, np.ones(12), np.zeros(11))
    np.testing.assert_allclose(found, 0.5, rtol=0.1)
