"""Scores that only a rendered clip allows: cameras against the true ones, and views that no camera of the clip ever had."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..clip.images import read_color, resize_color
from ..errors import F4xError
from ..fit.losses import psnr, ssim
from ..geometry.camera import Camera, CameraPath
from ..progress import Progress, silent
from ..scene import Scene
from ..scene.view import render
from .evaluation import path_error

# Rounds of the alternation between scale and rotation, and of the reweighting against wrong cameras.
ALIGN_ROUNDS = 20
# A camera this many times further off than the median one has little say in the alignment.
OUTLIER = 3.0
# Cameras that stay within this radius (root mean square, in scene units: median depth 1) do not tell the scene's unit.
SHORTEST_PATH = 1e-3

Similarity = tuple[float, np.ndarray, np.ndarray]


def score_against_truth(
    scene: Scene, truth_folder: Path | str, backend: str = "auto", progress: Progress = silent
) -> dict[str, Any]:
    """Compare `scene` with the truth of the rendered clip it was made from.

    Args:
        scene: fitted to all frames of the clip (any width, held-out frames allowed), in any world frame and unit.
        truth_folder: what `scripts/synthetic_clip.py` wrote; its extra cameras are used when it has some.

    Returns:
        `ate` (true world units), `ate_share` (of the true path), `path_length`, `rotation_error` (degrees, root mean square
        after the alignment) over supervised frames; `scale` true units per scene unit; with extra cameras
        `unseen_psnr`, `unseen_ssim` (means over frames) and `views`, one row for each of their frames. Views are left out
        when the fitted camera stands still: its unit is then unknown, and so are places in it.

    Raises:
        F4xError: no truth there, or of another clip.
    """
    folder = Path(truth_folder)
    truth = _read_truth(folder)
    true_path = CameraPath.from_json(truth["cameras"], folder / "truth.json")
    if len(true_path) != len(scene.cameras):
        raise F4xError(
            f"{folder}: the truth has {len(true_path)} frames, the scene {len(scene.cameras)}; fit all frames of the clip."
        )
    used = np.setdiff1d(np.arange(len(true_path)), scene.held_out)
    estimated, actual = _chosen(scene.cameras, used), _chosen(true_path, used)
    similarity = align_cameras(estimated, actual)
    scores: dict[str, Any] = path_error(estimated, actual)
    scores |= {"scale": similarity[0], "rotation_error": rotation_error(estimated, actual, similarity)}
    rows = []
    still = float(np.sqrt(estimated.centers.var(axis=0).sum())) < SHORTEST_PATH
    for extra in () if still else truth["extra_cameras"]:
        path = CameraPath.from_json(extra["cameras"], folder / "truth.json").resized(
            scene.cameras.width, scene.cameras.height
        )
        for index, time in enumerate(path.times):
            progress("unseen views", index, len(path), extra["name"])
            row = _score_view(
                scene, into_scene(path[index], similarity), float(time), folder / extra["images"], backend
            )
            rows.append({"camera": extra["name"], "frame": int(time), **row})
        progress("unseen views", len(path), len(path), extra["name"])
    if rows:
        scores |= {f"unseen_{name}": float(np.mean([row[name] for row in rows])) for name in ("psnr", "ssim")}
        scores["views"] = rows
    return scores


def align_cameras(estimated: CameraPath, truth: CameraPath) -> Similarity:
    """Return `(s, R (3,3), t (3,))` with `x_true = s R x_estimated + t` that brings cameras, not only centres, together.

    Centres of a straight or short path leave turns about it open, so orientations take part: the least-squares sum over
    cameras of the squared centre distance, in estimated units (where 1 is the median scene depth, so it is an angle of
    view), and the squared angle between orientations. `R` and `(s, t)` are found in turn, both in closed form, with robust
    weights against single wrong cameras.
    """
    turns_there = truth.world_to_camera[:, :3, :3].transpose(0, 2, 1)  # (F,3,3) camera to world
    turns_here = estimated.world_to_camera[:, :3, :3].transpose(0, 2, 1)
    here, there = estimated.centers, truth.centers
    # The start is made of medians, so that a wrong camera does not decide which ones are wrong.
    relative = turns_there @ turns_here.transpose(0, 2, 1)  # every camera's own idea of R
    rotation = relative[np.argmin([np.median(_angles(relative, one)) for one in relative])]
    reach = float(np.median(np.linalg.norm(here - np.median(here, axis=0), axis=1)))
    scale = float(np.median(np.linalg.norm(there - np.median(there, axis=0), axis=1))) / reach if reach > 0 else 1.0
    shift = np.median(there - scale * here @ rotation.T, axis=0)
    for _ in range(ALIGN_ROUNDS):
        off = np.linalg.norm(there - (scale * here @ rotation.T + shift), axis=1) / max(scale, 1e-12)
        error = np.hypot(off, _angles(turns_there, rotation @ turns_here))
        w = (1 + (error / max(OUTLIER * float(np.median(error)), 1e-9)) ** 2) ** -2.0  # Geman-McClure
        w /= w.sum()
        here_centred, there_centred = here - w @ here, there - w @ there
        # |A - R B|_F^2 = 2 angle^2 for orientations, hence the half; centres are compared in estimated units.
        correlation = (w[:, None] * there_centred / max(scale, 1e-12)).T @ here_centred
        correlation += 0.5 * np.einsum("f,fij,fkj->ik", w, turns_there, turns_here)
        rotation = _nearest_rotation(correlation)
        turned = here_centred @ rotation.T
        spread = float((w[:, None] * turned**2).sum())
        scale = float((w[:, None] * there_centred * turned).sum()) / spread if spread > 0 else 1.0
        shift = w @ there - scale * rotation @ (w @ here)
    return scale, rotation, shift


def _nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation R (3,3) with the largest trace of R^T matrix."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles (F,) in radians between rotations (F,3,3)."""
    # |A - B|_F = sqrt(8) sin(angle/2): exact for small angles too, where the arc cosine of the trace is not.
    return 2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=(1, 2)) / np.sqrt(8), 0, 1))


