"""Turn a scene file into a .blend: point clouds, scaffold, camera, ready to play and render.

python scripts/import_scene.py SCENE.f4x OUT.blend
blender -b --factory-startup --python-exit-code 1 -P scripts/import_scene.py -- SCENE.f4x OUT.blend
"""

import argparse
import sys
import tempfile
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
    out = options.out.resolve()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(out))
    except (OSError, RuntimeError) as error:
        reason = refusal(out.parent, options.scene.stat().st_size) or " ".join(str(error).split())
        raise F4xError(
            f"{options.out} cannot be written ({reason}); make room there or choose another place."
        ) from error
    print(f"{options.out}: {root.name} with {len(root.children)} objects")


def refusal(folder: Path, size: int) -> str | None:
    """Why `folder` does not take a file of `size` bytes; None when it does. Blender calls a full disk a missing file."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(size))
            file.flush()
    except OSError as error:
        return error.strerror
    return None


door.run(main)
