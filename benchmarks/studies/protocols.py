"""Protocols by which the field measures a scene of each data set: cameras, their refinement and figures; tested on toy copies.

NVIDIA: Liu et al. 2023 (RoDynRF) with MoSca's test-time cameras; DyCheck: Gao et al. 2022; Nerfies: its left camera learnt,
its right one measured, as DyCheck's split `mono` has it. Where the files come from: docs/datasets.md.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from f4x_core.clip import Clip, read_clip
from f4x_core.clip.images import as_bytes
from f4x_core.clip.layouts import find_layout
from f4x_core.errors import F4xError
from f4x_core.evaluation.evaluate import FrozenMoment, Refinement, path_error, refine
from f4x_core.evaluation.perceptual_distance import lpips_bytes, lpips_missing, masked_lpips
from f4x_core.evaluation.tracking import keypoint_accuracy
from f4x_core.evaluation.truth import align_cameras, into_scene
from f4x_core.fit.config import FitConfig, profile, resolved
from f4x_core.fit.pipeline import fit_clip
from f4x_core.gaussians.camera_rig import CameraRig
from f4x_core.geometry.camera import Camera, CameraPath
from f4x_core.scene import Scene, read_scene, write_scene
from f4x_core.scene.view import render

from ..quality.image_metrics import masked_psnr, masked_ssim, psnr_bytes, ssim_bytes
from ..study import Context, MissingError, Row
from .novel import NovelCamera, measured_width, read_keypoints, read_novel_cameras
from .toy_fits import base_config

QUICK_WIDTH, QUICK_FRAMES = 160, 16
"""Size and frames of a quick report."""


@dataclass(frozen=True)
class Protocol:
    """Protocol of measuring a data set."""

    name: str
    """Of its folder below `--data`."""
    profile: str
    """Profile of the fit."""
    known_cameras: bool
    """True if the fit gets the data set's cameras; otherwise it estimates them."""
    first: Refinement
    """Refinement of the first view of a camera, the scene as it is."""
    others: Refinement
    """The same for its other views."""
    chained: bool
    """True if a view starts where the one before it ended."""
    masked: bool
    """True if figures are over `NovelCamera.seen` (mPSNR, mSSIM); otherwise over whole uint8 pictures."""
    factors: dict[str, int] = field(default_factory=dict)
    """Scene -> downsampling at which it is measured, where its `extra.json` does not tell."""


NVIDIA = Protocol(
    "nvidia",
    "nvidia",
    known_cameras=False,
    first=Refinement(100, 3e-4, 1e-6, hold=30, min_alpha=0.1),
    others=Refinement(100, 3e-4, 1e-6, hold=30, min_alpha=0.1),
    chained=True,
    masked=False,
)
DYCHECK = Protocol(
    "dycheck",
    "dycheck",
    known_cameras=True,
    first=Refinement(300, 3e-3, 1e-4, hold=15, min_alpha=0.1),
    others=Refinement(30, 3e-4, 1e-5, hold=15, min_alpha=0.1),
    chained=True,
    masked=True,
)
NERFIES = replace(DYCHECK, name="nerfies", factors={"broom": 4, "curls": 8, "tail": 4, "toby-sit": 4})


def scenes_of(context: Context, name: str, pattern: str) -> list[Path]:
    """Scene folders of a data set: those that hold `pattern`; in a quick report the first of them.

    Raises:
        MissingError: there are none.
    """
    folder = (context.data or Path("DATA")) / name
    found = sorted({file.parents[pattern.count("/")] for file in folder.glob(f"*/{pattern}")}) if context.data else []
    if not found:
        raise MissingError(f"{name}: no scene (no {folder}/SCENE/{pattern}); docs/datasets.md says where to get them.")
    return [path.resolve() for path in context.choose(found[:1], found)]


def read_scene_clip(context: Context, folder: Path, protocol: Protocol) -> Clip:
    """Return the training frames at the size at which the protocol measures; small and few in a quick report."""
    if context.quick:
        count = min(len(find_layout(folder).images), QUICK_FRAMES)
        return read_clip(folder, f"0:{count}", QUICK_WIDTH)
    return read_clip(folder, width=measured_width(folder, protocol.factors.get(folder.name)))


def fit_config(context: Context, name: str) -> FitConfig:
    """Return the profile called `name`; in a quick report the quick one, shortened."""
    full = replace(profile(name), threads=context.threads, seed=context.seed)
    return context.choose(base_config(context), full)


def fit_scene(context: Context, clip: Clip, config: FitConfig, known_cameras: bool = False) -> tuple[Scene, Row]:
    """Return the scene of `clip`, fitted now or in an earlier run of the report, and what it cost."""
    file = context.folder / f"{clip.name}.f4x"

    def work() -> Row:
        place = context.folder / f"{clip.name}-{config.name}-{config.seed}-{clip.width}x{len(clip)}"
        fitted_clip = clip if known_cameras else replace(clip, cameras=None)
        resume = (place / "checkpoints").is_dir()
        fitted = fit_clip(fitted_clip, place, config, context.progress, resume)
        write_scene(fitted.scene, file)
        return {"steps": config.steps, "fit (s)": sum(fitted.seconds.values())}

    cost = context.step(f"{clip.name} fit", work, config=resolved(config), frames=clip.picked, width=clip.width)
    return read_scene(file), cost


