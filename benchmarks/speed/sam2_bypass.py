"""Does SAM 2 without its encoder mask as the whole model does? Logits from its own features against those from pixels."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from f4x_core.features.models.loading import find, load, transformers
from f4x_core.features.models.sam2 import DEFAULT, FeatureSam2, Sam2MaskDecoder
from f4x_core.features.preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor
from f4x_core.progress import Progress, silent

RANDOM = "random"
"""In place of a checkpoint: random weights in the shape of SAM 2.1 tiny."""


def compare_bypass(
    frames: np.ndarray, model: str | Path | None = RANDOM, progress: Progress = silent
) -> dict[str, float | int | str]:
    """Follow the middle of the first frame through `frames (T,H,W,3) uint8`, from pixels and from the encoder's own features.

    `model` is a checkpoint as in `load_sam2`, or `RANDOM`. Returns `model`, `frames`, `logits_error` and `logits_spread`
    (largest difference over all frames, and the standard deviation that it compares with), and how often the encoder ran:
    `pixel_encoder_calls`, `bypass_encoder_calls`; seconds of both paths over all frames, drawing pictures or features left out.
    """
    full = random_sam2() if model == RANDOM else load(transformers.Sam2VideoModel, find(DEFAULT, model))
    bypass = without_encoder(full)
    count, side = len(frames), full.image_size
    size = tuple(full.prompt_encoder.mask_input_size)  # logits come through unresized
    encoder = type(full.vision_encoder)
    pixels = [image_tensor(frame, (side, side), IMAGENET_MEAN, IMAGENET_STD) for frame in frames]
    progress("sam2 from pixels", 0, 1)
    with torch.inference_mode(), counted(encoder) as pixel_calls:
        begun = time.perf_counter()
        expected = _pixel_path(full, torch.cat(pixels), size)
        pixel_seconds = time.perf_counter() - begun
    progress("sam2 features", 0, 1)
    with torch.inference_mode():
        pyramids = [full.get_image_features(image, return_dict=True).fpn_hidden_states for image in pixels]
    grids = full.backbone_feature_sizes
    levels = [
        [flat[:, 0].unflatten(0, tuple(grid)).numpy() for flat, grid in zip(pyramid, grids, strict=True)]
        for pyramid in pyramids
    ]  # (h,w,C), fine to coarse
    progress("sam2 from features", 0, 1)
    with counted(encoder) as bypass_calls:
        decoder = Sam2MaskDecoder(bypass, lambda t: levels[t][2], count, size, lambda t: (levels[t][0], levels[t][1]))
        begun = time.perf_counter()
        decoder.prompt(0, points=[[size[1] / 2, size[0] / 2]])
        found = dict(decoder.propagate())
        bypass_seconds = time.perf_counter() - begun
    return {
        "model": str(model),
        "frames": count,
        "logits_error": float(max(np.abs(found[t] - expected[t]).max() for t in range(count))),
        "logits_spread": float(np.std([expected[t] for t in range(count)])),
        "pixel_encoder_calls": len(pixel_calls),
        "bypass_encoder_calls": len(bypass_calls),
        "pixel_seconds": pixel_seconds,
        "bypass_seconds": bypass_seconds,
        "sam2_time_ratio": pixel_seconds / bypass_seconds,
    }


def random_sam2(seed: int = 0) -> Any:
    """SAM 2.1 tiny with random weights of unit gain, also where training starts at zero: nothing drops out of a comparison."""
    generator = torch.Generator().manual_seed(seed)
    model = transformers.Sam2VideoModel(transformers.Sam2VideoConfig())
    with torch.no_grad():
        for weight in model.parameters():
            noise = torch.randn(weight.shape, generator=generator)
            weight.copy_(noise / weight[0].numel() ** 0.5 if weight.ndim > 1 else weight + 0.1 * noise)
        model.mask_decoder.pred_obj_score_head.proj_out.bias.fill_(
            5.0
        )  # an object on every frame, not the constant for none
    return model.eval().requires_grad_(False)


def without_encoder(full: Any) -> FeatureSam2:
    """The same model without its encoder, sharing the weights."""
    bypass = FeatureSam2(full.config)
    own = bypass.state_dict().keys()
    bypass.load_state_dict({name: value for name, value in full.state_dict().items() if name in own}, assign=True)
    return bypass.eval().requires_grad_(False)


@contextmanager
def counted(kind: type) -> Iterator[list[None]]:
    """A list that gets one entry for each forward call of any module of `kind` inside the block."""
    calls: list[None] = []

    def note(module: torch.nn.Module, _: Any) -> None:
        if isinstance(module, kind):
            calls.append(None)

    handle = torch.nn.modules.module.register_module_forward_pre_hook(note)
    try:
        yield calls
    finally:
        handle.remove()


def _pixel_path(model: Any, video: torch.Tensor, size: tuple[int, ...]) -> dict[int, np.ndarray]:
    """Frame -> logits (h,w) of the unchanged model on `video (T,3,side,side)`, called as its documentation says."""
    session = transformers.Sam2VideoInferenceSession(
        video=video, video_height=size[0], video_width=size[1], dtype=torch.float32
    )
    index = session.obj_id_to_idx(1)
    middle = torch.full((1, 1, 1, 2), model.image_size / 2)
    session.add_point_inputs(index, 0, {"point_coords": middle, "point_labels": torch.ones(1, 1, 1, dtype=torch.int32)})
    session.obj_with_new_inputs.append(1)
    model(session, frame_idx=0)
    masks = {out.frame_idx: out.pred_masks for out in model.propagate_in_video_iterator(session, start_frame_idx=0)}
    return {
        t: functional.interpolate(mask, size, mode="bilinear", align_corners=False)[0, 0].numpy()
        for t, mask in masks.items()
    }
