"""Compiles the kernels into one shared library with the compiler that is there; standard library only.

`python -m f4x_core.native.build` does it from a shell; with `--target NAME` or `--all` the package ziglang compiles for one
platform or every platform of `TARGETS`. `--all` compiles file by file on all cores, and takes from `--cache DIR` what is there
of the same sources, flags and compiler.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path

from ..errors import F4xError
from .library import FOLDER, ROOM, SOURCES, library_path

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


def compile_command(compiler: list[str], output: Path, inputs: Sequence[Path] = SOURCES) -> list[str]:
    """The whole command line that turns `SOURCES`, or the objects of all of them, into the library `output`."""
    names = [str(path) for path in inputs]
    if Path(compiler[0]).stem.lower() == "cl":
        return [*compiler, "/nologo", "/std:c++17", "/O2", "/EHsc", "/LD", *names, f"/Fe:{output}"]
    flags = [*flags_for(output), "-shared"]
    if output.suffix == ".dylib":  # its name for linkers, otherwise the path of this build's temporary folder
        flags.append(f"-Wl,-install_name,@rpath/{output.name}")
    if "ziglang" in compiler:
        flags.append("-s")  # no symbols: a tenth of the size
    elif output.suffix == ".so":
        flags += ["-static-libgcc", "-static-libstdc++"]  # no C++ runtime to agree on with Blender's
    return [*compiler, *flags, *names, "-o", str(output)]


def flags_for(library: Path) -> list[str]:
    """Flags of GCC, clang and zig for every file of a library."""
    return FLAGS if library.suffix == ".dll" else [*FLAGS, "-fPIC"]


def run_compiler(command: list[str], folder: Path, output: Path) -> None:
    """Run a compiler in `folder`. Raises F4xError, with its first error, where it fails or `output` is not there."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode or not output.is_file():
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
        message = next((line for line in lines if "error" in line), lines[0])
        raise F4xError(f"The native library does not compile with {' '.join(command[:5])}: {message}")


@lru_cache
def zig_version() -> str:
    """The version of the package ziglang. Raises F4xError where it is not installed."""
    if find_spec("ziglang") is None:
        raise F4xError("Only the package ziglang compiles for other platforms: `pip install ziglang`.")
    version = [sys.executable, "-m", "ziglang", "version"]
    return subprocess.run(version, check=True, capture_output=True, text=True).stdout.strip()


def object_of(source: Path, target: str, cache: Path) -> Path:
    """One of `SOURCES` compiled for a platform of `TARGETS`, from `cache` if it is there; returns the object's path.

    The name of an object in `cache` says of what it was made (compiler, flags, source, all headers) and what its bytes are, as two
    hashes, so that neither an old nor a damaged one is taken.
    """
    version = zig_version()
    compiler = find_compiler(target)
    assert compiler is not None
    # zig describes files for debuggers, with the path of this checkout, unless it is told not to.
    command = [*compiler, *flags_for(library_path(target)), "-g0", "-c", source.name]
    made_of = hashlib.sha256("\0".join([version, *command[1:]]).encode())  # without the path of this Python
    for file in (source, *sorted(ROOM.glob("*.hpp"))):
        made_of.update(hashlib.sha256(file.read_bytes()).digest())
    key = made_of.hexdigest()
    for found in cache.glob(f"{key}-*.o"):
        if found.name == object_name(key, found):
            return found
    with tempfile.TemporaryDirectory(dir=cache) as folder:
        output = Path(folder) / "new.o"
        run_compiler([*command, "-o", str(output)], ROOM, output)
        return output.rename(cache / object_name(key, output))


def object_name(key: str, file: Path) -> str:
    """What an object that was made of `key` is called in a cache."""
    return f"{key}-{hashlib.sha256(file.read_bytes()).hexdigest()}.o"


def build(target: str | None = None, objects: Sequence[Path] = ()) -> Path:
    """Make the library of a platform of `TARGETS` (this one) unless it is there; returns its path.

    Args:
        target: platform; None compiles for this one with its own compiler.
        objects: of all `SOURCES` for `target`; without them the sources themselves are compiled.

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
            run_compiler(compile_command(compiler, output, objects or SOURCES), Path(folder), output)
            os.replace(output, library)
    except OSError as error:
        raise F4xError(f"The native library cannot be written to {FOLDER} ({error}); make it writable.") from error
    return library


def build_all(cache: Path) -> list[Path]:
    """Make the libraries of all `TARGETS`, one file or library per core; objects stay in `cache`.

    Raises:
        F4xError: ziglang is missing or fails, or a folder cannot be written.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            missing = [target for target in TARGETS if not library_path(target).is_file()]
            made = [pool.submit(object_of, source, target, cache) for target, source in product(missing, SOURCES)]
            objects = [job.result() for job in made]
            of_target = {target: objects[i * len(SOURCES) :][: len(SOURCES)] for i, target in enumerate(missing)}
            return list(pool.map(lambda target: build(target, of_target.get(target, ())), TARGETS))
    except OSError as error:
        raise F4xError(f"The native libraries cannot be kept in {cache} ({error}); make it writable.") from error


def main() -> int:
    """Build and say where the libraries are; `--quiet` says nothing when all is well."""
    parser = argparse.ArgumentParser(description="Compile the native library.")
    parser.add_argument("--quiet", action="store_true", help="print only failures")
    parser.add_argument("--target", choices=TARGETS, help="for this platform, by the package ziglang")
    parser.add_argument("--all", action="store_true", help=f"for every platform: {', '.join(TARGETS)} (needs ziglang)")
    parser.add_argument("--cache", type=Path, help="with --all: folder of objects for the next time (default: none)")
    args = parser.parse_args()
    try:
        if args.all:
            with tempfile.TemporaryDirectory() as folder:
                paths = build_all((args.cache or Path(folder)).resolve())
        else:
            paths = [build(args.target)]
    except F4xError as error:
        hint = "" if args.all else " The torch backend serves instead."
        print(f"native library: {error}{hint}", file=sys.stderr)
        return 2
    if not args.quiet:
        print(*paths, sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
