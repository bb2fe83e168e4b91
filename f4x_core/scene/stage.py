"""A stage: clouds of Gaussians placed in a world, opaque surfaces between them, one camera, many render passes.

`view.render` renders one scene file; `draw` renders what an artist composed of several. All is projected from the frame of
the first cloud, whose arrays reach the rasteriser unchanged: a single cloud looks the same as through `view.render`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from ..geometry import quaternion, spherical_harmonics
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from ..progress import Progress, silent
from .color import linear_from_srgb, srgb_from_linear
from .passes import Mist, mist_left, normals, vectors
from .view import COVERED

if TYPE_CHECKING:
    from ..raster import RasterConfig
    from .model import Scene

MATTE = "matte:"
"""Prefix of the passes `matte:LAYER`, coverage by each thing that `Cloud.mattes` tells apart."""
PASSES = ("alpha", "depth", "latent", "selection", "score", "index", "vector", "normal", "position", "mist", "unseen")
"""What `draw` gives besides `rgb` and `matte:LAYER`."""
BAND = 1 << 17
"""Pixels of the first band of rows; the time it took sets the size of the next one."""
TALLEST = 1 << 21
"""Pixels of a band of rows at most, a picture of 1920x1080: what all passes need on their way, in float64, takes memory for one
band alone (a picture of 3840x2160 would take gigabytes)."""
PAUSE, GROWTH = 0.3, 8.0
"""Seconds between two calls of `progress`, about; and how many times taller than the last a band may be."""
NOTHING = 1e10
"""Depth where nothing is seen, Blender's own."""
AMBIENT = 0.4
"""Fraction of a surface's colour that it keeps where it is seen edge-on; the rest is shaded by the cosine to the view."""
_WIDTHS = {"latent": 3, "selection": 1, "score": 1, "unseen": 1}
_GEOMETRY = {"vector": 6, "normal": 3, "mist": 1}
"""Passes that surfaces have, too. What is composited for `vector` are the ways in the world to where a place was one frame
before and will be one frame after, for `mist` the light that it leaves."""


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
    """Which cloud it is, the same at every moment; only the pass `vector` asks."""
    beside: tuple[np.ndarray, np.ndarray] | None = None
    """Centres (N,3) in the world one frame before and one after; None = it stands still."""
    light: np.ndarray | None = None
    """(N,) fraction of its light that reaches each Gaussian (`shadows.light_left`); None = all of it."""
    mattes: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Layer -> (N,) uint32 id of what each Gaussian belongs to (`cryptomatte.identify`); 0 = nothing."""

    @classmethod
    def of_scene(cls, scene: Scene, time: float) -> Cloud:
        """The Gaussians of a scene at clip time `time`; drawn alone they look as through `view.render`."""
        posed = scene.posed(time)
        return cls(
            means=posed.means,
            quats=posed.quats,
            scales=posed.scales,
            opacities=posed.opacities,
            sh=posed.sh,
            turn=posed.quats,
            fitted_focal=scene.fitted_focal(time),
            key=scene.name,
        )

    @property
    def places(self) -> np.ndarray:
        """(N,3) float64 centres in the world."""
        return self.means @ self.to_world[:3, :3].T + self.to_world[:3, 3]

    def colors(self, center: np.ndarray) -> np.ndarray:
        """(N,3) sRGB seen from `center (3,)` in the world; as in `Scene.colors`, appearance turns with the surface."""
        colors = self._unshaded(center)
        if self.light is not None:
            dark = self.light < 1
            colors[dark] = srgb_from_linear(linear_from_srgb(colors[dark]) * self.light[dark, None])
        return colors

    def _unshaded(self, center: np.ndarray) -> np.ndarray:
        """`colors` as the Gaussians were fitted."""
        if self.sh.shape[1] == 1:
            return np.maximum(spherical_harmonics.rgb_from_dc(self.sh[:, 0]), 0)
        own = np.linalg.solve(self.to_world, np.append(center, 1.0))[:3]
        directions: np.ndarray = self.means - own.astype(np.float32)
        if self.turn is not None:
            directions = quaternion.rotate(quaternion.conjugate(self.turn), directions)
        return spherical_harmonics.evaluate(self.sh, directions)

    def seen_from(self, frame: np.ndarray) -> Cloud:
        """The same Gaussians with `frame (4,4)` as their `to_world`: means, rotations and scales alone change."""
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
class Surface:
    """Opaque triangles: they hide what lies behind them and show one flat colour each, lit from the camera."""

    triangles: np.ndarray
    """(T,3,3) corners in the world."""
    colors: np.ndarray
    """(T,3) sRGB in [0, 1]."""
    index: int = 0
    """Number of its object in the pass `index`."""
    holdout: bool = False
    """Cut a hole into the picture instead of showing a colour."""
    key: str = ""
    """As of a `Cloud`."""
    beside: tuple[np.ndarray, np.ndarray] | None = None
    """Corners (T,3,3) in the world one frame before and one after; None = it stands still."""
    mattes: Mapping[str, int] = field(default_factory=dict)
    """Layer -> id, as of a `Cloud`."""


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
    """As in `raster.rasterize`."""
    cameras: tuple[Camera, Camera] | None = None
    """The camera one frame before and one after, for the pass `vector`; None = it stands still."""
    mist: Mist = field(default_factory=Mist)
    """Of the pass `mist`."""


def draw(
    clouds: Sequence[Cloud],
    surfaces: Sequence[Surface],
    camera: Camera,
    settings: DrawSettings | None = None,
    *,
    passes: Collection[str] = (),
    region: tuple[slice, slice] | None = None,
    progress: Progress = silent,
    finish: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]] | None = None,
) -> dict[str, np.ndarray]:
    """Draw everything through `camera` in the world; float32 pictures by name, `rgb`, `alpha` and those of `passes`.

    * `rgb (H,W,3)` sRGB over the background, over nothing (premultiplied) where that is None.
    * `alpha (H,W)` of Gaussians and surfaces.
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
    * `matte:LAYER:ID (H,W)` for `matte:LAYER`: fraction of the pixel that what has this id, in hexadecimal, covers.

    Args:
        clouds: Gaussians; one whose centre lies behind a surface is hidden by it as a whole.
        surfaces: opaque triangles, without antialiasing.
        camera: pinhole camera in the world.
        settings: clipping planes, background and rasteriser; the defaults of `DrawSettings` when None.
        passes: any of `PASSES` and `matte:LAYER`.
        region: (rows, columns) of the picture to draw; the result is what the whole picture has there, bit for bit.
        progress: called between bands of rows, a few times a second; cancelling passes through. Without it bands are tall.
        finish: converts the pictures, pixel by pixel; called with those of each band.

    Raises:
        F4xError: a camera that is not finite, or a backend that cannot run here.
    """
    from ..raster import rasterize

    rows, columns = region or (slice(0, camera.height), slice(0, camera.width))
    settings = settings or DrawSettings()
    ground = _Ground.seen(surfaces, camera, settings, [name for name in _GEOMETRY if name in passes])
    mattes = {name: _matte_ids(clouds, surfaces, name.removeprefix(MATTE)) for name in passes if name.startswith(MATTE)}
    frame = clouds[0].to_world if clouds else np.eye(4)
    numbers = sorted({cloud.index for cloud in clouds}) if "index" in passes else []
    widths = {"rgb": 3} | {name: w for name, w in (_WIDTHS | _GEOMETRY).items() if name in passes}
    widths |= {"index": len(numbers)} | {name: len(ids) for name, ids in mattes.items()}
    own = [_own_layers(cloud, camera, settings, numbers, mattes, widths) for cloud in clouds]
    features = [_features(len(cloud.means), layers, widths) for cloud, layers in zip(clouds, own, strict=True)]
    moved = [cloud.seen_from(frame) for cloud in clouds]
    splats = Splats(
        means=_joined([cloud.means for cloud in moved], 3),
        quats=_joined([cloud.quats for cloud in moved], 4),
        scales=_joined([cloud.scales for cloud in moved], 3),
        opacities=_joined([cloud.opacities[:, None] for cloud in moved], 1)[:, 0],
    )
    colors = _joined(features, sum(widths.values()))
    view = replace(camera, world_to_camera=camera.world_to_camera @ frame)
    config = replace(settings.config or fitted_config(clouds, camera), near=settings.near)

    images: dict[str, np.ndarray] = {}
    for band in _tall_bands(rows, camera.width) if progress is silent else _bands(rows, camera.width):
        progress("render", band.start - rows.start, rows.stop - rows.start)
        # Pixels beside the region keep the limit 0 and are not drawn.
        limit = np.zeros((band.stop - band.start, camera.width), np.float32)
        limit[:, columns] = ground.limit[band, columns]
        out = rasterize(splats, colors, view, config=config, backend=settings.backend, limit=limit, rows=band)
        channels, alpha, depth = (
            np.asarray(part[:, columns], np.float32) for part in (out.channels, out.alpha, out.depth)
        )
        layers = dict(zip(widths, np.split(channels, np.cumsum([*widths.values()])[:-1], axis=-1), strict=True))
        part = ground.cut((band, columns))
        drawn = _images(layers, alpha, depth, part, numbers, passes)
        if {"position", "vector"} & {*passes}:
            drawn |= _on_rays(drawn, camera, settings, (band, columns))
        drawn = {name: image for name, image in drawn.items() if name in ("rgb", "alpha", *passes)}
        for name, ids in mattes.items():
            behind = part.matte(surfaces, name.removeprefix(MATTE), ids)
            coverage = layers[name] + (1 - alpha)[..., None] * behind
            drawn |= {f"{name}:{number:08x}": coverage[..., i] for i, number in enumerate(ids)}
        for name, image in (finish(drawn) if finish else drawn).items():
            if name not in images:  # memory is touched, which takes long, only band by band
                images[name] = np.empty((rows.stop - rows.start, *image.shape[1:]), np.float32)
            images[name][band.start - rows.start : band.stop - rows.start] = image
    progress("render", rows.stop - rows.start, rows.stop - rows.start)
    return images


def as_seen(clouds: Sequence[Cloud], back: float) -> list[Cloud]:
    """The clouds without the focal lengths of their fits where the view has no perspective (`back` > 0), and so no angles."""
    return [replace(cloud, fitted_focal=None) for cloud in clouds] if back else list(clouds)


def fitted_config(clouds: Sequence[Cloud], camera: Camera) -> RasterConfig:
    """Return the rasteriser's constants of the largest cloud whose fit is known."""
    from ..raster import RasterConfig

    known = [cloud for cloud in clouds if cloud.fitted_focal is not None]
    largest = max(known, key=lambda cloud: len(cloud.means), default=None)
    return RasterConfig.as_fitted(None if largest is None else largest.fitted_focal, camera)


