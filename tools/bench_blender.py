"""Measure the extension in Blender: import, playback, motion against the core, thresholds, queries, clicks, pictures, jobs.

python tools/bench_blender.py --json
blender -b --factory-startup --python-exit-code 1 -P tools/bench_blender.py -- --rows import playback

Without --scene the Gaussians are random, as many as asked for; times are medians on the machine that it runs on.
"""

import argparse
import gc
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.extend(str(Path(__file__).resolve().parents[1] / name) for name in ("tools", "scripts"))
import door

REPEATS = 9
PLAYED = 40
"""Frames that are played."""
REGISTRATIONS = 10
SIZE = (480, 270)
FOCAL = 400.0
ERROR_FRAMES = 5
"""Frames at which Blender's points are compared with the core's."""


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="bench_blender.py", description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS), help="what to measure (default: all)")
    parser.add_argument("--scene", type=Path, help="measure this scene in place of a random one")
    parser.add_argument("--static", type=int, default=100_000, help="Gaussians that stand (default: 100000)")
    parser.add_argument("--dynamic", type=int, default=100_000, help="Gaussians that move (default: 100000)")
    parser.add_argument("--nodes", type=int, default=200, help="of the scaffold (default: 200)")
    parser.add_argument("--frames", type=int, default=100, help="of the clip (default: 100)")
    parser.add_argument("--slots", type=int, default=4, help="nodes that carry a Gaussian (default: 4)")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON alone")
    return parser.parse_args(arguments)


def random_scene(static: int, dynamic: int, nodes: int, frames: int, slots: int) -> Any:
    """Return a scene of that size: random Gaussians of SH degree 1 on smoothly moving nodes, with all reference times."""
    import numpy as np
    from feature4x.f4x_core.geometry import quaternion
    from feature4x.f4x_core.geometry.camera import CameraPath
    from feature4x.f4x_core.scaffold import Scaffold
    from feature4x.f4x_core.scaffold.deformation import align_signs
    from feature4x.f4x_core.scene import DynamicSet, Scene, StaticSet

    random = np.random.default_rng(0)
    times: np.ndarray = np.arange(frames, dtype=float)
    start = random.uniform([-0.6, -0.4, 0.8], [0.6, 0.4, 1.4], (nodes, 3))
    phase = random.uniform(0, 6, (nodes, 3))
    xyz = start + 0.1 * np.sin(0.1 * times[:, None, None] + phase)
    quat = quaternion.from_rotation_vector(0.3 * np.sin(0.1 * times[:, None, None] + phase))
    near = np.argsort(np.linalg.norm(start[:, None] - start, axis=-1), axis=1)[:, :slots]
    scaffold = Scaffold(
        times=times,
        xyz=xyz.astype(np.float32),
        quat=align_signs(quat, near, np.ones(near.shape, bool)).astype(np.float32),
        radius=np.full(nodes, 0.1, np.float32),
        certain=np.ones((frames, nodes), bool),
        ids=np.arange(nodes),
        neighbours=near,
        edge_mask=np.ones(near.shape, bool),
        unit=0.1,
    )

    def gaussians(count: int, first: int) -> dict[str, Any]:
        return {
            "ids": np.arange(first, first + count),
            "means": random.uniform([-0.8, -0.5, 0.8], [0.8, 0.5, 1.6], (count, 3)).astype(np.float32),
            "quats": quaternion.normalize(random.normal(size=(count, 4))).astype(np.float32),
            "scales": random.uniform(0.003, 0.012, (count, 3)).astype(np.float32),
            "opacities": random.uniform(0.1, 1, count).astype(np.float32),
            "sh": random.normal(0, 0.3, (count, 4, 3)).astype(np.float32),
        }

    moving = DynamicSet(
        **gaussians(dynamic, static),
        reference=random.integers(0, frames, dynamic).astype(np.int32),
        node=near[random.integers(0, nodes, dynamic)].astype(np.int32),
        weight=random.dirichlet(np.ones(slots), dynamic).astype(np.float32),
        strength=np.ones(dynamic, np.float32),
    )
    lens = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    cameras = CameraPath(np.tile(lens, (frames, 1, 1)), np.tile(np.eye(4), (frames, 1, 1)), times, *SIZE)
    return Scene("bench", StaticSet(**gaussians(static, 0)), cameras, moving, scaffold, 24.0)


