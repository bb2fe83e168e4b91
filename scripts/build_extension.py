"""Build the Blender extension, feature4x-VERSION.zip, with the compiled kernels of the present sources for the platforms built.

python scripts/build_extension.py [-o DIR]

`blender --command extension build` makes a working one too, but also packs libraries of older sources that lie around.
"""

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from f4x_core.native.library import FOLDER, library_path

ROOT = Path(__file__).resolve().parents[1]
PARTS = (
    "__init__.py",
    "blender_manifest.toml",
    "pyproject.toml",
    "LICENSE",
    "README.md",
    "addon",
    "f4x_core",
    "scripts",
)
"""Of the repository; blender_manifest.toml leaves out more."""


def builder() -> Path:
    """Blender's own program that builds and validates extensions, in the bpy package."""
    spec = importlib.util.find_spec("bpy")
    folder = Path(spec.origin).parent if spec is not None and spec.origin else ROOT
    found = sorted(folder.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not found:
        sys.exit("This Python has no bpy; build with Blender itself: blender --command extension build")
    return found[0]


def main() -> None:
    """Stage, build, validate; the last line on standard output is JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("."), help="folder of the zip (default: here)")
    output = parser.parse_args().output.resolve()
    output.mkdir(parents=True, exist_ok=True)
    present = library_path().name.split("-")[1]  # libraries carry a hash of their sources
    old = [path.name for path in FOLDER.iterdir() if f"-{present}-" not in path.name] if FOLDER.is_dir() else []
    with tempfile.TemporaryDirectory() as folder:
        for part in PARTS:
            source, copy = ROOT / part, Path(folder) / part
            if source.is_dir():
                shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__", *old))
            else:
                shutil.copy2(source, copy)
        command = [sys.executable, str(builder())]
        subprocess.run([*command, "build", "--source-dir", folder, "--output-dir", str(output)], check=True)
    made = max(output.glob("feature4x-*.zip"), key=lambda path: path.stat().st_mtime)
    subprocess.run([*command, "validate", str(made)], check=True)
    platforms = sorted(path.stem.split("-", 2)[2] for path in FOLDER.glob(f"f4x-{present}-*"))
    print(json.dumps({"output": str(made), "bytes": made.stat().st_size, "kernels": platforms}))


if __name__ == "__main__":
    main()
