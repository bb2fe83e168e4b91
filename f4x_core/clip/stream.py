"""Clips that no memory should hold at once: surveyed in one pass, then read a window at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from ..progress import Progress, silent
from .changes import find_changes
from .images import even_size, resize_color
from .layouts import find_layout
from .read import frame_indices, parse_span, read_pictures
from .video import decode, describe

STAGE = "surveying clip"


@dataclass(frozen=True)
class Survey:
    """What is known of a clip before its frames are looked at closely."""

    first: int
    """Frame of the source that is clip frame 0."""
    step: int
    """Frames of the source from one clip frame to the next."""
    count: int
    """Clip frames T."""
    cuts: tuple[int, ...]
    """First frames of the shots after the first."""

    def part(self, start: int, end: int) -> str:
        """Clip frames `start` to `end` (not included) as the `frames` of `read_clip`."""
        return f"{self.first + start * self.step}:{self.first + (end - 1) * self.step + 1}:{self.step}"


def claimed_frames(source: str | Path, frames: str | None = None) -> int:
    """How many frames `read_clip` would read, as far as the source tells without being decoded; 0 = it does not."""
    source = Path(source).expanduser()
    total = describe(source)[1] if source.is_file() else len(find_layout(source.absolute()).images)
    return len(frame_indices(frames, total, source)) if total else 0


def survey(
    source: str | Path, frames: str | None = None, width: int | None = None, progress: Progress = silent
) -> Survey:
    """Read through a clip once, one frame in memory at a time, and find its cuts.

    The arguments are those of `read_clip`. Raises F4xError for whatever cannot be read.
    """
    source = Path(source).expanduser()
    seen = 0

    def counted(pictures: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
        nonlocal seen
        for picture in pictures:
            progress(STAGE, seen, expected)
            seen += 1
            yield picture

    expected = claimed_frames(source, frames)
    if source.is_file():
        span = parse_span(frames)
        # `islice` over the decoder and not a list: a film decodes to more than any memory
        pictures = (
            resize_color(image, *even_size(image.shape[1], image.shape[0], width))
            for image in islice(decode(source), span.start, span.stop, span.step)
        )
        first, stride = span.start or 0, span.step or 1
    else:
        layout = find_layout(source.absolute())
        indices = frame_indices(frames, len(layout.images), source)
        size = partial(even_size, new_width=width)
        pictures = (read_pictures(layout, indices[i : i + 1], size)[0] for i in range(len(indices)))
        first, stride = int(indices[0]), int(indices[1] - indices[0]) if len(indices) > 1 else 1
    changes = find_changes(counted(pictures))
    progress(STAGE, seen, seen)
    return Survey(first, stride, seen, tuple(changes.cuts.tolist()))
