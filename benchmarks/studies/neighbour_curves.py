"""Speed against error of the neighbour searches that the scaffold is built with, exact and sampled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from f4x_core.scaffold.distance import CHUNK, curve_distance
from f4x_core.scaffold.graph import GraphConfig, attach_nodes, build_graph
from f4x_core.scaffold.selection import automatic_unit

from ..study import Context, Figure, Findings, Row, Table, time_columns, time_rows

GROUPS = 12
"""Parts of the made-up motion, which turn and shift as wholes."""
WOBBLE = 0.02
"""World units that a curve leaves its part by."""
WRONG, FARTHER = "wrong (share)", "farther than the nearest"
RELATIVE, EDGES = "relative error", "edges changed (share)"
SIZES, CURVES = ((24, 300, 3000), (64, 1000, 50_000)), ((48, 200), (96, 1000))
"""Frames, nodes and points; frames and curves; of a quick and of a full report."""
UNIT_FRAMES = (16, 8, 4, 2, 1)
"""The scaffold takes 16."""
EVERY = (2, 4, 8, 16)


def make_curves(frames: int, count: int, seed: int) -> np.ndarray:
    """`(F, M, 3)` float64 positions: `GROUPS` clusters that turn about themselves and drift, each curve wobbling on its own."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-1, 1, (GROUPS, 3))
    group = rng.integers(0, GROUPS, count)
    offset = 0.15 * rng.normal(size=(count, 3))
    fraction = np.linspace(0, 1, frames)[:, None]
    phase, swing, drift = rng.uniform(0, 6, GROUPS), rng.uniform(-2, 2, GROUPS), rng.normal(size=(GROUPS, 3))
    angle = (swing * np.sin(4 * fraction + phase))[:, group]  # (F,M) about the vertical
    turned = np.stack(
        [
            np.cos(angle) * offset[:, 0] - np.sin(angle) * offset[:, 2],
            np.broadcast_to(offset[:, 1], angle.shape),
            np.sin(angle) * offset[:, 0] + np.cos(angle) * offset[:, 2],
        ],
        -1,
    )
    wobble = WOBBLE * np.sin(10 * fraction[..., None] + rng.uniform(0, 6, (count, 3)))
    return centre[group] + 0.5 * np.sin(3 * fraction[..., None] * drift[group]) + turned + wobble


def measure_neighbours(context: Context) -> Findings:
    """Measure cheaper searches for a Gaussian's nearest node and for the spacing of nodes: errors against time."""
    frames, nodes, points = context.choose(*SIZES)
    about = {"frames": frames, "nodes": nodes, "points": points}
    attach = context.step("attach", partial(_attach_rows, frames, nodes, points, context), **about)
    unit = context.step("unit", partial(_unit_rows, frames, points, context), **about)
    tables = [
        Table(
            "attach",
            attach,
            f"The nearest of {nodes} nodes for {points:,} points at {frames} moments",
            time_columns(),
            _ATTACH,
        ),
        Table("unit", unit, f"The spacing of {points:,} curves by 4 neighbours", time_columns(), _UNIT),
    ]
    bars = time_columns()[1:]
    figures = [
        Figure("Nearest node", "attach", "time (ms)", WRONG, "kind", *bars),
        Figure("Spacing, by some of the frames", "unit", "time (ms)", RELATIVE, "name", *bars),
    ]
    brute, tree = attach[0], attach[1]
    sampled = [row for row in attach if row["kind"] == "sampled frames"]
    used = next(row for row in unit if row["frames"] == min(UNIT_FRAMES[0], frames))
    words = [
        f"The tree that the scaffold uses gives every point its nearest node ({tree[WRONG]:.1%} wrong),"
        f" {brute['time (ms)'] / tree['time (ms)']:.0f} times faster than asking for every pair.",
        f"Trees of 1 frame in {EVERY[0]} give {sampled[0][WRONG]:.0%} of the points a node that is not the nearest, on"
        f" average {sampled[0][FARTHER]:.1%} farther off.",
        f"{used['frames']} frames tell the spacing to {used[RELATIVE]:.1%} in"
        f" {used['time (ms)'] / unit[0]['time (ms)']:.0%} of the time of all {frames}.",
    ]
    failed = [f"The tree gives {tree[WRONG]:.1%} of the points a wrong node."] if tree[WRONG] else []
    return Findings(tables, figures, words, failed=failed)


_ATTACH = (
    f"`{WRONG}`: points whose node is not the nearest at their moment. `{FARTHER}`: mean of its distance over the nearest's, less"
    " 1. `within`: what the search may leave out (eps of the tree). `sampled`: moments are rounded to 1 frame in n."
)
_UNIT = "The median squared distance is taken over this many frames; error against all frames."


