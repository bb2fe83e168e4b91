"""Checks after every step of the random walk of `walk_blender.py`; `WrongError` names in a sentence what is wrong."""

from __future__ import annotations

import hashlib
import json
from functools import partial
from types import SimpleNamespace
from typing import Any

import bpy
import door
import numpy as np

door.load_extension()

from feature4x.addon import registration  # noqa: E402 - there once the extension is loaded
from feature4x.addon.common.geometry_nodes import MOTION  # noqa: E402
from feature4x.addon.common.lines import CATEGORY  # noqa: E402
from feature4x.addon.common.point_cloud import read_attribute  # noqa: E402
from feature4x.addon.edits import listing  # noqa: E402 - there once the extension is loaded
from feature4x.addon.operators.point_edits import changes_of  # noqa: E402
from feature4x.addon.rig.motion_edits import unwritten  # noqa: E402
from feature4x.addon.rig.repair import used_by  # noqa: E402
from feature4x.addon.rig.scaffold import NODES  # noqa: E402
from feature4x.addon.scene import cache  # noqa: E402 - there once the extension is loaded
from feature4x.addon.scene.clip_time import time_of  # noqa: E402
from feature4x.addon.scene.scene_object import APART, EDITS, HIDDEN, SELECTED, SceneObject  # noqa: E402
from feature4x.f4x_core.edit.stack import read_stack  # noqa: E402
from feature4x.f4x_core.errors import F4xError  # noqa: E402
from feature4x.f4x_core.scaffold.deformation import SIGN_BAND, motions_to, node_poses_at, pairs_of  # noqa: E402
from feature4x.f4x_core.scene import Scene  # noqa: E402

NEAR = 2e-4
"""World units between a point and where the core puts it; geometry nodes reckon in float32."""
SAME = 1e-5
"""Difference of opacities, and of places of objects, that is rounding."""


BAND = 1.01 * SIGN_BAND
"""Half width of the band of `undecided`, with what rounding to float32 adds."""


class WrongError(Exception):
    """Raised with one sentence about a state that is wrong."""


def require(good: bool, otherwise: str) -> None:
    """Raise `WrongError` unless `good`."""
    if not good:
        raise WrongError(otherwise)


def own_scenes() -> list[SceneObject]:
    """Return the file's own scenes; those in no Blender scene are left out, for Blender does not save them."""
    shown = {item.name for scene in bpy.data.scenes for item in scene.objects}
    return [each for each in SceneObject.among(bpy.data.objects) if not each.is_linked and each.name in shown]


def content() -> dict[str, dict[str, str | None]]:
    """Return the parts of the file's scenes that a person would miss: edits, points, selected and hidden Gaussians.

    None where it is not known, without the scene file.
    """
    found = {}
    for scene_object in own_scenes():
        points = {
            f"{cloud.name} {name}": _hash_of(scene_object, cloud, name)
            for cloud in scene_object.clouds
            for name in (SELECTED, HIDDEN, "gid")
        }
        found[scene_object.name] = {"edits": scene_object.root.get(EDITS, "")} | points
    return found


def _hash_of(scene_object: SceneObject, cloud: bpy.types.Object, name: str) -> str | None:
    """Return the hash of an attribute; in the separate cloud only points that pending edits need count, not a preview's."""
    values = read_attribute(cloud.data, name)
    if APART not in cloud or values is None:
        return _hash(values)
    try:
        pending = scene_object.pending
    except F4xError:
        return None
    return _hash(values[np.isin(read_attribute(cloud.data, "gid"), pending.scene.ids[pending.apart])])


def same(before: dict, after: dict, what: str) -> None:
    """Raise `WrongError` where what scenes hold differs."""
    for name in before.keys() | after.keys():
        here, there = before.get(name, {}), after.get(name, {})
        known = [key for key in here.keys() | there.keys() if None not in (here.get(key, ""), there.get(key, ""))]
        keys = sorted(key for key in known if here.get(key) != there.get(key))
        require(not keys, f"{what}: {name} had and has {[(key, here.get(key), there.get(key)) for key in keys]}")


def check_words(scene_object: SceneObject) -> None:
    """Check the sidebar's lists and counts, and its line about the file."""
    state, stack, name = scene_object.state, scene_object.stack, scene_object.name
    shown = [(row.name, row.edit_id, row.enabled) for row in state.history]
    held = [(listing.words_of(edit.operation, scene_object.axes), edit.id, edit.enabled) for edit in stack.edits]
    require(shown == held, f"{name}: the history shows {shown} and the scene holds {held}")
    words = scene_object.saving
    try:
        in_file = read_stack(scene_object.path)
        names = {each: len(rows) for each, rows in scene_object.names.items()}
    except F4xError:
        return
    saved = in_file.edits == stack.edits
    require((words == "Edits Saved") == saved, f"{name}: the button says {words!r}, but saved is {saved}")
    listed = {row.name: row.count for row in state.names}
    require(listed == names, f"{name}: the list of names has {listed}, the scene {names}")


