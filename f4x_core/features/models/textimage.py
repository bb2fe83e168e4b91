"""Dense features that words can be compared with: TIPSv2 and CLIP, their picture side and their text side.

Both models align whole pictures with text; their patches become comparable when the last attention passes the values on
without mixing the patches (MaskCLIP, Zhou et al. 2022, sec. 3.2). TIPSv2 keeps the residual and the feed-forward part of that
block (its own zero-shot segmentation), CLIP drops both. Pictures are read through overlapping square windows of the size the
model was trained on, and the unit vectors of the windows are averaged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from ..memory import memory_guard
from ..preprocess import image_tensor
from ..spec import FeatureSpec
from ..text import average_templates
from .loading import find, load, load_tokenizer, transformers

CLIP_MEAN, CLIP_STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
OVERLAP = {"tipsv2": 0.25, "clip": 0.5}
"""Fraction of a window that overlaps the next one (TIPSv2: 448 px windows 336 px apart, as in its own code)."""
MAGNIFICATION = {"tipsv2": 1, "clip": 2}
"""Shorter side of the picture in windows: CLIP's 14 x 14 patches of one window are too few for a whole picture."""
TEMPLATES = (
    "itap of a {}.",
    "a bad photo of the {}.",
    "a origami {}.",
    "a photo of the large {}.",
    "a {} in a video game.",
    "art of the {}.",
    "a photo of the small {}.",
    "a photo of a {}.",
    "{}",
)
"""Sentences whose embeddings are averaged: the seven that CLIP's authors found best together, and two plain ones."""

Mixing = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]
"""Queries, keys, values (B,heads,n,d) -> (B,heads,n,d)."""


