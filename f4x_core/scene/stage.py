"""A stage: clouds of Gaussians placed in a world, opaque surfaces between them, one camera, many render passes.

`view.render` renders one scene file; `draw` renders what an artist composed of several. Both composite by `clouds.Composite`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.camera import Camera
from ..progress import Progress, silent
from .clouds import COVERED, Cloud, Composite, fitted_config
from .ground import GEOMETRY, SAMPLES, Ground, Look, Surface, ground
from .passes import Mist, mist_left, normals, vectors

if TYPE_CHECKING:
    from ..raster import RasterConfig

MATTE = "matte:"
"""Prefix of the passes `matte:LAYER`, coverage by each thing that `Cloud.mattes` tells apart."""
PASSES = (
    "alpha",
    "depth",
    "latent",
    "selection",
    "score",
    "index",
    "vector",
    "normal",
    "position",
    "mist",
    "unseen",
    "holdout",
)
"""Passes of `draw` besides `rgb` and `matte:LAYER`."""
SHARP = ("depth", "index", "latent", "score", "vector", "normal", "position")
"""Passes that are no light: they are not blurred, and show what is at the centre of a pixel."""
HOLE = "hole"
"""Output of `draw` besides, where anything is held out: the fraction of a pixel that is."""
BAND = 1 << 17
"""Pixels of the first band of rows; the time it took sets the size of the next one."""
TALLEST = 1 << 21
"""Pixels of a band of rows at most, a picture of 1920x1080: what all passes need on their way, in float64, takes memory for one
band alone (a picture of 3840x2160 would take gigabytes)."""
PAUSE, GROWTH = 0.3, 8.0
"""Seconds between two calls of `progress`, about; and how many times taller than the last a band may be."""
NOTHING = 1e10
"""Depth where nothing is seen, Blender's own."""
_WIDTHS = {"latent": 3, "selection": 1, "score": 1, "unseen": 1}


@dataclass(frozen=True)
class DrawSettings:
    """Settings of drawing a stage, independent of its content."""

    near: float = 0.01
    """Minimum camera z that is drawn, above 0."""
    far: float = np.inf
    """Camera z from which on nothing is drawn."""
    background: Sequence[float] | None = (0.0, 0.0, 0.0)
    """sRGB colour behind everything; None = nothing (premultiplied alpha)."""
    config: RasterConfig | None = None
    """Constants of the rasteriser; its `near` is not used. None = those with which the largest cloud was fitted."""
    backend: str = "auto"
    """Backend of `raster.rasterize`."""
    cameras: tuple[Camera, Camera] | None = None
    """The camera one frame before and one after, for the pass `vector`; None = it stands still."""
    mist: Mist = field(default_factory=Mist)
    """Range and falloff of the pass `mist`."""
    surface_samples: int = SAMPLES
    """Points of a pixel that are looked at where surfaces end; fewer than 2 leave their edges hard."""
    region: tuple[slice, slice] | None = None
    """(rows, columns) of the picture to draw; the result is what the whole picture has there, bit for bit. None = all of it."""
    finish: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]] | None = None
    """Function that converts the passes, pixel by pixel; called with those of each band."""


