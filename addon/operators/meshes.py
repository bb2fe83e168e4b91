"""A mesh of the selected Gaussians, moved by the same nodes: for shadows, contact and holdouts in any engine.

    NAME mesh          the surface, below the root; point attribute `rgb`, modifiers as the dynamic point cloud has them
    NAME mesh pairs    its hidden helper, as NAME pairs is that of the Gaussians

The engine Feature4X draws the Gaussians and never such a mesh; what it does in other engines are Blender's own settings of objects.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, IntProperty

from ...f4x_core.edit.apply import EditedScene
from ...f4x_core.edit.meshing import MeshTask
from ...f4x_core.errors import F4xError
from ...f4x_core.scaffold import Scaffold
from ...f4x_core.scaffold.deformation import node_poses_at
from ...f4x_core.scene import Scene
from ...f4x_core.scene.color import linear_from_srgb
from ...f4x_core.scene.mesh import MeshConfig, Skin, SplatMesh
from ..common.geometry_nodes import build_motion_tree
from ..common.point_cloud import select_only, write_attribute
from ..common.undo import end_step
from ..common.wording import Reporting
from ..jobs import runner
from ..render.evaluated import OF
from ..rig.repair import add_pairs
from ..rig.scaffold import NODES, all_nodes
from ..scene import cache
from ..scene.scene_object import SceneObject, object_of
from .base import SceneOperator, Section

TITLE = "Mesh of"
"""Beginning of the titles of jobs that make a mesh."""


def add_mesh(root: bpy.types.Object, scene: Scene, made: SplatMesh, count: int) -> bpy.types.Object:
    """Add the mesh `made` of `count` Gaussians below `root`; it casts shadows, unseen. F4xError without its nodes."""
    curves = scene.curves if isinstance(scene, EditedScene) else scene.scaffold
    if made.skin is not None and curves is not None:
        all_nodes(root, curves.ids[np.unique(made.skin.node)])
    mesh = bpy.data.meshes.new(f"{root.name} mesh")
    mesh.from_pydata(made.vertices.tolist(), [], made.faces.tolist())
    mesh.shade_smooth()
    color = np.concatenate([linear_from_srgb(made.colors), np.ones((len(made.colors), 1))], axis=1)
    write_attribute(mesh, "rgb", "FLOAT_COLOR", color)
    mesh.materials.append(_material(mesh.name))
    item = bpy.data.objects.new(mesh.name, mesh)
    item[OF] = count
    root.users_collection[0].objects.link(item)
    item.parent = root
    item.visible_camera = False
    if made.skin is not None and curves is not None:
        _carry(item, root, curves, made.skin)
    return item


def _carry(item: bpy.types.Object, root: bpy.types.Object, curves: Scaffold, skin: Skin) -> None:
    """Let the nodes of `root` move a mesh by its skin, as geometry nodes move the Gaussians."""
    used, index = np.unique(skin.node, return_inverse=True)
    xyz, quat = node_poses_at(curves.times, curves.xyz, curves.quat, skin.time)
    helper = add_pairs(
        f"{item.name} pairs", root, (used, curves.ids[used]), np.zeros(len(used), int), (quat[used], xyz[used])
    )
    index = index.reshape(skin.node.shape)
    for slot in range(skin.node.shape[1]):
        write_attribute(item.data, f"pair_{slot}", "INT", index[:, slot])
        write_attribute(item.data, f"w_{slot}", "FLOAT", skin.weight[:, slot])
    write_attribute(item.data, "strength", "FLOAT", skin.strength)
    fades = bool((skin.strength < 1).any())
    modifier = item.modifiers.new("Feature4X motion", "NODES")
    modifier.node_group = build_motion_tree(f"{item.name} motion", root[NODES], helper, skin.node.shape[1], fades)


def _material(name: str) -> bpy.types.Material:
    """Return a rough surface of the colours of the Gaussians."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 1.0
    color = tree.nodes.new("ShaderNodeAttribute")
    color.attribute_name = "rgb"
    color.location = (-200, 300)
    tree.links.new(color.outputs["Color"], shader.inputs["Base Color"])
    return material


