"""Folds an edit stack into base arrays and scaffold, so that programs that know nothing of edits see the edited scene.

What is folded is the longest run of edits from the first on that a scene without edits can hold: colours that last, and
places. Every group of Gaussians with the same history moves by one similarity G(t) of what the base does at some moment
w(t). Where that is constant the arrays take it. Else nodes are cloned, Q'_k(t) = G(t) Q_k(w(t)) at clip frames, and a
Gaussian that stood still gets a node of its group. Poses given by `rekey` are folded before all that (`keys`). The
scaffold is given every clip frame as a time then, so that the baked scene is the edited one at all of them; between them
its curves run through the same places.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from ..geometry import quaternion
from ..scaffold import Scaffold
from ..scaffold.control import prune_nodes, resample_in_time
from ..scaffold.deformation import node_poses_at
from ..scene import DynamicSet, Scene, StaticSet
from ..scene.linear import fitted_look, is_refitted, linear_scene, with_look
from ..scene.model import SCAFFOLD_ARRAYS, empty_arrays
from ..scene.tints import PARTS, Tints, quantized
from .apply import EditedScene, base_of, edited, next_id
from .keys import with_keys_folded
from .operations import Delete, Name
from .records import mapped
from .selects import Ids, Moving
from .splat_rows import SplatRows, steps_of
from .stack import Edit, EditStack, of, with_stack
from .state import NO_MOTION, Motion

TOLERANCE = 0.02
"""Maximum error of a folded Gaussian in pixels at any clip frame; edits with a larger error stay in the stack."""
ANCHORS = 32
"""Maximum number of nodes for a group of static Gaussians: one for each kind of features in it, as features live on nodes."""
LONE_UNIT = 0.1
"""World units between nodes of a scene that had none; new nodes are bare and need no neighbours."""
NEAR = 0.05
"""Minimum distance in front of the camera, in world units, at which the error in pixels is measured."""


def bake(scene: Scene) -> Scene:
    """Return the scene with its edits folded into its arrays; names, and edits that no arrays can hold, stay in the stack.

    An appearance for linear light (`scene.linear`) is baked alike; where other edits can be folded into it, it is left out.
    """
    baked = _bake(scene)
    if not is_refitted(scene.base):
        return baked
    alike = _bake(with_stack(linear_scene(base_of(scene)), of(scene)))
    same = all(np.array_equal(getattr(baked, part).ids, getattr(alike, part).ids) for part in ("static", "dynamic"))
    return with_look(baked, fitted_look(alike) if same and alike.edits == baked.edits else None)


def unfolded(baked: Scene) -> list[Edit]:
    """Return the edits that `bake` had to leave in the stack; names, which stay by right, are not among them."""
    return [edit for edit in of(baked).edits if not isinstance(edit.operation, Name)]


def _bake(scene: Scene) -> Scene:
    """Return the scene with its edits folded into its arrays; names, and edits that no arrays can hold, stay in the stack.

    Gaussians keep their ids, copies have theirs; deleted ones are dropped, nodes that nobody follows any longer too. Edits that
    are switched off or undone are left behind. Raises F4xError where an edit is wrong.
    """
    scene = with_keys_folded(base_of(scene))
    stack = of(scene)
    active = stack.in_effect
    kept = EditStack(active)
    whole = edited(with_stack(scene, kept))
    for count in _foldable(scene, active):
        part = edited(with_stack(scene, replace(kept, edits=active[:count])))
        if not isinstance(part, EditedScene):
            break
        folded = _folded(part, drop=count == len(active))
        baked = with_stack(folded, _rest(scene, active, count, part.rows, folded))
        if _off(whole, edited(baked)) <= TOLERANCE:
            return baked
    return with_stack(scene, kept)


def _foldable(scene: Scene, active: tuple[Edit, ...]) -> Iterator[int]:
    """Yield how many of the first edits may be folded, the most first; fewer end before an edit that shows another time."""
    whole = edited(with_stack(scene, EditStack(active)))
    steps = whole.steps if isinstance(whole, EditedScene) else ()
    # what comes and goes is there by the clip's clock: edits that show other moments of it cannot be folded
    lasting = next((s.edit.id for s in steps if not s.edit.operation.lasts or (s.reads and scene.fades)), None)
    count = len(active) if lasting is None else [edit.id for edit in active].index(lasting)
    hidden = [edit.operation.hides for edit in active]
    inexact = {step.edit.id for step in steps if step.reads}
    for few in (count, *(index for index in range(count - 1, -1, -1) if active[index].id in inexact), 0):
        brings_back = any(edit.operation.brings_back for edit in active[few:]) and any(hidden[:few])
        yield hidden.index(True) if brings_back else few  # what stays brings back what was hidden, as the base has it


def _rest(scene: Scene, active: tuple[Edit, ...], count: int, rows: SplatRows, folded: Scene) -> EditStack:
    """Return the stack that follows the folded edits: the names, then the other edits."""
    stack = EditStack()
    if count < len(active) and rows.gone.any():
        stack = stack.append(Delete(Ids.of(rows.ids[rows.gone])))
    for name, index in rows.names.items():
        stack = stack.append(Name(Ids.of(np.intersect1d(rows.ids[index], folded.ids)), name))
    taken = len(stack)
    later = [
        replace(edit, operation=_spelt(edit, steps_of(scene, active[:place])[1]))
        for place, edit in enumerate(active[count:], count)
    ]
    return EditStack((*stack.edits, *(replace(edit, id=taken + i) for i, edit in enumerate(later, 1))))


def _spelt(edit: Edit, rows: SplatRows) -> Any:
    """Return the operation with `moving` spelt out as ids: folded edits make Gaussians move that did not."""
    return mapped(edit.operation, lambda value: Ids.of(rows.ids[rows.carried]) if isinstance(value, Moving) else None)


def _off(scene: Scene, baked: Scene) -> float:
    """Return the maximum error, in pixels, of the Gaussians of the baked scene over the clip's frames."""
    place = np.argsort(scene.ids)
    row = place[np.searchsorted(scene.ids[place], baked.ids)]
    worst = 0.0
    for time in scene.cameras.times if scene.moving.any() else scene.cameras.times[:1]:
        camera = scene.cameras.at(time)
        there, here = scene.posed(time).means[row].astype(float), baked.posed(time).means.astype(float)
        depth = camera.project(there)[1]
        pixels = np.linalg.norm(there - here, axis=1) * camera.intrinsics[0, 0] / np.maximum(depth, NEAR)
        worst = max(worst, float(pixels.max(initial=0)))
    return worst


