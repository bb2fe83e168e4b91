"""Keeps points on their nodes whatever is done to the empties: renaming, copying, deleting them, copying a whole scene.

Geometry nodes read the empties of a collection in the natural order of their names. Which place in that order a node has is
the attribute `node` of two helper meshes, worked out anew from the stored ids (`f4x_node`, `node_id`) whenever the names in the
collection change:

    NAME pairs   node_id, reference INT, own_turn, own_place (of the pair) -> node, rest_turn, rest_place (of what carries it)
    NAME graph   node_id INT -> node

What a missing node carried is carried by the nearest one. A copied node is an empty like any other. A copied scene gets nodes,
helpers and node trees of its own.
"""

from __future__ import annotations

import hashlib
import re

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...f4x_core.geometry import quaternion
from ...f4x_core.language.lexicon import plural
from ...f4x_core.scaffold.missing import carriers
from ..common.point_cloud import read_attribute, write_attribute
from ..scene.clip_time import retarget
from ..scene.scene_object import SceneObject, root_of
from .scaffold import HANDLE, NODE, NODES, hide_nodes, layer_of, nodes_of

ORDER = "f4x_order"
"""Property of a root: hash of the names and ids that its nodes had when their places were worked out.

The helper meshes have it, too: undo brings back a root and not a mesh that is the same in both steps, though its places were
worked out since.
"""
_OWN = {"rest_turn": ("own_turn", "QUATERNION"), "rest_place": ("own_place", "FLOAT_VECTOR")}


def add_identity(mesh: bpy.types.Mesh, ids: np.ndarray, reference: np.ndarray | None = None) -> None:
    """Note down the node `ids (V,)` of a helper mesh and, for pairs, `reference (V,)` and the pairs' own rest poses."""
    write_attribute(mesh, "node_id", "INT", ids)
    if reference is not None:
        write_attribute(mesh, "reference", "INT", reference)
        for name, (own, kind) in _OWN.items():
            write_attribute(mesh, own, kind, read_attribute(mesh, name))


