"""From a path that a person gives to a `Clip`."""

from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..files import user_path
from ..geometry.camera import CameraPath
from ..progress import Progress, silent
from .bars import picture_of
from .clock import Clock, read_clock
from .images import even_size, list_images, read_color, read_mask, resize_color, resize_nearest
from .layouts import DEFAULT_FPS, Distortion, Layout, find_layout
from .model import Clip, Picture, cut
from .video import decode, describe

STAGE = "reading clip"
USUAL_SIDE = 480
"""Pixels along the longer side of a picture, unless a width is given: what all figures of the project were measured at."""
ASPECT_TOLERANCE = 0.01  # relative; rounding to even sizes changes the aspect of a 200-pixel frame by this much


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
    selection; "layout" takes those of the source's own layout; none when None.
    Black bars around the picture are cut off, of masks too (`clip.bars`). Raises F4xError for whatever cannot be read.
    """
    source = user_path(source)
    span = parse_span(frames)
    if width is not None and width < 2:
        raise F4xError(f"--width {width} is too small; give at least 2 pixels")
    if hold_out is not None and hold_out < 2:
        raise F4xError(f"--hold-out {hold_out} would leave no frame to learn from; give 2 or more")
    layout = None if source.is_file() else find_layout(source)
    picture = picture_of(source, layout)
    if layout is None:
        name = source.stem
        indices, pictures, clock, total = _read_video(source, span, width, picture, progress)
    else:
        name, total = layout.name, len(layout.images)
        indices = _select(span, total, source)
        pictures = read_pictures(layout, indices, partial(even_size, new_width=width), picture, progress)
        clock = Clock(np.arange(len(indices), dtype=np.float64), layout.fps / (span.step or 1))
    if hold_out is not None and hold_out > len(indices):
        raise F4xError(
            f"--hold-out {hold_out} holds out none of the {len(indices)} frames of {source}; give a smaller number, or"
            " leave it out"
        )
    height, width = pictures.shape[1:3]
    return Clip(
        name=name,
        frames=pictures,
        times=clock.times,
        fps=clock.fps,
        held_out=np.arange(len(indices)) % hold_out == hold_out - 1 if hold_out else np.zeros(len(indices), bool),
        source=str(source),
        picked=f"{indices[0]}:{indices[-1] + 1}:{span.step or 1}",
        cameras=_cameras(layout, indices, width, height) if layout else None,
        masks=stack_like_frames(
            mask_files(masks, layout, source, indices, total), lambda file: cut(read_mask(file), picture), width, height
        )
        if masks is not None
        else None,
        depth=stack_like_frames([layout.depth[index] for index in indices], _load_depth, width, height)
        if layout and layout.depth
        else None,
        picture=picture,
    )


def usual_width(source: str | Path) -> int:
    """Width in pixels at which the longer side of the pictures of `source` has `USUAL_SIDE`, if they are so large."""
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


def _read_video(
    file: Path, span: slice, width: int | None, picture: Picture | None, progress: Progress
) -> tuple[np.ndarray, np.ndarray, Clock, int]:
    """Return (indices, frames, their clock, number of frames of the file); keeps only selected frames, already small."""
    kept: list[np.ndarray] = []
    seconds: list[float] = []
    rate, claimed = describe(file)
    count, tick, expected = 0, 0.0, min(filter(None, (span.stop, claimed)), default=0)
    for count, shown in enumerate(islice(decode(file), span.stop), start=1):
        progress(STAGE, count - 1, max(count, expected))
        index, tick = count - 1 - (span.start or 0), shown.tick
        if index >= 0 and index % (span.step or 1) == 0:
            pixels = cut(shown.pixels, picture)
            kept.append(resize_color(pixels, *even_size(pixels.shape[1], pixels.shape[0], width)))
            seconds.append(shown.seconds)
    progress(STAGE, count, count)
    indices = _select(span, count, file)
    clock = read_clock(seconds, tick, (rate or DEFAULT_FPS) / (span.step or 1))
    return indices, _stacked(kept, file), clock, max(count, claimed)


def _stacked(kept: list[np.ndarray], file: Path) -> np.ndarray:
    """One array of the frames, which it takes out of `kept` on the way, so that memory holds them once."""
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


def read_pictures(
    layout: Layout,
    indices: np.ndarray,
    new_size: Callable[[int, int], tuple[int, int]],
    picture: Picture | None = None,
    progress: Progress = silent,
) -> np.ndarray:
    """Return `(T, H, W, 3)`, undistorted, without bars and resized to `new_size(W, H)`; raises F4xError for several sizes."""
    kept: list[np.ndarray] = []
    native: tuple[int, ...] = ()
    for done, index in enumerate(indices):
        progress(STAGE, done, len(indices))
        image = read_color(layout.images[index])
        native = native or image.shape
        if image.shape != native:
            sizes = f"{image.shape[1]}x{image.shape[0]}, the first frame is {native[1]}x{native[0]}"
            raise F4xError(f"{layout.images[index]} is {sizes}; make all frames the same size")
        if layout.distortions and layout.size:
            image = undistort(image, layout.distortions[index], layout.size)
        image = cut(image, picture)
        kept.append(resize_color(image, *new_size(image.shape[1], image.shape[0])))
    progress(STAGE, len(indices), len(indices))
    return np.stack(kept)


def undistort(image: np.ndarray, lens: Distortion, size: tuple[int, int]) -> np.ndarray:
    """Return the picture a pinhole with the same intrinsics would have taken; black where the lens saw nothing."""
    import cv2

    scale = np.array([image.shape[1] / size[0], image.shape[0] / size[1], 1.0])[:, None]
    intrinsics = lens.intrinsics * scale
    intrinsics[:2, 2] -= 0.5  # OpenCV counts pixel centres at whole numbers
    return cv2.undistort(image, intrinsics, lens.coefficients)


def _cameras(layout: Layout, indices: np.ndarray, width: int, height: int) -> CameraPath | None:
    if layout.intrinsics is None or layout.world_to_camera is None or layout.size is None:
        return None
    times = np.arange(len(indices))
    path = CameraPath(layout.intrinsics[indices], layout.world_to_camera[indices], times, *layout.size)
    return path.resized(width, height)


def mask_files(masks: str | Path, layout: Layout | None, source: Path, indices: np.ndarray, total: int) -> list[Path]:
    """Return one mask file per selected frame; the folder may hold one per frame of the source or of the selection."""
    if str(masks) == "layout":
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
        depth = np.load(file, allow_pickle=False).astype(np.float32)
    except (OSError, ValueError) as error:
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
        if image.ndim != 2 or abs(image.shape[1] * height / (image.shape[0] * width) - 1) > ASPECT_TOLERANCE:
            sizes = f"{image.shape[1]}x{image.shape[0]} beside frames of {width}x{height}"
            raise F4xError(f"{file} is {sizes}; it should have the same aspect")
        stack.append(resize_nearest(image, width, height))
    return np.stack(stack)
