"""Baking: a job writes a new scene file whose Gaussians hold the edits, and it is shown where the scene was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ...f4x_core.edit.baking import BakeTask
from ...f4x_core.errors import F4xError
from ..common.point_cloud import select_only
from ..common.undo import end_step
from ..io.import_scene import import_scene
from ..io.render_setup import clip_camera
from ..jobs import runner
from ..scene import cache, clip_time
from ..scene.scene_object import SceneObject, object_of
from .base import SceneOperator
from .exporting import stack_as_seen

TITLE = "Bake"
"""Beginning of the titles of jobs that bake edits."""


class F4X_OT_bake_edits(SceneOperator, bpy.types.Operator, ExportHelper):  # noqa: N801 - Blender wants this form
    """Write the edits into the Gaussians of a new scene file. A job does it; it is listed under Tasks."""

    bl_idname, bl_label = "f4x.bake_edits", "Bake Edits"
    bl_options = {"REGISTER"}  # noqa: RUF012 - the job that it starts is a step of undo when it ends

    filename_ext = ".f4x"
    filter_glob: StringProperty(default="*.f4x", options={"HIDDEN"})  # type: ignore[valid-type]
    show: BoolProperty(  # type: ignore[valid-type]
        name="Show It Instead",
        description="Import the baked scene in place of this one, whose collection is hidden",
        default=True,
    )

    def invoke(self, context, event):
        """Open the file browser with a name beside the scene file."""
        if not self.filepath:
            path = SceneObject.of(context.object).path
            self.filepath = str(path.with_name(f"{path.stem}_baked{self.filename_ext}"))
        return super().invoke(context, event)

    def act(self, context, scene_object):
        """Start the job."""
        stack = stack_as_seen(scene_object)
        if not stack.in_effect:
            raise F4xError(f"{scene_object.name} has no edits in effect, so there is nothing to bake.")
        output = Path(bpy.path.abspath(self.filepath)).with_suffix(self.filename_ext)
        uid, show = scene_object.root.session_uid, self.show

        def done(result: dict[str, Any]) -> None:
            root = object_of(uid)
            if show and root is not None:
                _show_instead(root, output)

        task = BakeTask(str(scene_object.path), cache.text_of(stack), str(output))
        runner.start_task(f"{TITLE} {scene_object.name}", task, done)


def _show_instead(root: bpy.types.Object, path: Path) -> None:
    """Import the scene at `path` where and when the one of `root` is, and hide that one's collection."""
    scene, timing = bpy.context.scene, clip_time.timing_of(root)
    new = import_scene(path, set_up_render=False)
    new.matrix_world = root.matrix_world
    clip_time.place(new, timing.start, timing.rate)
    if scene.camera is not None and scene.camera == clip_camera(root):
        scene.camera = clip_camera(new)
    for collection in root.users_collection:
        if collection != scene.collection:
            collection.hide_viewport = collection.hide_render = True
    select_only(new)
    end_step(F4X_OT_bake_edits.bl_label)


CLASSES = (F4X_OT_bake_edits,)
