"""Preferences: which interpreter serves, what Check Setup shows, what Set Up asks for; jobs as Blender's operators start them."""

import sys
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene
from warped_clip import warped_clip

from f4x_core.scene import write_scene
from f4x_core.scene.ply import read_ply

from .artist import perform

Image = pytest.importorskip("PIL.Image")
ROOT = Path(__file__).resolve().parents[2]

# Every test is a Blender of its own, with the extension enabled as far as its preferences are concerned.
START = """
import time
bpy.context.preferences.addons.new().module = "feature4x"
from feature4x.addon.jobs import runner, preferences, worker
settings = preferences.preferences()
"""


def test_which_interpreter_serves_and_what_set_up_asks_for(tmp_path):
    script = """
assert preferences.find_interpreter() is None
assert "Set Up" in refused(ops.check_worker)
bpy.context.preferences.system.use_online_access = False
assert not ops.set_up_worker.poll()
bpy.context.preferences.system.use_online_access = True
said = refused(ops.set_up_worker, python="/bin/true")
assert "/bin/true is no Python" in said, said
assert not preferences.worker_folder().exists()
made = preferences.interpreter_in(preferences.worker_folder())
made.parent.mkdir(parents=True)
made.touch()
assert preferences.find_interpreter() == str(made)
os.environ["F4X_PYTHON"] = "/of/the/environment"
assert preferences.find_interpreter() == "/of/the/environment"
settings.interpreter = "/of/the/preferences"
assert preferences.find_interpreter() == "/of/the/preferences"
assert "/of/the/preferences is missing or cannot be run" in refused(ops.check_worker)
"""
    perform(tmp_path, START + script, BLENDER_USER_RESOURCES=str(tmp_path))


def test_check_setup_shows_versions_and_kernels(tmp_path):
    script = """
settings.interpreter = sys.executable
assert ops.check_worker() == {"FINISHED"}
noted["checked"] = json.loads(settings.checked)
"""
    rows = perform(tmp_path, START + script)[0]["checked"]
    assert rows[0][0] and f"Feature4X 0.1.0 on Python 3.{sys.version_info.minor}" in rows[0][1]
    assert rows[1][0] and rows[1][1].startswith("torch 2.")
    assert "compiled kernels" in rows[2][1]


def test_a_worker_without_torch_is_told(tmp_path):
    """The interpreter has everything but torch: a package of that name that cannot be imported stands in its way."""
    (tmp_path / "torch").mkdir()
    (tmp_path / "torch" / "__init__.py").write_text("raise ModuleNotFoundError(\"No module named 'torch'\")")
    python = tmp_path / "python"
    hide = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); sys.path.insert(1, '')"
    python.write_text(
        f"#!{sys.executable}\n{hide}\nimport importlib.metadata as m, runpy\nversion = m.version\n"
        "def absent(name):\n    if name == 'torch': raise m.PackageNotFoundError(name)\n    return version(name)\n"
        "m.version = absent\nsys.argv = sys.argv[2:]\nrunpy.run_module('f4x_core', run_name='__main__', alter_sys=True)\n"
    )
    python.chmod(0o755)
    code = """
settings.interpreter = sys.argv[3]
said = refused(ops.check_worker)
assert "torch" in said and "Set Up" in said, said
"""
    perform(tmp_path, START + code, python)


# A window's way, by hand: Blender without a window never calls timers, and waits for its jobs instead.
WINDOWED = """
bpy_app = bpy.app
class Windowed:
    background = False
    timers = bpy_app.timers
runner.bpy = type("bpy", (), {"app": Windowed, "context": bpy.context})
"""


def test_jobs_are_looked_after_by_a_timer(tmp_path):
    code = """
talk = "import json, os, sys, time; print(json.dumps({'stage': 'a', 'done': 1, 'total': 2})); sys.stdout.flush(); time.sleep(60)"
job = worker.Job("long", [sys.executable, "-c", talk])
start = time.monotonic()
runner.start(job)
assert time.monotonic() - start < 0.1 and bpy_app.timers.is_registered(runner.tick)
while runner.tick() and job.stage != "a":
    time.sleep(0.02)
assert job.fraction == 0.5 and runner.all_jobs() == (job,)
assert ops.dismiss_job(number=0) == {"FINISHED"}
while runner.tick():
    time.sleep(0.02)
assert job.state == worker.CANCELLED and runner.tick() is None
assert ops.dismiss_job(number=0) == {"FINISHED"} and runner.all_jobs() == ()
assert ops.dismiss_job(number=0) == {"CANCELLED"}
last = worker.Job("last", [sys.executable, "-c", talk])
runner.start(last)
runner.end_all()
assert last.child.poll() is not None and not bpy_app.timers.is_registered(runner.tick)
"""
    perform(tmp_path, START + WINDOWED + code)


