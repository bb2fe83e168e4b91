"""Shared by the tests in Blender: their marker, which skips them where Blender's module is absent, and scenes to open."""

from importlib.util import find_spec
from pathlib import Path

import pytest
from labelled_scene import labelled_scene

from f4x_core.scene import write_scene

from .tiny_scene import tiny_scene

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items):
    for item in items:
        if HERE in item.path.parents and getattr(item.module, "NEEDS_BLENDER", True):
            item.add_marker(pytest.mark.blender)
            if find_spec("bpy") is None:
                item.add_marker(pytest.mark.skip("bpy is absent"))


@pytest.fixture
def folder(tmp_path):
    """A folder whose scene.f4x is that of words, with a square that moves before a wall."""
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    return tmp_path


@pytest.fixture
def tiny_folder(tmp_path):
    """A folder whose scene.f4x is the tiny one, with twelve nodes that turn."""
    write_scene(tiny_scene(), tmp_path / "scene.f4x")
    return tmp_path
