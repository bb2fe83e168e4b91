"""Description of the machine that figures come from."""

from __future__ import annotations

import hashlib
import os
import platform
from functools import cache
from pathlib import Path

from f4x_core import __version__

CPU_FILE = Path("/proc/cpuinfo")
ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("f4x_core", "benchmarks")
SOURCES = ("*.py", "*.cpp", "*.hpp")


def describe_machine() -> dict[str, str | int]:
    """Processor, cores, system, and the versions that a figure depends on."""
    import numpy
    import torch

    from f4x_core.native import instruction_set, open_library

    library, reason = open_library()
    return {
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": numpy.__version__,
        "torch": torch.__version__,
        "kernels": instruction_set(library) if library is not None else reason,
        "feature4x": __version__,
    }


@cache
def digest_source() -> str:
    """Short hash of both packages' source when first asked: figures with another one were measured by other code."""
    digest = hashlib.sha256()
    for file in sorted(file for name in PACKAGES for pattern in SOURCES for file in (ROOT / name).rglob(pattern)):
        digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:12]


def _processor() -> str:
    if CPU_FILE.is_file():
        for line in CPU_FILE.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
