"""Operators that start jobs: fit a clip, add features, answer a question."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ...f4x_core.errors import F4xError
from ..common.gaussian_attributes import draws_splats
from ..common.lines import CATEGORY
from ..common.point_cloud import selected_in
from ..common.wording import Reporting
from ..edits import display
from ..io.clip_background import find_clip, shown_clip
from ..jobs import runner
from ..jobs.preferences import find_interpreter, worker_python
from ..jobs.worker import RUNNING, Job, core_command
from ..rig.motion_edits import unwritten
from ..scene import cache
from ..scene.scene_object import PATH, SceneObject
from .exporting import stack_as_seen

PROFILES = (
    ("quick", "Quick", "Takes minutes; shows whether a clip is suitable"),
    ("wild", "Thorough", "Takes up to an hour on two cores; better quality"),
)


BESIDE = 4.0
"""World units, median depths of a clip, from an open scene to one that a job adds."""


def start_verb(title: str, on_done: Callable[[dict[str, Any]], None] | None, verb: str, *arguments: Path | str) -> None:
    """Run one verb of `f4x` as a job. Raises F4xError if there is no worker, or without a window if the job fails."""
    runner.start(Job(title, core_command(worker_python(), verb, *arguments), on_done))


def import_fitted(result: dict[str, Any]) -> None:
    """Import the scene of a finished fit. A file that already shows a scene keeps its render size, frames and camera."""
    others = [item for item in bpy.data.objects if PATH in item and item.parent is None]
    alone, view_layer = not others, bpy.context.view_layer
    active, selected = view_layer.objects.active, selected_in(view_layer)
    try:
        bpy.ops.f4x.import_scene(  # True: one step of undo
            "EXEC_DEFAULT", True, filepath=result["scene"], set_up_render=alone, show=alone
        )
    except RuntimeError as error:  # what the operator reported
        raise F4xError(str(error).removeprefix("Error: ").strip()) from error
    if not alone:  # the person goes on where they were, and finds the new scene beside the open ones
        root = view_layer.objects.active
        root.location.x = max(item.matrix_world.translation.x for item in others) + BESIDE
        root.select_set(False)
        for item in selected:
            item.select_set(True)
        view_layer.objects.active = active


def look_up(scene_object: SceneObject, words: Sequence[str]) -> None:
    """Let the worker add `words` to the vocabulary of a scene. Raises F4xError if the scene has unsaved edits."""
    listed = ", ".join(words)
    if not scene_object.is_saved:
        raise F4xError(
            f"{scene_object.name} does not know {listed}; save its edits first, so that the worker can add it to the scene file."
        )
    _add_features(scene_object, scene_object.path, listed, ["--vocabulary", listed])


def _add_features(scene_object: SceneObject, path: Path, words: str, options: list[str]) -> None:
    """Start `f4x distill`; the scene is updated at the end unless it was edited meanwhile. `words` go into the title."""

    def done(result: dict[str, Any]) -> None:
        for each in SceneObject.among(bpy.data.objects):
            if each.path == path and not each.is_linked and each.is_saved:
                each.attach()

    title = f"Features of {scene_object.name}" + (f": {words}" if words else "")
    if any(job.title == title and job.state == RUNNING for job in runner.all_jobs()):
        raise F4xError(f"{title}: this job is already running; wait until it is done.")
    start_verb(title, done, "distill", path, *options)


class _WorkerOperator(Reporting):
    """Base of operators that start a job."""

    def execute(self, context):
        """Start the job."""
        self.start(context)
        return {"FINISHED"}


class SavedSceneOperator(_WorkerOperator):
    """Base of operators on the scene of the active object."""

    @classmethod
    def poll(cls, context):
        """Return True if the active object belongs to a scene."""
        if SceneObject.of(context.active_object) is None:
            cls.poll_message_set("Select an object of an imported Feature4X scene")
            return False
        return True


def saved_scene(context: bpy.types.Context) -> tuple[SceneObject, Path]:
    """Return the active scene and its file. Raises F4xError if it has unsaved edits, because the worker reads only the file."""
    scene_object = SceneObject.of(context.active_object)
    if not scene_object.holds_edits:
        raise F4xError(
            f"The worker reads scene files, and {scene_object.path.name} is none; press Save As Scene first."
        )
    if not scene_object.is_saved:
        raise F4xError(f"{scene_object.name} has unsaved edits; press Save Edits to Scene first.")
    if unwritten(scene_object):
        raise F4xError(
            f"Nodes of {scene_object.name} were moved; press Write Motion Back and Save Edits to Scene first."
        )
    return scene_object, scene_object.path


class F4X_OT_fit_clip(_WorkerOperator, bpy.types.Operator, ImportHelper):  # noqa: N801 - Blender wants this form
    """Fit a scene to a video or an image folder, and import it. Resumes a stopped fit."""

    bl_idname = "f4x.fit_clip"
    bl_label = "Fit Video"

    filename_ext = ""
    filter_glob: StringProperty(  # type: ignore[valid-type]
        default="*.mp4;*.mov;*.mkv;*.avi;*.webm;*.m4v;*.png;*.jpg", options={"HIDDEN"}
    )
    profile: EnumProperty(name="Profile", items=PROFILES, default="wild")  # type: ignore[valid-type]
    frames: StringProperty(name="Frames", description="Frames to use as first:end:step, such as 0:120:2; empty: all")  # type: ignore[valid-type]
    width: IntProperty(  # type: ignore[valid-type]
        name="Width",
        description="Frames wider than this are scaled down; 0: so that their longer side has 480 pixels",
        default=0,
        min=0,
        max=4096,
    )
    features: BoolProperty(  # type: ignore[valid-type]
        name="Features", description="Also add the features that text and point queries need", default=True
    )
    output: StringProperty(  # type: ignore[valid-type]
        name="Folder", description="Output folder of the scene; empty: a folder beside the clip", subtype="DIR_PATH"
    )
    resume: BoolProperty(  # type: ignore[valid-type]
        name="Continue", description="Resume a fit of this clip that was stopped", default=True
    )

    def invoke(self, context, event):
        """Open the file browser, where there is a worker."""
        worker_python()
        return super().invoke(context, event)

    def start(self, context):
        """Start `f4x fit`."""
        clip = Path(bpy.path.abspath(self.filepath))
        if not clip.exists():
            raise F4xError(f"{clip} does not exist; choose a video, or an image in a folder of images.")
        if clip.suffix.lower() in (".png", ".jpg"):
            clip = clip.parent  # an image stands for its folder
        output = Path(bpy.path.abspath(self.output)) if self.output else clip.with_name(f"{clip.stem}_4d")
        options = ["-o", output, "--profile", self.profile]
        options += ["--width", str(self.width)] if self.width else []
        options += ["--frames", self.frames] if self.frames else []
        options += ["--features", "visual,text"] if self.features else []
        options += ["--resume"] if self.resume else []
        name = clip.parent.name if clip.name == "images" else clip.name
        start_verb(f"Fit {name}", import_fitted, "fit", clip, *options)


class F4X_OT_add_features(SavedSceneOperator, bpy.types.Operator):  # noqa: N801
    """Add features of vision models to the scene, so that you can query it by words and points."""

    bl_idname = "f4x.add_features"
    bl_label = "Add Features"

    teachers: StringProperty(  # type: ignore[valid-type]
        name="Teachers",
        description="Names of teachers separated by commas; the command f4x models list shows them",
        default="visual,text",
    )
    words: StringProperty(  # type: ignore[valid-type]
        name="Words", description="Labels to store in addition to everyday ones, separated by commas"
    )
    clip: StringProperty(  # type: ignore[valid-type]
        name="Clip", description="Video of the scene; empty: the file that the scene was fitted to", subtype="FILE_PATH"
    )

    def invoke(self, context, event):
        """Open the dialog, where there is a worker."""
        worker_python()
        return context.window_manager.invoke_props_dialog(self, width=420)

    def start(self, context):
        """Start `f4x distill`."""
        scene_object, path = saved_scene(context)
        options = ["--teacher", self.teachers] if self.teachers else []
        options += ["--vocabulary", self.words] if self.words else []
        clip = bpy.path.abspath(self.clip) if self.clip else _moved_clip(scene_object, path)
        options += ["--clip", clip] if clip else []
        _add_features(scene_object, path, "" if self.teachers else self.words, options)


def _moved_clip(scene_object: SceneObject, path: Path) -> Path | None:
    """Return the clip of a scene where it lies elsewhere by now: near the scene file, or behind the camera; None: in its place, or
    unknown.

    Raises F4xError where it is at none of these.
    """
    source = scene_object.base.provenance.get("source")
    if not source or (Path(source).is_absolute() and Path(source).exists()):
        return None
    found = find_clip(scene_object.base, path) or shown_clip(scene_object.root)
    if found is None and not (path.parent / "features").is_dir():  # maps that were made before need no clip
        line = f"The clip that {scene_object.name} was fitted to is no longer at {source}"
        raise F4xError(f"{line}; choose it under Clip in this dialog.")
    return found


class F4X_OT_refit(SavedSceneOperator, bpy.types.Operator):  # noqa: N801
    """Refit colors, opacities and sizes for Cycles and EEVEE, which blend splats in linear light. Takes minutes."""

    bl_idname = "f4x.refit"
    bl_label = "Refit for Cycles"

    @classmethod
    def poll(cls, context):
        """Return True where Blender draws splats itself, and the active object belongs to a scene."""
        if not draws_splats():
            cls.poll_message_set("Blender draws splats itself from version 5.3 on")
            return False
        return super().poll(context)

    def start(self, context):
        """Start `f4x refit`; the points are updated at the end."""
        scene_object, path = saved_scene(context)

        def done(result: dict) -> None:
            for each in SceneObject.among(bpy.data.objects):
                if each.path == path and not each.is_linked:
                    display.refresh(each)

        start_verb(f"Refit {scene_object.name}", done, "refit", path, "--resume")


class F4X_OT_ask_scene(SavedSceneOperator, bpy.types.Operator):  # noqa: N801
    """Ask a question about the scene; "it" is what is selected. The answer appears in the panel Tasks."""

    bl_idname = "f4x.ask_scene"
    bl_label = "Ask"

    question: StringProperty(name="Question", default="What moves?")  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Open the dialog."""
        return context.window_manager.invoke_props_dialog(self, width=420)

    def start(self, context):
        """Start the job: of the worker, where there is one, whose models know more words; else of Blender's own Python."""
        from ...f4x_core.app.asking import AskTask  # not above: Blender starts more often than somebody asks

        scene_object = SceneObject.of(context.active_object)
        chosen, edits = scene_object.selection, cache.text_of(stack_as_seen(scene_object))
        selection = None if chosen is None else chosen.to_json()
        task = AskTask(str(scene_object.path), edits, self.question, selection)
        runner.start_task(f"Ask: {self.question}", task, interpreter=find_interpreter())