def add_pairs(
    name: str,
    root: bpy.types.Object,
    nodes: tuple[np.ndarray, np.ndarray],
    reference: np.ndarray,
    rest: tuple[np.ndarray, np.ndarray],
) -> bpy.types.Object:
    """Add a hidden helper mesh below `root`, a vertex for each pair of a node and a moment.

    `nodes`: place (P,) in the collection of nodes and id (P,); `reference (P,)`: number of the moment; `rest`: rotation (P,4) of
    any length and place (P,3) of the node then.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(reference))
    write_attribute(mesh, "node", "INT", nodes[0])
    write_attribute(mesh, "rest_turn", "QUATERNION", quaternion.conjugate(quaternion.normalize(rest[0])))
    write_attribute(mesh, "rest_place", "FLOAT_VECTOR", rest[1])
    add_identity(mesh, nodes[1], reference)
    helper = bpy.data.objects.new(mesh.name, mesh)
    root.users_collection[0].objects.link(helper)
    helper.parent = root
    helper.hide_viewport = helper.hide_render = True
    return helper


def repair(scene: bpy.types.Scene) -> None:
    """Put right the scenes in `scene` whose nodes were renamed, copied or deleted; does nothing else, and is quick then."""
    _part_points(scene)
    roots = [item for item in scene.objects if isinstance(item.get(NODES), bpy.types.Collection)]
    roots = [item for item in roots if _is_own(item)]
    roots.sort(key=lambda item: item.session_uid)
    owners: dict[bpy.types.Collection, bpy.types.Object] = {}
    for root in roots:
        if root[NODES] in owners:
            _set_up_copy(root, owners[root[NODES]])
        else:
            owners[root[NODES]] = root
    for root in roots:
        if NODES in root and not _is_in_order(root):
            _work_out_places(root)


def _part_points(scene: bpy.types.Scene) -> None:
    """Give scenes that share points, as linked copies do, points of their own: they may be edited otherwise."""
    owners: dict[bpy.types.ID, dict[bpy.types.Object, bpy.types.ID]] = {}  # points -> root -> points of its own
    shared = [item for item in scene.objects if item.type == "POINTCLOUD" and item.data.users > 1 and _is_own(item)]
    for item in sorted(shared, key=lambda item: item.session_uid):
        root = root_of(item)
        if root is not None:
            roots = owners.setdefault(item.data, {})
            if root not in roots:
                roots[root] = item.data.copy() if roots else item.data
            item.data = roots[root]


def _is_own(item: bpy.types.Object) -> bool:
    """Return True if an object belongs to this file."""
    return item.library is None and item.override_library is None


def _use_own_nodes(root: bpy.types.Object) -> None:
    """Let the trees of a scene that was copied with a whole Blender scene use its own copies of the nodes and helpers."""
    parts = [*SceneObject(root).clouds, *_helpers(root)]
    used = {found for item in parts for found in used_by(item) if isinstance(found, bpy.types.Collection)} - {
        root[NODES]
    }
    for original in [item for item in bpy.data.objects if item.get(NODES) in used]:
        swaps = {original[NODES]: root[NODES]} | dict(zip(_helpers(original), _helpers(root), strict=False))
        for item in parts:
            _swap_all(item, swaps)


def _work_out_places(root: bpy.types.Object) -> None:
    _use_own_nodes(root)
    nodes = nodes_of(root)
    copies = [item for item in root[NODES].objects if NODE in item and nodes.get(item[NODE]) != item]
    for item in copies:
        del item[NODE]
    place = {name: index for index, name in enumerate(_in_order(root[NODES]))}
    places = {id: place[item.name] for id, item in nodes.items()}
    missing = set()
    for helper in _helpers(root):
        missing |= _remap(helper.data, places)
    was, root[ORDER] = root.get(ORDER), _order(root)
    for mesh in _own_meshes(root):
        mesh[ORDER] = root[ORDER]
    if was is not None or missing:  # nothing happened to nodes that were just imported
        _tell(root, len(missing), [item.name for item in copies])


def _remap(mesh: bpy.types.Mesh, places: dict[int, int]) -> set[int]:
    """Write the places of the nodes into a helper mesh; returns the ids of the missing ones."""
    ids, reference = read_attribute(mesh, "node_id"), read_attribute(mesh, "reference")
    points = read_attribute(mesh, "position" if reference is None else "own_place")
    there = np.isin(ids, list(places))
    carrier = carriers(np.zeros_like(ids) if reference is None else reference, points, there)
    write_attribute(mesh, "node", "INT", np.array([places.get(id, 0) for id in ids[carrier].tolist()]))
    for name, (own, kind) in _OWN.items() if reference is not None else ():
        write_attribute(mesh, name, kind, read_attribute(mesh, own)[carrier])
    mesh.update_tag()
    return set(ids[~there].tolist())


def _tell(root: bpy.types.Object, missing: int, copies: list[str]) -> None:
    """Say in the sidebar, and where there is none on the console, what happened to the nodes."""
    line = ""
    if missing:
        those = "is missing; its points follow" if missing == 1 else "are missing; their points follow"
        back = "it" if missing == 1 else "them"
        line = f"{missing} {plural('node', missing)} {those} the nodes around {back}. Ctrl-Z brings {back} back."
    elif copies:
        those = f"{copies[0]} is a copy of a node" if len(copies) == 1 else f"{len(copies)} empties are copies of nodes"
        line = f"{those}; no points follow {'it' if len(copies) == 1 else 'them'}."
    if hasattr(root, "f4x"):
        root.f4x.notice = line
    if line:
        print(f"Feature4X: {root.name}: {line}")


def _set_up_copy(root: bpy.types.Object, original: bpy.types.Object) -> None:
    """Give a copied scene what it still shares with its original; a root that was copied without them becomes an empty."""
    clouds = SceneObject(root).clouds
    if not clouds:
        for key in [key for key in root.keys() if key.startswith("f4x_")]:  # noqa: SIM118 - no mapping
            del root[key]
        return
    handles = any(HANDLE in item for item in original.children_recursive)
    if handles:  # nodes hang below them; the points of the copy follow the original's nodes
        del root[NODES]
        return
    shared, own = root[NODES], bpy.data.collections.new(f"{root.name} nodes")
    root.users_collection[0].children.link(own)
    for item in _nodes_below(root, original):
        own.objects.link(item)
        if shared in item.users_collection:
            shared.objects.unlink(item)
    layer = layer_of(original)
    root[NODES] = own
    if layer is not None and layer.hide_viewport:
        hide_nodes(root)
    swaps = {shared: own}
    for helper in _helpers(original):  # they are hidden, and Blender copies only what can be selected
        swaps[helper] = _copy_below(root, original, helper)
    for item in (*clouds, *_helpers(root)):
        if item.data.users > 1:
            item.data = item.data.copy()
        _swap_all(item, swaps)
    retarget(root, original)
    root[ORDER] = ""


def _nodes_below(root: bpy.types.Object, original: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the nodes of a copied scene: those that were copied with it, and copies of the rest, hidden ones for example."""
    copied = {item[NODE]: item for item in root.children if NODE in item}
    actions: dict[bpy.types.Action, bpy.types.Action] = {}
    for id, item in nodes_of(original).items():
        if id in copied:
            continue
        copy = copied[id] = item.copy()
        copy.parent = root
        data = copy.animation_data
        if data is not None and data.action is not None:
            slot, action = data.action_slot.identifier, data.action
            data.action = actions.setdefault(action, actions.get(action) or action.copy())
            data.action_slot = data.action.slots[slot]
    return list(copied.values())


