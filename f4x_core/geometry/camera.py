"""Pinhole cameras: OpenCV axes (x right, y down, z forward), pixel (col, row) is looked through at (col+.5, row+.5)."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import F4xError
from ..files import replace_file
from ..reading import load_json
from ..versions import CAMERA_PATH
from . import pose
from .arrays import Array, are_indices, like, namespace
from .interpolation import interpolate, interpolate_rotation

FORMAT = "f4x-cameras"
_ARRAYS = ("intrinsics", "world_to_camera", "times")
_MIN_DEPTH = 1e-8  # world units; nearer to the camera plane the projection is held finite, on its own side
# Points in one matrix product: BLAS shares larger ones among threads, which wait for one another on a busy machine.
_BLOCK = 1 << 14


@dataclass(frozen=True, eq=False)
class Camera:
    """One view. Points are in world units, pixels have their origin at the image's upper left corner."""

    intrinsics: Array
    """(3, 3) float64, pixels: [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]. Here and below a torch tensor stays what it is, with
    its gradient."""
    world_to_camera: Array
    """(4, 4) float64 rigid matrix."""
    width: int
    height: int

    def __post_init__(self):
        """Take anything array-like but a tensor as float64 and refuse wrong shapes."""
        object.__setattr__(self, "intrinsics", _checked(self.intrinsics, (3, 3), "intrinsics"))
        object.__setattr__(self, "world_to_camera", _checked(self.world_to_camera, (4, 4), "world_to_camera"))
        _check_size(self.width, self.height)

    @property
    def center(self) -> Array:
        """Camera centre in the world, `(3,)`."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    @property
    def camera_to_world(self) -> np.ndarray:
        """Rigid matrix `(4, 4)`, the inverse of `world_to_camera`."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.world_to_camera[:3, :3].T
        matrix[:3, 3] = self.center
        return matrix

    @property
    def focal(self) -> float:
        """Focal length in pixels, the geometric mean of the two."""
        return float((self.intrinsics[0, 0] * self.intrinsics[1, 1]) ** 0.5)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Return (pixels `(..., 2)`, depth `(...)`) of world `points (..., 3)`; depth <= 0 is behind the camera."""
        if len(parts := _blocks(points)) > 1:
            pixels, depths = zip(*map(self.project, parts), strict=True)
            return np.concatenate(pixels), np.concatenate(depths)
        xp = namespace(points)
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        local = points @ like(rotation.T, points) + like(translation, points)
        depth = local[..., 2:]
        sign = xp.where(depth < 0, -xp.ones_like(depth), xp.ones_like(depth))
        safe_depth = xp.where(abs(depth) < _MIN_DEPTH, sign * _MIN_DEPTH, depth)
        pixels = local[..., :2] / safe_depth @ like(self.intrinsics[:2, :2].T, points)
        return pixels + like(self.intrinsics[:2, 2], points), depth[..., 0]

    def unproject(self, pixels: Array, depth: Array) -> Array:
        """Return world points `(..., 3)` of `pixels (..., 2)` at z `depth (...)`; the inverse of `project`."""
        if len(parts := _blocks(pixels)) > 1:
            return np.concatenate([self.unproject(*part) for part in zip(parts, _blocks(depth), strict=True)])
        xp = namespace(pixels, depth)
        inverse = np.linalg.inv(self.intrinsics)
        plane = pixels @ like(inverse[:2, :2].T, pixels) + like(inverse[:2, 2], pixels)
        local = xp.concatenate([plane, xp.ones_like(plane[..., :1])], axis=-1) * depth[..., None]
        matrix = self.camera_to_world
        return local @ like(matrix[:3, :3].T, pixels) + like(matrix[:3, 3], pixels)

    def on_plane(self, pixels: np.ndarray) -> np.ndarray:
        """Return `(..., 2)`: x, y of the camera's rays through `pixels (..., 2)` where z = 1; the skew counts as 0."""
        return (pixels - self.intrinsics[:2, 2]) / self.intrinsics[[0, 1], [0, 1]]

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera of the same picture resampled to another size."""
        intrinsics = _resized_intrinsics(self.intrinsics, width / self.width, height / self.height)
        return Camera(intrinsics, self.world_to_camera, width, height)

    def of_width(self, width: int) -> "Camera":
        """Return the camera of the same picture resampled to so many columns, and as many rows as keep its shape."""
        return self.resized(width, max(1, round(width * self.height / self.width)))

    def pixel_grid(self) -> np.ndarray:
        """Return the pixel centres `(H, W, 2)` float64, `[row, col] = (col + 0.5, row + 0.5)`."""
        return np.stack(np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5), axis=-1)


@dataclass(frozen=True, eq=False)
class CameraPath:
    """The cameras of one clip at increasing times; between them the motion is smooth."""

    intrinsics: np.ndarray
    """(T, 3, 3) float64, pixels."""
    world_to_camera: np.ndarray
    """(T, 4, 4) float64 rigid matrices."""
    times: np.ndarray
    """(T,) float64, strictly increasing, in clip frames."""
    width: int
    height: int

    def __post_init__(self):
        """Take anything array-like as float64 and refuse wrong shapes and times that do not increase."""
        count = len(self.times)
        object.__setattr__(self, "intrinsics", _checked(self.intrinsics, (count, 3, 3), "intrinsics"))
        object.__setattr__(self, "world_to_camera", _checked(self.world_to_camera, (count, 4, 4), "world_to_camera"))
        object.__setattr__(self, "times", _checked(self.times, (count,), "times"))
        _check_size(self.width, self.height)
        if count == 0 or (np.diff(self.times) <= 0).any():
            raise F4xError("a camera path needs at least one camera, and times that strictly increase")

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, index: int) -> Camera:
        return Camera(self.intrinsics[index], self.world_to_camera[index], self.width, self.height)

    @property
    def centers(self) -> np.ndarray:
        """Camera centres in the world, `(T, 3)`."""
        return self._poses[1]

    @cached_property
    def _poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Camera-to-world (quaternions, centres): the centre is what moves smoothly, not the matrix's translation."""
        return pose.invert(*pose.from_matrix(self.world_to_camera))

    def at(self, time: float) -> Camera:
        """Return the camera at any time: a stored one at its own time, cubic between, coasting to rest outside."""
        stored = np.flatnonzero(self.times == time)
        if len(stored):
            return self[int(stored[0])]
        q, centers = self._poses
        turned, center = interpolate_rotation(self.times, q, time), interpolate(self.times, centers, time)
        # Linear and held at the ends: a coasting zoom could turn the picture inside out.
        row = np.interp(time, self.times, np.arange(len(self)))
        below, above = int(np.floor(row)), int(np.ceil(row))
        intrinsics = self.intrinsics[below] + (row - below) * (self.intrinsics[above] - self.intrinsics[below])
        return Camera(intrinsics, pose.to_matrix(*pose.invert(turned, center)), self.width, self.height)

    @property
    def mean_down(self) -> np.ndarray:
        """(3,) unit vector in the world: down in the mean camera."""
        down = self.world_to_camera[:, 1, :3].mean(0)
        return down / max(float(np.linalg.norm(down)), 1e-9)

    @property
    def steady(self) -> bool:
        """Return True if the times are 0, 1, 2, ...: frames that are evenly spaced, all of them."""
        return are_indices(self.times)

    def frame_at(self, time: float) -> int:
        """Return the index of the camera nearest in time; for evenly spaced frames `time` itself, rounded, even if outside."""
        return round(time) if self.steady else int(np.abs(self.times - time).argmin())

    def at_times(self, times: Sequence[float] | np.ndarray) -> "CameraPath":
        """Return the path sampled at other times, for example every clip frame from the supervised ones."""
        cameras = [self.at(time) for time in times]
        return CameraPath(
            np.stack([camera.intrinsics for camera in cameras]),
            np.stack([camera.world_to_camera for camera in cameras]),
            np.asarray(times, np.float64),
            self.width,
            self.height,
        )

    def resized(self, width: int, height: int) -> "CameraPath":
        """Return the path for pictures resampled to another size."""
        intrinsics = _resized_intrinsics(self.intrinsics, width / self.width, height / self.height)
        return replace(self, intrinsics=intrinsics, width=width, height=height)

    def scaled_world(self, scale: float) -> "CameraPath":
        """Return the path in a world whose coordinates are all multiplied by `scale`."""
        matrices = self.world_to_camera.copy()
        matrices[:, :3, 3] *= scale
        return replace(self, world_to_camera=matrices)

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-compatible dict; `from_json` gives back the same float64 numbers."""
        return {
            "format": FORMAT,
            "version": CAMERA_PATH,
            "axes": "OpenCV: x right, y down, z forward; pixel centres at +0.5",
            "width": self.width,
            "height": self.height,
        } | {name: getattr(self, name).tolist() for name in _ARRAYS}

    @classmethod
    def from_json(cls, data: Any, source: str | Path = "camera path") -> "CameraPath":
        """Return the path of a dict written by `to_json`; `source` names it in the F4xError of a wrong one."""
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise F4xError(f"{source} is not a camera path: it should be a JSON object with format '{FORMAT}'")
        if data.get("version") != CAMERA_PATH:
            raise F4xError(f"{source} has version {data.get('version')!r}; this Feature4X reads version {CAMERA_PATH}")
        try:
            intrinsics, matrices, times = (np.array(data[name], np.float64) for name in _ARRAYS)
            return cls(intrinsics, matrices, times, int(data["width"]), int(data["height"]))
        except KeyError as error:
            raise F4xError(f"{source} lacks the entry {error}; write it again") from error
        except (TypeError, ValueError, OverflowError) as error:
            raise F4xError(f"{source} holds something other than numbers ({error}); write it again") from error
        except F4xError as error:
            raise F4xError(f"{source}: {error}") from error

    def write(self, file: str | Path) -> None:
        """Write the path as a JSON file."""
        with replace_file(file) as target:
            target.write(json.dumps(self.to_json()).encode())

    @classmethod
    def read(cls, file: str | Path) -> "CameraPath":
        """Return the path in a JSON file; raises F4xError that names the file."""
        try:
            data = load_json(Path(file))
        except OSError as error:
            raise F4xError(f"{file} cannot be read ({error.strerror}); give an existing camera path") from error
        except ValueError as error:
            raise F4xError(
                f"{file} cannot be read as JSON ({error}); give a camera path written by Feature4X"
            ) from error
        return cls.from_json(data, file)


def _blocks(rows: Array) -> list[Array]:
    """Return a long numpy array in parts along its first axis, of at most `_BLOCK` rows and alike in length; all else whole.

    Parts alike in length, as the product of a single row is rounded differently.
    """
    count = 1 if namespace(rows) is not np or rows.ndim == 0 else -(-len(rows) // _BLOCK)
    return np.array_split(rows, count) if count > 1 else [rows]


def _resized_intrinsics(intrinsics: np.ndarray, scale_x: float, scale_y: float) -> np.ndarray:
    """Scale rows x and y; exact because pixel coordinates count from the image's corner, not from a pixel's centre."""
    return intrinsics * np.array([scale_x, scale_y, 1.0])[:, None]


def _checked(array: Any, shape: tuple[int, ...], name: str) -> Array:
    if namespace(array) is np:
        array = np.asarray(array, np.float64)
        usable = array.shape == shape and bool(np.isfinite(array).all())
    else:
        usable = tuple(array.shape) == shape  # whether a tensor is finite is asked where it is used, with all others
    if not usable:
        raise F4xError(f"camera {name} should be finite numbers of shape {shape}, got shape {tuple(array.shape)}")
    return array


def _check_size(width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise F4xError(f"a camera needs a picture of at least 1x1 pixels, got {width}x{height}")
