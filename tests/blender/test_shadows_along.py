"""Remove in the panel takes the shadow along, unless its switch is off; points deleted by hand take nothing along."""

import numpy as np
from test_edit_shadows import MOST, SCENE, SHADOW, SQUARE

from f4x_core.scene import write_scene

from .artist import perform


def test_remove_takes_the_shadow_along(tmp_path):
    write_scene(SCENE, tmp_path / "scene.f4x")
    np.save(tmp_path / "square.npy", SQUARE)
    script = """
from feature4x.addon.edits import marking
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "scene.f4x"))
square = np.load(folder / "square.npy")
for shadow in (True, False):
    marking.combine(scene_object(), square, "SET")
    ops.remove("EXEC_DEFAULT", True, shadow=shadow)
    arrays[f"gone{shadow}"] = scene_object().edited.rows.gone
    noted[f"edit{shadow}"] = root().f4x.history[-1].name
    ops.history(how="CLEAR")
"""
    noted, arrays = perform(tmp_path, script)
    both, alone = arrays["goneTrue"], arrays["goneFalse"]
    np.testing.assert_array_equal(alone, SQUARE)
    assert both[SHADOW].mean() > MOST and not both[~(SQUARE | SHADOW)].any() and both[SQUARE].all()
    assert "with its shadow" in noted["editTrue"] and "shadow" not in noted["editFalse"]
