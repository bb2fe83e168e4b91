"""Opaque surfaces and the world behind Gaussians, per pixel, with smooth shading and soft edges.

Edges are soft by supersampling, only where two things meet. Such a pixel has two parts: the thing at its centre, and all
that the samples see beside it. Each part hides Gaussians by its own depth, so `stage.draw` blends them over both and mixes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from ..geometry.camera import Camera
from .color import linear_from_srgb, srgb_from_linear
from .passes import Mist, mist_left

AMBIENT = 0.4
"""Fraction of a surface's color that it keeps where it is seen edge-on; the rest is shaded by the cosine to the view."""
GEOMETRY = {"vector": 6, "normal": 3, "mist": 1}
"""Passes that surfaces have, and their channels. What is composited for `vector` are the ways in the world to where a place
was one frame before and will be one frame after, for `mist` the light that it leaves."""
CREASE = 8 / 255
"""Difference between the colors of neighboring pixels from which on a surface has an edge there."""
SAMPLES = 8
"""Points of a pixel that are looked at where things meet."""


@dataclass(frozen=True, eq=False)
class Texture:
    """An image on some of the triangles of a surface."""

    image: np.ndarray
    """(h,w,3) sRGB in [0, 1], the upper row first."""
    on: np.ndarray
    """(T,) bool, the triangles that show it."""
    uvs: np.ndarray
    """(T,3,2) where each corner is in the image, from the lower left; the image repeats."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Opaque triangles: they hide what lies behind them and show their own color, lit from the camera."""

    triangles: np.ndarray
    """(T,3,3) corners in the world."""
    colors: np.ndarray
    """(T,3) sRGB in [0, 1], or (T,3,3) one for each corner."""
    normals: np.ndarray | None = None
    """(T,3,3) in the world, of any length, one for each corner; None = that of the triangle."""
    glow: np.ndarray | None = None
    """(T,3) light that it gives, linear; None = none."""
    textures: Sequence[Texture] = ()
    """Images that take the place of the color."""
    index: int = 0
    """Number of its object in the pass `index`."""
    holdout: bool = False
    """Cut a hole into the picture instead of showing a color."""
    key: str = ""
    """Name of the surface, the same at every moment, as of a `Cloud`."""
    beside: tuple[np.ndarray, np.ndarray] | None = None
    """Corners (T,3,3) in the world one frame before and one after; None = it stands still."""
    mattes: Mapping[str, int] = field(default_factory=dict)
    """Layer -> id, as of a `Cloud`."""

    @property
    def corner_colors(self) -> np.ndarray:
        """(T,3,3) sRGB; of a triangle with an image what that has at the corners."""
        colors = np.array(np.broadcast_to(self.colors.reshape(len(self.colors), -1, 3), self.triangles.shape))
        for texture in self.textures:
            colors[texture.on] = sample(texture.image, texture.uvs[texture.on])
        return colors

    @property
    def corner_normals(self) -> np.ndarray:
        """(T,3,3) in the world, of any length."""
        if self.normals is not None:
            return self.normals
        a, b, c = self.triangles.transpose(1, 0, 2)
        return np.repeat(np.cross(b - a, c - a)[:, None], 3, 1)


