"""Depth of triangles per pixel against a ray through every pixel centre and every triangle."""

import numpy as np
import pytest

from f4x_core.geometry.camera import Camera
from f4x_core.raster.triangles import draw_triangles

WIDTH, HEIGHT = 31, 23
K = np.array([[25.0, 0, 14], [0, 28, 12], [0, 0, 1]])
CAMERA = Camera(K, np.eye(4), WIDTH, HEIGHT)


def draw_by_rays(triangles, near, far):
    """The nearest hit of each pixel's ray (Moeller-Trumbore's equations, solved plainly)."""
    depth, index = np.full((HEIGHT, WIDTH), np.inf), np.full((HEIGHT, WIDTH), -1)
    for row in range(HEIGHT):
        for column in range(WIDTH):
            ray = np.linalg.inv(K) @ [column + 0.5, row + 0.5, 1]
            for number, (a, b, c) in enumerate(triangles):
                u, v, z = np.linalg.solve(np.stack([b - a, c - a, -ray], 1), -a)
                if min(u, v, 1 - u - v) >= 0 and near <= z < min(far, depth[row, column]):
                    depth[row, column], index[row, column] = z, number
    return depth, index


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_rays(seed):
    """Both windings, corners beside and behind the camera, triangles through each other, near and far cuts."""
    random = np.random.default_rng(seed)
    triangles = random.uniform(-2, 2, (9, 3, 3))
    triangles[..., 2] = random.uniform(-1.5, 5, (9, 3))
    depth, index = draw_triangles(triangles, CAMERA, near=0.3, far=4)
    expected, hit = draw_by_rays(triangles, 0.3, 4)
    there = np.isfinite(expected)
    assert 0.02 < there.mean() < 1
    assert (index == hit).all() and (np.isfinite(depth) == there).all()
    assert np.abs(depth[there] - expected[there]).max() < 1e-9


def test_neighbours_leave_no_crack_and_flat_ones_nothing():
    random = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-3, 3, 14), np.linspace(-3, 3, 12))
    points = np.stack([x, y, 2 + 0.3 * random.random(x.shape)], -1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    sheet = np.concatenate([np.stack(t, 2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])
    depth, _ = draw_triangles(sheet, CAMERA)
    assert np.isfinite(depth).all()
    flat = np.stack([points[:-1, 0], points[1:, 0], points[1:, 0]], 1)
    assert (draw_triangles(flat, CAMERA)[1] == -1).all()
    assert (draw_triangles(np.zeros((0, 3, 3)), CAMERA)[1] == -1).all()


def test_the_view_matrix_moves_the_camera():
    quad = np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], float)
    view = np.eye(4)
    view[2, 3] = 5
    depth, index = draw_triangles(quad, Camera(K, view, WIDTH, HEIGHT))
    assert (index == 0).sum() > 5 and np.allclose(depth[index == 0], 5)
