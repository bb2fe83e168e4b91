"""Scores against the ground truth of a rendered clip: camera errors, and PSNR of views away from the camera path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import binary_closing

from ..clip.images import read_color, resize_color, resize_nearest
from ..errors import F4xError
from ..gaussians.camera_rig import CameraRig
from ..geometry.camera import Camera, CameraPath
from ..geometry.quaternion import angles_between
from ..geometry.trajectory import View
from ..metrics.pictures import psnr, ssim
from ..priors.synthetic import BACKGROUND_DEPTH, read_passes
from ..progress import Progress, silent
from ..reading import load_json
from ..scene import Scene
from ..scene.view import render
from .evaluate import FrozenMoment, path_error, refine

# Rounds of the alternation between scale and rotation, and of the reweighting against wrong cameras.
ALIGN_ROUNDS = 20
# A camera whose error is this many times the median one gets little weight in the alignment.
OUTLIER = 3.0
# Cameras within this radius (root mean square, in scene units: median depth 1) do not determine the scene's unit.
MIN_PATH_SPREAD = 1e-3

# Depth of the sky, in median depths of the clip: far enough that only its direction counts.
SKY = 1e4
# Figures of one view that are also averaged over the views of each angle.
BY_DEGREES = ("psnr_covered", "psnr_covered_moving", "psnr_covered_static")

Similarity = tuple[float, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class ExtraCamera:
    """A camera that rendered some moments of a clip from another place."""

    name: str
    cameras: CameraPath
    """True cameras, one for each moment (`cameras.times`)."""
    images: Path
    """Folder of its images, `%05d.png` by clip frame."""
    passes: Path
    """Folder of its passes, `%05d.exr`; older clips have none."""
    degrees: float | None
    """Angle at the scene between it and the clip's camera of the same moment; None where truth.json does not know."""


@dataclass(frozen=True)
class TrueClip:
    """The ground truth of the rendered clip that a scene was fitted to, and the alignment of the two worlds."""

    folder: Path
    """Output folder of `scripts/synthetic_clip.py`."""
    path: CameraPath
    """True cameras of all frames."""
    moving_index: list[int]
    """Object indices of the moving objects."""
    extras: list[ExtraCamera]
    """Extra cameras; empty if the fitted camera is static."""
    used: np.ndarray
    """(F,) supervised frames."""
    similarity: Similarity
    """Similarity from the scene's world to the true one."""
    focal_ratio: float
    """Fitted focal length divided by the true one."""
    still: bool
    """True if the fitted camera is static, so that `similarity` does not determine the scene's unit."""

    @classmethod
    def read(cls, scene: Scene, truth_folder: Path | str) -> TrueClip:
        """Read the truth and align the scene's cameras with it. F4xError: none there, or that of another clip."""
        folder = Path(truth_folder)
        truth = _read_truth(folder)
        path = CameraPath.from_json(truth["cameras"], folder / "truth.json")
        if len(path) != len(scene.cameras):
            raise F4xError(
                f"{folder}: the truth has {len(path)} frames, the scene {len(scene.cameras)}; fit all frames of the clip."
            )
        used = np.setdiff1d(np.arange(len(path)), scene.held_out)
        estimated, true_used = _chosen(scene.cameras, used), _chosen(path, used)
        fitted = estimated.resized(path.width, path.height)
        focal_ratio = float(np.median(fitted.intrinsics[:, 0, 0] / true_used.intrinsics[:, 0, 0]))
        still = float(np.sqrt(estimated.centers.var(axis=0).sum())) < MIN_PATH_SPREAD
        extras = [
            ExtraCamera(
                extra["name"],
                CameraPath.from_json(extra["cameras"], folder / "truth.json"),
                folder / extra["images"],
                folder / f"truth_{extra['name']}",
                extra.get("degrees"),
            )
            for extra in ([] if still else truth["extra_cameras"])
        ]
        similarity = align_cameras(estimated, true_used)
        return cls(folder, path, truth["moving_index"], extras, used, similarity, focal_ratio, still)

    def into_scene(self, camera: Camera, scene: Scene) -> Camera:
        """Return a camera of the true world as one of the scene's, at the size of the scene's pictures."""
        return into_scene(camera, self.similarity, self.focal_ratio).resized(scene.cameras.width, scene.cameras.height)


