"""Colors that change in time: what is added to the color of each Gaussian at some moments, linear between them. No torch.

A scene keeps them in `Scene.extra`, where its clip asked for them:

* `tints/times` (K,) float64: clip times that increase.
* `static/tints` (Ns,K,3), `dynamic/tints` (Nd,K,3) int8: 255ths of display color.

`Scene.posed` adds them to the first coefficient of the harmonics. The color without them is the mean over the clip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import F4xError
from ..geometry import spherical_harmonics

if TYPE_CHECKING:
    from .model import Scene

TIMES, PARTS = "tints/times", ("static/tints", "dynamic/tints")
"""Members of `Scene.extra`."""
LEVELS = 255
"""Steps of a tint from black to white."""
LARGEST = 127
"""The largest tint, in steps."""
DARK = 0.05
"""Display color below which an edit's gain is taken as if the color were this: the gain of black is not known."""
MOST_GAIN = 2.0
"""Largest gain of a tint: what an edit makes many times as bright need not flicker as many times as much."""


@dataclass(frozen=True, eq=False)
class Tints:
    """Changes of the colors of N Gaussians over time, static ones first."""

    times: np.ndarray
    """(K,) float64 clip times that increase; K is at least 1."""
    parts: tuple[np.ndarray, ...]
    """(Ns,K,3) and (Nd,K,3) int8, in 255ths of display color; either may be left out where there are no such Gaussians."""

    def at(self, time: float) -> np.ndarray:
        """Return (N,3) float32 display color to be added at clip time `time`; before the first and after the last time as there."""
        place = float(np.interp(time, self.times, np.arange(len(self.times))))
        lower = int(place)
        upper, fraction = min(lower + 1, len(self.times) - 1), place - lower
        before, after = (1 - fraction) / LEVELS, fraction / LEVELS
        added = [
            part[:, lower] * np.float32(before) + (part[:, upper] * np.float32(after) if after else np.float32(0))
            for part in self.parts
        ]
        return np.concatenate(added)


def tints_in(extra: Mapping[str, np.ndarray], counts: Sequence[int]) -> Tints | None:
    """Return the tints among the arrays `extra` of a scene with `counts` static and dynamic Gaussians; None where there are none.

    Raises F4xError where they do not belong to such a scene.
    """
    if TIMES not in extra:
        return None
    times = extra[TIMES]
    if times.ndim != 1 or not len(times) or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
        raise F4xError(f"{TIMES} must hold times that increase")
    for name, count in zip(PARTS, counts, strict=True):
        part = extra.get(name)
        if count and (part is None or part.dtype != np.int8 or part.shape != (count, len(times), 3)):
            raise F4xError(f"{name} must be an array of int8 of the shape {(count, len(times), 3)}")
    return Tints(
        times.astype(np.float64),
        tuple(extra[name] for name, count in zip(PARTS, counts, strict=True) if count)
        or (np.zeros((0, len(times), 3), np.int8),),
    )


def with_tints(scene: Scene, times: np.ndarray, values: np.ndarray) -> Scene:
    """Return the unedited scene with tints `values (N,K,3)` int8 at clip times `times (K,)`, in the order of `posed`."""
    count = len(scene.static)
    arrays = {TIMES: np.asarray(times, np.float64), PARTS[0]: values[:count], PARTS[1]: values[count:]}
    if not len(scene.dynamic):
        del arrays[PARTS[1]]
    return replace(scene, extra={**scene.extra, **arrays})


def without_tints(scene: Any) -> Any:
    """Return the scene, with its edits, in its mean colors over time; other posable objects have no tints."""
    if getattr(scene, "tints", None) is None:
        return scene
    extra = {name: array for name, array in scene.extra.items() if name not in (TIMES, *PARTS)}
    return replace(scene, extra=extra)


def quantized(tint: np.ndarray) -> np.ndarray:
    """Return a tint (…,3) of display color as int8."""
    return np.clip(np.rint(tint * LEVELS), -LARGEST, LARGEST).astype(np.int8)


def tinted(sh: np.ndarray, tint: np.ndarray) -> np.ndarray:
    """Return harmonics (n,S,3) with `tint (n,3)` added to their color."""
    changed = sh.copy()
    changed[:, 0] += tint / np.float32(spherical_harmonics.C0)
    return changed


def gain_of(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return (n,3) how much larger a tint is on colors that an edit made of others: harmonics (n,S,3) `before` and `after` it."""
    old, new = (spherical_harmonics.rgb_from_dc(sh[:, 0]) for sh in (before, after))
    gain = np.clip(new / np.maximum(old, np.float32(DARK)), 0, MOST_GAIN)
    same = (before[:, 0] == after[:, 0]).all(1)
    return np.where(same[:, None], np.float32(1), gain).astype(np.float32)
