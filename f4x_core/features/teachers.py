"""The registry of teachers - models that turn frames into feature maps - and the one way to run them over a clip."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from ..clip import Clip
from ..clip.stream import ClipStream
from ..errors import F4xError
from ..native.kernels import torch_threads
from ..parallel import in_threads, side_by_side, thread_count
from ..progress import Progress, silent
from .maps import FeatureMaps, MapsPlan, read_maps, read_stored, write_maps
from .spec import FeatureSpec
from .text import factory_of
from .weights import describe, require_path


class Teacher(Protocol):
    """A model that maps single pictures.

    One that needs the whole clip has `encode_clip(frames) -> Iterator[(h,w,C)]` besides, which is then used: `frames` has a
    length and gives (H,W,3) uint8 as often as one goes through it. Where its spec says `has_global`, `glob` holds the clip's
    vector (C,) after the last frame. A class with `SMALL = True` encodes a frame on one thread in little memory: several frames
    are then encoded side by side, and its maps do not depend on the number of threads.
    """

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """Return the spec of the maps of images of this size."""
        ...

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """Return the map (h,w,C) float32 of a picture (H,W,3) uint8."""
        ...


@dataclass(frozen=True)
class TeacherEntry:
    """Registry entry of a teacher: its purpose, its weights and how to load it."""

    name: str
    """Name for --teacher, and of its head."""
    purpose: str
    """Purpose, in a few words."""
    weights: tuple[str, ...]
    """Names in `weights.WEIGHTS`; empty where the maps come from elsewhere."""
    factory: str
    """`module:class` below this room, called with `model` (path of the weights, hub id or None) and `options`."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further arguments of the factory."""
    version: int = 1
    """Counts changes of its results: maps of another version are made again."""

    @property
    def licence(self) -> str:
        """SPDX ids of the weights."""
        return ", ".join(dict.fromkeys(describe(name)["licence"] for name in self.weights)) or "of the maps"

    @property
    def download_bytes(self) -> int:
        """Size of the weights."""
        return sum(describe(name)["download_bytes"] for name in self.weights)

    @property
    def source(self) -> str:
        """Packages or hub id of the weights."""
        return ", ".join(describe(name)["source"] for name in self.weights) or "files made by another program"

    def load(self, path: Path | str | None = None) -> Teacher:
        """Return the teacher, its packages imported now; F4xError when they or the weights are absent."""
        return cast(Teacher, factory_of(self.factory)(model=path, **self.options))


TEACHERS = {
    entry.name: entry
    for entry in (
        TeacherEntry("visual", "what looks alike: carries masks through a clip", ("mobilenetv2",), ".offline:Visual"),
        TeacherEntry(
            "text",
            "text queries without a download: ImageNet's words",
            ("efficientnet-lite0", "minilm"),
            ".offline:Conse",
        ),
        TeacherEntry(
            "sam2", "maps for the mask decoder of SAM 2 in other programs", ("sam2-tiny",), ".models.sam2:Sam2Teacher"
        ),
        *(
            TeacherEntry(
                f"sam2_{level}",
                "finer maps for the same decoder: a skip connection",
                ("sam2-tiny",),
                ".models.sam2:Sam2Teacher",
                {"head": f"sam2_{level}"},
            )
            for level in ("s0", "s1")
        ),
        TeacherEntry(
            "clip", "text queries, any words", ("clip",), ".models.textimage:TextImageTeacher", {"name": "clip"}
        ),
        TeacherEntry(
            "tipsv2", "text queries, any words", ("tipsv2",), ".models.textimage:TextImageTeacher", {"name": "tipsv2"}
        ),
        TeacherEntry("smolvlm", "questions about the video", ("smolvlm-256m",), ".models.smolvlm:SmolVlmTeacher"),
        TeacherEntry("lseg", "LSeg maps, 512 wide", (), ".precomputed:Precomputed", {"layout": "lseg"}),
        TeacherEntry(
            "internvideo", "InternVideo2 maps, 1408 wide", (), ".precomputed:Precomputed", {"layout": "internvideo"}
        ),
        TeacherEntry("precomputed", "any maps with a spec.json", (), ".precomputed:Precomputed"),
    )
}
"""Every teacher by name."""


