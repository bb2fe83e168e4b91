"""Profiles a step of the fit by function, serial against shareable milliseconds: `f4x bench step --clip CLIP`."""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path
from typing import Any

import torch

from f4x_core.adam import Adam
from f4x_core.clip import Clip
from f4x_core.errors import F4xError
from f4x_core.fit import model
from f4x_core.fit import trainer as trainer_module
from f4x_core.fit.config import profile
from f4x_core.fit.frame_native import NativeFrameLosses
from f4x_core.fit.pipeline import ClipFit
from f4x_core.fit.trainer import Trainer
from f4x_core.gaussians.appearance_native import NativeDrawing
from f4x_core.native import open_library, shareable_seconds
from f4x_core.progress import Progress, silent
from f4x_core.raster.native import autograd as raster
from f4x_core.scaffold.deformation.native import autograd as deformation
from f4x_core.scaffold.motion_native import NativeMotion

REST = "rest of the step"
PARTS: tuple[tuple[str, Any, tuple[str, ...]], ...] = (
    ("deformation", model.SceneModel, ("dynamic_at",)),
    ("deformation", deformation._Deformation, ("backward",)),
    ("activations and colours", model.SceneModel, ("drawn",)),
    ("activations and colours", NativeDrawing, ("backward",)),
    ("cameras", model.CameraRig, ("camera", "smoothness")),
    ("cameras", model.CorrectedView, ("backward",)),
    ("raster", trainer_module, ("rasterize",)),
    ("raster", raster._Rasterize, ("backward",)),
    ("losses", trainer_module, ("total_loss",)),
    ("losses", NativeFrameLosses, ("backward",)),
    ("losses", NativeMotion, ("backward",)),
    ("Adam", Adam, ("step",)),
    ("density statistics", Trainer, ("_record_gradients",)),
    ("torch's gradients", torch.Tensor, ("backward",)),
    (REST, Trainer, ("train_step",)),
)
"""Part of a step -> functions whose own time, without that of the parts they call, it is."""


@dataclass
class StepClock:
    """Own processor seconds of every part of one step, all and shareable."""

    seconds: dict[str, list[float]] = field(default_factory=lambda: defaultdict(lambda: [0.0, 0.0]))
    _inner: list[list[float]] = field(default_factory=list)

    @staticmethod
    def _now() -> tuple[float, float]:
        library, _ = open_library()
        assert library is not None
        return time.thread_time(), shareable_seconds(library)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count what happens within for `name`, but for the parts within it."""
        start = self._now()
        self._inner.append([0.0, 0.0])
        try:
            yield
        finally:
            passed = [now - before for now, before in zip(self._now(), start, strict=True)]
            inner = self._inner.pop()
            for k in (0, 1):
                self.seconds[name][k] += passed[k] - inner[k]
                if self._inner:
                    self._inner[-1][k] += passed[k]

    @contextmanager
    def watching(self, trainer: Trainer) -> Iterator[None]:
        """The functions of `PARTS` and the actions of `trainer` are timed within."""
        before = [(owner, name, owner.__dict__[name]) for _, owner, names in PARTS for name in names]
        actions = trainer.actions
        try:
            for part, owner, names in PARTS:
                for name in names:
                    setattr(owner, name, self._timed(part, owner.__dict__[name]))
            every_step = ("learning rates", "skinning offsets learnt")
            trainer.actions = [
                action if action.name.startswith(every_step) else replace(action, run=self._timed(action.name, action.run))
                for action in actions
            ]
            yield
        finally:
            trainer.actions = actions
            for owner, name, function in before:
                setattr(owner, name, function)

    def _timed(self, part: str, function: Any) -> Any:
        static = isinstance(function, staticmethod)
        plain = function.__func__ if static else function

        @wraps(plain)
        def timed(*args: Any, **named: Any) -> Any:
            with self.part(part):
                return plain(*args, **named)

        return staticmethod(timed) if static else timed


def profile_steps(clip: Clip, folder: Path, name: str, progress: Progress = silent) -> dict[str, Any]:
    """Fit `clip` by the profile `name` on one thread, its priors kept in `folder`, and time every part of its steps.

    Returns:
        `parts`: rows of part, ms (one thread), shareable_ms and serial_ms. Parts of every step are medians of the steps at
        full size; actions that happen now and then are means over all steps. `gaussians`: at the middle step.
    """
    if open_library()[0] is None:
        raise F4xError("bench step profiles the compiled library, which is not built: run `python -m f4x_core.native.build`.")
    trainer = _start(clip, folder, name, 1, progress)
    parts = {part for part, _, _ in PARTS}
    rows: list[dict[str, list[float]]] = []
    total: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    counts = []
    while trainer.step < trainer.config.steps:
        clock = StepClock()
        full = trainer.fraction >= trainer.config.coarse
        with clock.watching(trainer):
            trainer.train_step()
        if full:
            rows.append({part: own for part, own in clock.seconds.items() if part in parts})
            counts.append(len(trainer.model))
        for part, own in clock.seconds.items():
            if part not in parts:
                total[part] = [a + b for a, b in zip(total[part], own, strict=True)]
        progress("bench step", trainer.step, trainer.config.steps, f"{len(trainer.model):,} Gaussians")
    found = {part: _median([row.get(part, [0.0, 0.0]) for row in rows]) for part in dict.fromkeys(p for p, _, _ in PARTS)}
    found["now and then: " + ", ".join(sorted(total))] = [
        1e3 * sum(own[k] for own in total.values()) / trainer.config.steps for k in (0, 1)
    ]
    table = [
        {"part": part, "ms": ms, "shareable_ms": shared, "serial_ms": ms - shared} for part, (ms, shared) in found.items()
    ]
    sums = {key: sum(row[key] for row in table) for key in ("ms", "shareable_ms", "serial_ms")}
    return {
        "parts": sorted(table, key=lambda row: -row["serial_ms"]),
        **sums,
        "gaussians": int(statistics.median(counts)),
        "width": clip.width,
        "height": clip.height,
    }


def _median(rows: list[list[float]]) -> tuple[float, float]:
    """Milliseconds, all and shareable. A part of every n-th step alone counts by its mean."""
    often = statistics.median(row[0] for row in rows) > 0
    middle = statistics.median if often else statistics.fmean
    return 1e3 * middle(row[0] for row in rows), 1e3 * middle(row[1] for row in rows)


def _start(clip: Clip, folder: Path, name: str, threads: int, progress: Progress) -> Trainer:
    fit = ClipFit(clip, folder, replace(profile(name), threads=threads), progress)
    return fit.start(fit.make_priors())