@dataclass(frozen=True, eq=False)
class _Group:
    """Gaussians that the same steps move, and how; F times of the scaffold."""

    rows: np.ndarray
    """(n,) rows of the edited scene; the scaffold carries all or none of them."""
    moments: np.ndarray
    """(F,) clip time w(t) at which the base is read."""
    turns: np.ndarray
    """(F,4) rotation of G(t), wxyz."""
    shifts: np.ndarray
    """(F,3) where G(t) takes the origin."""
    scale: float
    """Of G, at all times."""

    @property
    def lasts(self) -> bool:
        """Return True if G is the same at all times."""
        return bool((self.turns == self.turns[0]).all() and (self.shifts == self.shifts[0]).all())

    def is_nothing(self, times: np.ndarray) -> bool:
        """Return True if these Gaussians are where the base has them."""
        still = not self.turns[:, 1:].any() and not self.shifts.any() and self.scale == 1
        return still and bool((self.moments == times).all())

    def moved(self, points: np.ndarray) -> np.ndarray:
        """Return `points (F,n,3)` moved by G(t), float64."""
        return self.scale * quaternion.rotate(self.turns[:, None], points) + self.shifts[:, None]


def _histories(scene: EditedScene, there: np.ndarray) -> list[np.ndarray]:
    """Return the rows `there (N,) bool` in groups that move alike: the same steps chose them, as copies of the same number."""
    code = SplatRows.of(base_of(scene)).carried.astype(np.int64)
    for depth, step in enumerate(scene.steps, 1):
        part: np.ndarray = step.chosen.astype(np.int64)
        if step.copied is not None:
            _, below, part = step.read(0.0, np.arange(len(scene.after(depth).ids)))
            code = code[below]
        elif step.edit.operation.LOOKS:
            continue
        code = np.unique(code * (part.max() + 1) + part, return_inverse=True)[1]
    index = np.flatnonzero(there)
    return [index[code[index] == value] for value in np.unique(code[index])]


