"""Build the Blender extension, feature4x-VERSION.zip, with the compiled kernels of the present sources for the platforms built.

python scripts/build_extension.py [-o DIR] [--target PLATFORM]

With --target, such as linux-x86_64, the zip is for that platform alone. The same sources and libraries make the same bytes.
`blender --command extension build` makes a working one too, but also packs libraries of older sources that lie around.
"""

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
import zipfile
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
    "docs",
    "f4x_core",
    "scripts",
)
"""Of the repository; blender_manifest.toml leaves out more."""
EARLIEST = (1980, 1, 1, 0, 0, 0)
"""Date of every file in the zip: the first one that a zip can name, so that only contents count."""
PLAIN_FILE = 0o100644 << 16
"""Rights of every file in the zip, as zip files keep them."""


def builder() -> Path:
    """Return Blender's own program that builds and validates extensions, in the bpy package."""
    spec = importlib.util.find_spec("bpy")
    folder = Path(spec.origin).parent if spec is not None and spec.origin else ROOT
    found = sorted(folder.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not found:
        sys.exit("This Python has no bpy; build with Blender itself: blender --command extension build")
    return found[0]


def blender_platform(target: str) -> str:
    """Return the name of a platform of `native.build.TARGETS` in Blender's manifests."""
    return target.replace("x86_64", "x64")


def stage(folder: Path, target: str | None) -> None:
    """Copy what belongs into the zip: of the libraries those of the present sources, for `target` or all that are built."""
    wanted = library_path(target).name if target else f"-{library_path().name.split('-')[1]}-"
    old = [path.name for path in FOLDER.iterdir() if wanted not in path.name] if FOLDER.is_dir() else []
    for part in PARTS:
        source, copy = ROOT / part, folder / part
        if source.is_dir():
            shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__", *old))
        else:
            shutil.copy2(source, copy)
    if target:
        manifest = folder / "blender_manifest.toml"
        text = manifest.read_text(encoding="utf-8")
        line = f'platforms = ["{blender_platform(target)}"]\n\n[permissions]'
        manifest.write_text(text.replace("[permissions]", line), encoding="utf-8")


def reproducible(path: Path) -> None:
    """Write a zip anew in place, its files in the order of their names and without dates and rights of this machine."""
    with zipfile.ZipFile(path) as old:
        contents = sorted((name, old.read(name)) for name in old.namelist() if not name.endswith("/"))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as new:
        for name, content in contents:
            entry = zipfile.ZipInfo(name, EARLIEST)
            entry.compress_type, entry.external_attr, entry.create_system = zipfile.ZIP_DEFLATED, PLAIN_FILE, 3
            new.writestr(entry, content)


def main() -> None:
    """Stage, build and validate the extension; the last line on standard output is JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("."), help="folder of the zip (default: here)")
    parser.add_argument("--target", help="for this platform alone, such as linux-x86_64; its library has to be built")
    args = parser.parse_args()
    output, target = args.output.resolve(), args.target
    output.mkdir(parents=True, exist_ok=True)
    if target and not library_path(target).is_file():
        sys.exit(f"There is no library for {target}: python -m f4x_core.native.build --target {target}")
    command = [sys.executable, str(builder())]
    with tempfile.TemporaryDirectory() as folder:
        stage(Path(folder), target)
        split = ["--split-platforms"] if target else []
        build = [*command, "build", *split, "--source-dir", folder, "--output-dir", str(output)]
        subprocess.run(build, check=True)
    made = max(output.glob("feature4x-*.zip"), key=lambda path: path.stat().st_mtime)
    reproducible(made)
    subprocess.run([*command, "validate", str(made)], check=True)
    present = library_path().name.split("-")[1]  # libraries carry a hash of their sources
    platforms = [target] if target else sorted(path.stem.split("-", 2)[2] for path in FOLDER.glob(f"f4x-{present}-*"))
    print(json.dumps({"output": str(made), "bytes": made.stat().st_size, "kernels": platforms}))


if __name__ == "__main__":
    main()