def _attach_rows(frames: int, nodes: int, points: int, context: Context) -> list[Row]:
    from scipy.spatial import cKDTree

    xyz = make_curves(frames, nodes, context.seed)
    rng = np.random.default_rng(context.seed)
    reference = rng.integers(0, frames, points)
    x = xyz[reference, rng.integers(0, nodes, points)] + 0.1 * rng.normal(size=(points, 3))

    def every_pair() -> np.ndarray:
        found = np.zeros(points, np.int64)
        for frame in range(frames):
            here = reference == frame
            found[here] = ((x[here, None] - xyz[frame]) ** 2).sum(-1).argmin(1)
        return found

    def roughly(eps: float) -> np.ndarray:
        found = np.zeros(points, np.int64)
        for frame in range(frames):
            here = reference == frame
            found[here] = cKDTree(xyz[frame]).query(x[here], eps=eps)[1]
        return found

    ways: dict[tuple[str, str], Callable[[], np.ndarray]] = {
        ("every pair", "every pair"): every_pair,
        ("tree", "tree (the scaffold)"): partial(attach_nodes, x, reference, xyz),
    }
    ways |= {
        ("tree, within", f"tree, within {1 + eps:g} times"): partial(roughly, eps) for eps in (0.25, 0.5, 1.0, 2.0)
    }
    ways |= {
        ("sampled frames", f"tree, 1 frame in {n}"): partial(attach_nodes, x, reference // n * n, xyz) for n in EVERY
    }
    nearest = every_pair()
    times = time_rows([name for _, name in ways], list(ways.values()), context.repeats)
    nearest_distance = np.linalg.norm(x - xyz[reference, nearest], axis=1)
    rows = []
    for (kind, _), way, time in zip(ways, ways.values(), times, strict=True):
        found = way()
        farther = np.linalg.norm(x - xyz[reference, found], axis=1) / nearest_distance - 1
        errors = {WRONG: float(np.mean(found != nearest)), FARTHER: float(farther.mean())}
        rows.append({"name": time["name"], "kind": kind} | time | errors)
    return rows


def _unit_rows(frames: int, points: int, context: Context) -> list[Row]:
    xyz = make_curves(frames, points, context.seed)
    numbers = [frames, *(n for n in UNIT_FRAMES if n < frames)]
    ways = [partial(automatic_unit, xyz, 1.0, frames=n) for n in numbers]
    truth = ways[0]()
    times = time_rows([f"{n} frames" for n in numbers], ways, context.repeats)
    return [
        time | {"frames": n, "unit (world units)": way(), RELATIVE: abs(way() / truth - 1)}
        for n, way, time in zip(numbers, ways, times, strict=True)
    ]


def measure_curve_distance(context: Context) -> Findings:
    """Measure the distance of curves, the most that two trajectories get apart: all frames and some, dtypes, block sizes."""
    frames, nodes = context.choose(*CURVES)
    rows = context.step("curves", partial(_curve_rows, frames, nodes, context), frames=frames, nodes=nodes)
    bars = time_columns()[1:]
    figures = [
        Figure("Distance", "curves", "time (ms)", RELATIVE, "kind", *bars),
        Figure("The graph made of it", "curves", "time (ms)", EDGES, "kind", *bars),
    ]
    used, half = (next(row for row in rows if row["name"] == name) for name in (USED, _every(EVERY[0])))
    words = [
        f"The scaffold's distance over all {frames} frames is within {used[RELATIVE]:.1e} of float64 and leaves"
        f" {'every edge' if not used[EDGES] else f'{1 - used[EDGES]:.1%} of the edges'} of the graph as it is.",
        f"1 frame in {EVERY[0]} takes {half['time (ms)'] / used['time (ms)']:.0%} of the time, is off by"
        f" {half[RELATIVE]:.1e} and changes {half[EDGES]:.1%} of the edges.",
        f"scipy's distances frame by frame, in float64, take {rows[0]['time (ms)'] / used['time (ms)']:.2f} times as long as the"
        " scaffold's.",
    ]
    note = (
        f"`{RELATIVE}`: root mean square over that of the distances. `{EDGES}`: of the {GraphConfig().neighbours - 1} nearest"
        " nodes of each. Some frames can only underrate the largest distance."
    )
    table = Table("curves", rows, f"All pairs of {nodes} curves over {frames} frames", time_columns(), note)
    return Findings([table], figures, words)


USED = "float32, all frames (the scaffold)"


def _every(n: int) -> str:
    return f"float32, 1 frame in {n}"


def _curve_rows(frames: int, nodes: int, context: Context) -> list[Row]:
    from scipy.spatial.distance import cdist

    xyz = make_curves(frames, nodes, context.seed)

    def plainly() -> np.ndarray:
        largest = np.zeros((nodes, nodes))
        for here in xyz:
            np.maximum(largest, cdist(here, here), out=largest)
        return largest

    ways: dict[tuple[str, str], Callable[[], np.ndarray]] = {
        ("float64", "float64, all frames (scipy)"): plainly,
        ("all frames", USED): partial(curve_distance, xyz),
    }
    ways |= {
        ("all frames", f"float32, {chunk:,} pairs a block"): partial(curve_distance, xyz, chunk=chunk)
        for chunk in (256, 65_536)
        if chunk != CHUNK
    }
    ways |= {("some frames", _every(n)): partial(curve_distance, xyz[::n]) for n in EVERY}
    truth = plainly()
    edges = _edges(truth)
    times = time_rows([name for _, name in ways], list(ways.values()), context.repeats)
    rows = []
    for (kind, _), way, time in zip(ways, ways.values(), times, strict=True):
        found = way()
        error = float(np.sqrt(np.mean((found - truth) ** 2) / np.mean(truth**2)))
        changed = 1 - sum(len(a & b) for a, b in zip(_edges(found), edges, strict=True)) / sum(map(len, edges))
        rows.append({"name": time["name"], "kind": kind} | time | {RELATIVE: error, EDGES: changed})
    return rows


def _edges(distance: np.ndarray) -> Sequence[set[int]]:
    """Return the neighbours of every node."""
    neighbours, _ = build_graph(distance, GraphConfig().neighbours, np.inf)
    return [set(row[1:].tolist()) for row in neighbours]