def _group(scene: EditedScene, rows: np.ndarray, times: np.ndarray) -> _Group:
    tracks = [_track(scene, int(rows[0]), float(time)) for time in times]
    motions = [motion for _, motion in tracks]
    return _Group(
        rows,
        np.array([moment for moment, _ in tracks]),
        quaternion.align_sequence(np.stack([motion.rotation for motion in motions])),
        np.stack([motion.shift for motion in motions]),
        motions[0].scale,
    )


def _track(scene: EditedScene, row: int, time: float) -> tuple[float, Motion]:
    """Return (w(time), G(time)) of one row: back through the steps, each at the moment that the one after it shows."""
    whole, last = NO_MOTION, float(scene.cameras.times[-1])
    for below in range(len(scene.steps) - 1, -1, -1):
        step = scene.steps[below]
        operation = step.edit.operation
        if step.reads:
            when, at, copy = step.read(time, np.array([row]))
            time, row = float(when[0]), int(at[0])
            if (shift := operation.copy_motion(copy)) is not None:
                whole = whole.after(NO_MOTION._replace(translate=shift[0]))
        elif step.chosen[row] and (fraction := operation.fraction(time, last)):
            motion = operation.motion(fraction, partial(scene.pivot, below, time=time))
            whole = whole if motion is None else whole.after(motion)
    return time, whole


def _folded(scene: EditedScene, drop: bool) -> Scene:
    """Return the scene with all its edits in its arrays, up to what nodes cannot hold exactly, and an empty stack.

    `drop`: leave out what is deleted. Else it is there with opacity 0, as later edits count on it.
    """
    base, rows = base_of(scene), scene.rows
    times = base.cameras.times.astype(np.float64)
    times = times if base.scaffold is None else np.union1d(base.scaffold.times, times)
    groups = [_group(scene, members, times) for members in _histories(scene, ~(rows.gone & drop))]
    moving = [group for group in groups if not group.lasts or rows.carried[group.rows[0]]]
    if base.scaffold is not None and not all(group.is_nothing(times) for group in moving):
        base = _with_knots(base, base.scaffold, times)
    posed, count = scene.posed(float(times[0])), len(base.static)
    opacities, sh = scene.appearance(float(times[0]))
    static_groups = [group for group in groups if group.lasts and not rows.carried[group.rows[0]]]
    static_rows = np.sort(np.concatenate([np.zeros(0, int), *(group.rows for group in static_groups)]))
    turned = np.isin(static_rows, [row for group in static_groups if group.turns[0, 1:].any() for row in group.rows])
    origin = rows.origin[static_rows]
    static = StaticSet(
        ids=rows.ids[static_rows],
        means=posed.means[static_rows],
        quats=np.where(turned[:, None], posed.quats[static_rows], base.static.quats[origin]),
        scales=posed.scales[static_rows],
        opacities=opacities[static_rows],
        sh=sh[static_rows, : base.static.sh.shape[1]],
        span=_spans(base, origin),
    )
    build = _Nodes(base, times, scene.scaffold)
    for group in moving:
        build.add(group, rows)
    dynamic, scaffold, latents, followers = build.finish(scene)
    field = base.features
    extra = {}
    for name, array in base.extra.items():
        part, _, kind = name.partition("/")
        index = origin if part == "static" else rows.origin[followers] - count
        extra[name] = _taken(array, index) if part in ("static", "dynamic") else array
        before = base.extra.get(f"static/{kind}") if part == "dynamic" else None
        if before is not None:  # what stood still may move now
            extra[name] = np.concatenate([before, array])[rows.origin[followers]]
    if base.tints is not None:
        extra |= _tints(scene, base.tints, static_rows, followers)
    folded_edits = [
        {"op": edit.operation.TAG, "said": edit.sentence} for edit in of(scene).edits if edit.operation.ACTS
    ]
    return replace(
        base,
        static=static,
        dynamic=dynamic,
        scaffold=scaffold,
        features=None if field is None else replace(field, static=field.static[origin], nodes=latents),
        extra=extra,
        edits=(),
        next_id=next_id(base),
        provenance={**base.provenance, "baked": [*base.provenance.get("baked", []), *folded_edits]},
    )


