"""Fits a film through the whole pipeline with a very small profile, and asks what the program says about it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from f4x_core.clip import Clip
from f4x_core.errors import F4xError
from f4x_core.fit.advice import findings
from f4x_core.fit.config import FitConfig, profile
from f4x_core.fit.pipeline import FitResult, fit_clip
from f4x_core.priors import Priors
from f4x_core.report.evaluation import evaluate
from f4x_core.report.studies.hard_cases import Check, that, told
from f4x_core.scene import Scene

STEPS = 120
GOOD_PSNR = 26.0
"""dB on unseen frames: an ordinary film of this size comes out at 29 to 31, the nearest used frame scores 20."""


def small(**priors: Any) -> FitConfig:
    """The quick profile made as small as these films; `priors` are its files (`depth=folder`, ...)."""
    config = profile("quick")
    cameras = replace(config.priors.cameras, solver="tracks")  # pycolmap wants larger pictures, and seconds to start
    tracks = replace(config.priors.tracks, count=1200)
    files = {name: str(path) for name, path in priors.items()}
    return replace(
        config,
        steps=STEPS,
        threads=1,
        checkpoint_every=10**6,
        measure_every=STEPS,
        priors=replace(config.priors, tracks=tracks, cameras=cameras, files=files),
        scaffold=replace(config.scaffold, most_nodes=24, geometry_steps=40),
        spawn_static=replace(config.spawn_static, most=1500),
        spawn_dynamic=replace(config.spawn_dynamic, most=500),
        density_static=replace(config.density_static, most=2000),
        density_dynamic=replace(config.density_dynamic, most=800),
    )


@dataclass(frozen=True)
class Fitted:
    """A fitted film and what was measured and said about it."""

    result: FitResult
    scene: Scene
    metrics: dict[str, Any]

    @property
    def priors(self) -> Priors:
        """What the fit was given."""
        return self.result.priors

    @property
    def said(self) -> list[str]:
        """The sentences of the diagnostics page that are no praise."""
        found = findings(self.priors, self.result.scaffold, self.metrics)
        return [finding.what for finding in found if finding.weight != "good"]

    @property
    def psnr(self) -> float:
        """Of unseen frames, dB."""
        return self.metrics["held_out_psnr"]


def fit(clip: Clip, **priors: Any) -> Fitted:
    """Priors, fit and evaluation; `priors` are arrays or files that the user gives."""
    with tempfile.TemporaryDirectory() as folder:
        files = {name: _file(Path(folder) / name, value) for name, value in priors.items()}
        try:
            result = fit_clip(clip, Path(folder) / "fit", small(**files))
        except F4xError as reason:  # without the name of a folder that is another one every time
            raise F4xError(str(reason).replace(folder, "films")) from reason
    scene = result.scene(clip)
    return Fitted(result, scene, evaluate(scene, clip))


def _file(path: Path, value: Any) -> Path:
    """An array as `.npy`, a camera path as `.json`."""
    path = path.with_suffix(".npy" if isinstance(value, np.ndarray) else ".json")
    if isinstance(value, np.ndarray):
        np.save(path, value)
    else:
        value.write(path)
    return path


def judge(fitted: Fitted, cause: str = "", least: float = GOOD_PSNR) -> Iterator[Check]:
    """Finite arrays; a good picture of unseen frames, or a sentence that matches `cause`."""
    scene = fitted.scene
    arrays = [scene.static.xyz, scene.static.scale, scene.dynamic.xyz, scene.cameras.world_to_camera]
    yield that("every array is finite", all(np.isfinite(array).all() for array in arrays))
    if fitted.psnr >= least or not cause:
        yield Check(
            f"unseen frames, error in share of {least:g} dB",
            "right" if fitted.psnr >= least else "wrong",
            error=10 ** ((least - fitted.psnr) / 10),
            allowed=1.0,
        )
    else:
        yield told(f"{fitted.psnr:.1f} dB on unseen frames, and the cause is said", cause, fitted.said)
