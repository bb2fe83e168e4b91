"""The door for programs: what `import f4x_core` offers, that it loads nothing by itself, and the examples of the documents."""

import os
import re
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import LABELS, VECTORS, labelled_scene
from toy import clip_and_priors

import f4x_core
from f4x_core.clip import write_video
from f4x_core.edit.apply import open_scene
from f4x_core.errors import F4xError
from f4x_core.scene import read_scene, view, write_scene
from f4x_core.scene.field import Vocabulary

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def run(program):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run([sys.executable, "-c", program], cwd=ROOT, env=environment, capture_output=True, text=True)


def known_as(word, **fields):
    """The labelled scene, whose moving square is called by a word."""
    scene = labelled_scene(**fields)
    vocabulary = Vocabulary((word, *LABELS[1:]), VECTORS.astype(np.float16))
    return replace(scene, features=replace(scene.features, vocabularies={"words": vocabulary}))


def test_importing_the_package_loads_nothing_else():
    program = (
        "import sys; before = set(sys.modules)\nimport f4x_core\n"
        "new = set(sys.modules) - before - {'f4x_core.versions'}\n"
        "assert not {name for name in new if name.startswith(('f4x_core.', 'numpy', 'torch'))}\n"
        "assert set(f4x_core.__all__) <= set(dir(f4x_core)) and f4x_core.__version__"
    )
    result = run(program)
    assert result.returncode == 0, result.stderr


def test_scenes_are_drawn_and_edited_with_numpy_alone(tmp_path):
    write_scene(known_as("dog"), tmp_path / "scene.f4x")
    blocked = ("torch", "cv2", "av", "scipy", "PIL", "pycolmap", "bpy", "matplotlib")
    program = f"""
import sys
for name in {blocked!r}:
    sys.modules[name] = None
import f4x_core as f4x
scene = f4x.edit_scene(f4x.read_scene({str(tmp_path / "scene.f4x")!r}), "make the dog green")
assert f4x.select(scene, "dog").chosen.sum() == len(scene.dynamic)
assert "dog" in f4x.ask(scene, "What moves?").text
assert f4x.render(scene, 1, backend="plain").shape == (40, 64, 3)
"""
    result = run(program)
    assert result.returncode == 0, result.stderr