def _tints(scene: EditedScene, tints: Tints, static: np.ndarray, dynamic: np.ndarray) -> dict[str, np.ndarray]:
    """Return the tints of rows `static` and `dynamic` as the edits leave them: members of `Scene.extra`."""
    parts = [np.zeros((len(rows), len(tints.times), 3), np.int8) for rows in (static, dynamic)]
    for k, time in enumerate(tints.times):
        added = scene.tint(float(time))
        for part, rows in zip(parts, (static, dynamic), strict=True):
            part[:, k] = quantized(added[rows])
    return dict(zip(PARTS, parts, strict=True))


def _spans(base: Scene, origin: np.ndarray) -> np.ndarray | None:
    """Return the times (n,4) at which Gaussians from rows `origin (n,)` of `base.posed` are present; None where all always are."""
    if not base.fades:
        return None
    always = (-np.inf, -np.inf, np.inf, np.inf)
    spans = [
        np.full((len(part), 4), always, np.float32) if part.span is None else part.span
        for part in (base.static, base.dynamic)
    ]
    return np.concatenate(spans)[origin]


def _with_knots(base: Scene, scaffold: Scaffold, times: np.ndarray) -> Scene:
    """Return the scene with curves that have knots at all of `times`, so that new nodes are right at every clip frame."""
    reference = np.searchsorted(times, scaffold.times[base.dynamic.reference]).astype(np.int32)
    return replace(base, scaffold=resample_in_time(scaffold, times), dynamic=replace(base.dynamic, reference=reference))


class _Followers(NamedTuple):
    """n Gaussians and the nodes they follow."""

    rows: np.ndarray
    """(n,) rows of the edited scene."""
    reference: np.ndarray
    """(n,) index into the scaffold's times."""
    node: np.ndarray
    """(n,K)"""
    weight: np.ndarray
    """(n,K)"""
    strength: np.ndarray
    """(n,)"""
    kept: bool = False
    """True if the base has them in the same place at the same reference time."""


