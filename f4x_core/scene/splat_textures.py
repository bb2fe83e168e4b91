"""A stage as textures for a graphics card: every Gaussian's numbers in float texels, small tables per view, triangles.

`splat_shader` reads them. Nothing here knows a graphics library: arrays go in and come out. A texture is `WIDTH` texels wide;
entry i of a list with one texel each is at (i % WIDTH, i // WIDTH). Clouds that motion turns come last, `split` Gaussians after
the others, and have textures of their own: playback fills only these again.

    means      1 float  x, y, z of Gaussian i at 3 i, 3 i + 1, 3 i + 2, in its object's frame
    quats      4        wxyz as it stands now
    moving_means, moving_quats: the same of Gaussian `split` + i
    turns      4        wxyz that motion gave Gaussian `split` + i
    shapes     4        activated scales, number of its cloud
    looks      4        harmonic of degree 0, opacity
    harmonics  4        the others, `terms` texels each: red, green, blue, 0
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ..errors import F4xError
from ..geometry.camera import Camera
from ..geometry.spherical_harmonics import dc_from_rgb
from .clouds import Cloud
from .color import linear_from_srgb, srgb_from_linear
from .depth_order import OrderSettings, depth_order
from .ground import Surface

WIDTH = 8192
"""Texels of a row; every card that Blender runs on takes 16384."""
STILL, MOVING = ("means", "quats"), ("moving_means", "moving_quats", "turns")
"""Textures of the clouds that motion does not turn, and of those that it does; the others are of all."""
CHANNELS = {"means": 1, "moving_means": 1} | dict.fromkeys(
    ("quats", "moving_quats", "turns", "shapes", "looks", "harmonics"), 4
)
"""The textures and the floats of a texel."""
VIEW_TEXELS = 5
"""Texels per cloud of a view: three rows of the matrix to the camera, the camera's centre in the object's frame, unused."""


class SplatTextures:
    """The Gaussians of a stage, cloud after cloud. An array that `update` has seen before must not have changed since."""

    def __init__(self) -> None:
        """Start empty; `update` adds clouds."""
        self.clouds: list[Cloud] = []
        self.starts = np.zeros(1, np.int64)
        self.split = 0
        """The first Gaussian of the clouds that motion turns."""
        self.arrays: dict[str, np.ndarray] = {}
        """(rows, WIDTH, channels) float32 by the names above."""
        self.terms = 0
        """Harmonics above degree 0 of the cloud that has most."""
        self._sources: dict[str, list[tuple]] = {}
        self._means = np.zeros((0, 3), np.float32)
        self._opacities = np.zeros(0, np.float32)
        self._order = np.zeros(0, np.float32)

    def __len__(self) -> int:
        """Return the number of Gaussians."""
        return int(self.starts[-1])

    def update(self, clouds: Sequence[Cloud]) -> set[str]:
        """Take these clouds; returns the names of the textures that are other than before.

        What is the very array that it was before is not looked at again.
        """
        clouds = sorted(clouds, key=lambda cloud: cloud.turn is not None)
        starts = np.cumsum([0, *(len(cloud.means) for cloud in clouds)]).astype(np.int64)
        split = sum(len(cloud.means) for cloud in clouds if cloud.turn is None)
        terms = max((cloud.sh.shape[1] - 1 for cloud in clouds), default=0)
        if not np.array_equal(starts, self.starts) or (terms, split) != (self.terms, self.split):
            self._sources, self.arrays = {}, {}
            self._means = np.zeros((starts[-1], 3), np.float32)
        self.clouds, self.starts, self.split, self.terms = clouds, starts, split, terms
        changed = {name for name in CHANNELS if self._refill(name)}
        if "looks" in changed:
            self._opacities = np.ascontiguousarray(self._rows("looks")[:, 0, 3])
        return changed

    def view(self, camera: Camera) -> np.ndarray:
        """Return (1, VIEW_TEXELS clouds, 4) float32: what the shader needs of a camera and every cloud."""
        table = np.zeros((max(len(self.clouds), 1), VIEW_TEXELS, 4), np.float32)
        for number, cloud in enumerate(self.clouds):
            table[number, :3] = (camera.world_to_camera @ cloud.to_world)[:3]
            table[number, 3, :3] = np.linalg.solve(cloud.to_world, np.append(camera.center, 1.0))[:3]
        return table.reshape(1, -1, 4)

    def order(self, camera: Camera, settings: OrderSettings) -> tuple[np.ndarray, int]:
        """Return (rows, WIDTH, 1) float32 indices of seen Gaussians, the farthest first, and their number, until the next call."""
        if self._order.size != _padded(len(self)):
            self._order = np.zeros(_padded(len(self)), np.float32)
        rows = np.stack([(camera.world_to_camera @ cloud.to_world)[2] for cloud in self.clouds] or [np.zeros(4)])
        count = depth_order(
            self._means,
            self._opacities,
            self.starts if self.clouds else np.zeros(2, np.int64),
            rows.astype(np.float32),
            settings,
            self._order[: len(self)],
        )
        return self._order.reshape(-1, WIDTH, 1), count

    def _page(self, name: str) -> tuple[int, int]:
        """Return the range (first, end) of the Gaussians that a texture holds."""
        if name in STILL:
            return 0, self.split
        return (self.split if name in MOVING else 0), len(self)

    def _texels(self, name: str) -> int:
        """Return the texels of a Gaussian."""
        return max(self.terms, 1) if name == "harmonics" else 3 // CHANNELS[name] or 1

    def _rows(self, name: str) -> np.ndarray:
        """Return (Gaussians of the texture, texels, channels) view of it."""
        first, last = self._page(name)
        shape = (last - first, self._texels(name), CHANNELS[name])
        return self.arrays[name].reshape(-1)[: math.prod(shape)].reshape(shape)

    def _refill(self, name: str) -> bool:
        """Fill the parts of a texture whose clouds have other arrays than before; whether there was one."""
        first, last = self._page(name)
        fill, old = _FILL[name], self._sources.get(name)
        sources = [_SOURCES[name](cloud) for cloud in self.clouds]
        if old is None:
            rows = _padded((last - first) * self._texels(name)) // WIDTH
            self.arrays[name] = np.zeros((rows, WIDTH, CHANNELS[name]), np.float32)
        self._sources[name] = sources
        parts, changed = self._rows(name), old is None
        for number, (cloud, begin, end) in enumerate(zip(self.clouds, self.starts, self.starts[1:], strict=False)):
            known = old is not None and all(a is b for a, b in zip(sources[number], old[number], strict=True))
            if known or not first <= begin < end <= last:
                continue
            fill(cloud, number, parts[begin - first : end - first])
            if name in ("means", "moving_means"):
                self._means[begin:end] = cloud.means
            changed = True
        return changed


def refuse_too_large(textures: SplatTextures, limit: int) -> None:
    """Raise F4xError where a texture has more rows than the `limit` of a card."""
    largest = max((len(array) for array in textures.arrays.values()), default=0)
    if largest > limit:
        raise F4xError(f"the picture needs textures of {largest} rows, the graphics card takes {limit}")


def triangle_vertices(surfaces: Sequence[Surface]) -> dict[str, np.ndarray]:
    """Return surfaces as corners: `pos (3 T,3)`, `normal (3 T,3)` of any length, `color (3 T,4)` sRGB; float32.

    A holdout shows black. An image is seen at the corners alone, and what glows as if it were lit.
    """
    nothing = np.zeros((0, 3, 3))
    rgb = np.concatenate([nothing, *(_lit(surface) * (not surface.holdout) for surface in surfaces)]).reshape(-1, 3)
    corners = {
        "pos": np.concatenate([nothing, *(surface.triangles for surface in surfaces)]).reshape(-1, 3),
        "normal": np.concatenate([nothing, *(surface.corner_normals for surface in surfaces)]).reshape(-1, 3),
        "color": np.concatenate([rgb, np.ones((len(rgb), 1))], 1),
    }
    return {name: np.ascontiguousarray(values, np.float32) for name, values in corners.items()}


def _lit(surface: Surface) -> np.ndarray:
    """Return (T,3,3) sRGB at the corners, with what the surface gives off."""
    colors = surface.corner_colors
    return colors if surface.glow is None else srgb_from_linear(linear_from_srgb(colors) + surface.glow[:, None])


def clip_matrix(camera: Camera, near: float) -> np.ndarray:
    """Return (4,4) from the world to OpenGL's clip space, without a far plane; rows of the picture run downwards."""
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
    """Return the texels of the whole rows that hold this many, at least one row."""
    return max(-(-texels // WIDTH), 1) * WIDTH


def _fill_means(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[..., 0] = cloud.means


def _fill_quats(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:, 0] = cloud.quats


def _fill_turns(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:, 0] = cloud.turn


def _fill_shapes(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:, 0, :3], part[:, 0, 3] = cloud.scales, number


def _fill_looks(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:, 0, :3], part[:, 0, 3] = dc_from_rgb(np.zeros(3)) if cloud.holdout else cloud.sh[:, 0], cloud.opacities


def _fill_harmonics(cloud: Cloud, number: int, part: np.ndarray) -> None:
    part[:] = 0
    if not cloud.holdout:
        part[:, : cloud.sh.shape[1] - 1, :3] = cloud.sh[:, 1:]


_FILL: dict[str, Callable[[Cloud, int, np.ndarray], None]] = {
    "means": _fill_means,
    "quats": _fill_quats,
    "moving_means": _fill_means,
    "moving_quats": _fill_quats,
    "turns": _fill_turns,
    "shapes": _fill_shapes,
    "looks": _fill_looks,
    "harmonics": _fill_harmonics,
}
"""Fills the part (n, texels, channels) of a texture that holds a cloud, by its number."""
_SOURCES: dict[str, Callable[[Cloud], tuple]] = {
    "means": lambda cloud: (cloud.means,),
    "quats": lambda cloud: (cloud.quats,),
    "moving_means": lambda cloud: (cloud.means,),
    "moving_quats": lambda cloud: (cloud.quats,),
    "turns": lambda cloud: (cloud.turn,),
    "shapes": lambda cloud: (cloud.scales,),
    "looks": lambda cloud: (cloud.sh, cloud.opacities, cloud.holdout),
    "harmonics": lambda cloud: (cloud.sh if cloud.higher is None else cloud.higher, cloud.holdout),
}
"""Fields that a texture is made of; a cloud that is held out is black."""
