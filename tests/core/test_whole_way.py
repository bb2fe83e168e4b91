"""A scene is written, read, asked, edited and drawn: with numpy and the library alone, on every platform."""

import numpy as np
import pytest
from labelled_scene import labelled_scene

import f4x_core
from f4x_core.scene import write_scene


def test_a_scene_is_read_asked_edited_and_drawn(tmp_path, native_library):
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    scene = f4x_core.read_scene(tmp_path / "scene.f4x")
    assert "square" in f4x_core.ask(scene, "What moves?").text
    assert f4x_core.select(scene, "square").chosen.sum() == len(scene.dynamic)
    edited = f4x_core.edit_scene(scene, "make the square green")
    before, after = (f4x_core.render(each, 1, backend="native") for each in (scene, edited))
    changed = np.abs(after - before).max(-1) > 0.1
    assert 20 < changed.sum() < before.shape[0] * before.shape[1] / 2
    assert before[changed].mean(0).argmax() == 0 and after[changed].mean(0).argmax() == 1
    assert after == pytest.approx(f4x_core.render(edited, 1, backend="plain"), abs=2e-3)