class _Nodes:
    """The nodes of the folded scene while groups are added, and who follows them."""

    def __init__(self, base: Scene, times: np.ndarray, curves: Scaffold | None):
        """Begin without new nodes; `curves` is the scaffold with its own knots alone, as any other knot would bend it."""
        self.base, self.times = base, times
        self.old = _no_nodes(times) if base.scaffold is None else base.scaffold
        self.curves = curves or self.old
        self.latents = np.zeros((len(self.old), 0), np.uint8) if base.features is None else base.features.nodes
        self.followers: list[_Followers] = []
        self.added: list[_NewNodes] = []

    @property
    def count(self) -> int:
        """Nodes so far."""
        return len(self.old) + sum(len(new.radius) for new in self.added)

    def add(self, group: _Group, rows: SplatRows) -> None:
        """Let the Gaussians of `group` follow nodes that move as they do."""
        origin = rows.origin[group.rows]
        if not rows.carried[group.rows[0]]:
            self._add_static_group(group, origin)
            return
        carried = self.base.dynamic.take(origin - len(self.base.static))
        if group.is_nothing(self.times):
            reference, node, weight, strength = carried.reference, carried.node, carried.weight, carried.strength
            self.followers.append(_Followers(group.rows, reference, node, weight, strength, kept=True))
            return
        cloned, local = np.unique(carried.node, return_inverse=True)
        node, weight, strength = self.count + local.reshape(carried.node.shape), carried.weight, carried.strength
        self._add_clones(group, cloned)
        if not group.lasts and (strength < 1).any():
            # Who follows the nodes in part follows G alone with the rest: an identity that is moved by it.
            node = np.concatenate([node, np.full((len(node), 1), self.count)], 1)
            weight = np.concatenate([weight * strength[:, None], 1 - strength[:, None]], 1)
            strength = np.ones_like(strength)
            self._add_bare(group, np.zeros((1, 3)), self.latents[cloned[:1]])
        gaps = np.abs(group.moments[:, None] - self.times[carried.reference])  # (F, n)
        self.followers.append(_Followers(group.rows, gaps.argmin(0), node, weight, strength))

    def _add_clones(self, group: _Group, cloned: np.ndarray) -> None:
        old, curves = self.old, self.curves
        poses = [node_poses_at(curves.times, curves.xyz, curves.quat, float(moment)) for moment in group.moments]
        quats = quaternion.multiply(group.turns[:, None], np.stack([quat[cloned] for _, quat in poses]))
        place = np.full(len(old), -1)
        place[cloned] = self.count + np.arange(len(cloned))
        neighbours = place[old.neighbours[cloned]]
        own = place[cloned][:, None]
        nearest = np.abs(group.moments[:, None] - self.times).argmin(1)
        self.added.append(
            _NewNodes(
                group.moved(np.stack([xyz[cloned] for xyz, _ in poses])),
                quaternion.align_sequence(quats),
                old.radius[cloned] * group.scale,
                old.certain[nearest][:, cloned],
                np.where(neighbours < 0, own, neighbours),
                old.edge_mask[cloned] & (neighbours >= 0),
                self.latents[cloned],
            )
        )

    def _add_static_group(self, group: _Group, origin: np.ndarray) -> None:
        static, field = self.base.static.take(origin), self.base.features
        kinds = np.zeros(len(origin), int)
        latents = np.zeros((1, self.latents.shape[1]), np.uint8)
        if field is not None:
            kinds, latents = _kinds(field.static[origin])
        slots = self.base.dynamic.node.shape[1]
        weight = np.zeros((len(origin), slots), np.float32)
        weight[:, 0] = 1
        node = np.tile(self.count + kinds[:, None], (1, slots))
        reference, strength = np.zeros(len(origin), int), np.ones(len(origin), np.float32)
        self.followers.append(_Followers(group.rows, reference, node, weight, strength))
        self._add_bare(group, np.tile(np.median(static.means, 0), (len(latents), 1)), latents, static.means.std())

    def _add_bare(self, group: _Group, points: np.ndarray, latents: np.ndarray, radius: float = 0.0) -> None:
        """Add nodes at `points (m,3)` of the base scene that only move by G(t)."""
        times, (count, slots) = len(self.times), (len(points), self.old.neighbours.shape[1])
        own = self.count + np.arange(count)
        self.added.append(
            _NewNodes(
                group.moved(np.tile(points, (times, 1, 1))),
                np.tile(group.turns[:, None], (1, count, 1)),
                np.full(count, max(radius * group.scale, self.old.unit)),
                np.ones((times, count), bool),
                np.tile(own[:, None], (1, slots)),
                np.tile(np.arange(slots) == 0, (count, 1)),
                latents,
            )
        )

    def finish(self, scene: EditedScene) -> tuple[DynamicSet, Scaffold | None, np.ndarray, np.ndarray]:
        """Return (the dynamic Gaussians, the scaffold, its latents (M,D), rows of these Gaussians in the edited scene)."""
        base = self.base
        if not self.followers:
            return DynamicSet.empty(), None, self.latents[:0], np.zeros(0, int)
        scaffold, latents = self._scaffold()
        slots = max(part.node.shape[1] for part in self.followers)
        parts = [part._replace(node=_widened(part.node, slots, "edge"), weight=_widened(part.weight, slots, "constant"))
                 for part in self.followers]  # fmt: skip
        rows, reference, node, weight, strength = (
            np.concatenate([part[i] for part in parts]) for i in range(len(_Followers._fields) - 1)
        )
        used = np.zeros(len(scaffold), bool)
        used[node] = True
        abandoned = np.zeros(len(scaffold), bool)
        abandoned[base.dynamic.node] = True
        scaffold, place = prune_nodes(scaffold, np.where(abandoned & ~used, 0.0, 1.0), np.zeros(0, int))
        means, quats, scales = (np.empty((len(rows), n), np.float32) for n in (3, 4, 3))
        for index in np.unique(reference):
            posed = scene.posed(float(self.times[index]))
            here = reference == index
            for array, value in ((means, posed.means), (quats, posed.quats), (scales, posed.scales)):
                array[here] = value[rows[here]]
        kept = np.concatenate([np.full(len(part.rows), part.kept) for part in parts])
        origin = scene.rows.origin[rows[kept]] - len(base.static)
        means[kept], quats[kept], scales[kept] = (
            base.dynamic.means[origin], base.dynamic.quats[origin], base.dynamic.scales[origin]
        )  # fmt: skip
        opacities, sh = scene.appearance(float(self.times[0]))
        size = base.dynamic.sh.shape[1] if scene.rows.carried[rows].all() else sh.shape[1]
        arrays = {
            "ids": scene.rows.ids[rows],
            "means": means,
            "quats": quats,
            "scales": scales,
            "opacities": opacities[rows],
            "sh": sh[rows, :size],
            "reference": reference.astype(np.int32),
            "node": place[node].astype(np.int32),
            "weight": weight.astype(np.float32),
            "strength": strength.astype(np.float32),
            "span": _spans(base, scene.rows.origin[rows]),
        }
        order = np.argsort(rows)
        return DynamicSet(**arrays).take(order), scaffold, latents[place >= 0], rows[order]

    def _scaffold(self) -> tuple[Scaffold, np.ndarray]:
        """Return (all nodes, old ones first; their latents (M,D))."""
        old, new = self.old, self.added
        first = int(old.ids.max(initial=-1)) + 1
        scaffold = replace(
            old,
            xyz=np.concatenate([old.xyz, *(part.xyz for part in new)], 1, dtype=np.float32),
            quat=np.concatenate([old.quat, *(part.quat for part in new)], 1, dtype=np.float32),
            radius=np.concatenate([old.radius, *(part.radius for part in new)], dtype=np.float32),
            certain=np.concatenate([old.certain, *(part.certain for part in new)], 1),
            ids=np.append(old.ids, first + np.arange(self.count - len(old))),
            neighbours=np.concatenate([old.neighbours, *(part.neighbours for part in new)]),
            edge_mask=np.concatenate([old.edge_mask, *(part.edge_mask for part in new)]),
        )
        return scaffold, np.concatenate([self.latents, *(part.latents for part in new)])


