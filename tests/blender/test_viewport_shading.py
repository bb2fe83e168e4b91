"""The pictures of viewports: a saved .blend opens as it was seen, and *Show Picture* is there wherever it is not."""

import numpy as np

from .artist import perform

START = """
ops.import_scene(filepath=str(folder / "scene.f4x"))
from feature4x.addon.render import viewport
bpy.context.scene.render.engine = "FEATURE4X"

def views():
    return [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]

def shading():
    return [space.shading.type for space in views()]

def save_and_open(**options):
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "a.blend"))
    noted["in memory"] = [viewport.WAS_EXACT in screen for screen in bpy.data.screens]
    bpy.ops.wm.open_mainfile(filepath=str(folder / "a.blend"), **options)

for number, space in enumerate(views()):
    space.shading.type = "RENDERED" if number % 2 else "WIREFRAME"
before = shading()
"""


def test_a_saved_blend_opens_as_it_was_seen(tiny_folder):
    script = """
save_and_open()
noted["same"], noted["shows"] = shading() == before, sorted(set(before))
noted["left"] = [viewport.WAS_EXACT in screen for screen in bpy.data.screens]
views()[0].shading.type = "SOLID"
save_and_open()
noted["again"] = shading() == ["SOLID", *before[1:]]
"""
    noted, _ = perform(tiny_folder, START + script)
    assert noted["same"] and noted["again"] and noted["shows"] == ["RENDERED", "WIREFRAME"]
    assert not any(noted["left"]) and not any(noted["in memory"])


def test_viewports_of_other_engines_and_of_the_session_are_left_alone(tiny_folder):
    """Blender opens no file with the picture of Cycles; without the file's windows those of the session stay."""
    script = """
bpy.context.scene.render.engine = "CYCLES"
save_and_open()
noted["cycles"] = "RENDERED" in shading()
bpy.context.scene.render.engine = "FEATURE4X"
for space in views():
    space.shading.type = "RENDERED"
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "a.blend"))
for space in views():
    space.shading.type = "SOLID"
bpy.ops.wm.open_mainfile(filepath=str(folder / "a.blend"), load_ui=False)
noted["session"] = "RENDERED" in shading()
"""
    noted, _ = perform(tiny_folder, START + script)
    assert not noted["cycles"] and not noted["session"]


def test_the_button_has_words_until_the_picture_is_shown(tiny_folder):
    """A layout that only notes what is drawn into it."""
    script = """
from types import SimpleNamespace
scene, space = bpy.context.scene, views()[0]

class Noted:
    def __init__(self):
        self.drawn = []
    def operator(self, name, text=None, **options):
        self.drawn.append((name, text))

def button():
    layout = Noted()
    viewport._draw_button(SimpleNamespace(layout=layout), SimpleNamespace(scene=scene, space_data=space))
    return layout.drawn

space.shading.type = "SOLID"
noted["solid"] = button()
scene.render.engine = "CYCLES"
noted["cycles"] = button()
scene.render.engine, space.shading.type = "FEATURE4X", "RENDERED"
noted["shown"] = button()
space.shading.type = "SOLID"
for item in list(bpy.data.objects):
    bpy.data.objects.remove(item)
noted["empty"] = button()
"""
    noted, _ = perform(tiny_folder, START + script)
    words = [["f4x.show_picture", None]]  # its own label
    assert noted == {"solid": words, "cycles": words, "shown": [], "empty": []}


def test_the_cameras_picture_fills_the_free_part_of_a_viewport(tmp_path):
    """Blender draws the picture `factor` times as large as the region, moved by twice the offset times that."""
    script = """
from feature4x.addon.render.viewport import FILLED, framing
region = (1148, 870)
for zoom, free in ((0.0, (40, 0, 865, 800)), (25.0, (0, 0, 500, 870)), (-10.0, (300, 100, 1148, 300))):
    factor = ((zoom / 50 + 2**0.5) / 2) ** 2
    sides = np.array([1148, 646]) * factor
    new, offset = framing(zoom, sides, free, region)
    larger = ((new / 50 + 2**0.5) / 2) ** 2
    drawn, middle = np.array([1148, 646]) * larger, np.array(region) / 2 - 2 * larger * np.array(offset) * region
    room = np.subtract(free[2:], free[:2])
    noted[str(zoom)] = [*(middle - np.add(free[:2], free[2:]) / 2), (drawn / room).max() - FILLED]
"""
    noted, _ = perform(tmp_path, script)
    assert len(noted) == 3 and np.abs(list(noted.values())).max() < 1e-6
