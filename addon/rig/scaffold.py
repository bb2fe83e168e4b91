"""The scaffold as a rig: a keyed empty for each node, handles that move groups of nodes, and lines between nodes.

    NAME node 00000    child of the root; keyed at every clip frame; its `f4x_node` is the id of the scaffold's node
    NAME graph         mesh of the graph's edges that follows the nodes; hidden by default
    NAME group 00      follows a group of nodes that moves as one thing, keyed
      NAME handle 00   child of it, at rest: whoever moves, turns or keys it moves the group along, in the group's own frame
                       (then the group's nodes are its children)

Poses are read as Blender evaluates them - keys, parents, constraints and all - in the scene's own frame: the root's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np
from mathutils import Matrix

from ...f4x_core.errors import F4xError
from ...f4x_core.geometry import pose, quaternion
from ...f4x_core.scaffold import Scaffold
from ...f4x_core.scaffold.deformation import node_poses_at
from ...f4x_core.scaffold.grab import add_offset
from ...f4x_core.scaffold.groups import group_motion, rigid_groups
from ..common.animation import rewrite, sample, write_action
from ..common.geometry_nodes import FIRST_PAIR, build_graph_tree
from ..common.point_cloud import write_attribute
from ..scene.clip_time import timing_of
from ..scene.scene_object import TIMED, SceneObject

NODE = "f4x_node"
"""Property of a node's empty: the id of the node."""
NODES = "f4x_nodes"
"""Property of a root: the collection of its nodes' empties."""
HANDLE = "f4x_handle"
"""Property of a handle and of the empty that carries it: the number of its group."""
NODE_SIZE, HANDLE_SIZE = 0.4, 2.0
"""Drawn sizes of empties in node spacings."""
PLACE, TURN = "location", "rotation_quaternion"
MOVED = 1e-6
"""Smallest difference between a property and its keys that a hand made; what Blender evaluates is equal."""
MIN_GROUP_SIZE = 2
"""Minimum number of nodes in a group; a single node needs no handle."""


def layer_of(root: bpy.types.Object) -> bpy.types.LayerCollection | None:
    """Return the nodes of a scene in the current view layer, with the switch that hides their empties; None where it has none."""
    collection, layers = root.get(NODES), [bpy.context.view_layer.layer_collection]
    while collection is not None and layers:
        layer = layers.pop()
        if layer.collection == collection:
            return layer
        layers.extend(layer.children)
    return None


def hide_nodes(root: bpy.types.Object) -> None:
    """Hide the nodes of a scene in the present view layer: hundreds of empties would cover what moves; the sidebar shows them."""
    layer = layer_of(root)
    if layer is not None:
        layer.hide_viewport = True


