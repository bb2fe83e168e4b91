"""The scene file `name.f4x`, identity of every Gaussian, posing, export formats and views. Needs numpy alone."""

from .file import append_edit, read_header, read_scene, write_edits, write_scene
from .model import DynamicSet, Posed, Scene, StaticSet

__all__ = [
    "DynamicSet",
    "Posed",
    "Scene",
    "StaticSet",
    "append_edit",
    "read_header",
    "read_scene",
    "write_edits",
    "write_scene",
]
