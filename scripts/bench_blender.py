"""Times of Blender with a large scene: import and playback, each the best of some, as one line of JSON.

python scripts/bench_blender.py [--static N] [--dynamic N] [--nodes M] [--frames T] [--slots K]
blender -b --factory-startup --python-exit-code 1 -P scripts/bench_blender.py -- [...]
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door

REPEATS = 40
"""Frames that are played; the best and the median are told."""


def main(arguments: list[str]) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="bench_blender.py", description=__doc__.splitlines()[0])
    for name, default in (("static", 100_000), ("dynamic", 100_000), ("nodes", 200), ("frames", 100), ("slots", 4)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args(arguments)
    import bpy
    from feature4x.addon.import_scene import import_scene
    from feature4x.f4x_core.scene import write_scene

    scene = large_scene(**vars(options))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "large.f4x"
        write_scene(scene, file)
        start = time.perf_counter()
        import_scene(file)
        seconds = time.perf_counter() - start
    print(json.dumps(vars(options) | {"blender": bpy.app.version_string, "import_s": round(seconds, 2)} | play(scene)))


def play(scene) -> dict[str, float]:
    """Milliseconds of a frame with and without the motion of the Gaussians, and its largest error against the core."""
    import bpy

    cloud = bpy.data.objects["large dynamic"]
    times = {}
    for label, on in (("frame", True), ("frame_without_motion", False)):
        cloud.modifiers[0].show_viewport = on
        spent = []
        for frame in range(REPEATS):
            start = time.perf_counter()
            bpy.context.scene.frame_set(frame % len(scene.cameras))
            spent.append(1e3 * (time.perf_counter() - start))
        times |= {f"{label}_best_ms": round(min(spent), 1), f"{label}_median_ms": round(float(np.median(spent)), 1)}
    cloud.modifiers[0].show_viewport = True
    worst = 0.0
    for frame in np.linspace(0, len(scene.cameras) - 1, 4).astype(int):
        bpy.context.scene.frame_set(int(frame))
        data = cloud.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        points = np.empty(3 * len(scene.dynamic), np.float32)
        data.attributes["position"].data.foreach_get("vector", points)
        posed = scene.posed(float(frame))
        worst = max(worst, float(np.abs(points.reshape(-1, 3) - posed.means[posed.dynamic]).max()))
    return times | {"largest_error": float(f"{worst:.1e}")}


def large_scene(static: int, dynamic: int, nodes: int, frames: int, slots: int):
    """Random Gaussians of degree 1 that follow slowly travelling and turning nodes, with all reference times in use."""
    from feature4x.f4x_core.geometry import pose, quaternion
    from feature4x.f4x_core.geometry.camera import CameraPath
    from feature4x.f4x_core.scaffold import Scaffold
    from feature4x.f4x_core.scene import DynamicSet, Scene, StaticSet

    random = np.random.default_rng(0)
    times = np.arange(frames, dtype=float)
    start, velocity = random.uniform(-1, 1, (nodes, 3)), random.normal(0, 0.005, (nodes, 3))
    spin = random.normal([0, 0.03, 0], 0.003, (nodes, 3))
    near = np.argsort(np.linalg.norm(start[:, None] - start, axis=-1), axis=1)[:, :slots]
    scaffold = Scaffold(
        times=times,
        xyz=(start + times[:, None, None] * velocity).astype(np.float32),
        quat=quaternion.from_rotation_vector(spin * times[:, None, None]).astype(np.float32),
        radius=np.full(nodes, 0.3, np.float32),
        certain=np.ones((frames, nodes), bool),
        ids=np.arange(nodes),
        neighbours=near,
        edge_mask=np.ones(near.shape, bool),
        unit=0.2,
    )

    def gaussians(count: int, first: int) -> dict[str, np.ndarray]:
        return {
            "ids": np.arange(first, first + count),
            "xyz": random.uniform(-1, 1, (count, 3)).astype(np.float32),
            "rotation": random.normal(size=(count, 4)).astype(np.float32),
            "scale": random.uniform(0.005, 0.02, (count, 3)).astype(np.float32),
            "opacity": random.uniform(0.1, 1, count).astype(np.float32),
            "sh": random.normal(0, 0.3, (count, 4, 3)).astype(np.float32),
        }

    shift = np.array([0.01, 0, 0]) * times[:, None] + [0, 0, 4.0]
    matrices = pose.to_matrix(np.tile(quaternion.IDENTITY, (frames, 1)), shift)
    intrinsics = np.tile([[900.0, 0, 480], [0, 900, 270], [0, 0, 1]], (frames, 1, 1))
    return Scene(
        name="large",
        static=StaticSet(**gaussians(static, 0)),
        dynamic=DynamicSet(
            **gaussians(dynamic, static),
            reference=random.integers(0, frames, dynamic).astype(np.int32),
            node=near[random.integers(0, nodes, dynamic)].astype(np.int32),
            weight=random.dirichlet(np.ones(slots), dynamic).astype(np.float32),
            strength=np.ones(dynamic, np.float32),
        ),
        scaffold=scaffold,
        cameras=CameraPath(intrinsics, matrices, times, 960, 540),
    )


door.run(main)
