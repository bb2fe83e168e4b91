"""Turn a scene file into a .blend: point clouds, scaffold, camera, ready to play and render.

python scripts/import_scene.py SCENE.f4x OUT.blend
blender -b --factory-startup --python-exit-code 1 -P scripts/import_scene.py -- SCENE.f4x OUT.blend
"""

import argparse
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door


def main(arguments: list[str]) -> dict[str, Any]:
    """Import one scene and save it."""
    parser = argparse.ArgumentParser(prog="import_scene.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=door.scene, help="name.f4x, or splats: .ply, .splat, numbered .ply files")
    parser.add_argument("out", type=Path, help=".blend file to write")
    options = parser.parse_args(arguments)
    root = door.import_empty(options.scene)
    size = options.scene.stat().st_size
    door.save_blend(options.out, size)
    return {"output": str(options.out), "scene": root.name, "objects": len(root.children)}


door.run(main)
