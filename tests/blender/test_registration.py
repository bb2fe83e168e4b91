"""The extension registers, imports through its operator, reports a bad file and leaves nothing behind."""

import importlib
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from f4x_core.versions import VERSION

ROOT = Path(__file__).resolve().parents[2]

CHILD = """
import sys
sys.path.insert(0, sys.argv[1] + "/scripts")
import bpy, door
extension = door.load_extension()
ERRORS = (
    (OSError(28, "No space left on device", "a.f4x"), "a.f4x: No space left on device; nothing half-written was left"
     " behind; make room there or choose another place. [F4X-DISK]"),
    (MemoryError("3 GiB"), "The memory does not suffice (3 GiB); use fewer frames or smaller ones. [F4X-MEMORY]"),
)
for _ in range(2):  # registering again after unregistering is what reloading an extension does
    extension.register()
    assert "import_scene" in dir(bpy.ops.f4x)
    try:
        bpy.ops.f4x.import_scene(filepath="/absent/scene.f4x")
    except RuntimeError as error:
        assert "scene.f4x" in str(error) and "Traceback" not in str(error), error
    else:
        raise AssertionError("an absent file was imported")
    for error, said in ERRORS:
        def refuse(*given, **named):
            raise error
        operators = sys.modules["feature4x.addon.operators.importing"]
        kept, operators.import_scene = operators.import_scene, refuse
        try:
            bpy.ops.f4x.import_scene(filepath="/some/scene.f4x")
        except RuntimeError as report:
            assert str(report).strip() == "Error: " + said, report
        else:
            raise AssertionError("an error passed unseen")
        operators.import_scene = kept
    registration = sys.modules["feature4x.addon.registration"]
    Reporting = sys.modules["feature4x.addon.common.wording"].Reporting
    operators = [each for each in registration.CLASSES if issubclass(each, bpy.types.Operator)]
    bare = [each.__name__ for each in operators if not issubclass(each, Reporting)]
    assert len(operators) > 30 and not bare, bare
    extension.unregister()
    assert "import_scene" not in dir(bpy.ops.f4x)
print("REGISTERED TWICE", flush=True)
door.end()
"""


def test_register_import_unregister():
    done = subprocess.run([sys.executable, "-c", CHILD, str(ROOT)], capture_output=True, text=True, timeout=60)
    assert "REGISTERED TWICE" in done.stdout, done.stderr


def test_the_core_inside_blender_is_the_extensions_own():
    """Inside Blender the core is a subpackage: nothing may import an installed `f4x_core`."""
    code = "import sys; sys.path.insert(0, sys.argv[1] + '/scripts'); import door; door.load_extension()\n"
    code += "import feature4x.addon.registration; print('f4x_core' in sys.modules, flush=True); door.end()"
    environment = os.environ | {"PYTHONPATH": ""}
    done = subprocess.run([sys.executable, "-c", code, str(ROOT)], capture_output=True, text=True, env=environment)
    assert done.stdout.strip() == "False", done.stderr


def test_manifest_agrees_with_the_package():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    assert manifest["version"] == VERSION
    assert manifest["id"] == "feature4x" and manifest["blender_version_min"] == "4.5.0"


def test_an_error_that_ends_a_tool_gives_the_window_back_and_a_mistake_stays_one():
    """Blender has no window here, so a tool is asked as it would ask it."""
    sys.path.insert(0, str(ROOT / "scripts"))
    import door

    door.load_extension()
    reporting = importlib.import_module("feature4x.addon.common.wording").Reporting

    class Tool(reporting):
        said, given_back, error = "", [], MemoryError("1 GiB")

        def report(self, kind, text):
            self.said = text

        def let_go(self, context):
            self.given_back.append(context)

        def modal(self, context, event):
            raise self.error

        def execute(self, context):
            raise self.error

    tool = Tool()
    assert tool.execute("window") == {"CANCELLED"} and tool.said.endswith("[F4X-MEMORY]") and not tool.given_back
    assert tool.modal("window", None) == {"CANCELLED"} and tool.given_back == ["window"]
    assert (Tool.execute.__code__.co_argcount, Tool.modal.__code__.co_argcount) == (2, 3)  # as Blender counts them
    Tool.error = ZeroDivisionError()
    with pytest.raises(ZeroDivisionError):
        tool.modal("window", None)
