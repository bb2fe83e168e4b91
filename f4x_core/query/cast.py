"""Shadows, reflections and ripples that things cast on the background. Needs numpy alone.

No teacher of words knows them; the graph of a scene tells them by how little they differ from what is behind (`standing_out`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from ..language.cast_words import is_cast
from ..scene import Scene
from .attached import attached, mostly
from .floaters import floater_scores, is_floaters
from .ground import GROUND, ground_scores, is_of_ground
from .objects import MOSTLY, graph_of
from .people import is_of_people
from .select_config import SELECT, SelectConfig
from .sky import SKY, is_of_sky, sky_scores

SHAPED: tuple[tuple[Callable[[Scene, str], bool], Callable[[Scene], np.ndarray]], ...] = (
    (lambda _, label: is_floaters(label), floater_scores),
    (is_of_ground, ground_scores),
    (is_of_sky, sky_scores),
)
"""(if a label means it in a scene, (N,) scores of it): what shape, place or color tell."""


def shaped_scores(scene: Scene, label: str) -> Callable[[Scene], np.ndarray] | None:
    """Return the function of a scene for the scores (N,) of what `label` means by its shape; None for other labels."""
    return next((scores for means, scores in SHAPED if means(scene, label)), None)


Source = Literal["cast", "people", "shape", "teacher"]
"""Source of the Gaussians of a label: what is cast, the people of the scene, `SHAPED`, or the teacher of its vocabulary."""


def source_of(scene: Scene, label: str) -> Source:
    """Return what knows the Gaussians that `label` means."""
    if is_cast(label):
        return "cast"
    if is_of_people(scene, label):
        return "people"
    return "teacher" if shaped_scores(scene, label) is None else "shape"


def needs_no_teacher(scene: Scene, label: str) -> bool:
    """Return True if the scene itself knows what `label` means, and no vocabulary has to."""
    return source_of(scene, label) != "teacher"


SURFACES = (GROUND, SKY)
"""Words for surfaces that a scene itself tells."""
SOMEBODY = ("man", "woman", "boy", "girl", "child", "guy", "dancer")
"""Words for the people whom a fit found."""


def untaught_words(scene: Scene, words: Sequence[str] = SURFACES + SOMEBODY) -> list[str]:
    """Return those of some words that need no teacher."""
    return [word for word in words if needs_no_teacher(scene, word)]


def with_untaught(scene: Scene, labels: Sequence[str], words: Sequence[str] = SURFACES + SOMEBODY) -> list[str]:
    """Return `labels` and the untaught ones of `words`; none of those without labels, as any word may be a name then."""
    return [*labels, *(untaught_words(scene, words) if labels else ())]


def cast_of(scene: Scene, by: np.ndarray | None = None, config: SelectConfig = SELECT) -> np.ndarray:
    """Return (N,) float64: 1 for the Gaussians of shadows and the like, with `by (N,)` bool of those that these cast.

    Gaussians of things are none of it, though they look much like the background: sills and wheels above a car's shadow.
    """
    superpoints = graph_of(scene, config).moving
    cast, count = superpoints.cast, len(scene.ids)
    thing = ~cast
    if by is not None and (own := mostly(superpoints, by) & ~cast).any():
        cast, thing = cast & attached(scene, superpoints, own), own
    own = superpoints.with_edges(thing, np.zeros(len(cast), bool), count) > 0
    if by is not None and superpoints.unlike is not None:
        own[superpoints.rows] |= by[superpoints.rows] & (superpoints.unlike >= config.thing.alike_behind)
    return superpoints.spread(cast.astype(float), count) * ~own


def without_shadow(scene: Scene, scores: np.ndarray, config: SelectConfig = SELECT) -> np.ndarray:
    """Return `scores (N,)` of a thing, 0 for what is cast on the background and looks like it; unless most of the thing is cast."""
    if not scores[scene.moving].any():
        return scores
    superpoints = graph_of(scene, config).moving
    held = superpoints.gather(scores)
    if superpoints.unlike is None or held[superpoints.cast].sum() > MOSTLY * held.sum():
        return scores
    alike = superpoints.cast[superpoints.index] & (superpoints.unlike < config.thing.alike_behind)
    scores = scores.copy()
    scores[superpoints.rows[alike]] = 0
    return scores


def moving_things(scene: Scene) -> np.ndarray:
    """Return the moving Gaussians (N,) bool that are not cast."""
    return scene.moving & (cast_of(scene) == 0)
