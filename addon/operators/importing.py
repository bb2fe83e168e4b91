"""Import operators, for the menu, drag and drop and scripts, and the operator that chooses the clip behind a scene."""

import re
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, CollectionProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ...f4x_core.scene.linear import is_refitted
from ..common.gaussian_attributes import draws_splats
from ..common.point_cloud import select_only
from ..common.waiting import waiting
from ..common.wording import Reporting
from ..io.clip_background import doubt, show_clip
from ..io.import_scene import NOTES, import_scene
from ..io.render_setup import LEFT, SOURCE, ClipSettings, clip_camera, is_under_way, left_as_is, set_up, was_set_up
from ..render import viewport
from ..render.occluders import hide_occluders
from ..scene import clip_time, packing
from ..scene.scene_object import PATH, SceneObject
from .base import SceneOperator

PASSING = {"HIDDEN", "SKIP_SAVE"}
"""Options of properties that Blender or a job sets for a single call."""

REFIT = "Tasks > Refit lets Cycles and EEVEE draw this scene like the clip; the engine Feature4X does so already."
"""The sidebar's sentence on a scene that was fitted for other blending than Blender's own."""
_told_of_refit = False
NEAR = 0.5
"""World units, median depths of a clip, between the origins of two scenes that lie within each other."""
SCENE_FILES = "*.f4x;*.ply;*.splat;*.spz;*.glb;*.gltf"
"""Files that browsers show."""


def options_for(filepath: str) -> list[str]:
    """Return the names of the import options that a file of this name has, in their order."""
    numbered = re.fullmatch(r".*\d\.ply", Path(filepath).name, re.IGNORECASE) is not None
    return ["set_up_render", "clear_view", *(["sequence", "step"] if numbered else []), "clip"]