def score_against_truth(
    scene: Scene,
    truth_folder: Path | str,
    *,
    refine_camera: bool = False,
    backend: str = "auto",
    progress: Progress = silent,
) -> dict[str, Any]:
    """Compare `scene` with the truth of the rendered clip it was made from.

    Args:
        scene: fitted to all frames of the clip (any width, held-out frames allowed), in any world frame and unit.
        truth_folder: what `scripts/synthetic_clip.py` wrote; its extra cameras are used when it has some.
        refine_camera: also score extra views after their camera was moved to match (scene frozen), which takes out what
            the alignment of the two worlds leaves.

    Returns:
        `ate` (true world units), `ate_fraction` (of the true path), `path_length`, `rotation_error` (degrees, root mean square
        after the alignment) over supervised frames; `scale` true units per scene unit; `focal_ratio` fitted to true;
        `depth_error_static` and `depth_error_moving`, see `depth_errors` (left out when the fitted camera stands still).
        With extra cameras `unseen_psnr`, `unseen_ssim`, `unseen_psnr_covered` (only pixels whose surface some used frame saw,
        by the truth: DyCheck's co-visible ones), `unseen_covered_fraction` (0..1, how many these are), `..._covered_moving` and
        `..._covered_static` (those that show moving objects, seen at that very frame, and the others) and on request
        `unseen_psnr_covered_refined`: means over views, leaving out views that show none of it. The figures in `BY_DEGREES`
        also as `unseen_FIGURE_at_D` over the cameras D degrees off the path. `views`: one row for each view.
        Views are left out when the fitted camera stands still: its unit is then unknown, and so are places in it.

    Raises:
        F4xError: no truth there, or of another clip.
    """
    clip = TrueClip.read(scene, truth_folder)
    estimated, true_used = _chosen(scene.cameras, clip.used), _chosen(clip.path, clip.used)
    scores: dict[str, Any] = path_error(estimated, true_used)
    scores |= {"scale": clip.similarity[0], "rotation_error": rotation_error(estimated, true_used, clip.similarity)}
    scores["focal_ratio"] = clip.focal_ratio
    if not clip.still:
        scores |= fitted_depth_errors(scene, clip, backend, progress)
    seen = SeenSurface.read(clip.folder, clip.path, clip.used, clip.moving_index) if clip.extras else None
    rows: list[dict[str, Any]] = []
    for extra in clip.extras:
        for index, time in enumerate(extra.cameras.times):
            progress("unseen views", index, len(extra.cameras), extra.name)
            actual = read_color(extra.images / f"{int(time):05d}.png")
            regions = seen.regions(extra, index, clip.moving_index) if seen else {}
            camera = clip.into_scene(extra.cameras[index], scene)
            row = _score_view(scene, View(camera, float(time)), actual, regions, refine_camera, backend)
            rows.append({"camera": extra.name, "degrees": extra.degrees, "frame": int(time), **row})
        progress("unseen views", len(extra.cameras), len(extra.cameras), extra.name)
    if rows:
        names = [name for name in rows[0] if name not in ("camera", "degrees", "frame")]
        scores |= _means(rows, names, "")
        for degrees in sorted({row["degrees"] for row in rows if row["degrees"] is not None}):
            chosen = [row for row in rows if row["degrees"] == degrees]
            scores |= _means(chosen, [name for name in BY_DEGREES if name in names], f"_at_{degrees:g}")
        scores["views"] = rows
    return scores


def _means(rows: Sequence[dict[str, Any]], names: Sequence[str], suffix: str) -> dict[str, float]:
    """Return `unseen_NAME` + suffix: mean over the rows in which a figure is finite; figures that never are, are left out."""
    means = {}
    for name in names:
        values = [row[name] for row in rows if np.isfinite(row[name])]
        if values:
            means[f"unseen_{name}{suffix}"] = float(np.mean(values))
    return means


def fitted_depth_errors(
    scene: Scene, clip: TrueClip, backend: str = "auto", progress: Progress = silent
) -> dict[str, float]:
    """Return `depth_errors` of the scene's own rendered depth in the used frames; {} without passes of the clip."""
    found, true, moving = [], [], []
    for done, frame in enumerate(clip.used):
        progress("depth", done, len(clip.used))
        file = clip.folder / "truth" / f"{frame:05d}.exr"
        if not file.is_file():
            return {}
        passes = read_passes(file)
        camera = scene.cameras[int(frame)]
        found.append(render(scene, camera, float(scene.cameras.times[frame]), ("depth",), backend)["depth"])
        true.append(resize_nearest(passes["Depth"], camera.width, camera.height))
        moves = np.isin(passes["Object Index"].round(), clip.moving_index)
        moving.append(resize_nearest(moves, camera.width, camera.height))
    progress("depth", len(clip.used), len(clip.used))
    return depth_errors(clip.similarity[0] * np.stack(found), np.stack(true), np.stack(moving))