def sizes_of(scene: Scene) -> Row:
    """Megabytes of a scene's parts; scaffold with what it moves."""
    size = scene.info()["megabytes"]
    parts = {"static (MB)": size["static"], "dynamic (MB)": size["dynamic"] + size["scaffold"]}
    return parts | {"features (MB)": size["features"], "size (MB)": sum(size.values())}


def place_cameras(scene: Scene, clip: Clip, novel: NovelCamera) -> list[Camera]:
    """Return the views of `novel` as cameras of the scene's world, before any of them is moved to match.

    A camera that took a frame of the clip is where the fit says that it was; others go along when the data set's cameras
    of the clip are laid over the fitted ones.
    """
    given = clip.cameras
    if given is None:
        raise F4xError(
            f"{clip.source}: the clip has no cameras, so that no other can be placed; complete the download."
        )
    fitted = scene.cameras
    similarity = align_cameras(fitted, given)
    lens = float(np.median(fitted.intrinsics[:, 0, 0] / given.intrinsics[:, 0, 0]))
    placed = []
    for index in range(len(novel.path)):
        camera = novel.path[index]
        same = (given.world_to_camera == camera.world_to_camera).all((1, 2)).nonzero()[0]
        placed.append(fitted[int(same[0])] if len(same) else into_scene(camera, similarity, lens))
    return placed


def match_cameras(
    scene: Scene, novel: NovelCamera, placed: list[Camera], protocol: Protocol, backend: str = "auto"
) -> list[Camera]:
    """`placed` after the protocol's test-time optimisation; the scene stays fixed and masks are ignored."""
    matched: list[Camera] = []
    for index, camera in enumerate(placed):
        start = replace(camera, world_to_camera=matched[-1].world_to_camera) if protocol.chained and matched else camera
        rig = CameraRig(
            CameraPath(start.intrinsics[None], start.world_to_camera[None], np.zeros(1), start.width, start.height)
        )
        moment = FrozenMoment(scene, float(novel.path.times[index]), backend)
        target = torch.from_numpy(novel.frames[index].astype(np.float32) / 255)
        settings = protocol.others if matched else protocol.first
        matched.append(refine(moment, rig, target, settings)[1])
    return matched


def score_views(scene: Scene, novel: NovelCamera, cameras: list[Camera], masked: bool, backend: str = "auto") -> Row:
    """Mean PSNR, SSIM and, where it runs, LPIPS of the scene's pictures of all views, rounded to bytes as the protocols have it."""
    scores = []
    for index, camera in enumerate(cameras):
        drawn = render(scene, camera, float(novel.path.times[index]), ("rgb",), backend)["rgb"]
        scores.append(score_render(as_bytes(drawn), novel, index, masked))
    return {name: float(np.nanmean([row[name] for row in scores])) for name in scores[0]}


def score_render(image: np.ndarray, novel: NovelCamera, index: int, masked: bool) -> Row:
    """PSNR, SSIM and, where it runs, LPIPS of a picture (H,W,3) uint8 as view `index` of `novel`; masked: mPSNR and so on."""
    target = novel.frames[index]
    if not masked:
        row = {"PSNR (dB)": psnr_bytes(image, target), "SSIM": ssim_bytes(image, target)}
        return row | _where_run("LPIPS", lpips_bytes(image, target))
    seen = np.ones(target.shape[:2], bool) if novel.seen is None else novel.seen[index]
    shown, true = image / 255.0, target / 255.0
    row = {"mPSNR (dB)": masked_psnr(shown, true, seen), "mSSIM": masked_ssim(shown, true, seen)}
    return row | _where_run("mLPIPS", masked_lpips(shown, true, seen))


def _where_run(name: str, value: float | None) -> Row:
    return {} if value is None else {name: value}


def measure_views(context: Context, clip: Clip, scene: Scene, protocol: Protocol) -> Row:
    """Return the protocol's figures of every other camera, matched (also `as placed`: before its cameras were moved)."""
    novel = read_novel_cameras(clip)
    if not novel:
        raise F4xError(f"{clip.source} has no pictures of another camera; docs/datasets.md says where they lie.")

    def work() -> Row:
        rows = []
        for camera in novel:
            placed = place_cameras(scene, clip, camera)
            before = score_views(scene, camera, placed, protocol.masked)
            as_placed = {
                name.replace(" (dB)", ", as placed (dB)"): value for name, value in before.items() if "(dB)" in name
            }
            matched = match_cameras(scene, camera, placed, protocol)
            rows.append(score_views(scene, camera, matched, protocol.masked) | as_placed)
        counts = [len(camera.path) for camera in novel]
        means = {name: float(np.average([row[name] for row in rows], weights=counts)) for name in rows[0]}
        points = read_keypoints(clip)
        pck = {"PCK@5%": keypoint_accuracy(scene, points)["pck"]} if points else {}
        return means | pck | {"views": sum(counts)} | _path_error(scene, clip, protocol)

    settings = {"frames": clip.picked, "width": clip.width, "lpips": not lpips_missing()}
    return context.step(f"{clip.name} views", work, protocol=asdict(protocol), **settings)


def _path_error(scene: Scene, clip: Clip, protocol: Protocol) -> Row:
    """Error of the found cameras against the data set's."""
    if protocol.known_cameras or clip.cameras is None:
        return {}
    return {"camera error (share of path)": path_error(scene.cameras, clip.cameras)["ate_fraction"]}