class F4X_OT_import_scene(Reporting, bpy.types.Operator, ImportHelper):  # noqa: N801 - Blender wants this form
    """Import a Feature4X scene with its motion, camera and edits, or Gaussian splats: PLY, .splat, SPZ, glTF, PLY sequences."""

    bl_idname = "f4x.import_scene"
    bl_label = "Import Feature4X"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - read by Blender at registration

    filename_ext = ".f4x"
    filter_glob: StringProperty(default=SCENE_FILES, options={"HIDDEN"})  # type: ignore[valid-type]
    directory: StringProperty(subtype="DIR_PATH", options=PASSING)  # type: ignore[valid-type]
    set_up_render: BoolProperty(  # type: ignore[valid-type]
        name="Set Up Render",
        description="Use the clip's size, frame rate, frame range and camera, and the render engine Feature4X. "
        "On by default only in a new file: a project that is under way keeps its settings",
        default=True,
        options={"SKIP_SAVE"},
    )
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options=PASSING)  # type: ignore[valid-type]
    sequence: BoolProperty(  # type: ignore[valid-type]
        name="Sequence", description="Import all files of a numbered PLY sequence", default=True, options={"SKIP_SAVE"}
    )
    step: IntProperty(  # type: ignore[valid-type]
        name="Step", description="Import only every n-th file of a sequence", default=1, min=1, options={"SKIP_SAVE"}
    )
    clip: StringProperty(  # type: ignore[valid-type]
        name="Clip",
        description="Video or image folder to show behind the scene; empty: the clip that the scene was fitted to, if it exists",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    clear_view: BoolProperty(  # type: ignore[valid-type]
        name="Hide What Is in the Way",
        description="Hide objects of this file that stand between the clip's camera and the scene, such as the default cube",
        default=True,
        options={"SKIP_SAVE"},
    )
    show: BoolProperty(  # type: ignore[valid-type]
        name="Show", description="Show the scene in the viewports, in its colors", default=True, options=PASSING
    )

    def draw(self, context):
        """Draw the options that the chosen file has: only numbered PLY files are a sequence."""
        layout = self.layout
        layout.use_property_split = True
        for name in options_for(self.filepath):
            layout.prop(self, name)

    def execute(self, context):
        """Import the chosen file."""
        clip = Path(bpy.path.abspath(self.clip)) if self.clip else None
        takes_over = self._takes_over(context)
        with waiting():  # seconds, for large files
            root = import_scene(
                Path(self.filepath or self.directory),
                set_up_render=takes_over,
                clip=clip,
                sequence=self.sequence,
                step=self.step,
            )
        if clip is not None:
            _warn_of_clip(self, root)
        select_only(root)
        lines = self._show_set_up(context, root) if takes_over else []
        if not takes_over:
            _notice(root, left_as_is(context.scene, clip_camera(root)))
        _tell_of_refit(root)
        if self.show:  # a job puts what it has made beside the others
            _notice(root, _others_there(root, context.scene))
            moves = takes_over and PATH in root and SceneObject(root).holds_edits
            viewport.show(root, context.scene.camera if moves else None, stay=not takes_over)
        if root.f4x.speed != 1:
            lines.append(_own_pace(root, context.scene))
        # one report: of several the status bar shows none
        self.report({"INFO"}, ". ".join(line.rstrip(".") for line in (_summary(root), root.get(NOTES), *lines) if line))
        return {"FINISHED"}

    def _takes_over(self, context: bpy.types.Context) -> bool:
        """Return True if the import sets up the render: as asked, else in a new file."""
        if self.properties.is_property_set("set_up_render"):
            return self.set_up_render
        return not is_under_way(context.scene)

    def _show_set_up(self, context: bpy.types.Context, root: bpy.types.Object) -> list[str]:
        """Hide what was there before and is in the way; returns sentences about the clip's settings and what is hidden."""
        done = [was_set_up(clip_camera(root))]
        viewport.use_engine(context.scene)
        if not self.clear_view:
            return done
        first, last = ClipSettings.read(clip_camera(root)).frames or (context.scene.frame_current,) * 2
        hidden = hide_occluders(root, sorted({first, (first + last) // 2, last}))
        if hidden and bpy.data.filepath:  # in a new file it is Blender's own cube that is in the way
            root.f4x.notice = hidden
        return [*done, hidden]

    def invoke(self, context, event):
        """Open the file browser, or only the options if a file was dropped into the viewport."""
        self.set_up_render = self._takes_over(context)
        return self.invoke_popup(context) if self.filepath else super().invoke(context, event)


def _tell_of_refit(root: bpy.types.Object) -> None:
    """Say once in a session, in the sidebar, that Cycles and EEVEE would draw this scene better after a refit."""
    global _told_of_refit
    if _told_of_refit or PATH not in root or not draws_splats() or not SceneObject(root).holds_edits:
        return
    if not is_refitted(SceneObject(root).base):
        _told_of_refit = True
        _notice(root, REFIT)


def _notice(root: bpy.types.Object, line: str) -> None:
    """Add a line to those that the sidebar shows of a scene; an empty one adds nothing."""
    root.f4x.notice = "\n".join(part for part in (root.f4x.notice, line) if part)


def _others_there(root: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """Return a sentence where another file's scene is seen in the same place as that of `root`; else an empty string."""
    others = [
        item
        for item in scene.objects
        if PATH in item
        and item.get(PATH) != root.get(PATH)
        and any(not cloud.hide_get() for cloud in SceneObject(item).clouds)
    ]
    near = [
        item.name for item in others if (item.matrix_world.translation - root.matrix_world.translation).length < NEAR
    ]
    return (
        f"It lies in the same place as {near[0]}: move it, the empty {root.name}, or hide one of the two."
        if near
        else ""
    )


def _own_pace(root: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """Return the sentence about a clip whose frame rate is not that of the file."""
    fps = scene.render.fps / scene.render.fps_base
    pace = f"it plays at its own pace, Speed {root.f4x.speed:.3g} in the panel Motion"
    return f"The clip has {fps * root.f4x.speed:.4g} frames per second and this file {fps:.4g}: {pace}"


def _summary(root: bpy.types.Object) -> str:
    """Return the summary of an import, in as few words as the status bar shows."""
    if PATH in root and SceneObject(root).holds_edits:
        return f"{root.name}: {len(SceneObject(root).base.cameras)} frames. Space plays"
    clouds = [item for item in root.children_recursive if item.type == "POINTCLOUD"]
    return f"{root.name}: {sum(len(item.data.points) for item in clouds):,} Gaussians"


class F4X_OT_show_picture(Reporting, bpy.types.Operator):  # noqa: N801
    """Show this viewport with the engine Feature4X. Solid shading, Blender's default, shows point clouds in gray up to 5.2."""

    bl_idname = "f4x.show_picture"
    bl_label = "Show Picture"

    def execute(self, context):
        """Choose the engine and the shading."""
        viewport.use_engine(context.scene)
        viewport.draw_exactly(context.space_data)
        return {"FINISHED"}


class F4X_OT_set_up_render(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Use the clip's size, frame rate, frame range and camera, and the render engine Feature4X."""

    bl_idname = "f4x.set_up_render"
    bl_label = "Set Up Render"

    @classmethod
    def poll(cls, context):
        """Return True if the scene still has the camera that came with it."""
        scene_object = SceneObject.of(context.object)
        if scene_object is not None and clip_camera(scene_object.root) is not None:
            return True
        cls.poll_message_set("Select an object of an imported scene that has its clip's camera")
        return False

    def act(self, context, scene_object):
        """Take over the settings, and name them."""
        set_up(context.scene, clip_camera(scene_object.root))
        lines = scene_object.state.notice.splitlines()
        scene_object.state.notice = "\n".join(line for line in lines if not line.startswith(LEFT))
        viewport.use_engine(context.scene)
        self.report({"INFO"}, was_set_up(clip_camera(scene_object.root)))


class F4X_OT_choose_clip(Reporting, bpy.types.Operator, ImportHelper):  # noqa: N801
    """Show a video behind the scene, or the folder of the chosen image."""

    bl_idname = "f4x.choose_clip"
    bl_label = "Choose Clip"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    filter_movie: BoolProperty(default=True, options={"HIDDEN"})  # type: ignore[valid-type]
    filter_image: BoolProperty(default=True, options={"HIDDEN"})  # type: ignore[valid-type]
    filter_folder: BoolProperty(default=True, options={"HIDDEN"})  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context):
        """Return True if an object of an imported scene is active."""
        if _root_of(context.object) is not None:
            return True
        cls.poll_message_set("Select an object of an imported scene")
        return False

    def execute(self, context):
        """Show the chosen clip behind the scene."""
        root = _root_of(context.object)
        assert root is not None  # polled
        camera = next(item for item in root.children if item.type == "CAMERA")
        clip = Path(bpy.path.abspath(self.filepath))
        images = clip.parent if clip.suffix.lower() in bpy.path.extensions_image else clip
        show_clip(camera, images, np.arange(root[clip_time.FIRST], root[clip_time.LAST] + 1))
        _warn_of_clip(self, root)
        return {"FINISHED"}


def _warn_of_clip(operator: bpy.types.Operator, root: bpy.types.Object) -> None:
    """Say so where the clip behind the camera of `root` seems to be that of another scene."""
    camera = next(item for item in root.children if item.type == "CAMERA")
    line = doubt(camera, SceneObject(root).base) if PATH in root else ""
    if line:
        root.f4x.notice = line
        operator.report({"WARNING"}, line)


def _root_of(item: bpy.types.Object | None) -> bpy.types.Object | None:
    """Return the root of what was imported, scene or splats, that `item` is a part of."""
    while item is not None and SOURCE not in item and PATH not in item:
        item = item.parent
    return item


class F4X_FH_scene(bpy.types.FileHandler):  # noqa: N801
    """Dropping a scene or splats into a viewport imports them."""

    bl_idname = "F4X_FH_scene"
    bl_label = "Feature4X"
    bl_import_operator = "f4x.import_scene"
    bl_file_extensions = ".f4x;.ply;.splat;.spz;.glb;.gltf"

    @classmethod
    def poll_drop(cls, context):
        """Accept drops into 3D viewports."""
        return context.area is not None and context.area.type == "VIEW_3D"


class F4X_OT_find_scene(SceneOperator, bpy.types.Operator, ImportHelper):  # noqa: N801
    """Choose the scene file again after it was moved."""

    bl_idname = "f4x.find_scene"
    bl_label = "Find Scene File"

    filename_ext = ".f4x"
    filter_glob: StringProperty(default=SCENE_FILES, options={"HIDDEN"})  # type: ignore[valid-type]

    def act(self, context, scene_object):
        """Use the chosen file if it holds the same scene."""
        scene_object.relink(Path(self.filepath))


class F4X_OT_pack_scene(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Keep a copy of the scene file in the .blend, so that render farms and other computers need the .blend only."""

    bl_idname = "f4x.pack_scene"
    bl_label = "Pack Scene"

    def act(self, context, scene_object):
        """Pack the file as it is now; saving edits later packs it again."""
        path = scene_object.path
        packing.pack(scene_object.root, path)
        self.report({"INFO"}, f"The .blend now holds {path.name} ({path.stat().st_size / 2**20:.1f} MiB); save it")


CLASSES = (
    F4X_OT_pack_scene,
    F4X_OT_import_scene,
    F4X_OT_find_scene,
    F4X_OT_show_picture,
    F4X_OT_set_up_render,
    F4X_OT_choose_clip,
    F4X_FH_scene,
)
