"""Small worlds whose everything is known: textured boxes and sheets of triangles, moved by formulas.

A world gives a clip and its true priors, so that a study measures a choice of the fit and not the priors; and any view at
any time, so that errors are told where no camera was. Lengths are in world units (median depth about 1); a clip of any
number of frames shows the same motion, at `phase` 0 to 1.

Surfaces are triangles and not dense Gaussians. Of overlapping Gaussians the one in front is seen, half a footprint beside
the surface's own point, and on the other side when the camera crosses the surface's normal: such a wall jumped by 1.5 pixels
in mid-clip, no true camera explained it, and fits were judged by how they bent their cameras to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from f4x_core.clip import Clip
from f4x_core.geometry import pose, quaternion, spherical_harmonics
from f4x_core.geometry.camera import Camera, CameraPath
from f4x_core.priors import Priors
from f4x_core.raster.triangles import draw_triangles

Motion = Callable[[np.ndarray, float], np.ndarray]
"""Rest positions (n,3) and phase to positions (n,3)."""

SPACING = 0.011
"""Between points of a surface that can be tracked: about a pixel of a picture 80 wide at depth 1."""
SUBPIXELS = 3
"""Rays per pixel and axis, averaged: pictures without jagged edges."""
FOCAL = 0.9
"""In picture widths."""
MIDDLE = np.array([0.0, 0.0, 0.95])
"""Point that the cameras look at."""
WAVES, MAX_WAVELENGTH, MIN_WAVELENGTH = 14, 0.6, 0.035
"""Number and wavelengths of a texture's waves."""
HOLD_OUT = 5
"""Every so many frames the middle one is held out: each has used ones on both sides."""
NOVEL_DEGREES = (4.0, -3.0)
"""Novel views look from so far to the side of, and above, the clip's path."""
PURE = 0.85
"""Minimum fraction of a pixel's blend weight that one body must have for the pixel's depth to be known."""
SEEN = 0.02
"""A point is visible where the rendered depth differs from its own by less than this fraction."""


