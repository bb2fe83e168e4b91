"""Meshes as Cycles or EEVEE draw them among the Gaussians: a second scene for the meshes, and nodes that merge both pictures.

Blender renders a scene with one engine. So a second scene, `NAME meshes`, has the same collections but for those of Gaussians,
and its render layer is an input of the first one's compositor. The first scene's view layer holds all meshes out, and its pass
Holdout says how much of each pixel shows them, by depth and with soft edges:

    picture = Gaussians + meshes / alpha of the meshes x Holdout
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from bpy.app.handlers import persistent
from bpy.props import EnumProperty

from ...f4x_core.errors import F4xError
from ..common.point_cloud import read_attribute
from ..common.render_settings import ENGINE
from ..common.wording import Reporting

MESHES = "f4x_meshes"
"""Property of a scene: the scene that draws its meshes."""
SPLATS = "f4x_splats"
"""Property of a collection that holds Gaussians alone, which the other scene leaves out."""
NODE = "Feature4X"
"""Beginning of the names of our nodes."""
ENGINES = {"CYCLES": ("CYCLES",), "EEVEE": ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT")}
"""Engine -> its identifiers, of which a Blender knows one."""
TITLES = {"CYCLES": "Cycles", "EEVEE": "EEVEE"}
"""Their names for people."""
SAMPLES = 128
"""Samples of Cycles in a new scene for meshes."""
SAME = (
    *("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "fps", "fps_base"),
    *("use_border", "border_min_x", "border_min_y", "border_max_x", "border_max_y", "use_crop_to_border"),
    *("use_motion_blur", "motion_blur_shutter", "motion_blur_position", "use_multiview", "views_format"),
)
"""Render settings that both scenes have to share."""
ROW, COLUMN = 100, 320
"""Height that a closed node takes up in the compositor, and width."""
ALIKE = ("exclude", "holdout", "indirect_only")
"""Settings of collections in a view layer that both scenes share."""


def set_up(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, engine: str) -> bpy.types.Scene:
    """Let `engine` (of `ENGINES`) draw the meshes of a scene in its renders; returns the scene that does. May raise F4xError."""
    _gather_splats(scene)
    other = scene.get(MESHES)
    if other is None:
        other = scene[MESHES] = bpy.data.scenes.new(f"{scene.name} meshes")
        if hasattr(other, "cycles"):  # its extension may be off
            other.cycles.samples = SAMPLES
        other.frame_set(scene.frame_current, subframe=scene.frame_subframe)  # what both share is evaluated in both
    other.render.film_transparent = True
    known = other.render.bl_rna.properties["engine"].enum_items
    for name in ENGINES[engine]:
        if name in known or name == "CYCLES":
            other.render.engine = name
    scene.render.engine, scene.render.use_compositing = ENGINE, True
    layer.f4x_hold_out_meshes = layer.f4x_passes.holdout = True
    scene.f4x_shadows.use = True
    _show_splats(layer.layer_collection)
    layer.update_render_passes()
    synchronize(scene)
    _add_nodes(scene, layer, other)
    return other


def synchronize(scene: bpy.types.Scene) -> None:
    """Copy the camera, picture size, frames, collections and world of `scene` to the scene that renders its meshes."""
    other = scene.get(MESHES)
    if other is None:
        return
    for name in SAME:
        setattr(other.render, name, getattr(scene.render, name))
    for name in ("camera", "world", "frame_start", "frame_end", "frame_step"):
        setattr(other, name, getattr(scene, name))
    for kind in ("children", "objects"):
        ours, theirs = getattr(scene.collection, kind), getattr(other.collection, kind)
        for each in set(theirs) - set(ours):
            theirs.unlink(each)
        for each in set(ours) - set(theirs):
            theirs.link(each)
    other.view_layers.update()
    for first, second in zip(scene.view_layers, other.view_layers, strict=False):
        if second.layer_collection is None:  # that of a new scene in Blender 5.3
            second.update()
        _align(first.layer_collection, second.layer_collection)


def _align(first: bpy.types.LayerCollection, second: bpy.types.LayerCollection) -> None:
    """Give collections of the second scene's view layer the settings that they have in the first one's."""
    for child in second.children:
        model = first.children.get(child.name)
        if model is None:
            continue
        for name in ALIKE:
            wanted = getattr(model, name) or (name == "exclude" and SPLATS in child.collection)
            if getattr(child, name) != wanted:
                setattr(child, name, wanted)
        _align(model, child)


def _show_splats(parent: bpy.types.LayerCollection) -> None:
    """Show Gaussians that are left out, in a scene that drew meshes for another one before."""
    for child in parent.children:
        if SPLATS in child.collection and child.exclude:
            child.exclude = False
        _show_splats(child)


def _collections(parent: bpy.types.Collection) -> Iterator[bpy.types.Collection]:
    yield parent
    for child in parent.children:
        yield from _collections(child)


def _gather_splats(scene: bpy.types.Scene) -> None:
    """Move Gaussians into collections of their own, below those where they are. F4xError where that is another file's."""
    for collection in list(_collections(scene.collection)):
        splats = [item for item in collection.objects if _is_splats(item)]
        if not splats or SPLATS in collection:
            continue
        if not collection.is_editable:
            raise F4xError(
                f"The collection {collection.name} is linked from another file; make it local (Object > Relations), then"
                " composite."
            )
        own = next((child for child in collection.children if SPLATS in child), None)
        if own is None:
            own = bpy.data.collections.new(f"{collection.name} splats")
            own[SPLATS] = True
            collection.children.link(own)
        for item in splats:
            own.objects.link(item)
            collection.objects.unlink(item)


