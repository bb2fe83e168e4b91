"""Movers that are apart for most of the time that both are there, whatever touches in between. Needs numpy alone.

Two people who cross hide and touch each other for a moment, and their superpoints are neighbours then. Before and after there is
room between them: at each time, superpoints are linked across gaps as small as those within a thing, and two that lie in
different clusters most of the time belong to different movers.
"""

from __future__ import annotations

import numpy as np

from .connected_objects import connect
from .select_config import MoverConfig

ROUNDS = 30
"""Rounds of assigning superpoints to the one of two movers that they are less apart from; a few mostly do."""
NEAREST = 2
"""Rank, from 0, of the neighbour that a superpoint's distances are measured by: where a thing has few, they lie farther apart."""
UNKNOWN = -1
"""Mover of a superpoint that nothing tells it of."""


def movers_of(
    places: np.ndarray, presence: np.ndarray, weight: np.ndarray, bonds: np.ndarray, config: MoverConfig
) -> np.ndarray:
    """Return (P,) int64: the mover of each superpoint, from 0; `UNKNOWN` for those that nothing tells of.

    Args:
        places: (P,T,3) at T times over the clip.
        presence: (P,T), above 0 where it is there.
        weight: (P,) of superpoints; 0 for those of no mover.
        bonds: (P,P) between neighbours; they decide for what is there while movers touch alone.
        config: thresholds.
    """
    apart, together = _apart(places, presence > 0, weight, config)
    mover = np.where(weight > 0, 0, UNKNOWN)
    open_, count = [0], 1
    while open_:
        rows = np.flatnonzero(mover == open_.pop())
        one, other = _halves(*(each[np.ix_(rows, rows)] for each in (apart, together)), weight[rows], config)
        if one.any() and other.any():
            mover[rows[~one & ~other]] = UNKNOWN
            mover[rows[other]] = count
            open_ += [int(mover[rows[one][0]]), count]
            count += 1
    beside = bonds @ (mover[:, None] == np.arange(count))
    return np.where((mover == UNKNOWN) & (weight > 0) & beside.any(1), beside.argmax(1), mover)


def _apart(
    places: np.ndarray, there: np.ndarray, weight: np.ndarray, config: MoverConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Return (P,P) float64 each: at how many times two superpoints lie in different clusters, and in any at all."""
    apart, together = (np.zeros((len(weight), len(weight)), np.float32) for _ in range(2))
    for place, present in zip(places.swapaxes(0, 1), there.T, strict=True):
        here = np.flatnonzero(present & (weight > 0))
        if len(here) <= NEAREST + 1:
            continue
        squares = (place[here] ** 2).sum(1)
        far = np.maximum(squares[:, None] + squares - 2 * place[here] @ place[here].T, 0)
        np.fill_diagonal(far, np.inf)
        usual = np.quantile(far.min(1), config.usual)
        reach = config.gap**2 * np.maximum(np.partition(far, NEAREST, 1)[:, NEAREST], usual)
        cluster = connect(np.array(np.nonzero(far <= np.minimum(reach[:, None], reach))), len(here))
        share = np.bincount(cluster, weight[here]) / weight[here].sum()
        large = share[cluster] >= config.least
        rows = here[large]
        apart[np.ix_(rows, rows)] += cluster[large][:, None] != cluster[large]
        together[np.ix_(rows, rows)] += 1
    return apart, together


def _halves(
    apart: np.ndarray, together: np.ndarray, weight: np.ndarray, config: MoverConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Return (P,) bool each: two movers of superpoints, as far as it is known which; both empty where they are one mover."""
    none = np.zeros(len(weight), bool)
    mass = weight[:, None] * weight
    seen, cut = together * mass, apart * mass
    if not cut.any():
        return none, none
    first = int(cut.sum(1).argmax())
    second = int(cut[first].argmax())
    one, other = (apart[:, far] > apart[:, near] for near, far in ((first, second), (second, first)))
    for _ in range(ROUNDS):
        from_one, from_other = (cut[:, half].sum(1) / np.maximum(seen[:, half].sum(1), 1e-12) for half in (one, other))
        before, (one, other) = one, (from_other > from_one + config.sure, from_one > from_other + config.sure)
        if not one.any() or not other.any():
            return none, none
        if (one == before).all():
            break
    share = np.stack([weight * half / weight[half].sum() for half in (one, other)], 1)
    times = share.T @ together @ share
    between = (share.T @ apart @ share)[0, 1] / max(times[0, 1], 1e-12)
    turns = times[0, 1] < config.meet * times.diagonal().min()  # one thing that is lost and found again, perhaps
    small = min(weight[one].sum(), weight[other].sum()) < config.least * weight.sum()
    return (none, none) if between < config.apart or turns or small else (one, other)
