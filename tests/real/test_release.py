"""A finished release as a stranger meets it: a wheel in a new environment, a zip through its repository in a real Blender.

F4X_RELEASE names the folder of `python3 scripts/dev.py release` (dist); F4X_BLENDER_ROOT a system with a Blender.
"""

import ast
import hashlib
import json
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
from labelled_scene import labelled_scene

from f4x_core.clip.rendered_scenes import EXAMPLES
from f4x_core.native.build import TARGETS
from f4x_core.native.library import library_path, this_platform
from f4x_core.scene import read_scene, write_scene
from f4x_core.versions import VERSION
from scripts.build_extension import blender_platform
from scripts.real_blender import clean_profile

pytestmark = pytest.mark.real
REPOSITORY = Path(__file__).resolve().parents[2]
SETUP = ast.parse((REPOSITORY / "setup.py").read_text(encoding="utf-8"))
WHEEL_TAGS = next(
    ast.literal_eval(node.value)
    for node in SETUP.body
    if isinstance(node, ast.Assign) and "WHEEL_TAGS" in ast.dump(node)
)
# Run in Blender with the extension that came through the repository; the last line is JSON.
USE = """
import bpy, json, sys
bpy.ops.f4x.import_scene(filepath=sys.argv[-1] + "/scene.f4x")
name = "bl_ext.ours.feature4x"
native = sys.modules[name + ".f4x_core.native.library"]
print(json.dumps([len(bpy.data.pointclouds), native.library_path().is_file()]))
"""


@pytest.fixture(scope="module")
def release() -> Path:
    folder = Path(os.environ.get("F4X_RELEASE", REPOSITORY / "dist"))
    if not (folder / "SHA256SUMS").is_file():
        pytest.skip(f"{folder} holds no release; python3 scripts/dev.py release makes one")
    return folder


def wheel_of(release: Path, target: str) -> Path:
    return release / f"feature4x_blender-{VERSION}-py3-none-{WHEEL_TAGS[target]}.whl"


def test_the_sums_are_those_of_the_files(release):
    lines = [line.split("  ") for line in (release / "SHA256SUMS").read_text().splitlines()]
    assert {name for _, name in lines} >= {"NOTES.md", "extensions/index.json"}
    assert [name for digest, name in lines if hashlib.sha256((release / name).read_bytes()).hexdigest() != digest] == []


@pytest.mark.parametrize("target", TARGETS)
def test_wheel_and_zip_hold_the_library_of_their_platform_alone(release, target):
    for archive in (
        wheel_of(release, target),
        release / "extensions" / f"feature4x-{VERSION}-{blender_platform(target).replace('-', '_')}.zip",
    ):
        names = zipfile.ZipFile(archive).namelist()
        libraries = [Path(name).name for name in names if "_build/" in name]
        assert libraries == [library_path(target).name], archive.name


def test_the_repository_lists_every_platform_once(release):
    entries = json.loads((release / "extensions" / "index.json").read_text())["data"]
    assert sorted(platform for entry in entries for platform in entry["platforms"]) == sorted(
        map(blender_platform, TARGETS)
    )
    assert {entry["version"] for entry in entries} == {VERSION}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_opens_and_tells_nothing_of_the_machine_that_made_it(release, name):
    files = [release / "examples" / f"{name}{suffix}" for suffix in (".f4x", ".blend", ".html", ".jpg")]
    assert all(0 < file.stat().st_size < 10e6 for file in files)
    scene = read_scene(files[0])
    assert scene.name == name and len(scene.dynamic) > 100
    assert not Path(scene.provenance["source"]).is_absolute()


def test_a_wheel_in_a_new_environment_works(release, tmp_path):
    venv.create(tmp_path / "env", with_pip=True)
    programs = tmp_path / "env" / ("Scripts" if sys.platform == "win32" else "bin")
    pins = ["-c", str(REPOSITORY / "scripts" / "requirements.txt")] if sys.version_info[:2] == (3, 11) else []
    pip = [programs / "python", "-m", "pip", "install", "--quiet", *pins, wheel_of(release, this_platform())]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run(pip, check=True, env=environment, cwd=tmp_path, timeout=1200)
    write_scene(labelled_scene(), tmp_path / "scene.f4x")

    def f4x(*arguments: str) -> str:
        command = [programs / "f4x", *arguments]
        return subprocess.run(
            command, check=True, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300
        ).stdout

    assert f4x("--version").split()[-1] == VERSION
    assert "trusted below" in json.loads(f4x("doctor", "--json"))["native"]["self-check error"]
    assert json.loads(f4x("info", "scene.f4x", "--json"))
    f4x("render", "scene.f4x", "-o", "pictures")
    assert list((tmp_path / "pictures" / "rgb").glob("*.png"))


@pytest.mark.blender
def test_a_zip_through_the_repository_works_in_a_bare_blender(release, blender_root):
    with clean_profile(blender_root) as profile:
        write_scene(labelled_scene(), profile.folder / "scene.f4x")
        (profile.folder / "use.py").write_text(USE)
        served = profile.folder / "served"
        served.mkdir()
        for file in (release / "extensions").iterdir():
            (served / file.name).write_bytes(file.read_bytes())

        def blender(*words: object) -> str:
            done = subprocess.run(
                profile.command("blender", *words), capture_output=True, text=True, env=profile.environment, timeout=180
            )
            assert done.returncode == 0 and "Traceback" not in done.stderr, done.stdout + done.stderr
            return done.stdout

        address = f"file://{profile.inside}/served/index.json"
        blender("--online-mode", "--command", "extension", "repo-add", "--url", address, "ours")
        blender("--online-mode", "--command", "extension", "sync")
        blender("--online-mode", "--command", "extension", "install", "-e", "ours.feature4x")
        said = blender("-b", "--python-exit-code", "1", "-P", f"{profile.inside}/use.py", "--", profile.inside)
        clouds, has_library = json.loads([line for line in said.splitlines() if line.startswith("[")][-1])
        assert clouds >= 1 and has_library
