"""Groups of nodes that move as one rigid object, and the motion of such a group. numpy."""

import numpy as np

from ..geometry import pose, quaternion

NEARNESS = 0.05
"""Fraction of the distance between two nodes that is added to their `nonrigidity`, so that static nodes are grouped by place."""
TOLERANCE = 1.0
"""By how much the distance between two nodes of one group may change over the clip, in node spacings (nine pairs in ten)."""
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


def rigid_groups(xyz: np.ndarray, unit: float, count: int | None = None) -> np.ndarray:
    """Return the group `(M,)` int of every node with curve `xyz (F,M,3)`, the largest group 0.

    k-medoids on `nonrigidity` (Kaufman and Rousseeuw 1987), seeded with nodes far apart. Without `count` there are as few groups
    as leave nine in ten pairs of a group within `TOLERANCE` times `unit`, at most `MAX_GROUPS`.
    """
    distance = nonrigidity(xyz)
    for number in [count] if count else range(1, min(MAX_GROUPS, len(distance)) + 1):
        medoids = _medoids(distance, min(number, len(distance)))
        group = distance[:, medoids].argmin(1)
        together = distance[
            group[:, None] == group
        ]  # a medoid next to a joint is near to both sides of it; all pairs tell
        if count is None and np.quantile(together, 0.9) <= TOLERANCE * unit:
            break
    order = np.argsort(-np.bincount(group, minlength=len(medoids)), kind="stable")
    return np.argsort(order)[group]


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
    turns = [pose.align_similarity(xyz[0], placed, with_scale=False)[1] for placed in xyz]
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
    """Indices (count,) of the medoids: farthest first, then the middle of each group until nothing changes."""
    medoids = [int(distance.sum(1).argmin())]
    while len(medoids) < count:
        medoids.append(int(distance[:, medoids].min(1).argmax()))
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
