"""The thing that a user points at, in all frames at once. Needs numpy alone.

Gaussians are grouped into superpoints whose members are close, look alike and, where they move, move alike: one graph of what
moves, one of what stands. A random walk starts at the superpoints under the prompt and steps along bonds between neighbours;
what moves is left for the background where it looks like what is behind it (Grady 2005). The thing is a set of the superpoints
with the highest random-walk scores: the one whose outline cuts the weakest bonds (sweep cut; Andersen, Chung and Lang 2006). What
is cast on the background (shadows, ripples, reflections) is no part of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..geometry import spherical_harmonics
from ..geometry.arrays import evenly_spaced
from ..scene import Scene
from .blend_weights import blend_weight_sums
from .connected_objects import connect
from .k_means import k_means, means, nearest
from .kept import Kept
from .marks import Mark
from .movers import UNKNOWN, movers_of
from .score import logistic
from .select_config import MOVING, SELECT, Cutting, GraphConfig, KindConfig, SelectConfig, ThingConfig
from .smoothing import LOOKS_ALIKE, field_of_looks
from .standing_out import between, difference
from .superpixels import static_part

MOSTLY = 0.5
"""A majority: a superpoint belongs to an exact mark, or to one on what is not meant, that has more of its blend weights."""
UNSEEN = 1e-4
"""Minimum blend weight of a Gaussian, in pixels."""


class Graph(NamedTuple):
    """The superpoints of a scene."""

    moving: Superpoints
    static: Superpoints


_GRAPHS: Kept[Graph] = Kept()


@dataclass(frozen=True, eq=False)
class Superpoints:
    """Superpoints: groups of the moving, or of the static Gaussians of a scene; P of them."""

    rows: np.ndarray
    """(n,) int64: the rows of these Gaussians in `scene.posed`."""
    index: np.ndarray
    """(n,) int64: the superpoint of each of them."""
    weight: np.ndarray
    """(P,) float64: blend weights of a superpoint in pixels of the clip's pictures, mean over its views."""
    bonds: np.ndarray
    """(P,P) float64 in [0, 1] between neighbours, symmetric, 0 with itself."""
    near: np.ndarray
    """(P,P) float64 in [0, 1]: the bonds if all superpoints looked alike."""
    blend: np.ndarray
    """(P,) float64 in [0, `GraphConfig.blending`]: bonds to the static background behind, by appearance alone; 0 if static."""
    cast: np.ndarray
    """(P,) bool: shadows, ripples and reflections that move over the background."""
    kind: KindConfig = MOVING
    """Search for a thing of this kind."""
    config: SelectConfig = SELECT
    """The numbers that they were made with."""
    unlike: np.ndarray | None = None
    """(n,) float64: how much each of these Gaussians differs from the background behind it; None: not known."""
    piece: np.ndarray | None = None
    """(P,) int64: superpoints of one piece move as one (`_pieces`), and a thing lies within one; None: all are one piece."""
    mover: np.ndarray | None = None
    """(P,) int64: superpoints of different movers are apart most of the time (`movers`); None: all are one mover."""

    def gather(self, weights: np.ndarray) -> np.ndarray:
        """Return the sums (P,) over superpoints of the blend `weights (N,)` of all Gaussians of the scene."""
        return np.bincount(self.index, weights[self.rows], len(self.weight))

    def spread(self, values: np.ndarray, count: int) -> np.ndarray:
        """Return `values (P,)` of the superpoints at their Gaussians, (N,) float64; 0 for others."""
        result = np.zeros(count)
        result[self.rows] = values[self.index]
        return result

    def means(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the means (P,) of `values (N,)` over the Gaussians of each superpoint, weighted by `weights (N,)`."""
        return self.gather(values * weights) / np.maximum(self.gather(weights), 1e-12)

    def apart(self, marked: np.ndarray) -> np.ndarray:
        """Return the superpoints (P,) bool of other pieces and movers than those with most of the blend weights `marked (P,)`."""
        other = np.zeros(len(marked), bool)
        if self.piece is not None and len(self.piece):
            other |= self.piece != np.bincount(self.piece, marked).argmax()
        if self.mover is not None and len(self.mover):
            mover = np.bincount(self.mover - UNKNOWN, marked).argmax() + UNKNOWN
            other |= (self.mover != mover) & (self.mover != UNKNOWN) & (mover != UNKNOWN)
        return other

    def held_movers(self, inside: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return two (P,) bool: movers of which most of what is `seen (P,)` is `inside (P,)`, and the others; empty for one."""
        none = np.zeros(len(seen), bool)
        if self.mover is None or not (self.mover > 0).any():
            return none, none
        own, shown = (np.bincount(self.mover - UNKNOWN, each * ~self.cast) for each in (inside, seen))
        held = (own > MOSTLY * shown)[self.mover - UNKNOWN]
        known = self.mover != UNKNOWN
        return held & known, ~held & known

    def left_over(self, thing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return two (P,) bool outside `thing (P,)` bool: what is cast or a small piece that touches it; other things."""
        limits, rest = self.config.thing, ~thing & ~self.cast
        one, two = np.nonzero(self.near)
        together = rest[one] & rest[two]
        if self.piece is not None:
            together &= self.piece[one] == self.piece[two]
        component = connect(np.stack([one, two])[:, together], len(thing))
        weight = np.bincount(component, self.weight * rest) / max(self.weight[thing].sum(), UNSEEN)
        touches = np.bincount(component[two[thing[one] & rest[two]]], minlength=len(weight)) > 0
        edge, other = touches & (weight <= limits.edge), ~touches | (weight >= limits.caster)
        return ~thing & self.cast | rest & edge[component], rest & other[component]

    def with_edges(self, thing: np.ndarray, refused: np.ndarray, count: int) -> np.ndarray:
        """Return (N,) float64: 1 for `thing (P,)` bool and for shadows and loose edges at it that stand out.

        Never those of `refused (P,)` bool. `count`: N.
        """
        own = self.spread(thing.astype(float), count)
        shadow = self.weight[thing & self.cast].sum() > MOSTLY * self.weight[thing].sum()
        if self.unlike is None or shadow:
            return own
        loose, others = self.left_over(thing)
        beside = loose & ~refused & (self.near[:, thing].sum(1) > self.near[:, others].sum(1))
        own[self.rows[beside[self.index] & (self.unlike > self.config.thing.stands_out)]] = 1
        return own

    def grow(
        self, marked: np.ndarray, against: np.ndarray, doubt: np.ndarray | None = None, filled: float = 0.0
    ) -> np.ndarray:
        """Return the thing (P,) bool that a random walk from the blend weights `marked (P,)` finds; never `against (P,)` bool.

        What is cast on the background is no part of it, unless most of what is marked is cast: then that alone is found.
        `doubt (P,)` in [0, 1]: other evidence that a superpoint is none of it; it counts like blending in. `filled`: least fraction
        of what is marked that the thing holds.
        """
        cast = marked[self.cast & ~against].sum() > MOSTLY * marked[~against].sum()
        free = ~against & (self.cast | ~cast)
        chosen = np.zeros(len(marked), bool)
        if not marked[free].any():
            return chosen
        blend = np.zeros(len(marked)) if cast else self.blend  # all that is cast blends in
        full = self.config.graph.blending
        open_ = full * (blend.any() + (doubt is not None)) * np.ones(len(marked))
        blend = blend if doubt is None else blend + full * doubt
        (bonds, out), (near, most) = (
            (between[free][:, free], leaving[free] + between[free][:, ~free].sum(1))
            for between, leaving in ((self.bonds, blend), (self.near, open_))
        )
        # Scaled by what leaves a superpoint: bonds differ by orders of magnitude, and the matrix would be near singular.
        total = (1 + self.kind.escape) * (bonds.sum(1) + out) + np.finfo(float).tiny
        scale = np.sqrt(total)
        score = np.linalg.solve(np.eye(len(bonds)) - bonds / scale[:, None] / scale, marked[free] / scale) / scale
        order = np.argsort(-score, kind="stable")
        size = np.cumsum(self.weight[free][order]) / self.weight.sum()
        held = np.cumsum(marked[free][order]) / marked[free].sum()
        # Rounding must not decide.
        small = (size < self.kind.sizes[0] * (1 - 1e-9)) | (held < filled * (1 - 1e-9))
        large = size > max(self.kind.sizes[1] * (1 + 1e-9), size[0])
        chosen[
            np.flatnonzero(free)[order[: _sweep((bonds, out), (near, most), order, ~small & ~large, self.kind.cutting)]]
        ] = True
        return chosen & (self.cast == cast)


def point_out(
    scene: Scene, marks: Sequence[Mark], likely: np.ndarray | None = None, config: SelectConfig = SELECT
) -> np.ndarray | None:
    """Return (N,) float64: 1 for the Gaussians of the thing that `marks` show (see `marks.Mark`), else 0.

    A moving thing where enough blend weights at the first mark on it belong to moving Gaussians, else one that stands: what later
    marks show of the other kind is left aside. `likely (N,)` in [0, 1], where it is known by words, is evidence of the same kind.
    None where nothing is left.
    """
    signs = _signs(scene, marks)
    drawn_on = any(mark.on and not mark.around for mark in marks)
    on_mover = [_mostly(start, scene.moving, _moving_fraction(marks, config.thing)) for start in signs.starts]
    moves = on_mover[0]
    graph, limits = graph_of(scene, config), config.thing
    superpoints = graph.moving if moves else graph.static
    if not moves and likely is None and _by_picture(marks):
        aside = [mark for mark, mover in zip(signs.started_by, on_mover, strict=True) if mover]
        return _in_picture(scene, [mark for mark in marks if mark not in aside], superpoints)
    seen, inside, outside = map(superpoints.gather, (signs.seen, signs.inside, signs.outside))
    against = (outside > inside) & (seen > limits.hidden * superpoints.weight)
    refused = np.zeros(len(seen), bool)
    for beside in map(superpoints.gather, signs.beside):
        refused |= (beside > limits.marked * beside.max()) | (beside > MOSTLY * seen)
    against |= refused
    held = np.zeros(len(seen), bool)
    for exact in map(superpoints.gather, signs.exact):
        held |= exact > MOSTLY * seen
    held &= ~against & (seen > 0)
    if not drawn_on:
        against |= superpoints.held_movers(inside, inside + outside)[1]
    doubt = None if likely is None else 1 - superpoints.means(likely, signs.seen + UNSEEN)
    filled = 0.0 if drawn_on else superpoints.kind.filled
    chosen = held
    for start in map(superpoints.gather, signs.starts):
        other = superpoints.apart(np.where(against, 0, start)) if drawn_on else False
        chosen = chosen | superpoints.grow(start, against | other, doubt, filled)
    # What is hidden behind another mover is lost and found again, as other superpoints, to which no bonds lead.
    chosen = chosen | superpoints.held_movers(chosen * seen, seen)[0] & ~against
    return superpoints.with_edges(chosen, refused, len(scene.ids)) if chosen.any() else None


def _mostly(weights: np.ndarray, rows: np.ndarray, fraction: float) -> bool:
    """Return True if at least a fraction of the blend weights (N,) belongs to the Gaussians `rows (N,)` bool."""
    return bool(weights[rows].any() and weights[rows].sum() >= fraction * weights.sum())


def _by_picture(marks: Sequence[Mark]) -> bool:
    """Return True if `marks` are clicks and strokes alone, and those beside the thing lie on frames of those on it."""
    frames = {mark.frame for mark in marks if mark.on}
    return all(not mark.around and mark.frame in frames for mark in marks)


def _in_picture(scene: Scene, marks: Sequence[Mark], superpoints: Superpoints) -> np.ndarray | None:
    """Return `point_out` of static things by the marked frames' pictures; Gaussians that show in none go with their superpoint."""
    fraction, seen = static_part(scene, marks, superpoints.config.picture)
    around = superpoints.spread(superpoints.means(fraction, seen), len(seen))
    chosen = (np.where(seen > superpoints.config.thing.shows, fraction, around) > MOSTLY) & ~scene.moving
    return chosen.astype(float) if chosen.any() else None


def held_movers(
    scene: Scene, inside: np.ndarray, seen: np.ndarray, config: SelectConfig = SELECT
) -> tuple[np.ndarray, np.ndarray]:
    """Return two (N,) bool: Gaussians of movers whose blend weights `seen (N,)` are mostly `inside (N,)`, and of the others."""
    superpoints = graph_of(scene, config).moving
    found = superpoints.held_movers(superpoints.gather(inside), superpoints.gather(seen))
    held, others = (superpoints.spread(part.astype(float), len(seen)) > 0 for part in found)
    return held, others


class _Signs(NamedTuple):
    """Blend weights (N,) of all Gaussians under marks, in pixels."""

    starts: list[np.ndarray]
    """Under each mark drawn on the thing; without such marks, inside those around it. Frames come as they were marked."""
    started_by: list[Mark]
    """The mark of each of `starts`."""
    beside: list[np.ndarray]
    """Under each mark on what is not meant."""
    exact: list[np.ndarray]
    """Under each mark most of which belongs to the thing."""
    inside: np.ndarray
    """Inside the marks around the thing, in their frames."""
    outside: np.ndarray
    """Outside of them."""
    seen: np.ndarray
    """In the whole pictures of all marked frames."""


def _signs(scene: Scene, marks: Sequence[Mark]) -> _Signs:
    """Return the blend weights under `marks`. F4xError for a mark that marks nothing."""
    size = (scene.cameras.height, scene.cameras.width)
    drawn_on = any(mark.on and not mark.around for mark in marks)
    count = len(scene.ids)
    signs = _Signs([], [], [], [], np.zeros(count), np.zeros(count), np.zeros(count))
    for frame in dict.fromkeys(mark.frame for mark in marks):
        here = [mark for mark in marks if mark.frame == frame]
        pixels = [mark.pixels(size) for mark in here]
        region = [at for mark, at in zip(here, pixels, strict=True) if mark.on and mark.around]
        within = np.any(region, 0) if region else np.ones(size, bool)
        layers = np.stack([np.ones(size, bool), within, *(at & within for at in pixels)], -1).astype(np.float32)
        seen, inside, *sums = blend_weight_sums(scene, float(scene.cameras.times[frame]), frame, layers).T
        signs.seen[:] += seen
        if region:
            signs.inside[:] += inside
            signs.outside[:] += seen - inside
        for mark, under in zip(here, sums, strict=True):
            if not mark.on:
                signs.beside.append(under)
            elif mark.around != drawn_on:
                signs.starts.append(under)
                signs.started_by.append(mark)
            if mark.on and mark.exact:
                signs.exact.append(under)
    return signs


def _moving_fraction(marks: Sequence[Mark], limits: ThingConfig) -> float:
    """Return the least fraction of the blend weights under `marks` that moving Gaussians have where a moving thing is meant."""
    if any(mark.on and not mark.around for mark in marks):
        return limits.moving_point
    return MOSTLY if all(mark.exact for mark in marks if mark.on) else limits.moving_box


def graph_of(scene: Scene, config: SelectConfig = SELECT) -> Graph:
    """Return the superpoints of a scene, cached as long as its static Gaussians live; an edited scene has those of its base."""
    base = scene.base
    graph = _GRAPHS.get(base.static, base.dynamic, base.features, config, make=lambda: superpoints_of(base, config))
    return graph if base is scene else Graph(*(_after_edits(part, scene) for part in graph))


def _after_edits(superpoints: Superpoints, scene: Scene) -> Superpoints:
    """Return the superpoints with the rows of an edited scene: a copy is where its original is."""
    index = np.full(len(scene.base.ids), -1)
    index[superpoints.rows] = superpoints.index
    there = index[scene.origin]
    rows = np.flatnonzero(there >= 0)
    unlike = superpoints.unlike
    if unlike is not None:
        of_base = np.zeros(len(index))
        of_base[superpoints.rows] = unlike
        unlike = of_base[scene.origin[rows]]
    return replace(superpoints, rows=rows, index=there[rows], unlike=unlike)


def superpoints_of(scene: Scene, config: SelectConfig = SELECT) -> Graph:
    """Group the Gaussians of a scene, moving and static ones by themselves, and bond the groups."""
    appearance, graph = _appearance(scene, config.graph), config.graph
    weights, differences = difference(scene, graph.views, graph.columns)
    weights += UNSEEN
    moving = _moving_superpoints(scene, appearance, weights, differences, config)
    return Graph(moving, _static_superpoints(scene, appearance, weights, config))


def _moving_superpoints(
    scene: Scene, appearance: np.ndarray, weights: np.ndarray, differences: np.ndarray, config: SelectConfig
) -> Superpoints:
    """Return the superpoints of the moving Gaussians.

    `appearance (N,C)`, blend `weights (N,)`, and `differences (N,)`: these times the difference from the background.
    """
    graph, rows = config.graph, np.flatnonzero(scene.moving)
    tracks = _tracks(scene, graph)
    index, weight, _, looks = _group(tracks.joint(), appearance[rows], weights[rows], graph.moving, graph)
    ways = tracks.means(index, weights[rows], len(weight))
    bonds, near = _bonds(ways.apart(), looks, graph.neighbours)
    changes = _changes(ways, near)
    bonds, piece = _strengthen(bonds, near, changes, graph), _pieces(changes, len(near), graph)
    differs = np.bincount(index, differences[rows], len(weight)) / weight
    blend, cast = graph.blending * np.exp(-((differs / graph.differs) ** 2)), _cast(differs, weight, bonds, graph)
    cast &= ~_held(scene, index, ~cast, graph)
    if weight[cast].sum() > MOSTLY * weight.sum():  # the background holds the things, too, and tells nothing
        cast[:] = False
    unlike = differences[rows] / weights[rows]
    mover = movers_of(ways.places, ways.presence, weight * ~cast, bonds, config.movers)
    return Superpoints(rows, index, weight, bonds, near, blend, cast, config.thing.moving, config, unlike, piece, mover)


def _static_superpoints(scene: Scene, appearance: np.ndarray, weights: np.ndarray, config: SelectConfig) -> Superpoints:
    """Return the superpoints of the static Gaussians, by `appearance (N,C)` and blend `weights (N,)`."""
    graph, rows = config.graph, np.flatnonzero(~scene.moving)
    scale = np.append(np.full(appearance.shape[1] - 3, graph.static_features), np.ones(3))
    index, weight, sights, looks = _group(
        _sights(scene, graph)[rows], appearance[rows] * scale, weights[rows], graph.static, graph
    )
    bonds, near = _bonds(_squares(sights, sights), looks, graph.neighbours)
    none, nobody = np.zeros(len(weight)), np.zeros(len(weight), bool)
    return Superpoints(rows, index, weight, bonds, near, none, nobody, config.thing.static, config)


def _cast(differs: np.ndarray, weight: np.ndarray, bonds: np.ndarray, graph: GraphConfig) -> np.ndarray:
    """Return the superpoints (P,) bool cast on the background, by how much they and their neighbours differ from it, (P,).

    A random walk with priors (Grady 2005): a superpoint is like its neighbours in `bonds (P,P)`, and by itself a thing with a
    probability that rises with `differs`; `weight (P,)` says how much that counts.
    """
    prior = logistic((differs - graph.cast) / graph.unsure)
    mass = weight * (len(weight) / max(weight.sum(), UNSEEN))
    across = np.diag(bonds.sum(1)) - bonds
    return np.linalg.solve(np.diag(mass) + graph.vote * across, mass * prior) < MOSTLY


def _held(scene: Scene, index: np.ndarray, thing: np.ndarray, graph: GraphConfig) -> np.ndarray:
    """Return the superpoints (P,) bool that mostly have some of `thing (P,)` bool above and below in the pictures.

    A grey shirt before a grey wall is no shadow. `index (n,)`: superpoints of the Gaussians that move.
    """
    if thing.all() or not thing.any():
        return np.zeros(len(thing), bool)
    chosen = np.zeros(len(scene.ids), bool)
    chosen[scene.moving] = thing[index]
    weights, parts = (
        np.bincount(index, each[scene.moving], len(thing))
        for each in between(scene, chosen, graph.glances, graph.columns)
    )
    return parts > MOSTLY * weights


class _Tracks(NamedTuple):
    """Places of n Gaussians or superpoints at T times over the clip."""

    places: np.ndarray
    """(n,T,3); 1 = the standard deviation of all of them."""
    presence: np.ndarray
    """(n,T) in [0, 1]: how much of each is there."""
    graph: GraphConfig

    def joint(self) -> np.ndarray:
        """Return (n,3 `GraphConfig.grouped_by`): places at a few times, as one place in a space of so many dimensions."""
        some = self.places[:, evenly_spaced(self.places.shape[1], self.graph.grouped_by)]
        return some.reshape(len(some), 3 * some.shape[1]) / np.sqrt(some.shape[1])

    def means(self, index: np.ndarray, weights: np.ndarray, groups: int) -> _Tracks:
        """Return the tracks of groups of rows, `index (n,)` int, weighted by `weights (n,)` and presence; a group is in or out."""
        held = weights[:, None] * (self.presence + self.graph.absent)
        places = [means(index, held[:, t], self.places[:, t], groups) for t in range(held.shape[1])]
        shares = means(index, weights, self.presence, groups)
        there = shares >= self.graph.present * np.maximum(shares.max(1, keepdims=True), 1e-9)
        return _Tracks(np.stack(places, 1), there.astype(float), self.graph)

    def apart(self) -> np.ndarray:
        """Return the mean squared distances (n,n) over the times at which two are present; infinite for two that never meet."""
        total = np.zeros((len(self.places), len(self.places)))
        for place, there in zip(self.places.swapaxes(0, 1), self.presence.T, strict=True):
            total += there[:, None] * there * _squares(place, place)
        times = self.presence @ self.presence.T
        return np.divide(total, times, out=np.full_like(total, np.inf), where=times > 0)


def _tracks(scene: Scene, graph: GraphConfig) -> _Tracks:
    """Return the tracks of the moving Gaussians."""
    times = [float(time) for time in scene.cameras.times[evenly_spaced(len(scene.cameras), graph.times)]]
    places = np.stack([scene.posed(time).means[scene.moving] for time in times], 1)
    spread = np.sqrt(places.var(0).sum() / len(times)) if len(places) else 1.0
    presence = np.stack([scene.dynamic.presence(time) for time in times], 1)
    return _Tracks(places / max(spread, 1e-9), presence, graph)


def _sights(scene: Scene, graph: GraphConfig) -> np.ndarray:
    """Return (N,4) float64: the direction from the camera in the middle of the clip to a Gaussian, and its distance."""
    middle = len(scene.cameras) // 2
    away = scene.posed(float(scene.cameras.times[middle])).means - scene.cameras[middle].center
    far = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    return np.concatenate([graph.sight * away / far, graph.far * np.log(far)], 1)


def _appearance(scene: Scene, graph: GraphConfig) -> np.ndarray:
    """Return (N,C) float32: features of unit length, as far as the scene has any, and weighted colors."""
    colour = graph.colour * np.clip(spherical_harmonics.rgb_from_dc(scene.posed(0.0).sh[:, 0]), 0, 1)
    field = field_of_looks(scene)
    if field is None:
        return colour.astype(np.float32)
    features = field.decode(LOOKS_ALIKE, scene.latents())
    features = features - features.mean(0)
    features /= np.maximum(np.linalg.norm(features, axis=1, keepdims=True), 1e-9)
    directions = np.linalg.eigh(features.T @ features)[1][:, -graph.directions :]
    return np.concatenate([features @ directions, colour], 1, dtype=np.float32)


def _group(
    place: np.ndarray, appearance: np.ndarray, weights: np.ndarray, count: int, graph: GraphConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Group n rows by k-means: index (n,), weight (k,), mean place (k,…) and looks (k,C) of at most `count` groups, none empty."""
    if not len(place):
        return np.zeros(0, int), weights, place, appearance
    looks = [graph.features * appearance[:, :-3], appearance[:, -3:] / graph.colour]
    joint = np.concatenate([place, *looks], 1, dtype=np.float32)
    centres = k_means(joint, count, graph.sample, graph.rounds)
    index = np.unique(nearest(joint, centres), return_inverse=True)[1]
    groups = int(index.max()) + 1
    weight = np.bincount(index, weights, groups)
    return index, weight, means(index, weights, place, groups), means(index, weights, appearance, groups)


def _squares(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the squared distances (n,m) of rows."""
    return np.maximum((one**2).sum(1)[:, None] + (other**2).sum(1) - 2 * one @ other.T, 0)


def _bonds(far: np.ndarray, appearance: np.ndarray, neighbours: int) -> tuple[np.ndarray, np.ndarray]:
    """Return bonds (P,P) between neighbours by squared distances `far (P,P)`, and the bonds if all looked alike."""
    # A product of matrices is symmetric but for rounding, which must not decide who is near.
    far = np.maximum(far, far.T)
    np.fill_diagonal(far, np.inf)
    if len(far) < 2:
        return np.zeros(far.shape), np.zeros(far.shape)
    last = min(neighbours, len(far) - 1) - 1
    reach = np.partition(far, last, axis=1)[:, last]
    near = (far <= np.maximum(reach[:, None], reach)) & np.isfinite(far)
    if not near.any():
        return np.zeros(far.shape), np.zeros(far.shape)
    unlike = _squares(appearance, appearance)
    unit = max(float(np.median(unlike[near])), 1e-9)
    close = np.where(near, np.exp(-far / max(np.median(reach[np.isfinite(reach)]), 1e-12)), 0)
    return close * np.exp(-unlike / unit), close


class _Changes(NamedTuple):
    """Changes of the distances of E pairs of neighbours."""

    pairs: np.ndarray
    """(2,E) int64."""
    change: np.ndarray
    """(E,): as a fraction of the distance, or of the neighbours' median distance where that is more, while both are there."""


def _changes(tracks: _Tracks, near: np.ndarray) -> _Changes:
    """Return the changes of distance between neighbours, `near (P,P)` > 0."""
    one, two = np.nonzero(near)
    if not len(one):
        return _Changes(np.zeros((2, 0), int), np.zeros(0))
    far = np.linalg.norm(tracks.places[one] - tracks.places[two], axis=2)
    far[(tracks.presence[one] * tracks.presence[two]) == 0] = np.nan
    change = np.nanmax(far, 1) - np.nanmin(far, 1)
    change /= np.nanmean(far, 1) + np.nanmedian(far) + np.finfo(float).tiny
    return _Changes(np.stack([one, two]), change)


def _pieces(changes: _Changes, count: int, graph: GraphConfig) -> np.ndarray:
    """Return the piece (P,) int64 of each of `count` superpoints, from 0: neighbours stay together while their distance lasts."""
    pairs, change = changes
    if not len(change):
        return np.arange(count)
    usual = max(graph.rigid, graph.noise * float(np.median(change)))
    return connect(pairs[:, change <= graph.lasting * usual], count)


def _strengthen(bonds: np.ndarray, near: np.ndarray, changes: _Changes, graph: GraphConfig) -> np.ndarray:
    """Return `bonds (P,P)` with part of what differing looks took from them, `near (P,P)`, where two move as one."""
    pairs, change = changes
    if not len(change):
        return bonds
    steady = np.zeros_like(bonds)
    steady[tuple(pairs)] = np.exp(-((change / max(graph.rigid, float(np.median(change)))) ** 2))
    return bonds + graph.together * steady * (near - bonds)


def _sweep(
    strength: tuple[np.ndarray, np.ndarray],
    most: tuple[np.ndarray, np.ndarray],
    order: np.ndarray,
    fits: np.ndarray,
    cutting: Cutting,
) -> int:
    """Return the n of the set that `cutting` means among the first n superpoints in `order (P,)`; `fits (P,)` bool may win.

    `strength`: bonds (P,P), cut where only one of two is in the set, and bonds to the outside (P,), cut for every superpoint in
    it; `most`: what those could be. Where no set fits, it is the last one that does not.
    """
    cut, volume = _cuts(*strength, order)
    at_most = np.maximum(_cuts(*most, order)[0], 1e-9)
    cut = np.maximum(cut, 0)
    contrast = cutting.contrast
    weakness = (cut / at_most) ** contrast * (cut / np.maximum(volume, 1e-12)) ** (1 - contrast)
    weakness[~fits] = np.inf
    if not fits.any():
        return len(order)
    first = int(np.argmin(np.maximum(weakness, cutting.clear)))
    stops = np.append(weakness[first + 1 :] >= weakness[first:-1], True)
    return first + int(np.argmax(stops)) + 1


def _cuts(bonds: np.ndarray, out: np.ndarray, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cut bonds (P,) and all bonds (P,) of the first 1, 2, … superpoints of `order (P,)`."""
    degree = (bonds.sum(1) + out)[order]
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    one, two = np.nonzero(bonds)  # few: all pairs would cost a tenth of a second
    before = rank[two] < rank[one]
    inner = np.bincount(rank[one[before]], bonds[one[before], two[before]], len(order))  # bonds to those before it
    return np.cumsum(degree - 2 * inner), np.cumsum(degree)
