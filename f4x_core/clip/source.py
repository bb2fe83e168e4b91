"""The source of a clip, a film or a folder, as one sequence of frames: without bars and repeats, all of one size."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..files import user_path
from .bars import picture_of
from .clock import Clock, Shown, rate_without_repeats, read_clock
from .folders import review
from .hidden import shrunk
from .images import alike, read_picture, resize_color, scaled
from .layouts import DEFAULT_FPS, Distortion, Layout, find_layout
from .model import Picture, cut
from .notes import Note, Remark, remarks
from .pixels import SEEN, WHITE
from .video import decode, describe

Size = Callable[[int, int], tuple[int, int]]
"""Width and height of a frame of the source -> of the frame that is wanted."""


@dataclass
class Source:
    """A film, or a folder whose `layout` is known; frames count from 0 without those that are left out."""

    path: Path
    layout: Layout | None
    white: int = WHITE
    """White level of pictures of 16 bits."""
    notes: list[Note] = field(default_factory=list)
    """Notes so far on frames and stamps that were left out, mended or guessed."""
    stamps: list[float] = field(default_factory=list)
    """Seconds of the frames that are kept, chosen or not, as far as they are decoded; of all in a folder."""
    numbers: list[int] = field(default_factory=list)
    """Their places among all frames of the source."""
    ended: bool = False
    """There are no more."""

    @classmethod
    def of(cls, path: str | Path) -> Source:
        """Open a source; F4xError where a folder holds no frames."""
        path = user_path(path)
        if path.is_file():
            return cls(path, None)
        layout = find_layout(path)
        # Cameras tell where each picture was taken, twice or not.
        found = review(layout.images, repeats=layout.intrinsics is None)
        notes = [*layout.notes, *found.notes]
        if layout.intrinsics is not None:
            return cls(path, layout, found.white, notes)
        places = np.arange(len(layout.images)) if layout.places is None else layout.places
        return cls(path, kept_of(layout, found.kept, places), found.white, notes)

    @property
    def name(self) -> str:
        """Short name for files and titles."""
        return self.path.stem if self.layout is None else self.layout.name

    @cached_property
    def picture(self) -> Picture | None:
        """Place of the picture in the frames; None where they have no bars."""
        return picture_of(self.path, self.layout)

    @cached_property
    def claimed(self) -> tuple[float, int]:
        """Frames per second, and the number of frames with those that are left out, 0 where a film does not tell it."""
        if self.layout is None:
            rate, count = describe(self.path)
            return rate or DEFAULT_FPS, count
        return self.layout.fps, self.layout.total or len(self.layout.images)

    def frames(self, span: slice, size: Size, alpha_is_mask: bool = False) -> Iterator[Shown]:
        """Yield the frames of `span` (start, stop and step of a slice), resized to `size`, with `alpha` (H,W) bool.

        It says where colours are hidden and thus filled from around; with `alpha_is_mask` colours are as they are stored, and it
        says where they are shown.
        """
        if self.layout is None:
            # `islice` over the decoder and not a list: a film decodes to more than any memory
            found: Iterator[Shown] = islice(
                self._counted(decode(self.path, self.notes)), span.start, span.stop, span.step
            )
        else:
            count = len(self.layout.images)
            self.stamps = [self._stamp(self.layout, row) for row in range(count)]
            self.numbers, self.ended = [self.layout.file_of(row) for row in range(count)], True
            found = self._pictures(self.layout, range(count)[span])
        for shown in found:
            pixels = cut(shown.pixels, self.picture)
            alpha = None if shown.alpha is None else cut(shown.alpha, self.picture)
            wanted = size(pixels.shape[1], pixels.shape[0])
            if alpha_is_mask:
                shows = None if alpha is None else resize_color(alpha, *wanted) >= SEEN
                yield shown._replace(pixels=resize_color(pixels, *wanted), alpha=shows)
            else:
                pixels, hidden = shrunk(pixels, alpha, *wanted)
                yield shown._replace(pixels=pixels, alpha=hidden)

    def clock(self, seconds: list[float] | np.ndarray, tick: float, step: int) -> Clock:
        """Return the clock of frames of the source that are `step` apart."""
        rate, slower = self.claimed[0], 0.0
        if any(note.kind == "repeated" for note in self.notes):
            slower = rate_without_repeats(self.stamps, rate) / step
        return read_clock(seconds, tick, rate / step, slower)

    def remarks(self, indices: np.ndarray, clock: Clock, hidden: float) -> tuple[Remark, ...]:
        """Return the remarks on the clip of frames `indices` with this clock, of whose pixels alpha hides a fraction `hidden`."""
        numbers = np.array(self.numbers)[indices]
        timed = [note._replace(frame=int(numbers[note.frame])) for note in clock.notes]
        whole = int(indices[0]) == 0, self.ended and int(indices[-1]) == len(self.numbers) - 1
        found = remarks([*self.notes, *timed], numbers, whole)
        if not hidden:
            return found
        words = f"Alpha hides {hidden:.1%} of the pixels, which are neither fitted nor measured."
        return (*found, Remark(words, "Where it marks what moves, and not what is seen, give --masks alpha."))

    def _counted(self, frames: Iterator[Shown]) -> Iterator[Shown]:
        self.stamps, self.numbers = [], []
        for shown in frames:
            self.stamps.append(shown.seconds)
            self.numbers.append(shown.number)
            yield shown
        self.ended = True

    def _stamp(self, layout: Layout, row: int) -> float:
        return float(row if layout.places is None else layout.places[row]) / layout.fps

    def _pictures(self, layout: Layout, rows: range) -> Iterator[Shown]:
        """Yield the pictures `rows` of a folder, undistorted; F4xError where their aspects differ."""
        native: tuple[int, int] | None = None
        for row in rows:
            file = layout.images[row]
            image, alpha = read_picture(file, self.white)
            size = image.shape[1], image.shape[0]
            native = native or size
            if size != native:
                if not alike(*size, *native):
                    sizes = f"{size[0]}x{size[1]}, the first frame is {native[0]}x{native[1]}"
                    raise F4xError(f"{file} is {sizes}; make all frames the same size")
                self.notes.append(Note("resized", layout.file_of(row), text=f"{size[0]}x{size[1]}"))
                image, alpha = scaled(image, *native), None if alpha is None else scaled(alpha, *native)
            if layout.distortions and layout.size:
                image = undistort(image, layout.distortions[row], layout.size)
            yield Shown(image, self._stamp(layout, row), 0.0, layout.file_of(row), alpha)


def kept_of(layout: Layout, rows: np.ndarray, places: np.ndarray) -> Layout:
    """Return the layout with the images `rows` alone, each at its place in time."""

    def chosen(files: list[Path]) -> list[Path]:
        return [files[row] for row in rows] if len(files) == len(layout.images) else files

    return replace(
        layout,
        images=chosen(layout.images),
        masks=chosen(layout.masks),
        depth=chosen(layout.depth),
        places=places[rows],
        rows=rows,
        total=len(layout.images),
    )


def read_pictures(layout: Layout, rows: np.ndarray, size: Size) -> np.ndarray:
    """Return the pictures `rows` of a layout, (T,H,W,3) uint8, undistorted and resized to `size`; F4xError for several aspects."""
    source = Source(layout.images[0].parent, layout)
    source.picture = None
    return np.concatenate([[shown.pixels] for row in rows for shown in source.frames(slice(row, row + 1), size)])


def undistort(image: np.ndarray, lens: Distortion, size: tuple[int, int]) -> np.ndarray:
    """Return the picture a pinhole with the same intrinsics would have taken; black where the lens saw nothing."""
    import cv2

    scale = np.array([image.shape[1] / size[0], image.shape[0] / size[1], 1.0])[:, None]
    intrinsics = lens.intrinsics * scale
    intrinsics[:2, 2] -= 0.5  # OpenCV counts pixel centres at whole numbers
    return cv2.undistort(image, intrinsics, lens.coefficients)
