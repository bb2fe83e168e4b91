"""Reads the evaluated Blender scene as the core's stage: Gaussians after geometry nodes, surfaces, the world."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import bpy
import numpy as np

from ...f4x_core.edit.resolve import named
from ...f4x_core.query.matte import MOVES
from ...f4x_core.query.unseen import unseen_gaussians
from ...f4x_core.scene.clouds import Cloud
from ...f4x_core.scene.color import srgb_from_linear
from ...f4x_core.scene.cryptomatte import identify
from ...f4x_core.scene.stage import Surface
from ..common.gaussian_attributes import FITTED_FOCAL, read_look
from ..common.geometry_nodes import TINT
from ..common.point_cloud import read_attribute
from ..rig.native_motion import carried_cloud
from ..scene.scene_object import HIDDEN, SceneObject, root_of
from .surfaces import Images, surface_of

LAYERS = {"latent": "f4x_latent", "selection": ".selection", "score": "f4x_score"}
"""Passes of the stage and the point attributes they show."""
_POSED = {"position": "means", "rotation": "quats", "turn": "turn"}
"""Attributes that may be read anew one by one, and what of a cloud they are."""
_LOOKS = {"scale", "radiance:base"}
"""Attributes that are read anew together (`read_look`)."""
_KEPT = {"scales", "opacities"}
"""Attributes that modifiers mostly write without a change: then the array stays the same object."""
_UNSEEN = {"rgb", "radius"}
"""Attributes that the engine does not look at."""
_READERS = (
    "NodeGroupInput",
    "GeometryNodeCaptureAttribute",
    "GeometryNodeCollectionInfo",
    "GeometryNodeObjectInfo",
)
"""Nodes that hand on geometry as it is."""
OF = "f4x_of"
"""Property of a mesh that was made of Gaussians: how many. The engine draws the Gaussians and not the mesh."""
SOLID = ("MESH", "CURVE", "SURFACE", "FONT", "META")


class Mattes:
    """Layers of mattes: objects, collections, and in scenes the selections that edits named. Gathers their names."""

    def __init__(self):
        self.names: dict[str, dict[str, None]] = {"object": {}, "collection": {}}
        self._selected: dict[str, dict[str, np.ndarray]] = {}

    def of(self, owner: bpy.types.Object) -> dict[str, int]:
        """Return layer -> id of an object as a whole."""
        collections = owner.users_collection
        return {
            "object": self._id("object", owner.name),
            "collection": self._id("collection", collections[0].name) if collections else 0,
        }

    def of_points(self, owner: bpy.types.Object, data: bpy.types.PointCloud) -> dict[str, np.ndarray]:
        """Return layer -> (N,) id of each point of an object's evaluated `data`; of several selections the last one counts."""
        ids = {layer: np.full(len(data.points), own, np.uint32) for layer, own in self.of(owner).items()}
        found, gid = SceneObject.of(owner), read_attribute(data, "gid")
        if found is not None and gid is not None:
            shown = found.shown
            if found.name not in self._selected:
                self._selected[found.name] = {name: each.chosen for name, each in named(shown.scene).items()}
            row, known = shown.rows_of(gid)
            for name, chosen in self._selected[found.name].items():
                ids["object"][known & chosen[row]] = self._id("object", name)
        return ids

    @property
    def selections(self) -> set[int]:
        """Return the ids of the selections that edits named."""
        return {identify(name) for selected in self._selected.values() for name in selected}

    def _id(self, layer: str, name: str) -> int:
        self.names[layer][name] = None
        return identify(name)


class More(NamedTuple):
    """Contents of a stage that only some passes need."""

    mattes: Mattes | None = None
    """Gathers mattes; None = no pass needs them."""
    unseen: bool = False
    """True if each Gaussian gets a number that tells whether any frame of its clip shows it."""
    moving: bool = False
    """True if each Gaussian gets a number that tells whether it moves."""
    lit: Callable[[bpy.types.Object, Cloud], Cloud] | None = None
    """Function of an evaluated object and its cloud that returns the cloud with light; None = no shadows."""
    hold_out: bool = False
    """True if all surfaces are held out."""


class _Holdouts:
    """The holdouts of a view layer: objects, collections, and all of a scene whose root is held out."""

    def __init__(self, depsgraph: bpy.types.Depsgraph):
        self._layer = depsgraph.view_layer

    def is_held(self, owner: bpy.types.Object) -> bool:
        """Return True if an object that owns something seen cuts a hole."""
        root = root_of(owner) if owner.type == "POINTCLOUD" else None
        return owner.holdout_get(view_layer=self._layer) or (root is not None and root.is_holdout)


def stage(depsgraph: bpy.types.Depsgraph, more: More | None = None) -> tuple[list[Cloud], list[Surface]]:
    """Return every visible point cloud that holds Gaussians and every visible surface, instances too, in Blender's world."""
    more = more or More()
    mattes = more.mattes
    holds, images = _Holdouts(depsgraph), Images()
    clouds: list[Cloud] = []
    surfaces: list[Surface] = []
    for instance, item, owner in _visible(depsgraph, None):
        to_world = np.array(instance.matrix_world)
        key = f"{owner.name}/{item.name}/{tuple(instance.persistent_id) if instance.is_instance else ''}"
        if item.type == "POINTCLOUD":
            cloud = _cloud(item.data, to_world, item.pass_index)
            if cloud is not None:
                cloud = more.lit(item, cloud) if more.lit else cloud
                ids = mattes.of_points(item.original, item.data) if mattes else {}
                own = _layers(item.original, item.data, more)
                held = holds.is_held(owner)
                clouds.append(replace(cloud, key=key, mattes=ids, layers={**cloud.layers, **own}, holdout=held))
        else:
            surface = surface_of(item, to_world, images)
            if surface is not None:
                ids = mattes.of(item.original) if mattes else {}
                surfaces.append(replace(surface, key=key, mattes=ids, holdout=more.hold_out or holds.is_held(owner)))
    return clouds, surfaces


def _layers(owner: bpy.types.Object, data: bpy.types.PointCloud, more: More) -> dict[str, np.ndarray]:
    """Return the layers (N,1) that `more` asks for of evaluated points; nothing where they belong to no scene."""
    found, gid = SceneObject.of(owner), read_attribute(data, "gid")
    if found is None or gid is None or not (more.unseen or more.moving):  # a farm may lack the scene file
        return {}
    row, known = found.shown.rows_of(gid)
    scene = found.shown.scene
    layers = {"unseen": unseen_gaussians(scene)} if more.unseen else {}
    layers |= {MOVES: scene.moving} if more.moving else {}
    return {name: (known & values[row])[:, None] for name, values in layers.items()}


def _visible(
    depsgraph: bpy.types.Depsgraph, view: bpy.types.SpaceView3D | None
) -> Iterator[tuple[bpy.types.DepsgraphObjectInstance, bpy.types.Object, bpy.types.Object]]:
    """Yield (instance, its evaluated object, the object that owns it) of all point clouds and surfaces that a picture shows.

    `view` is the viewport that looks, where one does: it may hide objects of its own.
    """
    for instance in depsgraph.object_instances:
        item = instance.object
        if item.type != "POINTCLOUD" and item.type not in SOLID:
            continue
        owner = (instance.parent or item).original
        hidden = not instance.show_self or not item.visible_camera or OF in item.original
        hidden = hidden or owner.indirect_only_get(view_layer=depsgraph.view_layer)
        if not hidden and (view is None or owner.visible_in_viewport_get(view)):
            yield instance, item, owner