def find_teacher(name: str) -> TeacherEntry:
    """Return the entry called `name`; F4xError lists the known ones."""
    if name not in TEACHERS:
        raise F4xError(f"There is no teacher '{name}'; known: {', '.join(TEACHERS)}.")
    return TEACHERS[name]


def require_ready(name: str) -> None:
    """Raise F4xError unless the teacher has weights and they are on this machine."""
    entry = find_teacher(name)
    if not entry.weights:
        raise F4xError(
            f"The teacher '{name}' reads maps that another program made; name them with --model PATH in"
            f" `f4x features CLIP --teacher {name}`, then `f4x distill`."
        )
    for weights in entry.weights:
        require_path(weights)


def extract(
    clip: Clip | ClipStream,
    name: str,
    folder: Path | str,
    model: Path | str | None = None,
    rank: int | None = None,
    progress: Progress = silent,
) -> FeatureMaps:
    """Return the maps of teacher `name` for every frame of `clip`, in `folder` (which gets `spec.json`, `maps.npy`, …).

    Does nothing when `folder` holds maps of the same teacher, weights, frames and rank. `model` is a folder with the
    weights (or with the maps, of teachers that read files), a hub id, or the name of another checkpoint; `rank` as in
    `write_maps`. A cancelled or failed run leaves what was there before; the next one with the same settings goes on where
    it stopped, but for teachers that need the whole clip.
    """
    import torch  # here, so that the registry can be listed without waiting for it

    folder, entry = Path(folder), find_teacher(name)
    seen = hashlib.blake2b(digest_size=16)
    for image in clip.frames:
        progress("looking at the clip", 0, 0)
        seen.update(np.ascontiguousarray(image).data)
    settings = {
        "teacher": name,
        "version": entry.version,
        "model": _fingerprint(model),
        "rank": rank,
        "frames": seen.hexdigest(),
    }
    if (folder / "spec.json").is_file() and read_stored(folder).get("settings") == settings:
        return read_maps(folder)
    threads = torch.get_num_threads()
    with side_by_side(threads):  # which keeps BLAS to one thread, whose sums depend on their number
        teacher = entry.load(model)
    own, of_torch = (threads, 1) if getattr(teacher, "SMALL", False) else (1, threads)
    with torch.inference_mode(), torch_threads(of_torch), side_by_side(own):
        spec = teacher.spec_for(clip.width, clip.height)
        whole = getattr(teacher, "encode_clip", None)
        frames = whole(clip.frames) if whole else lambda first: _encoded(teacher, islice(clip.frames, first, None))
        plan = MapsPlan(spec, len(clip), rank, settings)
        return write_maps(folder, plan, frames, lambda: cast(Any, teacher).glob, progress)


def _encoded(teacher: Teacher, images: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield the maps of `images` in order, as many at a time as `in_threads` has threads."""
    waiting = iter(images)
    while batch := list(islice(waiting, thread_count())):
        yield from in_threads(teacher.encode, batch)


def _fingerprint(model: Path | str | None) -> str | None:
    """Return a hash of the names, sizes and times of a file or folder of weights, without reading the content."""
    if model is None or not Path(model).exists():
        return None if model is None else str(model)
    root = Path(model)
    files = sorted(file for file in root.rglob("*") if file.is_file()) if root.is_dir() else [root]
    rows = [f"{file.relative_to(root.parent)} {file.stat().st_size} {file.stat().st_mtime_ns}" for file in files]
    return hashlib.blake2b("\n".join(rows).encode(), digest_size=16).hexdigest()
