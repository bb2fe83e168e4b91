"""Hard cases as a table: the catalogue of `hard_cases.py` run through, and two curves of float32 against float64."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from f4x_core.geometry import dual_quaternion, quaternion
from f4x_core.raster import RasterConfig, why_not
from f4x_core.scaffold.deformation import COLLAPSED, blend

from ..speed.raster import draw, make_wavy_scene
from ..study import Context, Figure, Findings, MissingError, Row, Table
from .hard_cases import OUTCOMES, Case, Check, load_cases, run_case

CATALOGUE = Path(__file__).parents[2] / "tests" / "hard_cases"
"""Beside the package in a checkout; an installation has none."""
SCALES = tuple(10.0**power for power in range(-3, 4))
TURNS = (0, 45, 90, 120, 150, 165, 172, 176, 178, 179, 179.9, 180, 180.1, 181, 182, 184, 188, 195, 210, 240, 300, 360)
"""Degrees that a Gaussian's neighbours have turned."""
SPREAD = 3.0
"""Degrees between the first and the last of its neighbours."""
LAST_STAGE = "fit"


def measure_cases(context: Context) -> Findings:
    """Run every hard case: which checks passed, which errors were reported, and which were wrong without a message."""
    folder = context.cases or CATALOGUE
    if not folder.is_dir():
        raise MissingError(
            "the catalogue of hard cases is not part of an installation; --cases DIR names tests/hard_cases."
        )
    whole = load_cases(folder)
    cases = [case for case in whole if not (case.long and context.quick)]
    found = [(case, _checks(context, case)) for case in cases]
    table = [_case_row(case, checks) for case, checks in found]
    every = [_check_row(case, check) for case, checks in found for check in checks]
    failed = [f"{row['case']}: {row['said']}" for row in table if row["outcome"] == "wrong"]
    note = (
        "right: within what is allowed of float64 or of the truth. told: not right, and the program names the cause."
        " refused: no answer but a sentence. known limit: not right, in the way the catalogue says. wrong: without a word."
    )
    tables = [
        Table("cases", table, "Hard cases, each with its worst outcome", note=note),
        Table("checks", every, "Everything that was tried"),
    ]
    skipped = [f"{case.title}: too long for a quick report" for case in whole if case not in cases]
    return Findings(tables, words=_words(table, every), skipped=skipped, failed=failed)


def _checks(context: Context, case: Case) -> list[Check]:
    rows = context.step(case.name, lambda: [asdict(check) for check in run_case(case)], digest=case.digest)
    return [Check(**row) for row in rows]


def _case_row(case: Case, checks: Sequence[Check]) -> Row:
    """One line about a case: its worst check decides, and speaks."""
    outcome = case.outcome(checks)
    worst = max(checks, key=lambda check: (OUTCOMES.index(check.outcome), bool(check.message)))
    ratios = [check.error / check.allowed for check in checks if check.error is not None and check.allowed]
    message = worst.message or (f"{worst.by} {worst.what}".strip() if outcome == "wrong" else "")
    return {
        "case": case.title,
        "stage": case.stage,
        "hard": case.hard,
        "must hold": case.must,
        "checks": len(checks),
        "worst error / allowed": max(ratios, default=None),
        "outcome": outcome,
        "said": message,
        "file": f"{case.name}.py",
    }


def _check_row(case: Case, check: Check) -> Row:
    return {
        "case": case.name,
        "stage": case.stage,
        "by": check.by,
        "what": check.what,
        "error": check.error,
        "allowed": check.allowed,
        "outcome": check.outcome,
        "said": check.message,
    }


def _words(cases: Sequence[Row], checks: Sequence[Row]) -> list[str]:
    counts = Counter(row["outcome"] for row in cases)
    counted = ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES if counts[outcome])
    words = [f"{len(cases)} hard cases in {len(checks)} checks: {counted}; none may be wrong without a word."]
    precise = [row for row in cases if row["worst error / allowed"] is not None and row["stage"] != LAST_STAGE]
    if precise:
        worst = max(precise, key=lambda row: row["worst error / allowed"])
        words.append(
            f"Nearest to its bound in float32 comes “{worst['case']}” ({worst['stage']}), with"
            f" {worst['worst error / allowed']:.0%} of the error that is allowed."
        )
    return words


