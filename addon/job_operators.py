"""What the worker is asked to do: fit a clip, add features, answer a question, export. Each is one verb of `f4x`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..f4x_core.errors import F4xError
from ..f4x_core.scene.formats import FORMATS
from . import jobs, session
from .preferences import worker_python
from .worker import RUNNING, Job, core_command

PROFILES = (
    ("quick", "Quick", "Minutes: to see whether a clip works"),
    ("wild", "Thorough", "The better part of an hour on two cores"),
)


def start_verb(title: str, on_done: Callable[[dict[str, Any]], None] | None, verb: str, *arguments: Path | str) -> None:
    """Run one verb of `f4x` as a job; F4xError where there is no worker, or, without a window, where it failed."""
    jobs.start(Job(title, core_command(worker_python(), verb, *arguments), on_done))


def import_fitted(result: dict[str, Any]) -> None:
    """Import the scene that a fit left; size, frames and camera of a file that shows another scene stay as they are."""
    alone = not any(session.PATH in item for item in bpy.data.objects)
    try:
        bpy.ops.f4x.import_scene(  # True: one step of undo
            "EXEC_DEFAULT", True, filepath=result["scene"], set_up_render=alone, show=alone
        )
    except RuntimeError as error:  # what the operator reported
        raise F4xError(str(error).removeprefix("Error: ").strip()) from error


def look_up(root: bpy.types.Object, words: Sequence[str]) -> None:
    """Let the worker add `words` to what the scene of `root` knows; F4xError while its file lacks edits."""
    told = ", ".join(words)
    if not session.is_saved(root):
        raise F4xError(
            f"{root.name} does not know {told}; save its edits, so that the worker can look the scene over for it."
        )
    _add_features(root, session.path_of(root), told, ["--vocabulary", told])


def _add_features(root: bpy.types.Object, path: Path, words: str, options: list[str]) -> None:
    """Start `f4x distill`; the scene takes over what it leaves, if no edit came in between. `words`: all that is added, if so."""

    def done(result: dict[str, Any]) -> None:
        for item in bpy.data.objects:
            if session.PATH in item and session.path_of(item) == path and session.is_saved(item):
                session.attach(item)

    title = f"Features of {root.name}" + (f": {words}" if words else "")
    if any(job.title == title and job.state == RUNNING for job in jobs.all_jobs()):
        raise F4xError(f"{title}: that is under way; wait until the job is done.")
    start_verb(title, done, "distill", path, *options)


class _WorkerOperator:
    """Reports a refusal as one sentence."""

    def execute(self, context):
        """Start the job."""
        try:
            self.start(context)
        except F4xError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class _SceneOperator(_WorkerOperator):
    """Is about the scene of the active object."""

    @classmethod
    def poll(cls, context):
        """Only where it is clear which scene is meant."""
        if session.root_of(context.active_object) is None:
            cls.poll_message_set("Select a part of an imported Feature4X scene")
            return False
        return True


def _saved_scene(context: bpy.types.Context) -> tuple[bpy.types.Object, Path]:
    """Root and file of the scene that is meant; F4xError while the file lacks edits: the worker reads only the file."""
    root = session.root_of(context.active_object)
    if not session.is_saved(root):
        raise F4xError(f"{root.name} has edits that its file does not have; save them first.")
    return root, session.path_of(root)


class F4X_OT_fit_clip(_WorkerOperator, bpy.types.Operator, ImportHelper):  # noqa: N801 - Blender wants this form
    """Turn a video, or a folder of pictures, into a scene and import it. Goes on where a stopped fit was."""

    bl_idname = "f4x.fit_clip"
    bl_label = "Fit Video"

    filename_ext = ""
    filter_glob: StringProperty(  # type: ignore[valid-type]
        default="*.mp4;*.mov;*.mkv;*.avi;*.webm;*.m4v;*.png;*.jpg", options={"HIDDEN"}
    )
    profile: EnumProperty(name="Profile", items=PROFILES, default="wild")  # type: ignore[valid-type]
    frames: StringProperty(name="Frames", description="First:end:step, such as 0:120:2; empty: all")  # type: ignore[valid-type]
    width: IntProperty(  # type: ignore[valid-type]
        name="Width", description="Pictures wider than this are made smaller", default=480, min=64, max=4096
    )
    features: BoolProperty(  # type: ignore[valid-type]
        name="Features", description="Also add what text and point queries need", default=True
    )
    output: StringProperty(  # type: ignore[valid-type]
        name="Folder", description="Where the scene goes; empty: a folder beside the clip", subtype="DIR_PATH"
    )
    resume: BoolProperty(  # type: ignore[valid-type]
        name="Continue", description="Go on with a fit of this clip that was stopped", default=True
    )

    def start(self, context):
        """Start `f4x fit`."""
        clip = Path(bpy.path.abspath(self.filepath))
        if not clip.exists():
            raise F4xError(f"{clip} is not there; choose a video, or a picture of a folder of them.")
        if clip.suffix.lower() in (".png", ".jpg"):
            clip = clip.parent  # a picture stands for its folder
        output = Path(bpy.path.abspath(self.output)) if self.output else clip.with_name(f"{clip.stem}_4d")
        options = ["-o", output, "--profile", self.profile, "--width", str(self.width)]
        options += ["--frames", self.frames] if self.frames else []
        options += ["--features", "visual,text"] if self.features else []
        options += ["--resume"] if self.resume else []
        told = clip.parent.name if clip.name == "images" else clip.name
        start_verb(f"Fit {told}", import_fitted, "fit", clip, *options)


class F4X_OT_add_features(_SceneOperator, bpy.types.Operator):  # noqa: N801
    """Let teachers look at the scene's clip and distil what they see into the scene, so that it can be asked."""

    bl_idname = "f4x.add_features"
    bl_label = "Add Features"

    teachers: StringProperty(  # type: ignore[valid-type]
        name="Teachers", description="Names with commas, as `f4x models list` shows them", default="visual,text"
    )
    words: StringProperty(  # type: ignore[valid-type]
        name="Words", description="Labels to store beside the everyday ones, with commas"
    )
    clip: StringProperty(  # type: ignore[valid-type]
        name="Clip", description="The scene's video; empty: where it was when it was fitted", subtype="FILE_PATH"
    )

    def invoke(self, context, event):
        """Ask what to add."""
        return context.window_manager.invoke_props_dialog(self, width=420)

    def start(self, context):
        """Start `f4x distill`."""
        root, path = _saved_scene(context)
        options = ["--teacher", self.teachers] if self.teachers else []
        options += ["--vocabulary", self.words] if self.words else []
        options += ["--clip", bpy.path.abspath(self.clip)] if self.clip else []
        _add_features(root, path, "" if self.teachers else self.words, options)


