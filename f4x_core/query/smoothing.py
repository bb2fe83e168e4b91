"""Neighbourhoods: Gaussians that lie and look alike are grouped, and groups vote. Needs numpy alone.

Text features are coarse (a feature-map pixel sees its surroundings); `visual` features and positions show where an object
ends. Text scores are therefore smoothed along those: a random walker with priors (Grady 2005) on a graph of patches.
A few thousand patches carry a scene of any size, and heads decode their mean latents, which is what heads were trained on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ..features.text import unit
from ..scene import Scene
from ..scene.field import FeatureField, FieldHead
from .blend_weights import total_blend_weights
from .kept import Kept

LOOKS_ALIKE = "visual"
"""The head whose features say what looks alike: they carry masks through the clip, and words to neighbours (a scene without
it compares latents there)."""
CELL = 1 / 40
"""Width of a patch, in widths of the picture: about a cell of the finest offline teacher."""
LAYER = 0.15
"""Depth of a patch, in natural logarithms of the distance from the camera."""
KINDS = 4
"""Of Gaussians that share no patch: moving or not, in front of the camera or behind."""
REACH = 2
"""Patches are bound to others up to so many cells away across the picture, and one in depth."""
NEAR = 0.05
"""Distance, in widths of the picture, at which a bond is weaker by 1/e."""
FAR = 0.3
"""Width of the picture that a step of 1 in the logarithm of the distance is worth."""
ALIKE = 0.1
"""Difference of cosines at which a bond is weaker by 1/e."""
TRUST = 0.04
"""Weight of a patch's own value against one bond of full strength."""
MAX_WEIGHT_QUANTILE = 0.95
"""Quantile of the weights of patches above which they are clipped."""
VIEWS, COLUMNS = 3, 120
"""Views, evenly over the clip, in which blend weights are summed, and their width in pixels."""
UNSEEN = 1e-3
"""Minimum blend weight of a Gaussian, in pixels of such a view."""
STEPS, TOLERANCE = 200, 1e-4
"""Bounds of the conjugate gradients: steps, and the residual relative to the start."""


def field_of_looks(scene: Scene) -> FeatureField | None:
    """Return the scene's feature field, if it has the head for what looks alike."""
    field = scene.features
    return field if field is not None and LOOKS_ALIKE in field.names else None


