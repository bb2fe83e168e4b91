"""The built zip in a real Blender: installed in a clean profile, enabled, rendered with, and the scripts beside it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.edit.apply import base_of, open_scene, with_operations
from f4x_core.edit.operations import Transform
from f4x_core.edit.selects import Moving
from f4x_core.scene import write_scene
from f4x_core.scene.view import render
from scripts.real_blender import Profile, clean_profile

pytestmark = [pytest.mark.real, pytest.mark.blender]
cv2 = pytest.importorskip("cv2")
REPOSITORY = Path(__file__).resolve().parents[2]
FRAME = 3

# Run in Blender with the extension that is installed there; the last line is JSON.
USE = """
import bpy, importlib.util, json, sys
import addon_utils
name = "bl_ext.user_default.feature4x"
home = sys.argv[-1]
def handlers():
    kinds = (getattr(bpy.app.handlers, kind) for kind in dir(bpy.app.handlers))
    return sum(len(kind) for kind in kinds if isinstance(kind, list))
def there():
    engines = [engine.__name__ for engine in bpy.types.RenderEngine.__subclasses__()]
    return [name in bpy.context.preferences.addons, hasattr(bpy.types, "F4X_PT_ask"), handlers(),
            "import_scene" in dir(bpy.ops.f4x), bpy.types.RenderEngine.bl_rna_get_subclass_py("FEATURE4X") is not None]
on, states = there(), []
for _ in range(10):
    addon_utils.disable(name, default_set=True)
    off = there()
    addon_utils.enable(name, default_set=True)
    states.append([off, there()])
for item in list(bpy.data.objects):
    bpy.data.objects.remove(item)
refused = ""
try:
    bpy.ops.f4x.import_scene(filepath=home + "/broken.f4x")
except RuntimeError as error:
    refused = str(error)
bpy.ops.f4x.import_scene(filepath=home + "/scene.f4x")
scene_object = sys.modules[name + ".addon.scene.scene_object"].SceneObject.of(bpy.context.object)
root = scene_object.root
bpy.ops.f4x.query_text(text="square")
bpy.ops.f4x.recolour(rgb=(0.0, 1.0, 0.0))
bpy.ops.f4x.save_edits()
# the core draws over black, and rounds
bpy.context.scene.world, bpy.context.scene.render.dither_intensity = None, 0
bpy.ops.wm.save_as_mainfile(filepath=home + "/scene.blend")
others = [other for other in ("torch", "scipy", "cv2", "PIL", "av", "OpenEXR") if importlib.util.find_spec(other)]
print(json.dumps(dict(on=on, states=states, refused=refused, others=others, selected=root.f4x.selected,
                      edits=len(root.f4x.history), core="f4x_core" in sys.modules,
                      found=sys.modules[name].__file__, points=sum(len(c.data.points) for c in scene_object.clouds))))
"""


def run(profile: Profile, *command, code: int = 0) -> str:
    """What a command in the system says on standard output; it must end with this exit code."""
    done = subprocess.run(
        profile.command(*command), capture_output=True, text=True, env=profile.environment, timeout=120
    )
    assert done.returncode == code and "Traceback" not in done.stderr, done.stdout + done.stderr
    return done.stdout


def door(profile: Profile, name: str, *arguments, code: int = 0) -> dict:
    """What a script that runs in Blender says last."""
    script = f"{profile.inside}/feature4x/scripts/{name}"
    blender = ("blender", "-b", "--factory-startup", "--python-exit-code", "1", "-P", script, "--")
    return last_json(run(profile, *blender, *arguments, code=code))


def last_json(said: str) -> dict:
    """The last JSON object among lines; Blender may say good-bye after it."""
    return json.loads([line for line in said.splitlines() if line.startswith("{")][-1])


def pictures(profile: Profile, name: str) -> np.ndarray:
    """Render the saved file with the installed extension's engine; (H,W,3) RGB of frame FRAME."""
    output = f"{profile.inside}/{name}_####"
    run(profile, "blender", "-b", f"{profile.inside}/scene.blend", "-E", "FEATURE4X", "-o", output, "-f", FRAME)
    return cv2.imread(str(profile.folder / f"{name}_{FRAME:04d}.png"))[..., ::-1]


@pytest.fixture(scope="module")
def profile(blender_root):
    with clean_profile(blender_root) as profile:
        write_scene(labelled_scene(), profile.folder / "scene.f4x")
        (profile.folder / "broken.f4x").write_bytes(b"no scene")
        yield profile


