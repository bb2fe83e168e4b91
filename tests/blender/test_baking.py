"""Baking in the sidebar: a job writes the edits into the Gaussians of a new file, which is shown where the scene was."""

import numpy as np
from labelled_scene import labelled_scene

from f4x_core.edit.apply import open_with
from f4x_core.scene import read_scene

from .artist import perform


def test_a_baked_scene_is_shown_in_place_of_the_edited_one(folder):
    script = """
ops.import_scene(filepath=str(folder / "scene.f4x"))
noted["without edits"] = refused(ops.bake_edits, filepath=str(folder / "baked.f4x"))
old = root()
old.matrix_world.translation = (1, 2, 3)
old.f4x.start_frame = 5
ops.query_text(text="square")
ops.recolour(rgb=(0, 0, 1))
noted["pending"] = old["f4x_edits"]
noted["itself"] = refused(ops.bake_edits, filepath=str(folder / "scene.f4x"))
ops.bake_edits(filepath=str(folder / "alone.f4x"), show=False)
noted["scenes"] = len([item for item in bpy.data.objects if "f4x_path" in item])
ops.bake_edits(filepath=str(folder / "baked.f4x"))
new = bpy.context.object
noted["new"] = new != old and new.visible_get() and not old.visible_get() and new["f4x_path"] == str(folder / "baked.f4x")
noted["edits"] = [len(item.f4x.history) for item in (old, new)]
noted["place"] = [list(new.matrix_world.translation), new.f4x.start_frame]
noted["camera"] = bpy.context.scene.camera.parent == new
bpy.context.view_layer.objects.active = None
from feature4x.addon.scene.scene_object import SceneObject
noted["the visible one"] = SceneObject.of(None).root == new
"""
    noted, _ = perform(folder, script)
    assert "no edits in effect" in noted["without edits"] and "it is the scene itself" in noted["itself"]
    assert noted["scenes"] == 1 and noted["new"] and noted["camera"] and noted["the visible one"]
    assert noted["edits"] == [1, 0] and noted["place"] == [[1, 2, 3], 5]
    baked = read_scene(folder / "baked.f4x")
    assert not baked.edits and not read_scene(folder / "scene.f4x").edits
    edited, plain = open_with(folder / "scene.f4x", noted["pending"]), labelled_scene()
    np.testing.assert_allclose(baked.posed(2.0).sh, edited.posed(2.0).sh, atol=1e-6)
    assert not np.allclose(baked.posed(2.0).sh, plain.posed(2.0).sh, atol=1e-2)
