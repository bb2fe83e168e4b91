"""What moves, cut into things: the one that a user points at, over all times at once. Needs numpy alone.

Moving Gaussians are grouped into pieces that lie, look and move alike. A walker who starts where the user pointed goes from
piece to piece along bonds of nearness and likeness (random walker, Grady 2005), and is lost to what stands still the more a
piece looks like that: a shadow like the ground, ripples like the water. The thing is the set of first-reached pieces with
fewest bonds to all else for its own (least conductance; Andersen, Chung and Lang 2006).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..features.models.prompt import Prompt
from ..geometry import spherical_harmonics
from ..scene import Scene
from .light import light_into
from .smoothing import LOOKS_ALIKE

PIECES, BACKDROP = 1000, 600
"""Pieces of what moves and of what stands still: with these many, true labels of pieces cost 0.02 of IoU against labels of
Gaussians, and matrices of all pairs stay small."""
ROUNDS = 5
"""Rounds of k-means; pieces need not settle, they only have to be compact."""
TIMES, VIEWS, COLUMNS = 3, 5, 120
"""Times at which places are compared; views, evenly over the clip, whose light counts, and the width of their pictures."""
DIRECTIONS = 16
"""Principal directions of the features that tell looks apart; the others are noise and cost time."""
COLOUR = 0.7
"""Weight of colour (sRGB, 1 = black to white) beside unit features in the distance of two looks."""
PLACED, SEEN = 1.0, 0.5
"""Weights of place (in its standard deviations) and of features when pieces are made; colour counts 1."""
NEIGHBOURS, RIVALS = 12, 4
"""Pieces that a piece is bonded to at least; backdrops most alike whose mean distance says how well a piece blends in."""
ESCAPE = 1e-4
"""Share of the walkers that get lost at every piece: with none and no backdrop, all places would be reached alike."""
SMALLEST = 0.02
"""Least share of the moving light that a thing has: the outline of a few pieces can be short by chance."""
DOT = 0.006
"""Radius of a point, in widths of the picture: what a hand with a mouse means."""
MOVING_POINT, MOVING_BOX = 0.5, 0.25
"""Share of the light at the points, or in a box, that comes from what moves if a moving thing is meant: boxes hold more."""
MARKED = 0.3
"""Of points beside the thing, a piece with this share of the light of the most marked one is marked too."""
UNSEEN = 1e-4
"""Light, in pixels, that every Gaussian counts with at least."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Groups of moving Gaussians of a scene; P pieces, Q groups of what stands still."""

    rows: np.ndarray
    """(n,) int64: the rows of the moving Gaussians in `scene.posed`."""
    index: np.ndarray
    """(n,) int64: the piece of each of them."""
    weight: np.ndarray
    """(P,) float64: light that a piece sends into views of the clip."""
    bonds: np.ndarray
    """(P,P) float64 in [0, 1], symmetric, 0 with itself."""
    loss: np.ndarray
    """(P,) float64 in [0, 1]: bond to what stands still, by looks alone."""

    def gather(self, light: np.ndarray) -> np.ndarray:
        """(P,): sums over pieces of `light (N,)` of all Gaussians of the scene."""
        return np.bincount(self.index, light[self.rows], len(self.weight))

    def spread(self, values: np.ndarray, count: int) -> np.ndarray:
        """(N,) float64: `values (P,)` given to the Gaussians of the pieces; 0 for what stands still."""
        result = np.zeros(count)
        result[self.rows] = values[self.index]
        return result

    def grow(self, marked: np.ndarray, against: np.ndarray) -> np.ndarray:
        """(P,) bool: the thing that walkers find who start by the light `marked (P,)`; nothing of `against (P,)` bool."""
        free = ~against
        chosen = np.zeros(len(marked), bool)
        if not marked[free].any():
            return chosen
        bonds = self.bonds[free][:, free]
        degree = bonds.sum(1) + self.loss[free] + self.bonds[free][:, against].sum(1)
        walked = np.linalg.solve(np.diag(degree + ESCAPE * np.median(degree)) - bonds, marked[free])
        chosen[free] = _sweep(bonds, degree, walked, self.weight[free])
        return chosen