def poses_of(scaffold: Scaffold, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses (xyz (T,M,3), quat (T,M,4)) at clip frames, neighbours in time on one hemisphere."""
    poses = [node_poses_at(scaffold.times, scaffold.xyz, scaffold.quat, float(frame)) for frame in frames]
    return np.stack([xyz for xyz, _ in poses]), quaternion.align_sequence(np.stack([quat for _, quat in poses]))


def add_nodes(name: str, curves: Scaffold, frames: np.ndarray, collection, root) -> bpy.types.Collection:
    """Return a collection with an empty for each node. Keyed at every clip frame, also at held-out ones: linear between keys then
    agrees with the core at whole frames."""
    nodes = bpy.data.collections.new(f"{name} nodes")
    collection.children.link(nodes)
    xyz, quat = poses_of(curves, frames)
    for i, id in enumerate(curves.ids.tolist()):
        empty = _add_empty(f"{name} node {i:05d}", nodes, root, NODE_SIZE * curves.unit)
        empty[NODE] = id
        write_action(empty, frames, {PLACE: xyz[:, i], TURN: quat[:, i]})
    root[NODES] = nodes
    return nodes


def add_graph(name: str, curves: Scaffold, nodes: bpy.types.Collection, collection, root) -> bpy.types.Object:
    """Return the graph's edges as a hidden mesh whose corners follow the nodes."""
    mesh = bpy.data.meshes.new(f"{name} graph")
    mesh.from_pydata(curves.xyz[0].tolist(), curves.edges.tolist(), [])
    write_attribute(mesh, "node", "INT", np.arange(len(curves.ids)))
    graph = bpy.data.objects.new(mesh.name, mesh)
    collection.objects.link(graph)
    graph.parent = root
    graph.modifiers.new("Feature4X graph", "NODES").node_group = build_graph_tree(f"{name} graph", nodes)
    graph.hide_viewport = graph.hide_render = True
    return graph


def nodes_of(root: bpy.types.Object) -> dict[int, bpy.types.Object]:
    """Return the empties of the nodes by the ids of the nodes, without missing ones and without copies."""
    collection = root.get(NODES)  # a .blend of an older version has none
    if collection is None and not any(FIRST_PAIR in cloud.data.attributes for cloud in SceneObject(root).clouds):
        return {}  # nothing moves; an artist may have hung another scene's nodes there
    items = SceneObject(root).below if collection is None else collection.objects
    # a copy is younger than its original
    found = sorted((item for item in items if NODE in item), key=lambda item: item.session_uid, reverse=True)
    return {item[NODE]: item for item in found}


def all_nodes(root: bpy.types.Object, ids: np.ndarray) -> list[bpy.types.Object]:
    """Return the empties of the nodes `ids (M,)`. Raises F4xError if one is missing."""
    found = nodes_of(root)
    missing = sum(id not in found for id in ids.tolist())
    if missing:
        those = "node is" if missing == 1 else "nodes are"
        raise F4xError(f"{root.name}: {missing} {those} missing; press Ctrl-Z, or import the scene again.")
    return [found[id] for id in ids.tolist()]


def read_poses(
    root: bpy.types.Object, items: Sequence[bpy.types.Object | None], frames: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses (xyz (T,n,3), quat (T,n,4)) float64 of `items` at clip frames, in the scene's frame, as Blender has them."""
    scene, present = bpy.context.scene, bpy.context.scene.frame_current_final
    shown_at = timing_of(root).frames_of(frames)
    xyz, quat = np.zeros((len(frames), len(items), 3)), np.zeros((len(frames), len(items), 4))
    with _gaussians_at_rest(root):
        for i, frame in enumerate(shown_at):
            set_frame(scene, frame)
            xyz[i], quat[i] = poses_now(root, items)
        set_frame(scene, present)
    return xyz, quaternion.align_sequence(quat)


def set_frame(scene: bpy.types.Scene, frame: float) -> None:
    """Go to a frame of the timeline, or between two."""
    whole = int(np.floor(frame))
    scene.frame_set(whole, subframe=float(frame) - whole)


def poses_now(root: bpy.types.Object, items: Sequence[bpy.types.Object | None]) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses (xyz (n,3), quat (n,4)) float64 of `items` at the current frame in the scene's frame, as last evaluated.

    None stands for Blender's world: the parent of a node whose own one an artist took away.
    """
    to_scene = root.matrix_world.inverted()
    stand = [to_scene if item is None else to_scene @ item.matrix_world for item in items]
    found = np.array(stand, np.float64).reshape(len(items), 4, 4)
    found[:, :3, :3] /= np.linalg.norm(found[:, :3, :3], axis=-2, keepdims=True)  # an empty's size takes no part
    quat, xyz = pose.from_matrix(found)
    return xyz, quat


def key_moved(root: bpy.types.Object) -> None:
    """Key at the current frame the nodes and handles that were moved there by hand: a look at another frame would put them back."""
    frame = bpy.context.scene.frame_current_final
    for item in root.children_recursive:
        if NODE not in item and HANDLE not in item:
            continue
        for path, keyed in sample(item, np.array([frame]), (PLACE, TURN)).items():
            if np.abs(keyed[0] - getattr(item, path)).max() > MOVED:
                item.keyframe_insert(path, frame=frame)


def write_poses(
    root: bpy.types.Object, items: Sequence[bpy.types.Object], frames: np.ndarray, xyz: np.ndarray, quat: np.ndarray
) -> None:
    """Key `items` at clip frames so that they stand at `xyz (T,n,3)`, `quat (T,n,4)` of the scene's frame, whoever their
    parents are."""
    keyed_at = timing_of(root).frames_of(frames)
    parents = list(dict.fromkeys(item.parent for item in items))
    above_xyz, above_quat = read_poses(root, parents, frames)
    for i, item in enumerate(items):
        above = parents.index(item.parent)
        item.matrix_parent_inverse = Matrix()
        item.rotation_mode = "QUATERNION"
        local = pose.compose(*pose.invert(above_quat[:, above], above_xyz[:, above]), quat[:, i], xyz[:, i])
        rewrite(item, keyed_at, {PLACE: local[1], TURN: quaternion.align_sequence(local[0])})


def hold(
    root: bpy.types.Object,
    items: Sequence[bpy.types.Object],
    frames: np.ndarray,
    offset: tuple[np.ndarray, np.ndarray],
    fraction: np.ndarray,
) -> None:
    """Add `fraction (T,)` of `offset` = `(quat (n,4), xyz (n,3))`, in each item's own frame, to its keys at clip frames
    `frames (T,)`."""
    frames = timing_of(root).frames_of(frames)
    for i, item in enumerate(items):
        keyed = sample(item, frames, (PLACE, TURN))
        one = offset[0][i : i + 1], offset[1][i : i + 1]
        xyz, quat = add_offset(keyed[PLACE][:, None], quaternion.normalize(keyed[TURN])[:, None], one, fraction)
        rewrite(item, frames, {PLACE: xyz[:, 0], TURN: quaternion.align_sequence(quat[:, 0])})


def add_handles(root: bpy.types.Object, unit: float, frames: np.ndarray, count: int | None) -> list[bpy.types.Object]:
    """Add a handle for each group of nodes that moves rigidly: `count` groups, or as many as the motion shows.

    The motion stays the same. Existing handles are removed first.
    """
    remove_handles(root, frames)
    nodes = list(nodes_of(root).values())
    xyz, quat = read_poses(root, nodes, frames)
    group = rigid_groups(xyz, count)
    collection = bpy.data.collections.new(f"{root.name} handles")
    root.users_collection[0].children.link(collection)
    handles = []
    for number in range(group.max(initial=-1) + 1):
        members = np.flatnonzero(group == number)
        if len(members) < MIN_GROUP_SIZE:
            continue
        carrier = _add_empty(f"{root.name} group {number:02d}", collection, root, unit)
        handle = _add_empty(f"{root.name} handle {number:02d}", collection, carrier, HANDLE_SIZE * unit)
        handle.empty_display_type = "SPHERE"
        carrier[HANDLE] = handle[HANDLE] = number
        turn, place = group_motion(xyz[:, members])
        write_action(carrier, timing_of(root).frames_of(frames), {PLACE: place, TURN: turn})
        carrier.hide_set(True)
        for member in members:
            nodes[member].parent = handle
        handles.append(handle)
    write_poses(root, nodes, frames, xyz, quat)
    return handles


def remove_handles(root: bpy.types.Object, frames: np.ndarray) -> None:
    """Remove the handles; the nodes keep their current motion."""
    old = [item for item in SceneObject(root).below if HANDLE in item]
    if not old:
        return
    nodes = list(nodes_of(root).values())
    xyz, quat = read_poses(root, nodes, frames)
    for node in nodes:
        node.parent = root
    write_poses(root, nodes, frames, xyz, quat)
    collections = {collection for item in old for collection in item.users_collection}
    for item in old:
        bpy.data.objects.remove(item)
    for collection in collections:
        if not collection.all_objects:
            bpy.data.collections.remove(collection)


@contextmanager
def _gaussians_at_rest(root: bpy.types.Object) -> Iterator[None]:
    """Switch modifiers below `root` and timed edits off within a `with` block that needs the empties alone."""
    shown = [m for item in SceneObject(root).below for m in item.modifiers if m.show_viewport]
    timed, root[TIMED] = root.get(TIMED, False), False
    for modifier in shown:
        modifier.show_viewport = False
    try:
        yield
    finally:
        root[TIMED] = timed
        for modifier in shown:
            modifier.show_viewport = True


def _add_empty(name: str, collection: bpy.types.Collection, parent: bpy.types.Object, size: float) -> bpy.types.Object:
    empty = bpy.data.objects.new(name, None)
    collection.objects.link(empty)
    empty.parent = parent
    empty.rotation_mode = "QUATERNION"
    empty.empty_display_size = size
    return empty