def _tall_bands(rows: slice, width: int) -> Iterator[slice]:
    """`rows` in parts of `TALLEST` pixels: as few as memory allows, because each looks at all Gaussians."""
    count = max(1, TALLEST // width)
    return (slice(first, min(first + count, rows.stop)) for first in range(rows.start, rows.stop, count))


def _bands(rows: slice, width: int) -> Iterator[slice]:
    """`rows` in parts that each take about `PAUSE` seconds, by how long the last one took; none is above `TALLEST`."""
    first, count = rows.start, max(1, BAND // width)
    while first < rows.stop:
        start = time.perf_counter()
        yield slice(first, min(first + count, rows.stop))
        first, taken = first + count, time.perf_counter() - start
        count = max(1, min(round(count * min(PAUSE / taken, GROWTH)), TALLEST // width))


def _joined(parts: list[np.ndarray], width: int) -> np.ndarray:
    return np.concatenate([np.zeros((0, width), np.float32), *parts], dtype=np.float32)


def _matte_ids(clouds: Sequence[Cloud], surfaces: Sequence[Surface], layer: str) -> np.ndarray:
    """(K,) uint32, increasing: everything that a layer of mattes tells apart."""
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
    """Layer -> (N,C) numbers of one cloud's Gaussians, of those layers that it has."""
    count = len(cloud.means)
    own = {"rgb": cloud.colors(camera.center), **cloud.layers}
    own["index"] = np.tile(np.equal(numbers, cloud.index), (count, 1))
    places = cloud.places if {*_GEOMETRY} & {*wanted} else np.zeros((count, 3))
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
    """(N,6) from `places (N,3)` to where they were and will be."""
    return np.concatenate([there - places for there in beside or (places, places)], 1)


def _on_rays(
    drawn: dict[str, np.ndarray], camera: Camera, settings: DrawSettings, region: tuple[slice, slice]
) -> dict[str, np.ndarray]:
    """Passes `position` and `vector` of a region's `drawn` passes `depth` and, where that is wanted, the ways of `vector`."""
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


def _features(count: int, own: Mapping[str, np.ndarray], widths: Mapping[str, int]) -> np.ndarray:
    """(N,C) what is composited of `count` Gaussians; 0 in layers that they lack."""
    return np.concatenate(
        [own.get(name, np.zeros((count, width))) for name, width in widths.items()], 1, dtype=np.float32
    )


@dataclass(frozen=True, eq=False)
class _Ground:
    """Surfaces and world behind the Gaussians, per pixel."""

    rgb: np.ndarray
    """(H,W,3) sRGB."""
    alpha: np.ndarray
    """(H,W) 1 where a surface shows itself."""
    depth: np.ndarray
    """(H,W) of the nearest surface, infinite where there is none."""
    index: np.ndarray
    """(H,W) number of its object, else 0."""
    limit: np.ndarray
    """(H,W) float32 depth from which on Gaussians are hidden."""
    hit: np.ndarray
    """(H,W) number of the triangle, all surfaces' one after the other; -1 where there is none."""
    layers: Mapping[str, np.ndarray]
    """(H,W,C) of `_GEOMETRY`, 0 where there is no surface."""

    @classmethod
    def seen(
        cls, surfaces: Sequence[Surface], camera: Camera, settings: DrawSettings, wanted: Sequence[str]
    ) -> _Ground:
        """Draw surfaces over the background, with their `layers` of those names."""
        from ..raster.triangles import draw_triangles

        triangles = np.concatenate([np.zeros((0, 3, 3)), *(surface.triangles for surface in surfaces)])
        size = (camera.width, camera.height)
        behind = np.asarray((0, 0, 0) if settings.background is None else settings.background, np.float32)
        if not len(triangles):  # one value each, however large the picture is
            flat = (
                behind,
                np.zeros(()),
                np.array(np.inf),
                np.zeros(()),
                np.array(settings.far, np.float32),
                -np.ones(()),
            )
            empty = {name: np.broadcast_to(0.0, (camera.height, camera.width, _GEOMETRY[name])) for name in wanted}
            plain = [np.broadcast_to(value, (camera.height, camera.width, *value.shape)) for value in flat]
            return cls(plain[0], plain[1], plain[2], plain[3], plain[4], plain[5], empty)
        depth, hit = draw_triangles(
            triangles, camera.world_to_camera, camera.intrinsics, *size, near=settings.near, far=settings.far
        )
        there = hit >= 0
        rgb = np.zeros((*depth.shape, 3), np.float32) + behind
        index, shows = np.zeros(depth.shape), np.zeros(depth.shape)
        if there.any():

            def of_triangles(values) -> np.ndarray:
                """Values of the triangle at each covered pixel, from one value or (T,...) of each surface."""
                parts = [
                    np.broadcast_to(v, (len(s.triangles), *np.shape(v)[1:]))
                    for s, v in zip(surfaces, values, strict=True)
                ]
                return np.concatenate(parts)[hit[there]]

            index[there] = of_triangles([[s.index] for s in surfaces])
            shows[there] = of_triangles([[not s.holdout] for s in surfaces])
            a, b, c = triangles[hit[there]].transpose(1, 0, 2)
            normal = np.cross(b - a, c - a)
            pixels = camera.pixel_grid()[there]
            ray = camera.unproject(pixels, np.ones(len(pixels))) - camera.center
            cosine = np.abs((normal * ray).sum(1)) / (np.linalg.norm(normal, axis=1) * np.linalg.norm(ray, axis=1))
            shading = (AMBIENT + (1 - AMBIENT) * cosine) * shows[there]
            rgb[there] = of_triangles([s.colors for s in surfaces]) * shading[:, None]
        layers = _ground_layers(surfaces, camera, settings, wanted, (depth, hit)) if wanted else {}
        return cls(rgb, shows, depth, index, np.minimum(depth, settings.far).astype(np.float32), hit, layers)

    def cut(self, region: tuple[slice, slice]) -> _Ground:
        """The part inside a region."""
        plain = {f.name: getattr(self, f.name)[region] for f in fields(self) if f.name != "layers"}
        return _Ground(**plain, layers={name: layer[region] for name, layer in self.layers.items()})

    def matte(self, surfaces: Sequence[Surface], layer: str, ids: np.ndarray) -> np.ndarray:
        """(H,W,K) 1 where a surface of that id shows itself."""
        owners = np.repeat(
            np.array([surface.mattes.get(layer, 0) for surface in surfaces], np.uint32),
            [len(surface.triangles) for surface in surfaces],
        )
        own = np.append(owners, np.uint32(0))[self.hit.astype(np.int64)]  # -1 is the last
        return (own[..., None] == ids) * self.alpha[..., None]


def _ground_layers(
    surfaces: Sequence[Surface],
    camera: Camera,
    settings: DrawSettings,
    wanted: Sequence[str],
    seen: tuple[np.ndarray, np.ndarray],
) -> dict[str, np.ndarray]:
    """`_Ground.layers` of surfaces that were `seen` as (depth, number of the triangle) per pixel."""
    depth, hit = seen
    there = hit >= 0
    corners = np.concatenate([surface.triangles for surface in surfaces])[hit[there]].astype(np.float64)
    places = camera.unproject(camera.pixel_grid()[there], depth[there])
    own = {"mist": mist_left(settings.mist, places, camera)[:, None]}
    sides = corners[:, 1:] - corners[:, :1]
    if "normal" in wanted:
        normal = np.cross(sides[:, 0], sides[:, 1])
        normal *= -np.sign((normal * (places - camera.center)).sum(1))[:, None]
        own["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    if "vector" in wanted:
        # where in its triangle a place lies, by least squares in the triangle's plane
        gram = sides @ sides.transpose(0, 2, 1)
        right = sides @ (places - corners[:, 0])[..., None]
        part = np.linalg.solve(gram, right)[..., 0]
        weights = np.concatenate([1 - part.sum(1, keepdims=True), part], 1)[..., None]
        both = [surface.beside or (surface.triangles, surface.triangles) for surface in surfaces]
        beside = tuple((np.concatenate([one[i] for one in both])[hit[there]] * weights).sum(1) for i in (0, 1))
        own["vector"] = _ways(places, (beside[0], beside[1]))
    layers = {name: np.zeros((*hit.shape, _GEOMETRY[name])) for name in wanted}
    for name, layer in layers.items():
        layer[there] = own[name]
    return layers


def _images(
    layers: Mapping[str, np.ndarray],
    alpha: np.ndarray,
    depth: np.ndarray,
    ground: _Ground,
    numbers: Sequence[int],
    passes: Collection[str],
) -> dict[str, np.ndarray]:
    """Gaussians over the ground: composited `layers`, `alpha` and `depth` (sum of z alpha T) become the passes."""
    left = 1 - alpha
    covered = alpha >= COVERED
    divisor = np.where(covered, alpha, 1)
    images = {"rgb": layers["rgb"] + left[..., None] * ground.rgb, "alpha": alpha + left * ground.alpha}
    solid = np.isfinite(ground.depth)
    total = np.where(solid, 1, divisor)
    for name, behind in ground.layers.items():
        summed = layers[name] + left[..., None] * behind
        mean = np.where((covered | solid)[..., None], summed / total[..., None], 0)
        length = np.linalg.norm(mean, axis=-1, keepdims=True) if name == "normal" else 1
        images[name] = 1 - summed[..., 0] if name == "mist" else mean / np.where(length == 0, 1, length)
    if {"depth", "position", "vector"} & {*passes}:
        summed = depth + np.where(solid, left * np.where(solid, ground.depth, 0), 0)
        images["depth"] = np.where(covered | solid, summed / total, NOTHING)
    if "latent" in passes:
        images["latent"] = np.where(covered[..., None], layers["latent"] / divisor[..., None], 0)
    if "score" in passes:
        images["score"] = np.where(covered, layers["score"][..., 0] / divisor, 0)
    if "selection" in passes:
        images["selection"] = layers["selection"][..., 0]
    if "unseen" in passes:
        images["unseen"] = layers["unseen"][..., 0] + left * (1 - ground.alpha)
    if "index" in passes:
        weights = np.concatenate([left[..., None], layers["index"]], -1)  # behind them all, then every object
        found = np.array([0, *numbers])[weights.argmax(-1)]
        images["index"] = np.where(weights.argmax(-1) == 0, ground.index, found)
    return {name: image.astype(np.float32, copy=False) for name, image in images.items()}
