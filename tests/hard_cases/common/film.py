"""A small world of textured cards and a camera that films it by tracing rays: exact colours, depth, masks and cameras.

It shares no code with the rasteriser, so that a case can tell right from wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from f4x_core.clip import Clip
from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import Camera, CameraPath

WIDTH, HEIGHT, FRAMES = 96, 56, 12
FOCAL = 0.9
"""Picture widths."""
MIDDLE = (FRAMES - 1) / 2
"""Time at which the camera is before the middle of the room."""
Texture = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Places (...) on a card, world units -> colours (..., 3) in [0, 1]."""
Places = Callable[[float], np.ndarray]
"""Time in frames -> (3,) world position."""


def checks(period: float, tint: float = 0.0) -> Texture:
    """Soft checks, the largest of `period` world units, in colours of their own `tint`."""
    hue = 0.5 + 0.18 * np.cos(tint + np.array([0, 2.1, 4.2]))

    def colour(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        a, b = 2 * np.pi * (0.9 * u + 0.4 * v) / period, 2 * np.pi * (0.9 * v - 0.4 * u) / period
        large, small = np.sin(a + tint) * np.cos(b), np.sin(1.9 * b + 1.3 * tint) + np.sin(2.3 * a)
        return hue + 0.16 * large[..., None] + 0.06 * np.stack([small, small, -small], -1)

    return colour


def plain(*rgb: float) -> Texture:
    """One colour."""
    return lambda u, v: np.broadcast_to(np.array(rgb), (*u.shape, 3))


@dataclass(frozen=True)
class Card:
    """A flat rectangle (or disc) in the plane z = 0 of its own frame."""

    texture: Texture
    half: tuple[float, float] = (np.inf, np.inf)
    """Half sides, world units."""
    at: Places = lambda time: np.zeros(3)
    """Where its centre is."""
    turn: Callable[[float], np.ndarray] = lambda time: np.zeros(3)
    """How it is turned: rotation vector (3,), radians."""
    moves: bool = False
    """It belongs to the mask of what moves by itself."""
    disc: bool = False


@dataclass(frozen=True)
class Film:
    """What was filmed, and the truth about it."""

    clip: Clip
    cameras: CameraPath
    depth: np.ndarray
    """(T, H, W) float32 z depth, NaN where no card is."""
    mask: np.ndarray
    """(T, H, W) bool: a card that moves."""
    show: Callable[[Camera, float], tuple[np.ndarray, np.ndarray, np.ndarray]]
    """Camera and time in frames -> what any camera would have seen, with a shutter of no length: picture (H, W, 3) uint8, z
    depth (H, W), and whether it moves (H, W)."""


def standing(*place: float) -> Places:
    """A place that stays."""
    return lambda time: np.array(place, float)


def gliding(start: Sequence[float], step: Sequence[float]) -> Places:
    """A place that moves by `step` a frame."""
    return lambda time: np.array(start, float) + time * np.array(step, float)


def room(*cards: Card) -> list[Card]:
    """A slanting wall, a floor and two posts that stand before it, and `cards`."""
    return [
        Card(checks(0.57), at=standing(0, 0, 1.6), turn=standing(0, 0.35, 0)),
        Card(checks(0.43, 1.0), at=standing(0, 0.25, 1), turn=standing(np.pi / 2, 0, 0)),
        Card(checks(0.15, 2.0), (0.06, 0.5), at=standing(-0.42, 0.1, 1.0)),
        Card(checks(0.15, 3.0), (0.05, 0.5), at=standing(0.5, 0.1, 0.9)),
        *cards,
    ]


def mover(speed: float = 0.01, depth: float = 0.8) -> Card:
    """A card that glides to the left and down."""
    return Card(checks(0.2, 4.0), (0.12, 0.12), at=gliding((0.08, -0.04, depth), (-speed, speed, 0)), moves=True)


def trace(cards: Sequence[Card], camera: Camera, time: float, rows: slice = slice(None)) -> tuple[np.ndarray, ...]:
    """Colours (h,W,3) in [0,1], z depth (h,W) with NaN where nothing is, and whether it moves (h,W), of some rows."""
    pixels = camera.pixel_grid()[rows]
    eye, far = camera.center, camera.unproject(pixels, np.ones(pixels.shape[:2]))
    rays = far - eye  # z depth 1 in the camera
    rgb, depth = np.zeros((*pixels.shape[:2], 3)), np.full(pixels.shape[:2], np.inf)
    moving = np.zeros(pixels.shape[:2], bool)
    for card in cards:
        q, t = pose.invert(quaternion.from_rotation_vector(card.turn(time)), card.at(time))
        origin, along = pose.transform(q, t, eye), quaternion.rotate(q, rays)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origin[2] / along[..., 2]
            u, v = (origin[i] + distance * along[..., i] for i in (0, 1))
            inside = (abs(u) <= card.half[0]) & (abs(v) <= card.half[1]) & (distance > 1e-3) & (distance < depth)
            if card.disc:
                inside &= np.hypot(u, v) <= card.half[0]
        depth = np.where(inside, distance, depth)
        rgb[inside] = card.texture(u[inside], v[inside])
        moving[inside] = card.moves
    return rgb, np.where(np.isinf(depth), np.nan, depth), moving


LEVEL = standing(0, 0, 0)


def sideways(step: float = 0.03) -> Places:
    """A camera carried from left to right by `step` a frame, going up and down as a hand does."""
    return lambda time: np.array([step * (time - MIDDLE), 0.02 * np.sin(0.7 * time), 0])


def following(time: float) -> np.ndarray:
    """The look of a camera that keeps turning to the room's middle, and nods: without turns no focal length can be known."""
    return np.array([0.05 * np.sin(0.7 * time), -0.024 * (time - MIDDLE), 0])


SIDEWAYS = sideways()


def film(
    cards: Sequence[Card],
    eye: Places = SIDEWAYS,
    look: Places = following,
    frames: int = FRAMES,
    focal: float | Callable[[float], float] = FOCAL,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    hold_out: int = 4,
    shutter: float = 0.0,
    readout: float = 0.0,
    gain: Callable[[float], float] = lambda time: 1.0,
    cut_to: tuple[int, Sequence[Card]] | None = None,
    rays: int = 1,
) -> Film:
    """Film `cards` from `eye`, turned by the rotation vector `look`, with the focal length `focal` (a number or one of the time).

    `shutter`: share of a frame that the shutter is open (motion blur); `readout`: share of a frame between the first and
    the last row (rolling shutter); `gain`: exposure; `cut_to`: from that frame on other cards are seen; `rays`: rays along
    either side of a pixel.
    """
    width, height = size

    def lens(time: float) -> np.ndarray:
        length = width * (focal(time) if callable(focal) else focal)
        return np.array([[length, 0, width / 2], [0, length, height / 2], [0, 0, 1]])

    def camera(time: float) -> Camera:
        q = quaternion.from_rotation_vector(look(time))
        return Camera(lens(time), pose.to_matrix(*pose.invert(q, eye(time))), width, height)

    def shown(time: float) -> Sequence[Card]:
        return cut_to[1] if cut_to and time >= cut_to[0] else cards

    def show(seen: Camera, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        _, depth, _ = trace(shown(time), seen, time)
        moving = _blocks(trace(shown(time), _finer(seen, rays), time)[2], rays).any((1, 3))
        return _picture(_radiance(shown(time), seen, time, rays), gain(time)), depth, moving

    pictures, depths, masks = [], [], []
    for t in range(frames):
        _, depth, moving = show(camera(t), t)
        moments = t + shutter * np.linspace(-0.5, 0.5, 5) if shutter else [t]
        seen = []
        for moment in moments:
            bands = (
                [(row, moment + readout * (row / height - 0.5)) for row in range(height)]
                if readout
                else [(None, moment)]
            )
            parts = [
                _radiance(shown(t), camera(m), m, rays, slice(None) if row is None else slice(row, row + 1))
                for row, m in bands
            ]
            seen.append(np.concatenate(parts))
        pictures.append(_picture(np.mean(seen, 0), gain(t)))
        depths.append(depth)
        masks.append(moving)
    held_out = np.arange(frames) % hold_out == hold_out - 1 if hold_out else np.zeros(frames, bool)
    held_out[-1] = False  # a camera beyond the last used one would be a guess
    times = np.arange(frames, dtype=float)
    clip = Clip("film", np.stack(pictures), times, 24.0, held_out, "film")
    path = CameraPath(
        np.stack([lens(t) for t in times]), np.stack([camera(t).world_to_camera for t in times]), times, width, height
    )
    return Film(clip, path, np.stack(depths).astype(np.float32), np.stack(masks), show)


def _finer(camera: Camera, rays: int) -> Camera:
    """The same view in `rays` times as many rows and columns."""
    return camera.resized(rays * camera.width, rays * camera.height)


def _blocks(image: np.ndarray, rays: int) -> np.ndarray:
    """(h, rays, W, rays, ...) of an image of (h rays, W rays, ...)."""
    return image.reshape(len(image) // rays, rays, image.shape[1] // rays, rays, *image.shape[2:])


def _radiance(cards: Sequence[Card], camera: Camera, time: float, rays: int, rows: slice = slice(None)) -> np.ndarray:
    """Colours (h,W,3) in [0,1] of some rows, each pixel the mean of its rays."""
    first, end, _ = rows.indices(camera.height)
    return _blocks(trace(cards, _finer(camera, rays), time, slice(rays * first, rays * end))[0], rays).mean((1, 3))


def _picture(radiance: np.ndarray, gain: float) -> np.ndarray:
    return np.clip(255 * gain * radiance, 0, 255).round().astype(np.uint8)
