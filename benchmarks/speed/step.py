"""Profiles a step of the fit by function, serial against shareable milliseconds: `f4x bench step --clip CLIP`."""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple

import torch

from f4x_core.clip import Clip
from f4x_core.errors import F4xError
from f4x_core.fit import model
from f4x_core.fit import trainer as trainer_module
from f4x_core.fit.config import profile
from f4x_core.fit.frame_native import NativeFrameLosses
from f4x_core.fit.pipeline import ClipFit
from f4x_core.fit.trainer import Trainer
from f4x_core.gaussians import camera_rig
from f4x_core.gaussians.appearance_native import NativeDrawing
from f4x_core.native import open_library, shareable_seconds
from f4x_core.progress import Progress, silent
from f4x_core.raster.native import autograd as raster
from f4x_core.scaffold.adam import Adam
from f4x_core.scaffold.deformation.native import autograd as deformation
from f4x_core.scaffold.motion_native import NativeMotion

REST = "rest of the step"
PARTS: tuple[tuple[str, Any, tuple[str, ...]], ...] = (
    ("deformation", model.SceneModel, ("dynamic_at",)),
    ("deformation", deformation._Deformation, ("backward",)),
    ("activations and colours", model.SceneModel, ("drawn",)),
    ("activations and colours", NativeDrawing, ("backward",)),
    ("cameras", camera_rig.CameraRig, ("camera", "smoothness")),
    ("cameras", camera_rig.CorrectedView, ("backward",)),
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


PART_NAMES = tuple(dict.fromkeys(part for part, _, _ in PARTS))
BLOCK = 4
"""Steps that are timed alike before the others' turn: some losses count at every second or fourth step alone."""
EVERY_STEP = ("learning rates", "skinning offsets learnt")
"""Actions that belong to every step."""


class Seconds(NamedTuple):
    """Processor time of the thread that trains."""

    all: float = 0.0
    shareable: float = 0.0
    """Spent in the compiled library on work that threads can share."""

    @classmethod
    def now(cls) -> Seconds:
        """Clocks and counts since the start."""
        library, _ = open_library()
        assert library is not None
        return cls(time.thread_time(), shareable_seconds(library))

    def __add__(self, other: Seconds) -> Seconds:  # type: ignore[override]  # numbers, not a sequence
        return Seconds(self.all + other.all, self.shareable + other.shareable)

    def __sub__(self, other: Seconds) -> Seconds:
        return Seconds(self.all - other.all, self.shareable - other.shareable)

    def __truediv__(self, count: int) -> Seconds:
        return Seconds(self.all / count, self.shareable / count)


@dataclass
class StepClock:
    """Own time of every part of one step."""

    seconds: dict[str, Seconds] = field(default_factory=lambda: defaultdict(Seconds))
    _inner: list[Seconds] = field(default_factory=list)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count what happens within for `name`, but for the parts within it."""
        start = Seconds.now()
        self._inner.append(Seconds())
        try:
            yield
        finally:
            passed = Seconds.now() - start
            self.seconds[name] += passed - self._inner.pop()
            if self._inner:
                self._inner[-1] += passed

    @contextmanager
    def watching(self, trainer: Trainer, parts: Sequence[tuple[str, Any, tuple[str, ...]]]) -> Iterator[None]:
        """The functions of `parts` and the rare actions of `trainer` are timed within."""
        before = [(owner, name, owner.__dict__[name]) for _, owner, names in parts for name in names]
        actions = trainer.actions
        try:
            for part, owner, names in parts:
                for name in names:
                    setattr(owner, name, self._timed(part, owner.__dict__[name]))
            trainer.actions = [
                action
                if action.name.startswith(EVERY_STEP)
                else replace(action, run=self._timed(action.name, action.run))
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
    """Fit `clip` by the profile `name` on one thread, its priors kept in `folder`, and time its steps.

    Returns:
        `parts`: rows of part, ms (one thread), shareable_ms and serial_ms, means of half of the steps at full size. `step`: the
        same of the other half, of which nothing but the whole is timed.
        `actions`: the same of what happens now and then, a mean over all steps. `gaussians`: at the middle step.

    Raises:
        F4xError: the compiled library is not built.
    """
    if open_library()[0] is None:
        raise F4xError(
            "bench step profiles the compiled library, which is not built: run `python -m f4x_core.native.build`."
        )
    fit = ClipFit(clip, folder, replace(profile(name), threads=1), progress)
    trainer = fit.start(fit.make_priors())
    every_step = set(PART_NAMES)
    by_part: list[dict[str, Seconds]] = []
    whole: list[Seconds] = []
    actions, counts = Seconds(), []
    while trainer.step < trainer.config.steps:
        clock, start = StepClock(), Seconds.now()
        in_parts = trainer.step // BLOCK % 2 == 1
        with clock.watching(trainer, PARTS if in_parts else ()):
            trainer.train_step()
        passed = Seconds.now() - start
        for part, own in clock.seconds.items():
            if part not in every_step:
                actions, passed = actions + own, passed - own
        if trainer.fraction >= trainer.config.coarse:
            counts.append(len(trainer.model))
            if in_parts:
                by_part.append(clock.seconds)
            else:
                whole.append(passed)
        progress("bench step", trainer.step, trainer.config.steps, f"{len(trainer.model):,} Gaussians")
    rows = [_row(part, [own.get(part, Seconds()) for own in by_part]) for part in PART_NAMES]
    return {
        "parts": sorted(rows, key=lambda row: -row["serial_ms"]),
        "step": _row("a step", whole),
        "actions": _row("now and then", [actions / trainer.config.steps]),
        "gaussians": int(statistics.median(counts)),
        "width": clip.width,
        "height": clip.height,
    }


def _row(part: str, seconds: Sequence[Seconds]) -> dict[str, Any]:
    """Milliseconds of a part."""
    ms, shareable = (1e3 * statistics.fmean(getattr(own, kind) for own in seconds) for kind in ("all", "shareable"))
    return {"part": part, "ms": ms, "shareable_ms": shareable, "serial_ms": ms - shareable}