class Bench:
    """One imported scene and the rows about it."""

    def __init__(self, path: Path):
        """Import the scene, timed."""
        self.path = path
        door.start_blender()
        start = time.perf_counter()
        self.root = door.import_scene(path)
        self.seconds = time.perf_counter() - start

    def import_time(self) -> dict[str, Any]:
        """Measure the seconds from file to objects."""
        from feature4x.addon.scene.scene_object import SceneObject

        scene = SceneObject(self.root).edited
        nodes = len(scene.scaffold.ids) if scene.scaffold is not None else 0
        return {"seconds": self.seconds, "gaussians": len(scene.ids), "nodes": nodes, "frames": len(scene.cameras)}

    def playback(self) -> dict[str, Any]:
        """Measure the milliseconds in which Blender evaluates a frame, with and without the motion of the Gaussians."""
        import bpy

        scene = bpy.context.scene
        frames = range(scene.frame_start, min(scene.frame_end + 1, scene.frame_start + PLAYED))
        clouds = [item for item in self.root.children if item.type == "POINTCLOUD"]
        modifiers = [modifier for item in clouds for modifier in item.modifiers if modifier.show_viewport]
        row: dict[str, Any] = {"frames": len(frames)}
        for name, on in (("without_motion_", False), ("", True)):
            for modifier in modifiers:
                modifier.show_viewport = on
            scene.frame_set(frames[-1])
            times = [1000 * measure(partial(scene.frame_set, frame)) for frame in frames]
            row |= {f"{name}milliseconds": statistics.median(times), f"{name}best_milliseconds": min(times)}
        return row

    def motion(self) -> dict[str, Any]:
        """Measure the largest difference between points in Blender and in the core, in units of the scene."""
        import bpy
        import numpy as np
        from feature4x.addon.common.point_cloud import read_attribute
        from feature4x.addon.scene.scene_object import SceneObject

        scene = SceneObject(self.root).edited
        errors, turns = [], []
        for frame in np.linspace(0, len(scene.cameras) - 1, ERROR_FRAMES).astype(int):
            bpy.context.scene.frame_set(int(frame))
            posed = scene.posed(float(frame))
            depsgraph = bpy.context.evaluated_depsgraph_get()
            for cloud, at, row in SceneObject(self.root).points():
                data = cloud.evaluated_get(depsgraph).data
                if not len(at):  # no edit moves anything
                    continue
                errors.append(np.abs(read_attribute(data, "position")[at] - posed.means[row]).max())
                there, core = read_attribute(data, "rotation")[at], posed.quats[row]
                turns.append(np.minimum(np.abs(there - core).max(1), np.abs(there + core).max(1)).max())
        return {"position": float(max(errors)), "rotation": float(max(turns))}

    def threshold(self) -> dict[str, Any]:
        """Measure the milliseconds from a moved threshold to a new selection."""
        import numpy as np
        from feature4x.addon.edits import marking
        from feature4x.addon.scene.scene_object import SELECTED, SceneObject
        from feature4x.f4x_core.query.selection import Selection

        ids = SceneObject(self.root).shown.scene.ids
        scores = np.random.default_rng(0).random(len(ids))
        marking.ask(SceneObject(self.root), Selection(ids, scores, np.zeros(len(ids), bool)))
        values = np.linspace(0.2, 0.8, REPEATS).tolist()
        times = [measure(partial(setattr, self.root.f4x, "threshold", value)) for value in values]
        chosen = int(SceneObject(self.root).read(SELECTED).sum())
        assert chosen == int((scores.astype(np.float32) >= np.float32(values[-1])).sum())
        return {"milliseconds": 1000 * statistics.median(times), "gaussians": len(ids)}

    def query(self) -> dict[str, Any]:
        """Measure the milliseconds from a word of the vocabulary to selected points, the first time and again."""
        from feature4x.addon.edits import marking
        from feature4x.addon.scene.scene_object import SceneObject
        from feature4x.f4x_core.query.prompts import select_by_text

        scene = SceneObject(self.root).edited
        vocabularies = {} if scene.features is None else scene.features.vocabularies
        if not vocabularies:
            return {"left_out": "the scene has no words; give --scene with features"}
        word = next(iter(vocabularies.values())).labels[0]
        times = [measure(lambda: marking.ask(SceneObject(self.root), select_by_text(scene, [word]))) for _ in range(3)]
        return {"first_milliseconds": 1000 * times[0], "milliseconds": 1000 * times[-1], "word": word}

    def click(self) -> dict[str, Any]:
        """Measure the seconds of preparing clicks, of the first click on what moves most and on what stands, and of later ones.

        `…processor_seconds`: of all threads, which other programs hardly change.
        """
        import numpy as np
        from feature4x.addon.edits import marking
        from feature4x.addon.scene.scene_object import SceneObject
        from feature4x.f4x_core.query.calibration import prepare
        from feature4x.f4x_core.query.following import draw_views
        from feature4x.f4x_core.query.prompts import select_by_points
        from feature4x.f4x_core.scene.view import render

        scene = SceneObject(self.root).edited
        values = {"moving": scene.moving[:, None].astype(np.float32)}
        moving = render(scene, scene.cameras[0], float(scene.cameras.times[0]), (), values=values)["moving"][..., 0]
        row: dict[str, Any] = {"gaussians": len(scene.ids)}

        def time_of(name: str, work: Callable[[], Any]) -> None:
            before = time.process_time()
            row[f"{name}seconds"] = measure(work)
            row[f"{name}processor_seconds"] = time.process_time() - before

        time_of("prepare_", lambda: prepare(scene))
        time_of("draw_views_", lambda: draw_views(scene))
        for name, coverage in (("moving_", moving), ("static_", -moving)):
            y, x = np.unravel_index(coverage.argmax(), coverage.shape)

            def ask(at: tuple[float, float] = (x + 0.5, y + 0.5)) -> None:
                marking.ask(SceneObject(self.root), select_by_points(scene, [at], 0))

            time_of(f"{name}first_", ask)
            time_of(name, ask)
        return row

    def render_image(self) -> dict[str, Any]:
        """Measure the seconds of one picture of the render engine at the clip's size."""
        import bpy

        scene = bpy.context.scene
        scene.render.engine = "FEATURE4X"
        times = [measure(bpy.ops.render.render) for _ in range(3)]
        return {"seconds": min(times), "size": [scene.render.resolution_x, scene.render.resolution_y]}