def rotation_error(estimated: CameraPath, truth: CameraPath, similarity: Similarity) -> float:
    """Root mean square angle in degrees between the orientations of two paths after `similarity`."""
    turns_there, turns_here = (path.world_to_camera[:, :3, :3].transpose(0, 2, 1) for path in (truth, estimated))
    return float(np.degrees(np.sqrt(np.mean(_angles(turns_there, similarity[1] @ turns_here) ** 2))))


def into_scene(camera: Camera, similarity: Similarity) -> Camera:
    """A camera of the true world as a camera of the scene's world: same picture, other unit and axes."""
    scale, rotation, shift = similarity
    matrix = np.eye(4)
    turn = camera.world_to_camera[:3, :3]
    matrix[:3, :3] = turn @ rotation
    matrix[:3, 3] = (turn @ shift + camera.world_to_camera[:3, 3]) / scale
    return Camera(camera.intrinsics, matrix, camera.width, camera.height)


def _chosen(path: CameraPath, frames: Sequence[int] | np.ndarray) -> CameraPath:
    return CameraPath(
        path.intrinsics[frames], path.world_to_camera[frames], path.times[frames], path.width, path.height
    )


def _score_view(scene: Scene, camera: Camera, time: float, images: Path, backend: str) -> dict[str, float]:
    """PSNR and SSIM of one extra view; its picture is called by its time."""
    actual = resize_color(read_color(images / f"{int(time):05d}.png"), camera.width, camera.height)
    drawn = np.clip(render(scene, camera, time, ("rgb",), backend)["rgb"], 0, 1)
    pair = torch.from_numpy(drawn), torch.from_numpy(actual.astype(np.float32) / 255)
    return {"psnr": psnr(*pair), "ssim": ssim(*pair)}


def _read_truth(folder: Path) -> dict[str, Any]:
    path = folder / "truth.json"
    try:
        truth = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise F4xError(
            f"{path} cannot be read ({error}); render the clip again with scripts/synthetic_clip.py."
        ) from error
    if not isinstance(truth, dict) or not {"cameras", "extra_cameras"} <= truth.keys():
        raise F4xError(f"{path} is not the truth of a rendered clip; render it with scripts/synthetic_clip.py.")
    return truth
