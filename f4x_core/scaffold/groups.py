"""Groups of nodes that move as one rigid object, and the motion of such a group. numpy."""

import numpy as np

from ..geometry import pose, quaternion

NEARNESS = 0.05
"""Fraction of the distance between two nodes that is added to their `nonrigidity`, so that static nodes are grouped by place."""
MOMENTS = 12
"""Times that are looked at for groups: curves are smooth, so that more would tell the same again."""
STILL = 1e-6
"""Fraction of the extent below which a residual is rounding and not noise."""
MAX_GROUPS = 24
"""Largest number of groups: more handles are of no use to a person."""
ROUNDS = 20
"""Rounds of choosing medoids; a few hundred nodes settle in less than ten."""


def nonrigidity(xyz: np.ndarray) -> np.ndarray:
    """Return, for each pair of curves `xyz (F,M,3)`, how far they are from one rigid object: `(M,M)` float64, symmetric.

    The range of their distance over time (largest minus smallest) plus `NEARNESS` times its mean, in world units.
    """
    nodes = xyz.shape[1]
    lowest, highest, total = np.full((nodes, nodes), np.inf), np.zeros((nodes, nodes)), np.zeros((nodes, nodes))
    for placed in xyz.astype(np.float64):
        distance = np.linalg.norm(placed[:, None] - placed, axis=-1)
        lowest, highest, total = np.minimum(lowest, distance), np.maximum(highest, distance), total + distance
    return highest - lowest + NEARNESS * total / len(xyz)


def rigid_groups(xyz: np.ndarray, count: int | None = None) -> np.ndarray:
    """Return the group `(M,)` int of every node with curve `xyz (F,M,3)`, the largest group 0.

    Many small groups (k-medoids on `nonrigidity`; Kaufman and Rousseeuw 1987) are merged, two at a time, where one rigid motion
    explains both best. Without `count` there are as many as the Bayesian information criterion favours (Schwarz 1978): noise of
    the curves makes no groups, however large, as long as another rigid motion explains little of it.
    """
    xyz = xyz[np.unique(np.linspace(0, len(xyz) - 1, MOMENTS).round().astype(int))].astype(np.float64)
    times, nodes = xyz.shape[:2]
    distance = nonrigidity(xyz)
    group = distance[:, _medoids(distance, min(max(count or MAX_GROUPS, MAX_GROUPS), nodes))].argmin(1)
    splits = _merged(xyz, [np.flatnonzero(group == number) for number in np.unique(group)])
    if count is None:
        values, floor = 3 * times * nodes, times * nodes * (STILL * np.ptp(xyz)) ** 2
        # a rigid motion is three numbers for its place and three for its turn at each time
        costs = [
            values * np.log(left + floor + 1e-300) + 6 * times * len(split) * np.log(values) for left, split in splits
        ]
        parts = splits[int(np.argmin(costs))][1]
    else:
        parts = next((split for _, split in splits if len(split) <= count))
    for number, members in enumerate(sorted(parts, key=len, reverse=True)):
        group[members] = number
    return group


def _merged(xyz: np.ndarray, parts: list[np.ndarray]) -> list[tuple[float, list[np.ndarray]]]:
    """Return (sum of squared residuals, groups) while groups of nodes are merged pair by pair until there is one."""
    residuals = [_residual(xyz[:, part]) for part in parts]
    together: dict[tuple[bytes, bytes], float] = {}
    splits = [(sum(residuals), list(parts))]
    while len(parts) > 1:
        best = (np.inf, 0, 0)
        for i, j in zip(*np.tril_indices(len(parts), -1), strict=True):
            key = (parts[i].tobytes(), parts[j].tobytes())
            if key not in together:
                together[key] = _residual(xyz[:, np.concatenate([parts[i], parts[j]])])
            best = min(best, (together[key] - residuals[i] - residuals[j], i, j))
        added, i, j = best
        parts = [*parts, np.concatenate([parts[i], parts[j]])]
        residuals = [*residuals, added + residuals[i] + residuals[j]]
        for gone in sorted((i, j), reverse=True):
            del parts[gone], residuals[gone]
        splits.append((sum(residuals), list(parts)))
    return splits


def _residual(xyz: np.ndarray) -> float:
    """Return the sum of squared distances of curves `xyz (F,n,3)` from one rigid object that moves as well as it can."""
    turn, middle = group_motion(xyz)
    shape = quaternion.rotate(quaternion.conjugate(turn)[:, None], xyz - middle[:, None])
    return float(((shape - shape.mean(0)) ** 2).sum())


def connected_groups(edges: np.ndarray, nodes: int) -> np.ndarray:
    """Return the group `(M,)` int of every one of `nodes` that `edges (E,2)` join, the largest group 0. Needs scipy."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    links = csr_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(nodes, nodes))
    count, group = connected_components(links, directed=False)
    order = np.argsort(-np.bincount(group, minlength=count), kind="stable")
    return np.argsort(order)[group]


def group_motion(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses `(quat (F,4), xyz (F,3))` of a rigid frame that moves with nodes of curves `xyz (F,n,3)`.

    At the first time it is in their middle, without rotation; then it follows them by the best rigid motion (Kabsch 1976).
    For fewer than three nodes it does not turn.
    """
    centres = xyz.mean(1, dtype=np.float64)
    if xyz.shape[1] < 3:
        return np.tile(quaternion.IDENTITY, (len(xyz), 1)), centres
    turns = [pose.align_similarity(xyz[0], placed)[1] for placed in xyz]
    return quaternion.align_sequence(quaternion.from_matrix(np.stack(turns))), centres


def shape_change(xyz: np.ndarray) -> np.ndarray:
    """Return how much `(F,)` of the shape of nodes with curves `xyz (F,n,3)` their best rigid motion leaves unexplained.

    Root mean square distance from the shape of the first time, over the geometric mean of both extents: 0 for a rigid object,
    about 1 where the shape has nothing in common with that of the first time.
    """
    turn, middle = group_motion(xyz)
    shape = xyz - middle[:, None]
    left = (shape - quaternion.rotate(turn[:, None], shape[:1])) ** 2
    extent = np.sqrt((shape**2).sum((1, 2)))
    return np.sqrt(left.sum((1, 2)) / np.maximum(extent * extent[0], 1e-12))


def _medoids(distance: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of the medoids: farthest first, then the middle of each group until nothing changes.

    There are `count`, or fewer where all other nodes coincide with one of them.
    """
    medoids = [int(distance.sum(1).argmin())]
    while len(medoids) < count and (apart := distance[:, medoids].min(1)).any():
        medoids.append(int(apart.argmax()))
    chosen = np.array(medoids)
    for _ in range(ROUNDS):
        group = distance[:, chosen].argmin(1)
        group[chosen] = np.arange(len(chosen))
        members = [np.flatnonzero(group == number) for number in range(len(chosen))]
        better = np.array([index[distance[np.ix_(index, index)].sum(1).argmin()] for index in members])
        if (better == chosen).all():
            break
        chosen = better
    return chosen