class F4X_PT_jobs(bpy.types.Panel):  # noqa: N801
    """Buttons that start jobs of the worker, and its jobs."""

    bl_label = "Tasks"
    bl_category = CATEGORY
    bl_space_type, bl_region_type = "VIEW_3D", "UI"
    bl_order = 90

    def draw(self, context):
        """Draw the running jobs, the buttons, then the jobs that have ended."""
        layout = self.layout
        running = [job for job in runner.in_order() if job.state == RUNNING]
        for job in running:
            runner.draw_job(layout, context, job)
        grid = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
        grid.operator(F4X_OT_fit_clip.bl_idname, text="Fit Video…", icon="FILE_MOVIE")
        grid.operator(F4X_OT_add_features.bl_idname, text="Features…", icon="OUTLINER_OB_POINTCLOUD")
        grid.operator(F4X_OT_ask_scene.bl_idname, text="Question…", icon="QUESTION")
        if draws_splats():
            grid.operator(F4X_OT_refit.bl_idname, text="Refit…", icon="SHADING_RENDERED")
        grid.operator("f4x.export_scene", text="Export…", icon="EXPORT")
        grid.operator("f4x.render_film", text="Film…", icon="RENDER_ANIMATION")
        grid.operator("f4x.add_path_camera", text="Camera…", icon="CAMERA_DATA")
        ended = [job for job in runner.in_order() if job.state != RUNNING]
        for job in ended:
            runner.draw_job(layout, context, job)
        if ended:
            layout.operator("f4x.clear_jobs", icon="TRASH")


CLASSES = (F4X_OT_fit_clip, F4X_OT_add_features, F4X_OT_refit, F4X_OT_ask_scene, F4X_PT_jobs)
