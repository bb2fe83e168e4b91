"""The shadow and the loose edges of a thing: what an editor expects to go with it. Needs numpy alone.

A selection of a thing leaves out its shadow, its reflection and the ripples it makes, and Gaussians at its outline that look like
the background. All of these are small beside the thing and near it. With several moving things each keeps its own: a random walk
on the graph of neighbours starts at what is left over, and the thing that it reaches first is the owner (Grady 2006).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..scene import Scene
from .objects import MOSTLY, Superpoints, graph_of

TIMES = 5
"""Times, evenly over the clip, at which a shadow that touches nothing is compared with the places of things."""
NO_BOND = 1e-9
"""Sum of bonds to things below which a superpoint has none."""


class Attached(NamedTuple):
    """Gaussians that belong to a chosen thing besides its own, of a scene's N."""

    shadow: np.ndarray
    """(N,) bool: its shadow, reflection or ripples."""
    edges: np.ndarray
    """(N,) bool: loose edges of it."""


def attached_to(scene: Scene, chosen: np.ndarray) -> Attached:
    """Return the moving Gaussians that belong to `chosen (N,)` bool and are none of them."""
    left = scene.moving & ~chosen
    none = np.zeros(len(chosen), bool)
    if not left.any() or not chosen[scene.moving].any():
        return Attached(none, none)
    superpoints = graph_of(scene).moving
    thing = mostly(superpoints, chosen)
    if not (thing & ~superpoints.cast).any():  # a shadow alone
        return Attached(none, none)
    cast, others = (
        left & (superpoints.spread(each.astype(float), len(chosen)) > 0)
        for each in (superpoints.cast, thing | attached(scene, superpoints, thing))
    )
    own = (
        superpoints.with_edges(thing, np.zeros(len(thing), bool), len(chosen)) > 0
    )  # sills and wheels above a car's shadow
    shadow = others & cast & ~own
    return Attached(shadow, others & ~shadow)


def mostly(superpoints: Superpoints, chosen: np.ndarray) -> np.ndarray:
    """Return the superpoints (P,) bool of which more than half of the Gaussians are `chosen (N,)` bool."""
    return superpoints.means(chosen.astype(float), np.ones(len(chosen))) > MOSTLY


def attached(scene: Scene, superpoints: Superpoints, thing: np.ndarray) -> np.ndarray:
    """Return the superpoints (P,) bool outside `thing (P,)` bool that are its shadow or loose edges of it."""
    loose, others = superpoints.left_over(thing)
    rows = np.flatnonzero(loose)
    found = np.zeros(len(thing), bool)
    if not others.any():
        return loose
    near = superpoints.near[rows]
    to_thing, to_others, between = near[:, thing].sum(1), near[:, others].sum(1), near[:, rows]
    total = np.diag(to_thing + to_others + between.sum(1) + NO_BOND) - between
    reached, either = np.linalg.solve(total, np.stack([to_thing, to_thing + to_others], 1)).T
    mine = reached > MOSTLY * either
    alone = either < MOSTLY  # the walk hardly leaves it: it touches neither
    if alone.any():
        mine[alone] = _nearer(scene, superpoints, rows[alone], thing, others)
    found[rows[mine]] = True
    return found


def _nearer(
    scene: Scene, superpoints: Superpoints, asked: np.ndarray, thing: np.ndarray, others: np.ndarray
) -> np.ndarray:
    """Return (k,) bool: superpoints `asked (k,)` that are, over time, nearer to `thing (P,)` bool than to `others (P,)` bool."""
    apart = np.zeros((2, len(asked)))
    for time in scene.cameras.times[evenly_spaced(len(scene.cameras), TIMES)]:
        means = scene.posed(float(time)).means
        places = np.stack([superpoints.means(axis, np.ones(len(means))) for axis in means.T], 1)
        for far, group in zip(apart, (thing, others), strict=True):
            far += np.linalg.norm(places[asked][:, None] - places[group], axis=-1).min(1)
    return apart[0] < apart[1]
