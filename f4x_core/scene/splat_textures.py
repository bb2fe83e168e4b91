"""A stage as textures for a graphics card: every Gaussian's numbers in float texels, small tables per view, triangles.

`splat_shader` reads them. Nothing here knows a graphics library: arrays go in and come out. A texture is `WIDTH` texels wide;
entry i of a list with one texel each is at (i % WIDTH, i // WIDTH).

    means      1 float  x, y, z of Gaussian i at 3 i, 3 i + 1, 3 i + 2, in its object's frame
    quats      4        wxyz as it stands now
    turns      4        wxyz that motion gave it; (1,0,0,0) where there is none
    shapes     4        activated scales, number of its cloud
    looks      4        harmonic of degree 0, opacity
    harmonics  4        the others, `terms` texels each: red, green, blue, 0
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import F4xError
from ..geometry.camera import Camera
from .depth_order import OrderSettings, depth_order
from .stage import Cloud, Surface

WIDTH = 8192
"""Texels of a row; every card that Blender runs on takes 16384."""
CHANNELS = {"means": 1, "quats": 4, "turns": 4, "shapes": 4, "looks": 4, "harmonics": 4}
"""The textures and the floats of a texel."""
VIEW_TEXELS = 5
"""Texels per cloud of a view: three rows of the matrix to the camera, the camera's centre in the object's frame, unused."""
IDENTITY = np.array([1, 0, 0, 0], np.float32)


class SplatTextures:
    """The Gaussians of a stage, cloud after cloud. An array that `update` has seen before must not have changed since."""

    def __init__(self) -> None:
        """Nothing yet; `update` fills it."""
        self.clouds: list[Cloud] = []
        self.starts = np.zeros(1, np.int64)
        self.arrays: dict[str, np.ndarray] = {}
        """(rows, WIDTH, channels) float32 by the names above."""
        self.terms = 0
        """Harmonics above degree 0 of the cloud that has most."""
        self._sources: dict[str, list[np.ndarray | None]] = {}
        self._opacities = np.zeros(0, np.float32)
        self._order = np.zeros(0, np.float32)

    def __len__(self) -> int:
        """How many Gaussians there are."""
        return int(self.starts[-1])

    def update(self, clouds: Sequence[Cloud]) -> set[str]:
        """Take these clouds; returns the names of the textures that are other than before.

        What is the very array that it was before is not looked at again.
        """
        starts = np.cumsum([0, *(len(cloud.means) for cloud in clouds)]).astype(np.int64)
        terms = max((cloud.sh.shape[1] - 1 for cloud in clouds), default=0)
        if not np.array_equal(starts, self.starts) or terms != self.terms:
            self._sources, self.arrays = {}, {}
        self.clouds, self.starts, self.terms = list(clouds), starts, terms
        fill: dict[str, Callable[[Cloud, int, np.ndarray], None]] = {
            "means": _fill_means,
            "quats": _fill_quats,
            "turns": _fill_turns,
            "shapes": _fill_shapes,
            "looks": _fill_looks,
            "harmonics": _fill_harmonics,
        }
        texels = {"means": 3, "harmonics": max(terms, 1)}
        changed = {name for name in fill if self._refill(name, texels.get(name, 1), fill[name])}
        if "looks" in changed:
            self._opacities = np.ascontiguousarray(self._rows("looks", 1)[:, 3])
        return changed

    def view(self, camera: Camera) -> np.ndarray:
        """(1, VIEW_TEXELS clouds, 4) float32: what the shader needs of a camera and every cloud."""
        table = np.zeros((max(len(self.clouds), 1), VIEW_TEXELS, 4), np.float32)
        for number, cloud in enumerate(self.clouds):
            table[number, :3] = (camera.world_to_camera @ cloud.to_world)[:3]
            table[number, 3, :3] = np.linalg.solve(cloud.to_world, np.append(camera.center, 1.0))[:3]
        return table.reshape(1, -1, 4)

    def order(self, camera: Camera, settings: OrderSettings) -> tuple[np.ndarray, int]:
        """(rows, WIDTH, 1) float32 indices of what is seen, the farthest first, and their number; overwritten by the next call."""
        if self._order.size != _padded(len(self)):
            self._order = np.zeros(_padded(len(self)), np.float32)
        rows = np.stack([(camera.world_to_camera @ cloud.to_world)[2] for cloud in self.clouds] or [np.zeros(4)])
        means, starts = self._rows("means", 3)[..., 0], self.starts
        count = depth_order(
            means,
            self._opacities,
            starts if self.clouds else np.zeros(2, np.int64),
            rows.astype(np.float32),
            settings,
            self._order[: len(self)],
        )
        return self._order.reshape(-1, WIDTH, 1), count

    def _rows(self, name: str, texels: int) -> np.ndarray:
        """(N, texels, channels) view of a texture; of one channel, (N, texels)."""
        count, channels = len(self), CHANNELS[name]
        flat = self.arrays[name].reshape(-1)[: count * texels * channels]
        return flat.reshape(count, texels, channels) if texels > 1 else flat.reshape(count, channels)

    def _refill(self, name: str, texels: int, fill: Callable[[Cloud, int, np.ndarray], None]) -> bool:
        """Fill the parts of a texture whose clouds have other arrays than before; whether there was one."""
        sources = [_SOURCES[name](cloud) for cloud in self.clouds]
        old = self._sources.get(name)
        if old is None:
            rows = _padded(len(self) * texels) // WIDTH
            self.arrays[name] = np.zeros((rows, WIDTH, CHANNELS[name]), np.float32)
        self._sources[name] = sources
        parts, changed = self._rows(name, texels), old is None
        for number, (cloud, source) in enumerate(zip(self.clouds, sources, strict=True)):
            if old is not None and all(a is b for a, b in zip(source, old[number], strict=True)):
                continue
            fill(cloud, number, parts[self.starts[number] : self.starts[number + 1]])
            changed = True
        return changed


def refuse_too_large(textures: SplatTextures, limit: int) -> None:
    """Raise F4xError where a texture has more rows than the `limit` of a card."""
    largest = max((len(array) for array in textures.arrays.values()), default=0)
    if largest > limit:
        raise F4xError(f"the picture needs textures of {largest} rows, the graphics card takes {limit}")


def triangle_vertices(surfaces: Sequence[Surface]) -> dict[str, np.ndarray]:
    """Surfaces as a list of corners: `pos (3 T,3)`, `normal (3 T,3)` of any length, `color (3 T,4)` sRGB; float32.

    A holdout shows black.
    """
    triangles = np.concatenate([np.zeros((0, 3, 3)), *(surface.triangles for surface in surfaces)])
    colors = [surface.colors * (not surface.holdout) for surface in surfaces]
    rgb = np.concatenate([np.zeros((0, 3)), *colors])
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    corners = {
        "pos": triangles.reshape(-1, 3),
        "normal": np.repeat(normal, 3, 0),
        "color": np.repeat(np.concatenate([rgb, np.ones((len(rgb), 1))], 1), 3, 0),
    }
    return {name: np.ascontiguousarray(values, np.float32) for name, values in corners.items()}


def clip_matrix(camera: Camera, near: float) -> np.ndarray:
    """(4,4) from the world to OpenGL's clip space, without a far plane; rows of the picture run downwards."""
    fx, fy, cx, cy = camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]]
    width, height = camera.width, camera.height
    lens = np.array(
        [
            [2 * fx / width, 0, 2 * cx / width - 1, 0],
            [0, -2 * fy / height, 1 - 2 * cy / height, 0],
            [0, 0, 1, -2 * near],
            [0, 0, 1, 0],
        ]
    )
    return lens @ camera.world_to_camera


