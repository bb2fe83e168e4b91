"""Render a scene, or a .blend, to pictures through Blender's camera.

python scripts/render_scene.py SCENE.f4x -o OUT --frames 0:24:4
blender -b --factory-startup --python-exit-code 1 -P scripts/render_scene.py -- SHOT.blend -o OUT --engine CYCLES --exr

blender -b --factory-startup --python-exit-code 1 -P scripts/render_scene.py -- SHOT.blend -o OUT --composite CYCLES

OUT/00000.png …, and with --exr OUT/00000.exr … with all passes that the view layer has, in 32 bits.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door

ENGINES = ("FEATURE4X", "CYCLES", "BLENDER_WORKBENCH")


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="render_scene.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=door.scene, help="name.f4x, splats, or a .blend")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the pictures")
    parser.add_argument(
        "--engine", choices=ENGINES, default=ENGINES[0], help=f"default: {ENGINES[0]}, the exact picture"
    )
    parser.add_argument(
        "--composite",
        choices=("CYCLES", "EEVEE"),
        help="let this engine draw the meshes, merged with the Gaussians by depth",
    )
    parser.add_argument("--frames", metavar="A:B:S", help="first frame, end and step (default: all of the file)")
    parser.add_argument("--percent", type=int, default=100, metavar="P", help="size in percent (default: 100)")
    parser.add_argument("--exr", action="store_true", help="also a multilayer EXR of each frame, with depth and alpha")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> dict[str, Any]:
    """Open the scene, render frame by frame, and report the seconds."""
    options = parse(arguments)
    import bpy
    from feature4x.addon.common.render_settings import save_multilayer, save_png
    from feature4x.addon.render import compositing
    from feature4x.f4x_core.errors import F4xError

    if options.scene.suffix == ".blend":
        door.start_blender()
        door.open_blend(options.scene)
    else:
        door.import_empty(options.scene)
    scene = bpy.context.scene
    if scene.camera is None:
        raise F4xError(f"{options.scene} has no camera; add one in Blender and save it.")
    if not 1 <= options.percent <= 1000:
        raise F4xError(f"--percent {options.percent}: give a number from 1 to 1000.")
    scene.render.engine = options.engine
    if options.composite:
        compositing.set_up(scene, bpy.context.view_layer, options.composite)
    scene.render.resolution_percentage = options.percent
    frames = door.frame_range(options.frames, scene.frame_start, scene.frame_end)
    if options.exr:
        layer = bpy.context.view_layer
        layer.use_pass_z = layer.f4x_passes.alpha = True
    options.output.mkdir(parents=True, exist_ok=True)
    files, seconds = [], []
    for frame in frames:
        scene.frame_set(frame)
        start = time.perf_counter()
        if options.exr:
            files.append(options.output / f"{frame:05d}.exr")
            save_multilayer(scene, files[-1])
        else:
            bpy.ops.render.render()
        seconds.append(round(time.perf_counter() - start, 3))
        files.append(options.output / f"{frame:05d}.png")
        save_png(scene, files[-1])
    return {
        "output": str(options.output),
        "frames": list(frames),
        "files": [file.name for file in files],
        "seconds": seconds,
    }


door.run(main)
