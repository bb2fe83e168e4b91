"""The turn of long moving objects by the way they go: planes whose truth is known, and what has no heading."""

import numpy as np
import pytest

from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import heading as module

LENS = np.array([[200.0, 0, 120], [0, 200, 70], [0, 0, 1]])
FRAMES, WIDTH, HEIGHT = 20, 240, 140


def cameras(turn=0.0):
    """A camera that walks sideways and turns by `turn` radians in all about the vertical."""
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    for pose, angle in zip(poses, np.linspace(0, turn, FRAMES), strict=True):
        pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    poses[:, 0, 3] = np.linspace(0, 0.1, FRAMES)
    return CameraPath(np.tile(LENS, (FRAMES, 1, 1)), poses, np.arange(float(FRAMES)), WIDTH, HEIGHT)


def walker(path, way, body=0.4, start=(-0.3, 0.1, 2.0)):
    """Extents of an upright plate of length `body` along its `way (3,)` per frame, with the inverse depth of its middle and its
    true relative change per column there."""
    along = np.array(way) / np.linalg.norm(way)
    center, size, inverse, slope = [], [], [], []
    for f, camera in enumerate(path):
        middle = np.array(start) + f * np.array(way)
        pixels, depth = camera.project(np.array([middle - along * body / 2, middle, middle + along * body / 2]))
        center.append(pixels[1])
        size.append([abs(np.ptp(pixels[:, 0])), 20.0])
        inverse.append(1 / depth[1])
        slope.append((1 / depth[2] - 1 / depth[0]) / (pixels[2, 0] - pixels[0, 0]) * depth[1])
    return module.Extents(np.array(center), np.array(size)), np.array(inverse), np.array(slope)


@pytest.mark.parametrize("way", [(0.05, 0, 0.02), (0.05, 0, -0.02), (-0.04, 0, 0.0), (0.05, 0.01, 0.0)])
@pytest.mark.parametrize("turn", [0.0, 0.2])
def test_a_plate_that_moves_along_its_length_is_turned_as_it_is(way, turn):
    path = cameras(turn)
    extents, inverse, slope = walker(path, way)
    found = module.turn_along_way(extents, inverse, path)
    moved = np.linalg.norm(way) * np.array([min(f, 12) + min(FRAMES - 1 - f, 12) for f in range(FRAMES)])
    widths = moved / (extents.size[:, 0] / 200 / inverse)
    counts = widths**2 / (widths**2 + module.HALF_WAY**2)
    limited = np.clip(module.SHOWN * slope * extents.size[:, 0], -module.MAX_RELIEF, module.MAX_RELIEF)
    np.testing.assert_allclose(found, counts * limited / extents.size[:, 0], rtol=1e-3, atol=1e-6)


def test_what_comes_straight_on_is_limited():
    path = cameras()
    extents, inverse, _ = walker(path, (0.0, 0, -0.03))
    extents = module.Extents(extents.center, np.tile([60.0, 20.0], (FRAMES, 1)))
    assert abs(module.turn_along_way(extents, inverse, path) * 60).max() <= module.MAX_RELIEF


@pytest.mark.parametrize(("height", "counts"), [(10.0, 1.0), (40.0, 1.0), (48.0, 0.5), (60.0, 0.0), (90.0, 0.0)])
def test_only_what_is_long_has_a_heading(height, counts):
    extents = module.Extents(np.zeros((FRAMES, 2)), np.tile([60.0, height], (FRAMES, 1)))
    assert extents.length == pytest.approx(counts)


def test_what_stands_has_no_heading():
    path = cameras()
    extents, inverse, _ = walker(path, (0.05, 0, 0.02))
    still = module.Extents(np.tile(extents.center[:1], (FRAMES, 1)), extents.size)
    fixed = CameraPath(path.intrinsics, np.tile(np.eye(4), (FRAMES, 1, 1)), path.times, WIDTH, HEIGHT)
    np.testing.assert_array_equal(module.turn_along_way(still, np.full(FRAMES, 0.5), fixed), 0)
    np.testing.assert_array_equal(module.turn_along_way(extents, inverse[:2], path), 0)


def test_extents_of_masks():
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[10:20, 30:60] = True
    mask[20:30, 30:40] = True
    found = module.Extents.of([mask])
    y, x = np.nonzero(mask)
    np.testing.assert_allclose(found.center, [[x.mean() + 0.5, y.mean() + 0.5]])
    np.testing.assert_array_equal(found.size, [[30, 20]])
