"""Exporting what is seen, in Blender's own Python: no worker, no saving before."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty
from bpy_extras.io_utils import ExportHelper

from ...f4x_core.edit.exporting import ExportTask
from ...f4x_core.edit.operations import Extract
from ...f4x_core.edit.stack import EditStack
from ...f4x_core.errors import F4xError
from ...f4x_core.scene.formats import DEFAULT, FORMATS, choose_format
from ...f4x_core.scene.formats.usd import expected_bytes
from ..common.axes import BLENDER_FROM_SCENE
from ..common.wording import Reporting
from ..jobs import runner
from ..rig.motion_edits import changes, unwritten
from ..scene import cache
from ..scene.scene_object import SceneObject
from .point_edits import changes_of

AUTO = "auto"
"""The ending of the file's name decides on the format."""
NEEDS = {"points": "trimesh"}
"""Format -> the package that writes it; a format without its package is not offered."""
SUFFIXES = {suffix for entry in FORMATS.values() for suffix in entry.suffixes}

FORMAT_ITEMS = [
    (AUTO, "From File Name", "The extension of the file name decides"),
    *((name, name, entry.keeps) for name, entry in FORMATS.items() if name not in NEEDS or find_spec(NEEDS[name])),
]


def usd_megabytes(scene_object: SceneObject, one_frame: bool) -> float:
    """Return about the size of the scene as USD; its text grows with frames and moving Gaussians. 0 without the scene file."""
    try:
        scene = scene_object.edited
    except F4xError:
        return 0.0
    moments = 1 if one_frame else len(scene.cameras)
    return expected_bytes(len(scene.static), len(scene.dynamic), moments, scene.static.sh.shape[1]) / 1e6


def target_of(path: Path, wanted: str, one_frame: bool) -> tuple[str, Path]:
    """Return (format, file or folder) of an export to `path`: many frames of a format that holds one a file get a folder.

    Raises F4xError for an ending that no format has.
    """
    suffix = path.suffix.lower()
    name = (
        wanted if wanted != AUTO else choose_format(path if suffix else path.with_suffix(f".{DEFAULT}"), None, True)[0]
    )
    entry, bare = FORMATS[name], path.with_suffix("") if suffix in SUFFIXES else path
    if entry.write_clip is None and not one_frame:
        return name, bare
    return name, path if suffix in entry.suffixes else bare.with_name(bare.name + entry.suffixes[0])


def stack_as_seen(scene_object: SceneObject) -> EditStack:
    """Return the pending edits, with nodes and points that were moved or deleted in Blender and are no edits yet."""
    stack = scene_object.stack
    motion = changes(scene_object) if unwritten(scene_object) else None
    for operation in (*((motion,) if motion is not None else ()), *changes_of(scene_object).operations):
        stack = stack.append(operation, "in Blender")
    return stack


def _placed(root: bpy.types.Object) -> list[float] | None:
    """Return the move of the root since import, as a 4x4 matrix in the scene's axes, row by row; None where it was not."""
    matrix = np.linalg.inv(BLENDER_FROM_SCENE) @ np.array(root.matrix_world, np.float64)
    return None if np.allclose(matrix, np.eye(4), atol=1e-6) else matrix.ravel().tolist()


class F4X_OT_export_scene(Reporting, bpy.types.Operator, ExportHelper):  # noqa: N801 - Blender wants this form
    """Export Gaussians for other programs, as they are seen: PLY, .splat, SPZ or glTF of one frame or all, animated USD."""

    bl_idname = "f4x.export_scene"
    bl_label = "Export Feature4X Scene"

    filename_ext = ".ply"
    check_extension = None  # the ending goes with the format, or is a folder's
    format: EnumProperty(  # type: ignore[valid-type]
        name="Format",
        items=FORMAT_ITEMS,
    )
    frames: EnumProperty(  # type: ignore[valid-type]
        name="Frames",
        items=(
            ("CURRENT", "Current Frame", "The frame that is shown"),
            (
                "ALL",
                "All Frames",
                "One animated file, or a folder of numbered files where a format holds one frame a file",
            ),
        ),
    )
    selected_only: BoolProperty(name="Selection Only", description="Export only the selected Gaussians")  # type: ignore[valid-type]
    with_edits: BoolProperty(  # type: ignore[valid-type]
        name="With Edits",
        description="Export what is seen, also where it is not saved yet; else the scene as its file has it, without edits",
        default=True,
    )

    as_placed: BoolProperty(  # type: ignore[valid-type]
        name="As Placed",
        description="Export the scene as it was moved, rotated and scaled in Blender; else where its file has it",
        default=True,
    )

    @classmethod
    def poll(cls, context):
        """Return True if there is an imported scene."""
        if SceneObject.of(context.active_object) is not None:
            return True
        cls.poll_message_set("Import a scene or splats with Feature4X, or select an object of one")
        return False

    def invoke(self, context, event):
        """Open the file browser, unless the scene file is missing or holds something else by now."""
        scene_object = SceneObject.of(context.active_object)
        edited = scene_object.edited
        if not self.filepath:
            beside = Path(bpy.data.filepath).parent if bpy.data.filepath else scene_object.path.parent
            self.filepath = str(beside / f"{edited.name}_export{self.filename_ext}")
        return super().invoke(context, event)

    def check(self, context):
        """Let the ending of the name follow the format."""
        if self.format == AUTO:
            return False
        before, one = self.filepath, self.frames == "CURRENT"
        self.filepath = str(target_of(Path(self.filepath), self.format, one)[1])
        return self.filepath != before

    def draw(self, context):
        """Draw the options, and how large a file of text becomes."""
        layout = self.layout
        layout.use_property_split = True
        for name in ("format", "frames", "selected_only", "with_edits", "as_placed"):
            layout.prop(self, name)
        scene_object = SceneObject.of(context.active_object)
        is_text = self.format == "usd" or (self.format == AUTO and self.filepath.lower().endswith(".usda"))
        if scene_object is not None and is_text:
            size = usd_megabytes(scene_object, self.frames == "CURRENT")
            layout.label(text=f"USD as text: about {size:,.0f} MB", icon="INFO")
        elif scene_object is not None and scene_object.holds_edits and not scene_object.is_saved:
            layout.label(text="Unsaved edits are exported too" if self.with_edits else "Without edits", icon="INFO")

    def execute(self, context):
        """Start the job."""
        scene_object = SceneObject.of(context.active_object)
        one = self.frames == "CURRENT"
        name, output = target_of(Path(bpy.path.abspath(self.filepath)), self.format, one)
        if output.exists() and output.samefile(scene_object.path):
            raise F4xError(f"{output} is the file that {scene_object.name} is read from; choose another name.")
        stack = stack_as_seen(scene_object) if self.with_edits else EditStack()
        if self.selected_only:
            stack = stack.append(Extract(scene_object.selected_ids))
        times = [scene_object.frame] if one else scene_object.base.cameras.times.tolist()
        transform = _placed(scene_object.root) if self.as_placed else None
        task = ExportTask(str(scene_object.path), cache.text_of(stack), times, str(output), name, transform)
        runner.start_task(f"Export {scene_object.name}", task)
        self.report({"INFO"}, f"Exporting to {output}" if not bpy.app.background else f"Exported {output}")
        return {"FINISHED"}


CLASSES = (F4X_OT_export_scene,)