def point_out(scene: Scene, prompts: Mapping[int, Prompt]) -> np.ndarray | None:
    """(N,) float64, 1 for the Gaussians of the moving thing at points or in a box (clip frame -> prompt), else 0.

    None where the light at the points, or most of it in the boxes, comes from what stands still.
    """
    light = np.zeros((len(scene.ids), 3))  # at points on the thing or in its box, at points beside it, outside its box
    for frame, prompt in prompts.items():
        layers = _marks(prompt, (scene.cameras.height, scene.cameras.width))
        light += light_into(scene, float(scene.cameras.times[frame]), frame, layers)
    toward, beside, outside = light.T
    least = MOVING_POINT if any(prompt.labels.any() for prompt in prompts.values()) else MOVING_BOX
    if toward[scene.moving].sum() < least * toward.sum() or not toward[scene.moving].any():
        return None
    pieces = pieces_of(scene)
    toward, beside, outside = (pieces.gather(column) for column in (toward, beside, outside))
    against = (beside > MARKED * beside.max()) | (outside > toward)
    return pieces.spread(pieces.grow(toward, against), len(scene.ids))


def _marks(prompt: Prompt, size: tuple[int, int]) -> np.ndarray:
    """(H,W,3) float32 in {0, 1}: around points on the thing, or in the box without such points; beside it; outside the box."""
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5

    def around(points: np.ndarray) -> np.ndarray:
        far = (columns[..., None] - points[:, 0]) ** 2 + (rows[..., None] - points[:, 1]) ** 2
        return (far <= max(1.0, DOT * size[1]) ** 2).any(-1)

    inside = np.ones(size, bool)
    if prompt.box is not None:
        left, top, right, bottom = prompt.box
        inside = (columns >= left) & (columns <= right) & (rows >= top) & (rows <= bottom)
    on = around(prompt.points[prompt.labels]) if prompt.labels.any() else inside
    return np.stack([on & inside, around(prompt.points[~prompt.labels]), ~inside], -1).astype(np.float32)


def pieces_of(scene: Scene) -> Pieces:
    """The pieces of what moves in a scene."""
    times = scene.cameras.times[np.linspace(0, len(scene.cameras) - 1, TIMES).round().astype(int)]
    posed = [scene.posed(float(time)) for time in times]
    moving, standing = np.flatnonzero(scene.moving), np.flatnonzero(~scene.moving)
    place = np.stack([moment.means for moment in posed], 1)  # (N,TIMES,3)
    looks = _looks(scene)
    light = _light(scene) + UNSEEN
    spread = np.sqrt(place[moving].var(0).sum() / TIMES) if len(moving) else 1.0
    tracks = place[moving].reshape(len(moving), -1) / np.sqrt(TIMES)
    index, weight, centres, mine = _group(tracks / max(spread, 1e-9), looks[moving], light[moving], PIECES)
    # What stands far off varies much in place for its looks; angles from the first camera compare better than metres.
    sight = place[standing, 0] - scene.cameras[0].center
    sight = sight / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
    *_, theirs = _group(2 * sight, looks[standing], light[standing], BACKDROP)
    bonds, unit = _bonds(centres, mine)
    apart = _squares(mine, theirs)
    if apart.shape[1]:
        rivals = min(RIVALS, apart.shape[1])
        loss = np.exp(-np.partition(apart, rivals - 1, axis=1)[:, :rivals].mean(1) / unit)
    else:
        loss = np.zeros(len(mine))
    return Pieces(moving, index, weight, bonds, loss)


def _looks(scene: Scene) -> np.ndarray:
    """(N,C) float32: features of unit length, as far as the scene has any, and weighed colours."""
    colour = COLOUR * np.clip(spherical_harmonics.rgb_from_dc(scene.posed(0.0).sh[:, 0]), 0, 1)
    if scene.features is None or LOOKS_ALIKE not in scene.features.names:
        return colour.astype(np.float32)
    features = scene.features.decode(LOOKS_ALIKE, scene.latents())
    features = features - features.mean(0)
    features /= np.maximum(np.linalg.norm(features, axis=1, keepdims=True), 1e-9)
    directions = np.linalg.eigh(features.T @ features)[1][:, -DIRECTIONS:]
    return np.concatenate([features @ directions, colour], 1, dtype=np.float32)


