"""Times the forms of the deformation against each other: `f4x bench deform`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from f4x_core.geometry import pose, quaternion
from f4x_core.native import open_library
from f4x_core.progress import Progress, silent
from f4x_core.scaffold.deformation import blend, blend_reference, move_gaussians, relative_motions
from f4x_core.scaffold.deformation.sparse import Deformer

from ..timing import measure_in_turn

NODES, FRAMES, NEIGHBOURS = 1000, 8, 8
# Nodes turn by at most this share of 180 degrees: no two differ by half a turn, where the sign rules of the forms part.
TURN = 0.45


def benchmark(
    counts: Sequence[int] = (50_000, 100_000), repeats: int = 5, progress: Progress = silent
) -> dict[str, Any]:
    """Measure the blend of N Gaussians with 8 of 1000 nodes, all forms in turn `repeats` times, one thread.

    Returns:
        `timings`: list of name, gaussians, neighbours, ms (medians of wall times). `ratios`: gather / CSR and numpy /
        native. `errors`: largest difference of the poses from float64, per form.
    """
    timings: list[dict[str, Any]] = []
    ratios: dict[str, float] = {}
    errors: dict[str, float] = {}
    for done, count in enumerate(counts):
        progress("bench deform", done, len(counts), f"{count:,} Gaussians")
        forms, checks = _forms(count)
        milliseconds = dict(zip(forms, (1e3 * s for s in measure_in_turn(list(forms.values()), repeats)), strict=True))
        for name, ms in milliseconds.items():
            timings.append({"name": name, "gaussians": count, "neighbours": NEIGHBOURS, "ms": ms})
        ratios[f"gather / CSR, {count} Gaussians"] = (
            milliseconds["gather, with backward"] / milliseconds["CSR, with backward"]
        )
        if "native forward" in milliseconds:
            ratios[f"numpy / native, {count} Gaussians"] = (
                milliseconds["numpy forward"] / milliseconds["native forward"]
            )
        errors |= {name: max(error, errors.get(name, 0.0)) for name, error in checks.items()}
    return {"timings": timings, "ratios": ratios, "errors": errors}


def _forms(count: int) -> tuple[dict[str, Any], dict[str, float]]:
    """Functions to time, by name, and the largest error of each form's poses."""
    rng = np.random.default_rng(0)
    times = np.arange(float(FRAMES))
    axis = rng.normal(size=(NODES, 3))
    axis *= TURN * np.pi * rng.uniform(size=(NODES, 1)) / np.linalg.norm(axis, axis=1, keepdims=True)
    phase = np.linspace(0, 1, FRAMES)[:, None, None]
    quat = quaternion.from_rotation_vector(phase * axis).astype(np.float32)
    xyz = (rng.normal(size=(1, NODES, 3)) + 0.2 * phase * axis).astype(np.float32)
    neighbours = rng.integers(0, NODES, (count, NEIGHBOURS))
    weights = rng.uniform(0.1, 1, (count, NEIGHBOURS)).astype(np.float32)
    weights /= weights.sum(1, keepdims=True)
    strength = np.ones(count, np.float32)
    means = rng.normal(size=(count, 3)).astype(np.float32)
    quats = quaternion.normalize(rng.normal(size=(count, 4))).astype(np.float32)
    deformer = Deformer(times, np.zeros(count, np.int64), neighbours, NODES)
    pairs, last = deformer.pairs, times[-1]
    table = relative_motions(times, xyz, quat, pairs, last)
    place, turn = (torch.from_numpy(a).requires_grad_() for a in (xyz, quat))
    weight = torch.from_numpy(weights).requires_grad_()
    index = torch.from_numpy(pairs.index)

    def gather() -> None:
        motions = relative_motions(times, place, turn, pairs, last)
        q, t = blend_reference(motions[index], weight, torch.ones(count))
        torch.autograd.grad(q.sum() + t.sum(), [place, turn, weight])

    def sparse() -> None:
        q, t = deformer(place, turn, weight, None, last)
        torch.autograd.grad(q.sum() + t.sum(), [place, turn, weight])

    def through_numpy() -> tuple[np.ndarray, np.ndarray]:
        rotation, xyz = pose.compose(*blend(table, pairs.index, weights, strength), quats, means)
        return xyz, rotation

    def through_library() -> tuple[np.ndarray, np.ndarray]:
        return move_gaussians(table, pairs.index, weights, strength, means, quats)

    wide = relative_motions(times, xyz.astype(float), quat.astype(float), pairs, last)
    moved = blend_reference(wide[pairs.index], weights.astype(float), strength.astype(float))
    turned, exact = pose.compose(*moved, quats.astype(float), means.astype(float))
    forms: dict[str, Any] = {
        "gather, with backward": gather,
        "CSR, with backward": sparse,
        "numpy forward": through_numpy,
    }
    answers = {"numpy forward": through_numpy()}
    if open_library()[0] is not None:
        forms["native forward"] = through_library
        answers["native forward"] = through_library()
    errors = {name: float(max(abs(a - exact).max(), abs(b - turned).max())) for name, (a, b) in answers.items()}
    return forms, errors
