"""The scene file `name.f4x`, identity of every Gaussian, posing, export formats and views. Needs numpy alone."""

from .field import FeatureField, FieldHead, Vocabulary
from .file import read_header, read_scene, write_edits, write_scene
from .locking import updating
from .model import EARLIER, MADE_UP, DynamicSet, PosedSplats, Scene, StaticSet

__all__ = [
    "EARLIER",
    "MADE_UP",
    "DynamicSet",
    "FeatureField",
    "FieldHead",
    "PosedSplats",
    "Scene",
    "StaticSet",
    "Vocabulary",
    "read_header",
    "read_scene",
    "updating",
    "write_edits",
    "write_scene",
]
