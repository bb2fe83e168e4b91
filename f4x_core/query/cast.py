"""Words for what things cast on the background: shadows, reflections, ripples. Needs numpy alone.

No teacher of words knows them; the graph of a scene tells them by how little they differ from what is behind (`standing_out`).
"""

from __future__ import annotations

import re

import numpy as np

from ..scene import Scene
from .floaters import is_floaters
from .objects import graph_of
from .people import is_of_people

_WORDS = re.compile(
    r"(?:(?:the|its|his|her|their) )?(?:(?P<whose>.+)'s? )?(?:shadow|reflection|ripple)s?", re.IGNORECASE
)


def is_cast(label: str) -> bool:
    """Whether `label` names what is cast: "shadow", "the dog's shadow", "reflections"."""
    return _WORDS.fullmatch(" ".join(label.split())) is not None


def needs_no_teacher(scene: Scene, label: str) -> bool:
    """True if the scene itself tells what `label` means, and no vocabulary has to know it: what is cast, floaters, known people."""
    return is_cast(label) or is_floaters(label) or is_of_people(scene, label)


def caster(label: str) -> str | None:
    """Who casts what `label` names: "dog" of "the dog's shadow"; None where the word says it of nobody."""
    found = _WORDS.fullmatch(" ".join(label.split()))
    return found and found["whose"]


def cast_of(scene: Scene, by: np.ndarray | None = None) -> np.ndarray:
    """(N,) float64: 1 for the Gaussians of what is cast, by those `by (N,)` bool alone if given: what moves as one with them."""
    superpoints = graph_of(scene).moving
    cast = superpoints.cast.copy()
    if by is not None and superpoints.piece is not None:
        casting = superpoints.gather(by.astype(float)) * ~superpoints.cast
        cast &= np.isin(superpoints.piece, superpoints.piece[casting > 0])
    return superpoints.spread(cast.astype(float), len(scene.ids))


def moving_things(scene: Scene) -> np.ndarray:
    """(N,) bool: what moves without what is cast."""
    return scene.moving & (cast_of(scene) == 0)
