"""The deformation's speed against its error: forms of the blend, neighbours, precisions, and every angle of a turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from f4x_core.geometry import dual_quaternion, pose, quaternion
from f4x_core.native import open_library
from f4x_core.scaffold.deformation import blend, move_gaussians

from ..speed.deformation import benchmark
from ..study import Context, Figure, Findings, Row, Table, time_columns, time_rows
from .rigid_mean import rigid_mean

NODES, SIDE = 200, 1.0
"""Nodes lie within `SIDE` of the origin in each direction; the scene's median depth is 1."""
SLIDE = 0.2
"""Shift of nodes beside their turn, world units."""
DEGREES, PLACE = "rotation rms (deg)", "position rms"
USUAL = 40.0
"""Largest turn of neighbours, in degrees, where something else varies."""
COUNTS, IMPLEMENTED = (3000, 30_000), ((10_000,), (50_000, 100_000))
"""Gaussians of a quick and of a full report."""
NEIGHBOURS, SPREADS = ((2, 8), (1, 2, 4, 8, 16)), ((10.0, 80.0), (5.0, 10.0, 20.0, 80.0))
ANGLES = (
    (0, 15, 45, 90, 120, 150, 170, 179, 181, 190, 210, 240, 270, 315, 345, 359),
    (*range(0, 175, 5), 175, 178, 179, 179.9, 180, 180.1, 181, 182, *range(185, 360, 5), 359),
)
OWN_DEGREES, OWN_PLACE = "rounding of rotation (deg)", "rounding of position"
MADE_DEGREES, MADE_PLACE = "rotation rms, as made (deg)", "position rms, as made"
MAX_EXACT_ERROR = 1e-9
"""The exact mean may be so far from the screw it halves (world units; degrees are checked at 57 times as much)."""

Poses = tuple[np.ndarray, np.ndarray]
Kind = type[np.floating[Any]]


@dataclass(frozen=True)
class Carried:
    """Gaussians and the motions of their neighbours, in one precision."""

    table: np.ndarray
    """(P,8) unit dual quaternions."""
    index: np.ndarray
    """(N,K) rows of `table`."""
    weights: np.ndarray
    """(N,K) that sum to 1."""
    quats: np.ndarray
    """(N,4)"""
    means: np.ndarray
    """(N,3)"""

    def rounded(self, kind: Kind) -> Carried:
        """The same in another precision."""
        floats = {name: getattr(self, name).astype(kind) for name in ("table", "weights", "quats", "means")}
        return replace(self, **floats)


def blend_linearly(c: Carried) -> Poses:
    """Linear blend skinning: the mean matrix moves the centre, its nearest rotation turns the Gaussian."""
    q, t = dual_quaternion.to_pose(c.table)
    weights = c.weights[..., None]
    matrix = (weights[..., None] * quaternion.to_matrix(q)[c.index]).sum(1)  # (N,3,3)
    place = np.einsum("nij,nj->ni", matrix, c.means) + (weights * t[c.index]).sum(1)
    u, _, vt = np.linalg.svd(matrix.astype(np.float32) if c.table.dtype == np.float16 else matrix)
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    return quaternion.multiply(quaternion.from_matrix(u @ vt).astype(c.quats.dtype), c.quats), place


def blend_unaligned(c: Carried) -> Poses:
    """Dual quaternions summed with the signs that they have."""
    summed = np.matmul(c.weights[:, None, :], c.table[c.index])[:, 0]
    return pose.compose(*dual_quaternion.to_pose(dual_quaternion.normalize(summed)), c.quats, c.means)


def blend_aligned(c: Carried) -> Poses:
    """Blend as scenes do: dual quaternions on the hemisphere of the attach node's."""
    return pose.compose(*blend(c.table, c.index, c.weights, np.ones(1, c.weights.dtype)), c.quats, c.means)


def blend_natively(c: Carried) -> Poses:
    """`blend_aligned` by the compiled library."""
    means, quats = move_gaussians(c.table, c.index, c.weights, np.ones(len(c.means), np.float32), c.means, c.quats)
    return quats, means


def blend_exactly(c: Carried) -> Poses:
    """By the exact mean."""
    q, t = dual_quaternion.to_pose(c.table[c.index])
    return pose.compose(*rigid_mean(q, t, c.weights), c.quats, c.means)