def sample(image: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """Return (...,3) colors of a repeating `image (h,w,3)` at `uvs (...,2)` from its lower left, between pixels in proportion."""
    height, width = image.shape[:2]
    x, y = uvs[..., 0] * width - 0.5, (1 - uvs[..., 1]) * height - 0.5
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right, down = (x - left)[..., None], (y - top)[..., None]
    rows, columns = (top % height, (top + 1) % height), (left % width, (left + 1) % width)
    upper = image[rows[0], columns[0]] * (1 - right) + image[rows[0], columns[1]] * right
    lower = image[rows[1], columns[0]] * (1 - right) + image[rows[1], columns[1]] * right
    return upper * (1 - down) + lower * down


@dataclass(frozen=True, eq=False)
class Ground:
    """Surfaces and world behind the Gaussians, per pixel."""

    rgb: np.ndarray
    """(H,W,3) sRGB, as much of it as there is: black where a surface is held out."""
    alpha: np.ndarray
    """(H,W) 1 where a surface shows itself."""
    held: np.ndarray
    """(H,W) 1 where a surface is held out."""
    depth: np.ndarray
    """(H,W) of the nearest surface that shows itself, infinite where there is none."""
    index: np.ndarray
    """(H,W) number of its object, else 0."""
    limit: np.ndarray
    """(H,W) float32 depth from which on Gaussians are hidden."""
    hit: np.ndarray
    """(H,W) number of the triangle, all surfaces' one after the other; -1 where there is none."""
    layers: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(H,W,C) of `GEOMETRY`, 0 where there is no surface."""
    fraction: np.ndarray | None = None
    """(H,W) fraction of each pixel that all this is about; None = all of it, everywhere."""
    beside: Ground | None = None
    """Colour of the rest of each pixel; its limit is 0 where there is no rest."""

    def cut(self, region: tuple[slice, slice]) -> Ground:
        """Return the part inside a region."""
        whole = {f.name: getattr(self, f.name) for f in fields(self)}
        arrays = {name: value[region] for name, value in whole.items() if isinstance(value, np.ndarray)}
        layers = {name: layer[region] for name, layer in self.layers.items()}
        beside = None if self.beside is None else self.beside.cut(region)
        return replace(self, **arrays, layers=layers, beside=beside)

    def matte(self, surfaces: Sequence[Surface], layer: str, ids: np.ndarray) -> np.ndarray:
        """Return (H,W,K) 1 where a surface of that id shows itself."""
        owners = np.repeat(
            np.array([surface.mattes.get(layer, 0) for surface in surfaces], np.uint32),
            [len(surface.triangles) for surface in surfaces],
        )
        own = np.append(owners, np.uint32(0))[self.hit.astype(np.int64)]  # -1 is the last
        return (own[..., None] == ids) * self.alpha[..., None]


@dataclass(frozen=True, eq=False)
class Look:
    """Looks of surfaces."""

    camera: Camera
    near: float
    """Least camera z that is seen."""
    far: float
    """Camera z from which on nothing is seen."""
    background: np.ndarray
    """(3,) sRGB behind everything."""
    mist: Mist
    cameras: tuple[Camera, Camera] | None = None
    samples: int = SAMPLES
    """Points of a pixel where things meet; fewer than 2 leave edges hard."""


def ground(surfaces: Sequence[Surface], look: Look, wanted: Sequence[str]) -> Ground:
    """Draw surfaces over the background, with their `layers` of those names."""
    camera = look.camera
    size = (camera.height, camera.width)
    if not any(len(surface.triangles) for surface in surfaces):  # one value each, however large the picture is
        empty = {name: np.broadcast_to(0.0, (*size, GEOMETRY[name])) for name in wanted}
        zero, far = np.broadcast_to(0.0, size), np.broadcast_to(np.float32(look.far), size)
        nothing, infinite = np.broadcast_to(-1, size), np.broadcast_to(np.inf, size)
        return Ground(np.broadcast_to(look.background, (*size, 3)), zero, zero, infinite, zero, far, nothing, empty)
    drawn = _Triangles.of(surfaces, look)
    depth, hit = drawn.seen()
    seen = hit >= 0
    held = seen & drawn.held[hit]
    there = seen & ~held
    rgb = np.zeros((*size, 3), np.float32) + look.background
    rgb[held] = 0
    rgb[there] = drawn.colors(hit[there], camera.pixel_grid()[there])
    index = np.where(there, drawn.index[hit], 0)
    shown = np.where(there, depth, np.inf)
    limit = np.minimum(depth, look.far).astype(np.float32)
    layers = _layers(surfaces, look, wanted, shown, hit) if wanted else {}
    sharp = Ground(rgb, there.astype(float), held.astype(float), shown, index, limit, hit, layers)
    return sharp if look.samples < 2 else _with_edges(sharp, drawn)


@dataclass(frozen=True, eq=False)
class _Triangles:
    """The triangles of all surfaces, one after the other."""

    corners: np.ndarray
    """(T,3,3)."""
    owner: np.ndarray
    """(T,) number of the surface."""
    held: np.ndarray
    """(T,) whether it is held out."""
    index: np.ndarray
    """(T,) number of the object."""
    surfaces: Sequence[Surface]
    firsts: np.ndarray
    """Number of each surface's first triangle."""
    look: Look

    @classmethod
    def of(cls, surfaces: Sequence[Surface], look: Look) -> _Triangles:
        """Gather the triangles of `surfaces`."""
        counts = [len(surface.triangles) for surface in surfaces]
        owner = np.repeat(np.arange(len(surfaces)), counts)
        held = np.array([surface.holdout for surface in surfaces])[owner]
        index = np.array([surface.index for surface in surfaces])[owner]
        corners = np.concatenate([surface.triangles for surface in surfaces]).astype(np.float64)
        return cls(corners, owner, held, index, surfaces, np.cumsum([0, *counts[:-1]]), look)

    def seen(self, chosen: np.ndarray | None = None, offset: Sequence[float] = (0, 0)) -> tuple[np.ndarray, np.ndarray]:
        """Return (depth (H,W), number of the triangle (H,W)) at the pixels' centres moved by `offset`; `chosen`: of those alone."""
        from ..raster.triangles import draw_triangles

        camera, corners = self.look.camera, self.corners if chosen is None else self.corners[chosen]
        matrix = camera.intrinsics.copy()
        matrix[:2, 2] -= offset
        limits = {"near": self.look.near, "far": self.look.far}
        depth, hit = draw_triangles(corners, replace(camera, intrinsics=matrix), **limits)
        return depth, hit if chosen is None else np.append(chosen, -1)[hit]

    def colors(self, hit: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Return (n,3) sRGB that triangles `hit (n,)` show at `pixels (n,2)`; 0 where they are held out."""
        weights = self._weights(hit, pixels)
        camera = self.look.camera
        rays = camera.unproject(pixels, np.ones(len(pixels))) - camera.center
        rgb = np.zeros((len(hit), 3))
        for number, surface in enumerate(self.surfaces):
            own = np.flatnonzero(self.owner[hit] == number)
            if surface.holdout or not len(own):
                continue
            triangle, weight = hit[own] - self.firsts[number], weights[own]
            rgb[own] = _shaded(surface, triangle, weight, rays[own])
        return rgb

    @cached_property
    def _edges(self) -> np.ndarray:
        """(T,3,3) edge functions on the screen."""
        from ..raster.triangles import edge_functions

        camera = self.look.camera
        local = self.corners @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        return edge_functions(local @ camera.intrinsics.T)

    def _weights(self, hit: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Return (n,3) barycentric coordinates of where the rays of `pixels` meet triangles."""
        edges = self._edges[hit]
        found = edges[..., 0] * pixels[:, :1] + edges[..., 1] * pixels[:, 1:] + edges[..., 2]
        found = np.clip(found / found.sum(1, keepdims=True), 0, 1)  # rounding may leave the triangle
        return found / found.sum(1, keepdims=True)

    def meeting(self, mask: np.ndarray) -> np.ndarray:
        """Return the numbers of the triangles whose rectangle on the screen holds a pixel of `mask (H,W)`."""
        camera = self.look.camera
        local = self.corners @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        ahead = (local[..., 2] > self.look.near).all(1)
        places = local @ camera.intrinsics.T
        places = places[..., :2] / np.where(ahead[:, None], places[..., 2], 1)[..., None]
        size = [camera.width, camera.height]
        first = np.where(ahead[:, None], np.clip(np.floor(places.min(1)) - 1, 0, size), 0).astype(np.int64)
        last = np.where(ahead[:, None], np.clip(np.ceil(places.max(1)) + 1, 0, size), size).astype(np.int64)
        total = np.pad(mask.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        inside = total[last[:, 1], last[:, 0]] - total[first[:, 1], last[:, 0]]
        inside += total[first[:, 1], first[:, 0]] - total[last[:, 1], first[:, 0]]
        return np.flatnonzero(inside > 0)


def _shaded(surface: Surface, triangle: np.ndarray, weights: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return (n,3) sRGB of places in triangles of a surface, by barycentric `weights (n,3)`, lit along `rays (n,3)`."""
    if surface.colors.ndim == 2:
        colors = surface.colors[np.minimum(triangle, len(surface.colors) - 1)].astype(np.float64)
    else:
        colors = (surface.colors[triangle] * weights[..., None]).sum(1)
    for texture in surface.textures:
        chosen = texture.on[triangle]
        uvs = (texture.uvs[triangle[chosen]] * weights[chosen, :, None]).sum(1)
        colors[chosen] = sample(texture.image, uvs)
    corners = surface.triangles[triangle]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if surface.normals is not None:
        normals = (surface.normals[triangle] * weights[..., None]).sum(1)
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(rays, axis=1)
    cosine = np.abs((normals * rays).sum(1)) / np.maximum(lengths, np.finfo(float).tiny)
    colors *= (AMBIENT + (1 - AMBIENT) * cosine)[:, None]
    if surface.glow is None:
        return colors
    return srgb_from_linear(linear_from_srgb(colors) + surface.glow[triangle])


def _with_edges(sharp: Ground, drawn: _Triangles) -> Ground:
    """Return the ground with soft edges where things meet."""
    owner = np.append(drawn.owner, -1)
    own = owner[sharp.hit]
    mask = _meets(own, sharp.rgb)
    if not mask.any():
        return sharp
    chosen, look = drawn.meeting(mask), drawn.look
    centre, pixels = own[mask], look.camera.pixel_grid()[mask]
    count = len(centre)
    kept, same = np.zeros(count), np.zeros((count, 3))
    rest = {"rgb": np.zeros((count, 3)), "alpha": np.zeros(count), "held": np.zeros(count)}
    nearest, limit = np.full(count, -1), np.full(count, np.inf)
    for offset in _offsets(look.samples):
        depth, hit = (image[mask] for image in drawn.seen(chosen, offset))
        rgb = np.tile(look.background, (count, 1)).astype(np.float64)
        seen = hit >= 0
        rgb[seen] = drawn.colors(hit[seen], pixels[seen] + offset)
        stays = owner[hit] == centre
        kept += stays
        same += rgb * stays[:, None]
        held = seen & drawn.held[hit]
        for name, values in (("rgb", rgb * ~held[:, None]), ("alpha", seen & ~held), ("held", held)):
            rest[name] += np.where(stays if values.ndim == 1 else stays[:, None], 0, values)
        nearer = ~stays & (depth < limit)
        nearest[nearer], limit[nearer] = hit[nearer], depth[nearer]
    others = np.maximum(look.samples - kept, 1)
    rgb = sharp.rgb.copy()
    rgb[mask] = np.where(kept[:, None] > 0, same / np.maximum(kept, 1)[:, None], rgb[mask])
    part = np.ones(mask.shape)
    part[mask] = kept / look.samples
    limits = _spread(np.where(kept < look.samples, np.minimum(limit, look.far), 0), mask, 0).astype(np.float32)
    found = {name: _spread((values.T / others).T, mask, 0) for name, values in rest.items()}
    far, zero = np.full(mask.shape, np.inf), np.zeros(mask.shape)
    hit = _spread(nearest, mask, -1)
    beside = Ground(found["rgb"], found["alpha"], found["held"], far, zero, limits, hit)
    return replace(sharp, rgb=rgb, fraction=part, beside=beside)


def _meets(own: np.ndarray, rgb: np.ndarray) -> np.ndarray:
    """Return (H,W) where what `own (H,W)` numbers, or its color, differs from that of a neighboring pixel, and beside that."""
    mask = np.zeros(own.shape, bool)
    for axis in (0, 1):
        first, second = (
            tuple(part if a == axis else slice(None) for a in (0, 1)) for part in (slice(None, -1), slice(1, None))
        )
        differs = (own[first] != own[second]) | (np.abs(rgb[first] - rgb[second]).max(-1) > CREASE)
        mask[first] |= differs
        mask[second] |= differs
    wider = np.pad(mask, 1)
    return np.logical_or.reduce([wider[i : i + own.shape[0], j : j + own.shape[1]] for i in range(3) for j in range(3)])


def _offsets(count: int) -> np.ndarray:
    """Return (count,2) points of a pixel from its centre, each in a row and a column of its own."""
    order = np.argsort(np.argsort(np.arange(count) * (5**0.5 - 1) / 2 % 1))
    return np.stack([np.arange(count) + 0.5, order + 0.5], 1) / count - 0.5


def _spread(values: np.ndarray, mask: np.ndarray, empty: float) -> np.ndarray:
    """Return (H,W,...) `values` where `mask (H,W)` is, and `empty` elsewhere."""
    whole = np.full((*mask.shape, *values.shape[1:]), empty, values.dtype)
    whole[mask] = values
    return whole


def _layers(
    surfaces: Sequence[Surface], look: Look, wanted: Sequence[str], depth: np.ndarray, hit: np.ndarray
) -> dict[str, np.ndarray]:
    """Return `Ground.layers` of surfaces, with the `depth (H,W)` where they show themselves and the triangles `hit (H,W)`."""
    there, camera = np.isfinite(depth), look.camera
    corners = np.concatenate([surface.triangles for surface in surfaces])[hit[there]].astype(np.float64)
    places = camera.unproject(camera.pixel_grid()[there], depth[there])
    own = {"mist": mist_left(look.mist, places, camera)[:, None]}
    sides = corners[:, 1:] - corners[:, :1]
    # where in its triangle a place lies, by least squares in the triangle's plane
    gram = sides @ sides.transpose(0, 2, 1)
    part = np.linalg.solve(gram, sides @ (places - corners[:, 0])[..., None])[..., 0]
    weights = np.concatenate([1 - part.sum(1, keepdims=True), part], 1)[..., None]
    if "normal" in wanted:
        normal = (np.concatenate([surface.corner_normals for surface in surfaces])[hit[there]] * weights).sum(1)
        normal *= -np.sign((normal * (places - camera.center)).sum(1))[:, None]
        own["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    if "vector" in wanted:
        both = [surface.beside or (surface.triangles, surface.triangles) for surface in surfaces]
        beside = [(np.concatenate([one[i] for one in both])[hit[there]] * weights).sum(1) for i in (0, 1)]
        own["vector"] = np.concatenate([at - places for at in beside], 1)
    layers = {name: np.zeros((*hit.shape, GEOMETRY[name])) for name in wanted}
    for name, layer in layers.items():
        layer[there] = own[name]
    return layers
