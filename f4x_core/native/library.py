"""Finds and opens the compiled library. Needs the standard library alone: the build asks here too."""

from __future__ import annotations

import ctypes
import hashlib
import platform
import sys
from functools import lru_cache
from pathlib import Path

ROOM = Path(__file__).parent
FOLDER = ROOM / "_build"
SOURCES = tuple(sorted(ROOM.glob("*.cpp")))
SUFFIXES = {"windows": ".dll", "macos": ".dylib"}  # others: .so


def this_platform() -> str:
    """Return operating system and processor as in library names, for example `linux-x86_64` or `macos-arm64`."""
    system = {"win32": "windows", "darwin": "macos"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "aarch64": "arm64"}.get(machine, machine)
    return f"{system}-{machine}"


@lru_cache  # the sources do not change under a running process, and several kernels ask at every step
def library_path(target: str | None = None) -> Path:
    """Return the library's path for a platform (this one); the name has the hash of the sources, so no old one is used."""
    digest = hashlib.sha256()
    for source in (*SOURCES, *sorted(ROOM.glob("*.hpp")), ROOM / "build.py"):
        digest.update(source.read_bytes().replace(b"\r\n", b"\n"))  # whatever line ends a checkout writes
    target = target or this_platform()
    return FOLDER / f"f4x-{digest.hexdigest()[:16]}-{target}{SUFFIXES.get(target.partition('-')[0], '.so')}"


def open_library() -> tuple[ctypes.CDLL | None, str]:
    """Return the library, or None and the reason why there is none; looked for once per process."""
    return _open(library_path())


@lru_cache
def _open(path: Path) -> tuple[ctypes.CDLL | None, str]:
    if not path.is_file():
        return None, "the library is not built for its present source: run `python -m f4x_core.native.build`"
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        return None, f"{path.name} does not load: {error}"
    # Not by `binder`, which needs numpy: none of these functions takes an array, and the build has to do without.
    library.f4x_instruction_set.restype = ctypes.c_char_p
    library.f4x_peak.restype = ctypes.c_double
    library.f4x_peak.argtypes = [ctypes.c_double]
    library.f4x_shareable_seconds.restype = ctypes.c_double
    return library, ""


def require_library() -> ctypes.CDLL:
    """Return the library, for callers that were chosen because it is there."""
    library, reason = open_library()
    assert library is not None, reason
    return library


def instruction_set(library: ctypes.CDLL) -> str:
    """Return the version of the kernels that this processor runs: `avx512-wide`, `avx512`, `avx2` or `plain`.

    `avx512` and `avx2` are the same to the bit. `avx512-wide` draws the same pictures to the bit with sixteen lanes, where a
    measurement at first use says that they pay; it sums gradients in another order.
    """
    return library.f4x_instruction_set().decode()


def measure_peak(library: ctypes.CDLL, seconds: float = 0.2) -> float:
    """Return the float operations per second of independent multiply-adds on one thread."""
    return library.f4x_peak(seconds)


def shareable_seconds(library: ctypes.CDLL) -> float:
    """Return the processor seconds that callers of all kernels have spent so far on work that threads can share."""
    return library.f4x_shareable_seconds()
