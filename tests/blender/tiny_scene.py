"""The scene that most tests in Blender import; it needs no Blender, so that these tests are skipped in peace without one."""

import numpy as np

from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet

TIMES = np.array([0.0, 1.0, 3.0, 4.0, 6.0])  # frames 2 and 5 are held out
CLIP = 7
DYNAMIC, STATIC, NODES, SLOTS = 300, 50, 12, 4


def tiny_scene() -> Scene:
    """Random but smooth: nodes that travel and turn by more than a half turn, Gaussians of every reference time."""
    random = np.random.default_rng(5)
    start, velocity = random.uniform(-1, 1, (NODES, 3)), random.normal(0, 0.1, (NODES, 3))
    xyz = start + TIMES[:, None, None] * velocity + 0.05 * np.sin(TIMES[:, None, None] + start)
    spin = random.normal([0, 0.6, 0], 0.05, (NODES, 3))  # radians per frame: 3.6 at the end, more than pi
    quat = quaternion.from_rotation_vector(spin * TIMES[:, None, None])
    quat[:, ::2] *= -1  # the same rotations with the other sign
    quat *= 1.7  # the file does not promise unit length
    nearest = np.argsort(np.linalg.norm(start[:, None] - start, axis=-1), axis=1)[:, :SLOTS]
    scaffold = Scaffold(
        times=TIMES,
        xyz=xyz.astype(np.float32),
        quat=quat.astype(np.float32),
        radius=np.full(NODES, 0.3, np.float32),
        certain=np.ones((len(TIMES), NODES), bool),
        ids=np.arange(NODES) * 3,
        neighbours=nearest,
        edge_mask=np.ones((NODES, SLOTS), bool),
        unit=0.2,
    )

    def gaussians(count, first):
        return {
            "ids": np.arange(first, first + count),
            "means": random.uniform(-1, 1, (count, 3)).astype(np.float32),
            "quats": random.normal(size=(count, 4)).astype(np.float32),
            "scales": random.uniform(0.01, 0.05, (count, 3)).astype(np.float32),
            "opacities": random.uniform(0.1, 1, count).astype(np.float32),
            "sh": random.normal(0, 0.3, (count, 4, 3)).astype(np.float32),
        }

    weight = random.dirichlet(np.ones(SLOTS), DYNAMIC)
    strength = np.where(random.random(DYNAMIC) < 0.5, 1.0, random.random(DYNAMIC))
    dynamic = DynamicSet(
        **gaussians(DYNAMIC, STATIC),
        reference=random.integers(0, len(TIMES), DYNAMIC).astype(np.int32),
        node=nearest[random.integers(0, NODES, DYNAMIC)].astype(np.int32),
        weight=weight.astype(np.float32),
        strength=strength.astype(np.float32),
    )
    frames = np.arange(CLIP, dtype=np.float64)
    turn = quaternion.from_rotation_vector(np.array([0.02, -0.05, 0.01]) * frames[:, None])
    matrices = pose.to_matrix(turn, np.array([0.1, 0.05, 0.02]) * frames[:, None] + [0, 0, 4.0])
    intrinsics = np.array([[90.0, 0, 50], [0, 85.0, 33], [0, 0, 1]]) + np.zeros((CLIP, 1, 1))
    intrinsics[:, :2, :2] *= 1 + 0.01 * frames[:, None, None]  # a slow zoom
    return Scene(
        name="tiny",
        static=StaticSet(**gaussians(STATIC, 0)),
        dynamic=dynamic,
        scaffold=scaffold,
        cameras=CameraPath(intrinsics, matrices, frames, 96, 64),
        fps=23.976,
        held_out=(2, 5),
    )
