"""Teachers that read maps which another program made, and bring them to a size that can be kept.

A source is one file or a folder:

* one file: all frames in one array, (T,h,w,C) or (T,C,h,w);
* a folder: one file per frame of the clip, in the order of their names, (h,w,C) or (C,h,w) each;

as `.npy`, `.npz` (the array called `map`, or the only one; `global` besides if there is a vector for the clip) or `.pt` (one
tensor). A folder may hold `spec.json` (`FeatureSpec`; its grid is the source's or a smaller one) and `global.npy`. Where the
width of the features is known, it tells which axis is C; otherwise it is the last one.

| layout | width | notes |
|---|---|---|
| `precomputed` | any | says what it is in `spec.json`; else its text encoder is unknown and it keeps its own grid up to LIMIT |
| `lseg` | 512 | LSeg (ViT-L/16): kept at most LIMIT cells wide, unit length; its words are those of CLIP ViT-B/32 (`clip-b32`) |
| `internvideo` | 1408 | InternVideo2 vision tower: 16x16 tokens a frame, or all in one (T*256+1, 1408) with the class token first |
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import F4xError
from ..reading import DAMAGE, load_json, load_npy, open_npz, reason
from .preprocess import resize_map
from .spec import FeatureSpec

LIMIT = 120
"""Cells along the longer side: LSeg at 480x480x512 would be 236 MB a frame, at 120x120 it is 15 MB."""
ENDINGS = (".npy", ".npz", ".pt", ".pth")
UNREADABLE = (OSError, *DAMAGE)
TOKENS = 16


@dataclass(frozen=True)
class Layout:
    """Width, resizing and text encoder that the files of one model are expected to have."""

    name: str
    """Head name where the source does not say another."""
    dim: int | None = None
    """C; None where the files decide."""
    resize: str = "bilinear"
    """As in `FeatureSpec`."""
    normalise: bool = False
    """Bring every cell to unit length."""
    text_encoder: str | None = None
    """As in `FeatureSpec`."""
    temperature: float | None = None
    """As in `FeatureSpec`."""
    has_global: bool = False
    """A vector for the whole clip belongs to it."""
    provenance: dict[str, Any] = dataclasses.field(default_factory=dict)
    """As in `FeatureSpec`."""


LAYOUTS = {
    "precomputed": Layout("precomputed"),
    "lseg": Layout(
        "lseg",
        512,
        normalise=True,
        text_encoder="clip-b32",
        temperature=0.07,  # its logits are cosines / 0.07, fixed in training (Li et al. 2022, eq. 2)
        provenance={"model": "LSeg ViT-L/16", "words": "CLIP ViT-B/32", "licence": "MIT"},
    ),
    "internvideo": Layout(
        "internvideo", 1408, "area", has_global=True, provenance={"model": "InternVideo2", "licence": "Apache-2.0"}
    ),
}


class Precomputed:
    """A teacher whose maps exist already; `encode_clip` reads them in the order of the frames."""

    def __init__(self, model: Path | str | None = None, layout: str = "precomputed"):
        """Open the source; F4xError when it is missing or not of the layout."""
        self.layout = LAYOUTS[layout]
        if model is None:
            raise F4xError(f"The teacher '{layout}' reads maps that another program made; name them with --model PATH.")
        self.source = Path(model)
        if not self.source.exists():
            raise F4xError(f"{self.source} does not exist; give the file or folder with the maps of '{layout}'.")
        given = self.source / "spec.json"
        self.given = FeatureSpec.from_json(_json(given)) if given.is_file() else None
        self.dim = self.given.dim if self.given else self.layout.dim
        self.glob: np.ndarray | None = None
        self.count, self.read = self._open()
        if self.glob is None and (self.source / "global.npy").is_file():
            self.glob = _array(self.source / "global.npy").astype(np.float32)
        first = self.read(0)
        self.dim = first.shape[-1]
        self.grid = self.given.grid if self.given else _limited(first.shape[0], first.shape[1])
        if self.layout.has_global and self.glob is None:
            raise F4xError(f"{self.source}: the class token of '{layout}' is missing; put it there as global.npy.")

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """Return the spec of the maps; the image size does not matter, the grid always covers the whole image."""
        if self.given is not None:
            return self.given
        layout = self.layout
        return FeatureSpec(
            layout.name,
            self.dim or 0,
            self.grid,
            layout.resize,
            layout.normalise,
            layout.text_encoder,
            layout.temperature,
            has_global=self.glob is not None,
            provenance={**layout.provenance, "source_grid": list(self.read(0).shape[:2])},
        )

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """Raise F4xError: there is no model here, only its results."""
        raise F4xError(f"{self.source} holds maps of one clip and cannot encode other pictures.")

    def encode_clip(self, frames: Sized) -> Iterator[np.ndarray]:
        """Yield (h,w,C) float32 of every frame, at the grid of the spec; F4xError when the numbers of frames differ."""
        if self.count != len(frames):
            raise F4xError(
                f"{self.source} holds {self.count} maps, the clip has {len(frames)} frames; make them equal."
            )
        normalise = self.given.normalised if self.given else self.layout.normalise
        resize = self.given.resize if self.given else self.layout.resize
        for t in range(self.count):
            x = torch.from_numpy(np.array(self.read(t), np.float32)).permute(2, 0, 1)[None]  # (1,C,h,w)
            x = resize_map(x, self.grid, resize)
            if normalise:
                x = torch.nn.functional.normalize(x, dim=1)
            yield x[0].permute(1, 2, 0).numpy()

    def _open(self) -> tuple[int, Callable[[int], np.ndarray]]:
        """Return (number of frames, function that reads the map (h,w,C) of one)."""
        if self.source.is_dir():
            files = [
                f for f in self.source.iterdir() if f.suffix in ENDINGS and f.stem not in ("global", "basis", "mean")
            ]
            files.sort(
                key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
            )
            if not files:
                raise F4xError(f"{self.source} holds no {', '.join(ENDINGS)} files; put one per frame there.")
            if len(files) > 1 or _array(files[0]).ndim == 3:
                return len(files), lambda t: self._channels_last(files[t], _array(files[t]))
            return self._stack(files[0])
        return self._stack(self.source)

    def _stack(self, file: Path) -> tuple[int, Callable[[int], np.ndarray]]:
        """Return all frames in one array."""
        if file.suffix == ".npz" and (vector := _member(file, "global")) is not None:
            self.glob = vector.astype(np.float32)
        stack = _array(file)
        if self.layout.name == "internvideo" and stack.ndim == 2 and len(stack) % TOKENS**2 == 1:
            self.glob = np.asarray(stack[0], np.float32)
            stack = stack[1:].reshape(-1, TOKENS, TOKENS, stack.shape[1])
        if stack.ndim != 4:
            raise F4xError(f"{file} has shape {stack.shape}; give (T,h,w,C), (T,C,h,w) or one file per frame.")
        return len(stack), lambda t: self._channels_last(file, stack[t])

    def _channels_last(self, file: Path, array: np.ndarray) -> np.ndarray:
        if array.ndim != 3 or 0 in array.shape:
            raise F4xError(f"{file} has shape {array.shape}; a map is (h,w,C) or (C,h,w).")
        if self.dim is not None and array.shape[-1] != self.dim:
            if array.shape[0] != self.dim:
                raise F4xError(f"{file} has shape {array.shape}; '{self.layout.name}' needs {self.dim} channels.")
            array = np.moveaxis(array, 0, -1)
        return array


def _limited(rows: int, columns: int) -> tuple[int, int]:
    """Return the grid, smaller where it exceeds LIMIT."""
    scale = min(1.0, LIMIT / max(rows, columns))
    return max(1, round(rows * scale)), max(1, round(columns * scale))


def _array(file: Path) -> np.ndarray:
    """Return the array of a file: mapped from `.npy`, `map` or the only one of `.npz`, the tensor of `.pt`."""
    try:
        if file.suffix in (".pt", ".pth"):
            tensor = torch.load(file, map_location="cpu", weights_only=True)
            if not isinstance(tensor, torch.Tensor):
                raise F4xError(f"{file} holds a {type(tensor).__name__}; save one tensor.")
            return tensor.numpy() if tensor.dtype != torch.bfloat16 else tensor.float().numpy()
        if file.suffix == ".npz":
            array = _member(file, "map")
            if array is None:
                raise F4xError(f"{file} holds no array called 'map'; name it so.")
            return array
        if file.suffix == ".npy":
            return load_npy(file, mapped=True)
    except UNREADABLE as error:
        raise F4xError(f"{file} cannot be read ({reason(error)}); write it again.") from error
    raise F4xError(f"{file} is no map; give {', '.join(ENDINGS)}.")


def _member(file: Path, name: str) -> np.ndarray | None:
    """Return the array `name` of an `.npz`; for `map` also the only one there is."""
    try:
        with open_npz(file) as arrays:
            if name not in arrays and (name != "map" or len(arrays) != 1):
                return None
            return arrays[name if name in arrays else next(iter(arrays))]
    except UNREADABLE as error:
        raise F4xError(f"{file} cannot be read ({reason(error)}); write it again.") from error


def _json(path: Path) -> Any:
    try:
        return load_json(path)
    except (OSError, ValueError) as error:
        raise F4xError(f"{path} is not readable JSON ({error}); write it again.") from error
