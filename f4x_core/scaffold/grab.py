"""Moving a few nodes while their neighbours follow as rigidly as possible (Sorkine and Alexa 2007). numpy, float64."""

import numpy as np

from ..geometry import pose, quaternion

ITERATIONS = 100
"""Local and global steps at most; a pull over a few rings of nodes settles in about twenty."""
SETTLED = 1e-5
"""Iterations end when no node moves by more than this fraction of the largest displacement in a step."""
DIAGONAL = 1e-9
"""Added to the diagonal of the linear system, so that nodes without any edge keep their place."""
UPRIGHT = 1e-6
"""Fraction of the edges' moment that is added in favour of no turn: nodes on a line leave the turn about that line open."""


def within_reach(xyz: np.ndarray, edges: np.ndarray, grabbed: np.ndarray, reach: float) -> np.ndarray:
    """Return the indices of the `grabbed (n,)` nodes and of all nodes within `reach` world units of one, measured along edges."""
    lengths = np.linalg.norm(xyz[edges[:, 0]] - xyz[edges[:, 1]], axis=1)
    distance = np.full(len(xyz), np.inf)
    distance[grabbed] = 0
    while True:  # Bellman-Ford: a scaffold has hundreds of nodes, and few rings lie within reach
        before = distance.copy()
        for a, b in (edges.T, edges.T[::-1]):
            np.minimum.at(distance, b, before[a] + lengths)
        if (distance == before).all():
            return np.flatnonzero(distance <= reach)


def grab(
    xyz: np.ndarray, edges: np.ndarray, grabbed: np.ndarray, targets: np.ndarray, free: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return `(positions (M,3), turns (M,4))`, unit wxyz, of nodes at `xyz (M,3)` when the `grabbed (n,)` are at `targets (n,3)`.

    Minimises `sum |(x_i - x_j) - R_i (p_i - p_j)|^2` over both directions of `edges (E,2)`, positions x and a rotation R
    for each node, alternately: the best rotations for the positions, then the best positions for the rotations. `free` are the
    indices of the nodes that may follow (default: all); every other node stays where it is. `turns` is how each node has
    turned: its rotation is to be multiplied by it from the left.
    """
    rest = np.asarray(xyz, np.float64)
    moves = np.full(len(rest), free is None)
    if free is not None:
        moves[free] = True
    moves[grabbed] = False
    placed = rest.copy()
    placed[grabbed] = targets
    largest = float(np.abs(placed - rest).max(initial=0))
    both = np.concatenate([edges, edges[:, ::-1]])  # (2E,2): from i to j
    bars = rest[both[:, 1]] - rest[both[:, 0]]
    laplacian = np.zeros((len(rest), len(rest)))
    np.add.at(laplacian, (both[:, 0], both[:, 0]), 1.0)
    np.add.at(laplacian, (both[:, 0], both[:, 1]), -1.0)
    inner = laplacian[np.ix_(moves, moves)] + DIAGONAL * np.eye(int(moves.sum()))
    solve, held = np.linalg.inv(inner), laplacian[np.ix_(moves, ~moves)]
    # Parts that no edge joins to a fixed node would be free to drift: the small diagonal keeps them where they are.
    anchor = DIAGONAL * rest[moves]
    # The iteration is slow to find a common turn, so it starts from the one that the grabbed and the fixed nodes show.
    common = pose.align_similarity(rest[~moves], placed[~moves])[1] if (~moves).sum() > 2 else np.eye(3)
    rotations = np.broadcast_to(common, (len(rest), 3, 3))
    for _ in range(ITERATIONS if moves.any() and largest else 0):
        pull = np.zeros_like(rest)
        np.add.at(pull, both[:, 0], -_mean_turned(rotations, both, bars))
        before = placed[moves]
        placed[moves] = solve @ (pull[moves] - held @ placed[~moves] + anchor)
        rotations = _best_rotations(placed, both, bars)
        if np.abs(placed[moves] - before).max() <= SETTLED * largest:
            break
    turned = np.zeros(len(rest), bool)
    turned[np.flatnonzero(moves)] = turned[grabbed] = bool(largest)
    turns = quaternion.from_matrix(_best_rotations(placed, both, bars))
    return placed, np.where(turned[:, None], turns, quaternion.IDENTITY)


def add_offset(
    xyz: np.ndarray, quat: np.ndarray, offset: tuple[np.ndarray, np.ndarray], fraction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return node poses `(xyz (F,n,3), quat (F,n,4))` after adding a `fraction (F,)` of `offset` = `(quat (n,4), xyz (n,3))`.

    The offset is in each node's own frame, so that it turns with the object that the node belongs to.
    """
    turn = quaternion.from_rotation_vector(fraction[:, None, None] * quaternion.to_rotation_vector(offset[0]))
    turned, placed = pose.compose(quat, xyz, turn, fraction[:, None, None] * offset[1])
    return placed, turned


def _mean_turned(rotations: np.ndarray, both: np.ndarray, bars: np.ndarray) -> np.ndarray:
    """Return the bars (2E,3) turned by the mean of the rotations at both ends."""
    mean = (rotations[both[:, 0]] + rotations[both[:, 1]]) / 2
    return np.einsum("eij,ej->ei", mean, bars)


def _best_rotations(placed: np.ndarray, both: np.ndarray, bars: np.ndarray) -> np.ndarray:
    """Return the rotations (M,3,3) that best turn the bars at each node into what they have become (Kabsch 1976)."""
    now = placed[both[:, 1]] - placed[both[:, 0]]
    moments = np.zeros((len(placed), 3, 3))
    np.add.at(moments, both[:, 0], now[:, :, None] * bars[:, None, :])
    moments += UPRIGHT * np.trace(moments, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    u, _, vt = np.linalg.svd(moments)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt
