"""Gestures without a window: the operators with explicit coordinates over what the scene's camera sees, as scripts call them."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import HEIGHT, labelled_scene

from f4x_core.query.gesture import View, select_by_gesture, select_by_sphere
from f4x_core.query.shapes import Polygon, Rectangle, Stroke
from f4x_core.scene import write_scene

from .artist import opened_at, perform

FRAME = 3
START = f"""{opened_at(FRAME)}
def keep(name):
    arrays[name] = scene_object().read(".selection")
def way(places):
    return [{{"name": "", "loc": (float(x), {HEIGHT} - float(y)), "time": 0}} for x, y in places]
"""


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


@pytest.fixture
def folder(tmp_path, scene):
    write_scene(scene, tmp_path / "scene.f4x")
    return tmp_path


def square_of(scene):
    """(left, top, right, bottom) around the square at FRAME, in pixels of the clip."""
    posed = scene.posed(FRAME)
    pixels, _ = scene.cameras.at(FRAME).project(posed.means[posed.dynamic])
    return (*(pixels.min(0) - 3).tolist(), *(pixels.max(0) + 3).tolist())


def test_drawn_gestures_select_what_the_core_selects(folder, scene):
    """Pixels of the camera's picture are those of the clip; a turned and shrunk scene looks the same from its own camera."""
    left, top, right, bottom = square_of(scene)
    lasso = [(left, top), (right, top), (right, bottom), ((left + right) / 2, (top + bottom) / 2), (left, bottom)]
    stroke, radius = [(left, bottom), ((left + right) / 2, top)], 4.0
    shapes = {"box": Rectangle((left, top), (right, bottom)), "lasso": Polygon(lasso), "brush": Stroke(stroke, radius)}
    script = f"""
for through in (False, True):
    ops.select_box(box=({left}, {HEIGHT - top}, {right}, {HEIGHT - bottom}), through=through); keep(f"box {{through}}")
    ops.select_lasso(path=way({lasso}), through=through); keep(f"lasso {{through}}")
    ops.select_brush(path=way({stroke}), radius={radius}, through=through); keep(f"brush {{through}}")
root().f4x.through = True
ops.select_lasso(path=way({lasso})); keep("as the panel says")
root().scale, root().location = (0.5, 0.5, 0.5), (1.0, 2.0, 3.0)
ops.select_lasso(path=way({lasso})); keep("elsewhere")
noted["refused"] = refused(ops.select_lasso, path=way({lasso[:2]}))
"""
    noted, arrays = perform(folder, START + script)
    view = View(scene.cameras.at(FRAME), FRAME)
    for name, shape in shapes.items():
        for through in (False, True):
            expected = select_by_gesture(scene, view, shape, through=through).chosen
            assert expected.any() and not expected.all()
            assert (arrays[f"{name} {through}"] == expected).mean() > 0.995, name  # the camera went through float32
    np.testing.assert_array_equal(arrays["as the panel says"], arrays["lasso True"])
    assert (arrays["elsewhere"] == arrays["lasso True"]).mean() > 0.995  # centres on the line itself
    assert "three corners" in noted["refused"]


def test_a_stroke_selects_the_whole_thing(folder, scene):
    left, top, right, bottom = square_of(scene)
    x, y = (left + right) / 2, (top + bottom) / 2
    script = f"""
stroke = way({[(x - 2, y), (x + 2, y)]})
ops.select_brush(path=stroke, radius=2.0); keep("stroke")
ops.select_brush(path=stroke, radius=2.0, whole=True); keep("thing")
"""
    _, arrays = perform(folder, START + script)
    count = len(scene.static)
    assert 0 < arrays["stroke"].sum() < len(scene.dynamic)
    assert arrays["thing"][count:].all() and not arrays["thing"][:count].any()


