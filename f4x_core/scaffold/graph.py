"""The node graph: nearest curves, edges within reach, coarse levels for ARAP. numpy."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

DISTANCE_CAP = 1e6
"""Stands for "never seen together" and "another group": finite, so it sorts, and beyond every reach."""


@dataclass(frozen=True)
class GraphConfig:
    """Shape of the graph. Lengths are multiples of the node spacing `unit`."""

    neighbours: int = 8
    """K, neighbours of a node, itself included."""
    reach: float = 5.0
    """An edge is valid when its curve distance is below so many units."""
    kth: int = 1
    """The curve distance is the kth largest over time; above 1 it forgives single bad frames."""
    base_weight: float = 0.4
    """ARAP weight of the graph itself."""
    levels: tuple[tuple[float, int, float], ...] = ((4.0, 4, 0.3),)
    """Coarse ARAP levels `(spacing in units, nearest members per node, weight)`: they keep the whole in shape."""


@dataclass(frozen=True, eq=False)
class EdgeLevel:
    """Edges from every node to the members of a thinned set."""

    node: np.ndarray
    """(E,) int64, the finer end."""
    neighbour: np.ndarray
    """(E,) int64, the member of the coarse set."""
    weight: float


def build_graph(
    distance: np.ndarray,
    neighbours: int,
    reach: float,
    groups: np.ndarray | None = None,
    distance_cap: float = DISTANCE_CAP,
) -> tuple[np.ndarray, np.ndarray]:
    """Return `(neighbours (M, K) int64, edge_mask (M, K) bool)` from curve distances `(M, M)`.

    Every row is the node itself, then its K-1 nearest; an edge is valid below `reach` (world units), the self edge
    always. Nodes of different `groups (M,)` (say instances) are `distance_cap` apart, so no edge joins them; the same
    holds for nodes at infinite distance. Rows of graphs with fewer than K nodes are padded with the node, invalid.
    """
    nodes = len(distance)
    order, sorted_distance = _nearest(_capped(distance, groups, distance_cap), min(neighbours, nodes) - 1)
    own = np.arange(nodes)[:, None]
    padding = np.repeat(own, max(neighbours - nodes, 0), axis=1)
    valid = sorted_distance < min(reach, distance_cap)
    mask = np.concatenate([np.ones((nodes, 1), bool), valid, np.zeros(padding.shape, bool)], axis=1)
    return np.concatenate([own, order, padding], axis=1), mask


def thin(distance_from: Callable[[int], np.ndarray], unit: float, order: np.ndarray) -> np.ndarray:
    """Return the indices, in the `order (M,)` of all, that are each farther than `unit` from all accepted before.

    `distance_from(i)` gives the distances `(M,)` from `i` to all; it is asked for accepted indices only. Every index is
    within `unit` of an accepted one.
    """
    nearest = np.full(len(order), np.inf)
    accepted = []
    for i in order.tolist():
        if nearest[i] > unit:
            accepted.append(i)
            np.minimum(nearest, distance_from(i), out=nearest)
    return np.asarray(accepted, np.int64)


def multilevel_edges(distance: np.ndarray, unit: float, config: GraphConfig, seed: int) -> list[EdgeLevel]:
    """Return the coarse ARAP edges, the thinned sets drawn from a generator with `seed`."""
    generator = np.random.default_rng(seed)
    capped = _capped(distance, None, DISTANCE_CAP)
    edges = []
    for spacing, count, weight in config.levels:
        members = thin(capped.__getitem__, spacing * unit, generator.permutation(len(capped)))
        to_members = capped[:, members].copy()
        to_members[members, np.arange(len(members))] = np.inf  # never an edge to itself
        picked = np.argsort(to_members, axis=1, kind="stable")[:, :count]
        node, slot = np.nonzero(np.take_along_axis(to_members, picked, axis=1) < config.reach * spacing * unit)
        edges.append(EdgeLevel(node, members[picked[node, slot]], weight))
    return edges


def attach_nodes(points: np.ndarray, reference: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Return the nearest node `(N,)` int64 of `points (N, 3)` at their reference frames `(N,)`, `xyz (F, M, 3)`."""
    from scipy.spatial import cKDTree

    attach = np.zeros(len(points), np.int64)
    for frame in np.unique(reference):
        members = reference == frame
        attach[members] = cKDTree(xyz[frame]).query(points[members])[1]
    return attach


def _capped(distance: np.ndarray, groups: np.ndarray | None, cap: float) -> np.ndarray:
    capped = np.minimum(distance, cap)
    return capped if groups is None else np.where(groups[:, None] == groups[None, :], capped, cap)


def _nearest(distance: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the `count` nearest other nodes of each node and their distances, ties by index; duplicates count."""
    others = distance.copy()
    np.fill_diagonal(others, np.inf)
    order = np.argsort(others, axis=1, kind="stable")[:, :count]
    return order, np.take_along_axis(others, order, axis=1)
