"""Floaters: Gaussians that nothing holds up, specks in the air and faint haze that training left behind. Needs numpy alone.

A surface is made of Gaussians that overlap, so each of its Gaussians has others within its own reach. A floater is alone there, or
much larger and fainter than all that is around it. Sizes and distances are compared in octaves, so that neither the unit of a
scene nor its depth matters.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from ..geometry import quaternion
from ..geometry.arrays import evenly_spaced
from ..geometry.splats import Splats
from ..scene import Scene

NEIGHBOURS = 12
"""Gaussians before and after one on a space-filling curve that are compared with it, on each of two curves."""
REACH = 3.0
"""Standard deviations of either of two Gaussians, along the line between them, at which they hold each other up by 1/e."""
TYPICAL = 1.5
"""Sum of the opacities of overlapping neighbours that half of the Gaussians have at least, or the reach is widened."""
WIDENINGS = (1.0, 1.6, 2.5, 4.0)
"""Factors of the reach, for scenes whose Gaussians are small for their distances; the last is not exceeded."""
FLATTEST = 0.3
"""Least axis of a Gaussian by its longest that is reckoned with: fits leave surfels thinner than the noise of their places."""
ENOUGH = 0.65
"""Sum of the opacities of the neighbours that overlap it at which a Gaussian counts as held up by half."""
LARGE = 1.0
"""Octaves by which a Gaussian is longer than its neighbours where it counts as too large by half."""
FAINT = 0.15
"""Opacity at which a Gaussian counts as faint by half."""
FEW = 0.1
"""Fraction of the clip's frames that see a place at which it counts as seen by few by half."""
FEW_COUNTS = 0.25
"""Score of a Gaussian that is seen by few and is otherwise sound: below the threshold, for a clip ends somewhere."""
SHARPNESS = 3.0
"""Exponent of the scores: how fast they pass from 0 to 1 about their middle."""
ROUNDS = 4
"""Times that support is reckoned with what the supporting Gaussians are themselves supported by."""
MOMENTS = 5
"""Clip times, evenly spaced, at which a scene that moves is judged."""
FRAMES = 24
"""Clip frames, evenly spaced, that are checked for what sees a place."""
BITS = 20
"""Cells along an axis of a curve, as a power of 2."""
BULK = (0.5, 99.5)
"""Percentiles of the positions that a curve spans; what is beyond shares its outermost cells."""
WORDS = re.compile(
    r"(?:the |all )*(?:floaters?|floating (?:bits|specks|splats|gaussians)|stray (?:splats|gaussians))", re.I
)

_SCORES: WeakKeyDictionary[Scene, np.ndarray] = WeakKeyDictionary()


def is_floaters(label: str) -> bool:
    """Return True if `label` names floaters, which the shape of a scene shows and no vocabulary."""
    return WORDS.fullmatch(" ".join(label.split())) is not None


def floater_scores(scene: Scene) -> np.ndarray:
    """Return the floater score (N,) float64 in [0, 1]; copies have that of their originals. Cached."""
    base = scene.base
    if base not in _SCORES:
        _SCORES[base] = _scores(base)
    return _SCORES[base][scene.origin]


def _scores(scene: Scene) -> np.ndarray:
    """Return the least score over the moments at which a Gaussian is present: one that is held up once is no floater."""
    moves = bool(len(scene.dynamic)) or scene.fades
    times = scene.cameras.times[evenly_spaced(len(scene.cameras), MOMENTS if moves else 1)]
    scores, present = np.ones(len(scene.ids)), np.zeros(len(scene.ids), bool)
    for time in times:
        splats = scene.posed(float(time))
        there = splats.opacities > 0
        held, longer = support(splats)
        doubt = np.maximum(1 - _half_at(held, ENOUGH, SHARPNESS), _haze(longer, splats.opacities))
        if len(scene.cameras) > 1:
            few = 1 - _half_at(_seen_fraction(scene, splats.means), FEW, SHARPNESS)
            doubt = 1 - (1 - doubt) * (1 - few * FEW_COUNTS)
        scores[there] = np.minimum(scores, doubt)[there]
        present |= there
    return np.where(present, scores, 0.0)


def _haze(longer: np.ndarray, opacities: np.ndarray) -> np.ndarray:
    """Return the score (N,) of faint Gaussians that are much longer than their neighbours."""
    large = 1 / (1 + np.exp2(-2 * (longer - LARGE)))
    return large * (1 - _half_at(opacities, FAINT, SHARPNESS))


