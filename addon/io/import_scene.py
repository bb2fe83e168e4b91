"""A scene file becomes Blender objects: two point clouds, empties for the scaffold, a keyed camera. Splat files, too.

    NAME                root empty; carries the turn from the scene's axes (OpenCV, y down) to Blender's (z up)
    ├── NAME static     point cloud
    ├── NAME dynamic    point cloud + geometry nodes (`geometry_nodes`)
    ├── NAME edited     point cloud of what edits move, retime or copy; empty at first (`edits.display`)
    ├── NAME pairs      hidden helper mesh of the geometry nodes
    ├── NAME camera     keyed at every clip frame; the clip is its background where it is found
    ├── NAME graph      hidden lines between the nodes (`scaffold`)
    └── NAME node 0000  the scaffold's nodes, in their own collection, keyed at every clip frame

Below the root all data stay in the scene file's own frame and unit, bit for bit: edits can be written back, and
harmonics stay right because Blender evaluates native splats in the frame of their object, which the root turns as a
whole. Which clip frame is shown at which frame of the timeline is `clip_time`'s.

Attributes of the points (the names that Blender 5.3 draws as splats): `position`, `scale` (linear), `rotation` (wxyz),
`radiance:base` (DC coefficients, opacity), `radiance:sh_0 ..` (higher coefficients, turned from the Gaussian's own
frame into the object's); ours: `gid` (identity), `rgb` (linear display colour), `radius`, and on the dynamic cloud
`reference`, `pair_k`, `w_k`, `strength`; `span_0 .. span_3` where Gaussians come and go (`build_presence_tree`); where the
scene has features `f4x_latent`, their three principal components from 0 to 1; where its colors change in time those of `tints`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...f4x_core.edit.apply import EditedScene, edited
from ...f4x_core.errors import F4xError
from ...f4x_core.geometry import pose, quaternion
from ...f4x_core.geometry.camera import CameraPath
from ...f4x_core.scaffold.deformation import Pairs, pairs_of
from ...f4x_core.scene import DynamicSet, Scene, StaticSet
from ...f4x_core.scene.foreign import SplatSequence, notes_of, open_any
from ...f4x_core.scene.recognise import identify
from ...f4x_core.scene.view import NEAR
from ..common.animation import write_action
from ..common.axes import BLENDER_FROM_SCENE, FLIP_YZ, lens_from_intrinsics
from ..common.gaussian_attributes import FITTED_FOCAL, RECOLORED, draws_splats, write_appearance, write_places
from ..common.geometry_nodes import MOTION, PRESENCE, build_motion_tree, build_presence_tree
from ..common.point_cloud import new_point_cloud, write_attribute
from ..edits import display, drawing, listing
from ..rig.motion_edits import mark_keyed
from ..rig.repair import add_identity, add_pairs
from ..rig.scaffold import add_graph, add_nodes, hide_nodes
from ..scene import cache, clip_time
from ..scene.scene_object import PATH, SELECTED, SceneObject
from ..scene.tints import add_tints, tints_of, write_tints
from .clip_background import find_clip, frames_of, has_bars, show_clip
from .render_setup import SOURCE, ClipSettings, set_up
from .sequence import add_sequence, check_size

GENERIC = {"scene", "clip", "frames", "images", "input", "video", "rgb", "color"}
"""Names of files and of folders of frames that say nothing of what is in them."""
MAX_NAME = 40  # Blender cuts names at 63 bytes; ours get a suffix
MAX_GID = 2**31 - 1  # Blender attributes have 32-bit integers
MIN_REACH = 100.0  # Blender's own clip end, world units
SMALL = 0.1  # drawn size of the camera, world units: the scene is about one away from it
TINY = 0.1 * NEAR  # drawn size of the root, which is where the clip's first camera is: its axes would cross the picture
NEVER = 1e9  # frames; stands for infinity, which geometry nodes cannot reckon with
NOTES = "f4x_notes"
"""Property of that root: what a person must know of how the file was read."""


@contextmanager
def _in_window() -> Iterator[None]:
    """Give the context a window: a script that has just opened a file has none, and Blender then converts no points."""
    windows = bpy.context.window_manager.windows
    if bpy.context.window is not None or not windows:
        yield
        return
    with bpy.context.temp_override(window=windows[0]):
        yield


@_in_window()
def import_scene(
    path: Path, *, set_up_render: bool = True, clip: Path | None = None, sequence: bool = True, step: int = 1
) -> bpy.types.Object:
    """Read a scene or splat file into the current Blender scene and return the root empty.

    What `f4x_core.scene.foreign.open_any` opens, told by content: a `.f4x` scene with its edits, a file of splats, a
    numbered PLY sequence (unless not `sequence`: that file alone), of which every `step`th is taken.

    All but a sequence is then a `SceneObject`, which edits and exports. `set_up_render` also takes over the clip's camera and
    settings (`render_setup.set_up`). `clip` is shown behind the scene; without it the clip that the scene was made of, if
    it is still there with as many pictures.
    Raises F4xError for a missing, damaged or unsuitable file; nothing is added to Blender then.
    """
    source = _Source.read(Path(path), sequence, step)
    opened, name = source.opened, source.free_name()
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    try:
        root = _add_root(name, source, collection)
        clouds = _add_clouds(source, root, collection)
        camera = _add_clip_camera(source, root, collection)
        if set_up_render:
            set_up(bpy.context.scene, camera)
        _set_up_time(source, root, clouds)
        if clip is not None:
            times, barred = opened.cameras.times, isinstance(opened, Scene) and has_bars(opened)
            show_clip(camera, Path(clip), times, barred=barred)
        if source.kind != "sequence":
            _make_editable(root, clouds, source.first)
    except F4xError:
        _take_out(collection)
        raise
    if clip is None and source.kind == "scene":
        _show_own_clip(source.first, source.path, camera)
    return root


@dataclass(frozen=True, eq=False)
class _Source:
    """The content of a file that is imported."""

    path: Path
    kind: str
    """As `identify` has it."""
    opened: Scene | SplatSequence
    first: Scene
    """The scene as its enabled edits leave it, or the first file of a sequence."""
    step: int
    """Of the files of a sequence every so many-th is taken."""

    @classmethod
    def read(cls, path: Path, sequence: bool, step: int) -> _Source:
        """Open the file. Raises F4xError where Blender cannot hold it, or it has nothing to show."""
        kind = identify(path, sequence)
        opened = open_any(path) if kind == "sequence" else cache.opened(path)
        if isinstance(opened, SplatSequence):
            check_size(opened, step)
            return cls(path, kind, opened, opened[0], step)
        first = edited(opened)
        _check(first, path)
        return cls(path, kind, opened, first, step)

    def free_name(self) -> str:
        """Return a name for the objects that no object has yet."""
        called = _called(self.path, self.opened.name) if self.kind == "scene" else self.opened.name or self.path.stem
        return _free_name(called)


def _add_root(name: str, source: _Source, collection: bpy.types.Collection) -> bpy.types.Object:
    """Add the empty below which all of a scene lies; it knows the file, and what was guessed of it."""
    root = _add_object(name, None, collection)
    root.matrix_world = Matrix(BLENDER_FROM_SCENE)
    root.empty_display_size = TINY
    root[SOURCE if source.kind == "sequence" else PATH] = str(source.path)
    if source.kind != "scene" and (notes := notes_of(source.opened)):
        root[NOTES] = "; ".join(notes)
    return root


def _add_clip_camera(source: _Source, root: bpy.types.Object, collection: bpy.types.Collection) -> bpy.types.Object:
    """Add the clip's camera below `root`; it remembers the clip's settings."""
    camera = add_camera(f"{root.name} camera", source.opened.cameras, source.first, collection)
    camera.parent = root
    follow_scale(camera, root)
    ClipSettings.of(source.opened, foreign=source.kind != "scene").remember(camera)
    return camera


def _set_up_time(source: _Source, root: bpy.types.Object, clouds: Sequence[bpy.types.Object]) -> None:
    """Let the scene play at the clip's pace, with its colors over time."""
    times = source.opened.cameras.times
    still = len(times) < 2  # it has no pace
    rate = 1.0 if still else clip_time.rate_between(source.opened.fps, bpy.context.scene)
    clip_time.set_up(root, times[0], times[-1], rate)
    for cloud in clouds if source.first.tints is not None else ():
        if len(cloud.data.points):
            add_tints(root, cloud, source.first.tints.times)


