"""Turn a scene file into a .blend: point clouds, scaffold, camera, ready to play and render.

python scripts/import_scene.py SCENE.f4x OUT.blend
blender -b --factory-startup --python-exit-code 1 -P scripts/import_scene.py -- SCENE.f4x OUT.blend
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door


def main(arguments: list[str]) -> None:
    """Import one scene and save it."""
    parser = argparse.ArgumentParser(prog="import_scene.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="scene file, name.f4x")
    parser.add_argument("out", type=Path, help=".blend file to write")
    options = parser.parse_args(arguments)
    import bpy
    from feature4x.addon.import_scene import import_scene
    from feature4x.f4x_core.errors import F4xError

    bpy.ops.wm.read_factory_settings(use_empty=True)
    root = import_scene(options.scene)
    bpy.context.scene.render.engine = "CYCLES"  # the one engine that also works without a display
    bpy.context.scene.cycles.samples = 16
    try:
        options.out.resolve().parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(options.out.resolve()))
    except (OSError, RuntimeError) as error:
        raise F4xError(f"{options.out} cannot be written ({error}); choose another place.") from error
    print(f"{options.out}: {root.name} with {len(root.children)} objects")


door.run(main)