def values_only(queries: torch.Tensor, keys: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Let every patch keep its own value."""
    return values


def attend(attention: Any, x: torch.Tensor, mix: Mixing) -> torch.Tensor:
    """Return an attention layer of either model on x (B,n,C) with its own mixing of values; `mix` = softmax attention: itself."""
    heads = getattr(attention, "num_attention_heads", None) or attention.num_heads
    split = [
        layer(x).unflatten(-1, (heads, -1)).transpose(1, 2)
        for layer in (attention.q_proj, attention.k_proj, attention.v_proj)
    ]  # 3 x (B,heads,n,d)
    out = attention.o_proj if hasattr(attention, "o_proj") else attention.out_proj
    return out(mix(*split).transpose(1, 2).flatten(2))


def tipsv2_block(layer: Any, x: torch.Tensor, mix: Mixing) -> torch.Tensor:
    """Apply one block of TIPSv2's vision tower to tokens x (B,n,C)."""
    x = x + layer.layer_scale1(attend(layer.attention, layer.norm1(x), mix))
    return x + layer.layer_scale2(layer.mlp(layer.norm2(x)))


class TextImageTeacher:
    """Frames to unit vectors in the space of a text encoder; one cell per patch of the magnified picture."""

    def __init__(self, model: str | Path | None = None, name: str = "tipsv2") -> None:
        self.name, self.weights = name, find(name, model)
        self.model: Any = load(_CLASSES[name], self.weights)
        vision = self.model.config.vision_config
        self.patch = int(vision.patch_size)
        self.cells = int(vision.image_size) // self.patch
        """Patches along the side of one window."""

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """Return the spec: `cells * MAGNIFICATION` patches along the shorter side, in the aspect of the picture."""
        short = self.cells * MAGNIFICATION[self.name]
        scale = short / min(width, height)
        rows, columns = (max(short, round(side * scale)) for side in (height, width))
        return FeatureSpec(
            name=self.name,
            dim=_dim(self.name, self.model),
            grid=(rows, columns),
            resize="bilinear",
            normalised=True,
            text_encoder=self.name,
            temperature=_temperature(self.name, self.model),
            has_global=False,
            provenance=self.weights.provenance([columns * self.patch, rows * self.patch]),
        )

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """Return the features (h,w,C) float32, unit length, of a picture (H,W,3) uint8."""
        rows, columns = self.spec_for(rgb.shape[1], rgb.shape[0]).grid
        cells, patch = self.cells, self.patch
        step = max(1, round(cells * (1 - OVERLAP[self.name])))
        mean, std = (CLIP_MEAN, CLIP_STD) if self.name == "clip" else ((0.0,) * 3, (1.0,) * 3)
        with torch.inference_mode(), memory_guard(f"{self.name} on {columns * patch} x {rows * patch} pixels"):
            pixels = image_tensor(rgb, (rows * patch, columns * patch), mean, std)
            total = torch.zeros(rows, columns, _dim(self.name, self.model))
            for top in _starts(rows, cells, step):
                for left in _starts(columns, cells, step):
                    window = pixels[..., top * patch : (top + cells) * patch, left * patch : (left + cells) * patch]
                    total[top : top + cells, left : left + cells] += self._window(window)
            return functional.normalize(total, dim=-1).numpy()

    def _window(self, pixels: torch.Tensor) -> torch.Tensor:
        """Return unit vectors (cells,cells,C) of one window (1,3,side,side)."""
        vision = self.model.vision_model
        if self.name == "clip":
            layer = vision.encoder.layers[-1]
            x = tokens_before(vision, layer.layer_norm1, pixels)
            x = attend(layer.self_attn, layer.layer_norm1(x), values_only)
            x = self.model.visual_projection(vision.post_layernorm(x))
        else:
            layer = vision.encoder.layer[-1]
            x = vision.layernorm(tipsv2_block(layer, tokens_before(vision, layer.norm1, pixels), values_only))
        patches = x[0, -(self.cells**2) :]  # class and register tokens come first
        return functional.normalize(patches, dim=-1).unflatten(0, (self.cells, self.cells))


class TextImageEncoder:
    """Labels to unit vectors in the space of the checkpoint `name`, of either architecture; averaged over `templates`."""

    def __init__(
        self, model: str | Path | None = None, name: str = "tipsv2", templates: Sequence[str] = TEMPLATES
    ) -> None:
        weights = find(name, model)
        kind = weights.entry.architecture
        self.name, self.templates = name, templates
        self.model: Any = load(_CLASSES[kind], weights)
        self.tokenizer = load_tokenizer(weights)
        self.dim, self.temperature = _dim(kind, self.model), _temperature(kind, self.model)

    def encode(self, labels: list[str]) -> np.ndarray:
        """Return unit vectors (L,dim) float32; F4xError for an empty label."""
        return average_templates(labels, self.templates, self._embed)

    def _embed(self, sentences: list[str]) -> np.ndarray:
        """Return (n,dim) float32 of whole sentences, of any length."""
        limit = self.model.config.text_config.max_position_embeddings
        with torch.inference_mode():
            tokens = self.tokenizer(sentences, padding=True, truncation=True, max_length=limit, return_tensors="pt")
            found = self.model.get_text_features(tokens["input_ids"], attention_mask=tokens["attention_mask"])
        return getattr(found, "pooler_output", found).numpy()  # older releases return the tensor itself


_CLASSES = {"tipsv2": transformers.Tipsv2Model, "clip": transformers.CLIPModel}
"""By architecture, which for these two is also the teacher's name."""


class _Reached(Exception):  # noqa: N818 - a signal, not an error
    """The tokens before the last block are known."""


def tokens_before(vision: Any, norm: torch.nn.Module, pixels: torch.Tensor) -> torch.Tensor:
    """Return the tokens (B,n,C) that reach `norm`, the first layer of the last block; the block itself does not run."""
    caught: list[torch.Tensor] = []

    def stop(_: torch.nn.Module, inputs: tuple[torch.Tensor, ...]) -> None:
        caught.append(inputs[0])
        raise _Reached

    handle = norm.register_forward_pre_hook(stop)
    try:
        vision(pixels)
    except _Reached:
        pass
    finally:
        handle.remove()
    return caught[0]


def _dim(name: str, model: Any) -> int:
    return int(model.config.projection_dim if name == "clip" else model.config.vision_config.hidden_size)


def _temperature(name: str, model: Any) -> float:
    return math.exp(-float(model.logit_scale)) if name == "clip" else float(model.temperature)


def _starts(length: int, window: int, step: int) -> list[int]:
    """Return the first cells of windows that cover `length` cells; the last one ends flush."""
    return [*range(0, length - window, step), length - window]
