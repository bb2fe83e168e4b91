"""Scores a scene against its clip: used frames, held-out frames with registered or refined camera, simple baselines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..clip import Clip
from ..errors import F4xError
from ..files import json_text, replace_file
from ..gaussians import appearance
from ..gaussians.camera_rig import CameraRig
from ..geometry.camera import Camera, CameraPath
from ..metrics.pictures import psnr, ssim
from ..native.kernels import torch_threads
from ..parallel import in_threads, side_by_side
from ..progress import Progress, silent
from ..raster import rasterize
from ..scene import Scene, write_scene
from .perceptual_distance import lpips
from .registration import halfway_offset, register_camera

# Mean squared errors below this count as equal images; keeps the logarithm finite.
MIN_ERROR = 1e-12
# Pixels with this much dynamic alpha belong to the moving region.
MOVING_ALPHA = 0.5
# Figures that come first where all are listed.
LEADING = ("psnr", "psnr_registered", "psnr_flow_blend_registered")
# Smaller masks (fraction of the picture) do not judge a moving object: a few pixels at its edge are all they hold.
MIN_MASK = 1e-3


@dataclass(frozen=True)
class Refinement:
    """Settings for refining a camera so that the render matches an image; the scene stays fixed."""

    steps: int = 60
    """Steps of Adam."""
    rate: float = 1e-3
    """Learning rate at the start: radians, and world units (median depth 1)."""
    last_rate: float = 1e-4
    """Learning rate at the last step."""
    hold: int = 0
    """Steps before the rate begins to fall, along a cosine."""
    min_alpha: float = 0.0
    """Pixels with less alpha than this do not count."""


class FrozenMoment:
    """The Gaussians of a scene at one time as tensors, ready to be drawn from cameras with gradients."""

    def __init__(self, scene: Scene, time: float, backend: str = "auto"):
        """Pose the scene at clip time `time`."""
        posed = scene.posed(time)
        self.splats = posed.map(lambda array: torch.from_numpy(np.ascontiguousarray(array)))
        self.dynamic = torch.from_numpy(posed.dynamic).float()
        self.backend = backend

    def draw(self, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
        """Return rgb (H,W,3), the dynamic alpha and the alpha (H,W) seen from `camera`."""
        splats = self.splats
        centre = torch.as_tensor(camera.center, dtype=torch.float32).detach()
        rgb = appearance(splats.sh, splats.means, splats.quats, centre)
        colors = torch.cat([rgb, self.dynamic[:, None]], 1)
        out = rasterize(splats, colors, camera, backend=self.backend)
        return out.channels[..., :3].clamp(0, 1), out.channels[..., 3], out.alpha


@dataclass(frozen=True, eq=False)
class Figures:
    """The measures of `evaluate` besides PSNR and SSIM."""

    refine_camera: bool = False
    """Held-out figures with the camera refined on that very frame; the scene stays as it is."""
    baselines: bool = False
    """Held-out figures of two baselines that know no 3D: the nearest used frame, and the half-way blend of its two flow-warped
    neighbours, also with the registered camera."""
    perceptual: bool = False
    """LPIPS, where it can run."""
    masks: Mapping[int, np.ndarray] | None = None
    """Clip frame -> (H,W) bool of moving objects by the priors or a person: adds `mask_scores`."""


def evaluate(
    scene: Scene, clip: Clip, figures: Figures | None = None, backend: str = "auto", progress: Progress = silent
) -> dict[str, Any]:
    """Compare every frame of `clip` with the scene's picture of it.

    Returns per-frame and mean PSNR (dB; the mean is over frames) and SSIM for used and held-out frames, PSNR of the moving
    and of the static region, the held-out figures with the camera registered by flow and depth (`registration`), and those
    that `figures` ask for.

    Raises:
        F4xError: clip and scene differ in frame count or size.
    """
    cameras = scene.cameras
    if len(clip) != len(cameras) or (clip.width, clip.height) != (cameras.width, cameras.height):
        fitted = scene.fitted_frames
        raise F4xError(
            f"{clip.source}: the clip has {len(clip)} frames of {clip.width}x{clip.height}, the scene {len(cameras)} of"
            f" {cameras.width}x{cameras.height}; give the clip that was fitted{f', with --frames {fitted}' if fitted else ''}."
        )
    figures = figures or Figures()

    def scores(index: int) -> dict[str, Any]:
        return _frame_scores(scene, clip, index, figures, backend)

    def report(done: int) -> None:
        progress("evaluate", done, len(clip))

    # Torch's sums depend on its number of threads: a frame has one, and several frames are compared side by side.
    with side_by_side(torch.get_num_threads()), torch_threads(1):
        frames = in_threads(scores, range(len(clip)), report)
    return {"frames": frames, **summary(frames)}


def _frame_scores(scene: Scene, clip: Clip, index: int, figures: Figures, backend: str) -> dict[str, Any]:
    """Return the scores of frame `index`."""
    held_out, time = set(scene.held_out), float(scene.cameras.times[index])
    moment = FrozenMoment(scene, time, backend)
    target, seen = frame_of(clip, index)
    rig = CameraRig(scene.cameras.at_times([time]))
    with torch.no_grad():
        image, moving, _ = moment.draw(rig.camera(0, clip.width, clip.height))
    target = target if seen is None else torch.where(seen[..., None] > 0, target, image)
    region = (moving > MOVING_ALPHA).float()
    row: dict[str, Any] = {
        "frame": index,
        "held_out": index in held_out,
        "psnr": psnr(image, target, seen),
        "ssim": ssim(image, target),
        "psnr_moving": psnr(image, target, within(region, seen)),
        "psnr_static": psnr(image, target, within(1 - region, seen)),
    }
    distance = lpips(image.numpy(), target.numpy()) if figures.perceptual else None
    if distance is not None:
        row["lpips"] = distance
    mask = None if figures.masks is None else figures.masks.get(index)
    if row["held_out"]:
        row |= registered_scores(scene, clip, index, moment, figures.baselines, mask)
    elif mask is not None:
        row |= mask_scores(image, moving, target, mask)
    if row["held_out"] and figures.refine_camera:
        row["psnr_refined"] = psnr(refine(moment, rig, target)[0], target)
    if row["held_out"] and figures.baselines:
        row |= baseline_scores(clip, index, held_out)
    return row


def frame_of(clip: Clip, index: int) -> tuple[Tensor, Tensor | None]:
    """Return frame `index` (H,W,3) in [0,1], and (H,W) float32, 1 where it was seen; None in its place where all of it was."""
    seen = None if clip.hidden is None else torch.from_numpy(~clip.hidden[index]).float()
    return torch.from_numpy(clip.frames[index].astype(np.float32) / 255), seen


def within(region: Tensor, seen: Tensor | None) -> Tensor:
    """Return the part of a region (H,W) that was seen."""
    return region if seen is None else region * seen


def summary(frames: list[dict[str, Any]]) -> dict[str, float]:
    """Return the means over used and held-out frames of every figure in the rows, LEADING first; NaN (no region) is left out."""
    result: dict[str, float] = {}
    for group, held_out in (("used", False), ("held_out", True)):
        rows = [row for row in frames if row["held_out"] == held_out]
        names = {name for row in rows for name in row} - {"frame", "held_out"}
        for name in sorted(names, key=lambda name: (name not in LEADING, name)):
            values = np.array([row[name] for row in rows if name in row], np.float64)
            if np.isfinite(values).any():
                result[f"{group}_{name}"] = float(np.nanmean(values))
    return result


def without_frames(metrics: dict[str, Any]) -> dict[str, Any]:
    """Return the result of `evaluate` without its rows for single frames."""
    return {name: value for name, value in metrics.items() if name != "frames"}


def keep_measured(folder: Path, scene: Scene, metrics: dict[str, Any], **more: Any) -> tuple[Scene, dict[str, Any]]:
    """Write `folder/scene.f4x` with the metrics of `evaluate`, and `folder/metrics.json` with the metrics, `more` and all frames.

    Returns the scene with its metrics, and the content of `metrics.json` without the frames.
    """
    scene = replace(scene, metrics=without_frames(metrics) | {"gaussians": len(scene.static) + len(scene.dynamic)})
    write_scene(scene, folder / "scene.f4x")
    figures = {**scene.metrics, **more}
    with replace_file(folder / "metrics.json") as file:
        file.write(json_text({**figures, "frames": metrics["frames"]}, indent=1).encode())
    return scene, figures


def refine(
    moment: FrozenMoment, rig: CameraRig, target: Tensor, settings: Refinement | None = None
) -> tuple[Tensor, Camera]:
    """Refine the camera of a one-frame rig so that the render matches `target` (H,W,3) in [0,1]; the scene stays fixed.

    Returns the image (H,W,3) and the camera of the step with the best PSNR over covered pixels.
    """
    settings = settings or Refinement()
    height, width = target.shape[:2]
    parameters = [rig.parameters["camera_rotation"], rig.parameters["camera_position"]]
    optimiser = torch.optim.Adam(parameters, lr=settings.rate)
    falling = max(settings.steps - settings.hold, 1)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, falling, settings.last_rate)
    best, best_error = None, math.inf
    for step in range(settings.steps + 1):
        image, _, alpha = moment.draw(rig.camera(0, width, height))
        covered = (alpha.detach() >= settings.min_alpha).float()
        error = ((image - target).square().mean(-1) * covered).sum() / covered.sum().clamp_min(1)
        value = float(error.detach())
        if value < best_error:
            best, best_error = (image.detach(), rig.refined()[0]), value
        optimiser.zero_grad()
        error.clamp_min(MIN_ERROR).log().backward()
        optimiser.step()
        if step >= settings.hold:
            schedule.step()
    assert best is not None
    return best


def mask_scores(image: Tensor, moving: Tensor, target: Tensor, mask: np.ndarray) -> dict[str, float]:
    """Return the scores of moving objects over a mask (H,W) that does not depend on the scene; empty if the mask is too small.

    `psnr_mask` (dB) compares the pictures (H,W,3), `mover_coverage` is the mean dynamic alpha `moving (H,W)`.
    """
    if mask.mean() < MIN_MASK:
        return {}
    region = torch.from_numpy(np.ascontiguousarray(mask))
    return {
        "psnr_mask": psnr(image, target, region.float()),
        "mover_coverage": float(moving[region].clamp(0, 1).mean()),
    }


def registered_scores(
    scene: Scene,
    clip: Clip,
    index: int,
    moment: FrozenMoment,
    baselines: bool = False,
    mask: np.ndarray | None = None,
) -> dict[str, float]:
    """Return the PSNR of held-out frame `index` at its registered camera, that of the flow blend there, and how it was measured.

    `registered` is 1 where flow determines the camera; elsewhere the scene is drawn from the interpolated one, and the blend is
    the plain one. At an end of the clip, the blend is the only neighbour moved to the registered camera.
    """
    found = register_camera(scene, clip, index, moment.backend)
    target, seen = frame_of(clip, index)
    with torch.no_grad():
        image, moving, _ = moment.draw(found.camera)
    region = (moving > MOVING_ALPHA).float()
    scores = {
        "psnr_registered": psnr(image, target, seen),
        "psnr_moving_registered": psnr(image, target, within(region, seen)),
        "psnr_static_registered": psnr(image, target, within(1 - region, seen)),
        "registered": float(found.found),
        "registration_points": float(found.points),
        "registration_px": found.error_px,
        "interpolation_px": found.interpolated_error_px,
    }
    if mask is not None:
        scores |= mask_scores(image, moving, target, mask)
    neighbours = beside(len(clip), index, set(scene.held_out))
    if baselines and (found.found or len(neighbours) == 2):
        fraction = _fraction(clip, index, neighbours) if len(neighbours) == 2 else 0.0
        offset = None
        if found.found:
            offset = halfway_offset(scene, index, neighbours, fraction, found.camera, moment.backend)
        blended = blend_by_flow(clip.frames[neighbours[0]], clip.frames[neighbours[-1]], fraction, offset)
        scores["psnr_flow_blend_registered"] = psnr(torch.from_numpy(blended), target, seen)
    return scores


def beside(frames: int, index: int, held_out: set[int]) -> tuple[int, ...]:
    """Return the last used clip frame before `index` and the first after it; one of them at an end of the clip's `frames`."""
    used = [i for i in range(frames) if i not in held_out]
    before = max((i for i in used if i < index), default=None)
    after = min((i for i in used if i > index), default=None)
    return tuple(i for i in (before, after) if i is not None)


def _fraction(clip: Clip, index: int, neighbours: tuple[int, ...]) -> float:
    """Return the place in time of frame `index` between two `neighbours`, 0 to 1."""
    before, now, after = clip.times[[neighbours[0], index, neighbours[1]]]
    return float((now - before) / (after - before))


def baseline_scores(clip: Clip, index: int, held_out: set[int]) -> dict[str, float]:
    """Return the PSNR of the nearest used frame, and of a half-way flow blend of both neighbours, as pictures of frame `index`."""
    neighbours = beside(len(clip), index, held_out)
    target, seen = frame_of(clip, index)
    nearest = min(neighbours, key=lambda i: abs(clip.times[i] - clip.times[index]))
    scores = {"psnr_nearest": psnr(frame_of(clip, nearest)[0], target, seen)}
    if len(neighbours) == 2:
        before, after = neighbours
        blended = blend_by_flow(clip.frames[before], clip.frames[after], _fraction(clip, index, neighbours))
        scores["psnr_flow_blend"] = psnr(torch.from_numpy(blended), target, seen)
    return scores


def blend_by_flow(
    before: np.ndarray, after: np.ndarray, fraction: float, offset: np.ndarray | None = None
) -> np.ndarray:
    """Return (H,W,3) float32 in [0,1]: two (H,W,3) uint8 frames warped along DIS flow to `fraction` of the way, and blended.

    `offset (H,W,2)`: pixels from where the picture shows a point to where the blend has it (`registration.halfway_offset`).
    """
    import cv2

    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey_before, grey_after = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (before, after))
    forward = flow.calc(grey_before, grey_after, None)
    backward = flow.calc(grey_after, grey_before, None)
    height, width = grey_before.shape
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(np.float32)
    start = grid if offset is None else grid + offset

    def look_up(image: np.ndarray, place: np.ndarray) -> np.ndarray:
        return cv2.remap(image, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def warp(frame: np.ndarray, motion: np.ndarray) -> np.ndarray:
        return look_up(frame, start + (motion if offset is None else look_up(motion, start))) / 255.0

    # The flow at the middle is taken from the same pixel of either end: good to first order, and plain.
    mixed = (1 - fraction) * warp(before, fraction * backward) + fraction * warp(after, (1 - fraction) * forward)
    return mixed.astype(np.float32)


def path_error(estimated: CameraPath, truth: CameraPath) -> dict[str, float]:
    """Return the absolute trajectory error after a similarity alignment: RMSE over the true path's length, and in world units."""
    from ..geometry.pose import align_similarity

    scale, rotation, translation = align_similarity(estimated.centers, truth.centers)
    aligned = scale * estimated.centers @ rotation.T + translation
    rmse = float(np.sqrt(np.mean(np.sum((aligned - truth.centers) ** 2, 1))))
    length = float(np.linalg.norm(np.diff(truth.centers, axis=0), axis=1).sum())
    return {"ate": rmse, "ate_fraction": rmse / max(length, 1e-12), "path_length": length, "scale": float(scale)}