class Reader:
    """Reads a stage again and again, each time only what Blender says has changed: what has not is the very same array.

    It has to be asked after every evaluation, as a viewport's engine is.
    """

    def __init__(self) -> None:
        """Begin with nothing read."""
        self._clouds: dict[tuple, tuple[Cloud | None, frozenset[str] | None]] = {}
        self._surfaces: dict[tuple, tuple[np.ndarray, Surface | None]] = {}
        self._written: dict[int, frozenset[str] | None] = {}
        self._images = Images()

    def stage(
        self, depsgraph: bpy.types.Depsgraph, view: bpy.types.SpaceView3D | None = None
    ) -> tuple[list[Cloud], list[Surface]]:
        """Return the clouds and surfaces of `stage`, as a viewport sees them; what did not change is kept from the last call."""
        changed = _Changes(depsgraph)
        if changed.trees:
            self._written = {}
        if changed.others:
            self._images = Images()
        clouds: dict[tuple, tuple[Cloud | None, frozenset[str] | None]] = {}
        surfaces: dict[tuple, tuple[np.ndarray, Surface | None]] = {}
        shown: list[Cloud] = []
        holds = _Holdouts(depsgraph)
        for instance, item, owner in _visible(depsgraph, view):
            to_world = np.array(instance.matrix_world)
            data = item.original.data.session_uid
            key = (item.original.session_uid, data, *instance.persistent_id, owner.session_uid)
            if item.type == "POINTCLOUD":
                cloud, written = self._cloud(key, item, to_world, changed)
                clouds[key] = None if cloud is None else replace(cloud, holdout=holds.is_held(owner)), written
                if clouds[key][0] is not None:
                    shown.append(carried_cloud(item.original, clouds[key][0], item.data))
            else:
                surface, held = self._surface(key, item, to_world, changed), holds.is_held(owner)
                same = surface is None or surface.holdout == held
                surfaces[key] = to_world, surface if same else replace(surface, holdout=held)
        self._clouds, self._surfaces = clouds, surfaces
        parts = [surface for _, surface in surfaces.values()]
        return shown, [part for part in parts if part is not None]

    def _cloud(
        self, key: tuple, item: bpy.types.Object, to_world: np.ndarray, changed: _Changes
    ) -> tuple[Cloud | None, frozenset[str] | None]:
        """Return the cloud, and the attributes that its modifiers write."""
        written = self._written_by(item)
        old, before = self._clouds.get(key, (None, None))
        if old is None or changed.any_data(item) or written != before:
            return _cloud(item.data, to_world, item.pass_index), written
        old = replace(old, to_world=to_world, index=item.pass_index)
        if not changed.shape(item):
            return old, written
        if written is None:
            return _cloud(item.data, to_world, item.pass_index), None
        return _reread(item.data, old, written), written

    def _written_by(self, item: bpy.types.Object) -> frozenset[str] | None:
        """Return the attributes that the modifiers of a point cloud write in viewports; None = they may do anything."""
        written: frozenset[str] | None = frozenset()
        for modifier in [each for each in item.original.modifiers if each.show_viewport]:
            tree = modifier.node_group if modifier.type == "NODES" else None
            uid = tree.session_uid if tree else -1
            if uid not in self._written:
                self._written[uid] = _attributes_of(tree)
            one = self._written[uid]
            written = None if written is None or one is None else written | one
        return written

    def _surface(self, key: tuple, item: bpy.types.Object, to_world: np.ndarray, changed: _Changes) -> Surface | None:
        old = self._surfaces.get(key)
        if old is None or changed.others or changed.shape(item) or not np.array_equal(old[0], to_world):
            return surface_of(item, to_world, self._images)
        return old[1]


class _Changes:
    """Datablocks that an evaluation changed."""

    def __init__(self, depsgraph: bpy.types.Depsgraph) -> None:
        self._shapes: set[int] = set()
        self._data: set[int] = set()
        self.trees = self.others = False
        """True if a node tree, and if anything but objects, point clouds and animation has changed."""
        for update in depsgraph.updates:
            data = update.id.original
            if isinstance(data, bpy.types.Object):
                if update.is_updated_geometry or update.is_updated_shading:
                    self._shapes.add(data.session_uid)
            elif isinstance(data, bpy.types.PointCloud):
                self._data.add(data.session_uid)
            elif not isinstance(data, bpy.types.Scene | bpy.types.Action | bpy.types.Collection):
                self.others = True
                self.trees |= isinstance(data, bpy.types.NodeTree)

    def shape(self, item: bpy.types.Object) -> bool:
        """Return True if modifiers of an evaluated object ran, or its own settings changed."""
        return item.original.session_uid in self._shapes

    def any_data(self, item: bpy.types.Object) -> bool:
        """Return True if anything of an evaluated object's points may have changed, not only what its modifiers write."""
        return self.trees or item.original.data.session_uid in self._data


