"""The moving object that a user points at, in all frames at once. Needs numpy alone.

Moving Gaussians are grouped into superpoints whose members are close, look alike and move alike. A random walk starts at the
superpoints under the prompt and steps between superpoints by appearance, wherever they are; it is absorbed by the static
background where a superpoint looks like that: a shadow like the ground, ripples like the water (Grady 2005). The object is a
set of the superpoints with the highest random-walk scores: the set with the lowest conductance, which is the fraction of its
bonds that lead to its neighbours and to the background (sweep cut; Andersen, Chung and Lang 2006).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..features.models.prompt import Prompt
from ..geometry import spherical_harmonics
from ..scene import Scene
from .blend_weights import blend_weight_sums, total_blend_weights
from .smoothing import LOOKS_ALIKE

SUPERPOINTS, BACKDROP = 1000, 600
"""Superpoints of moving and of static Gaussians. With so many, labelling superpoints rather than Gaussians costs 0.02 of IoU, and
matrices of all pairs stay small."""
ROUNDS = 5
"""Rounds of k-means; superpoints need not converge, they only have to be compact."""
TIMES, VIEWS, COLUMNS = 3, 5, 120
"""Times at which places are compared; views, evenly over the clip, in which blend weights are summed, and their width in pixels."""
DIRECTIONS = 16
"""Principal directions of the features that tell looks apart; the others are noise and cost time."""
COLOUR = 0.7
"""Weight of colour (sRGB, 1 = black to white) beside unit features in the distance of two looks."""
PLACED, SEEN = 1.0, 0.5
"""Weights of place (in its standard deviations) and of features when superpoints are made; colour counts 1."""
NEIGHBOURS = 12
"""Minimum number of superpoints that one is bonded to, and number of static groups that decide how well it blends in."""
BLENDING = 4.0
"""Bonds of full strength from a superpoint to the static background that looks like it. Four filmed and three rendered clips,
four clicks on each: IoU is the same within 0.01 from 3 to 6; at 1 the water around a swan is the swan, at 10 a thing with
dark parts falls apart."""
SHARP = 8.0
"""Walkers step along exp(-SHARP x squared distance of looks / its median): at 4 a swan's walkers end in the water."""
ESCAPE = 1e-3
"""Fraction of the walkers that is lost at every superpoint: without any loss, all superpoints would score alike."""
HEAVY = 0.95
"""Quantile of the weights of superpoints, or of static groups, above which they are clipped."""
MIN_FRACTION = 0.02
"""Minimum fraction of the moving blend weights that an object has: the outline of a few superpoints can be short by chance."""
DOT = 0.006
"""Radius of a point, in widths of the picture: what a hand with a mouse means."""
MOVING_POINT, MOVING_BOX = 0.5, 0.25
"""Minimum fraction of the blend weights at the points, or in a box, that belongs to moving Gaussians if a moving object is
meant; a box holds more background."""
MARKED = 0.3
"""A superpoint is marked by the negative points when it has this fraction of the blend weights of the most marked one."""
UNSEEN = 1e-4
"""Minimum blend weight of a Gaussian, in pixels."""
BLOCK = 4096
"""Gaussians compared with all centres at once: the matrix of their distances stays small."""


@dataclass(frozen=True, eq=False)
class Superpoints:
    """Superpoints: groups of the moving Gaussians of a scene; P of them."""

    rows: np.ndarray
    """(n,) int64: the rows of the moving Gaussians in `scene.posed`."""
    index: np.ndarray
    """(n,) int64: the superpoint of each of them."""
    weight: np.ndarray
    """(P,) float64: blend weights of a superpoint, summed over views of the clip."""
    bonds: np.ndarray
    """(P,P) float64 in [0, 1] between neighbours, symmetric, 0 with itself."""
    blend: np.ndarray
    """(P,) float64 in [0, BLENDING]: bonds to the static background, by appearance alone."""
    steps: np.ndarray
    """(P,P) float64: rate of the random walk from one superpoint to another, by appearance alone; symmetric, 0 with itself."""
    lost: np.ndarray
    """(P,) float64: rate of the random walk to the static background, which absorbs it."""

    def gather(self, weights: np.ndarray) -> np.ndarray:
        """(P,): sums over superpoints of the blend `weights (N,)` of all Gaussians of the scene."""
        return np.bincount(self.index, weights[self.rows], len(self.weight))

    def spread(self, values: np.ndarray, count: int) -> np.ndarray:
        """(N,) float64: `values (P,)` given to the Gaussians of the superpoints; 0 for static ones."""
        result = np.zeros(count)
        result[self.rows] = values[self.index]
        return result

    def grow(self, marked: np.ndarray, against: np.ndarray) -> np.ndarray:
        """(P,) bool: the object that a random walk from the blend weights `marked (P,)` finds; never `against (P,)` bool."""
        free = ~against
        chosen = np.zeros(len(marked), bool)
        if not marked[free].any():
            return chosen
        (steps, leaving), (bonds, cut) = (
            (between[free][:, free], out[free] + between[free][:, against].sum(1))
            for between, out in ((self.steps, self.lost), (self.bonds, self.blend))
        )
        # Scaled by what leaves a superpoint: blend weights differ by orders of magnitude, and the matrix would be near singular.
        total = (1 + ESCAPE) * (steps.sum(1) + leaving) + np.finfo(float).tiny
        scale = np.sqrt(total)
        random_walk_score = (
            np.linalg.solve(np.eye(len(steps)) - steps / scale[:, None] / scale, marked[free] / scale) / scale
        )
        chosen[free] = _sweep(bonds, cut, random_walk_score, self.weight[free])
        return chosen


