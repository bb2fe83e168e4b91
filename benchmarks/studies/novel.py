"""Held-back parts of a data set that measure a scene of its clip: pictures of other cameras, and keypoints set by hand."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from f4x_core.clip.images import alike, read_color, read_mask, resize_nearest
from f4x_core.clip.layouts import Layout, dycheck_keypoints, find_layout, find_novel
from f4x_core.clip.model import Clip
from f4x_core.clip.read import frame_indices
from f4x_core.clip.source import read_pictures, undistort
from f4x_core.errors import F4xError
from f4x_core.geometry.camera import CameraPath


@dataclass(frozen=True, eq=False)
class NovelCamera:
    """V pictures of a camera that the clip is not of."""

    name: str
    path: CameraPath
    """Cameras at the clip's size and in the units of `Clip.cameras`; `times` are frames of the clip."""
    frames: np.ndarray
    """(V, H, W, 3) uint8, at the clip's size, undistorted."""
    seen: np.ndarray | None
    """(V, H, W) bool: pixels that count, co-visible ones or those inside an undistorted picture; None = all."""


def read_novel_cameras(clip: Clip) -> list[NovelCamera]:
    """Read the other cameras that the folder of `clip` has (NVIDIA, DyCheck, Nerfies), at frames of the clip.

    Raises:
        F4xError: a picture that cannot be read, or of another aspect than the clip's.
    """
    folder, frames = _folder_and_frames(clip)

    def size(width: int, height: int) -> tuple[int, int]:
        if not alike(width, height, clip.width, clip.height):
            raise F4xError(
                f"{folder}: pictures for measuring are {width}x{height}, the clip's {clip.width}x{clip.height}; their"
                " aspect should be the same"
            )
        return clip.width, clip.height

    cameras = []
    for layout in find_novel(folder):
        assert layout.times is not None and layout.size is not None
        assert layout.intrinsics is not None and layout.world_to_camera is not None
        rows = np.flatnonzero(np.isin(layout.times, frames))
        if len(rows):
            times = np.searchsorted(frames, layout.times[rows]).astype(np.float64)
            path = CameraPath(layout.intrinsics[rows], layout.world_to_camera[rows], times, *layout.size)
            images = read_pictures(layout, rows, size)
            path = path.resized(clip.width, clip.height)
            cameras.append(NovelCamera(layout.name, path, images, _seen(layout, rows, clip.width, clip.height)))
    return cameras


def measured_width(source: Path | str, factor: int | None = None) -> int | None:
    """Width in pixels at which a data set is measured: by its own factor or `factor`, else that of its novel pictures.

    None = nothing tells.
    """
    layout = find_layout(Path(source))
    factor = layout.factor or factor
    if factor and layout.size:
        return round(layout.size[0] / factor)
    novel = find_novel(Path(source))
    return read_color(novel[0].images[0]).shape[1] if novel else None


def read_keypoints(clip: Clip) -> dict[int, np.ndarray]:
    """Frame of `clip` -> `(J, 3)`: x, y in its pixels (pixel centres at +0.5) and 1 where the keypoint is visible.

    Raises:
        F4xError: a file that holds something else.
    """
    folder, frames = _folder_and_frames(clip)
    files, factor = dycheck_keypoints(folder)
    found = {int(np.searchsorted(frames, frame)): file for frame, file in files.items() if frame in frames}
    if not found:
        return {}
    layout = find_layout(folder)
    assert layout.size is not None
    ratio = np.array([clip.width / layout.size[0], clip.height / layout.size[1], 1.0])
    return {frame: _keypoints(file, layout, frames[frame], factor) * ratio for frame, file in sorted(found.items())}


def _folder_and_frames(clip: Clip) -> tuple[Path, np.ndarray]:
    """Return the folder of a clip, and which of its frames the clip took."""
    folder = Path(clip.source).absolute()
    if folder.is_file():
        return folder.parent, np.zeros(0, int)
    return folder, frame_indices(clip.picked or None, len(find_layout(folder).images), folder)


def _seen(layout: Layout, rows: np.ndarray, width: int, height: int) -> np.ndarray | None:
    if not layout.masks and not layout.distortions:
        return None
    stack = []
    for row in rows:
        mask = read_mask(layout.masks[row]) if layout.masks else np.ones((height, width), bool)
        if layout.distortions and layout.size:
            mask = undistort(np.uint8(255) * mask, layout.distortions[row], layout.size) == 255
        stack.append(resize_nearest(mask, width, height))
    return np.stack(stack)


def _keypoints(file: Path, layout: Layout, frame: int, factor: int) -> np.ndarray:
    """`(J, 3)` in pixels of the layout's size, where a pinhole would see them."""
    import cv2

    try:
        points = np.array(json.loads(file.read_text(encoding="utf-8")), np.float64).reshape(-1, 3)
    except (OSError, ValueError) as error:
        raise F4xError(f"{file} should hold a list of [x, y, visible] ({error}); download it again") from error
    points[:, :2] = factor * (points[:, :2] + 0.5)  # they count pixel centres at whole numbers of the smaller picture
    if layout.distortions:
        lens = layout.distortions[frame]
        points[:, :2] = cv2.undistortPoints(points[:, None, :2], lens.intrinsics, lens.coefficients, P=lens.intrinsics)[
            :, 0
        ]
    return points
