"""The clip that every later stage works on."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import are_indices
from ..geometry.camera import CameraPath
from .notes import Remark

MIN_FRAMES = 3
"""Supervised frames that a clip needs at least: fewer tell no motion from parallax."""
MIN_SIDE = 16
"""Pixels; smaller pictures hold no pattern that flow could follow."""


@dataclass(frozen=True)
class Picture:
    """Rectangle of the picture in a source's frames: pixels `left` to `right` of `width`, `top` to `bottom` of `height`."""

    left: int
    top: int
    right: int
    bottom: int
    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.right - self.left}x{self.bottom - self.top} of {self.width}x{self.height}"

    @classmethod
    def read(cls, values: object) -> Picture | None:
        """Read the JSON object of a scene file; None where that is none."""
        names = {entry.name for entry in fields(cls)}
        if (
            not isinstance(values, dict)
            or values.keys() != names
            or not all(type(each) is int for each in values.values())
        ):
            return None
        read = cls(**values)
        inside = 0 <= read.left < read.right <= read.width and 0 <= read.top < read.bottom <= read.height
        return read if inside else None


def cut(pixels: np.ndarray, picture: Picture | None) -> np.ndarray:
    """Return the `picture` of `pixels (h,w,…)`, a frame of its source or a mask of that at any size; all where it is None."""
    if picture is None:
        return pixels
    down, across = pixels.shape[0] / picture.height, pixels.shape[1] / picture.width
    rows, columns = (
        slice(round(first * scale), round(end * scale))
        for first, end, scale in ((picture.top, picture.bottom, down), (picture.left, picture.right, across))
    )
    return pixels[rows, columns]


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames of one camera in order of time. T frames of H x W pixels."""

    name: str
    """Short name for files and titles."""
    frames: np.ndarray
    """(T, H, W, 3) uint8, sRGB."""
    times: np.ndarray
    """(T,) float64 clip frames, from 0: the frame index 0 .. T-1, but for films whose frames are not evenly spaced in time."""
    fps: float
    """Clip frames per second (a stride divides the rate of the source)."""
    held_out: np.ndarray
    """(T,) bool: frames that the fit may not see, kept for evaluation."""
    source: str
    """The path it was read from."""
    picked: str = ""
    """Frames of that source, `first:end:step` with all three numbers; empty = not known."""
    cameras: CameraPath | None = None
    """Cameras of all T frames at `times`, in the units of the source, where the source knows them."""
    masks: np.ndarray | None = None
    """(T, H, W) bool: moving objects, where the user or the source gives them."""
    depth: np.ndarray | None = None
    """(T, H, W) float32, z depth in the units of `cameras`, NaN = unknown."""
    picture: Picture | None = None
    """Rectangle that was cut out of the source's frames, where they have black bars (`clip.bars`); None: all of them."""
    hidden: np.ndarray | None = None
    """(T, H, W) bool: pixels that nobody saw, as alpha hides them; they have the colours around them. None: all are seen."""
    remarks: tuple[Remark, ...] = ()
    """Remarks on frames and stamps that were left out, mended or guessed while the source was read."""

    def __post_init__(self):
        """Refuse arrays that do not belong together."""
        if self.frames.ndim != 4 or self.frames.shape[3] != 3 or self.frames.dtype != np.uint8 or not len(self.frames):
            raise F4xError(f"{self.source}: a clip needs uint8 frames (T, H, W, 3), got {self.frames.shape}")
        for name in ("times", "held_out", "cameras"):
            value = getattr(self, name)
            if value is not None and len(value) != len(self):
                raise F4xError(f"{self.source}: {len(self)} frames but {len(value)} entries in {name}")
        for name in ("masks", "depth", "hidden"):
            value = getattr(self, name)
            if value is not None and value.shape != self.frames.shape[:3]:
                raise F4xError(f"{self.source}: frames {self.frames.shape[:3]} but {name} {value.shape}")

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def width(self) -> int:
        """Pixels in a row."""
        return self.frames.shape[2]

    @property
    def height(self) -> int:
        """Pixels in a column."""
        return self.frames.shape[1]

    @property
    def supervised(self) -> np.ndarray:
        """Indices `(F,)` of the frames that the fit may see."""
        return np.flatnonzero(~self.held_out)

    def require_enough(self) -> None:
        """Raise F4xError where there are too few supervised frames, or too small pictures, for any fit."""
        count = len(self.supervised)
        if count < MIN_FRAMES:
            few = f"{count} {'frame is' if count == 1 else 'frames are'} too few to tell motion from parallax"
            raise F4xError(f"{self.source}: {few}; give at least {MIN_FRAMES}.")
        if min(self.width, self.height) < MIN_SIDE:
            raise F4xError(
                f"{self.source}: pictures of {self.width}x{self.height} are too small; give at least {MIN_SIDE}x{MIN_SIDE}"
                " pixels."
            )

    @property
    def steady(self) -> bool:
        """True if the frames are evenly spaced, so that their times are their indices."""
        return are_indices(self.times)

    @property
    def digest(self) -> str:
        """Hash of the pictures that the fit may see and of their times."""
        state = hashlib.blake2b(self.supervised.astype(np.int64).tobytes(), digest_size=16)
        for frame in self.supervised:
            state.update(np.ascontiguousarray(self.frames[frame]).tobytes())
        if not self.steady:
            state.update(self.times.astype(np.float64).tobytes())
        if self.hidden is not None:
            state.update(np.packbits(self.hidden[self.supervised]).tobytes())
        return state.hexdigest()