def point_out(scene: Scene, prompts: Mapping[int, Prompt]) -> np.ndarray | None:
    """(N,) float64: 1 for the Gaussians of the moving object at points or in a box (clip frame -> prompt), else 0.

    None where most blend weights at the points, or in the boxes, belong to static Gaussians, or where no superpoint is left.
    """
    starts, rest = [], np.zeros((3, len(scene.ids)))
    for frame, prompt in prompts.items():
        layers = _marks(prompt, (scene.cameras.height, scene.cameras.width))
        sums = blend_weight_sums(scene, float(scene.cameras.times[frame]), frame, layers).T
        starts += [*sums[3:]]
        rest += sums[:3]
    toward = np.sum(starts, 0)
    minimum = MOVING_POINT if any(prompt.labels.any() for prompt in prompts.values()) else MOVING_BOX
    if toward[scene.moving].sum() < minimum * toward.sum() or not toward[scene.moving].any():
        return None
    superpoints = superpoints_of(scene)
    beside, outside, inside = map(superpoints.gather, rest)
    against = (beside > MARKED * beside.max()) | (outside > inside)
    chosen = np.any([superpoints.grow(superpoints.gather(start), against) for start in starts], 0)
    return superpoints.spread(chosen, len(scene.ids)) if chosen.any() else None


def _marks(prompt: Prompt, size: tuple[int, int]) -> np.ndarray:
    """(H,W,3+n) float32 in {0, 1}: at negative points, outside the box, inside, and at each of n positive points (else inside)."""
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5

    def around(points: np.ndarray) -> np.ndarray:
        far = (columns[..., None] - points[:, 0]) ** 2 + (rows[..., None] - points[:, 1]) ** 2
        return (far <= max(1.0, DOT * size[1]) ** 2).any(-1)

    inside = np.ones(size, bool)
    if prompt.box is not None:
        left, top, right, bottom = prompt.box
        inside = (columns >= left) & (columns <= right) & (rows >= top) & (rows <= bottom)
    on = [around(point[None]) & inside for point in prompt.points[prompt.labels]] or [inside]
    return np.stack([around(prompt.points[~prompt.labels]), ~inside, inside, *on], -1).astype(np.float32)


def superpoints_of(scene: Scene) -> Superpoints:
    """The superpoints of the moving Gaussians of a scene that has some."""
    times = scene.cameras.times[np.linspace(0, len(scene.cameras) - 1, TIMES).round().astype(int)]
    posed = [scene.posed(float(time)) for time in times]
    moving, static = np.flatnonzero(scene.moving), np.flatnonzero(~scene.moving)
    place = np.stack([moment.means for moment in posed], 1)  # (N,TIMES,3)
    appearance = _appearance(scene)
    weights = total_blend_weights(scene, VIEWS, COLUMNS) + UNSEEN
    spread = np.sqrt(place[moving].var(0).sum() / TIMES)
    tracks = place[moving].reshape(len(moving), 3 * TIMES) / np.sqrt(TIMES)
    index, weight, centres, mine = _group(tracks / max(spread, 1e-9), appearance[moving], weights[moving], SUPERPOINTS)
    # Far static Gaussians that look alike can be far apart; angles from the first camera compare better than metres.
    sight = place[static, 0] - scene.cameras[0].center
    sight = sight / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
    _, backdrop, _, theirs = _group(2 * sight, appearance[static], weights[static], BACKDROP)
    bonds, unit = _bonds(centres, mine)
    apart, unlike = _squares(mine, theirs), _squares(mine, mine)
    nearest = np.sort(apart, axis=1)[:, :NEIGHBOURS]
    blend = BLENDING * np.exp(-nearest.mean(1) / unit) if nearest.size else np.zeros(len(mine))
    reach = max(float(np.median(unlike)), 1e-9) / SHARP
    mass, other = _mass(weight), _mass(backdrop)
    steps = np.exp(-unlike / reach) * np.sqrt(mass[:, None] * mass)
    np.fill_diagonal(steps, 0)
    return Superpoints(moving, index, weight, bonds, blend, steps, mass * (np.exp(-apart / reach) @ other))


