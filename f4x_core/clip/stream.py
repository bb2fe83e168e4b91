"""Clips too long for memory: surveyed in one pass, then read window by window or streamed frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..files import user_path
from ..progress import Progress, silent
from .changes import find_changes
from .clock import Clock, Shown
from .images import even_size
from .layouts import DEFAULT_FPS, find_layout
from .notes import Remark
from .read import frame_indices, parse_span
from .source import Source
from .video import describe

STAGE = "surveying clip"


@dataclass(frozen=True)
class Survey:
    """Frame range and cuts of a clip, found in one pass over its frames."""

    first: int
    """Frame of the source that is clip frame 0."""
    step: int
    """Frames of the source from one clip frame to the next."""
    count: int
    """Clip frames T."""
    cuts: tuple[int, ...]
    """First frames of the shots after the first."""
    rate: float = DEFAULT_FPS
    """Clip frames per second, as the source says."""
    seconds: np.ndarray | None = None
    """(T,) time stamps of the clip frames."""
    tick: float = 0.0
    """Seconds to which they are rounded."""
    source: Source | None = None
    """The clip that was read."""
    remarks: tuple[Remark, ...] = ()
    """Notes on frames and stamps that were left out, mended or guessed."""

    def part(self, start: int, end: int) -> str:
        """Clip frames `start` to `end` (not included) as the `frames` of `read_clip`."""
        return f"{self.first + start * self.step}:{self.first + (end - 1) * self.step + 1}:{self.step}"

    def clock(self, start: int, end: int) -> Clock:
        """Return the clock of a clip of the frames `start` to `end` (not included)."""
        if self.seconds is None or self.source is None:
            return Clock(np.arange(end - start, dtype=np.float64), self.rate)
        return self.source.clock(self.seconds[start:end], self.tick, self.step)


@dataclass(frozen=True)
class ClipStream:
    """A clip whose frames are read from disk on each iteration, one in memory at a time.

    It can be passed instead of a `Clip` where `frames` is only iterated over.
    """

    source: Path
    """Source as `read_clip` takes it."""
    picked: str | None
    """The `frames` of `read_clip`."""
    width: int
    """Pixels in a row; pictures are averaged down to it."""
    height: int
    """Pixels in a column, as they must come out."""
    count: int
    """Frames, as many as there must be."""

    @property
    def frames(self) -> ClipStream:
        """An iterable of the frames (H,W,3) uint8 in order; F4xError where the source has another size or number of frames."""
        return self

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[np.ndarray]:
        seen, (high, wide) = 0, (self.height, self.width)
        for shown in Source.of(self.source).frames(parse_span(self.picked), self._size):
            seen, (high, wide) = seen + 1, shown.pixels.shape[:2]
            if seen > self.count or (high, wide) != (self.height, self.width):
                break
            yield shown.pixels
        if seen != self.count or (high, wide) != (self.height, self.width):
            less = "" if seen < self.count else "at least "
            raise F4xError(
                f"{self.source}: the clip has {less}{seen} frames of {wide}x{high}, wanted are"
                f" {self.count} of {self.width}x{self.height}; give the clip that the scene was fitted to, with the same"
                " --frames."
            )

    def _size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size that a frame of the source gets: exactly the wanted one if rounding alone makes the difference."""
        found = even_size(width, height, self.width)
        return (self.width, self.height) if abs(found[1] - self.height) <= 2 else found


def reported_frame_count(source: str | Path, frames: str | None = None) -> int:
    """Return the number of frames that `read_clip` would read, from the metadata of the source; 0 where those do not give it."""
    source = user_path(source)
    total = describe(source)[1] if source.is_file() else len(find_layout(source).images)
    return len(frame_indices(frames, total, source)) if total else 0


def survey(
    source: str | Path, frames: str | None = None, width: int | None = None, progress: Progress = silent
) -> Survey:
    """Read through a clip once, one frame in memory at a time, and find its cuts.

    The arguments are those of `read_clip`. Raises F4xError for whatever cannot be read.
    """
    found, span = Source.of(source), parse_span(frames)
    seconds: list[float] = []
    tick, hidden = 0.0, 0.0

    def counted(pictures: Iterator[Shown]) -> Iterator[np.ndarray]:
        nonlocal tick, hidden
        for shown in pictures:
            progress(STAGE, len(seconds), expected)
            seconds.append(shown.seconds)
            tick = shown.tick
            hidden += 0.0 if shown.alpha is None else float(shown.alpha.mean())
            yield shown.pixels

    expected = reported_frame_count(source, frames)
    cuts = find_changes(counted(found.frames(span, partial(even_size, new_width=width)))).cuts
    progress(STAGE, len(seconds), len(seconds))
    indices = frame_indices(frames, len(found.stamps), found.path)
    clock = found.clock(seconds, tick, span.step or 1)
    remarks = found.remarks(indices, clock, hidden / len(seconds))
    rate = found.claimed[0] / (span.step or 1)
    return Survey(
        int(indices[0]),
        span.step or 1,
        len(seconds),
        tuple(cuts.tolist()),
        rate,
        np.array(seconds),
        tick,
        found,
        remarks,
    )