def draw(
    clouds: Sequence[Cloud],
    surfaces: Sequence[Surface],
    camera: Camera,
    settings: DrawSettings | None = None,
    *,
    passes: Collection[str] = (),
    progress: Progress = silent,
) -> dict[str, np.ndarray]:
    """Draw everything through `camera` in the world; float32 pictures by name, `rgb`, `alpha` and those of `passes`.

    * `rgb (H,W,3)` sRGB over the background, over nothing (premultiplied) where that is None.
    * `alpha (H,W)` of Gaussians and surfaces that are not held out.
    * `depth (H,W)` expected z depth in world units, 1e10 where alpha < 0.1.
    * `latent (H,W,3)`, `score (H,W)`: mean of the Gaussians' layers, 0 where their alpha < 0.1.
    * `selection (H,W)`: fraction of the pixel that selected Gaussians cover.
    * `unseen (H,W)`: fraction that nothing covers, or Gaussians that no frame of the clip shows (their layer is 1): a matte of what
      is left to paint.
    * `index (H,W)` number of the object that covers most of the pixel, 0 for nothing.
    * `position (H,W,3)` in the world, where the pixel's ray has the expected depth; `vector (H,W,4)` in pixels, how that place
      moves on the screen (`passes.vectors`); `normal (H,W,3)` of length 1. Of Gaussians and the surface behind them; 0 where
      alpha < 0.1 and there is no surface.
    * `mist (H,W)` from 0, clear, to 1, also where nothing is.
    * `holdout (H,W)` fraction of the pixel where a held-out surface is seen: that of a picture that is to be laid there.
    * `matte:LAYER:ID (H,W)` for `matte:LAYER`: fraction of the pixel that what has this id, in hexadecimal, covers.
    * `hole (H,W)`, only if anything is held out: fraction of the pixel where held-out Gaussians or surfaces are seen. No other
      pass shows anything of them.

    Args:
        clouds: Gaussians; one whose centre lies behind a surface is hidden by it as a whole.
        surfaces: opaque triangles.
        camera: pinhole camera in the world.
        settings: clipping planes, background, rasteriser and region; the defaults of `DrawSettings` when None.
        passes: any of `PASSES` and `matte:LAYER`.
        progress: called between bands of rows, a few times a second; cancelling passes through. Without it bands are tall.

    Raises:
        F4xError: a camera that is not finite, or a backend that cannot run here.
    """
    settings = settings or DrawSettings()
    rows, columns = settings.region or (slice(0, camera.height), slice(0, camera.width))
    behind = np.asarray((0, 0, 0) if settings.background is None else settings.background, np.float32)
    look = Look(camera, settings.near, settings.far, behind, settings.mist, settings.cameras, settings.surface_samples)
    back = ground(surfaces, look, [name for name in GEOMETRY if name in passes])
    drawing = _Drawing.of(clouds, surfaces, camera, settings, passes)
    images: dict[str, np.ndarray] = {}
    for band in _tall_bands(rows, camera.width) if progress is silent else _bands(rows, camera.width):
        progress("render", band.start - rows.start, rows.stop - rows.start)
        drawn = drawing.over(back.cut((band, slice(None))), (band, columns), passes)
        for name, image in (settings.finish(drawn) if settings.finish else drawn).items():
            if name not in images:  # memory is touched, which takes long, only band by band
                images[name] = np.empty((rows.stop - rows.start, *image.shape[1:]), np.float32)
            images[name][band.start - rows.start : band.stop - rows.start] = image
    progress("render", rows.stop - rows.start, rows.stop - rows.start)
    return images


@dataclass(frozen=True, eq=False)
class _Drawing:
    """Gaussians and what is composited of them, ready to be drawn over any ground."""

    composite: Composite
    camera: Camera
    """In the world."""
    settings: DrawSettings
    surfaces: Sequence[Surface]
    numbers: Sequence[int]
    """Numbers of objects, for the pass `index`."""
    mattes: Mapping[str, np.ndarray]
    """Pass -> (K,) ids."""
    holds: bool
    """True if any cloud or surface is held out."""

    @classmethod
    def of(
        cls,
        clouds: Sequence[Cloud],
        surfaces: Sequence[Surface],
        camera: Camera,
        settings: DrawSettings,
        passes: Collection[str],
    ) -> _Drawing:
        """Gather the layers of all clouds in the frame of the first one, whose arrays stay as they are."""
        shown = [cloud for cloud in clouds if not cloud.holdout]
        visible = [surface for surface in surfaces if not surface.holdout]
        mattes = {
            name: _matte_ids(shown, visible, name.removeprefix(MATTE)) for name in passes if name.startswith(MATTE)
        }
        numbers = sorted({cloud.index for cloud in shown}) if "index" in passes else []
        widths = {"rgb": 3} | {name: w for name, w in (_WIDTHS | GEOMETRY).items() if name in passes}
        widths |= {"index": len(numbers)} | {name: len(ids) for name, ids in mattes.items()}
        if len(shown) < len(clouds):
            widths |= {"shown": 1, "depth": 1}
        layers = [
            {} if cloud.holdout else _own_layers(cloud, camera, settings, numbers, mattes, widths) for cloud in clouds
        ]
        config = replace(settings.config or fitted_config(clouds, camera), near=settings.near)
        holds = len(shown) < len(clouds) or len(visible) < len(surfaces)
        composite = Composite.of(clouds, layers, widths, camera, config)
        return cls(composite, camera, settings, surfaces, numbers, mattes, holds)

    def over(self, back: Ground, part: tuple[slice, slice], passes: Collection[str]) -> dict[str, np.ndarray]:
        """Return the passes of a part of the picture, over the ground of all of its rows."""
        own = self._over(back, part, passes)
        columns = part[1]
        if back.fraction is None or back.beside is None or back.fraction[:, columns].min(initial=1) == 1:
            return own
        beside = self._over(back.beside, part, [name for name in passes if name not in (*SHARP, "mist")])
        fraction = back.fraction[:, columns].astype(np.float32)
        for name, image in beside.items():
            weight = fraction.reshape(*fraction.shape, *[1] * (image.ndim - 2))
            own[name] = weight * own[name] + (1 - weight) * image
        return own

    def _over(self, back: Ground, part: tuple[slice, slice], passes: Collection[str]) -> dict[str, np.ndarray]:
        rows, columns = part
        # Pixels beside the part keep the limit 0 and are not drawn.
        limit = np.zeros(back.limit.shape, np.float32)
        limit[:, columns] = back.limit[:, columns]
        drawn = self.composite.draw(self.settings.backend, limit=limit, rows=rows)
        layers, back = {n: one[:, columns] for n, one in drawn.layers.items()}, back.cut((slice(None), columns))
        seen = _Seen(layers, drawn.alpha[:, columns], drawn.depth[:, columns], back)
        images = _images(seen, self.numbers, passes)
        if {"position", "vector"} & {*passes}:
            images |= _on_rays(images, self.camera, self.settings, part)
        images = {name: image for name, image in images.items() if name in ("rgb", "alpha", *passes)}
        for name, ids in self.mattes.items():
            coverage = layers[name] + seen.left[..., None] * back.matte(self.surfaces, name.removeprefix(MATTE), ids)
            images |= {f"{name}:{number:08x}": coverage[..., i] for i, number in enumerate(ids)}
        if self.holds:
            images[HOLE] = (seen.covered - seen.shown + seen.left * back.held).astype(np.float32)
        return images