def registration() -> dict[str, Any]:
    """Return the classes that stay registered after the extension was disabled and enabled ten times."""
    extension = door.load_extension()
    extension.unregister()
    before = registered()
    for _ in range(REGISTRATIONS):
        extension.register()
        extension.unregister()
    left = sorted(registered() - before)
    extension.register()
    return {"times": REGISTRATIONS, "registered": len(registered() - before), "left": left}


def registered() -> set[str]:
    """Return what an extension can leave behind in Blender: classes, properties, handlers, menu entries, modes' panels."""
    import bpy

    found = {name for name in dir(bpy.types) if "f4x" in name.lower() or "feature4x" in name.lower()}
    found |= {f"ops.f4x.{name}" for name in dir(bpy.ops.f4x)}
    for owner in ("Object", "Scene", "ViewLayer", "WindowManager", "PointCloud", "Collection"):
        properties = getattr(bpy.types, owner).bl_rna.properties
        found |= {f"{owner}.{one.identifier}" for one in properties if "f4x" in one.identifier}
    for name in dir(bpy.app.handlers):
        handlers = getattr(bpy.app.handlers, name)
        if isinstance(handlers, list):
            found |= {f"handlers.{name}.{one.__module__}.{one.__qualname__}" for one in handlers if ours(one)}
    for name in dir(bpy.types):
        draw = getattr(getattr(bpy.types, name), "draw", None)
        found |= {f"{name}.draw.{one.__qualname__}" for one in getattr(draw, "_draw_funcs", ()) if ours(one)}
    for panel in bpy.types.Panel.__subclasses__():
        if "FEATURE4X" in getattr(panel, "COMPAT_ENGINES", ()) and not ours(panel):
            found.add(f"{panel.__name__}.COMPAT_ENGINES")
    return found


def ours(one: Any) -> bool:
    """Return True if a function or class belongs to the extension."""
    return getattr(one, "__module__", "").startswith(door.PACKAGE)


def cancel() -> dict[str, Any]:
    """Measure the seconds from Cancel until a job that ignores it has ended."""
    from feature4x.addon.jobs import worker

    code = "import json, signal, sys, time; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    code += "from f4x_core.processes import stop_with_parent; stop_with_parent()\n"
    code += "print(json.dumps({'stage': 'deaf', 'done': 0, 'total': 0}), flush=True); time.sleep(60)"
    job = worker.Job("deaf", [sys.executable, "-c", code])
    while job.poll() and job.stage != "deaf":
        time.sleep(0.01)
    start = time.perf_counter()
    job.cancel()
    asked = time.perf_counter() - start
    job.wait(glance=0.01)
    return {"seconds": time.perf_counter() - start, "blocked_milliseconds": 1000 * asked, "state": job.state}


def measure(work: Callable[[], Any]) -> float:
    """Return the seconds that `work` takes, without garbage collection."""
    gc.collect()
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


ROWS: dict[str, Callable] = {
    "import": Bench.import_time,
    "playback": Bench.playback,
    "motion": Bench.motion,
    "threshold": Bench.threshold,
    "query": Bench.query,
    "click": Bench.click,
    "picture": Bench.render_image,
    "registration": lambda bench: registration(),
    "cancel": lambda bench: cancel(),
}


def main(arguments: list[str]) -> dict[str, Any] | None:
    """Run the chosen measurements."""
    options = parse(arguments)
    import bpy
    from feature4x.f4x_core.scene import write_scene

    with tempfile.TemporaryDirectory() as folder:
        path = options.scene or Path(folder) / "bench.f4x"
        if options.scene is None:
            write_scene(
                random_scene(options.static, options.dynamic, options.nodes, options.frames, options.slots), path
            )
        bench = Bench(path)
        rows = {"blender": bpy.app.version_string}
        for name in options.rows:
            rows[name] = ROWS[name](bench)
            if not options.json:
                print(f"{name}: {json.dumps(rows[name])}", flush=True)
    return rows


door.run(main)
