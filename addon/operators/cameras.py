"""Other ways to look at a scene: cameras along a path of their own, and films that stop or stretch time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ...f4x_core.geometry import trajectory
from ..io.import_scene import add_camera, follow_scale
from ..jobs.preferences import worker_python
from ..render.believed import zone_of
from ..scene.clip_time import keys_in_force
from ..scene.scene_object import SceneObject
from .base import SceneOperator
from .tasks import SavedSceneOperator, saved_scene, start_verb

MIN_DEGREES = 0.1
"""Degrees of the smallest swing."""
PATHS = (
    ("STABILISE", "Stabilize", "The clip's camera in a calm hand"),
    ("ORBIT", "Orbit", "A small circle around what the clip's camera looks at"),
)
FILMS = (
    ("original", "Clip", "The clip's own camera"),
    ("stabilise", "Stabilize", "The clip's camera in a calm hand"),
    ("orbit", "Orbit", "A small circle around what the clip's camera looks at"),
    ("bullet", "Bullet Time", "The clip stops at this frame while the camera swings to both sides, and goes on"),
    ("frozen", "Frozen", "The scene stands still at this frame while the camera goes its way"),
    ("slow", "Slow Motion", "The clip slower, with pictures between its frames"),
)
TIMED = ("bullet", "frozen")
"""Films that need a frame."""
SWUNG = ("orbit", "bullet")
"""Films that need an angle."""


def _stay_believed(operator: bpy.types.Operator, scene_object: SceneObject | None) -> None:
    """Let the swing of a dialog begin within the angle up to which the scene can be believed."""
    zone = zone_of(scene_object) if scene_object else None
    if zone is not None and not operator.properties.is_property_set("degrees"):
        operator.degrees = max(min(operator.degrees, zone.degrees), MIN_DEGREES)


class F4X_OT_add_path_camera(SceneOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Add a camera that follows a path of its own, and look through it."""

    bl_idname, bl_label = "f4x.add_path_camera", "Add Camera"

    path: EnumProperty(name="Path", items=PATHS)  # type: ignore[valid-type]
    calm: FloatProperty(  # type: ignore[valid-type]
        name="Calm",
        description="Frames over which the camera is smoothed",
        default=trajectory.SMOOTH,
        min=0.5,
        soft_max=48.0,
    )
    degrees: FloatProperty(  # type: ignore[valid-type]
        name="Degrees", description="Size of the circle, seen from its center", default=5.0, min=MIN_DEGREES, max=80.0
    )

    def draw(self, context):
        """Draw what the path needs."""
        self.layout.use_property_split = True
        self.layout.prop(self, "path")
        self.layout.prop(self, "calm" if self.path == "STABILISE" else "degrees")

    def invoke(self, context, event):
        """Open the dialog."""
        _stay_believed(self, SceneObject.of(context.object))
        return context.window_manager.invoke_props_dialog(self)

    def act(self, context, scene_object):
        """Key the camera at the clip's frames."""
        scene = scene_object.base
        views = (
            trajectory.stabilised(scene.cameras, self.calm)
            if self.path == "STABILISE"
            else trajectory.orbit(scene.cameras, degrees=self.degrees)
        )
        root, name = scene_object.root, f"{scene_object.name} {self.path.lower()}"
        with keys_in_force(root) as timing:
            frames = timing.frames_of(scene.cameras.times)
            cameras = replace(trajectory.cameras_of(views), times=frames)
            camera = add_camera(name, cameras, scene, root.users_collection[0])
            camera.parent = root
            follow_scale(camera, root)
        context.scene.camera = camera


class F4X_OT_render_film(SavedSceneOperator, bpy.types.Operator):  # noqa: N801
    """Render a film along a path in the worker. Save the edits first; it draws what the scene file holds."""

    bl_idname, bl_label = "f4x.render_film", "Render Film"

    path: EnumProperty(name="Path", items=FILMS, default="stabilise")  # type: ignore[valid-type]
    frame: IntProperty(name="Frame", description="Clip frame at which time stops", min=0)  # type: ignore[valid-type]
    degrees: FloatProperty(name="Degrees", description="Size of the swing", default=5.0, min=MIN_DEGREES, max=80.0)  # type: ignore[valid-type]
    factor: FloatProperty(name="Slower", description="How many times slower", default=4.0, min=1.0, max=100.0)  # type: ignore[valid-type]
    exr: BoolProperty(  # type: ignore[valid-type]
        name="EXR", description="Also write all passes of a frame as one EXR, with the matte of what no frame saw"
    )
    output: StringProperty(  # type: ignore[valid-type]
        name="Folder", description="Output folder; empty: a folder beside the scene file", subtype="DIR_PATH"
    )

    def draw(self, context):
        """Draw what the path needs."""
        layout = self.layout
        layout.use_property_split = True
        needs = {"frame": TIMED, "degrees": SWUNG, "factor": ("slow",)}
        for name in ("path", *(name for name, paths in needs.items() if self.path in paths), "exr", "output"):
            layout.prop(self, name)

    def invoke(self, context, event):
        """Open the dialog, with the current frame as the one at which time stops, where there is a worker."""
        worker_python()
        if not self.properties.is_property_set("frame"):
            scene_object = SceneObject.of(context.object)
            self.frame = round(scene_object.frame) if scene_object else 0
        _stay_believed(self, SceneObject.of(context.object))
        return context.window_manager.invoke_props_dialog(self, width=420)

    def start(self, context):
        """Start `f4x render`."""
        scene_object, path = saved_scene(context)
        number = f":{self.frame}" if self.path in TIMED else f":{self.factor:g}" if self.path == "slow" else ""
        output = Path(bpy.path.abspath(self.output)) if self.output else path.with_name(f"{path.stem}_{self.path}")
        options = ["-o", output, "--path", f"{self.path}{number}", "--degrees", f"{self.degrees:g}", "--video"]
        options += ["--exr", "--channels", "rgb,alpha,depth,unseen"] if self.exr else []
        start_verb(f"Film of {scene_object.name}", None, "render", path, *options)


CLASSES = (F4X_OT_add_path_camera, F4X_OT_render_film)
