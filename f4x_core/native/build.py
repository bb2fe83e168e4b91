"""Compiles the kernels into one shared library with the compiler that is there; standard library only.

`python -m f4x_core.native.build` does it from a shell.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from ..errors import F4xError
from .library import FOLDER, SOURCES, library_path

COMPILERS = ("c++", "g++", "clang++", "cl")
# The kernels set no errno and read no floating-point flags; contraction gives FMA where the target has it. Nothing here
# allows reordering of sums, so results stay reproducible.
FLAGS = [
    "-std=c++17",
    "-O3",
    "-shared",
    "-pthread",
    "-fvisibility=hidden",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-ffp-contract=fast",
    "-Wno-psabi",
]


def find_compiler() -> list[str] | None:
    """Command that starts a C++ compiler: one on the path, else the PyPI package `ziglang`, else None."""
    for name in COMPILERS:
        if found := shutil.which(name):
            return [found]
    if find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "c++", "-mcpu=baseline"]
    return None


def compile_command(compiler: list[str], output: Path) -> list[str]:
    """The whole command line that turns `SOURCES` into `output`."""
    if Path(compiler[0]).stem.lower() == "cl":
        return [*compiler, "/nologo", "/std:c++17", "/O2", "/EHsc", "/LD", *map(str, SOURCES), f"/Fe:{output}"]
    flags = list(FLAGS)
    if sys.platform != "win32":
        flags.append("-fPIC")
    if sys.platform == "linux" and "ziglang" not in compiler:
        flags += ["-static-libgcc", "-static-libstdc++"]  # no C++ runtime to agree on with Blender's
    return [*compiler, *flags, *map(str, SOURCES), "-o", str(output)]


def build() -> Path:
    """Compile unless the library is there already; returns its path.

    Raises:
        F4xError: no compiler is found, it fails, or the folder cannot be written.
    """
    target = library_path()
    if target.is_file():
        return target
    compiler = find_compiler()
    if compiler is None:
        raise F4xError(
            f"The native library cannot be compiled: none of {', '.join(COMPILERS)} is on the path; "
            "install one or `pip install ziglang`."
        )
    try:
        FOLDER.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=FOLDER) as folder:  # cl also leaves objects beside its output
            output = Path(folder) / target.name
            done = subprocess.run(compile_command(compiler, output), cwd=folder, capture_output=True, text=True)
            if done.returncode or not output.is_file():
                lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
                raise F4xError(f"The native library does not compile with {' '.join(compiler)}: {lines[0]}")
            os.replace(output, target)
    except OSError as error:
        raise F4xError(f"The native library cannot be written to {FOLDER} ({error}); make it writable.") from error
    return target


def main() -> int:
    """Build and say where the library is; `--quiet` says nothing when all is well."""
    parser = argparse.ArgumentParser(description="Compile the native library.")
    parser.add_argument("--quiet", action="store_true", help="print only failures")
    quiet = parser.parse_args().quiet
    try:
        path = build()
    except F4xError as error:
        print(f"native library: {error} The torch backend serves instead.", file=sys.stderr)
        return 2
    if not quiet:
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