def _is_splats(item: bpy.types.Object) -> bool:
    return item.type == "POINTCLOUD" and read_attribute(item.data, "radiance:base") is not None


def _add_nodes(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, other: bpy.types.Scene) -> None:
    """Add the nodes that merge both pictures to the compositor, or add them anew, and let them give the result."""
    tree, sink = _tree(scene)
    for node in [node for node in tree.nodes if node.name.startswith(f"{NODE} ")]:
        tree.nodes.remove(node)
    splats, meshes = _layer_node(tree, scene, layer.name), _layer_node(tree, other, other.view_layers[0].name)
    splats.label, meshes.label = "Gaussians", "Meshes"
    held = splats.outputs.get("Holdout")
    if held is None:
        raise F4xError(f"The view layer {layer.name} has no pass Holdout; register the engine Feature4X first.")
    part = _math(tree, "DIVIDE", held, meshes.outputs["Alpha"])
    channels = [_new(tree, "CompositorNodeSeparateColor") for _ in range(2)]
    tree.links.new(splats.outputs["Image"], channels[0].inputs[0])
    tree.links.new(meshes.outputs["Image"], channels[1].inputs[0])
    whole = _new(tree, "CompositorNodeCombineColor")
    for number, (first, second) in enumerate(zip(channels[0].outputs, channels[1].outputs, strict=True)):
        tree.links.new(_math(tree, "MULTIPLY_ADD", second, part, first), whole.inputs[number])
    tree.links.new(whole.outputs[0], sink.inputs[0])
    for column, nodes in enumerate(_columns(tree)):
        for row, node in enumerate(nodes):
            node.location = (COLUMN * column, -row * (ROW if node.hide else 3 * ROW))
    splats.location.y, meshes.location.y = ROW, -3 * ROW
    sink.location = (whole.location.x + COLUMN, 0)


def _columns(tree: bpy.types.NodeTree) -> list[list[bpy.types.Node]]:
    """Return our nodes by column, from left to right."""
    ours = [node for node in tree.nodes if node.name.startswith(f"{NODE} ")]
    order = ("R_LAYERS", "SEPARATE_COLOR", "MATH", "COMBINE_COLOR")
    return [[node for node in ours if node.type == kind] for kind in order]


def _tree(scene: bpy.types.Scene) -> tuple[bpy.types.NodeTree, bpy.types.Node]:
    """Return the compositor's nodes, and the node that is their result."""
    if "compositing_node_group" not in scene.bl_rna.properties:  # before 5.0
        scene.use_nodes = True
        tree = scene.node_tree
        sinks = [node for node in tree.nodes if node.type == "COMPOSITE"]
        return tree, sinks[0] if sinks else tree.nodes.new("CompositorNodeComposite")
    tree = scene.compositing_node_group
    if tree is None:
        tree = scene.compositing_node_group = bpy.data.node_groups.new(f"{scene.name} composite", "CompositorNodeTree")
    if not any(item.in_out == "OUTPUT" for item in tree.interface.items_tree):
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    sinks = [node for node in tree.nodes if node.type == "GROUP_OUTPUT"]
    return tree, sinks[0] if sinks else tree.nodes.new("NodeGroupOutput")


def _new(tree: bpy.types.NodeTree, *kinds: str) -> bpy.types.Node:
    """Return a new node of the first of these kinds that there is."""
    for kind in kinds[:-1]:
        if hasattr(bpy.types, kind):
            break
    else:
        kind = kinds[-1]
    node = tree.nodes.new(kind)
    node.name = f"{NODE} {node.name}"
    return node


def _layer_node(tree: bpy.types.NodeTree, scene: bpy.types.Scene, layer: str) -> bpy.types.Node:
    node = _new(tree, "CompositorNodeRLayers")
    node.scene, node.layer = scene, layer
    return node


def _math(tree: bpy.types.NodeTree, operation: str, *sources: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return the result of a calculation with these values."""
    node = _new(tree, "CompositorNodeMath", "ShaderNodeMath")
    node.operation, node.hide = operation, True
    for source, socket in zip(sources, node.inputs, strict=False):
        tree.links.new(source, socket)
    return node.outputs[0]


class F4X_OT_composite(Reporting, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Let Cycles or EEVEE draw the meshes in renders of this scene, merged with the Gaussians by depth."""

    bl_idname = "f4x.composite"
    bl_label = "Composite"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - read by Blender

    engine: EnumProperty(  # type: ignore[valid-type]
        name="Engine",
        description="What draws the meshes",
        items=[(name, title, "") for name, title in TITLES.items()],
    )

    def execute(self, context):
        """Set up the scene for meshes, the view layer and the compositor."""
        scene = context.scene
        if any(each.get(MESHES) == scene for each in bpy.data.scenes):
            raise F4xError(f"{scene.name} draws the meshes of another scene; choose that one first.")
        other = set_up(scene, context.view_layer, self.engine)
        lamps = any(item.type == "LIGHT" for item in scene.objects)
        hint = "" if lamps else ". Add a lamp for light and shadows"
        self.report(
            {"INFO"},
            f"Renders merge {other.name}, drawn by {TITLES[self.engine]}, in the compositor of {scene.name}{hint}",
        )
        return {"FINISHED"}


@persistent
def _render_begins(scene: bpy.types.Scene, *_) -> None:
    synchronize(scene)


HANDLERS = {"render_init": _render_begins}

CLASSES = (F4X_OT_composite,)