def depth_errors(found: np.ndarray, true: np.ndarray, moving: np.ndarray) -> dict[str, float]:
    """Return the median relative error of depth: `depth_error_static`, `depth_error_moving` (a region without pixels is left out).

    Args:
        found: (F,H,W) z depth in the true unit (the cameras' alignment gives it); NaN = unknown, does not count.
        true: (F,H,W) z depth, `BACKGROUND_DEPTH` and more = sky, does not count.
        moving: (F,H,W) bool. No scale of its own is granted to moving objects, so a wrong mean distance counts.
    """
    known = np.isfinite(found) & (true < BACKGROUND_DEPTH)
    errors = np.abs(np.divide(found, true, out=np.ones_like(found), where=known) - 1)
    regions = {"depth_error_static": known & ~moving, "depth_error_moving": known & moving}
    return {name: float(np.median(errors[region])) for name, region in regions.items() if region.any()}


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
    rotation = relative[np.argmin([np.median(angles_between(relative, one)) for one in relative])]
    reach = float(np.median(np.linalg.norm(here - np.median(here, axis=0), axis=1)))
    scale = float(np.median(np.linalg.norm(there - np.median(there, axis=0), axis=1))) / reach if reach > 0 else 1.0
    shift = np.median(there - scale * here @ rotation.T, axis=0)
    for _ in range(ALIGN_ROUNDS):
        off = np.linalg.norm(there - (scale * here @ rotation.T + shift), axis=1) / max(scale, 1e-12)
        error = np.hypot(off, angles_between(turns_there, rotation @ turns_here))
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
    """Return the rotation R (3,3) with the largest trace of R^T matrix."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def rotation_error(estimated: CameraPath, truth: CameraPath, similarity: Similarity) -> float:
    """Return the root mean square angle in degrees between the orientations of two paths after `similarity`."""
    turns_there, turns_here = (path.world_to_camera[:, :3, :3].transpose(0, 2, 1) for path in (truth, estimated))
    return float(np.degrees(np.sqrt(np.mean(angles_between(turns_there, similarity[1] @ turns_here) ** 2))))


def into_scene(camera: Camera, similarity: Similarity, focal_ratio: float = 1.0) -> Camera:
    """Return a camera of the true world as a camera of the scene's world: the same image in other units and axes.

    `focal_ratio` is the fitted focal length divided by the true one. The extra cameras have the clip's true focal length, but a
    scene that was fitted with a slightly wrong one reproduces its images only with the same wrong focal length.
    """
    scale, rotation, shift = similarity
    matrix = np.eye(4)
    turn = camera.world_to_camera[:3, :3]
    matrix[:3, :3] = turn @ rotation
    matrix[:3, 3] = (turn @ shift + camera.world_to_camera[:3, 3]) / scale
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, :2] *= focal_ratio
    return Camera(intrinsics, matrix, camera.width, camera.height)


def _chosen(path: CameraPath, frames: Sequence[int] | np.ndarray) -> CameraPath:
    return CameraPath(
        path.intrinsics[frames], path.world_to_camera[frames], path.times[frames], path.width, path.height
    )


@dataclass(frozen=True)
class SeenSurface:
    """True surface points that the used frames of the clip saw: the most that a scene can reproduce."""

    still: np.ndarray
    """(P,3) points of static surfaces in the true world, from all used frames."""
    moving: dict[int, np.ndarray]
    """Frame -> (n,3) points of moving surfaces that this frame saw."""
    sky: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(S,3) far points in the directions in which used frames saw the sky."""

    @classmethod
    def read(cls, folder: Path, path: CameraPath, used: np.ndarray, moving_index: list[int]) -> SeenSurface | None:
        """Read the passes in `folder/truth`; None if there are none."""
        still, moving, sky, depths = [], {}, [], []
        for frame in used:
            file = folder / "truth" / f"{frame:05d}.exr"
            if not file.is_file():
                return None
            passes = read_passes(file)
            depth, moves = passes["Depth"].astype(np.float64), np.isin(passes["Object Index"].round(), moving_index)
            known = depth < BACKGROUND_DEPTH
            camera, grid = path[int(frame)], path[int(frame)].pixel_grid()
            points = camera.unproject(grid, depth)  # (H,W,3)
            still.append(points[known & ~moves])
            moving[int(frame)] = points[known & moves]
            sky.append(camera.unproject(grid[~known], np.ones(int((~known).sum()))) - camera.center)
            depths.append(np.median(depth[known]) if known.any() else np.nan)
        far = SKY * float(np.nanmedian(depths)) if np.isfinite(depths).any() else SKY
        return cls(np.concatenate(still), moving, far * np.concatenate(sky))

    def covers(self, camera: Camera, frame: int) -> np.ndarray:
        """Return (H,W) bool: pixels of `camera` onto which a seen point falls; single-pixel gaps between points are closed.

        A seen wall behind an unseen part of the subject counts, so the region is rather too large than too small (by 1 %
        of the picture, 10 degrees off the path). For the same reason no depth is compared: it is asked whether anything
        lands, not what. Moving objects are unknown at a held-out `frame`. Sky is left out: it lies behind everything.
        """
        return _landing(camera, self.still, self.moving.get(frame, np.zeros((0, 3))))

    def regions(self, extra: ExtraCamera, index: int, moving_index: Sequence[int]) -> dict[str, np.ndarray]:
        """Return `covered` (H,W) bool of one view of an extra camera, and where its passes tell, its parts `moving` and `static`.

        Sky that the view shows is covered where a used frame looked into the same direction, and belongs to `static`.
        """
        camera, frame = extra.cameras[index], int(extra.cameras.times[index])
        covered, file = self.covers(camera, frame), extra.passes / f"{frame:05d}.exr"
        if not file.is_file():
            return {"covered": covered}
        passes = read_passes(file)
        moves = np.isin(passes["Object Index"].round(), moving_index)
        empty = passes["Depth"] >= BACKGROUND_DEPTH
        covered = np.where(empty, _landing(camera, self.sky), covered)
        seen_moving = _landing(camera, self.moving.get(frame, np.zeros((0, 3))))
        return {"covered": covered, "moving": moves & seen_moving, "static": covered & ~moves}


