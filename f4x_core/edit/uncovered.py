"""Places that an edit uncovers and no frame of the clip saw: made-up background, or nothing at all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..scene import MADE_UP, Scene
from ..scene.view import render
from .apply import edited
from .change import Change
from .operations import kinds
from .stack import of

VIEWS, COLUMNS = 8, 240
"""Frames, evenly over the clip, that are looked at, and the width of their pictures. Of 110,000 Gaussians that takes .1 s, and as
long again where something is empty. In three clips half or double the width counts each frame within .1 %, all frames have the
same maximum, and their mean is at most .06 % less."""
SHOWS = 0.5
"""Least part of a pixel that shows it."""
LEAST = 0.002
"""Fraction of a picture from which on it is told: 250 pixels of 480 x 270."""
_KNOWN: WeakKeyDictionary[Scene, Uncovered] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Uncovered:
    """Fraction of the clip's pictures that no frame of the clip saw."""

    frames: np.ndarray
    """(V,) clip frames that were looked at."""
    made_up: np.ndarray
    """(V,) fraction of each picture that shows what the fit made up."""
    nothing: np.ndarray
    """(V,) fraction of each picture where nothing is any more."""

    def __str__(self) -> str:
        """Return a sentence for each kind of uncovered surface that there is."""
        made_up = self._sentence(
            self.made_up, "shows background that no frame saw: it is made up from what is around it"
        )
        nothing = self._sentence(self.nothing, "is empty: there is nothing behind what was taken away")
        return " ".join(filter(None, [made_up, nothing]))

    def to_json(self) -> dict[str, Any]:
        """Return the fractions by frame."""
        return {name: getattr(self, name).tolist() for name in ("frames", "made_up", "nothing")}

    def _sentence(self, parts: np.ndarray, what: str) -> str:
        most = int(parts.argmax())
        if parts[most] < LEAST:
            return ""
        return (
            f"Up to {parts[most]:.1%} of a picture (frame {self.frames[most]}; {parts.mean():.1%} on average) {what}."
        )


def takes_away(operations: Iterable[Change]) -> bool:
    """Return True if any of the operations can bring to light what is behind."""
    return any(one.UNCOVERS for one in operations)


def summary_of(shows: Uncovered | None) -> str:
    """Return the sentences of `shows`, and the command that draws where it is; empty where nothing is uncovered."""
    return f"{shows} `f4x render SCENE -o DIR --channels unseen` draws where." if shows and str(shows) else ""


def uncovered(scene: Scene) -> Uncovered | None:
    """Return the surfaces that the edits of `scene`, in effect or baked in, uncover; None where none removes anything.

    None, too, for splats of another program. Made up is what the scene file marks so (`MADE_UP`); older files have no such mark.
    Cached for the lifetime of the edited scene.
    """
    folded = {entry.get("op") for entry in scene.provenance.get("baked", ())}
    in_effect = takes_away(edit.operation for edit in of(scene).edits if edit.enabled)
    if scene.is_foreign or (not in_effect and folded.isdisjoint(kind.TAG for kind in kinds() if kind.UNCOVERS)):
        return None
    scene = edited(scene)
    if scene not in _KNOWN:
        frames = evenly_spaced(len(scene.cameras), VIEWS)
        made_up, nothing = _parts(scene, frames)
        if nothing.max() >= LEAST:  # which a splat file has around it, or a sky
            nothing = np.maximum(nothing - _parts(scene.base, frames)[1], 0)
        _KNOWN[scene] = Uncovered(frames, made_up, nothing)
    return _KNOWN[scene]


def _parts(scene: Scene, frames: np.ndarray) -> np.ndarray:
    """Return the fractions (2,V) of the pictures that show what is made up, and nothing."""
    base = scene.base
    mark = np.zeros(len(base.ids), np.float32)
    mark[: len(base.static)] = base.extra.get(MADE_UP, False)
    mark = mark[scene.origin, None]
    found = []
    for frame in map(int, frames):
        camera, time = scene.cameras[frame].of_width(COLUMNS), float(scene.cameras.times[frame])
        drawn = render(scene, camera, time, ("alpha",), values={"made_up": mark})
        found.append([(drawn["made_up"] > SHOWS).mean(), (drawn["alpha"] < SHOWS).mean()])
    return np.array(found).T
