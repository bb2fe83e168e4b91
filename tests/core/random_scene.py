"""Small random scenes for tests: every part present, nothing meaningful to look at."""

import numpy as np

from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scaffold.deformation import align_signs
from f4x_core.scene import DynamicSet, Scene, StaticSet

FRAMES, WIDTH, HEIGHT = 6, 64, 40


def gaussians(rng, count, degree, depth=2.0):
    """Arrays of `count` Gaussians around (0, 0, depth)."""
    return {
        "means": (rng.normal(size=(count, 3)) * 0.4 + [0, 0, depth]).astype(np.float32),
        "quats": rng.normal(size=(count, 4)).astype(np.float32),
        "scales": rng.uniform(0.02, 0.2, (count, 3)).astype(np.float32),
        "opacities": rng.uniform(0.1, 0.95, count).astype(np.float32),
        "sh": (rng.normal(size=(count, (degree + 1) ** 2, 3)) * 0.3).astype(np.float32),
    }


def random_scaffold(rng, nodes=5, slots=3):
    """Nodes that turn and drift smoothly; frame 2 is held out."""
    times = np.array([0.0, 1, 3, 4, 5])
    quat = np.cumsum(rng.normal(size=(len(times), nodes, 4)) * [0.1, 0.3, 0.3, 0.3], axis=0) + np.eye(4)[0]
    quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
    xyz = np.cumsum(rng.normal(size=(len(times), nodes, 3)) * 0.1, axis=0) + 2 * np.eye(3)[2]
    return Scaffold(
        times=times,
        xyz=xyz.astype(np.float32),
        quat=align_signs(quat.astype(np.float32)),
        radius=rng.uniform(0.1, 0.3, nodes).astype(np.float32),
        certain=rng.random((len(times), nodes)) > 0.3,
        ids=np.arange(nodes) * 2,
        neighbours=(np.arange(nodes)[:, None] + np.arange(slots)) % nodes,
        edge_mask=np.ones((nodes, slots), bool),
        unit=0.25,
    )


def random_scene(seed=0, static=30, dynamic=20, degree=1, **fields):
    """A valid scene; without dynamic Gaussians it has no scaffold."""
    rng = np.random.default_rng(seed)
    intrinsics = np.array([[60.0, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]])
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 0.1, FRAMES)
    scene = {
        "name": "random scene",
        "static": StaticSet(ids=np.arange(static, dtype=np.int64), **gaussians(rng, static, degree)),
        "cameras": CameraPath(np.tile(intrinsics, (FRAMES, 1, 1)), poses, np.arange(FRAMES), WIDTH, HEIGHT),
        "fps": 24.0,
        "held_out": (2,),
        "provenance": {"depth": {"provider": "test", "seconds": 1.5}},
        "needs": ({"what": "nodes", "chosen": 5, "evidence": "five were asked for"},),
        "metrics": {"psnr": 30.25},
    }
    if dynamic:
        scaffold = random_scaffold(rng)
        weight = rng.uniform(0.05, 1, (dynamic, 3))
        scene["scaffold"] = scaffold
        scene["dynamic"] = DynamicSet(
            ids=np.arange(static, static + dynamic, dtype=np.int64),
            reference=rng.integers(0, len(scaffold.times), dynamic).astype(np.int32),
            node=rng.integers(0, len(scaffold.ids), (dynamic, 3)).astype(np.int32),
            weight=(weight / weight.sum(1, keepdims=True)).astype(np.float32),
            strength=np.where(np.arange(dynamic) % 3, 1, rng.uniform(0, 1, dynamic)).astype(np.float32),
            **gaussians(rng, dynamic, degree),
        )
    return Scene(**(scene | fields))


def arrays_of(scene):
    """Every array of a scene by name, for comparison."""
    parts = {"static": scene.static, "dynamic": scene.dynamic, "scaffold": scene.scaffold, "cameras": scene.cameras}
    found = {
        f"{part}/{name}": value
        for part, owner in parts.items()
        if owner is not None
        for name, value in vars(owner).items()
        if isinstance(value, np.ndarray)
    }
    return found | dict(scene.extra)


def assert_same(a, b):
    """Two scenes hold the same numbers and words."""
    left, right = arrays_of(a), arrays_of(b)
    assert left.keys() == right.keys()
    for name in left:
        assert left[name].dtype == right[name].dtype, name
        np.testing.assert_array_equal(left[name], right[name], err_msg=name)
    for name in ("name", "fps", "held_out", "needs", "metrics", "provenance", "edits", "next_id", "extra_fields"):
        assert getattr(a, name) == getattr(b, name), name
    assert (a.cameras.width, a.cameras.height) == (b.cameras.width, b.cameras.height)
