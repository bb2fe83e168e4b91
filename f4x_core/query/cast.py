"""What things cast on the background: shadows, reflections, ripples. Needs numpy alone.

No teacher of words knows them; the graph of a scene tells them by how little they differ from what is behind (`standing_out`).
"""

from __future__ import annotations

import numpy as np

from ..language.cast_words import is_cast
from ..scene import Scene
from .attached import attached, mostly
from .floaters import is_floaters
from .objects import graph_of
from .people import is_of_people


def needs_no_teacher(scene: Scene, label: str) -> bool:
    """True if the scene itself tells what `label` means, and no vocabulary has to know it: what is cast, floaters, known people."""
    return is_cast(label) or is_floaters(label) or is_of_people(scene, label)


def cast_of(scene: Scene, by: np.ndarray | None = None) -> np.ndarray:
    """(N,) float64: 1 for the Gaussians of what is cast, by those `by (N,)` bool alone if given; by all if none of them moves."""
    superpoints = graph_of(scene).moving
    cast = superpoints.cast
    if by is not None and (thing := mostly(superpoints, by) & ~cast).any():
        cast = cast & attached(scene, superpoints, thing)
    return superpoints.spread(cast.astype(float), len(scene.ids))


def moving_things(scene: Scene) -> np.ndarray:
    """(N,) bool: what moves without what is cast."""
    return scene.moving & (cast_of(scene) == 0)