def test_a_mistake_after_one_job_leaves_the_timer_to_the_others(tmp_path):
    code = """
talk = "import json, sys, time; time.sleep(float(sys.argv[1])); print(json.dumps({'result': {}}))"
shown = []
wrong = worker.Job("wrong", [sys.executable, "-c", talk, "0"], lambda result: shown.append(result["absent"]))
right = worker.Job("right", [sys.executable, "-c", talk, "1"], shown.append)
runner.start(wrong)
runner.start(right)
while runner.tick():
    time.sleep(0.02)
assert wrong.state == worker.FAILED and "cannot be shown (KeyError: 'absent')" in wrong.error, wrong.error
assert right.state == worker.DONE and shown == [{}]
"""
    perform(tmp_path, START + WINDOWED + code)


def test_the_worker_is_asked_about_the_scene(tmp_path):
    write_scene(labelled_scene(), tmp_path / "labelled.f4x")
    code = """
settings.interpreter = sys.executable
assert not ops.ask_scene.poll()  # there is no scene yet
ops.import_scene(filepath=str(folder / "labelled.f4x"))
bpy.context.scene.frame_set(3)
assert ops.export_scene(filepath=str(folder / "three.ply")) == {"FINISHED"}
assert ops.ask_scene(question="how many frames are there?") == {"FINISHED"}
assert ops.query_text(text="square") == {"FINISHED"}
started, start = [], runner.start
runner.start = lambda job: (started.append(job), start(job))
assert ops.ask_scene(question="what is it?") == {"FINISHED"}
assert "selection is the square (100%)" in started[0].text, started[0].text
assert "did you mean 'square'?" in refused(ops.ask_scene, question="where is the sqaure?")
from types import SimpleNamespace
from unittest.mock import MagicMock
drawn, body = MagicMock(), MagicMock()
drawn.box().panel.return_value, body.panel.return_value = (MagicMock(), body), (MagicMock(), None)
context = SimpleNamespace(region=SimpleNamespace(width=300), preferences=SimpleNamespace(system=SimpleNamespace(ui_scale=1)))
runner._jobs.append(started[1])  # with a window it stays in the list
runner.draw_job(drawn, context, started[1])
runner.dismiss(started[1])
assert "--yes" not in started[1].error + str(body.mock_calls)
assert ops.ask_scene(question=started[1].instead) == {"FINISHED"}
assert "square" in started[2].text and body.operator().question == started[1].instead == "where is the square"
assert "no-teacher" in refused(ops.add_features, teachers="no-teacher")
from feature4x.f4x_core.edit.operations import Recolour
from feature4x.f4x_core.edit.selects import Moving
scene_object = SceneObject.of(None)
scene_object.append(Recolour(Moving(), (0.0, 1.0, 0.0)))
told = refused(ops.query_text, text="unicorn")
assert "does not know unicorn; save its edits" in told and "Traceback" not in told
assert "Type what to select" in refused(ops.query_text, text=" ")
assert "does not exist" in refused(ops.fit_clip, filepath=str(folder / "nowhere.mp4"))
"""
    perform(tmp_path, START + code)
    exported, scene = read_ply(tmp_path / "three.ply"), labelled_scene()
    assert np.abs(exported.means - scene.posed(3.0).means).max() < 1e-5


