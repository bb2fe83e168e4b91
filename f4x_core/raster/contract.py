"""Input and output of every raster backend. Imports neither torch nor a compiled library."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..geometry.arrays import Array
from ..geometry.camera import Camera
from ..geometry.splats import Splats

# More threads than this only help images larger than a clip's, and each one holds its own work buffers.
MAX_DEFAULT_THREADS = 8
# J is linearised no further outside the image than this fraction of half its width (3DGS, gsplat).
FRUSTUM_MARGIN = 0.3


@dataclass(frozen=True)
class RasterConfig:
    """Constants of the compositing rule; the defaults are those of 3DGS and gsplat (`gsplat/cuda/_constants.py`)."""

    near: float = 0.01
    """Splats whose camera z is not above this are left out (world units; median scene depth is 1)."""
    blur: float = 0.3
    """Pixel footprint added to both diagonal entries of the projected covariance (px^2)."""
    alpha_min: float = 1.0 / 255.0
    """A splat contributes to a pixel only where its alpha is at least this (one step of an 8-bit image)."""
    alpha_max: float = 0.99
    """Alpha is clamped to this, so that the transmittance never becomes 0 and stays invertible."""
    transmittance_min: float = 1e-4
    """A pixel stops before the splat that would bring its transmittance down to this: (1 - alpha_max)^2."""
    tile: int = 8
    """Side of a square tile in pixels (`torch` backend; never changes the result)."""
    threads: int = field(default_factory=lambda: min(os.cpu_count() or 1, MAX_DEFAULT_THREADS))
    """Worker threads of the CPU backends; never changes the result."""
    debug: bool = False
    """Raise an error where a Gaussian's values are not finite, instead of leaving it out."""

    @classmethod
    def as_fitted(cls, focal: float | None, camera: Camera) -> RasterConfig:
        """Return the constants that show in `camera` what was fitted at a focal length of `focal` pixels (None = not known).

        The fit widened every projected Gaussian by `blur` in pixels of its own camera. The same angle is added here; with the
        same number of pixels for every size, Gaussians swell in small images and come apart in large ones.
        """
        return cls() if focal is None else cls(blur=cls.blur * (camera.focal / focal) ** 2)


@dataclass(frozen=True)
class RasterInput:
    """Arguments of `rasterize` for one view, all arrays of one kind; `rasterize` describes the fields."""

    splats: Splats
    colors: Array
    camera: Camera
    background: Array | None = None
    mean2d_offset: Array | None = None
    limit: Array | None = None
    config: RasterConfig = field(default_factory=RasterConfig)
    detached_from: int | None = None
    rows: slice | None = None

    @property
    def drawn_rows(self) -> slice:
        """The rows of the image that are drawn."""
        return self.rows or slice(0, self.camera.height)

    @property
    def attached_channels(self) -> int:
        """Number of channels, counted from the first, that send gradients to opacity, geometry and camera."""
        return self.colors.shape[1] if self.detached_from is None else self.detached_from

    def arrays(self) -> dict[str, Array | None]:
        """Return the arrays by name: `means`, `quats`, `scales`, `opacities`, `colors`, `viewmat`, `K`, and optional ones."""
        shape = {name: getattr(self.splats, name) for name in ("means", "quats", "scales", "opacities")}
        camera = {"viewmat": self.camera.world_to_camera, "K": self.camera.intrinsics}
        optional = {name: getattr(self, name) for name in ("background", "mean2d_offset", "limit")}
        return {**shape, "colors": self.colors, **camera, **optional}

    def with_arrays(self, arrays: Mapping[str, Array | None]) -> RasterInput:
        """Return the same view of other `arrays`, named as in `arrays()`."""
        named: dict[str, Any] = dict(arrays)
        splats = Splats(*(named.pop(name) for name in ("means", "quats", "scales", "opacities")))
        camera = replace(self.camera, intrinsics=named.pop("K"), world_to_camera=named.pop("viewmat"))
        return replace(self, splats=splats, camera=camera, **named)


class NotFiniteError(Exception):
    """A backend that looks itself found a Gaussian with a NaN or infinity among its values."""


@dataclass(frozen=True)
class RasterOutput:
    """Rendered view; tensors when tensors came in, numpy arrays when numpy arrays came in."""

    channels: Array
    """(H, W, C) composited channels, with the background where one was given."""
    depth: Array
    """(H, W) sum of z alpha T in world units; divide by `alpha` for the expected depth."""
    alpha: Array
    """(H, W) opacity of the pixel, 1 - transmittance left, in [0, 1)."""
    visible: Array
    """(N,) bool: in front of the near plane and the box around its `alpha >= alpha_min` ellipse meets the image."""
    dropped: int = 0
    """Gaussians that were left out because a value of theirs is NaN or infinite."""