def test_every_name_of_the_door_is_there_and_no_other():
    for name in f4x_core.__all__:
        assert callable(getattr(f4x_core, name)), name
        assert getattr(f4x_core, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'stare'"):
        f4x_core.stare  # noqa: B018
    with pytest.raises(ImportError):
        from f4x_core import stare  # noqa: F401


def test_packages_keep_their_names():
    import f4x_core.edit
    import f4x_core.query

    assert f4x_core.edit.__name__ == "f4x_core.edit" and f4x_core.query.__name__ == "f4x_core.query"
    assert not {"edit", "query"} & set(f4x_core.__all__)


def test_render_draws_the_scene_as_its_own_camera_sees_it():
    scene = labelled_scene()
    image = f4x_core.render(scene, 2)
    assert image.shape == (40, 64, 3) and image.dtype == np.float32
    np.testing.assert_array_equal(image, view.render(scene, scene.cameras[2], 2.0, ("rgb",))["rgb"])
    assert not np.array_equal(image, f4x_core.render(scene, 2.5))
    camera = scene.cameras.at(0).resized(32, 20)
    white = f4x_core.render(scene, 2, camera, background=(1, 1, 1))
    assert white.shape == (20, 32, 3) and (white >= f4x_core.render(scene, 2, camera)).all()


@pytest.mark.parametrize("time", [-1, 6, float("nan")])
def test_a_time_outside_the_clip_is_refused(time):
    with pytest.raises(F4xError, match="within the clip's frames, 0 to 5"):
        f4x_core.render(labelled_scene(), time)


def test_select_finds_what_words_mean():
    scene = known_as("dog")
    dog = f4x_core.select(scene, "dog")
    np.testing.assert_array_equal(dog.chosen, scene.moving)
    assert f4x_core.select(scene, "dog, wall").chosen.all()
    assert f4x_core.select(scene, "dog", "wall", 0.9, span=(1, 2)).span == (1, 2)
    assert not f4x_core.select(scene, "sky", "dog, wall").chosen.any()
    with pytest.raises(F4xError):
        f4x_core.select(scene, " , ")
    with pytest.raises(F4xError):
        f4x_core.select(scene, "dog", threshold=2)


def test_an_edit_leaves_the_scene_as_it_was_and_is_kept_in_the_file(tmp_path):
    scene = known_as("dog")
    red = f4x_core.edit_scene(f4x_core.edit_scene(scene, "make the dog green"), "copy the dog to the left")
    assert len(red.edits) == 2 and not scene.edits
    before, after = f4x_core.render(scene, 1), f4x_core.render(red, 1)
    assert np.abs(after - before).max() > 0.3
    f4x_core.write_scene(red, tmp_path / "red.f4x")
    again = f4x_core.read_scene(tmp_path / "red.f4x")
    np.testing.assert_array_equal(f4x_core.render(again, 1), after)  # the edits of a file are drawn
    np.testing.assert_array_equal(again.static.sh, scene.static.sh)
    assert len(open_scene(tmp_path / "red.f4x").ids) == len(red.ids) > len(scene.ids)
    assert f4x_core.select(again, "dog").chosen.shape == red.ids.shape
    with pytest.raises(F4xError):
        f4x_core.edit_scene(scene, "make the unicorn red")
    with pytest.raises(F4xError):
        f4x_core.edit_scene(scene, "sing")


def test_a_selection_is_what_it_means():
    scene = known_as("dog")
    dyed = f4x_core.edit_scene(scene, "make it green", f4x_core.select(scene, "dog"))
    assert int(dyed.steps[0].chosen.sum()) == len(scene.dynamic)


def examples(name):
    """The Python examples of a document."""
    return EXAMPLE.findall((ROOT / name).read_text(encoding="utf-8"))


def run_example(source):
    """Run an example; returns its variables."""
    variables = {}
    exec(compile(source, "example", "exec"), variables)
    return variables


def test_there_are_four_examples():
    assert [len(examples(name)) for name in ("README.md", "docs/programmers.md", "docs/python.md")] == [1, 1, 2]


def test_the_example_for_programmers_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_scene").mkdir()
    write_scene(known_as("swan", fps=2.0), tmp_path / "my_scene" / "scene.f4x")
    monkeypatch.chdir(tmp_path)
    images = run_example(examples("docs/programmers.md")[0])["images"]
    assert len(list((tmp_path / "gold").glob("*.png"))) == len(images) > 1
    assert len(read_scene("my_scene/golden.f4x").edits) == 1 and "dynamic" in capsys.readouterr().out


def test_the_example_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_scene").mkdir()
    write_scene(known_as("swan", fps=2.0), tmp_path / "my_scene" / "scene.f4x")
    monkeypatch.chdir(tmp_path)
    (source,) = examples("README.md")
    assert len(source.strip().splitlines()) <= 10
    image = run_example(source)["image"]
    assert image.shape == (40, 64, 3) and image.dtype == np.float32
    assert len(read_scene("my_scene/golden.f4x").edits) == 1
    assert "swan" in capsys.readouterr().out


def test_the_example_that_fits_runs(tmp_path, monkeypatch, one_thread):
    clip, _ = clip_and_priors()
    write_video(tmp_path / "my_clip.mp4", clip.frames, clip.fps)
    monkeypatch.chdir(tmp_path)
    short = partial(f4x_core.FitConfig, threads=1)
    monkeypatch.setattr(f4x_core, "FitConfig", lambda steps, **more: short(steps=steps // 40, **more), raising=False)
    images = run_example(examples("docs/python.md")[0])["images"]
    scene = read_scene("my_scene/scene.f4x")
    assert len(images) == len(scene.cameras) == len(list(Path("orbit").glob("*.png"))) == len(clip)
    assert scene.provenance["config"]["steps"] == 30 and images[0].mean() > 0.2


def test_the_example_that_edits_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_scene").mkdir()
    write_scene(known_as("dog"), tmp_path / "my_scene" / "scene.f4x")
    monkeypatch.chdir(tmp_path)
    variables = run_example(examples("docs/python.md")[1])
    assert variables["image"].shape == (200, 320, 3)
    assert len(read_scene("my_scene/edited.f4x").edits) == 2
    out = capsys.readouterr().out
    assert "dog" in out and "unicorn" in out
