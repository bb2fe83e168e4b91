"""Clouds of Gaussians, placed in a world, and the one place where their channels are composited for a camera.

`view.render` composites one cloud; `stage.draw` composites several over surfaces. All is projected from the frame of the first
cloud, whose arrays reach the rasteriser unchanged: a single cloud has the same bits in both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..geometry import quaternion, spherical_harmonics
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from .color import linear_from_srgb, srgb_from_linear

if TYPE_CHECKING:
    from ..raster import RasterConfig
    from .model import PosedSplats, Scene

COVERED = 0.1
"""Minimum alpha of a pixel that has a depth and a mean of its Gaussians' numbers."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """N Gaussians in the frame of their object."""

    means: np.ndarray
    """(N,3) centres as they stand now."""
    quats: np.ndarray
    """(N,4) wxyz as they stand now, any length."""
    scales: np.ndarray
    """(N,3) activated."""
    opacities: np.ndarray
    """(N,) in [0, 1]; 0 hides."""
    sh: np.ndarray
    """(N,S,3) in the object's frame before `turn`."""
    turn: np.ndarray | None = None
    """(N,4) rotation that motion gave each Gaussian, and its harmonics with it; None = none."""
    to_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    """(4,4) any affine matrix."""
    index: int = 0
    """Number of its object in the pass `index`."""
    fitted_focal: float | None = None
    """Focal length in pixels of the images that it was fitted to (`Scene.fitted_focal`); None = not known."""
    layers: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Numbers of the passes `latent (N,3)`, `selection`, `score` and `unseen (N,1)`, where it has them."""
    key: str = ""
    """Name of the cloud, the same at every moment; needed by the pass `vector` alone."""
    beside: tuple[np.ndarray, np.ndarray] | None = None
    """Centres (N,3) in the world one frame before and one after; None = it stands still."""
    light: np.ndarray | None = None
    """(N,) fraction of its light that reaches each Gaussian (`shadows.light_left`); None = all of it."""
    mattes: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Layer -> (N,) uint32 id of what each Gaussian belongs to (`cryptomatte.identify`); 0 = nothing."""
    holdout: bool = False
    """Cut holes into the picture instead of showing colors, as far as each Gaussian covers what is behind it."""
    higher: np.ndarray | None = None
    """The very same array as long as coefficients above degree 0 are the same, for who keeps them; None = it is not known."""

    @classmethod
    def of_scene(cls, scene: Scene, time: float) -> Cloud:
        """Return the Gaussians of a scene at clip time `time`."""
        return replace(cls.of_posed(scene.posed(time), scene.fitted_focal(time)), key=scene.name)

    @classmethod
    def of_posed(cls, posed: PosedSplats, fitted_focal: float | None) -> Cloud:
        """Return the Gaussians as `Scene.posed` gives them, and `Scene.fitted_focal`."""
        return cls(
            means=posed.means,
            quats=posed.quats,
            scales=posed.scales,
            opacities=posed.opacities,
            sh=posed.sh,
            turn=posed.quats,
            fitted_focal=fitted_focal,
        )

    @property
    def shape(self) -> Splats:
        """The Gaussians in their object's frame without their colours."""
        return Splats(self.means, self.quats, self.scales, self.opacities)

    @property
    def places(self) -> np.ndarray:
        """(N,3) float64 centres in the world."""
        return self.means @ self.to_world[:3, :3].T + self.to_world[:3, 3]

    def colors(self, center: np.ndarray) -> np.ndarray:
        """Return (N,3) sRGB seen from `center (3,)` in the world; appearance turns with the surface."""
        colors = self._unshaded(center)
        if self.light is not None:
            dark = self.light < 1
            colors[dark] = srgb_from_linear(linear_from_srgb(colors[dark]) * self.light[dark, None])
        return colors

    def _unshaded(self, center: np.ndarray) -> np.ndarray:
        """Return `colors` as the Gaussians were fitted."""
        own = np.linalg.solve(self.to_world, np.append(center, 1.0))[:3]
        return spherical_harmonics.seen_from(own, self.means, self.sh, self.turn)

    def seen_from(self, frame: np.ndarray) -> Cloud:
        """Return the Gaussians with `frame (4,4)` as their `to_world`: means, rotations and scales alone change."""
        if np.array_equal(frame, self.to_world):
            return self
        move = np.linalg.solve(frame, self.to_world)
        stretch, means = move[:3, :3], self.means @ move[:3, :3].T + move[:3, 3]
        size = abs(np.linalg.det(stretch)) ** (1 / 3)
        if np.allclose(stretch @ stretch.T, size**2 * np.eye(3), rtol=1e-6, atol=1e-9 * size**2):
            # the ellipsoid is symmetric, so that a mirrored frame may mirror it once more through its centre
            turn = stretch / size * np.sign(np.linalg.det(stretch))
            quats, scales = quaternion.multiply(quaternion.from_matrix(turn), self.quats), self.scales * size
        else:
            axes, scales, _ = np.linalg.svd(stretch @ quaternion.to_matrix(self.quats) * self.scales[:, None])
            quats = quaternion.from_matrix(axes * np.sign(np.linalg.det(axes))[:, None, None])
        cast = (array.astype(np.float32) for array in (means, quats, scales))
        return replace(self, **dict(zip(("means", "quats", "scales"), cast, strict=True)), to_world=frame)


