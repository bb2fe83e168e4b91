"""An edited scene for a viewer that poses the base scene by itself: what it has to draw differently, and at which frames.

A viewer such as Blender poses the base's Gaussians and keeps their appearance as attributes. An edit of appearance only
replaces attributes. Gaussians that an edit moves, retimes or copies are drawn separately, at the positions given here.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from ..geometry import quaternion, spherical_harmonics
from ..query.pixels import heat_map
from ..query.selection import Selection
from ..scene import PosedSplats, Scene
from ..scene.tints import gain_of
from .apply import EVERY, EditedScene
from .state import Appearance

GREY = 0.5
"""Grey level under a heat map, in place of the image, so that scores are easy to read."""


class Display:
    """Geometry and appearance of a scene to draw, edited or not. N Gaussians in the order of `posed`."""

    def __init__(self, scene: Scene):
        self.scene = scene
        self._steps = scene.steps if isinstance(scene, EditedScene) else ()

    @cached_property
    def apart(self) -> np.ndarray:
        """(n,) int rows that are drawn separately, copies included, in increasing order."""
        apart = np.zeros(len(self.scene.ids), bool)
        for step in self._steps:
            if step.reads or step.edit.operation.PLACES:
                apart[: len(step.chosen)] |= step.chosen
        apart[len(self.scene.static) + len(self.scene.dynamic) :] = True
        return np.flatnonzero(apart & self.there)

    @cached_property
    def there(self) -> np.ndarray:
        """(N,) bool: not deleted at all times."""
        if isinstance(self.scene, EditedScene):
            return ~self.scene.rows.gone
        return np.ones(len(self.scene.ids), bool)

    @cached_property
    def appearance_changes(self) -> bool:
        """True if an edit of the appearance is limited to a time span."""
        return any(step.edit.operation.LOOKS and step.edit.operation.span is not None for step in self._steps)

    @cached_property
    def changes(self) -> bool:
        """True if edits change opacity, colours or motion over time: a frame then differs in more than the motion of the base."""
        if self.appearance_changes or not len(self.apart):
            return self.appearance_changes
        other_tints = self.scene.tints is not None and any(step.retimes for step in self._steps)
        return bool(self.scene.fades or other_tints or self.scene.moving[self.apart].any())

    @cached_property
    def rest_rotation(self) -> np.ndarray:
        """(M,4) unit wxyz of the base's M Gaussians, static first, as the file has them: before any motion."""
        return quaternion.normalize(np.concatenate([self.scene.static.quats, self.scene.dynamic.quats]))

    def appearance_key(self, frame: float) -> object:
        """Return a key of the appearance at `frame`, equal where all Gaussians but the separately drawn ones look the same."""
        time, timed = self.time(frame), []
        for depth, step in enumerate(self._steps):
            operation = step.edit.operation
            if operation.LOOKS and operation.span is not None:
                if any(other.reads for other in self._steps[:depth]):
                    return time  # its tones may be those of Gaussians at other moments
                timed.append(operation.fraction(time, float(self.scene.cameras.times[-1])))
        return tuple(timed)

    def rows_of(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the row (m,) of each of `ids (m,)` and (m,) bool, True where there is one; fast for whole parts in order."""
        known = self.scene.ids
        for part in (*self._parts, self.apart):
            if len(part) == len(ids) and np.array_equal(known[part], ids):
                return part, np.ones(len(ids), bool)
        row = self._order[np.minimum(np.searchsorted(known, ids, sorter=self._order), len(known) - 1)]
        return row, known[row] == ids

    @cached_property
    def _parts(self) -> tuple[np.ndarray, np.ndarray]:
        static, total = len(self.scene.static), len(self.scene.static) + len(self.scene.dynamic)
        return np.arange(static), np.arange(static, total)

    @cached_property
    def _order(self) -> np.ndarray:
        return np.argsort(self.scene.ids, kind="stable")

    def time(self, frame: float) -> float:
        """Clip time that a viewer shows at `frame`, clamped to the clip."""
        first, last = self.scene.cameras.times[[0, -1]]
        return float(min(max(frame, first), last))

    def appearance(self, frame: float) -> Appearance:
        """Return opacities (N,) and harmonics (N,S,3) of all Gaussians, as if all were present, in their own frames."""
        if isinstance(self.scene, EditedScene):
            return self.scene.appearance(self.time(frame), EVERY)
        return Appearance(*self.scene.full_appearance)

    def tint_gain(self, appearance: Appearance) -> np.ndarray:
        """Return the factors (N,3) of the base's tints for Gaussians that have `appearance`."""
        return gain_of(self.scene.base.full_appearance[1][self.scene.origin], appearance.sh)

    def of_base(self, found: Selection) -> Selection:
        """Return a selection of the base scene in the order of `posed`; a copy is selected where its original is."""
        origin = self.scene.origin
        return replace(found, ids=self.scene.ids, scores=found.scores[origin], wins=found.wins[origin])

    def means_of(self, id: int, frame: float) -> np.ndarray:
        """Return the centers (n,3) at `frame` of the thing that the edit `id` changes; none where it has no effect."""
        step = next((step for step in self._steps if step.edit.id == id), None)
        if step is None:
            return np.zeros((0, 3), np.float32)
        assert isinstance(self.scene, EditedScene)
        return self.scene.part(self.time(frame), np.flatnonzero(step.thing)).means

    def moment(self, frame: float) -> PosedSplats:
        """Return the separately drawn Gaussians at `frame`."""
        assert isinstance(self.scene, EditedScene)
        return self.scene.part(self.time(frame), self.apart)


def by_score(appearance: Appearance, scores: np.ndarray) -> Appearance:
    """Return the same Gaussians in the colors of a heat map of `scores (N,)` in [0, 1]."""
    grey = np.full((1, len(scores), 3), GREY)
    rgb = heat_map(grey, scores[None])[0] / 255
    sh = np.zeros_like(appearance.sh)
    sh[:, 0] = spherical_harmonics.dc_from_rgb(rgb)
    return appearance._replace(sh=sh)