def measure_precision(context: Context) -> Findings:
    """Error of float32 over the size of the world and over the turn of a blend, the sign rule of the papers beside ours."""
    tables = [
        Table(
            "scales", context.step("scales", _measure_scales), "Picture of one scene in other units, against float64"
        ),
        Table(
            "turns",
            context.step("turns", _measure_turns),
            f"Blend of 8 neighbours within {SPREAD:g} degrees, about one axis",
            note="w >= 0: quaternions as the published code makes them from matrices, with no care for signs.",
        ),
    ]
    figures = [
        Figure("Float32 in small and large worlds", "scales", "size of the world", "error", "backend"),
        Figure("Blending around half a turn", "turns", "turn (degrees)", "error (degrees)", "rule", log="y"),
    ]
    return Findings(tables, figures, _precision_words(*(table.rows for table in tables)))


def _measure_scales() -> list[Row]:
    """Root mean square error of colours in [0, 1]; the near plane is scaled with the world."""
    scene = make_wavy_scene(400, 3, 96, 64)
    rows = []
    for scale in SCALES:
        scaled = scene | {"means": scale * scene["means"], "scales": scale * scene["scales"]}
        config = RasterConfig(near=0.01 * scale, threads=1)
        with torch.no_grad():
            true = draw(**scaled, backend="reference", config=config).channels
            for backend in ("native", "torch"):
                if why_not(backend) is None:
                    got = draw(**scaled, backend=backend, config=config).channels
                    error = float((got.double() - true).square().mean().sqrt())
                    rows.append({"size of the world": scale, "backend": backend, "error": error})
    return rows


def _measure_turns() -> list[Row]:
    """Degrees between the blended rotation and the middle of the neighbours' turns."""
    rng = np.random.default_rng(0)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    spread = np.deg2rad(np.linspace(-SPREAD / 2, SPREAD / 2, 8))
    weights, index, strength = np.full((1, 8), np.float32(1 / 8)), np.arange(8)[None], np.ones(1, np.float32)
    rows = []
    for turn in TURNS:
        true = quaternion.from_rotation_vector(np.deg2rad(turn) * axis)
        q = quaternion.from_rotation_vector((np.deg2rad(turn) + spread)[:, None] * axis)
        table = dual_quaternion.from_pose(q, np.zeros((8, 3))).astype(np.float32)
        upright = np.where(table[:, :1] < 0, -table, table)
        careless = dual_quaternion.to_pose(dual_quaternion.normalize(upright.mean(0), COLLAPSED))[0]
        for rule, got in (("ours", blend(table, index, weights, strength)[0][0]), ("w >= 0", careless)):
            apart = quaternion.multiply(quaternion.conjugate(true), got.astype(float))
            degrees = np.rad2deg(np.linalg.norm(quaternion.to_rotation_vector(apart)))
            rows.append({"turn (degrees)": float(turn), "rule": rule, "error (degrees)": float(degrees)})
    return rows


def _precision_words(scales: Sequence[Row], turns: Sequence[Row]) -> list[str]:
    words = []
    for backend in dict.fromkeys(row["backend"] for row in scales):
        errors = [row["error"] for row in scales if row["backend"] == backend]
        words.append(
            f"In worlds of {SCALES[0]:g} to {SCALES[-1]:g} times the size the float32 picture of `{backend}` is"
            f" {min(errors):.1e} to {max(errors):.1e} off that of float64."
        )
    worst = {
        rule: max((row for row in turns if row["rule"] == rule), key=lambda row: row["error (degrees)"])
        for rule in ("ours", "w >= 0")
    }
    ours, theirs = worst["ours"], worst["w >= 0"]
    words.append(
        f"A blend is at most {ours['error (degrees)']:.1e} degrees off, at any turn; without care for signs it is"
        f" {theirs['error (degrees)']:.0f} degrees off at {theirs['turn (degrees)']:g}."
    )
    return words
