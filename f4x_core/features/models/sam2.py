"""SAM 2.1: the three levels of its feature pyramid, of which its mask decoder makes masks in programs that have one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..memory import memory_guard
from ..preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor
from ..spec import FeatureSpec
from .loading import find, load, transformers

DEFAULT = "sam2-tiny"
LEVELS = {"sam2_s0": 0, "sam2_s1": 1, "sam2": 2}
"""Head -> level of the feature pyramid, fine to coarse; the fine two are the skip connections of the mask decoder."""


class Sam2Teacher:
    """Frames to one level of SAM 2's feature pyramid (`LEVELS`), not normalised, without the no-memory embedding."""

    def __init__(self, model: str | Path | None = None, head: str = "sam2") -> None:
        self.head, self.level = head, LEVELS[head]
        self.weights = find(DEFAULT, model)
        self.model: Any = load(transformers.Sam2VideoModel, self.weights)

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """Return the spec for pictures of any size: they are stretched to the model's square."""
        decoder = self.model.config.mask_decoder_config.hidden_size
        return FeatureSpec(
            name=self.head,
            dim=(decoder // 8, decoder // 4, decoder)[self.level],
            grid=tuple(self.model.backbone_feature_sizes[self.level]),
            resize="bilinear",
            normalised=False,
            text_encoder=None,
            temperature=None,
            has_global=False,
            provenance=self.weights.provenance([self.model.image_size] * 2),
        )

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """Return the features (h,w,C) float32 of a picture (H,W,3) uint8."""
        side = self.model.image_size
        with torch.inference_mode(), memory_guard(f"SAM 2 on {side} x {side} pixels"):
            pixels = image_tensor(rgb, (side, side), IMAGENET_MEAN, IMAGENET_STD)  # (1,3,side,side)
            flat = self.model.get_image_features(pixels, return_dict=True).fpn_hidden_states[self.level]  # (hw,1,C)
        height, width = self.model.backbone_feature_sizes[self.level]
        return flat[:, 0].reshape(height, width, -1).numpy().astype(np.float32)
