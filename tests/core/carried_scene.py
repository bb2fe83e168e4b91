"""A tiny model made by hand: static Gaussians, and dynamic ones on four nodes in a row, one unit apart, that rise and turn."""

import numpy as np

from f4x_core.fit.model import NodeSet, SceneModel
from f4x_core.gaussians import SpawnConfig, Spawned, spawn_dynamic, spawn_static
from f4x_core.gaussians.camera_rig import CameraRig
from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.native.kernels import TORCH, Kernels
from f4x_core.scaffold import Scaffold
from f4x_core.scaffold.graph import GraphConfig
from f4x_core.scaffold.optimise import with_graph

FRAMES, WIDTH, HEIGHT, FOCAL = 3, 64, 40, 50.0
GRAPH = GraphConfig(neighbours=4)


def camera_path(frames: int = FRAMES) -> CameraPath:
    """Cameras that turn and travel."""
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    for t in range(frames):
        matrices[t, :3, :3] = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.1, -0.05, 0.02]) * t))
        matrices[t, :3, 3] = [0.1 * t, -0.05 * t * t, 4.0]
    intrinsics = np.array([[FOCAL, 0, WIDTH / 2 + 1], [0, 1.1 * FOCAL, HEIGHT / 2 - 2], [0, 0, 1]])
    return CameraPath(np.tile(intrinsics, (frames, 1, 1)), matrices, np.arange(frames, dtype=float), WIDTH, HEIGHT)


def row_of_nodes(count: int = 4, radius: float = 0.6) -> Scaffold:
    """Nodes at x = 0, 1, ... that rise and turn from frame to frame; ids from 20 on."""
    xyz = np.zeros((FRAMES, count, 3), np.float32)
    xyz[..., 0] = np.arange(count)
    xyz[..., 1] = 0.2 * np.arange(FRAMES)[:, None]
    turn = quaternion.from_rotation_vector(np.array([0.0, 0.0, 0.3]) * np.arange(FRAMES)[:, None])
    quat = np.broadcast_to(turn[:, None], (FRAMES, count, 4)).astype(np.float32)
    bare = Scaffold(
        np.arange(float(FRAMES)),
        xyz,
        np.ascontiguousarray(quat),
        np.full(count, radius, np.float32),
        np.ones((FRAMES, count), bool),
        20 + np.arange(count),
        np.arange(count)[:, None],
        np.ones((count, 1), bool),
        1.0,
    )
    return with_graph(bare, GRAPH)


def spawned_at(xyz: np.ndarray) -> Spawned:
    """New Gaussians of the standard deviation 0.05 at `xyz (N,3)`, coloured by their number."""
    count = len(xyz)
    colour = np.linspace(0.2, 0.9, 3 * count).reshape(count, 3)
    ones = np.ones(count, np.float32)
    return Spawned(np.asarray(xyz, np.float32), colour.astype(np.float32), 0.05 * ones, 4 * ones)


def carried_scene(moving: np.ndarray, reference: np.ndarray, nodes: int = 4, kernels: Kernels = TORCH) -> SceneModel:
    """A model whose dynamic Gaussians are at `moving (N,3)` in their frames `reference (N,)`."""
    scaffold = row_of_nodes(nodes)
    still = spawn_static(spawned_at(np.array([[0, -1, 0.5], [1, -1, 1], [2, -1, 0]])), 1, SpawnConfig())
    dynamic = spawn_dynamic(spawned_at(moving), reference, scaffold, 1, SpawnConfig(), 3)
    return SceneModel(still, dynamic, NodeSet(scaffold, GRAPH), CameraRig(camera_path()), "sigma", kernels)
