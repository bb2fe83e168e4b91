"""Movers that are apart for most of the time that both are there, whatever touches in between. Needs numpy alone.

Two people who cross hide and touch each other for a moment, and their superpoints are neighbours then. Before and after there is
room between them: at each time, superpoints are linked across gaps as small as those within a thing, and two that lie in
different clusters most of the time belong to different movers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .connected_objects import connect
from .select_config import MoverConfig

ROUNDS = 30
"""Rounds of assigning superpoints to the one of two movers that they are less apart from; a few mostly do."""
NEAREST = 2
"""Rank, from 0, of the neighbour that a superpoint's distances are measured by: where a thing has few, they lie farther apart."""
UNKNOWN = -1
"""Mover of a superpoint that nothing tells of, and cluster of one that is in none."""


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
    mover = np.where(weight > 0, 0, UNKNOWN)
    cluster = _clusters(places, (presence > 0) & (weight > 0)[:, None], weight, config)
    if cluster.max(initial=0) == 0:  # never more than one
        return mover
    meetings, open_, count = _Meetings.of(cluster), [0], 1
    while open_:
        rows = np.flatnonzero(mover == open_.pop())
        one, other = meetings.among(rows).halves(weight[rows], config)
        if one.any():
            mover[rows[~one & ~other]] = UNKNOWN
            mover[rows[other]] = count
            open_ += [int(mover[rows[one][0]]), count]
            count += 1
    beside = bonds @ (mover[:, None] == np.arange(count))
    return np.where((mover == UNKNOWN) & (weight > 0) & beside.any(1), beside.argmax(1), mover)


def _clusters(places: np.ndarray, there: np.ndarray, weight: np.ndarray, config: MoverConfig) -> np.ndarray:
    """Return (P,T) int64: the cluster of each superpoint at each time, from 0; `UNKNOWN` if in no large one."""
    found = np.full(there.shape, UNKNOWN)
    for time, present in enumerate(there.T):
        here = np.flatnonzero(present)
        if len(here) <= NEAREST + 1:
            continue
        place = places[here, time]
        squares = (place**2).sum(1)
        far = np.maximum(squares[:, None] + squares - 2 * place @ place.T, 0)
        np.fill_diagonal(far, np.inf)
        usual = np.quantile(far.min(1), config.usual)
        reach = config.gap**2 * np.maximum(np.partition(far, NEAREST, 1)[:, NEAREST], usual)
        cluster = connect(np.array(np.nonzero(far <= np.minimum(reach[:, None], reach))), len(here))
        large = np.bincount(cluster, weight[here]) >= config.least * weight[here].sum()
        found[here, time] = np.where(large, np.cumsum(large) - 1, UNKNOWN)[cluster]
    return found


@dataclass(frozen=True, eq=False)
class _Meetings:
    """Counts of the times at which pairs of superpoints are seen together."""

    apart: np.ndarray
    """(P,P) float32: number of times at which two lie in different clusters."""
    together: np.ndarray
    """(P,P) float32: number of times at which each lies in one."""

    @classmethod
    def of(cls, cluster: np.ndarray) -> _Meetings:
        """Count, over the clusters (P,T) of superpoints."""
        known = (cluster != UNKNOWN).astype(np.float32)
        together = known @ known.T
        same = np.zeros_like(together)
        for number in range(int(cluster.max()) + 1):
            inside = (cluster == number).astype(np.float32)
            same += inside @ inside.T
        return cls(together - same, together)

    def among(self, rows: np.ndarray) -> _Meetings:
        """Return those of the superpoints `rows`."""
        pairs = np.ix_(rows, rows)
        return _Meetings(self.apart[pairs], self.together[pairs])

    def halves(self, weight: np.ndarray, config: MoverConfig) -> tuple[np.ndarray, np.ndarray]:
        """Return (P,) bool each: two movers of superpoints, as far as it is known which; both empty where they are one mover."""
        none = np.zeros(len(weight), bool)
        first = int((self.apart @ weight * weight).argmax())
        second = int((self.apart[first] * weight).argmax())
        one, other = self.apart[second] > self.apart[first], self.apart[first] > self.apart[second]
        for _ in range(ROUNDS):
            if not one.any() or not other.any():
                return none, none
            from_one, from_other = (
                self.apart @ (weight * half) / np.maximum(self.together @ (weight * half), 1e-12)
                for half in (one, other)
            )
            before, one, other = one, from_other > from_one + config.sure, from_one > from_other + config.sure
            if (one == before).all():
                break
        held = [weight[half].sum() for half in (one, other)]
        share = np.stack([weight * half / max(own, 1e-12) for half, own in zip((one, other), held, strict=True)])
        times = share @ self.together @ share.T
        between = (share @ self.apart @ share.T)[0, 1] / max(times[0, 1], 1e-12)
        turns = times[0, 1] < config.meet * times.diagonal().min()  # perhaps one thing that is lost and found again
        if between < config.apart or turns or min(held) < config.least * weight.sum():
            return none, none
        return one, other