@dataclass(frozen=True, eq=False)
class Body:
    """A surface that moves as one formula says."""

    label: str
    xyz: np.ndarray
    """(n,3) points of the surface at rest, evenly spread: what tracks follow."""
    triangles: np.ndarray
    """(T,3,3) corners at rest."""
    look: int
    """Seeds the texture."""
    motion: Motion | None = None
    """None = it never moves."""
    shine: float = 0.0
    """Strength by which the colour changes with the direction of view (degree 1 in the world's axes: only of static bodies)."""

    def at(self, phase: float) -> np.ndarray:
        """Positions (n,3) of the points."""
        return self.xyz if self.motion is None else self.motion(self.xyz, phase)

    def triangles_at(self, phase: float) -> np.ndarray:
        """Corners (T,3,3)."""
        corners = self.triangles.reshape(-1, 3)
        return (corners if self.motion is None else self.motion(corners, phase)).reshape(-1, 3, 3)

    def colour(self, rest: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Colours (n,3) of surface points given at rest (n,3), seen along unit `directions` (n,3)."""
        sh = spherical_harmonics.dc_from_rgb(texture(rest, self.look))[:, None]
        if self.shine:
            slopes = self.shine * (texture(rest[:, [2, 0, 1]], self.look + 1000) - 0.5)
            sh = np.concatenate([sh, np.stack([slopes, -slopes, slopes[:, [1, 2, 0]]], 1)], 1)
        return spherical_harmonics.evaluate(sh, directions)


@dataclass(frozen=True, eq=False)
class View:
    """True view of a camera."""

    rgb: np.ndarray
    """(H,W,3) float32 in [0,1]."""
    depth: np.ndarray
    """(H,W) float32, NaN where two bodies mix or nothing is."""
    label: np.ndarray
    """(H,W) int, index into `World.labels`; -1 where nothing is."""
    moving: np.ndarray
    """(H,W) float32 fraction of the blend weight that comes from moving bodies."""
    mix: np.ndarray
    """(H,W,L) float32 fraction of the blend weight of each label."""


@dataclass(frozen=True, eq=False)
class World:
    """Bodies and a camera path."""

    name: str
    bodies: tuple[Body, ...]
    width: int = 96
    height: int = 54
    frames: int = 16
    arc: float = 8.0
    """Degrees that the camera swings to either side."""

    @property
    def labels(self) -> list[str]:
        """Names of the bodies, each once."""
        return list(dict.fromkeys(body.label for body in self.bodies))

    @cached_property
    def cameras(self) -> CameraPath:
        """Path of the clip: an arc around `MIDDLE`, with a little up and down."""
        phase = np.linspace(0, 1, self.frames)
        return self._path(self.arc * (2 * phase - 1), 2 * np.sin(2 * np.pi * phase))

    @cached_property
    def novel_cameras(self) -> CameraPath:
        """The same path, turned aside by `NOVEL_DEGREES`."""
        phase = np.linspace(0, 1, self.frames)
        aside, above = NOVEL_DEGREES
        return self._path(self.arc * (2 * phase - 1) + aside, 2 * np.sin(2 * np.pi * phase) + above)

    def _path(self, aside: np.ndarray, above: np.ndarray) -> CameraPath:
        turn = np.radians(np.stack([above, aside, np.zeros_like(above)], -1))  # about x, then y
        turn = quaternion.to_matrix(quaternion.from_rotation_vector(turn))  # (T,3,3) camera to world
        matrices = np.tile(np.eye(4), (self.frames, 1, 1))
        matrices[:, :3, :3] = turn.transpose(0, 2, 1)
        centres = MIDDLE - turn @ MIDDLE
        matrices[:, :3, 3] = -np.einsum("tij,tj->ti", matrices[:, :3, :3], centres)
        lens = np.array([[FOCAL * self.width, 0, self.width / 2], [0, FOCAL * self.width, self.height / 2], [0, 0, 1]])
        times = np.arange(self.frames, dtype=float)
        return CameraPath(np.tile(lens, (self.frames, 1, 1)), matrices, times, self.width, self.height)

    def at(self, time: float) -> np.ndarray:
        """Positions (N,3) of all bodies' points at a clip time."""
        return np.concatenate([body.at(self._phase(time)) for body in self.bodies])

    def _phase(self, time: float) -> float:
        return time / max(self.frames - 1, 1)

    @cached_property
    def moving(self) -> np.ndarray:
        """(N,) bool: points of bodies with a motion."""
        return np.concatenate([np.full(len(body.xyz), body.motion is not None) for body in self.bodies])

    @cached_property
    def label_of(self) -> np.ndarray:
        """(N,) int: index of each point's label."""
        return np.concatenate([np.full(len(body.xyz), self.labels.index(body.label)) for body in self.bodies])

    def view(self, camera: Camera, time: float) -> View:
        """Render what `camera` sees at a clip time: `SUBPIXELS` x `SUBPIXELS` rays in each pixel, averaged."""
        corners = [body.triangles_at(self._phase(time)) for body in self.bodies]
        triangles = np.concatenate(corners)
        fine = camera.resized(SUBPIXELS * camera.width, SUBPIXELS * camera.height)
        depth, index = draw_triangles(triangles, fine)
        owner = np.repeat(np.arange(len(self.bodies)), [len(part) for part in corners])
        hit = index >= 0
        drawn = np.where(hit, owner[index], -1)
        places = fine.unproject(fine.pixel_grid(), np.where(hit, depth, 1.0))
        weights = barycentric(places[hit], triangles[index[hit]])
        rest = np.einsum("nk,nkc->nc", weights, np.concatenate([body.triangles for body in self.bodies])[index[hit]])
        directions = places[hit] - camera.center
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        colours = np.zeros((len(rest), 3))
        for number, body in enumerate(self.bodies):
            own = drawn[hit] == number
            colours[own] = body.colour(rest[own], directions[own])
        layers = np.zeros((*hit.shape, 3 + len(self.labels) + 2))  # colours, labels, what moves, depth
        layers[hit, :3] = colours
        label = np.array([self.labels.index(body.label) for body in self.bodies])[drawn[hit]]
        layers[(*np.nonzero(hit), 3 + label)] = 1
        layers[hit, -2] = np.array([body.motion is not None for body in self.bodies])[drawn[hit]]
        layers[hit, -1] = depth[hit]
        shape = camera.height, SUBPIXELS, camera.width, SUBPIXELS
        return _averaged(layers.reshape(*shape, -1).mean((1, 3)), hit.reshape(shape).mean((1, 3)))

    @cached_property
    def views(self) -> list[View]:
        """Every clip frame."""
        return [self.view(self.cameras[i], float(i)) for i in range(self.frames)]

    @cached_property
    def novel_views(self) -> list[tuple[Camera, float, View]]:
        """Every other frame's time, seen from the novel path."""
        path = self.novel_cameras
        return [(path[i], float(i), self.view(path[i], float(i))) for i in range(0, self.frames, 2)]

    @cached_property
    def clip(self) -> Clip:
        """The frames, one of `HOLD_OUT` held out."""
        frames = np.stack([(255 * view.rgb + 0.5).astype(np.uint8) for view in self.views])
        held_out = np.arange(self.frames) % HOLD_OUT == HOLD_OUT // 2
        return Clip(self.name, frames, self.cameras.times, 24.0, held_out, self.name)

    @cached_property
    def tracks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions (T,n,2), visibility (T,n), and whether it moves (n,), of points that the clip sees often enough."""
        picked = np.flatnonzero(np.arange(len(self.moving)) % np.where(self.moving, 3, 13) == 0)
        pixels, seen = [], []
        for time, view in enumerate(self.views):
            uv, z = self.cameras[time].project(self.at(time)[picked])
            column, row = np.floor(uv).astype(int).T
            inside = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
            surface = view.depth[row.clip(0, self.height - 1), column.clip(0, self.width - 1)]
            with np.errstate(invalid="ignore"):
                seen.append(inside & (np.abs(surface - z) < SEEN * z))
            pixels.append(uv)
        visible = np.stack(seen)
        often = visible.sum(0) >= min(4, self.frames)
        return np.stack(pixels)[:, often], visible[:, often], self.moving[picked][often]

    @cached_property
    def priors(self) -> Priors:
        """The truth in the place of priors; without flow, which the fit does not read."""
        clip = self.clip
        used, views = clip.supervised, [self.views[i] for i in clip.supervised]
        pixels, visible, moving = self.tracks
        priors = Priors.empty(clip)
        priors.camera_kind, priors.cameras = "moving", self.cameras.at_times(used.astype(float))
        priors.depth = np.stack([view.depth for view in views])
        priors.depth_confidence = np.isfinite(priors.depth).astype(np.float16)
        priors.motion = np.stack([view.moving for view in views]).astype(np.float16)
        priors.mask = priors.motion > 0.5
        priors.tracks, priors.tracks_visible = pixels[used].astype(np.float32), visible[used]
        priors.tracks_motion = moving.astype(np.float32)
        priors.validate()
        return priors


def _averaged(layers: np.ndarray, alpha: np.ndarray) -> View:
    """A view of channels (H,W,3 + L + 2), averaged over each pixel: colours, labels, what moves, depth; `alpha` (H,W) is hit."""
    colours, mix, moving, depth = np.split(layers, [3, -2, -1], axis=-1)
    mix, depth = mix / np.maximum(alpha, 1e-6)[..., None], depth[..., 0] / np.maximum(alpha, 1e-6)
    there = alpha > 0.5
    known = there & (mix.max(-1) > PURE)
    return View(
        colours.clip(0, 1).astype(np.float32),
        np.where(known, depth, np.nan).astype(np.float32),
        np.where(there, mix.argmax(-1), -1),
        moving[..., 0].clip(0, 1).astype(np.float32),
        mix.astype(np.float32),
    )


def barycentric(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Weights (n,3) of the corners of `triangles` (n,3,3) that make `points` (n,3) in their planes."""
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    aside = points - triangles[:, 0]
    normal = np.cross(one, two)
    area = (normal**2).sum(1)
    second = (np.cross(aside, two) * normal).sum(1) / area
    third = (np.cross(one, aside) * normal).sum(1) / area
    return np.stack([1 - second - third, second, third], 1)


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in the world; its sides are at right angles."""

    corner: Sequence[float]
    """(3,) one corner."""
    across: Sequence[float]
    """(3,) first side, from the corner."""
    up: Sequence[float]
    """(3,) second side, from the corner."""


def sheet(
    label: str, area: Rectangle, look: int, motion: Motion | None = None, shine: float = 0.0, spacing: float = SPACING
) -> Body:
    """Return a textured rectangle of two triangles; with `motion`, which may bend it, of two for every point.

    `look` and `shine` are those of `Body`.
    """
    corner, u, v = (np.array(a, float) for a in (area.corner, area.across, area.up))
    counts = [max(round(np.linalg.norm(side) / spacing), 1) for side in (u, v)]
    a, b = np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts), indexing="ij")
    xyz = corner + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v
    pieces = (1, 1) if motion is None else counts
    a, b = (part.reshape(-1, 1) for part in np.meshgrid(*(np.arange(n) / n for n in pieces), indexing="ij"))
    first, u, v = corner + a * u + b * v, u / pieces[0], v / pieces[1]
    halves = [np.stack([first, first + u, first + v], 1), np.stack([first + u + v, first + v, first + u], 1)]
    return Body(label, xyz, np.concatenate(halves), look, motion, shine)


def box(
    label: str,
    centre: Sequence[float] | np.ndarray,
    size: Sequence[float] | np.ndarray,
    look: int,
    motion: Motion | None = None,
) -> Body:
    """Six textured faces around `centre`, axes along the world's at rest."""
    middle, half = np.array(centre, float), np.array(size, float) / 2
    faces = []
    for axis in range(3):
        one, two = np.eye(3)[(axis + 1) % 3] * 2 * half, np.eye(3)[(axis + 2) % 3] * 2 * half
        for side in (-1, 1):
            corner = middle + side * np.eye(3)[axis] * half - (one + two) / 2
            faces.append(sheet(label, Rectangle(corner, one, two), look))
    xyz, triangles = (np.concatenate([getattr(face, name) for face in faces]) for name in ("xyz", "triangles"))
    return Body(label, xyz, triangles, look, motion)


def texture(xyz: np.ndarray, look: int) -> np.ndarray:
    """Colours (n,3) in [0,1]: a hue of the look's own and waves of many lengths through space."""
    rng = np.random.default_rng(look)
    direction = rng.normal(size=(WAVES, 3))
    length = np.geomspace(MAX_WAVELENGTH, MIN_WAVELENGTH, WAVES)
    wave = 2 * np.pi * direction / np.linalg.norm(direction, axis=1, keepdims=True) / length[:, None]
    strength = rng.uniform(-1, 1, (WAVES, 3)) * (length / MAX_WAVELENGTH)[:, None] ** 0.4
    base = rng.uniform(0.3, 0.7, 3)
    return np.clip(base + 0.17 * np.sin(xyz @ wave.T + rng.uniform(0, 2 * np.pi, WAVES)) @ strength, 0.02, 0.98)


def ride(
    xyz: np.ndarray, phase: float, *, pivot: Sequence[float], turn: Sequence[float], shift: Sequence[float]
) -> np.ndarray:
    """Return a rigid motion: turned about `pivot` by up to the rotation vector `turn`, carried by up to `shift` on an arc."""
    q = quaternion.from_rotation_vector(phase * np.asarray(turn, float))
    carried = np.asarray(pivot) + phase * np.asarray(shift, float) - [0, 0.06 * np.sin(np.pi * phase), 0]
    return quaternion.rotate(q, xyz - pivot) + carried


def bend_arm(
    xyz: np.ndarray, phase: float, *, joints: Sequence[Sequence[float]], angles: Sequence[float]
) -> np.ndarray:
    """A link of an arm: turned at every joint from the shoulder to its own, each up to its angle (radians, in the picture)."""
    q, t = quaternion.IDENTITY, np.zeros(3)
    for joint, angle in zip(joints, angles, strict=True):
        own = quaternion.from_rotation_vector(angle * np.array([0.25 * phase, 0, np.sin(0.5 * np.pi * phase)]))
        q, t = pose.compose(q, t, own, np.asarray(joint) - quaternion.rotate(own, np.asarray(joint, float)))
    return pose.transform(q, t, xyz)


def wave(xyz: np.ndarray, phase: float, *, left: float) -> np.ndarray:
    """Return a sheet in the picture's plane that waves like a flag, held at its edge x = `left`."""
    along = xyz[:, 0] - left
    depth = 0.22 * along * np.sin(11 * along - 2 * np.pi * phase)
    return xyz + np.stack([np.zeros_like(along), 0.1 * along * np.sin(2 * np.pi * phase), depth], -1)


def room(shine: float = 0.0) -> tuple[Body, ...]:
    """Return the static background: a wall and a floor."""
    back, ground = (
        Rectangle((-1.1, -0.7, 1.15), (2.2, 0, 0), (0, 1.05, 0)),
        Rectangle((-1.0, 0.26, 0.5), (2.0, 0, 0), (0, 0, 0.65)),
    )
    wall = sheet("wall", back, 1, shine=shine, spacing=1.3 * SPACING)
    return wall, sheet("floor", ground, 2, spacing=1.3 * SPACING)


def _static() -> tuple[Body, ...]:
    return *room(), box("box", (0.05, 0.05, 0.85), (0.22, 0.22, 0.22), 3)


def _rigid() -> tuple[Body, ...]:
    way = partial(ride, pivot=(-0.2, 0.05, 0.82), turn=(0.3, 1.3, 0.2), shift=(0.36, -0.04, 0.02))
    return *room(), box("box", (-0.2, 0.05, 0.82), (0.2, 0.2, 0.2), 3, way)


def _two_movers() -> tuple[Body, ...]:
    one = partial(ride, pivot=(-0.24, 0.1, 0.8), turn=(0, 1.1, 0.3), shift=(0.16, -0.1, 0.05))
    two = partial(ride, pivot=(0.2, 0.0, 0.9), turn=(0.8, 0, -0.9), shift=(0.06, 0.12, -0.1))
    return (
        *room(),
        box("box", (-0.24, 0.1, 0.8), (0.17, 0.17, 0.17), 3, one),
        box("brick", (0.2, 0.0, 0.9), (0.22, 0.13, 0.13), 4, two),
    )


def _articulated() -> tuple[Body, ...]:
    shoulder, elbow, wrist = (-0.3, 0.12, 0.83), (-0.1, 0.12, 0.83), (0.1, 0.12, 0.83)
    joints, angles = (shoulder, elbow, wrist), (-0.5, 0.9, -1.3)
    links = []
    for count in (1, 2, 3):
        x, y, z = joints[count - 1]
        way = partial(bend_arm, joints=joints[:count], angles=angles[:count])
        links.append(box("arm", (x + 0.1, y, z), (0.19, 0.08, 0.08), 4 + count, way))
    return *room(), *links


def _deforming() -> tuple[Body, ...]:
    left = -0.26
    area = Rectangle((left, -0.16, 0.85), (0.5, 0, 0), (0, 0.3, 0))
    flag = sheet("flag", area, 8, partial(wave, left=left))
    return *room(), flag


def _shiny() -> tuple[Body, ...]:
    return room(shine=0.9)


def _labelled() -> tuple[Body, ...]:
    """Fifteen tiles on the wall, each a thing of its own, and a mover in front."""
    tiles = [
        sheet(
            f"tile {i}",
            Rectangle((-0.75 + 0.3 * (i % 5), -0.48 + 0.3 * (i // 5), 1.1), (0.28, 0, 0), (0, 0.28, 0)),
            20 + i,
        )
        for i in range(15)
    ]
    return *_rigid(), *tiles


def _rolling() -> tuple[Body, ...]:
    way = partial(ride, pivot=(-0.24, 0.08, 0.82), turn=(0, 0, 5.2), shift=(0.45, 0, 0))
    return *room(), box("box", (-0.24, 0.08, 0.82), (0.2, 0.2, 0.2), 3, way)


KINDS: dict[str, tuple[str, Callable[[], tuple[Body, ...]], float]] = {
    "static": ("nothing moves", _static, 8.0),
    "rigid": ("one rigid mover", _rigid, 8.0),
    "two movers": ("two rigid movers", _two_movers, 8.0),
    "articulated": ("an arm of three links", _articulated, 8.0),
    "deforming": ("a waving flag", _deforming, 8.0),
    "view-dependent": ("nothing moves, the wall shines", _shiny, 16.0),
    "feature-rich": ("eighteen things, one of which moves", _labelled, 8.0),
    "rolling": ("a box that rolls through 300 degrees", _rolling, 8.0),
}
"""Name -> what it is, its bodies, and the degrees that the camera swings."""


def make_world(name: str, width: int = 96, frames: int = 16) -> World:
    """Return the world called `name` (of `KINDS`); pictures are 16:9."""
    _, bodies, arc = KINDS[name]
    return World(name, bodies(), width, round(width * 9 / 16), frames, arc)
