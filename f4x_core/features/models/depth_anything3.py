"""Cameras and depth at once from Depth Anything 3 (Lin et al. 2025, arXiv 2511.10647), by its authors' package.

Only the package's network is imported (no torchvision, xformers or gsplat), and it is built from numbers written here: a
checkpoint says which size it is and nothing else, because the package itself would import whatever its configuration names.
Cameras are then refined on the clip's static tracks like those of every other solver, and depth is scaled to them.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch
from huggingface_hub import try_to_load_from_cache
from safetensors import SafetensorError
from safetensors.torch import load_model
from torch import nn

from ...errors import F4xError
from ...priors import cameras as classical
from ...priors.bundle import Observations, from_matrices
from ...priors.camera_problem import MIN_TRACKS
from ...priors.depth import track_samples
from ...priors.sfm import Solution
from ..memory import memory_guard
from ..preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor, input_size
from .depth import AGREEMENT, GUESS, MAX_DEPTH, TRUST, weighted_median
from .loading import Located, find
from .providers import INSTALL
from .views import Views, predict_in_one_world

if TYPE_CHECKING:
    from ...clip import Clip
    from ...priors import Priors, PriorsConfig
    from ...progress import Progress

SIZES = {"da3-small": ("vits", 384), "da3-base": ("vitb", 768)}
"""`model_name` of a checkpoint -> its DINOv2 and the width of that; the sizes whose weights are free."""
LAYERS, ALTERNATING = (5, 7, 9, 11), 4
"""Blocks of the backbone that the heads read, and the one from which on every second block sees all views."""
LONGER_SIDE, PATCH = 504, 14
"""Pixels of the model's input along the longer side, as it was trained, and the step of its sides."""
MAX_VIEWS, MAX_PIXELS = 16, 16 * 504 * 294
"""Largest number of images in one pass of the model, and of pixels in all of them: 1.4 GB of memory."""
ZOOM = 1.2
"""A warning is given when the focal lengths found (5th to 95th percentile over the frames) differ by more than this ratio."""


class DepthAnything3:
    """Depth Anything 3: predicts the cameras and depth of a few images at once."""

    def __init__(self, model: str | Path | None = None) -> None:
        self.weights = find("depth-anything-3", model)
        self.network: Any = _load(self.weights)

    def predict(self, frames: np.ndarray) -> Views:
        """Return the views of pictures (N,H,W,3) uint8; depth and intrinsics are those of the model's own picture size (h, w)."""
        size = self.size(frames.shape[2], frames.shape[1])
        with torch.inference_mode(), memory_guard(f"Depth Anything 3 on {len(frames)} pictures of {size[1]}x{size[0]}"):
            images = [image_tensor(rgb, size, IMAGENET_MEAN, IMAGENET_STD, mode="bicubic") for rgb in frames]
            predicted = self.network(torch.cat(images)[None])  # (1,N,3,h,w)
        matrices = np.tile(np.eye(4), (len(frames), 1, 1))
        matrices[:, :3] = predicted["extrinsics"][0].double().numpy()
        return Views(
            predicted["intrinsics"][0].double().numpy(),
            matrices,
            predicted["depth"][0].numpy(),
            (1 - 1 / predicted["depth_conf"][0]).numpy(),  # the head's 1 + exp(x) as sigmoid(x)
        )

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return (h, w) of the model's input for pictures of `width` x `height`."""
        return input_size(width, height, round(LONGER_SIDE**2 * min(width, height) / max(width, height)), PATCH)


