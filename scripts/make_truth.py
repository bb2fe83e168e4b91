"""Ground truth of any .blend or .glb seen through a camera: frames, depth, flow, masks, tracks, cameras.

python scripts/make_truth.py WALK.glb OUT --camera auto --frames 0:24 --size 320x180
blender -b --factory-startup --python-exit-code 1 -P scripts/make_truth.py -- SHOT.blend OUT --camera Camera

OUT is what `f4x fit OUT/images --provider synthetic` and `f4x eval --truth OUT` read; files: ground_truth/truth.py.
"""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door

SWEEP = 20.0
"""Degrees that the camera of `--camera auto` goes around the scene during the clip."""
BACK = 2.2
"""Distance of that camera in half diagonals of the scene."""


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="make_truth.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help=".blend, .glb or .gltf")
    parser.add_argument("out", type=Path, help="folder to write; made when absent")
    parser.add_argument(
        "--camera",
        metavar="NAME|FILE.json|auto",
        help="a camera of the file (default: its active one), a camera path file in Blender's world, or one that goes around",
    )
    parser.add_argument("--frames", metavar="A:B", help="first frame and end (default: all of the file)")
    parser.add_argument("--size", metavar="WIDTHxHEIGHT", help="pixels (default: of the file)")
    parser.add_argument("--samples", type=int, default=16, help="Cycles samples per pixel (default: 16)")
    parser.add_argument(
        "--tracks", type=int, default=256, metavar="N", help="points to follow; 0 = none (default: 256)"
    )
    parser.add_argument("--moving", action="append", default=[], metavar="NAME", help="what moves (default: found out)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise and of the places of tracks")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> dict[str, Any]:
    """Open, choose the camera, render."""
    options = parse(arguments)
    door.start_blender()
    import bpy
    from feature4x.f4x_core.errors import F4xError
    from feature4x.ground_truth.truth import TruthSettings, write_truth

    if not options.scene.is_file():
        raise F4xError(f"{options.scene} is not there; give a .blend or a .glb file.")
    if options.samples < 1 or options.tracks < 0:
        raise F4xError("--samples must be at least 1, --tracks at least 0.")
    if options.scene.suffix.lower() in (".glb", ".gltf"):
        import_gltf(options.scene)
    else:
        door.open_blend(options.scene)
    scene = bpy.context.scene
    if options.size:
        width, _, height = options.size.partition("x")
        if not (width.isdigit() and height.isdigit() and int(width) >= 16 and int(height) >= 16):
            raise F4xError(
                f"--size {options.size} is not WIDTHxHEIGHT of at least 16x16; give for example --size 320x180."
            )
        scene.render.resolution_x, scene.render.resolution_y = int(width), int(height)
        scene.render.resolution_percentage = 100
    frames = door.frame_range(options.frames, scene.frame_start, scene.frame_end)
    if frames.step != 1:
        raise F4xError(f"--frames {options.frames}: flow leads from frame to frame; give A:B without a step.")
    choose_camera(scene, options.camera, frames)
    settings = TruthSettings(frames, options.samples, options.tracks, tuple(options.moving), options.seed)
    found = write_truth(options.out, options.scene.stem, scene, settings)
    return {"output": str(options.out), **found}


def import_gltf(path: Path) -> None:
    """Import a glTF file into the empty scene; one without lights gets a sun and a grey sky."""
    import bpy
    from feature4x.f4x_core.errors import F4xError

    bpy.ops.preferences.addon_enable(module="io_scene_gltf2")
    try:
        bpy.ops.import_scene.gltf(filepath=str(path.resolve()))
    except RuntimeError as error:
        raise F4xError(f"{path} cannot be imported ({' '.join(str(error).split())}); give a glTF 2.0 file.") from error
    scene = bpy.context.scene
    scene.frame_start = 0
    ends = [action.frame_range[1] for action in bpy.data.actions]
    scene.frame_end = int(max(ends, default=scene.frame_end))
    for item in [o for o in scene.objects if o.type == "MESH" and not o.visible_get()]:
        bpy.data.objects.remove(item)  # shapes of bones, which the importer keeps in a hidden collection
    if not any(item.type == "LIGHT" for item in scene.objects):
        sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
        sun.data.energy, sun.rotation_euler = 3.0, (math.radians(40), math.radians(-20), 0.0)
        scene.collection.objects.link(sun)
        scene.world = bpy.data.worlds.new("sky")
        scene.world.use_nodes = True
        scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.6, 0.6, 0.6, 1.0)