EXACT, ALIGNED = "exact SE(3) mean", "dual quaternion, aligned"
FORMS: dict[str, Callable[[Carried], Poses]] = {
    "linear blend": blend_linearly,
    "dual quaternion, not aligned": blend_unaligned,
    ALIGNED: blend_aligned,
}
PRECISIONS: tuple[Kind, ...] = (np.float64, np.float32, np.float16)
Form = tuple[str, Kind, Callable[[Carried], Poses]]


def _forms() -> list[Form]:
    """Name, precision and function of all forms, the exact one first."""
    forms: list[Form] = [(EXACT, np.float64, blend_exactly)]
    forms += [(name, kind, form) for name, form in FORMS.items() for kind in PRECISIONS]
    if open_library()[0] is not None:
        forms.append((f"{ALIGNED}, compiled", np.float32, blend_natively))
    return forms


def measure_forms(context: Context) -> Findings:
    """Forms of the blend against the exact mean: neighbours, how far these differ, precisions."""
    count = context.choose(*COUNTS)
    cases = [(k, USUAL) for k in context.choose(*NEIGHBOURS)] + [(8, spread) for spread in context.choose(*SPREADS)]
    rows: list[Row] = []
    for k, spread in sorted(cases):
        work = partial(_form_rows, count, k, spread, context)
        rows += context.step(f"{k}-neighbours-{spread:.0f}-degrees", work, count=count)
    counts = context.choose(*IMPLEMENTED)
    implementations = context.step("implementations", partial(_implementation_rows, counts, context), counts=counts)
    tables = [
        Table("forms", rows, f"{count:,} Gaussians, one thread", time_columns(), _FORMS_NOTE),
        Table("implementations", implementations, "The aligned blend, as it is used", ("time (ms)",), _USED_NOTE),
    ]
    bars, usual, wide = time_columns()[1:], {"K": 8, "spread (deg)": USUAL}, {"precision": "float64"}
    figures = [
        Figure(
            f"Rotation, 8 neighbours up to {USUAL:.0f}° apart",
            "forms",
            "time (ms)",
            DEGREES,
            "form",
            *bars,
            where=usual,
        ),
        Figure(
            f"Position, 8 neighbours up to {USUAL:.0f}° apart", "forms", "time (ms)", PLACE, "form", *bars, where=usual
        ),
        Figure("How far 8 neighbours differ", "forms", "spread (deg)", DEGREES, "form", log="y", where={"K": 8} | wide),
        Figure(
            "How many neighbours",
            "forms",
            "K",
            "time (ms)",
            "form",
            *bars,
            log="y",
            where={"spread (deg)": USUAL} | wide,
        ),
    ]
    return Findings(tables, figures, _form_words([row for row in rows if all(row[k] == v for k, v in usual.items())]))


_FORMS_NOTE = (
    f"`{DEGREES}`, `{PLACE}` (world units; median depth 1): from the exact mean. Rounding: from the same form in float64. `spread`:"
    " nodes turn by up to that much, and their dual quaternions have either sign. Times of numpy functions, with the gather of"
    " neighbours; a processor has no float16 arithmetic, so times of float16 mean nothing. Linear blending spends most on the"
    " nearest rotation, which a mesh doesn't need."
)
_USED_NOTE = "`gather` and `CSR` are in torch with gradients to poses and weights (a fit without the compiled library)."


def _form_rows(count: int, k: int, spread: float, context: Context) -> list[Row]:
    carried = make_motions(count, k, spread, context.seed)
    inputs = {kind: carried.rounded(kind) for kind in PRECISIONS}
    forms = _forms()
    answers = [form(inputs[kind]) for _, kind, form in forms]
    exact = answers[0]
    own = {name: answer for (name, kind, _), answer in zip(forms, answers, strict=True) if kind is np.float64}
    calls = [partial(form, inputs[kind]) for _, kind, form in forms]
    rows = []
    times = time_rows([name for name, _, _ in forms], calls, context.repeats)
    for (name, kind, _), answer, time in zip(forms, answers, times, strict=True):
        row = {"form": name, "precision": kind.__name__, "K": k, "spread (deg)": spread}
        row |= {key: value for key, value in time.items() if key != "name"}
        row |= dict(zip((DEGREES, PLACE), difference(answer, exact), strict=True))
        wide = own.get(name.removesuffix(", compiled"), exact)
        rows.append(row | dict(zip((OWN_DEGREES, OWN_PLACE), difference(answer, wide), strict=True)))
    return rows


