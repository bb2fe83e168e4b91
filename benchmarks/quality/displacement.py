"""The reach beside the path of the depth of a scene, by the truth of a rendered clip: the check of `metrics.believed`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from f4x_core.evaluation.truth import TrueClip
from f4x_core.geometry import trajectory
from f4x_core.geometry.arrays import evenly_spaced
from f4x_core.geometry.camera import Camera, CameraPath
from f4x_core.metrics.believed import MAX_DEGREES, TOLERANCE, Believed
from f4x_core.priors.synthetic import BACKGROUND_DEPTH, read_passes
from f4x_core.scene import Scene
from f4x_core.scene.view import render

# Frames looked at, the first and the last left out, and the step in which the angle is found.
FRAMES, STEP_DEGREES = 6, 0.5


@dataclass(frozen=True)
class DepthAgainstTruth:
    """One frame: how deep things are and how deep they should be, in the true world's unit."""

    camera: Camera
    """The true one."""
    true: np.ndarray
    """(H,W) z depth, NaN for the background at infinity."""
    depth: np.ndarray
    """(H,W) that of the scene, in any unit; NaN where it has none."""
    moving: np.ndarray
    """(H,W) bool, by the truth."""


def displacement(frame: DepthAgainstTruth, region: np.ndarray, degrees: float) -> float:
    """Median distance (picture widths) by which wrong depth displaces a `region (H,W)` seen from `degrees` to the right.

    The unit of the scene is that of its median static depth, so that only the shape counts; the camera swings about the median
    true depth. What the scene does not show at all is displaced without limit. NaN where nothing of the region is in that view.
    """
    known = np.isfinite(frame.true)
    both = known & np.isfinite(frame.depth)
    reference = both & ~frame.moving if (both & ~frame.moving).any() else both
    depth = frame.depth * (np.median(frame.true[reference]) / np.median(frame.depth[reference]))
    pixels, chosen = frame.camera.pixel_grid(), known & region
    path = CameraPath(
        frame.camera.intrinsics[None],
        frame.camera.world_to_camera[None],
        np.zeros(1),
        frame.camera.width,
        frame.camera.height,
    )
    aside = trajectory.aside(path, 0.0, right=degrees, depth=float(np.median(frame.true[known]))).camera
    there, ahead = aside.project(frame.camera.unproject(pixels[chosen], frame.true[chosen]))
    lands, before = aside.project(frame.camera.unproject(pixels[chosen], depth[chosen]))
    inside = (ahead > 0) & (there >= 0).all(-1) & (there < [aside.width, aside.height]).all(-1)
    if not inside.any():
        return float("nan")
    missed = np.where(np.isfinite(before) & (before > 0), np.linalg.norm(lands - there, axis=-1), np.inf)[inside]
    return float(np.median(missed)) / aside.width


def true_believed_degrees(frames: Sequence[DepthAgainstTruth], tolerance: float = TOLERANCE) -> Believed:
    """Angles from which on the mean over frames of `displacement` is more than `tolerance`; at most `MAX_DEGREES`."""

    def limit(regions: list[np.ndarray]) -> float:
        for degrees in np.arange(STEP_DEGREES, MAX_DEGREES, STEP_DEGREES):
            missed = [displacement(frame, region, degrees) for frame, region in zip(frames, regions, strict=True)]
            if not np.isnan(missed).all() and np.nanmean(missed) > tolerance:
                return float(degrees)
        return MAX_DEGREES

    static = limit([~frame.moving for frame in frames])
    has_movers = any((frame.moving & np.isfinite(frame.true)).any() for frame in frames)
    return Believed(static, limit([frame.moving for frame in frames]) if has_movers else None)


def read_depths(scene: Scene, truth_folder: Path | str, backend: str = "auto") -> list[DepthAgainstTruth]:
    """Depth of `scene` against that of the rendered clip in `truth_folder`, at some used frames.

    F4xError: no truth there, or that of another clip.
    """
    clip = TrueClip.read(scene, truth_folder)
    chosen = clip.used[evenly_spaced(len(clip.used), FRAMES, ends=False)]
    frames = []
    for index in chosen:
        passes = read_passes(clip.folder / "truth" / f"{index:05d}.exr")
        camera = clip.path[int(index)]
        own = scene.cameras[int(index)].resized(camera.width, camera.height)
        depth = render(scene, own, float(scene.cameras.times[index]), ("depth",), backend)["depth"].astype(np.float64)
        true = np.where(passes["Depth"] < BACKGROUND_DEPTH, passes["Depth"], np.nan).astype(np.float64)
        moving = np.isin(passes["Object Index"].round(), clip.moving_index)
        frames.append(DepthAgainstTruth(camera, true, depth, moving))
    return frames