def choose_camera(scene, wanted: str | None, frames: range) -> None:
    """Make the named camera the active one of the scene. Raises F4xError if there is no camera of that name."""
    import bpy
    from feature4x.f4x_core.errors import F4xError

    cameras = [item for item in scene.objects if item.type == "CAMERA"]
    if wanted is None:
        scene.camera = scene.camera or (cameras[0] if len(cameras) == 1 else None)
        if scene.camera is None:
            names = ", ".join(item.name for item in cameras) or "none"
            raise F4xError(f"The file has no active camera (there: {names}); give --camera NAME, FILE.json or auto.")
    elif wanted == "auto":
        scene.camera = around(scene, frames)
    elif wanted.endswith(".json"):
        scene.camera = along(scene, Path(wanted), frames)
    else:
        scene.camera = next((item for item in cameras if item.name == wanted), None)
        if scene.camera is None:
            names = ", ".join(item.name for item in cameras) or "none"
            raise F4xError(f"--camera {wanted}: the file has no such camera (there: {names}).")
    bpy.context.view_layer.update()


def around(scene, frames: range):
    """Return a camera that goes SWEEP degrees around the scene, looking at its middle."""
    import bpy
    import numpy as np
    from feature4x.addon.render import evaluated
    from feature4x.f4x_core.errors import F4xError
    from mathutils import Vector

    scene.frame_set(frames[0])
    _, surfaces = evaluated.stage(bpy.context.evaluated_depsgraph_get())
    if not surfaces:
        raise F4xError("--camera auto: the scene has no surface to look at.")
    corners = np.concatenate([surface.triangles for surface in surfaces]).reshape(-1, 3)
    middle = Vector((corners.min(0) + corners.max(0)) / 2)
    distance = BACK * float(np.linalg.norm(np.ptp(corners, axis=0))) / 2
    camera = bpy.data.objects.new("around", bpy.data.cameras.new("around"))
    camera.data.lens = 40.0
    camera.rotation_mode = "QUATERNION"
    scene.collection.objects.link(camera)
    for frame in range(frames[0] - 1, frames[-1] + 2):  # the Vector pass looks at both neighbours of a frame
        angle = math.radians(SWEEP) * ((frame - frames[0]) / max(len(frames) - 1, 1) - 0.5)
        away = Vector((math.sin(angle), -math.cos(angle), 0.25)).normalized()
        camera.location = middle + distance * away
        camera.rotation_quaternion = away.to_track_quat("Z", "Y")
        camera.keyframe_insert("location", frame=frame)
        camera.keyframe_insert("rotation_quaternion", frame=frame)
    return camera


def along(scene, path: Path, frames: range):
    """Return a camera that follows a camera path file (OpenCV axes, Blender's world), its times being Blender's frames."""
    import bpy
    import numpy as np
    from feature4x.addon.common.animation import write_action
    from feature4x.addon.common.axes import FLIP_YZ, lens_from_intrinsics
    from feature4x.f4x_core.geometry import pose, quaternion
    from feature4x.f4x_core.geometry.camera import CameraPath

    stored = CameraPath.read(path)
    times = np.arange(frames[0] - 1, frames[-1] + 2, dtype=float)
    cameras = stored.at_times(times)
    scene.render.resolution_x, scene.render.resolution_y = cameras.width, cameras.height
    scene.render.resolution_percentage = 100
    camera = bpy.data.objects.new(path.stem, bpy.data.cameras.new(path.stem))
    camera.data.sensor_fit, camera.rotation_mode = "HORIZONTAL", "QUATERNION"
    scene.collection.objects.link(camera)
    q, centre = pose.from_matrix(np.linalg.inv(cameras.world_to_camera) @ FLIP_YZ)
    write_action(camera, times, {"location": centre, "rotation_quaternion": quaternion.align_sequence(q)})
    lens = lens_from_intrinsics(cameras.intrinsics, cameras.width, cameras.height, camera.data.sensor_width)
    write_action(camera.data, times, lens)
    return camera


door.run(main)