def world_color(world: bpy.types.World | None) -> np.ndarray:
    """Return (3,) sRGB of a world of one colour: its Background node, else its viewport colour; black without a world."""
    if world is None:
        return np.zeros(3)
    color, strength = world.color, 1.0
    if bpy.app.version >= (5, 0, 0) or world.use_nodes:
        output = world.node_tree.get_output_node("ALL")
        links = output.inputs["Surface"].links if output else ()
        node = links[0].from_node if links else None
        if node is not None and node.type == "BACKGROUND" and not node.inputs["Color"].is_linked:
            color, strength = node.inputs["Color"].default_value[:3], node.inputs["Strength"].default_value
    return srgb_from_linear(np.array(color) * strength)


def _cloud(data: bpy.types.PointCloud, to_world: np.ndarray, index: int) -> Cloud | None:
    """Return the Gaussians of a point cloud; None where it holds none."""
    means, quats, look = read_attribute(data, "position"), read_attribute(data, "rotation"), read_look(data)
    if means is None or quats is None or look is None or not len(means):
        return None
    higher = []
    while (coefficients := read_attribute(data, f"radiance:sh_{len(higher)}")) is not None:
        higher.append(coefficients)
    whole = (int((1 + len(higher)) ** 0.5)) ** 2  # an artist may have removed some
    hidden = read_attribute(data, HIDDEN)
    layers = {name: read_attribute(data, attribute) for name, attribute in LAYERS.items()}
    sh = np.stack([look.dc, *higher[: whole - 1]], 1)
    return Cloud(
        means=means,
        quats=quats,
        scales=look.scales,
        opacities=look.opacities * (1 if hidden is None else ~hidden.astype(bool)),
        sh=sh,
        higher=sh,
        turn=read_attribute(data, "turn"),
        to_world=to_world,
        index=index,
        fitted_focal=data.get(FITTED_FOCAL),
        layers={name: values.reshape(len(means), -1) for name, values in layers.items() if values is not None},
    )


def _reread(data: bpy.types.PointCloud, old: Cloud, written: frozenset[str]) -> Cloud | None:
    """Return the cloud with what its modifiers write read anew; None where it holds no Gaussians any more."""
    new = {part: read_attribute(data, name) for name, part in _POSED.items() if name in written}
    if len(data.points) != len(old.means) or any(values is None for values in new.values()):
        return _cloud(data, old.to_world, old.index)
    if not written.isdisjoint(_LOOKS):
        look, hidden = read_look(data), read_attribute(data, HIDDEN)
        if look is None:
            return None
        new["scales"], new["opacities"] = look.scales, look.opacities * (1 if hidden is None else ~hidden.astype(bool))
        if not np.array_equal(look.dc, old.sh[:, 0]):
            new["sh"] = np.concatenate([look.dc[:, None], old.sh[:, 1:]], 1)
    kept = {part for part, values in new.items() if part in _KEPT and np.array_equal(values, getattr(old, part))}
    return replace(old, **{part: values for part, values in new.items() if part not in kept})


def _removes_tints(node: bpy.types.Node) -> bool:
    """Return True for a node that only removes attributes which the engine does not read."""
    return node.bl_idname == "GeometryNodeRemoveAttribute" and node.inputs["Name"].default_value.startswith(TINT)


def _attributes_of(tree: bpy.types.NodeTree | None) -> frozenset[str] | None:
    """Return the attributes of the points that a tree writes; None where it holds a node of which this is not known."""
    if tree is None:
        return None
    written: set[str] = set()
    for node in tree.nodes:
        makes = any(socket.type == "GEOMETRY" and socket.is_linked for socket in node.outputs)
        if node.bl_idname == "GeometryNodeStoreNamedAttribute" and not node.inputs["Name"].is_linked:
            written.add(node.inputs["Name"].default_value)
        elif node.bl_idname == "GeometryNodeSetPosition":
            written.add("position")
        elif makes and node.bl_idname not in _READERS and not _removes_tints(node):
            return None
    return frozenset(written) if written <= _POSED.keys() | _LOOKS | _UNSEEN else None