def _copy_below(root: bpy.types.Object, original: bpy.types.Object, helper: bpy.types.Object) -> bpy.types.Object:
    """Return the helper of a copied scene, copied here unless the user did it."""
    number = _helpers(original).index(helper)
    there = _helpers(root)
    if len(there) == len(_helpers(original)):
        return there[number]
    copy = helper.copy()
    for collection in root.users_collection:
        collection.objects.link(copy)
    copy.parent = root
    return copy


def _trees(item: bpy.types.Object) -> list[bpy.types.NodesModifier]:
    return [each for each in item.modifiers if each.type == "NODES" and each.node_group is not None]


def _sockets(tree: bpy.types.NodeTree) -> list[bpy.types.NodeSocket]:
    """Return the sockets of a tree that name a collection or an object."""
    return [socket for node in tree.nodes for socket in node.inputs if socket.type in ("COLLECTION", "OBJECT")]


def used_by(item: bpy.types.Object) -> set[bpy.types.ID | None]:
    """Return the collections and objects that the trees of an object use."""
    return {socket.default_value for modifier in _trees(item) for socket in _sockets(modifier.node_group)}


def _swap_all(item: bpy.types.Object, swaps: dict) -> None:
    """Let an object use copies of its trees with other collections and objects in them, where they use any of `swaps`."""
    for modifier in _trees(item):
        if any(socket.default_value in swaps for socket in _sockets(modifier.node_group)):
            modifier.node_group = modifier.node_group.copy()
            for socket in _sockets(modifier.node_group):
                socket.default_value = swaps.get(socket.default_value, socket.default_value)


def _helpers(root: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the helper meshes of a scene, the pairs first."""
    meshes = [item for item in root.children if item.type == "MESH" and "node_id" in item.data.attributes]
    return sorted(meshes, key=lambda item: "reference" not in item.data.attributes)


def _order(root: bpy.types.Object) -> str:
    """Return a hash of the names and collections that the order of the nodes depends on."""
    names = [f"{item.name}\t{item.get(NODE, '')}" for item in root[NODES].objects]
    return hashlib.sha256("\n".join([*names, "", *root[NODES].children.keys()]).encode()).hexdigest()


def _is_in_order(root: bpy.types.Object) -> bool:
    """Return True if the places of the nodes are those that were worked out last."""
    order = _order(root)
    return root.get(ORDER) == order and all(mesh.get(ORDER) == order for mesh in _own_meshes(root))


def _own_meshes(root: bpy.types.Object) -> list[bpy.types.Mesh]:
    """Return the helper meshes that are not another file's."""
    return [helper.data for helper in _helpers(root) if helper.data.library is None]


def _in_order(collection: bpy.types.Collection) -> list[str]:
    """Return the names of what is in a collection, in the order in which the node Collection Info reads it."""
    return sorted([*collection.objects.keys(), *collection.children.keys()], key=_Natural)


class _Natural:
    """Key of a name for Blender's natural order (`BLI_strcasecmp_natural`): numbers by value, letters without case."""

    def __init__(self, name: str):
        self.name = name.encode()
        self.parts = re.findall(rb"\d+|\D", self.name)

    def __lt__(self, other: _Natural) -> bool:
        """Return True if this name comes first."""
        zeros = 0
        for a, b in zip(self.parts, other.parts, strict=False):
            if a.isdigit() and b.isdigit():
                small, large = a.lstrip(b"0"), b.lstrip(b"0")
                if small != large:
                    return (len(small), small) < (len(large), large)
                zeros = zeros or len(a) - len(b)  # as many digits: fewer zeros first, if nothing else differs
            elif (first := a[:1].lower()) != (second := b[:1].lower()):
                return first == b"." or (second != b"." and first < second)
        return zeros < 0 or (zeros == 0 and self.name < other.name)


@persistent
def _changed(scene: bpy.types.Scene, *_) -> None:
    repair(scene)


@persistent
def _file_loaded(*_) -> None:
    repair(bpy.context.scene)


@persistent
def _brought_in(context: bpy.types.BlendImportContext, *_) -> None:
    """Hide the nodes of scenes that were appended or linked: their own file's view layer hid them, and stays there."""
    for item in context.import_items:
        if isinstance(item.id, bpy.types.Object) and NODES in item.id:
            hide_nodes(item.id)


HANDLERS = {
    "depsgraph_update_pre": _changed,
    "frame_change_pre": _changed,
    "load_post": _file_loaded,
    "blend_import_post": _brought_in,
}
