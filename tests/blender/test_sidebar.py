"""The sidebar: what its fields select and say, the list of tasks, the words it shows, and how far aside it warns."""

import importlib
import sys
from pathlib import Path

import pytest
from labelled_scene import labelled_scene

from f4x_core.scene import write_scene

from .artist import perform

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))
import door

WALL, SQUARE = 1120, 81

START = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "scene.f4x"))
state = root().f4x
"""


@pytest.fixture
def folder(tmp_path):
    write_scene(labelled_scene(provenance={"believed_degrees": 10.0}), tmp_path / "scene.f4x")
    return tmp_path


def test_fields_and_sentences_select(folder):
    script = """
for text in ("what moves", "What stands still", "everything", "nothing", "square"):
    ops.query_text(text=text)
    noted[text] = state.selected
for sentence in ("select what moves", "also select the background", "deselect the square", "select nothing"):
    ops.plan(sentence=sentence)
    noted[sentence] = [state.selected, state.answer, len(state.readings), len(state.history)]
ops.plan(sentence="select what moves")
noted["called"] = scene_object().selected_ids.words
noted["edit"] = ops.plan(sentence="make it red") == {"FINISHED"} and state.readings[0].description
"""
    noted, _ = perform(folder, START + script)
    counts = {
        "what moves": SQUARE,
        "What stands still": WALL,
        "everything": WALL + SQUARE,
        "nothing": 0,
        "square": SQUARE,
    }
    assert {text: noted[text] for text in counts} == counts
    for sentence, count in (
        ("select what moves", SQUARE),
        ("also select the background", WALL + SQUARE),
        ("deselect the square", WALL),
        ("select nothing", 0),
    ):
        assert noted[sentence] == [count, f"{count:,} of 1,201 Gaussians selected.", 0, 0], sentence
    assert (
        noted["called"] == "what moves"
        and noted["edit"] == f"make the selection red ({100 * SQUARE / (WALL + SQUARE):.1f} % of the scene's Gaussians)"
    )


def test_a_previewed_removal_counts_as_it_was(folder):
    script = """
from feature4x.addon.edits import listing
ops.query_text(text="square")
for name, act in (("planned", lambda: ops.plan(sentence="remove it")), ("applied", ops.apply_plan)):
    act()
    noted[name] = [*listing.counts(scene_object()), state.selected, state.total]
"""
    noted, _ = perform(folder, START + script)
    assert noted == {"planned": 2 * [SQUARE, WALL + SQUARE], "applied": 2 * [0, WALL]}


def test_words_that_find_nothing_are_explained_in_the_panel(folder):
    script = """
from feature4x.addon.operators import selecting
whole = selecting.by_labels
def none(*given, **named):
    from dataclasses import replace
    return {name: replace(each, scores=0.3 * each.scores, wins=each.wins & False) for name, each in whole(*given, **named).items()}
selecting.by_labels = none
ops.query_text(text="wall")
noted["none"] = [state.selected, state.found]
selecting.by_labels = whole
ops.query_text(text="square")
noted["some"] = [state.selected, state.found]
"""
    noted, _ = perform(folder, START + script)
    count, line = noted["none"]
    assert count == 0 and line.startswith(
        "In the scene 'labelled' nothing is called 'wall' with a probability of 0.5 or more"
    )
    assert noted["some"] == [SQUARE, ""]


def test_empty_fields_show_words_that_the_scene_answers_to(folder):
    script = """
import time
from feature4x.addon.scene import cache
from feature4x.addon.ui.panel import _examples
noted["at first"] = _examples(scene_object())
base = scene_object().base
cache._prepare(base)  # in a window a timer does
end = time.monotonic() + 60
while not cache.answers_of(base) and time.monotonic() < end:
    time.sleep(0.1)
noted["prepared"] = _examples(scene_object())
"""
    noted, _ = perform(folder, START + script)
    assert noted["at first"] == ["what moves", "make what moves red"]
    words, sentence = noted["prepared"]
    assert set(words.split(", ")) <= {"square", "wall"} and words
    assert sentence == f"make the {words.split(', ')[0]} red from second 2"


def test_the_list_of_edits_speaks_of_blenders_axes_and_of_hex_colors(folder):
    script = """
ops.query_text(text="square")
ops.transform(move=(-1.5, 0.25, 0))
ops.recolour(rgb=(0.8933, 0.1, 0.1))
noted["rows"] = [row.name for row in state.history]
"""
    noted, _ = perform(folder, START + script)
    assert noted["rows"] == [
        "move the square by (-1.5, 0.25, 0) units along Blender's X, Y and Z",
        "make the square red (#e41a1a)",
    ]


def test_renders_warn_once_beyond_what_can_be_believed(folder):
    script = """
from feature4x.addon.render import believed
from mathutils import Matrix, Vector
scene, camera, lines = bpy.context.scene, bpy.context.scene.camera, []
camera.animation_data_clear()
def render(degrees, times=1):
    lines.clear()
    for handler in bpy.app.handlers.render_init:
        handler(scene)
    turn = Matrix.Rotation(np.radians(degrees), 4, "Z")
    ahead = Matrix.Rotation(np.pi / 2, 4, "X")
    camera.matrix_world = Matrix.Translation((0, 1, 0)) @ turn @ Matrix.Translation((0, -1, 0)) @ ahead
    bpy.context.view_layer.update()
    for _ in range(times):
        believed.warn(lambda kind, line: lines.append([*kind, line]), bpy.context.evaluated_depsgraph_get())
    return list(lines)