def provide_cameras(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress, model: str | Path) -> None:
    """Provide cameras of the `model`, refined on static tracks.

    Fills `cameras`, `camera_kind` and `statistics["cameras"]` like the classical one. Errors: F4xError without package or
    weights.
    """
    name, views = _views(clip, priors, progress, model)
    scale = np.array([priors.width, priors.height]) / views.depth.shape[:0:-1]
    focals = (views.intrinsics[:, [0, 1], [0, 1]] * scale).mean(1)  # (F,) pixels of the clip
    focal, spread = float(np.median(focals)), np.divide(*np.percentile(focals, (95, 5)))
    bundle = from_matrices(views.world_to_camera, focal, np.array([priors.width, priors.height]) / 2)
    nothing = Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    classical.provide(clip, priors, config, progress, Solution(bundle, nothing, np.ones(len(views), bool)))
    priors.statistics["cameras"] |= {"model": name, "focal_spread": round(float(spread), 3)}
    if spread > ZOOM:
        priors.warn(
            f"The focal lengths that {name} finds differ by {spread:.0%} between frames; the clip is taken as filmed with"
            " their median. If it zooms, give its cameras yourself."
        )


def provide_depth(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress, model: str | Path) -> None:
    """Provide depth of the `model` in the scale of the cameras, whichever provider made those.

    Fills `depth`, `depth_confidence`, `statistics["depth"]` and sets the world unit like the classical one. Errors: F4xError
    without package or weights.
    """
    name, views = _views(clip, priors, progress, model)
    assert priors.cameras is not None
    size = (priors.width, priors.height)
    inverse = np.stack([cv2.resize(1 / frame, size, interpolation=cv2.INTER_LINEAR) for frame in views.depth])
    confidence = np.stack([cv2.resize(frame, size, interpolation=cv2.INTER_LINEAR) for frame in views.confidence])
    inverse = np.maximum(inverse, np.median(inverse) / MAX_DEPTH)
    scale, difference = np.full(len(views), float(np.median(inverse))), np.full(len(views), np.nan)
    if priors.camera_kind == "moving":
        scale, difference = scale_to_tracks(inverse, priors)
        if np.isnan(scale).all():
            scale[:] = _extent(priors.cameras.centers) / max(_extent(views.poses()[1]), 1e-9)
    depth = scale[:, None, None] / inverse
    trust = np.where(np.isnan(difference), GUESS, TRUST * np.exp(-difference / AGREEMENT))
    confidence = np.clip(confidence * trust[:, None, None], 0, 1)
    priors.store_depth(depth, confidence, float(np.median(depth)))
    assert priors.depth is not None
    priors.statistics["depth"] = {
        "model": name,
        "difference_to_tracks": None if np.isnan(difference).all() else round(float(np.nanmedian(difference)), 4),
        "percentiles_2_50_98": [
            round(float(value), 3) for value in np.percentile(priors.depth[:, ::4, ::4], (2, 50, 98))
        ],
        "mean_confidence": round(float(confidence.mean()), 3),
    }


def scale_to_tracks(inverse: np.ndarray, priors: Priors) -> tuple[np.ndarray, np.ndarray]:
    """Return the scale of each frame's `inverse (F,H,W)` depth to the cameras' unit, and the median relative difference left.

    Both `(F,)`, from the static tracks that the cameras triangulate; frames that see too few take their neighbours' scale and
    have no difference (NaN). All NaN where no frame sees enough.
    """
    frames = np.arange(len(inverse))
    log_scale, difference = np.full(len(inverse), np.nan), np.full(len(inverse), np.nan)
    for i, (uv, measured, precision) in enumerate(track_samples(priors)):
        if len(uv) < MIN_TRACKS:
            continue
        column, row = np.clip(uv.astype(int), 0, (priors.width - 1, priors.height - 1)).T
        ratio = np.log(inverse[i, row, column] / measured)
        weight = np.sqrt(precision) * measured  # one over the relative error
        log_scale[i] = weighted_median(ratio, weight)
        difference[i] = weighted_median(abs(ratio - log_scale[i]), weight)
    known = np.isfinite(log_scale)
    if known.any():
        log_scale = np.interp(frames, frames[known], log_scale[known])
    return np.exp(log_scale), difference