def _light(scene: Scene) -> np.ndarray:
    """(N,) float64: pixels of light that each Gaussian sends into `VIEWS` small views."""
    cameras = scene.cameras
    layer = np.ones((max(1, round(COLUMNS * cameras.height / cameras.width)), COLUMNS, 1), np.float32)
    frames = np.unique(np.linspace(0, len(cameras) - 1, VIEWS).round().astype(int))
    return sum(
        (light_into(scene, float(cameras.times[t]), int(t), layer)[:, 0] for t in frames), np.zeros(len(scene.ids))
    )


def _group(
    place: np.ndarray, looks: np.ndarray, light: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """k-means of n rows: index (n,), light (k,), mean place (k,…) and looks (k,C) of at most `count` groups, none empty."""
    joint = np.concatenate([PLACED * place, SEEN * looks[:, :-3], looks[:, -3:] / COLOUR], 1, dtype=np.float32)
    centres = joint[np.random.default_rng(0).permutation(len(joint))[:count]]
    for _ in range(ROUNDS if len(joint) else 0):
        index = _nearest(joint, centres)
        centres = _means(index, np.ones(len(joint)), joint, len(centres)).astype(np.float32)
    index = np.unique(_nearest(joint, centres), return_inverse=True)[1] if len(joint) else np.zeros(0, int)
    groups = int(index.max(initial=-1)) + 1
    weight = np.bincount(index, light, groups)
    return index, weight, _means(index, light, place, groups), _means(index, light, looks, groups)


def _nearest(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """(n,) int: which of `centres (k,D)` is nearest to each of `points (n,D)`, block by block."""
    half = (centres**2).sum(1) / 2
    blocks = np.array_split(points, max(1, len(points) // 4096))
    return np.concatenate([(half - block @ centres.T).argmin(1) for block in blocks])


def _means(index: np.ndarray, weight: np.ndarray, values: np.ndarray, groups: int) -> np.ndarray:
    """(groups,C) float64 weighted means of `values (n,C)`; 0 for an empty group."""
    sums = np.stack([np.bincount(index, weight * column, groups) for column in values.T], 1)
    return sums / np.maximum(np.bincount(index, weight, groups), 1e-12)[:, None]


def _squares(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,m) squared distances of rows."""
    return np.maximum((one**2).sum(1)[:, None] + (other**2).sum(1) - 2 * one @ other.T, 0)


def _bonds(place: np.ndarray, looks: np.ndarray) -> tuple[np.ndarray, float]:
    """Bonds (P,P) between neighbours in `place (P,…)`, and the squared distance of looks that weakens one by 1/e."""
    far = _squares(place, place)
    np.fill_diagonal(far, np.inf)
    if len(far) < 2:
        return np.zeros(far.shape), 1.0
    last = min(NEIGHBOURS, len(far) - 1) - 1
    reach = np.partition(far, last, axis=1)[:, last]
    near = far <= np.maximum(reach[:, None], reach)
    unlike = _squares(looks, looks)
    unit = max(float(np.median(unlike[near])), 1e-9)
    return np.where(near, np.exp(-np.where(near, far, 0) / max(np.median(reach), 1e-12) - unlike / unit), 0), unit


def _sweep(bonds: np.ndarray, degree: np.ndarray, walked: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(P,) bool: of the sets of pieces that were `walked (P,)` on most, the one with the least share of its bonds cut."""
    order = np.argsort(-walked, kind="stable")
    inner = np.tril(bonds[order][:, order], -1).sum(1)  # bonds to pieces before it in the order
    cut = np.cumsum(degree[order] - 2 * inner) / np.cumsum(degree[order])
    cut[np.cumsum(weight[order]) < SMALLEST * weight.sum()] = np.inf
    chosen = np.zeros(len(order), bool)
    chosen[order[: int(np.argmin(cut)) + 1]] = True
    return chosen