class F4X_OT_make_mesh(SceneOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Make a mesh around the selected Gaussians, moved by the same nodes. A job does it; it is listed under Tasks."""

    bl_idname = "f4x.make_mesh"
    bl_label = "Make Mesh"
    bl_options = {"REGISTER"}  # noqa: RUF012 - the job that it starts is a step of undo when it ends

    resolution: IntProperty(  # type: ignore[valid-type]
        name="Resolution", description="Steps along its longest side", default=MeshConfig.resolution, min=8, max=256
    )
    faces: IntProperty(  # type: ignore[valid-type]
        name="Triangles", description="Number of triangles at most", default=MeshConfig.faces, min=20, max=1_000_000
    )

    current: BoolProperty(  # type: ignore[valid-type]
        name="As at This Frame",
        description="Find the surface at the current frame; else at the frame where the thing is spread the widest",
    )

    def invoke(self, context, event):
        """Open the dialog."""
        return context.window_manager.invoke_props_dialog(self)

    def act(self, context, scene_object):
        """Start the job."""
        chosen = scene_object.selection
        if chosen is None:
            raise F4xError("Nothing is selected; type words, use Pick or a gesture, or select points in Edit Mode.")
        time = scene_object.frame if self.current else None
        _start(scene_object, chosen.chosen_ids, time, MeshConfig(self.resolution, self.faces))


def _start(scene_object: SceneObject, ids: np.ndarray, time: float | None, config: MeshConfig) -> None:
    """Start a job that makes a mesh, and adds it to the scene when it is done."""
    scene, uid, active = scene_object.edited, scene_object.root.session_uid, _active_uid()
    made = Path(mkdtemp(dir=bpy.app.tempdir, prefix="mesh-")) / "made.npz"
    edits = cache.text_of(scene_object.stack)

    def done(result: dict[str, Any]) -> None:
        root = object_of(uid)
        if root is None:
            raise F4xError("The scene that the mesh belongs to is no longer there; make it again.")
        item = add_mesh(root, scene, SplatMesh.read(made), len(ids))
        busy = active != _active_uid() or bpy.context.mode != "OBJECT"  # with something else by now
        if not busy and item.name in bpy.context.view_layer.objects:
            select_only(item)
        end_step("Make Mesh")

    task = MeshTask(str(scene_object.path), edits, ids.tolist(), time, asdict(config), str(made))
    runner.start_task(f"{TITLE} {scene_object.name}", task, done)


def _active_uid() -> int:
    """Return the session_uid of the active object; 0 where there is none."""
    active = bpy.context.view_layer.objects.active
    return 0 if active is None else active.session_uid


class F4X_OT_collider(Reporting, bpy.types.Operator):  # noqa: N801
    """Let other things bump into the mesh: a passive rigid body of its own shape, at every frame."""

    bl_idname = "f4x.collider"
    bl_label = "Collider"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - read by Blender

    @classmethod
    def poll(cls, context):
        """Return True for a mesh that was made of Gaussians."""
        return is_made(context.object)

    def execute(self, context):
        """Add the body, or take it away."""
        item = context.object
        with context.temp_override(object=item, active_object=item, selected_objects=[item]):
            if item.rigid_body is not None:
                bpy.ops.rigidbody.object_remove()
                return {"FINISHED"}
            bpy.ops.rigidbody.object_add(type="PASSIVE")
        body = item.rigid_body
        body.collision_shape, body.mesh_source = "MESH", "FINAL"
        body.use_deform = body.kinematic = True
        return {"FINISHED"}


class F4X_PT_mesh(Section, bpy.types.Panel):  # noqa: N801
    """Makes a mesh of a selection, and sets its shadow, holdout and collision."""

    bl_label = "Mesh"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - read by Blender

    def draw(self, context):
        """Draw the button, and the switches of the active mesh."""
        layout, item = self.layout, context.object
        layout.operator("f4x.make_mesh", text="Make Mesh…", icon="MESH_DATA")
        runner.draw_running(layout, context, TITLE)
        if is_made(item):
            column = layout.column(heading=item.name, align=True)
            for name in SWITCHES:
                column.prop(item, name)
            column.operator(
                "f4x.collider",
                icon="CHECKBOX_HLT" if item.rigid_body else "CHECKBOX_DEHLT",
                depress=bool(item.rigid_body),
            )
        layout.prop(context.scene.f4x_shadows, "use")
        row = layout.row()
        row.active = context.scene.f4x_shadows.use
        row.prop(context.scene.f4x_shadows, "strength", slider=True)
        layout.operator_menu_enum("f4x.composite", "engine", text="Composite Meshes With", icon="NODE_COMPOSITING")


def is_made(item: bpy.types.Object | None) -> bool:
    """Return True if an object is a mesh that was made of Gaussians."""
    return item is not None and OF in item


def _switch(native: str):
    """Return getter and setter of one of Blender's own switches, for a mesh that only some of them let a camera see."""

    def set_native(item, value):
        setattr(item, native, value)
        item.visible_camera = item.is_holdout or item.is_shadow_catcher

    return {"get": lambda item: getattr(item, native), "set": set_native}


SWITCHES = {
    "f4x_casts": ("visible_shadow", "Casts Shadows", "Cast shadows on other objects, in Cycles and EEVEE"),
    "f4x_holds_out": (
        "is_holdout",
        "Holdout",
        "Cut a hole where the thing stands, to lay the picture of the Gaussians there",
    ),
    "f4x_catches": ("is_shadow_catcher", "Shadow Catcher", "Show only the shadows that fall on it (Cycles)"),
}
"""Property of an object -> Blender's own setting, name, description."""
CLASSES = (F4X_OT_make_mesh, F4X_OT_collider, F4X_PT_mesh)


def register() -> None:
    """Add the switches."""
    for name, (native, title, description) in SWITCHES.items():
        setattr(bpy.types.Object, name, BoolProperty(name=title, description=description, **_switch(native)))


def unregister() -> None:
    """Undo `register`."""
    for name in SWITCHES:
        delattr(bpy.types.Object, name)