def _appearance(scene: Scene) -> np.ndarray:
    """(N,C) float32: features of unit length, as far as the scene has any, and weighed colours."""
    colour = COLOUR * np.clip(spherical_harmonics.rgb_from_dc(scene.posed(0.0).sh[:, 0]), 0, 1)
    if scene.features is None or LOOKS_ALIKE not in scene.features.names:
        return colour.astype(np.float32)
    features = scene.features.decode(LOOKS_ALIKE, scene.latents())
    features = features - features.mean(0)
    features /= np.maximum(np.linalg.norm(features, axis=1, keepdims=True), 1e-9)
    directions = np.linalg.eigh(features.T @ features)[1][:, -DIRECTIONS:]
    return np.concatenate([features @ directions, colour], 1, dtype=np.float32)


def _group(
    place: np.ndarray, appearance: np.ndarray, weights: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """k-means of n rows: index (n,), weight (k,), mean place (k,…) and looks (k,C) of at most `count` groups, none empty."""
    if not len(place):
        return np.zeros(0, int), weights, place, appearance
    joint = np.concatenate(
        [PLACED * place, SEEN * appearance[:, :-3], appearance[:, -3:] / COLOUR], 1, dtype=np.float32
    )
    centres = joint[np.random.default_rng(0).permutation(len(joint))[:count]]
    for _ in range(ROUNDS):
        index = _nearest(joint, centres)
        centres = _means(index, np.ones(len(joint)), joint, len(centres)).astype(np.float32)
    index = np.unique(_nearest(joint, centres), return_inverse=True)[1]
    groups = int(index.max()) + 1
    weight = np.bincount(index, weights, groups)
    return index, weight, _means(index, weights, place, groups), _means(index, weights, appearance, groups)


def _nearest(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """(n,) int: which of `centres (k,D)` is nearest to each of `points (n,D)`, block by block."""
    half = (centres**2).sum(1) / 2
    blocks = np.array_split(points, max(1, len(points) // BLOCK))
    return np.concatenate([(half - block @ centres.T).argmin(1) for block in blocks])


def _means(index: np.ndarray, weight: np.ndarray, values: np.ndarray, groups: int) -> np.ndarray:
    """(groups,C) float64 weighted means of `values (n,C)`; 0 for an empty group."""
    sums = np.stack([np.bincount(index, weight * column, groups) for column in values.T], 1)
    return sums / np.maximum(np.bincount(index, weight, groups), 1e-12)[:, None]


def _mass(weights: np.ndarray) -> np.ndarray:
    """`weights (n,)`, clipped at their quantile `HEAVY`, as fractions of the sum."""
    mass = np.minimum(weights, np.quantile(weights, HEAVY)) if len(weights) else weights
    return mass / max(mass.sum(), 1e-12)


def _squares(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,m) squared distances of rows."""
    return np.maximum((one**2).sum(1)[:, None] + (other**2).sum(1) - 2 * one @ other.T, 0)


def _bonds(place: np.ndarray, appearance: np.ndarray) -> tuple[np.ndarray, float]:
    """Bonds (P,P) between neighbours in `place (P,…)`, and the squared distance of looks that weakens one by 1/e."""
    far = _squares(place, place)
    np.fill_diagonal(far, np.inf)
    if len(far) < 2:
        return np.zeros(far.shape), 1.0
    last = min(NEIGHBOURS, len(far) - 1) - 1
    reach = np.partition(far, last, axis=1)[:, last]
    near = far <= np.maximum(reach[:, None], reach)
    unlike = _squares(appearance, appearance)
    unit = max(float(np.median(unlike[near])), 1e-9)
    return np.where(near, np.exp(-far / max(np.median(reach), 1e-12) - unlike / unit), 0), unit


def _sweep(bonds: np.ndarray, out: np.ndarray, random_walk_score: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(P,) bool: of the sets of superpoints with the highest `random_walk_score (P,)`, the one with the lowest conductance.

    Bonds `out (P,)` are cut for every superpoint in the set, `bonds (P,P)` where only one of the two is.
    """
    degree = bonds.sum(1) + out
    order = np.argsort(-random_walk_score, kind="stable")
    inner = np.tril(bonds[order][:, order], -1).sum(1)  # bonds to superpoints before it in the order
    cut = np.cumsum(degree[order] - 2 * inner) / np.cumsum(degree[order])
    cut[np.cumsum(weight[order]) < MIN_FRACTION * weight.sum()] = np.inf
    chosen = np.zeros(len(order), bool)
    chosen[order[: int(np.argmin(cut)) + 1]] = True
    return chosen