class _NewNodes(NamedTuple):
    """Arrays and latents of m new scaffold nodes."""

    xyz: np.ndarray
    """(F,m,3)"""
    quat: np.ndarray
    """(F,m,4)"""
    radius: np.ndarray
    """(m,)"""
    certain: np.ndarray
    """(F,m)"""
    neighbours: np.ndarray
    """(m,K)"""
    edge_mask: np.ndarray
    """(m,K)"""
    latents: np.ndarray
    """(m,D) uint8."""


def _no_nodes(times: np.ndarray) -> Scaffold:
    """Return a scaffold without nodes, for a scene that was static before its edits."""
    arrays = empty_arrays(SCAFFOLD_ARRAYS, F=len(times), K=1)
    return Scaffold(**{**arrays, "times": times}, unit=LONE_UNIT)


def _kinds(latents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return up to `ANCHORS` of `latents (n,D)`, the farthest apart, as (the nearest one of each (n,), those (k,D))."""
    values = latents.astype(np.float32)
    chosen, nearest = [0], np.full(len(values), np.inf)
    kind = np.zeros(len(values), int)
    while True:
        far = ((values - values[chosen[-1]]) ** 2).sum(1)
        kind[far < nearest] = len(chosen) - 1
        nearest = np.minimum(nearest, far)
        if len(chosen) == ANCHORS or not nearest.any():
            return kind, latents[chosen]
        chosen.append(int(nearest.argmax()))


def _taken(array: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the rows `index (n,)` of `array`, zeros where it is negative: Gaussians that only now belong to the dynamic set."""
    taken = np.zeros((len(index), *array.shape[1:]), array.dtype)
    taken[index >= 0] = array[index[index >= 0]]
    return taken


def _widened(array: np.ndarray, slots: int, mode: Literal["edge", "constant"]) -> np.ndarray:
    """Return `array (n,K)` with `slots` columns: the last one repeated, or zeros."""
    return np.pad(array, ((0, 0), (0, slots - array.shape[1])), mode=mode)
