"""Compiles the kernels into one shared library with the compiler that is there; standard library only.

`python -m f4x_core.native.build` does it from a shell; with `--target NAME` or `--all` the package ziglang compiles for one
platform or every platform of `TARGETS`.
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

# Platforms of the extension and what zig calls them, with the oldest C library or system that each has to run on.
TARGETS = {
    "linux-x86_64": "x86_64-linux-gnu.2.28",
    "linux-arm64": "aarch64-linux-gnu.2.28",
    "windows-x86_64": "x86_64-windows-gnu",
    "macos-arm64": "aarch64-macos.11.0",
    "macos-x86_64": "x86_64-macos.11.0",
}
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


def find_compiler(target: str | None = None) -> list[str] | None:
    """Command that starts a C++ compiler: one on the path, else the package ziglang; for a `target` that alone. None without."""
    if target is None:  # what is given away is built by zig alone: the same bytes everywhere, and for old systems too
        for name in COMPILERS:
            if found := shutil.which(name):
                return [found]
    if find_spec("ziglang") is None:
        return None
    zig = [sys.executable, "-m", "ziglang", "c++", "-mcpu=baseline"]
    return zig if target is None else [*zig, "-target", TARGETS[target]]


def compile_command(compiler: list[str], output: Path) -> list[str]:
    """The whole command line that turns `SOURCES` into `output`."""
    sources = [str(source) for source in SOURCES]
    if Path(compiler[0]).stem.lower() == "cl":
        return [*compiler, "/nologo", "/std:c++17", "/O2", "/EHsc", "/LD", *sources, f"/Fe:{output}"]
    flags = list(FLAGS)
    if output.suffix != ".dll":
        flags.append("-fPIC")
    if output.suffix == ".dylib":
        flags.append(f"-Wl,-install_name,@rpath/{output.name}")  # else it holds the path of this build
    if "ziglang" in compiler:
        flags.append("-s")  # no symbols: a tenth of the size
    elif output.suffix == ".so":
        flags += ["-static-libgcc", "-static-libstdc++"]  # no C++ runtime to agree on with Blender's
    if output.suffix == ".dylib":  # its name for linkers, otherwise the path of this build's temporary folder
        flags.append(f"-Wl,-install_name,@rpath/{output.name}")
    return [*compiler, *flags, *sources, "-o", str(output)]


def build(target: str | None = None) -> Path:
    """Compile for a platform of `TARGETS` (this one) unless the library is there already; returns its path.

    Raises:
        F4xError: no compiler is found, it fails, or the folder cannot be written.
    """
    library = library_path(target)
    if library.is_file():
        return library
    compiler = find_compiler(target)
    if compiler is None:
        wanted = "" if target is None else f" for {target}"
        raise F4xError(
            f"The native library cannot be compiled{wanted}: `pip install ziglang`"
            + (f", or install one of {', '.join(COMPILERS)}." if target is None else ".")
        )
    try:
        FOLDER.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=FOLDER) as folder:  # cl also leaves objects beside its output
            output = Path(folder) / library.name
            done = subprocess.run(compile_command(compiler, output), cwd=folder, capture_output=True, text=True)
            if done.returncode or not output.is_file():
                lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
                message = next((line for line in lines if "error" in line), lines[0])
                raise F4xError(f"The native library does not compile with {' '.join(compiler)}: {message}")
            os.replace(output, library)
    except OSError as error:
        raise F4xError(f"The native library cannot be written to {FOLDER} ({error}); make it writable.") from error
    return library


def main() -> int:
    """Build and say where the libraries are; `--quiet` says nothing when all is well."""
    parser = argparse.ArgumentParser(description="Compile the native library.")
    parser.add_argument("--quiet", action="store_true", help="print only failures")
    parser.add_argument("--target", choices=TARGETS, help="for this platform, by the package ziglang")
    parser.add_argument("--all", action="store_true", help=f"for every platform: {', '.join(TARGETS)} (needs ziglang)")
    args = parser.parse_args()
    failed = False
    for target in TARGETS if args.all else [args.target]:
        try:
            path = build(target)
        except F4xError as error:
            hint = "" if args.all else " The torch backend serves instead."
            print(f"native library: {error}{hint}", file=sys.stderr)
            failed = True
            continue
        if not args.quiet:
            print(path)
    return 2 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