def _make_editable(root: bpy.types.Object, clouds: Sequence[bpy.types.Object], scene: Scene) -> None:
    """Let panels and edits work on an imported `scene`, as its enabled edits leave it."""
    scene_object = SceneObject(root)
    scene_object.attach()
    for cloud in clouds:  # Blender 5 takes new points for selected
        write_attribute(cloud.data, SELECTED, "BOOLEAN", np.zeros(len(cloud.data.points), bool))
    display.make_ready(scene_object)
    mark_keyed(scene_object)
    hide_nodes(root)
    if scene.edits:
        display.refresh(scene_object)
    else:
        drawing.show_linear(scene_object)
        listing.update_panel(scene_object)


def _add_clouds(source: _Source, root: bpy.types.Object, collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """Add the point clouds below `root`: one for each file of a sequence, else those of the scene."""
    material = None if draws_splats() else _splat_material(root.name)
    opened = source.opened
    if isinstance(opened, SplatSequence):
        clouds = add_sequence(
            opened,
            source.step,
            root.name,
            lambda title, scene: _add_gaussians(title, scene.static, Extras(), collection, material),
        )
    else:
        clouds = _add_scene_clouds(source.first, root, collection, material)
    for cloud in clouds:
        cloud.parent = root
    return clouds


def _add_scene_clouds(scene: Scene, root, collection, material) -> list[bpy.types.Object]:
    """Add the point clouds of a scene, and the rig that moves the dynamic one."""
    name, (static, dynamic) = root.name, extras_of(scene)
    clouds = [_add_gaussians(f"{name} static", scene.static, static, collection, material)]
    if len(scene.dynamic):
        clouds.append(_add_gaussians(f"{name} dynamic", scene.dynamic, dynamic, collection, material))
        _add_motion(name, scene, clouds[-1], collection, root)
    focal = scene.fitted_focal(float(scene.cameras.times[0]))
    for cloud in clouds if focal is not None else ():
        cloud.data[FITTED_FOCAL] = focal
    return clouds


def _show_own_clip(scene: Scene, path: Path, camera: bpy.types.Object) -> None:
    """Show the clip behind the scene if it is known which image belongs to which frame."""
    clip = find_clip(scene, path)
    if clip is not None and scene.cameras.steady:  # Blender plays every film at one rate
        try:
            show_clip(camera, clip, scene.cameras.times, exact=True, picked=frames_of(scene), barred=has_bars(scene))
        except F4xError:
            return  # a help that nobody asked for may be missing


def _take_out(collection: bpy.types.Collection) -> None:
    """Remove a collection that was begun, its children and their objects."""
    for child in collection.children:
        _take_out(child)
    for item in list(collection.objects):
        bpy.data.objects.remove(item)
    bpy.data.collections.remove(collection)


def _check(scene: Scene, path: Path) -> None:
    """Refuse what Blender cannot hold, and what has nothing to show."""
    if not len(scene.ids):
        raise F4xError(f"{path} holds no Gaussians; choose another file.")
    largest = max((int(s.ids.max()) for s in (scene.static, scene.dynamic) if len(s)), default=0)
    if largest > MAX_GID:
        raise F4xError(
            f"{path} has Gaussian id {largest}, above Blender's 32-bit integers; renumber it with `f4x bake`."
        )


def _called(path: Path, clip: str) -> str:
    """Return the file's name, else that of the clip that it was made of, else its folder's, whichever tells something."""
    folder = path.resolve().parent.name
    return next((name for name in (path.stem, clip, folder) if name and name.lower() not in GENERIC), path.stem)


def _free_name(wanted: str) -> str:
    """Return a short prefix that no object starts with yet, so the nodes' names sort in their own order."""
    wanted = wanted.encode()[:MAX_NAME].decode(errors="ignore")
    name, number = wanted, 2
    while any(o.name.startswith(name) for o in bpy.data.objects):
        name, number = f"{wanted} ({number})", number + 1
    return name


def _add_object(name: str, data: bpy.types.ID | None, collection: bpy.types.Collection) -> bpy.types.Object:
    item = bpy.data.objects.new(name, data)
    collection.objects.link(item)
    return item


@dataclass(frozen=True, eq=False)
class Extras:
    """Optional values of Gaussians, one row each."""

    latent: np.ndarray | None = None
    """(n,3) principal components of their features, mostly within 0 to 1."""
    tints: np.ndarray | None = None
    """(n,K,3) int8 `tints_of`."""


def extras_of(scene: Scene) -> tuple[Extras, Extras]:
    """Return the optional values of the static and of the dynamic Gaussians of a scene."""
    count, total, latent = len(scene.static), len(scene.static) + len(scene.dynamic), None
    if scene.features is not None and scene.features.pca is not None:
        latent = scene.features.pca.to_unit_range(scene.latents()[:total])  # copies of edits come after them
    parts = latent, tints_of(scene)
    static, dynamic = (
        [None if part is None else part[rows] for part in parts] for rows in (slice(count), slice(count, total))
    )
    return Extras(*static), Extras(*dynamic)


def _add_gaussians(name, gaussians, extras: Extras, collection, material) -> bpy.types.Object:
    """Add one set of Gaussians as a point cloud."""
    item = new_point_cloud(name, len(gaussians), collection)
    cloud = item.data
    if len(gaussians) == 0:
        return item
    write_gaussians(cloud, gaussians, extras)
    if gaussians.span is not None:
        item.modifiers.new(PRESENCE, "NODES").node_group = build_presence_tree(f"{name} presence")
    if material is not None:
        cloud.materials.append(material)
    return item


def write_gaussians(cloud: bpy.types.PointCloud, gaussians: StaticSet, extras: Extras) -> None:
    """Write the attributes of one set of Gaussians."""
    quats = quaternion.normalize(gaussians.quats)
    write_places(cloud, gaussians.means, quats, gaussians.scales)
    write_appearance(cloud, quats, gaussians.sh, gaussians.opacities)
    write_attribute(cloud, RECOLORED, "BOOLEAN", np.zeros(len(gaussians), bool))
    write_attribute(cloud, "gid", "INT", gaussians.ids)
    if extras.latent is not None:
        write_attribute(cloud, "f4x_latent", "FLOAT_VECTOR", extras.latent)
    if extras.tints is not None:
        write_tints(cloud, extras.tints)
    if gaussians.span is not None:
        for i, times in enumerate(np.clip(gaussians.span, -NEVER, NEVER).T):
            write_attribute(cloud, f"span_{i}", "FLOAT", times)


def write_bindings(cloud: bpy.types.PointCloud, gaussians: DynamicSet) -> Pairs:
    """Write which nodes move each dynamic Gaussian, for geometry nodes; returns the pairs that the attributes index."""
    pairs = pairs_of(gaussians.node, gaussians.reference)
    write_attribute(cloud, "reference", "INT", gaussians.reference)
    write_attribute(cloud, "strength", "FLOAT", gaussians.strength)
    for k in range(gaussians.node.shape[1]):
        write_attribute(cloud, f"pair_{k}", "INT", pairs.index[:, k])
        write_attribute(cloud, f"w_{k}", "FLOAT", gaussians.weight[:, k])
    return pairs


def _add_motion(name, scene: Scene, dynamic, collection, root) -> None:
    """Add nodes, helper and geometry nodes that move the dynamic Gaussians."""
    scaffold, gaussians = scene.scaffold, scene.dynamic
    assert scaffold is not None  # a Scene with dynamic Gaussians always has one
    pairs = write_bindings(dynamic.data, gaussians)
    rest = scaffold.quat[pairs.reference, pairs.node], scaffold.xyz[pairs.reference, pairs.node]
    helper = add_pairs(f"{name} pairs", root, (pairs.node, scaffold.ids[pairs.node]), pairs.reference, rest)
    curves = scene.curves if isinstance(scene, EditedScene) else scaffold
    assert curves is not None
    nodes = add_nodes(name, curves, scene.cameras.times, collection, root)
    graph = add_graph(name, curves, nodes, collection, root)
    add_identity(graph.data, curves.ids)
    modifier = dynamic.modifiers.new(MOTION, "NODES")
    slots, fades = gaussians.node.shape[1], bool((gaussians.strength < 1).any())
    modifier.node_group = build_motion_tree(f"{name} motion", nodes, helper, slots, fades)


def add_camera(name: str, cameras: CameraPath, scene: Scene, collection: bpy.types.Collection) -> bpy.types.Object:
    """Add a camera keyed along a path, which sees as far as `scene` goes; its lens is keyed only when it changes."""
    camera = _add_object(name, bpy.data.cameras.new(name), collection)
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.display_size = SMALL
    camera.data.passepartout_alpha = 1.0  # outside the clip's picture nothing was filmed, and Gaussians fray
    camera.data.clip_start, camera.data.clip_end = NEAR, _reach(scene)
    camera.rotation_mode = "QUATERNION"
    q, centre = pose.from_matrix(np.linalg.inv(cameras.world_to_camera) @ FLIP_YZ)
    write_action(camera, cameras.times, {"location": centre, "rotation_quaternion": quaternion.align_sequence(q)})
    lens = lens_from_intrinsics(cameras.intrinsics, cameras.width, cameras.height, camera.data.sensor_width)
    for path, values in lens.items():
        setattr(camera.data, path, values[0])
    if any(np.ptp(values) > 0 for values in lens.values()):
        write_action(camera.data, cameras.times, lens)
    return camera


def follow_scale(camera: bpy.types.Object, root: bpy.types.Object) -> None:
    """Let the clip distances of a `camera` below `root` follow its scale, or a scene that was enlarged is cut off."""
    for name in ("clip_start", "clip_end"):
        distance = getattr(camera.data, name)
        driver = camera.data.driver_add(name).driver
        scale = driver.variables.new()
        scale.name, scale.type = "scale", "TRANSFORMS"
        target = scale.targets[0]
        target.id, target.transform_type, target.transform_space = root, "SCALE_AVG", "WORLD_SPACE"
        driver.expression = f"{distance!r} * scale"


def _reach(scene: Scene) -> float:
    """Return a distance beyond every Gaussian from every camera, world units."""
    points = np.concatenate([scene.static.means, scene.dynamic.means])
    spread = np.ptp(np.concatenate([points, scene.cameras.centers]), axis=0)
    return max(MIN_REACH, 2 * float(np.linalg.norm(spread)))


def _splat_material(name: str) -> bpy.types.Material:
    """Return the emission of `rgb`, as transparent as its alpha: a coarse picture in Cycles and EEVEE, exact in neither.

    Blender 5.3 colors splats by their harmonics where they have no material, and would count the alpha twice with this one.
    """
    material = bpy.data.materials.new(f"{name} color")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    color = tree.nodes.new("ShaderNodeAttribute")
    color.attribute_name = "rgb"  # never `color`: Cycles shows an attribute of that name as black on points
    emission = tree.nodes.new("ShaderNodeEmission")
    clear = tree.nodes.new("ShaderNodeBsdfTransparent")
    mix = tree.nodes.new("ShaderNodeMixShader")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    for source, sink in (
        (color.outputs["Color"], emission.inputs["Color"]),
        (color.outputs["Alpha"], mix.inputs[0]),
        (clear.outputs[0], mix.inputs[1]),
        (emission.outputs[0], mix.inputs[2]),
        (mix.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(source, sink)
    for i, node in enumerate(tree.nodes):
        node.location = (200 * i, 0)
    return material