def _views(clip: Clip, priors: Priors, progress: Progress, model: str | Path) -> tuple[str, Views]:
    """Return the name of the weights and the views of the supervised frames, predicted once per run for cameras and depth."""
    key, kept = f"views of {model}", priors.scratch.of_providers
    if key not in kept:
        network = DepthAnything3(model)
        height, width = network.size(priors.width, priors.height)
        max_views = int(np.clip(MAX_PIXELS // (height * width), 3, MAX_VIEWS))
        count, seen = len(priors.frames), 0

        def predict(chosen: np.ndarray) -> Views:
            nonlocal seen
            progress("model", min(seen, count), count, "Depth Anything 3")
            seen += len(chosen)
            return network.predict(np.stack([clip.frames[frame] for frame in priors.frames[chosen]]))

        views = predict_in_one_world(predict, count, max_views)
        progress("model", count, count, "Depth Anything 3")
        kept[key] = network.weights.name, views
    return kept[key]


def _extent(centers: np.ndarray) -> float:
    return float(np.linalg.norm(centers - centers.mean(0)))


def build(size: str) -> nn.Module:
    """Return the network of `SIZES[size]` with random weights; F4xError when the package is not here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its configuration library, which is not used
        try:
            from depth_anything_3.model.cam_dec import CameraDec
            from depth_anything_3.model.da3 import DepthAnything3Net
            from depth_anything_3.model.dinov2.dinov2 import DinoV2
            from depth_anything_3.model.dualdpt import DualDPT
            from depth_anything_3.utils.logger import logger
            from omegaconf import OmegaConf
        except ImportError as error:
            raise F4xError(f"Depth Anything 3 cannot be imported ({error}); install it: {INSTALL}") from error
    OmegaConf.clear_resolver("eval")  # the package teaches it Python's eval
    logger.level = 0  # errors only: it prints to standard output
    backbone, width = SIZES[size]
    return DepthAnything3Net(
        DinoV2(backbone, list(LAYERS), ALTERNATING, ALTERNATING, ALTERNATING, cat_token=True),
        DualDPT(2 * width, features=width // 6, out_channels=(width // 8, width // 4, width // 2, width)),
        CameraDec(2 * width),
        nn.Identity(),  # describes given cameras to the network; it is never given any
    )


def _load(weights: Located) -> nn.Module:
    """Return the network in evaluation mode, float32 on the CPU, without gradients; F4xError when it cannot be opened."""
    network = build(_size(weights))
    try:
        missing, _ = load_model(nn.ModuleDict({"model": network}), _file(weights, "model.safetensors"), strict=False)
    except (OSError, SafetensorError, RuntimeError) as error:
        line = str(error).splitlines()[0].rstrip(".:")
        raise F4xError(
            f"{weights.place}: the weights of '{weights.entry.name}' cannot be read ({line}); fetch them again."
        ) from error
    if missing:
        raise F4xError(
            f"{weights.place}: {len(missing)} weights of '{weights.entry.name}' are missing (the first is"
            f" {min(missing)}); fetch them again."
        )
    return network.eval().requires_grad_(False)


def _size(weights: Located) -> str:
    """Return the name of the entry of `SIZES` that a checkpoint is."""
    try:
        name = json.loads(_file(weights, "config.json").read_text(encoding="utf-8"))["model_name"]
    except (ValueError, TypeError, KeyError):
        name = None
    if name not in SIZES:
        raise F4xError(
            f"{weights.place}: config.json names none of the models {', '.join(SIZES)}; give such a checkpoint."
        )
    return name


def _file(weights: Located, name: str) -> Path:
    """Return a file of a checkpoint in a folder or the local cache; nothing is downloaded."""
    folder = Path(weights.place)
    if folder.is_dir():
        path: Any = folder / name
    else:
        try:
            path = try_to_load_from_cache(weights.place, name)
        except ValueError:  # no hub id
            path = None
    if not isinstance(path, str | Path) or not Path(path).is_file():
        raise F4xError(
            f"{weights.place} is no folder, or model in the local cache, that holds {name}; run: f4x models get"
            f" {weights.entry.name}"
        )
    return Path(path)
