"""Operators that edit the motion of a scene: soft grabbing of nodes, handles for groups, writing motion back as edits."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty, FloatVectorProperty, IntProperty
from bpy_extras.view3d_utils import region_2d_to_location_3d
from mathutils import Vector

from ...f4x_core.errors import F4xError
from ...f4x_core.geometry import pose, quaternion
from ...f4x_core.scaffold.grab import grab, within_reach
from ..edits import display
from ..rig.motion_edits import changes, mark_keyed
from ..rig.scaffold import NODE, add_handles, all_nodes, hold, key_moved, nodes_of, read_poses, remove_handles
from ..scene.clip_time import follows_timeline, keys_in_force, time_of
from ..scene.scene_object import SceneObject
from .base import SceneOperator
from .importing import F4X_OT_choose_clip, F4X_OT_find_scene, F4X_OT_pack_scene, F4X_OT_set_up_render
from .keeping import F4X_OT_save_as


class _MotionOperator(SceneOperator, bpy.types.Operator):
    """Base of operators on the nodes of the active object's scene."""

    @classmethod
    def poll(cls, context):
        """Return True in Object Mode, for a scene with nodes."""
        scene_object = SceneObject.of(context.object)
        if scene_object is None or not nodes_of(scene_object.root):
            cls.poll_message_set("Select an object of an imported scene with moving objects")
            return False
        if scene_object.is_linked:
            cls.poll_message_set(scene_object.why_linked_stays)
            return False
        return context.mode == "OBJECT"


