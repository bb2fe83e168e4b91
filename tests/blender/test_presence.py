"""Gaussians that come and go: Blender fades them as the core does, in both clouds, and in what an edit draws apart."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_scene import random_scene

from f4x_core.edit.apply import edited, with_operations
from f4x_core.edit.operations import Transform
from f4x_core.edit.selects import Ids
from f4x_core.scene import Scene, write_scene

from .artist import perform

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "import_scene.py"
FRAMES = (0, 2, 3, 4, 5)
DOOR = f"import sys; sys.path.insert(0, {str(SCRIPT.parent)!r}); import door\n"
PROBE = (
    DOOR
    + """
import bpy
import numpy as np
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
found = {}
for frame in map(int, sys.argv[3:]):
    bpy.context.scene.frame_set(frame)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for item in bpy.data.objects:
        if item.type != "POINTCLOUD":
            continue
        attributes = item.evaluated_get(depsgraph).data.attributes
        for name, key, kind, width in (("gid", "value", np.int32, 1), ("rgb", "color", np.float32, 4)):
            flat = np.empty(len(attributes[name].data) * width, kind)
            attributes[name].data.foreach_get(key, flat)
            found[f"{frame}/{item.name}/{name}"] = flat.reshape(-1, width)[:, -1]
np.savez(sys.argv[2], **found)
door.end()
"""
)


def fading_scene() -> Scene:
    """Steps, ramps and what is always there, in every order, in both sets."""
    random = np.random.default_rng(3)
    scene = random_scene(static=200, dynamic=200)

    def spans(count: int) -> np.ndarray:
        span = np.sort(random.integers(0, 7, (count, 4)), axis=1).astype(np.float32)
        span[::3, :2], span[1::3, 2:] = -np.inf, np.inf
        span[::5, 1] = span[::5, 0]
        return np.maximum.accumulate(span, axis=1)

    static, dynamic = (replace(part, span=spans(len(part))) for part in (scene.static, scene.dynamic))
    return replace(scene, static=static, dynamic=dynamic)


def run(*command: str) -> None:
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("moved", [False, True])
def test_blender_fades_as_the_core_does(tmp_path, moved):
    scene = fading_scene()
    if moved:
        some = Ids.of(np.concatenate([scene.static.ids[:20], scene.dynamic.ids[:40]]))
        scene = with_operations(scene, Transform(some, translate=(0.1, 0.0, 0.0)))
    path, blend, out = (tmp_path / name for name in ("tiny.f4x", "tiny.blend", "found.npz"))
    write_scene(scene, path)
    run(str(SCRIPT), str(path), str(blend))
    run("-c", PROBE, str(blend), str(out), *map(str, FRAMES))
    found = np.load(out)
    frames = (0,) if moved else FRAMES  # a file that is only opened has no handler that draws other frames apart
    for frame in frames:
        there = {int(g): o for g, o in zip(edited(scene).ids, edited(scene).posed(frame).opacities, strict=True)}
        seen = 0
        for name in found.files:
            if name.startswith(f"{frame}/") and name.endswith("/gid"):
                alphas = found[name.removesuffix("gid") + "rgb"]
                expected = np.array([there[int(g)] for g in found[name]])
                assert np.allclose(alphas, expected, atol=1e-3), (frame, name)
                seen += len(alphas)
        assert seen == len(there)


def test_pink_points_are_those_that_are_there(tmp_path):
    scene = fading_scene()
    write_scene(scene, tmp_path / "scene.f4x")
    script = """
from feature4x.addon.ui.overlay import drawn_rows
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
def drawn(cloud):
    data = cloud.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    return read_attribute(data, "gid")[drawn_rows(data)]
bpy.context.scene.frame_set(3)
arrays["none"] = np.concatenate([drawn(cloud) for cloud in scene_object().clouds])
ops.change_selection(how="ALL")
arrays["all"] = np.concatenate([drawn(cloud) for cloud in scene_object().clouds])
"""
    _, drawn = perform(tmp_path, script)
    posed = scene.posed(3)
    assert not len(drawn["none"]) and 0.1 < (posed.opacities < 1 / 255).mean() < 0.9
    assert set(drawn["all"]) == set(scene.ids[posed.opacities >= 1 / 255])