def test_a_question_needs_no_worker_and_no_saving(tmp_path):
    """Blender's own Python answers, for the scene as it is seen: with edits that are in no file, and nodes that were moved."""
    write_scene(labelled_scene(), tmp_path / "labelled.f4x")
    code = """
from feature4x.addon.jobs.preferences import find_interpreter
from feature4x.f4x_core.edit.operations import Delete
from feature4x.f4x_core.edit.selects import Moving
assert find_interpreter() is None
ops.import_scene(filepath=str(folder / "labelled.f4x"))
started, start = [], runner.start
runner.start = lambda job: (started.append(job), start(job))
assert ops.ask_scene(question="What moves?") == {"FINISHED"}
assert started[0].interpreter == sys.executable and "square" in started[0].text, started[0].text
scene_object = SceneObject.of(None)
scene_object.append(Delete(Moving()))
assert not scene_object.is_saved
assert ops.ask_scene(question="What moves?") == {"FINISHED"}
assert "Nothing moves" in started[1].text, started[1].text
told = refused(ops.ask_scene, question="where is the unicorn?")
assert "unicorn" in told and "[F4X-" in told and "[F4X-INSTALL]" not in told, told
"""
    perform(tmp_path, START + code)


def test_a_job_that_ends_leaves_what_is_being_worked_on(tmp_path):
    for name in ("mine", "fitted"):
        write_scene(labelled_scene(), tmp_path / f"{name}.f4x")
    code = """
from feature4x.addon.operators import tasks
ops.import_scene(filepath=str(folder / "mine.f4x"))
scene_object = SceneObject.of(bpy.context.object)
scene = bpy.context.scene
scene.render.resolution_x, scene.frame_end = 640, 99
ops.query_text(text="square")
before = scene.camera, scene_object.read(".selection")
tasks.import_fitted({"scene": str(folder / "fitted.f4x")})
assert (scene.camera, scene.render.resolution_x, scene.frame_end) == (before[0], 640, 99)
scene_object.attach()  # as after features were added
assert before[1].any() and (scene_object.read(".selection") == before[1]).all()
"""
    perform(tmp_path, START + code)


@pytest.mark.slow
def test_a_fit_is_stopped_goes_on_and_is_imported(tmp_path):
    clip, _ = warped_clip(8)
    (tmp_path / "walk").mkdir()
    for number, frame in enumerate(clip.frames):
        Image.fromarray(frame).save(tmp_path / "walk" / f"{number:03d}.png")
    code = """
settings.interpreter = sys.executable

def fit(stop_at=None):
    done = ops.fit_clip(filepath=str(folder / "walk/000.png"), profile="quick", features=False)
    assert done == {"FINISHED"}
    job = runner.all_jobs()[-1]
    stages, asked, longest = [], None, 0.0
    while True:
        start = time.monotonic()
        going = runner.tick()
        if going is None:
            return job, stages, asked and time.monotonic() - asked, longest
        longest = max(longest, time.monotonic() - start)
        stages += [job.stage] if job.stage not in stages else []
        if asked is None and job.stage == stop_at and job.done > 5:
            asked = time.monotonic()
            ops.dismiss_job(number=len(runner.all_jobs()) - 1)
        time.sleep(0.02)

job, stages, took, longest = fit("photometric")
print(f"stopped after {took:.2f} s; Blender was kept busy for {1000 * longest:.1f} ms at most")
assert job.state == "cancelled" and took < 2 and longest < 0.1
assert os.listdir(str(folder / "walk_4d/checkpoints")) == ["photometric.pt"]
job, again, _, _ = fit()
assert job.state == "done", job.error
assert "flow" in stages and "flow" not in again  # what was finished is not done twice
assert os.path.isfile(str(folder / "walk_4d/scene.f4x")) and "walk" in bpy.data.objects
"""
    perform(tmp_path, START + WINDOWED + code)


def test_imported_scenes_are_drawn_by_the_engine_unless_it_is_not_wanted_or_slow(folder):
    code = """
from feature4x.addon.render import viewport
scene = bpy.context.scene

def engine_after(library, **options):
    viewport.open_library = lambda: (library, "")
    scene.render.engine = "CYCLES"
    ops.import_scene(filepath=str(folder / "scene.f4x"), **options)
    return scene.render.engine

there = object()
assert engine_after(there) == "FEATURE4X"
assert engine_after(there, set_up_render=False) == "CYCLES"
assert engine_after(None) == "CYCLES"
settings.show_exactly = False
assert engine_after(there) == "CYCLES"
"""
    perform(folder, START + code)