def _implementation_rows(counts: tuple[int, ...], context: Context) -> list[Row]:
    found = benchmark(counts, context.repeats)
    return [
        {"name": row["name"], "Gaussians": row["gaussians"], "K": row["neighbours"], "time (ms)": row["ms"]}
        | {"largest error": found["errors"].get(row["name"])}
        for row in found["timings"]
    ]


def _form_words(rows: Sequence[Row]) -> list[str]:
    exact, best = rows[0], {row["form"]: row for row in rows[1:] if row["precision"] == "float64"}
    words = [
        f"{name}: {row[DEGREES]:.2g} degrees and {row[PLACE]:.1e} world units from the exact mean,"
        f" {exact['time (ms)'] / row['time (ms)']:.0f} times faster than it."
        for name, row in best.items()
    ]
    for row in rows:
        if row["form"].startswith(ALIGNED) and row["precision"] != "float64":
            words.append(
                f"{row['form']}, {row['precision']}: rounding costs {row[OWN_DEGREES]:.1e} degrees and"
                f" {row[OWN_PLACE]:.1e} world units."
            )
    return words


def make_motions(count: int, k: int, spread: float, seed: int) -> Carried:
    """Gaussians that follow `k` of `NODES` nodes, which turn about random axes by up to `spread` degrees and shift.

    Every dual quaternion has either sign, which are the same motion: who sums them has to know.
    """
    rng = np.random.default_rng(seed)
    axis = quaternion.normalize(np.pad(rng.normal(size=(NODES, 3)), ((0, 0), (1, 0))))[:, 1:]
    turn = quaternion.from_rotation_vector(np.radians(spread * rng.uniform(size=(NODES, 1))) * axis)
    pivot = rng.uniform(-SIDE, SIDE, (NODES, 3))
    shift = pivot - quaternion.rotate(turn, pivot) + SLIDE * rng.uniform(-1, 1, (NODES, 3))
    weights = rng.uniform(0.1, 1, (count, k))
    return Carried(
        rng.choice([-1, 1], (NODES, 1)) * dual_quaternion.from_pose(turn, shift),
        np.argsort(rng.uniform(size=(count, NODES)), axis=1)[:, :k].astype(np.int32),
        weights / weights.sum(1, keepdims=True),
        quaternion.normalize(rng.normal(size=(count, 4))),
        rng.uniform(-SIDE, SIDE, (count, 3)),
    )


def difference(found: Poses, truth: Poses) -> tuple[float, float]:
    """Root mean square angle in degrees and distance between poses `(q (N,4), x (N,3))`."""
    a, b = (quaternion.normalize(q.astype(np.float64)) for q in (found[0], truth[0]))
    apart = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    angles = np.degrees(4 * np.arcsin(np.minimum(apart / 2, 1)))
    distances = np.linalg.norm(found[1].astype(np.float64) - truth[1], axis=1)
    return float(np.sqrt(np.mean(angles**2))), float(np.sqrt(np.mean(distances**2)))


def measure_rotations(context: Context) -> Findings:
    """Measure a Gaussian between a node at rest and one that turns by 0 to 359 degrees."""
    angles = context.choose(*ANGLES)
    fractions = context.choose((0.25,), (0.25, 0.5))
    count = context.choose(64, 1000)
    rows: list[Row] = context.step(
        "rotations",
        lambda: [
            row for s in fractions for angle in angles for row in _rotation_rows(float(angle), s, count, context.seed)
        ],
        angles=angles,
        shares=fractions,
    )
    tables = [Table("rotations", rows, f"{count} axes and pivots", note=_ROTATIONS_NOTE)]
    shown = [row for row in rows if row["share"] == fractions[0]]
    wide, ours = {"precision": "float64", "share": fractions[0]}, {"kind": "aligned", "share": fractions[0]}
    figures = [
        Figure("From the mean on the short way", "rotations", "angle (deg)", DEGREES, "form", log="", where=wide),
        Figure("Position, from the same mean", "rotations", "angle (deg)", PLACE, "form", log="y", where=wide),
        Figure("From the turn as it was made", "rotations", "angle (deg)", MADE_DEGREES, "form", log="", where=wide),
        Figure("Rounding of the aligned blend", "rotations", "angle (deg)", OWN_DEGREES, "name", log="y", where=ours),
    ]
    exact = [row for row in rows if row["form"] == EXACT and row["angle (deg)"] != 180]
    wrong = max(max(row[PLACE], np.radians(row[DEGREES])) for row in exact)
    failed = [f"The exact mean is {wrong:.1e} from the screw that it divides."] if wrong > MAX_EXACT_ERROR else []
    return Findings(tables, figures, _rotation_words(shown), failed=failed)