class F4X_OT_grab_nodes(_MotionOperator):  # noqa: N801
    """Move the selected nodes; the nodes around them follow as rigidly as possible."""

    bl_idname = "f4x.grab_nodes"
    bl_label = "Grab Nodes Softly"
    bl_options = {"REGISTER", "UNDO", "GRAB_CURSOR", "BLOCKING"}  # noqa: RUF012

    offset: FloatVectorProperty(  # type: ignore[valid-type]
        name="Offset", description="Distance that the selected nodes move, along Blender's axes", subtype="TRANSLATION"
    )
    reach: FloatProperty(  # type: ignore[valid-type]
        name="Reach",
        description="Distance along the graph within which other nodes follow, in node spacings",
        default=5.0,
        min=0.0,
        soft_max=20,
    )
    hold: EnumProperty(  # type: ignore[valid-type]
        name="Hold",
        items=(
            ("CLIP", "Whole Clip", "Move the nodes in every frame of the clip"),
            (
                "AROUND",
                "Around This Frame",
                "Move the nodes fully in this frame, and less in the frames before and after",
            ),
        ),
    )
    frames: IntProperty(  # type: ignore[valid-type]
        name="Frames", description="Number of frames over which the motion fades; 0: only this frame", default=5, min=0
    )

    @classmethod
    def poll(cls, context):
        """Return True if a node is selected."""
        if not super().poll(context):
            return False
        if not any(NODE in item for item in context.selected_objects):
            cls.poll_message_set("Show the nodes by the button beside the scene's name in the sidebar, and select some")
            return False
        if not follows_timeline(SceneObject.of(context.object).root):
            cls.poll_message_set("Nodes look up Time; switch Animate Time off to move them, and on again afterwards")
            return False
        return True

    def act(self, context, scene_object):
        """Move by `offset` and insert keys."""
        _Grab(context, scene_object, self.reach).keep(Vector(self.offset), self.hold == "CLIP", self.frames)

    def invoke(self, context, event):
        """Follow the mouse until a click."""
        if context.area is None or context.area.type != "VIEW_3D":
            return self.execute(context)
        self._grab = _Grab(context, SceneObject.of(context.object), self.reach)
        self._start = _point_in_view(context, event)
        context.window_manager.modal_handler_add(self)
        context.area.header_text_set(
            "Move the mouse to move the nodes. Wheel: reach. Click or Enter: confirm. Right click or Esc: cancel"
        )
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Update the nodes whenever the mouse moves."""
        if event.type in {"RIGHTMOUSE", "ESC"}:
            self.let_go(context)
            return {"CANCELLED"}
        if event.type in {"LEFTMOUSE", "RET", "NUMPAD_ENTER"} and event.value == "PRESS":
            self.let_go(context)
            return self.execute(context)
        if event.type in {"WHEELUPMOUSE", "WHEELDOWNMOUSE"}:
            self.reach *= 1.25 if event.type == "WHEELUPMOUSE" else 0.8
            self._grab.set_reach(self.reach)
        if self._start is None:  # it was begun in the sidebar: what counts is the way from its border
            self._start = _point_in_view(context, event)
        elif event.type in {"MOUSEMOVE", "WHEELUPMOUSE", "WHEELDOWNMOUSE"}:
            view = _view_of(context)
            points = self._start, (event.mouse_x - view.x, event.mouse_y - view.y)
            data = context.space_data.region_3d
            places = [region_2d_to_location_3d(view, data, point, self._grab.anchor) for point in points]
            self.offset = places[1] - places[0]
            self._grab.show(self.offset)
        return {"RUNNING_MODAL"}

    def let_go(self, context):
        """Put the nodes back where their keys say."""
        context.area.header_text_set(None)
        context.scene.frame_set(context.scene.frame_current)


def _view_of(context: bpy.types.Context) -> bpy.types.Region:
    """Return the region of the 3D viewport that shows the scene."""
    return next(region for region in context.area.regions if region.type == "WINDOW")


def _point_in_view(context: bpy.types.Context, event: bpy.types.Event) -> tuple[int, int] | None:
    """Return the mouse in the pixels of the view; None over the sidebar, a header or a toolbar."""
    view, x, y = _view_of(context), event.mouse_x, event.mouse_y
    for region in context.area.regions:
        inside = region.x <= x < region.x + region.width and region.y <= y < region.y + region.height
        if region.type != "WINDOW" and inside:
            return None
    return x - view.x, y - view.y


class _Grab:
    """The nodes of a scene at the current frame, some of them grabbed."""

    def __init__(self, context: bpy.types.Context, scene_object: SceneObject, reach: float):
        scaffold = scene_object.base.scaffold
        assert scaffold is not None  # there are nodes
        self.root, self.nodes = scene_object.root, all_nodes(scene_object.root, scaffold.ids)
        self.unit, self.edges = scaffold.unit, scaffold.edges
        self.frames = scene_object.base.cameras.times
        self.frame = time_of(scene_object.root)
        xyz, quat = read_poses(scene_object.root, self.nodes, np.array([self.frame]))
        self.xyz, self.quat = xyz[0], quat[0]
        self.grabbed = np.array([i for i, item in enumerate(self.nodes) if item.select_get()])
        if not len(self.grabbed):
            raise F4xError(f"The selected nodes are not those of {scene_object.name}; select some of its own.")
        self.anchor = self.nodes[self.grabbed[0]].matrix_world.translation.copy()
        self.rest = [(item.location.copy(), item.rotation_quaternion.copy()) for item in self.nodes]
        self.set_reach(reach)

    def set_reach(self, reach: float) -> None:
        """Let nodes within `reach` spacings follow."""
        self.free = within_reach(self.xyz, self.edges, self.grabbed, reach * self.unit)

    def offsets(self, offset: Vector) -> tuple[np.ndarray, np.ndarray]:
        """Return `(quat (n,4), xyz (n,3))` of the nodes `free` in their own frames, the grabbed ones moved by `offset` (world)."""
        moved = np.array(self.root.matrix_world.to_3x3().inverted() @ offset)
        placed, turns = grab(self.xyz, self.edges, self.grabbed, self.xyz[self.grabbed] + moved, self.free)
        quat, xyz = pose.compose(*pose.invert(self.quat, self.xyz), quaternion.multiply(turns, self.quat), placed)
        return quat[self.free], xyz[self.free]

    def show(self, offset: Vector) -> None:
        """Put the empties there, without keys."""
        for i, quat, xyz in zip(self.free, *self.offsets(offset), strict=True):
            place, turn = self.rest[i]
            new = pose.compose(np.array(turn), np.array(place), quat, xyz)
            self.nodes[i].rotation_quaternion, self.nodes[i].location = new

    def keep(self, offset: Vector, whole_clip: bool, frames: int) -> None:
        """Key the move: over the whole clip, or fading within `frames` of the present one."""
        falloff = np.ones(len(self.frames))
        if not whole_clip:
            near = np.clip(1 - np.abs(self.frames - self.frame) / (frames + 1), 0, 1)
            falloff = near * near * (3 - 2 * near)
        hold(self.root, [self.nodes[i] for i in self.free], self.frames, self.offsets(offset), falloff)
        bpy.context.scene.frame_set(bpy.context.scene.frame_current)


class F4X_OT_add_handles(_MotionOperator):  # noqa: N801
    """Give every group of nodes that moves as one thing a handle: moving it moves the group."""

    bl_idname = "f4x.add_handles"
    bl_label = "Add Group Handles"

    count: IntProperty(  # type: ignore[valid-type]
        name="Groups", description="Number of groups; 0 = as many as there seem to be", default=0, min=0, soft_max=24
    )

    def act(self, context, scene_object):
        """Group the nodes anew."""
        scene = scene_object.base
        with keys_in_force(scene_object.root):
            handles = add_handles(scene_object.root, scene.scaffold.unit, scene.cameras.times, self.count or None)
        self.report({"INFO"}, f"Added {len(handles)} handles for {len(nodes_of(scene_object.root))} nodes")


class F4X_OT_remove_handles(_MotionOperator):  # noqa: N801
    """Remove the group handles. The nodes keep the motion that the handles gave them."""

    bl_idname = "f4x.remove_handles"
    bl_label = "Remove Group Handles"

    def act(self, context, scene_object):
        """Remove the handles, and key the nodes where they are."""
        with keys_in_force(scene_object.root):
            remove_handles(scene_object.root, scene_object.base.cameras.times)


class F4X_OT_write_motion(_MotionOperator):  # noqa: N801
    """Add the changed motion of nodes (keys, handles, constraints) to the edits of the scene."""

    bl_idname = "f4x.write_motion"
    bl_label = "Write Motion Back"

    def act(self, context, scene_object):
        """Append one edit with all changed poses; like every edit it pends until it is saved."""
        root = scene_object.root
        if follows_timeline(root) and time_of(root) in scene_object.base.cameras.times:
            key_moved(root)
        with keys_in_force(root):
            change = changes(scene_object)
        if change is None:
            self.report({"INFO"}, "No node was moved, so there is nothing to write back")
            return
        scene_object.append(change, sentence="moved in Blender")
        mark_keyed(scene_object)
        display.refresh(scene_object)
        self.report({"INFO"}, f"Wrote the motion of {len(change.nodes)} nodes at {len(change.times)} frames")


OPERATORS: tuple[Any, ...] = (
    F4X_OT_grab_nodes,
    F4X_OT_add_handles,
    F4X_OT_remove_handles,
    F4X_OT_write_motion,
)
OF_FILES = (F4X_OT_choose_clip, F4X_OT_set_up_render, F4X_OT_find_scene, F4X_OT_pack_scene, F4X_OT_save_as)


class F4X_MT_object(bpy.types.Menu):  # noqa: N801
    """Submenu of the Object menu: operators on the nodes and the clip of a scene."""

    bl_label = "Feature4X"

    def draw(self, context):
        """List the operators."""
        for operator in (*OPERATORS, *OF_FILES):
            self.layout.operator(operator.bl_idname)


CLASSES = (*OPERATORS, F4X_MT_object)


def draw_menu(self, context) -> None:
    """Draw the entry of the Object menu."""
    self.layout.separator()
    self.layout.menu(F4X_MT_object.__name__)
