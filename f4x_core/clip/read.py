"""Reads a `Clip` from a path that a person gives."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import F4xError
from ..files import user_path
from ..geometry.camera import CameraPath
from ..progress import Progress, silent
from ..reading import DAMAGE, load_npy
from .clock import Clock
from .images import alike, even_size, list_images, read_mask, resize_nearest
from .layouts import Layout
from .model import Clip, cut
from .source import Size, Source

LAYOUT, ALPHA = "layout", "alpha"
"""In place of a folder of masks: those that the source comes with, and its alpha."""
STAGE = "reading clip"
USUAL_SIDE = 480
"""Pixels along the longer side of a picture, unless a width is given: what all figures of the project were measured at."""


def read_clip(
    source: str | Path,
    frames: str | None = None,
    width: int | None = None,
    hold_out: int | None = None,
    masks: str | Path | None = None,
    progress: Progress = silent,
) -> Clip:
    """Read a video file, a folder of pictures, or an NVIDIA/RoDynRF, DyCheck/Nerfies or DAVIS folder.

    `frames`: "first:end:step" as in a Python slice, end not included, each part optional; all frames when None.
    `width`: frames are averaged down to this many pixels a row (even sizes, same aspect), never enlarged.
    `hold_out`: with N, frames N-1, 2N-1, ... are kept back from the fit.
    `masks`: a folder of pictures, not 0 where something moves by itself, one for each frame of the source or of the
    selection; "layout" takes those of the source's own layout, "alpha" what its alpha shows; none when None.
    Black bars around the picture are cut off, of masks too (`clip.bars`). Frames that are damaged or repeat the one before are
    left out, and `Clip.remarks` says so. Raises F4xError for whatever cannot be read.
    """
    span = parse_span(frames)
    if width is not None and width < 2:
        raise F4xError(f"--width {width} is too small; give at least 2 pixels")
    if hold_out is not None and hold_out < 2:
        raise F4xError(f"--hold-out {hold_out} would leave no frame to learn from; give 2 or more")
    found, by_alpha = Source.of(source), str(masks) == ALPHA
    layout = found.layout
    pictures = _read(found, span, partial(even_size, new_width=width), by_alpha, progress)
    indices, clock, step = pictures.indices, pictures.clock, span.step or 1
    if hold_out is not None and hold_out > len(indices):
        raise F4xError(
            f"--hold-out {hold_out} holds out none of the {len(indices)} frames of {source}; give a smaller number, or"
            " leave it out"
        )
    if by_alpha and pictures.alpha is None:
        raise F4xError(f"{source} has no alpha in the chosen frames; give a folder of masks, or none")
    if pictures.alpha is not None and not by_alpha and pictures.alpha.all():
        raise F4xError(f"{source}: alpha hides all of the chosen frames; give --masks alpha, or a clip without it")
    height, width = pictures.frames.shape[1:3]
    matte, hidden = (pictures.alpha, None) if by_alpha else (None, pictures.alpha)
    return Clip(
        name=found.name,
        frames=pictures.frames,
        times=clock.times,
        fps=clock.fps,
        held_out=np.arange(len(indices)) % hold_out == hold_out - 1 if hold_out else np.zeros(len(indices), bool),
        source=str(source),
        picked=f"{indices[0]}:{indices[-1] + 1}:{step}",
        cameras=_cameras(layout, indices, width, height) if layout else None,
        masks=matte if by_alpha or masks is None else _read_masks(masks, found, pictures),
        depth=stack_like_frames([layout.depth[index] for index in indices], _load_depth, width, height)
        if layout and layout.depth
        else None,
        picture=found.picture,
        hidden=hidden,
        remarks=found.remarks(indices, clock, 0.0 if hidden is None else float(hidden.mean())),
    )


def usual_width(source: str | Path) -> int:
    """Return the width in pixels at which the longer side of the pictures of `source` has `USUAL_SIDE`, if they are so large."""
    first = read_clip(source, "0:1")
    return even_size(first.width, first.height, USUAL_SIDE * first.width // max(first.width, first.height))[0]


def frame_indices(frames: str | None, count: int, source: Path | str) -> np.ndarray:
    """Return the indices that "first:end:step" picks among `count` frames; F4xError names `source` when it cannot."""
    return _select(parse_span(frames), count, Path(source))


def parse_span(text: str | None) -> slice:
    """Return the slice of "a:b:s", made of numbers >= 0 and a step >= 1."""
    if text is None:
        return slice(None)
    try:
        parts = [int(part) if part.strip() else None for part in text.split(":")]
    except ValueError:
        parts = []
    if not 2 <= len(parts) <= 3 or any(part is not None and part < 0 for part in parts) or parts[2:] == [0]:
        raise F4xError(f"frames '{text}' is not a range; write it as first:end:step, for example 0:48:2")
    span = slice(*parts)
    if span.stop is not None and span.stop <= (span.start or 0):
        raise F4xError(f"frames '{text}' select nothing; the end is not included, so let it be after the first")
    return span


def _select(span: slice, count: int, source: Path) -> np.ndarray:
    """Return the indices of `span` among `count` frames; raises F4xError when they are not all there."""
    if count == 0:
        raise F4xError(f"{source} holds no frames; give a video or a folder of pictures")
    if (span.stop or 0) > count or (span.start or 0) >= count:
        wanted = f"{span.start or 0}:{'' if span.stop is None else span.stop}"
        raise F4xError(f"{source} has frames 0:{count}, frames {wanted} reach beyond; choose a range inside")
    return np.arange(count)[span]


class _Pictures(NamedTuple):
    """The frames of a selection."""

    indices: np.ndarray
    """(T,) places among those that the source keeps."""
    numbers: np.ndarray
    """(T,) places among all of the source."""
    total: int
    """Frames of the source, as far as it is known."""
    frames: np.ndarray
    """(T,H,W,3) uint8."""
    alpha: np.ndarray | None
    """(T,H,W) bool: hidden by alpha, or shown by it where it is a mask; None where nothing is hidden."""
    clock: Clock


def _read(source: Source, span: slice, size: Size, alpha_is_mask: bool, progress: Progress) -> _Pictures:
    """Read the frames of `span`; keeps only those, already small."""
    kept: list[np.ndarray] = []
    alphas: list[np.ndarray | None] = []
    seconds: list[float] = []
    numbers: list[int] = []
    claimed, tick, step = source.claimed[1], 0.0, span.step or 1
    if source.layout is not None:
        _select(span, len(source.layout.images), source.path)  # before any picture is read
    expected = len(range(span.start or 0, min(filter(None, (span.stop, claimed)), default=0), step))
    for shown in source.frames(span, size, alpha_is_mask):
        progress(STAGE, len(kept), max(len(kept) + 1, expected))
        kept.append(shown.pixels)
        alphas.append(shown.alpha)
        seconds.append(shown.seconds)
        numbers.append(shown.number)
        tick = shown.tick
    progress(STAGE, len(kept), len(kept))
    indices = _select(span, len(source.stamps), source.path)
    frames = _stacked(kept, source.path)
    alpha = None
    if any(one is not None for one in alphas):
        plain = np.full(frames.shape[1:3], alpha_is_mask)
        alpha = np.stack([plain if one is None else one for one in alphas])
    return _Pictures(
        indices, np.array(numbers), max(claimed, numbers[-1] + 1), frames, alpha, source.clock(seconds, tick, step)
    )


def _stacked(kept: list[np.ndarray], file: Path) -> np.ndarray:
    """Stack the frames, taking them out of `kept` on the way, so that memory holds them once."""
    try:
        frames = np.empty((len(kept), *kept[0].shape), np.uint8)
    except MemoryError as error:
        height, width = kept[0].shape[:2]
        raise F4xError(
            f"{file}: {len(kept)} frames of {width}x{height} do not fit into memory; give --frames ::2 or a smaller --width"
        ) from error
    for index in reversed(range(len(kept))):
        frames[index] = kept.pop()
    return frames


def _read_masks(masks: str | Path, source: Source, pictures: _Pictures) -> np.ndarray:
    """Return the masks of the frames, cut and resized as they are."""
    layout, (height, width) = source.layout, pictures.frames.shape[1:3]
    if str(masks) == LAYOUT and layout is not None and len(layout.masks) == len(layout.images):
        files = [layout.masks[index] for index in pictures.indices]
    else:
        files = mask_files(masks, layout, source.path, pictures.numbers, pictures.total)
    return stack_like_frames(files, lambda file: cut(read_mask(file), source.picture), width, height)


def _cameras(layout: Layout, indices: np.ndarray, width: int, height: int) -> CameraPath | None:
    if layout.intrinsics is None or layout.world_to_camera is None or layout.size is None:
        return None
    times = np.arange(len(indices))
    path = CameraPath(layout.intrinsics[indices], layout.world_to_camera[indices], times, *layout.size)
    return path.resized(width, height)


def mask_files(masks: str | Path, layout: Layout | None, source: Path, indices: np.ndarray, total: int) -> list[Path]:
    """Return one mask file per selected frame; the folder may hold one per frame of the source or of the selection.

    `indices` count among the `total` frames of the source, those that are left out included.
    """
    if str(masks) == LAYOUT:
        files = layout.masks if layout else []
        if not files:
            raise F4xError(f"{source} comes without masks; give a folder of masks, or none")
    else:
        files = list_images(user_path(masks))
        if not files:
            raise F4xError(f"{masks} holds no masks; give a folder with one picture per frame")
    if len(files) == total:
        return [files[index] for index in indices]
    if len(files) != len(indices):
        raise F4xError(
            f"{files[0].parent} holds {len(files)} masks for {len(indices)} frames; give one per frame of the clip ({total})"
            f" or of the chosen frames ({len(indices)})"
        )
    return files


def _load_depth(file: Path) -> np.ndarray:
    """Return `(H, W)` float32 with NaN where the sensor saw nothing (0)."""
    try:
        depth = load_npy(file).astype(np.float32)
    except (OSError, *DAMAGE) as error:
        raise F4xError(
            f"{file} is not a depth array ({error}); download it again or remove the depth folder"
        ) from error
    depth = depth[..., 0] if depth.ndim == 3 else depth
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan))


def stack_like_frames(files: list[Path], load: Callable[[Path], np.ndarray], width: int, height: int) -> np.ndarray:
    """Return `(T, height, width)`; other resolutions are resampled, other aspects are an F4xError."""
    stack = []
    for file in files:
        image = load(file)
        if image.ndim != 2 or not alike(image.shape[1], image.shape[0], width, height):
            sizes = f"{image.shape[1]}x{image.shape[0]} beside frames of {width}x{height}"
            raise F4xError(f"{file} is {sizes}; it should have the same aspect")
        stack.append(resize_nearest(image, width, height))
    return np.stack(stack)