_ROTATIONS_NOTE = (
    "The exact mean of rest and a screw is the screw's share, on the short way: beyond 180 degrees it is that of the turn the"
    " other way round. `as made`: the share of the turn that the node really made, which no blend of two poses can know; signs"
    " that are continued in time and not aligned do. At 180 degrees both ways are equally short."
)


def _rotation_rows(angle: float, share: float, count: int, seed: int) -> list[Row]:
    rng = np.random.default_rng(seed)
    axis = quaternion.normalize(np.pad(rng.normal(size=(count, 3)), ((0, 0), (1, 0))))[:, 1:]
    pivot, x = rng.uniform(-SIDE, SIDE, (2, count, 3))
    slide = SLIDE * rng.uniform(-1, 1, (count, 1)) * axis
    own = quaternion.normalize(rng.normal(size=(count, 4)))

    def screw(degrees: float, part: float) -> Poses:
        half = np.radians(degrees * part) / 2
        q = np.concatenate([np.full((count, 1), np.cos(half)), np.sin(half) * axis], axis=1)  # sign goes on in time
        return q, pivot - quaternion.rotate(q, pivot) + part * slide

    rest = np.tile(dual_quaternion.IDENTITY, (count, 1))
    table = np.concatenate([rest, dual_quaternion.from_pose(*screw(angle, 1.0))])
    index = np.stack([np.arange(count), np.arange(count) + count], axis=1).astype(np.int32)
    carried = Carried(table, index, np.tile([1 - share, share], (count, 1)), own, x)
    short = pose.compose(*screw(angle if angle <= 180 else angle - 360, share), own, x)
    made = pose.compose(*screw(angle, share), own, x)
    forms = _forms()
    answers = [form(carried.rounded(kind)) for _, kind, form in forms]
    wide = {name: a for (name, kind, _), a in zip(forms, answers, strict=True) if kind is np.float64}
    rows = []
    for (name, kind, _), answer in zip(forms, answers, strict=True):
        row: Row = {"angle (deg)": angle, "share": share, "form": name, "precision": kind.__name__}
        row |= {
            "kind": "aligned" if name.startswith(ALIGNED) else "other",
            "name": f"{name.removeprefix('dual quaternion, ')}, {kind.__name__}",
        }
        row |= dict(zip((DEGREES, PLACE), difference(answer, short), strict=True))
        row |= dict(zip((MADE_DEGREES, MADE_PLACE), difference(answer, made), strict=True))
        own_form = wide[name.removesuffix(", compiled")]
        rows.append(row | dict(zip((OWN_DEGREES, OWN_PLACE), difference(answer, own_form), strict=True)))
    return rows


def _rotation_words(rows: Sequence[Row]) -> list[str]:
    words = []
    for name in FORMS:
        mine = [row for row in rows if row["form"] == name and row["precision"] == "float64"]
        below = max((row for row in mine if row["angle (deg)"] < 180), key=lambda row: row[DEGREES])
        beyond = [row for row in mine if row["angle (deg)"] > 180]
        words.append(
            f"{name}: at most {below[DEGREES]:.2g} degrees from the mean below 180 degrees (at {below['angle (deg)']:g});"
            f" beyond, {max(row[DEGREES] for row in beyond):.2g} from the mean on the short way and"
            f" {max(row[MADE_DEGREES] for row in beyond):.2g} from the turn as made."
        )
    return words