def check_points(scene_object: SceneObject) -> None:
    """Check that points show what the core computes for this frame: which are there, their opacity and their places."""
    try:
        shown = scene_object.shown
    except F4xError:
        return
    if changes_of(scene_object).summary:  # an artist deleted or moved points
        return
    parts, frame = list(scene_object.points()), scene_object.frame
    covered = np.concatenate([np.zeros(0, int), *(row for _, _, row in parts)])
    if len(np.unique(covered)) < len(shown.scene.ids) - (~shown.there).sum():  # an artist took points away
        return
    opacities, posed = shown.appearance(frame).opacities, shown.scene.posed(frame)
    at_frame = time_of(scene_object.root) in shown.scene.cameras.times  # elsewhere the nodes are not compared
    # the points of a copy without nodes of its own follow the original's
    own = NODES in scene_object.root or not len(shown.scene.dynamic)
    still = at_frame and own and unwritten(scene_object) == 0 and not scene_object.state.notice
    for cloud, at, row in parts:
        if APART in cloud:
            inside = np.isin(row, shown.apart)
            at, row = at[inside], row[inside]
            want = shown.moment(frame).opacities[np.searchsorted(shown.apart, row)] if len(row) else row
        elif len(at) == len(cloud.data.points):
            want = opacities[row]
        else:  # joined with something else
            continue
        error = float(np.abs(read_attribute(cloud.data, "radiance:base")[at, 3] - want).max(initial=0))
        require(error < SAME, f"{cloud.name}: opacity differs by {error:.3g} at frame {frame:g}")
        # an artist has hung a cloud below another scene, whose nodes are not those that carry it
        by_others = MOTION in cloud.modifiers and scene_object.root.get(NODES) not in used_by(cloud)
        moved = np.abs(np.array(cloud.matrix_world) - np.array(scene_object.root.matrix_world)).max()
        if still and moved < SAME and not by_others:  # else an artist has put the points elsewhere
            compared = np.ones(len(row), bool) if APART in cloud else ~undecided(shown.scene, frame)[row]
            _check_places(cloud, at, posed.means[row], compared)


def undecided(scene: Scene, frame: float) -> np.ndarray:
    """Return (N,) bool in the order of `posed`: Gaussians with a node that has turned half a turn against the attach node.

    Which way round they go depends on the signs of the nodes' quaternions: the core continues them in time, and the
    matrices of Blender's objects have none.
    """
    gaussians, rest = scene.base.dynamic, scene.base.scaffold
    without_sign = np.zeros(len(scene.base.ids), bool)
    if rest is not None and len(gaussians):
        curves, pairs = getattr(scene, "curves", rest), pairs_of(gaussians.node, gaussians.reference)
        now = node_poses_at(curves.times, curves.xyz, curves.quat, frame)
        real = motions_to(now, rest.xyz, rest.quat, pairs)[pairs.index, :4]
        near = np.abs((real * real[:, :1]).sum(-1)) < BAND
        without_sign[len(scene.base.static) :] = (near & (gaussians.weight > 0)).any(1)
    return without_sign[scene.origin]


def _check_places(cloud: bpy.types.Object, at: np.ndarray, means: np.ndarray, compared: np.ndarray) -> None:
    """`means (n,3)`: where the core puts the points `at (n,)` of `cloud` now; it shows no others. `compared (n,)`: which count."""
    ours = all(modifier.name.startswith("Feature4X") for modifier in cloud.modifiers)
    carried = APART in cloud or MOTION not in cloud.modifiers or cloud.modifiers[MOTION].show_viewport
    if not (ours and carried and cloud.visible_get()) or (
        "strength" in cloud.data.attributes and MOTION not in cloud.modifiers
    ):
        return
    data = cloud.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    places, gid = read_attribute(data, "position"), read_attribute(data, "gid")
    if not len(places):
        return
    place_of = {id: place for place, id in enumerate(read_attribute(cloud.data, "gid")[at].tolist())}
    more = sorted(set(gid.tolist()) - place_of.keys())
    require(not more, f"{cloud.name}: shows {len(more)} points that the scene does not have")
    place = np.array([place_of[id] for id in gid.tolist()])
    error = float(np.abs(places - means[place])[compared[place]].max(initial=0))
    require(error < NEAR, f"{cloud.name}: points stand {error:.3g} away from where the core puts them")


def pending() -> dict[int, list]:
    """Return the edits of each scene, by the session_uid of its root."""
    return {each.root.session_uid: json.loads(each.root.get(EDITS, cache.NO_EDITS)) for each in own_scenes()}


class _Layout:
    """Stand-in for `UILayout` where there is no window; names that panels give it have to exist."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: self

    def panel(self, *_: Any, **__: Any) -> tuple[_Layout, _Layout]:
        """Return a header and a body."""
        return self, self

    def prop(self, data: Any, name: str, **_: Any) -> None:
        """Require that a property exists."""
        getattr(data, name)

    def operator(self, name: str, **_: Any) -> _Layout:
        """Require that an operator exists."""
        room, name = name.split(".")
        getattr(getattr(bpy.ops, room), name).get_rna_type()
        return self


class _Drawn:
    """Stand-in for a panel without a window."""

    def __init__(self, panel: type):
        self._panel, self.layout = panel, _Layout()

    def __getattr__(self, name: str) -> Any:
        return partial(getattr(self._panel, name), self)


def draw_panels() -> None:
    """Let every panel of the sidebar draw where no window does."""
    for panel in registration.CLASSES:
        if getattr(panel, "bl_category", "") == CATEGORY and (not hasattr(panel, "poll") or panel.poll(bpy.context)):
            panel.draw(_Drawn(panel), _Context())


class _Context:
    """Stand-in for Blender's context, with a region and a size of letters."""

    region = SimpleNamespace(width=300)
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)


def _hash(values: np.ndarray | None) -> str:
    """Return a hash of values; an empty string for none, as for values of which none is true."""
    return "" if values is None or not values.any() else hashlib.sha256(values.tobytes()).hexdigest()[:12]