def support(splats: Splats) -> tuple[np.ndarray, np.ndarray]:
    """Return the support (N,) of each Gaussian by its neighbours, and the octaves (N,) by which it is longer than they are.

    A Gaussian is held up by the opacities of the neighbours that overlap it, each as far as it is held up itself: few that
    hold each other up alone fall together. Neighbours are those nearby on either of two space-filling curves; the curve on
    which more hold it up counts.
    """
    held, longer = np.zeros(len(splats)), np.zeros(len(splats))
    if len(splats) < 2:
        return held, longer
    for widening in WIDENINGS:
        curves = [_Curve.through(splats, shift, widening * REACH) for shift in (0.0, 1 / 3)]
        if np.median(np.max([curve.sums(splats.opacities) for curve in curves], axis=0)) >= TYPICAL:
            break
    steady = np.ones(len(splats), np.float32)
    for _ in range(ROUNDS):
        held = np.max([curve.sums(splats.opacities * steady) for curve in curves], axis=0)
        steady = _half_at(held, ENOUGH, SHARPNESS).astype(np.float32)
    octave = np.log2(np.maximum(splats.scales.max(1), 1e-12))
    return held, octave - np.mean([curve.means(octave) for curve in curves], axis=0)


@dataclass(frozen=True, eq=False)
class _Curve:
    """Gaussians in the order of a space-filling curve, each compared with the next `NEIGHBOURS`."""

    order: np.ndarray
    """(N,) rows in the order of the curve."""
    overlaps: tuple[np.ndarray, ...]
    """For each distance along the curve from 1 on (N - distance,) float32: overlap of the two Gaussians, 0 to 1."""

    @classmethod
    def through(cls, splats: Splats, shift: float, reach: float) -> _Curve:
        """Return the curve through N >= 2 Gaussians, its cells shifted by a fraction of its length; `reach` as `REACH`."""
        order = np.argsort(_along_curve(splats.means, shift), kind="stable")
        means, scales = splats.means[order].astype(np.float32), splats.scales[order]
        scales = np.maximum(scales, np.maximum(FLATTEST * scales.max(1, keepdims=True), 1e-12))
        turn = quaternion.to_matrix(quaternion.normalize(splats.quats[order]))
        whiten = (np.swapaxes(turn, 1, 2) / (reach * scales[..., None])).astype(np.float32)
        overlaps = []
        for step in range(1, min(NEIGHBOURS, len(means) - 1) + 1):
            way = means[step:] - means[:-step]
            apart = np.minimum(_length_squared(whiten[:-step], way), _length_squared(whiten[step:], way))
            overlaps.append(np.exp(-apart))
        return cls(order, tuple(overlaps))

    def sums(self, weights: np.ndarray) -> np.ndarray:
        """Return the sum (N,) of the `weights (N,)` of the others, by their overlap."""
        along, found = weights[self.order], np.zeros(len(self.order))
        for step, overlap in enumerate(self.overlaps, 1):
            found[:-step] += overlap * along[step:]
            found[step:] += overlap * along[:-step]
        return self._by_row(found)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Return the mean (N,) of `values (N,)` over the neighbours, regardless of their overlap."""
        along, found, count = values[self.order], np.zeros(len(self.order)), np.zeros(len(self.order))
        for step in range(1, len(self.overlaps) + 1):
            for here, there in ((slice(None, -step), slice(step, None)), (slice(step, None), slice(None, -step))):
                found[here] += along[there]
                count[here] += 1
        return self._by_row(found / count)

    def _by_row(self, along: np.ndarray) -> np.ndarray:
        values = np.empty_like(along)
        values[self.order] = along
        return values


def _length_squared(whiten: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Return |whiten way|^2 for (N,3,3) and (N,3)."""
    turned = np.matmul(whiten, way[..., None])[..., 0]
    return np.einsum("ni,ni->n", turned, turned)


def _along_curve(points: np.ndarray, shift: float) -> np.ndarray:
    """Return the place (N,) uint64 of `points (N,3)` on a Z curve whose cells are shifted by a fraction of its length."""
    low, high = np.percentile(points, BULK, axis=0)
    size = 2 * max(float((high - low).max()), 1e-12)
    unit = np.clip((points - low) / size + 0.25 + shift / 2, 0, 1 - 2.0**-BITS)
    x, y, z = (_spread((column * 2**BITS).astype(np.uint64)) for column in unit.T)
    return x | y << np.uint64(1) | z << np.uint64(2)


def _spread(value: np.ndarray) -> np.ndarray:
    """Return `value` of BITS bits with two zeros between its bits."""
    for shift, mask in ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F),
                        (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249)):  # fmt: skip
        value = (value | value << np.uint64(shift)) & np.uint64(mask)
    return value


def _seen_fraction(scene: Scene, points: np.ndarray) -> np.ndarray:
    """Return the fraction (N,) of the clip's frames whose picture holds each of `points (N,3)`."""
    frames = evenly_spaced(len(scene.cameras), FRAMES)
    seen = np.zeros(len(points))
    for frame in frames:
        camera = scene.cameras[frame]
        pixels, depth = camera.project(points)
        seen += (depth > 0) & (pixels >= 0).all(1) & (pixels < (camera.width, camera.height)).all(1)
    return seen / len(frames)


def _half_at(value: np.ndarray, half: float, sharpness: float) -> np.ndarray:
    """Return a score in [0, 1] that grows with `value` and is 0.5 at `half`."""
    return 1 / (1 + (half / np.maximum(value, 1e-12)) ** sharpness)