@dataclass(frozen=True, eq=False)
class Patches:
    """Groups of neighbouring Gaussians of a scene and the bonds between them; P patches, E directed bonds."""

    index: np.ndarray
    """(N,) int64: the patch of each Gaussian, static first."""
    weight: np.ndarray
    """(P,) float64: blend weights of a patch, summed over views of the clip; mean 1."""
    latents: np.ndarray
    """(P,D) float32: mean latents."""
    first: np.ndarray
    """(P,) int64: where each patch's bonds begin."""
    other: np.ndarray
    """(E,) int64: the patch at the other end; every bond is there from both ends."""
    bond: np.ndarray
    """(E,) float32 in [0, 1]."""
    _decoded: dict[FieldHead, np.ndarray] = field(default_factory=dict)

    def features(self, head: FieldHead) -> np.ndarray:
        """Return (P,C) float32, read-only: what `head` sees in each patch. Decoded once, which is most of the cost of a word."""
        if head not in self._decoded:
            self._decoded[head] = head(self.latents)
            self._decoded[head].setflags(write=False)
        return self._decoded[head]

    def smooth(self, values: np.ndarray, trust: float = TRUST) -> np.ndarray:
        """Return `argmin_x sum trust weight_i (x_i - values_i)^2 + sum bond_ij (x_i - x_j)^2` of `values (P,)`, float64.

        Solved by conjugate gradients with the diagonal as preconditioner.
        """
        own = trust * np.minimum(self.weight, np.quantile(self.weight, MAX_WEIGHT_QUANTILE))
        own += 1e-6 * own.mean()  # a patch without weight and bonds keeps its value
        diagonal = own + np.add.reduceat(self.bond, self.first)
        return solve(
            lambda x: self._apply(x, diagonal), diagonal, own * values, np.array(values, np.float64), STEPS, TOLERANCE
        )

    def _apply(self, x: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
        return diagonal * x - np.add.reduceat(self.bond * x[self.other], self.first)


def solve(
    apply: Callable[[np.ndarray], np.ndarray],
    diagonal: np.ndarray,
    right: np.ndarray,
    x: np.ndarray,
    steps: int,
    tolerance: float,
) -> np.ndarray:
    """Solve `apply(x) = right (n,)` from the guess `x (n,)` by conjugate gradients; returns (n,) float64.

    `apply`: a symmetric, positive definite matrix times a vector; `diagonal (n,)` its preconditioner. It ends after so many
    steps, or when the greatest residual is below `tolerance` times the first one.
    """
    residual = right - apply(x)
    start = np.abs(residual).max()
    scaled = residual / diagonal
    direction, power = scaled, residual @ scaled
    for _ in range(steps):
        if np.abs(residual).max() <= tolerance * start:
            break
        image = apply(direction)
        step = power / (direction @ image)
        x = x + step * direction
        residual = residual - step * image
        scaled = residual / diagonal
        before, power = power, residual @ scaled
        direction = scaled + power / before * direction
    return x


_GROUPS: Kept[Patches] = Kept()


def group_of(scene: Scene) -> Patches:
    """Return `group`, cached as long as the scene's features live: all words are scored on the same patches.

    An edited scene has those of its base, a copy that of its original: edits do not change what a thing is.
    """
    base, field = scene.base, scene.require_field()
    patches = _GROUPS.get(field, base.static, base.dynamic, make=lambda: group(base))
    return patches if base is scene else replace(patches, index=patches.index[scene.origin])


def group(scene: Scene) -> Patches:
    """Return the patches of a scene, as seen from the middle of the clip; moving and static Gaussians are never mixed.

    Raises F4xError: a scene without a feature field.
    """
    field = scene.require_field()
    cameras = scene.cameras
    middle = len(cameras) // 2
    posed = scene.posed(float(cameras.times[middle]))
    camera = cameras[middle]
    x = posed.means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    distance = np.maximum(np.linalg.norm(x, axis=1), 1e-9)
    # Directions, not pixels: what lies beside and behind the camera has a place too.
    place = np.concatenate(
        [x / distance[:, None] * camera.intrinsics[0, 0] / camera.width, np.log(distance)[:, None]], 1
    )
    weight = total_blend_weights(scene, VIEWS, COLUMNS) + UNSEEN
    cell = np.floor(place[:, [0, 1, 3]] / (CELL, CELL, LAYER)).astype(np.int64)
    cell -= cell.min(0) - REACH  # room for neighbours before each row, and so behind the row before it
    size = cell.max(0) + 1
    kind = 2 * posed.dynamic + (place[:, 2] < 0)
    key = np.ravel_multi_index((*cell.T, kind), (*size, KINDS))
    keys, index = np.unique(key, return_inverse=True)
    total = np.bincount(index, weight)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(index, weight * column) for column in values.T], 1) / total[:, None]

    latents = mean(scene.latents()).astype(np.float32)
    features = field.decode(LOOKS_ALIKE, latents) if LOOKS_ALIKE in field.names else latents - latents.mean(0)
    features = unit(features)
    place = mean(place * (1, 1, 1, FAR))
    one, two = _neighbours(keys, size)
    steps = ((place[one] - place[two]) ** 2).sum(1) / NEAR**2
    steps += (1 - np.einsum("ec,ec->e", features[one], features[two])) / ALIKE
    # From both ends, and one with itself: it pulls nowhere, but then every patch has a bond.
    itself = np.arange(len(keys))
    ends, others = np.concatenate([one, two, itself]), np.concatenate([two, one, itself])
    order = np.argsort(ends, kind="stable")
    bond = np.concatenate([np.exp(-steps), np.exp(-steps), np.ones(len(keys))]).astype(np.float32)[order]
    first = np.searchsorted(ends[order], itself)
    return Patches(index, total / total.mean(), latents, first, others[order], bond)


def _neighbours(keys: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return indices (E,), (E,) of pairs of `keys` (sorted; of column, row, layer, kind) in adjacent cells, each once."""
    rows, layers = int(size[1]), int(size[2])
    cells = keys // KINDS
    around = range(-REACH, REACH + 1)
    pairs = []
    for shift in (
        (across * rows + down) * layers + behind for across in around for down in around for behind in (-1, 0, 1)
    ):
        if shift < 0:
            continue  # the other end finds that pair
        for kind in range(KINDS):
            wanted = KINDS * (cells + shift) + kind
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            found = np.flatnonzero((keys[place] == wanted) & (place > np.arange(len(keys))))
            pairs.append((found, place[found]))
    one, two = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return one, two