def _padded(texels: int) -> int:
    """Texels of the whole rows that hold this many, at least one row."""
    return max(-(-texels // WIDTH), 1) * WIDTH


_SOURCES: dict[str, Callable[[Cloud], tuple]] = {
    "means": lambda cloud: (cloud.means,),
    "quats": lambda cloud: (cloud.quats,),
    "turns": lambda cloud: (cloud.turn,),
    "shapes": lambda cloud: (cloud.scales,),
    "looks": lambda cloud: (cloud.sh, cloud.opacities),
    "harmonics": lambda cloud: (cloud.sh,),
}
"""The arrays that a texture is made of."""


def _fill_means(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[..., 0] = cloud.means


def _fill_quats(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:] = cloud.quats


def _fill_turns(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:] = IDENTITY if cloud.turn is None else cloud.turn


def _fill_shapes(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:, :3], part[:, 3] = cloud.scales, number


def _fill_looks(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:, :3], part[:, 3] = cloud.sh[:, 0], cloud.opacities


def _fill_harmonics(cloud: Cloud, number: int, part: np.ndarray) -> None:
    own = part.reshape(len(cloud.means), -1, 4)
    own[:] = 0
    own[:, : cloud.sh.shape[1] - 1, :3] = cloud.sh[:, 1:]