def _landing(camera: Camera, *clouds: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: pixels onto which some point of `clouds`, each (n,3), falls; single-pixel gaps are closed."""
    mask = np.zeros((camera.height, camera.width), bool)
    for points in clouds:
        pixels, depth = camera.project(points)
        column, row = np.floor(pixels[depth > 0]).astype(int).T
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        mask[row[inside], column[inside]] = True
    # Beyond the picture it goes on as at its border, so that a strip of one pixel there is no gap between points.
    return binary_closing(np.pad(mask, 2, mode="edge"), np.ones((3, 3)))[2:-2, 2:-2]


def _score_view(
    scene: Scene, view: View, actual: np.ndarray, regions: dict[str, np.ndarray], refine_camera: bool, backend: str
) -> dict[str, float]:
    """Return the PSNR and SSIM of one extra view: `actual` (H,W,3) uint8, `regions` of the same size as `SeenSurface.regions`."""
    camera, time = view
    size = camera.width, camera.height
    target = torch.from_numpy(resize_color(actual, *size).astype(np.float32) / 255)
    image = torch.from_numpy(np.clip(render(scene, camera, time, ("rgb",), backend)["rgb"], 0, 1))
    scores = {"psnr": psnr(image, target), "ssim": ssim(image, target)}
    weights = {name: torch.from_numpy(resize_nearest(region, *size)).float() for name, region in regions.items()}
    if "covered" in weights:
        weight = weights.pop("covered")
        scores |= {"psnr_covered": psnr(image, target, weight), "covered_fraction": float(weight.mean())}
        scores |= {f"psnr_covered_{name}": psnr(image, target, part) for name, part in weights.items()}
        if refine_camera:
            rig = CameraRig(CameraPath(camera.intrinsics[None], camera.world_to_camera[None], np.array([time]), *size))
            scores["psnr_covered_refined"] = psnr(
                refine(FrozenMoment(scene, time, backend), rig, target)[0], target, weight
            )
    return scores


def _read_truth(folder: Path) -> dict[str, Any]:
    path = folder / "truth.json"
    try:
        truth = load_json(path)
    except (OSError, ValueError) as error:
        raise F4xError(
            f"{path} cannot be read ({error}); render the clip again with scripts/synthetic_clip.py."
        ) from error
    if not isinstance(truth, dict) or not {"cameras", "extra_cameras", "moving_index"} <= truth.keys():
        raise F4xError(f"{path} is not the truth of a rendered clip; render it with scripts/synthetic_clip.py.")
    return truth
