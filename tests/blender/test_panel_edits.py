"""The sidebar's operators in script mode: what they select, show, keep and write is what the core says.

One child does everything a person would, on a small scene with features; the tests look at what it noted down.
"""

import hashlib
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.cli.main import main as f4x
from f4x_core.edit.apply import edited, open_scene
from f4x_core.edit.stack import EditStack, of, with_stack, write_stack
from f4x_core.edit.uncovered import uncovered
from f4x_core.geometry import spherical_harmonics
from f4x_core.query.neighbourhood import grow_selection
from f4x_core.query.prompts import SelectOptions, select_by_prompts, select_by_text
from f4x_core.query.select_config import FollowConfig, SelectConfig
from f4x_core.scene import MADE_UP, read_scene, write_scene

from .artist import perform

FRAME = 3

CHILD = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))

def go(frame):
    bpy.context.scene.frame_set(frame)  # undo makes a new scene of it

go(FRAME)

def note(name):
    told = root().f4x
    shown = scene_object().shown.scene
    noted[name] = dict(selected=told.selected, total=told.total, answer=told.answer, stack=json.loads(root()["f4x_edits"]),
                       saved=scene_object().is_saved, history=[[row.name, row.enabled] for row in told.history],
                       names=[row.name for row in told.names], live=told.live, timed=bool(root().get("f4x_timed")),
                       uncovered=told.uncovered)
    arrays[name + "/ids"] = shown.ids
    arrays[name + "/chosen"] = scene_object().read(".selection")
    visible = {}
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for cloud in scene_object().clouds:
        data = cloud.evaluated_get(depsgraph).data
        if not len(data.points):
            continue
        for attribute in ("gid", "position", "radiance:base", "rotation", "scale"):
            visible.setdefault(attribute, []).append(read_attribute(data, attribute))
    for attribute, parts in visible.items():
        arrays[name + "/" + attribute] = np.concatenate(parts)

note("imported")
noted["nothing selected"] = refused(ops.recolour, rgb=(1, 0, 0))
noted["unknown word"] = refused(ops.query_text, text="unicorn")
ops.query_text(text="square"); note("square")
arrays["score"] = scene_object().read("f4x_score")
for threshold in (0.9, 0.05, 0.5):
    root().f4x.threshold = threshold
    arrays["threshold %g" % threshold] = scene_object().read(".selection")
root().f4x.mode = "ADD"; ops.query_text(text="wall"); note("added")
root().f4x.mode = "SUBTRACT"; ops.query_text(text="square"); note("subtracted")
root().f4x.mode = "INTERSECT"; ops.query_text(text="square"); note("intersected")
root().f4x.mode = "SET"; ops.query_text(text="square")
ops.change_selection(how="GROW", reach=0.4); note("grown")
ops.change_selection(how="INVERT"); note("inverted")
ops.query_text(text="square")
ops.hide(what="OTHERS"); note("isolated")
ops.hide(what="NOTHING"); note("shown")
root().f4x.show_score = True; note("heat")
root().f4x.show_score = False; note("cooled")
ops.query_point(frame=FRAME, at=POINT); note("point")
ops.query_box(frame=FRAME, box=BOX); note("box")

ops.query_text(text="square")
bpy.ops.ed.undo_push(message="before")
ops.recolour(rgb=(0, 1, 0), shading=False); note("recoloured")
bpy.ops.ed.undo_push(message="recolour")
bpy.ops.ed.undo(); note("undone")
bpy.ops.ed.redo(); note("redone")
ops.transform(move=(0.0, 0.0, 0.25), over_time=True, first=1, last=4); note("moved")
go(FRAME + 2); note("moved later")
go(FRAME)
ops.duplicate(offset=(0.3, 0.0, 0.0), time_shift=1.0); note("copied")
ops.name_selection(called="rex")
ops.change_selection(how="NONE")
ops.select_named(called="rex"); note("named")
ops.change_selection(how="NONE")
ops.query_text(text="Rex"); note("asked by name")
noted["unknown name"] = refused(ops.select_named, called="max")
ops.remove(); note("removed")
ops.restore(); note("restored")
ops.history(how="REMOVE", edit_id=root().f4x.history[-1].edit_id)
noted["no sense"] = refused(ops.plan, sentence="make the square bark"); note("refused")
ops.plan(sentence="make rex blue from frame 2"); note("planned")
noted["descriptions"] = [row.description for row in root().f4x.readings]
noted["not seen"] = [root().f4x.readings[0].line_at(frame) for frame in (1, 2, 3)]
ops.drop_plan(); note("dropped")
ops.plan(sentence="make rex blue from frame 2"); ops.apply_plan(); note("applied")
go(1); note("before the span")
go(FRAME)
ops.save_edits(); note("saved")
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
note("opened again")
ops.history(how="TOGGLE", edit_id=1); note("switched off")
"""


def pixel_of_square(scene):
    """A pixel on the middle of the square at FRAME, and a box around it."""
    posed = scene.posed(FRAME)
    pixels, _ = scene.cameras.at(FRAME).project(posed.means[posed.dynamic])
    return tuple(pixels.mean(0).tolist()), (*(pixels.min(0) - 4).tolist(), *(pixels.max(0) + 4).tolist())


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder, what was noted, and the arrays."""
    folder = tmp_path_factory.mktemp("panel")
    plain = labelled_scene()
    scene = replace(plain, extra={MADE_UP: (np.abs(plain.static.means[:, :2]) <= 0.2).all(1)})
    write_scene(scene, folder / "scene.f4x")
    shutil.copy(folder / "scene.f4x", folder / "before.f4x")
    point, box = pixel_of_square(scene)
    constants = f"FRAME, POINT, BOX = {FRAME}, {point}, {box}\n"
    return folder, *perform(folder, constants + CHILD)


