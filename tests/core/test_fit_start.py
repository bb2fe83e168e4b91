"""The start of a fit: depth of what moves goes with its nodes."""

from dataclasses import replace

import numpy as np

from f4x_core.fit.start import carried_depth
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors
from f4x_core.scaffold import Scaffold

FRAMES, WIDTH, HEIGHT, FOCAL = 2, 60, 40, 50.0


def case():
    """Priors of a region at depth 4 before one at 8, and nodes on the first."""
    intrinsics = np.tile(np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]), (FRAMES, 1, 1))
    priors = Priors(WIDTH, HEIGHT, np.arange(FRAMES))
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    priors.cameras = CameraPath(intrinsics, poses, np.arange(float(FRAMES)), WIDTH, HEIGHT)
    priors.mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    priors.mask[:, 10:30, 10:50] = True
    priors.depth = np.where(priors.mask, 4.0, 8.0).astype(np.float32)
    pixels = np.stack(np.meshgrid([12.0, 30.0, 48.0], [12.0, 28.0]), -1).reshape(-1, 2)
    xyz = np.column_stack([(pixels - [WIDTH / 2, HEIGHT / 2]) / FOCAL * 4, np.full(6, 4.0)])
    count = len(xyz)
    scaffold = Scaffold(
        np.arange(float(FRAMES)),
        np.tile(xyz, (FRAMES, 1, 1)).astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (FRAMES, count, 1)),
        np.full(count, 0.5, np.float32),
        np.ones((FRAMES, count), bool),
        np.arange(count),
        np.zeros((count, 1), np.int64),
        np.zeros((count, 1), bool),
        0.5,
    )
    return priors, scaffold


def test_depth_of_what_moves_follows_its_nodes_and_nothing_else_does():
    priors, before = case()
    xyz = before.xyz.copy()
    xyz[0] *= np.where(xyz[0, :, :1] < 0.5, 1.1, 1.3)  # along the rays: the right column of nodes farther
    after = replace(before, xyz=xyz)
    found = carried_depth(priors, before, after)
    np.testing.assert_array_equal(found[~priors.mask], priors.depth[~priors.mask])
    np.testing.assert_array_equal(found[1], priors.depth[1])
    np.testing.assert_allclose(found[0, 12, 12], 4.4, rtol=0.02)
    np.testing.assert_allclose(found[0, 12, 48], 5.2, rtol=0.02)
    inside = found[0][priors.mask[0]]
    assert inside.min() >= 4.39 and inside.max() <= 5.21


def test_uncertain_nodes_do_not_move_depth():
    priors, before = case()
    before = replace(before, certain=np.zeros_like(before.certain))
    found = carried_depth(priors, before, replace(before, xyz=before.xyz * 2))
    np.testing.assert_array_equal(found, priors.depth)
