"""An edited scene for a viewer that plays the base scene by itself: what it has to draw otherwise, and when.

A viewer such as Blender poses the base's Gaussians on its own and keeps their looks as attributes. New looks only replace
attributes; Gaussians that an edit puts elsewhere, shows at another moment or copies are drawn apart, from their places here.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..geometry import spherical_harmonics
from ..query.pixels import heat_map
from ..scene import Posed, Scene
from .apply import EVERY, LOOKS_OF, Appearance, EditedScene
from .operations import Transform

FAINTEST = 1 / 255
"""Opacity below which a Gaussian is drawn by no renderer."""
GREY = 0.5
"""What stands for the picture under a heat map: scores are to be read, not textures."""


class Display:
    """What there is to draw of a scene, edited or not. N Gaussians in the order of `posed`."""

    def __init__(self, scene: Scene):
        self.scene = scene
        self._steps = scene.steps if isinstance(scene, EditedScene) else ()

    @cached_property
    def apart(self) -> np.ndarray:
        """(n,) int rows that are drawn apart, copies included, in increasing order."""
        apart = np.zeros(len(self.scene.ids), bool)
        for step in self._steps:
            if step.reads or isinstance(step.edit.operation, Transform):
                apart[: len(step.chosen)] |= step.chosen
        base = len(self.scene.static) + len(self.scene.dynamic)
        apart[base:] = True
        if self._steps:
            apart[:base] &= ~self.scene.rows.gone[:base]  # type: ignore[attr-defined]  # it has steps, so it is edited
        return np.flatnonzero(apart)

    @cached_property
    def looks_change(self) -> bool:
        """Whether looks depend on time."""
        timed = (s for s in self._steps if isinstance(s.edit.operation, LOOKS_OF))
        return any(step.edit.operation.frames is not None for step in timed)  # type: ignore[union-attr]

    @cached_property
    def changes(self) -> bool:
        """Whether another frame shows anything that the base's own motion does not."""
        return self.looks_change or bool(self.scene.moving[self.apart].any())

    def time(self, frame: float) -> float:
        """The moment of the clip that a viewer shows at `frame`: before and after the clip it stands still."""
        first, last = self.scene.cameras.times[[0, -1]]
        return float(min(max(frame, first), last))

    def looks(self, frame: float) -> Appearance:
        """Of all Gaussians: opacities (N,), harmonics (N,S,3) in their own frames."""
        if isinstance(self.scene, EditedScene):
            return self.scene.looks(self.time(frame), EVERY)
        posed = self.scene.posed(self.time(frame))
        return Appearance(posed.opacities, posed.sh)

    def moment(self, frame: float) -> Posed:
        """The Gaussians that are drawn apart."""
        assert isinstance(self.scene, EditedScene)
        return self.scene.part(self.time(frame), self.apart)


def by_score(looks: Appearance, scores: np.ndarray) -> Appearance:
    """The same Gaussians in the colours of a heat map of `scores (N,)` in [0, 1]."""
    grey = np.full((1, len(scores), 3), GREY)
    rgb = heat_map(grey, scores[None])[0] / 255
    sh = np.zeros_like(looks.sh)
    sh[:, 0] = spherical_harmonics.dc_from_rgb(rgb)
    return looks._replace(sh=sh)