def test_modes_combine_and_a_sphere_follows_its_handles(folder, scene):
    left, top, right, bottom = square_of(scene)
    box = f"box=({left}, {HEIGHT - top}, {right}, {HEIGHT - bottom})"
    script = f"""
from mathutils import Vector
place = lambda row: root().matrix_world @ Vector(scene_object().shown.scene.posed({FRAME}).means[row].tolist())
ops.select_box({box}, through=True); keep("box")
ops.select_sphere(centre=place(-1), radius=0.16); keep("sphere")
ops.select_box({box}, through=True, mode="SUBTRACT"); keep("rest")
ops.select_sphere(centre=place(0), radius=0.21); keep("corner")
ops.select_sphere(centre=place(-1), radius=0.16, mode="ADD"); keep("both")
root().f4x.sphere_radius = 0.05; keep("smaller")
root().f4x.sphere = place(-5); keep("moved")
noted["refused"] = refused(ops.select_sphere, centre=(0, 0, 0), radius=0)
noted["sphere"] = root().f4x.sphere_radius
"""
    noted, arrays = perform(folder, START + script)
    view, means = View(scene.cameras.at(FRAME), FRAME), scene.posed(FRAME).means
    sphere = [select_by_sphere(scene, view, means[row], radius).chosen for row, radius in ((-1, 0.16), (0, 0.21))]
    np.testing.assert_array_equal(arrays["sphere"], sphere[0])
    np.testing.assert_array_equal(arrays["rest"], sphere[0] & ~arrays["box"])
    np.testing.assert_array_equal(arrays["both"], sphere[0] | sphere[1])
    for name, row in (("smaller", -1), ("moved", -5)):
        small = select_by_sphere(scene, view, means[row], 0.05).chosen
        assert 0 < small.sum() < sphere[0].sum()
        np.testing.assert_array_equal(arrays[name], sphere[1] | small)
    assert "radius" in noted["refused"] and noted["sphere"] == pytest.approx(0.05)


def test_bars_and_heat_map_are_those_of_the_selection(folder, scene):
    left, top, right, bottom = square_of(scene)
    script = f"""
def seen():
    return [root().f4x.show_score, sum(json.loads(root().f4x.histogram or "[]")), len(np.unique(colors()))]
def colors():
    return np.concatenate([values(cloud, "radiance:base")[:, :3] for cloud in scene_object().clouds]).round(3)
ops.query_text(text="square")
root().f4x.show_score = True
before = colors()
ops.select_box(box=({left}, {HEIGHT - bottom}, {right}, {HEIGHT - top}))
noted["gesture"] = [bool((colors() != before).any()), seen()[1]]
ops.plan(sentence="select what moves")
noted["words"] = seen()[:2]
"""
    noted, _ = perform(folder, START + script)
    assert noted["gesture"] == [True, len(scene.ids)]  # the gesture's own
    assert noted["words"] == [False, 0]


@pytest.mark.parametrize("features", [True, False])
def test_a_thing_of_a_scene_without_features_is_said_to_be_a_piece(folder, scene, features):
    if not features:
        write_scene(replace(scene, features=None), folder / "scene.f4x")
    left, top, right, bottom = square_of(scene)
    x, y = (left + right) / 2, (top + bottom) / 2
    script = f"""
ops.select_brush(path=way({[(x - 2, y), (x + 2, y)]}), radius=2.0)
noted["stroke"] = root().f4x.found
ops.select_brush(path=way({[(x - 2, y), (x + 2, y)]}), radius=2.0, whole=True)
noted["thing"] = root().f4x.found
ops.query_point(frame={FRAME}, at=({x}, {y}))
noted["pick"] = root().f4x.found
"""
    noted, _ = perform(folder, START + script)
    assert noted["stroke"] == "" and noted["thing"] == noted["pick"]
    assert ("no features" in noted["pick"]) != features


def test_what_is_hidden_in_the_viewport_is_not_selected(folder, scene):
    left, top, right, bottom = square_of(scene)
    script = f"""
ops.select_box(box=({left}, {HEIGHT - top}, {right}, {HEIGHT - bottom})); keep("square")
ops.hide(what="SELECTED")
ops.select_box(box=({left}, {HEIGHT - top}, {right}, {HEIGHT - bottom})); keep("behind")
"""
    _, arrays = perform(folder, START + script)
    count = len(scene.static)
    assert arrays["square"][count:].all() and not arrays["behind"][count:].any() and arrays["behind"][:count].sum() > 20


def test_the_tools_are_in_the_toolbar_and_leave_it_again(folder):
    script = """
from bl_ui.space_toolsystem_common import ToolSelectPanelHelper as toolbar
def names():
    tools = toolbar._tool_class_from_space_type("VIEW_3D")._tools["OBJECT"]
    return [tool.idname for tool in toolbar._tools_flatten(tools) if tool is not None and tool.idname.startswith("f4x")]
noted["there"] = names()
sys.modules["feature4x"].unregister()
noted["gone"] = names()
sys.modules["feature4x"].register()
noted["again"] = names()
"""
    noted, _ = perform(folder, script)
    assert noted["there"] == [f"f4x.{name}_tool" for name in ("box", "brush", "lasso", "sphere")]
    assert noted["gone"] == [] and noted["again"] == noted["there"]