@pytest.fixture(scope="module")
def scene(done):
    return read_scene(done[0] / "before.f4x")


def shown(arrays, name, attribute):
    """Values of an attribute of what is visible, by id."""
    order = np.argsort(arrays[f"{name}/gid"])
    return arrays[f"{name}/gid"][order], arrays[f"{name}/{attribute}"][order]


def test_a_text_query_selects_as_the_core_does(done, scene):
    _, noted, arrays = done
    found = select_by_text(scene, ["square"])
    np.testing.assert_array_equal(arrays["square/chosen"], found.chosen)
    np.testing.assert_allclose(arrays["score"], np.where(found.wins, 1, found.scores), atol=1e-6)
    assert 0 < noted["square"]["selected"] == found.chosen.sum() < noted["square"]["total"] == len(found.ids)
    for threshold in (0.9, 0.05, 0.5):
        np.testing.assert_array_equal(arrays[f"threshold {threshold:g}"], arrays["score"] >= np.float32(threshold))


def test_modes_combine(done):
    _, noted, arrays = done
    square, added = arrays["square/chosen"], arrays["added/chosen"]
    assert (added & ~square).any() and (added | ~square).all()
    np.testing.assert_array_equal(arrays["subtracted/chosen"], added & ~square)
    assert not arrays["intersected/chosen"].any() and noted["intersected"]["selected"] == 0


def test_grow_and_invert(done, scene):
    _, noted, arrays = done
    wanted = grow_selection(scene.posed(FRAME).means, arrays["square/chosen"], np.float32(0.4))
    np.testing.assert_array_equal(arrays["grown/chosen"], wanted)
    assert wanted.sum() > arrays["square/chosen"].sum()
    np.testing.assert_array_equal(arrays["inverted/chosen"], ~wanted)
    assert not noted["inverted"]["live"]


def test_words_know_the_names_that_were_given(done):
    _, noted, arrays = done
    assert noted["asked by name"]["selected"] == noted["named"]["selected"] > 0
    np.testing.assert_array_equal(arrays["asked by name/chosen"], arrays["named/chosen"])


def test_hiding_takes_points_out_of_the_evaluated_clouds(done, scene):
    _, _, arrays = done
    assert set(arrays["isolated/gid"]) == set(scene.ids[arrays["square/chosen"]])
    assert set(arrays["shown/gid"]) == set(scene.ids)


def test_the_heat_map_comes_and_goes(done):
    _, _, arrays = done
    for attribute in ("position", "radiance:base", "rotation", "scale"):
        np.testing.assert_array_equal(arrays[f"cooled/{attribute}"], arrays[f"shown/{attribute}"])
    red, _, blue = spherical_harmonics.rgb_from_dc(shown(arrays, "heat", "radiance:base")[1][:, :3]).T
    order = np.argsort(arrays["heat/ids"])
    square = arrays["square/chosen"][order]
    assert (red > 1.5 * blue)[square].all() and (blue > red)[~square].any()


@pytest.mark.parametrize("name", ["point", "box"])
def test_a_click_and_a_box_select_as_the_core_does(done, scene, name):
    chosen, square = done[2][f"{name}/chosen"], done[2]["square/chosen"]
    point, box = pixel_of_square(scene)
    prompt = {"points": [point]} if name == "point" else {"box": box}
    found = select_by_prompts(scene, {FRAME: prompt}, SelectOptions(config=SelectConfig(follow=FollowConfig(lifted=0))))
    np.testing.assert_array_equal(chosen, found.chosen)
    assert (chosen & square).sum() / (chosen | square).sum() > 0.5