@pytest.fixture(scope="module")
def told(profile) -> dict:
    """The extension is built, validated, installed and used once."""
    command = [sys.executable, str(REPOSITORY / "scripts/build_extension.py"), "-o", str(profile.folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    archive = f"{profile.inside}/{Path(last_json(done.stdout)['output']).name}"
    extension = ("blender", "--command", "extension")
    assert "Success" in run(profile, *extension, "validate", archive)
    run(profile, *extension, "install-file", "-r", "user_default", "-e", archive)
    (profile.folder / "use.py").write_text(USE)
    script = f"{profile.inside}/use.py"
    return last_json(run(profile, "blender", "-b", "--python-exit-code", "1", "-P", script, "--", profile.inside))


def test_installed_extension_works_with_nothing_but_blenders_numpy(profile, told):
    assert told["found"].startswith(f"{profile.inside}/blender/extensions/user_default/feature4x/")
    assert told["others"] == [] and not told["core"]
    scene = labelled_scene()
    assert told["points"] == len(scene.static) + len(scene.dynamic)
    assert told["selected"] == len(scene.dynamic) and told["edits"] == 1
    assert "broken.f4x" in told["refused"] and "Traceback" not in told["refused"]


def test_enabling_ten_times_leaves_what_once_does(told):
    assert told["on"][:2] == [True, True] and told["on"][3:] == [True, True]
    for off, on in told["states"]:
        assert on == told["on"]
        assert off[:2] == [False, False] and off[2] < on[2] and off[3:] == [False, False]


def test_pictures_are_the_cores_twice_and_without_the_compiled_kernels(profile, told):
    first, again = pictures(profile, "first"), pictures(profile, "again")
    assert np.array_equal(first, again)
    scene = open_scene(profile.folder / "scene.f4x")  # with the edit that Blender saved
    expected = render(scene, scene.cameras[FRAME], FRAME, ("rgb",))["rgb"]
    assert len(scene.edits) == 1 and expected.std() > 0.1
    assert np.abs(first / 255 - expected).max() < 1.01 / 255
    built = profile.folder / "blender/extensions/user_default/feature4x/f4x_core/native/_build"
    for library in built.iterdir():
        library.unlink()
    plain = pictures(profile, "plain").astype(int)
    assert np.abs(plain - first).max() <= 1


def test_scripts_end_with_true_exit_codes(profile):
    profile.check_out()
    inside, scene = profile.inside, f"{profile.inside}/asked.f4x"
    write_scene(labelled_scene(), profile.folder / "asked.f4x")
    told = door(profile, "query_scene.py", scene, "--text", "square")
    assert told["chosen"] == len(labelled_scene().dynamic)
    told = door(profile, "edit_scene.py", scene, "--say", "make the square green", "-o", f"{inside}/green.f4x")
    assert len(told["edits"]) == 1
    told = door(profile, "render_scene.py", f"{inside}/green.f4x", "-o", f"{inside}/out", "--frames", "3")
    assert told["files"] == ["00003.png"]
    for name, more in (("query_scene.py", ("--text", "square")), ("render_scene.py", ("-o", f"{inside}/none"))):
        assert "broken.f4x" in door(profile, name, f"{inside}/broken.f4x", *more, code=2)["error"]


@pytest.mark.parametrize("engine", ["FEATURE4X", "CYCLES"])
def test_a_farm_without_the_scene_file_that_an_edit_needs_fails(profile, told, engine):
    moved = with_operations(labelled_scene(), Transform(Moving(), translate=(0.3, 0.0, 0.0), frames=(0.0, 5.0)))
    write_scene(base_of(moved), profile.folder / "moved.f4x")
    (profile.folder / "moved.py").write_text(
        f"import bpy; bpy.ops.f4x.import_scene(filepath='{profile.inside}/moved.f4x')\n"
        f"bpy.ops.wm.save_as_mainfile(filepath='{profile.inside}/moved.blend')"
    )
    run(profile, "blender", "-b", "--python-exit-code", "1", "-P", f"{profile.inside}/moved.py")
    (profile.folder / "moved.f4x").unlink()
    output = f"{profile.inside}/{engine}_####"
    said = run(profile, "blender", "-b", f"{profile.inside}/moved.blend", "-E", engine, "-o", output, "-a", code=1)
    assert "moved.f4x cannot be read" in said and not list(profile.folder.glob(f"{engine}_*"))