@dataclass(frozen=True, eq=False)
class Composite:
    """Clouds as one set of Gaussians in the frame of the first one, with the channels that are composited for `camera`."""

    splats: Splats
    channels: np.ndarray
    """(N,C) float32 of all layers, one after the other."""
    widths: Mapping[str, int]
    """Layer -> its number of channels, in their order."""
    camera: Camera
    """In the frame of the first cloud."""
    config: RasterConfig

    @classmethod
    def of(
        cls,
        clouds: Sequence[Cloud],
        layers: Sequence[Mapping[str, np.ndarray]],
        widths: Mapping[str, int],
        camera: Camera,
        config: RasterConfig | None = None,
    ) -> Composite:
        """Gather clouds.

        Args:
            clouds: K clouds of N Gaussians in all.
            layers: of each cloud, layer -> (n, width) numbers; 0 where it lacks one.
            widths: layer -> number of channels.
            camera: in the world.
            config: constants of the rasteriser; None = `fitted_config`.
        """
        frame = clouds[0].to_world if clouds else np.eye(4)
        rows = [
            [own.get(name, np.zeros((len(cloud.means), width))) for name, width in widths.items()]
            for cloud, own in zip(clouds, layers, strict=True)
        ]
        channels = [
            np.concatenate([np.zeros((len(cloud.means), 0)), *row], 1, dtype=np.float32)
            for cloud, row in zip(clouds, rows, strict=True)
        ]
        moved = [cloud.seen_from(frame) for cloud in clouds]
        splats = Splats(
            means=_joined([cloud.means for cloud in moved], 3),
            quats=_joined([cloud.quats for cloud in moved], 4),
            scales=_joined([cloud.scales for cloud in moved], 3),
            opacities=_joined([cloud.opacities[:, None] for cloud in moved], 1)[:, 0],
        )
        view = replace(camera, world_to_camera=camera.world_to_camera @ frame)
        return cls(
            splats, _joined(channels, sum(widths.values())), widths, view, config or fitted_config(clouds, camera)
        )

    def draw(self, backend: str, limit: np.ndarray | None = None, rows: slice | None = None) -> Drawn:
        """Rasterize over black; `limit (H,W)` and `rows` are those of `raster.rasterize`.

        Raises:
            F4xError: a camera that is not finite, or a backend that cannot run here.
        """
        from ..raster import rasterize

        out = rasterize(
            self.splats, self.channels, self.camera, config=self.config, backend=backend, limit=limit, rows=rows
        )
        channels, alpha, depth = (np.asarray(one, np.float32) for one in (out.channels, out.alpha, out.depth))
        parts = np.split(channels, np.cumsum([*self.widths.values()])[:-1], axis=-1) if self.widths else []
        return Drawn(dict(zip(self.widths, parts, strict=True)), alpha, depth)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A composited picture."""

    layers: Mapping[str, np.ndarray]
    """Layer -> (H,W,C) float32 sums of value alpha T."""
    alpha: np.ndarray
    """(H,W) float32."""
    depth: np.ndarray
    """(H,W) float32 sum of z alpha T in world units."""

    @property
    def covered(self) -> np.ndarray:
        """(H,W) bool: alpha of at least `COVERED`."""
        return self.alpha >= COVERED

    def mean(self, sums: np.ndarray, absent: float = 0.0) -> np.ndarray:
        """Return `sums (H,W)` or `(H,W,C)` divided by alpha: the mean of the Gaussians; `absent` where a pixel is not covered."""
        shape = (*self.alpha.shape, *[1] * (sums.ndim - 2))
        covered = self.covered.reshape(shape)
        return np.where(covered, sums / np.where(covered, self.alpha.reshape(shape), 1), np.float32(absent))


def fitted_config(clouds: Sequence[Cloud], camera: Camera) -> RasterConfig:
    """Return the rasteriser's constants of the largest cloud whose fit is known."""
    from ..raster import RasterConfig

    known = [cloud for cloud in clouds if cloud.fitted_focal is not None]
    largest = max(known, key=lambda cloud: len(cloud.means), default=None)
    return RasterConfig.as_fitted(None if largest is None else largest.fitted_focal, camera)


def _joined(parts: list[np.ndarray], width: int) -> np.ndarray:
    return np.concatenate([np.zeros((0, width), np.float32), *parts], dtype=np.float32)