def test_undo_takes_an_edit_back_with_its_colours(done):
    _, noted, arrays = done
    assert [len(noted[name]["stack"]) for name in ("recoloured", "undone", "redone")] == [1, 0, 1]
    np.testing.assert_array_equal(arrays["undone/radiance:base"], arrays["cooled/radiance:base"])
    np.testing.assert_array_equal(arrays["redone/radiance:base"], arrays["recoloured/radiance:base"])
    assert noted["recoloured"]["history"] == [["make the square solid lime", True]]
    assert not noted["recoloured"]["timed"] and noted["moved"]["timed"]


@pytest.mark.parametrize(
    ("name", "time"),
    [
        *(("recoloured", 3), ("moved", 3), ("moved later", 5), ("copied", 3), ("removed", 3), ("restored", 3)),
        *(("applied", 3), ("before the span", 1), ("saved", 3), ("opened again", 3), ("switched off", 3)),
    ],
)
def test_what_is_shown_is_what_the_core_makes_of_the_stack(done, name, time):
    folder, noted, arrays = done
    path = folder / "check.f4x"
    header_scene = read_scene(folder / "before.f4x")
    write_scene(replace(header_scene, edits=tuple(noted[name]["stack"])), path)
    posed = edited(read_scene(path)).posed(time)
    there = posed.opacities > 0
    order = np.argsort(posed.ids[there])
    ids, means = shown(arrays, name, "position")
    np.testing.assert_array_equal(ids, posed.ids[there][order])
    np.testing.assert_allclose(means, posed.means[there][order], atol=2e-5)
    _, base = shown(arrays, name, "radiance:base")
    np.testing.assert_allclose(base[:, :3], posed.sh[there][order][:, 0], atol=1e-5)
    np.testing.assert_allclose(base[:, 3], posed.opacities[there][order], atol=1e-6)


def test_a_sentence_is_previewed_dropped_and_applied(done):
    _, noted, arrays = done
    assert noted["descriptions"] and "blue from frame 2 (0.1 s) on" in noted["descriptions"][0]
    assert noted["not seen"] == ["Not seen at frame 1: it changes something from frame 2 on.", "", ""]
    assert np.abs(arrays["planned/radiance:base"] - arrays["refused/radiance:base"]).max() > 0.1
    assert noted["planned"]["stack"] == noted["dropped"]["stack"] == noted["refused"]["stack"]
    np.testing.assert_array_equal(arrays["dropped/radiance:base"], arrays["refused/radiance:base"])
    np.testing.assert_array_equal(arrays["applied/radiance:base"], arrays["planned/radiance:base"])
    assert noted["applied"]["stack"][-1]["said"] == "make rex blue from frame 2"


def test_the_panel_tells_what_edits_bring_to_light(done, scene):
    _, noted, _ = done
    assert noted["recoloured"]["uncovered"] == ""
    for name in ("moved", "removed"):
        told = uncovered(with_stack(scene, EditStack.from_json(noted[name]["stack"], name)))
        assert "it is made up" in str(told)
        assert noted[name]["uncovered"] == f"{told} The pass Unseen of Feature4X's renders draws where."


def test_refusals_are_sentences(done):
    _, noted, _ = done
    for name, word in (
        ("nothing selected", "Nothing is selected"),
        ("unknown word", "unicorn"),
        ("unknown name", "rex"),
        ("no sense", "bark"),
    ):
        assert word in noted[name] and "Traceback" not in noted[name]
    assert "bark" in noted["refused"]["answer"]


def test_saved_is_what_f4x_edit_writes(done, tmp_path):
    """One code path: the same operations by the command line give the same bytes."""
    folder, noted, _ = done
    assert not noted["applied"]["saved"] and noted["saved"]["saved"] and noted["opened again"]["saved"]
    ours = read_scene(folder / "scene.f4x")
    for number, entry in enumerate(noted["saved"]["stack"]):
        plain = {name: value for name, value in entry.items() if name not in ("id", "said", "enabled")}
        (tmp_path / f"{number}.json").write_text(json.dumps(plain))
    path = tmp_path / "cli.f4x"
    shutil.copy(folder / "before.f4x", path)
    for number in range(len(noted["saved"]["stack"])):
        assert f4x(["edit", str(path), "--ops", str(tmp_path / f"{number}.json")]) == 0
    theirs = of(read_scene(path))
    assert [edit.operation for edit in theirs.edits] == [edit.operation for edit in of(ours).edits]
    # The command line was given operations and no sentence: what was said is the one difference there may be.
    write_stack(path, EditStack(tuple(of(ours).edits)))
    assert hashlib.sha256(path.read_bytes()).digest() == hashlib.sha256((folder / "scene.f4x").read_bytes()).digest()


def test_nothing_but_the_stack_is_written(done, scene):
    after = open_scene(done[0] / "scene.f4x", edits=False)
    for part in ("static", "dynamic"):
        for name, values in vars(getattr(scene, part)).items():
            np.testing.assert_array_equal(values, getattr(getattr(after, part), name))
    np.testing.assert_array_equal(scene.scaffold.xyz, after.scaffold.xyz)