noted["inside"], noted["outside"] = render(9), render(34, times=3)
camera.data.shift_x = 5
noted["not in view"] = render(34)
camera.data.shift_x = 0
root().matrix_world = Matrix.Translation((0.5, 0, 0)) @ root().matrix_world
bpy.context.view_layer.update()
camera.parent = None
noted["moved"] = render(9)
"""
    noted, _ = perform(folder, START + script)
    line = "labelled, frame 0: 34° beside the clip's camera: guesswork (good up to about 10°)"
    assert noted["inside"] == noted["not in view"] == [] and noted["outside"] == [["WARNING", line]]
    assert len(noted["moved"]) == 1  # the scene went away from the camera


def test_a_viewport_is_drawn_while_the_scene_file_is_away(folder):
    script = """
from feature4x.addon.render import believed
noted["there"] = believed.present_of(scene_object())[1]
(folder / "scene.f4x").rename(folder / "away.f4x")
noted["away"] = believed.present_of(scene_object())
"""
    noted, _ = perform(folder, START + script)
    assert noted == {"there": 0, "away": None}


def test_running_tasks_stand_first_and_ended_ones_are_cleared():
    door.load_extension()
    jobs, worker = (importlib.import_module(f"feature4x.addon.jobs.{name}") for name in ("runner", "worker"))
    done = "import json; print(json.dumps({'result': {}}))"
    waits = "import json, time; print(json.dumps({'stage': 'wait', 'done': 0, 'total': 0}), flush=True); time.sleep(60)"
    try:
        for title, code in (("first", done), ("under way", waits), ("last", done)):
            jobs._jobs.append(worker.Job(title, [sys.executable, "-c", code]))
        for job in jobs.all_jobs():
            if job.title != "under way":
                job.wait()
        assert [job.title for job in jobs.in_order()] == ["under way", "last", "first"]
        jobs.clear()
        assert [job.title for job in jobs.all_jobs()] == ["under way"]
    finally:
        jobs.end_all()


def test_the_documentation_comes_as_pages_whose_links_lead_somewhere(tmp_path):
    door.load_extension()
    documentation = importlib.import_module("feature4x.addon.operators.documentation")
    first = documentation.write_pages(tmp_path)
    text = first.read_text(encoding="utf-8")
    assert "<h1" in text and "<table>" in text and "<pre>" not in text.partition("<h1")[0] and "![" not in text
    links = documentation.re.findall(r'href="([^":#]+)', text)
    assert len(links) > 10 and all((tmp_path / link).exists() for link in links), links
    page = documentation.page_html(
        "# A & B\n\n* **one** [x](absent.md) `<b>`\n* two\n\n| a | b |\n|---|---|\n| 1 | 2 |", frozenset()
    )
    assert "A &amp; B</h1>" in page and "<li><b>one</b> x <code>&lt;b&gt;</code>" in page
    assert page.count("<td>") == 4 and "href" not in page


def test_what_other_engines_draw_of_gaussians_is_said_where_they_draw_none(folder):
    script = """
from unittest.mock import MagicMock
from walk_checks import _Context
from feature4x.addon.ui import panel

def lines(engine, splats):
    bpy.context.scene.render.engine, panel.draws_splats = engine, lambda: splats
    drawn = MagicMock()
    panel.F4X_PT_scene.draw(MagicMock(layout=drawn), _Context())
    return str(drawn.mock_calls)

for engine, splats in (("CYCLES", False), ("CYCLES", True), ("FEATURE4X", False)):
    noted[f"{engine} {splats}"] = "draws balls" in lines(engine, splats)
"""
    noted, _ = perform(folder, START + script)
    assert noted == {"CYCLES False": True, "CYCLES True": False, "FEATURE4X False": False}


def test_what_is_typed_is_the_active_scenes_and_no_step_of_undo_of_its_own(folder):
    """Blender makes no steps of fields of a window manager; the operator's step has what was typed."""
    script = """
typed = bpy.context.window_manager.f4x
noted["owner"] = typed.id_data.id_type
from feature4x.addon.ui import properties
called = []
properties.submit = lambda context, root, name: called.append(name)
typed.negatives = "wall"
typed.text, typed.sentence, typed.negatives = "square", "make it red", ""
typed.negatives = "wall"
typed.sentence = " "
noted["called"] = called[:]
typed.sentence = "make it red"
noted["kept"] = [state.text, state.sentence, state.negatives]
bpy.context.view_layer.objects.active = None
bpy.data.objects.remove(root())
typed.text = "nothing is there"
noted["none"] = [typed.text, typed.sentence]
"""
    noted, _ = perform(folder, START + script.replace("root()", "state.id_data"))
    # what is not meant asks again where words are, emptied as well, and says nothing alone
    assert noted.pop("called") == ["query_text", "plan", "query_text", "query_text"]
    assert noted == {"owner": "WINDOWMANAGER", "kept": ["square", "make it red", "wall"], "none": ["", ""]}
