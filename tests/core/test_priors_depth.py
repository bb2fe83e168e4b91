"""Depth from geometry, without pictures: exact triangulation, filling, objects that stand on the ground."""

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig
from f4x_core.priors.contact import smooth_object_depth
from f4x_core.priors.depth import (
    epipolar_direction,
    fill_inverse_depth,
    ground_prior,
    inverse_depth_from_flow,
    provide,
)
from f4x_core.priors.flow import texture_along
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
    priors.scratch["long_flows"] = flows
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


def test_filling_keeps_precise_samples_and_spans_holes():
    true = slanted_ground()
    rng = np.random.default_rng(0)
    known = rng.random(true.shape) < 0.2
    known[20:40, 30:60] = False
    samples = np.where(known, true + 0.01 * rng.standard_normal(true.shape), 0)
    filled = fill_inverse_depth(samples, known * 1e4, np.full(true.shape, 128.0))
    assert np.isfinite(filled).all()
    assert np.abs(filled - true).mean() < 0.02
    assert np.abs(filled - true)[20:40, 30:60].max() < 0.1


def test_filling_stops_at_picture_edges():
    true = np.where(np.arange(WIDTH) < WIDTH // 2, 0.5, 2.0) * np.ones((HEIGHT, 1))
    guide = np.where(true > 1, 220.0, 30.0)
    known = np.zeros(true.shape, bool)
    known[:, [8, WIDTH - 8]] = True
    filled = fill_inverse_depth(true * known, known * 1e4, guide, iterations=300)
    assert abs(filled[:, WIDTH // 2 - 3].mean() - 0.5) < 0.15
    assert abs(filled[:, WIDTH // 2 + 3].mean() - 2.0) < 0.15


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


def test_object_depth_follows_size_and_forgives_a_wrong_contact():
    growth = np.full(19, np.log(1.1))
    true = 0.5 * 1.1 ** np.arange(20)
    contact = true.copy()
    contact[4] *= 3
    found, certain = smooth_object_depth(contact, np.ones(20), growth)
    np.testing.assert_allclose(found, true, rtol=0.05)
    assert ((certain > 0) & (certain <= 1)).all()
    alone, _ = smooth_object_depth(np.array([0.7]), np.ones(1), np.zeros(0))
    np.testing.assert_allclose(alone, 0.7)


def test_what_hovers_is_not_put_on_the_ground_behind_it():
    contact = np.where(np.arange(12) % 6 == 0, 0.5, 0.35)  # it lands twice, and is seen before farther ground else
    found, _ = smooth_object_depth(contact, np.ones(12), np.zeros(11))
    np.testing.assert_allclose(found, 0.5, rtol=0.1)


def test_depth_is_not_measured_along_a_line():
    """Lines on a road along which the camera moves are sharp, but their flow along themselves is a guess."""
    rows, columns = np.mgrid[0:60, 0:80]
    across = (127 + 100 * np.sin(rows / 2)).astype(np.uint8)  # lines that run from left to right
    both = (127 + 60 * np.sin(rows / 2) + 60 * np.sin(columns / 2)).astype(np.uint8)
    sideways, up = np.zeros((30, 40, 2)), np.zeros((30, 40, 2))
    sideways[..., 0], up[..., 1] = 3.0, 0.01
    assert texture_along(across, sideways).max() < 0.01
    assert np.median(texture_along(across, up)) > 0.9
    assert np.median(texture_along(both, sideways)) > 0.9
    assert (texture_along(both, np.zeros((30, 40, 2))) == 0).all()  # no parallax at all
    slanted = texture_along(across, sideways + 300 * up)
    plain = texture_along(across, up)
    assert (slanted < plain + 1e-6).all()


def test_the_epipolar_direction_points_to_the_other_camera():
    path = sideways(3, 0.01)
    path.world_to_camera[2, :3, 3] = [-0.1, 0.02, -0.3]  # the farthest one, ahead
    epipole = INTRINSICS[:2, 2] + 80 * np.array([0.1, -0.02]) / 0.3
    pixels = np.array([[10.0, 20.0], [40.0, 30.0], [70.0, 55.0]])
    for pixel, found in zip(pixels, epipolar_direction(path, 0, pixels, [1, 2]), strict=True):
        onward = epipole - pixel
        assert (
            abs(found[0] * onward[1] - found[1] * onward[0])
            < 1e-9 * np.linalg.norm(found) * np.linalg.norm(onward) + 1e-12
        )
    assert (epipolar_direction(path, 0, pixels, []) == 0).all()