class F4X_OT_ask_scene(_SceneOperator, bpy.types.Operator):  # noqa: N801
    """Ask the scene a question; the answer appears under Jobs."""

    bl_idname = "f4x.ask_scene"
    bl_label = "Ask"

    question: StringProperty(name="Question", default="What moves?")  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Ask for the question."""
        return context.window_manager.invoke_props_dialog(self, width=420)

    def start(self, context):
        """Start `f4x ask`."""
        _, path = _saved_scene(context)
        start_verb(f"Ask: {self.question}", None, "ask", path, self.question)


class F4X_OT_export_scene(_SceneOperator, bpy.types.Operator, ExportHelper):  # noqa: N801
    """Write the scene for other programs: PLY, .splat or glTF of one frame, USD or numbered PLY files of all."""

    bl_idname = "f4x.export_scene"
    bl_label = "Export Feature4X Scene"

    filename_ext = ".usda"
    check_extension = None  # the ending goes with the format, or is a folder's
    format: EnumProperty(  # type: ignore[valid-type]
        name="Format",
        items=[("auto", "By the Ending", "")] + [(name, name, entry.keeps) for name, entry in FORMATS.items()],
    )
    one_frame: BoolProperty(  # type: ignore[valid-type]
        name="This Frame Alone", description="Write the current frame in place of all frames", default=False
    )

    def start(self, context):
        """Start `f4x export`."""
        root, path = _saved_scene(context)
        output = Path(bpy.path.abspath(self.filepath))
        options = ["-o", output] + (["--format", self.format] if self.format != "auto" else [])
        options += ["--time", f"{context.scene.frame_current_final:g}"] if self.one_frame else []
        start_verb(f"Export {root.name}", None, "export", path, *options)


class F4X_PT_jobs(bpy.types.Panel):  # noqa: N801
    """The worker: what it can be asked, and what it is doing."""

    bl_label = "Jobs"
    bl_category = "Feature4X"
    bl_space_type, bl_region_type = "VIEW_3D", "UI"
    bl_order = 90

    def draw(self, context):
        """The verbs, then a box for each job."""
        layout = self.layout
        column = layout.column(align=True)
        column.operator(F4X_OT_fit_clip.bl_idname, text="Fit Video…", icon="FILE_MOVIE")
        column.operator(F4X_OT_add_features.bl_idname, text="Add Features…", icon="OUTLINER_OB_POINTCLOUD")
        column.operator(F4X_OT_ask_scene.bl_idname, text="Question…", icon="QUESTION")
        column.operator(F4X_OT_export_scene.bl_idname, text="Export…", icon="EXPORT")
        for job in jobs.all_jobs():
            jobs.draw_job(layout, context, job)


CLASSES = (F4X_OT_fit_clip, F4X_OT_add_features, F4X_OT_ask_scene, F4X_OT_export_scene, F4X_PT_jobs)