def as_seen(clouds: Sequence[Cloud], back: float) -> list[Cloud]:
    """Return the clouds without their fitted focal lengths where the view has no perspective (`back` > 0), and so no angles."""
    return [replace(cloud, fitted_focal=None) for cloud in clouds] if back else list(clouds)


def _tall_bands(rows: slice, width: int) -> Iterator[slice]:
    """Return `rows` in parts of `TALLEST` pixels: as few as memory allows, because each looks at all Gaussians."""
    count = max(1, TALLEST // width)
    return (slice(first, min(first + count, rows.stop)) for first in range(rows.start, rows.stop, count))


def _bands(rows: slice, width: int) -> Iterator[slice]:
    """Yield `rows` in parts that each take about `PAUSE` seconds, by the time of the last one, at most `TALLEST` high."""
    first, count = rows.start, max(1, BAND // width)
    while first < rows.stop:
        start = time.perf_counter()
        yield slice(first, min(first + count, rows.stop))
        first, taken = first + count, time.perf_counter() - start
        count = max(1, min(round(count * min(PAUSE / taken, GROWTH)), TALLEST // width))


def _matte_ids(clouds: Sequence[Cloud], surfaces: Sequence[Surface], layer: str) -> np.ndarray:
    """Return (K,) uint32, increasing: everything that a layer of mattes tells apart."""
    owners: list[Cloud | Surface] = [*clouds, *surfaces]
    parts = [np.atleast_1d(owner.mattes[layer]) for owner in owners if layer in owner.mattes]
    found = np.unique(np.concatenate([np.zeros(0, np.uint32), *parts]))
    return found[found != 0].astype(np.uint32)


def _own_layers(
    cloud: Cloud,
    camera: Camera,
    settings: DrawSettings,
    numbers: Sequence[int],
    mattes: Mapping[str, np.ndarray],
    wanted: Collection[str],
) -> dict[str, np.ndarray]:
    """Return layer -> (N,C) numbers of one cloud's Gaussians, of those layers that it has."""
    count = len(cloud.means)
    own = {"rgb": cloud.colors(camera.center), **cloud.layers}
    if "shown" in wanted:
        own |= {"shown": np.ones((count, 1)), "depth": camera.project(cloud.places)[1][:, None]}
    own["index"] = np.tile(np.equal(numbers, cloud.index), (count, 1))
    places = cloud.places if {*GEOMETRY} & {*wanted} else np.zeros((count, 3))
    if "vector" in wanted:
        own["vector"] = _ways(places, cloud.beside)
    if "normal" in wanted:
        own["normal"] = normals(cloud.quats, cloud.scales, cloud.to_world, places - camera.center)
    if "mist" in wanted:
        own["mist"] = mist_left(settings.mist, places, camera)[:, None]
    for name, ids in mattes.items():
        if name.removeprefix(MATTE) in cloud.mattes:
            own[name] = np.equal(cloud.mattes[name.removeprefix(MATTE)][:, None], ids)
    return own


def _ways(places: np.ndarray, beside: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
    """Return (N,6) from `places (N,3)` to where they were and will be."""
    return np.concatenate([there - places for there in beside or (places, places)], 1)


def _on_rays(
    drawn: dict[str, np.ndarray], camera: Camera, settings: DrawSettings, region: tuple[slice, slice]
) -> dict[str, np.ndarray]:
    """Return the passes `position` and `vector` of a region's `drawn` passes `depth` and, where wanted, the ways of `vector`."""
    there = drawn["depth"] < NOTHING
    pixels = camera.pixel_grid()[region][there]
    places = camera.unproject(pixels, drawn["depth"][there].astype(np.float64))
    found = {"position": np.zeros((*there.shape, 3), np.float32)}
    found["position"][there] = places
    if "vector" in drawn:
        found["vector"] = np.zeros((*there.shape, 4), np.float32)
        before, after = np.split(drawn["vector"][there], 2, axis=1)
        found["vector"][there] = vectors(places, (places + before, places + after), camera, settings.cameras)
    return found


@dataclass(frozen=True, eq=False)
class _Seen:
    """The composited Gaussians, and the ground behind them."""

    layers: Mapping[str, np.ndarray]
    """(H,W,C) sums, by layer."""
    covered: np.ndarray
    """(H,W) alpha of all Gaussians."""
    deep: np.ndarray
    """(H,W) sum of z alpha T of all Gaussians."""
    back: Ground

    @property
    def left(self) -> np.ndarray:
        """(H,W) how much of the ground is seen."""
        return 1 - self.covered

    @property
    def shown(self) -> np.ndarray:
        """(H,W) alpha of the Gaussians that are not held out."""
        return self.layers["shown"][..., 0] if "shown" in self.layers else self.covered

    @property
    def depth(self) -> np.ndarray:
        """(H,W) sum of z alpha T of the Gaussians that are not held out."""
        return self.layers["depth"][..., 0] if "depth" in self.layers else self.deep


def _images(seen: _Seen, numbers: Sequence[int], passes: Collection[str]) -> dict[str, np.ndarray]:
    """Return the passes of composited Gaussians over the ground."""
    layers, ground, left, alpha = seen.layers, seen.back, seen.left, seen.shown
    solid = np.isfinite(ground.depth)
    behind = np.where(solid, left, 0)
    total = alpha + behind
    covered, there = alpha >= COVERED, total >= COVERED
    divisor = np.where(covered, alpha, 1)
    total = np.where(there, total, 1)
    images = {"rgb": layers["rgb"] + left[..., None] * ground.rgb, "alpha": alpha + left * ground.alpha}
    for name, own in ground.layers.items():
        summed = layers[name] + left[..., None] * own
        mean = np.where(there[..., None], summed / total[..., None], 0)
        length = np.linalg.norm(mean, axis=-1, keepdims=True) if name == "normal" else 1
        images[name] = 1 - summed[..., 0] if name == "mist" else mean / np.where(length == 0, 1, length)
    if {"depth", "position", "vector"} & {*passes}:
        summed = seen.depth + behind * np.where(solid, ground.depth, 0)
        images["depth"] = np.where(there, summed / total, NOTHING)
    if "latent" in passes:
        images["latent"] = np.where(covered[..., None], layers["latent"] / divisor[..., None], 0)
    if "score" in passes:
        images["score"] = np.where(covered, layers["score"][..., 0] / divisor, 0)
    if "selection" in passes:
        images["selection"] = layers["selection"][..., 0]
    if "unseen" in passes:
        images["unseen"] = layers["unseen"][..., 0] + left * (1 - ground.alpha)
    if "holdout" in passes:
        images["holdout"] = left * ground.held
    if "index" in passes:
        # the ground, what is held out, then every object
        weights = np.concatenate([np.stack([left, seen.covered - alpha], -1), layers["index"]], -1)
        found = np.array([0, 0, *numbers])[weights.argmax(-1)]
        images["index"] = np.where(weights.argmax(-1) == 0, ground.index, found)
    return {name: image.astype(np.float32, copy=False) for name, image in images.items()}
