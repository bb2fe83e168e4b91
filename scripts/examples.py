"""Scenes to look at before a clip of one's own: `python3 scripts/dev.py examples [OUT]`.

For each of `clip.rendered_scenes.EXAMPLES`, OUT (build/examples) then holds NAME.html, which any browser plays; NAME.f4x;
NAME.blend, which finds it beside itself; NAME.jpg, the clip beside what was made of it; and SHA256SUMS. Each is rendered by the
demo's generator and fitted as a clip of one's own would be. The same machine makes the same .f4x again; Blender's files carry
addresses of its memory.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from PIL import Image

from f4x_core.clip.rendered_scenes import EXAMPLES
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.formats.web import write_page

from .release import SUMS, write_sums

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build" / "examples"
"""Folder in which a release looks for them."""
QUALITY = 85
"""Of the JPEG pictures."""


def make(output: Path) -> None:
    """Make all examples in `output`. Raises CalledProcessError where a step failed, after its own words."""
    output.mkdir(parents=True, exist_ok=True)
    (output / SUMS).unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in EXAMPLES:
            # from within the folder: the scene's file tells where its clip lay, and no path of this machine
            run_in(Path(folder), "-m", "f4x_core", "demo", "--scene", name, "-o", name)
            finish(Path(folder) / name, output / f"{name}.f4x")
    write_sums(output)


def run_in(folder: Path, *command: str) -> None:
    """Run a Python command with the modules of this checkout."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, *command], cwd=folder, env=environment, check=True)


def finish(demo: Path, scene: Path) -> None:
    """Write the scene of a demo's folder, and beside it its page, picture and Blender file."""
    named = replace(read_scene(demo / "scene.f4x"), name=scene.stem)  # the demo calls every clip "clip"
    write_scene(named, scene)
    write_page(named, scene.with_suffix(".html"))
    Image.open(demo / "contact_sheet.png").convert("RGB").save(scene.with_suffix(".jpg"), quality=QUALITY)
    blend = scene.with_suffix(".blend").name
    run_in(scene.parent, str(ROOT / "scripts" / "import_scene.py"), scene.name, blend)


def main() -> None:
    """Make them, and say how large they are."""
    parser = argparse.ArgumentParser(prog="dev.py examples", description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path, nargs="?", default=FOLDER, help="folder (default: build/examples)")
    output = parser.parse_args().output.resolve()
    make(output)
    for file in sorted(output.iterdir()):
        print(f"{file}: {file.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
