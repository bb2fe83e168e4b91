"""Registers the camera of a held-out frame by geometry alone: optical flow to used frames and the scene's depth there.

Held-out frames are judged with this camera: an interpolated one does not know the hand that shook, and one refined on colours
has seen the picture it is judged by. No colour of the scene is compared with the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..clip import Clip
from ..geometry.camera import Camera
from ..priors.bundle import Observations, from_matrices, resect
from ..priors.flow import Flow, best_of_cells, dis, grey, inside, length, sample
from ..scene import Scene
from ..scene.view import render

NEIGHBOURS, REACH = 3, 6
"""Used frames on either side that a held-out frame is matched with, and how many clip frames away they may be: flow fails over
long gaps, and each neighbour's own camera error averages out."""
FLOW_PRESET, FLOW_REFINEMENTS = "fine", 0
"""Settings of DIS. Variational refinement moves no score by more than 0.02 dB (means of train and of dog)."""
CELLS = 60
"""Cells across the picture; each gives at most one point, so that one textured wall does not outvote the rest."""
MIN_CELL = 6
"""Pixels; DIS interpolates between patches of 8, so that closer points tell the same."""
MIN_TEXTURE = 1e-4
"""Smaller eigenvalue of the structure tensor (grey in [0,1]): gradients of about 1.3 grey levels a pixel, the noise of a phone."""
MAX_RETURN_PX = 0.5
"""Largest distance between a point and its image after flow there and back."""
MIN_ALPHA = 0.8
"""A used frame's pixel with less has no dependable depth."""
MOVING_ALPHA, MOVING_MARGIN = 0.1, 0.02
"""A pixel with this much dynamic alpha within this fraction of the width is near something that moves."""
MAX_DEPTH_STEP = 1.1
"""Largest over smallest depth among neighbouring pixels; across an edge of depth a point may belong to either side."""
MIN_POINTS, TILES, MIN_TILES, MIN_TILE_POINTS = 60, 4, 6, 3
"""Points that hold a camera: so many, in so many of TILES x TILES tiles of the picture that have some each."""
ROBUST_PX = 1.0
"""Cauchy scale in pixels."""
MIN_SHIFT_PX = 0.1
"""Cameras whose pictures differ by less (median over the points) are the same to DIS; the interpolated one is kept."""


@dataclass(frozen=True)
class Registration:
    """The camera of a held-out frame and what speaks for it."""

    camera: Camera
    """The registered camera; the interpolated one where `found` is false or where the two agree."""
    found: bool
    """True if flow determines the camera."""
    points: int
    """Points it was measured on."""
    error_px: float
    """Median reprojection error of `camera`, pixels; NaN without points."""
    interpolated_error_px: float
    """Error in pixels of the interpolated camera."""


@dataclass(frozen=True)
class Sightings:
    """Static points of the scene and where the held-out frame shows them."""

    points: np.ndarray
    """(N, 3) float64, world."""
    pixels: np.ndarray
    """(N, 2) float64 in the held-out frame, pixel centres at +0.5."""


def register_camera(scene: Scene, clip: Clip, frame: int, backend: str = "auto") -> Registration:
    """Register held-out `frame` of `clip` against `scene`, starting from the interpolated camera `scene.cameras[frame]`."""
    start = scene.cameras[frame]
    flow = dis(FLOW_PRESET, FLOW_REFINEMENTS)
    seen = [_sightings(scene, clip, used, frame, flow, backend) for used in near_used(scene, len(clip), frame)]
    points = np.concatenate([np.zeros((0, 3)), *(s.points for s in seen)])
    pixels = np.concatenate([np.zeros((0, 2)), *(s.pixels for s in seen)])
    before = _median_error(start, points, pixels)
    kept = Registration(start, False, len(points), before, before)
    if not _spread(pixels, clip.width, clip.height):
        return kept
    camera = resected(start, points, pixels)
    shift = length(camera.project(points)[0] - start.project(points)[0])
    if float(np.median(shift)) < MIN_SHIFT_PX:
        return replace(kept, found=True)
    after = _median_error(camera, points, pixels)
    return Registration(camera, True, len(points), after, before) if after < before else kept


def near_used(scene: Scene, frames: int, frame: int) -> list[int]:
    """Return used clip frames near `frame` of a clip of `frames`, nearest first, at most NEIGHBOURS on either side."""
    held_out = set(scene.held_out)
    used = [other for other in range(frames) if other not in held_out and abs(other - frame) <= REACH]
    before = [other for other in used if other < frame][-NEIGHBOURS:]
    after = [other for other in used if other > frame][:NEIGHBOURS]
    return sorted(before + after, key=lambda other: abs(other - frame))


def resected(start: Camera, points: np.ndarray, pixels: np.ndarray) -> Camera:
    """Return the camera that sees world `points (N,3)` at `pixels (N,2)`, robustly, from `start`, whose intrinsics it keeps."""
    focal = float(start.intrinsics[0, 0])
    at_origin = Camera(start.intrinsics, np.eye(4), start.width, start.height)
    plane = at_origin.unproject(pixels, np.ones(len(pixels)))[:, :2]
    bundle = from_matrices(start.world_to_camera[None], focal, np.zeros(2), points)
    index = np.arange(len(points))
    seen = Observations(np.zeros_like(index), index, focal * plane, np.ones(len(points)))
    scale = max(ROBUST_PX, _median_error(start, points, pixels))  # a shaken frame starts several pixels away
    for robust_px in (scale, ROBUST_PX):
        bundle = resect(bundle, seen, np.zeros(1, int), robust_px=robust_px)
    return Camera(start.intrinsics, bundle.world_to_camera[0], start.width, start.height)


def halfway_offset(
    scene: Scene, frame: int, neighbours: tuple[int, ...], fraction: float, camera: Camera, backend: str = "auto"
) -> np.ndarray:
    """Return (H,W,2) float32: ways from pixels of `camera` at clip `frame` to the same surface in a blend along flow.

    A blend puts a surface point on the straight line between its pixels in the two `neighbours`, at `fraction` of the way; the
    scene's depth at `camera` says which point each pixel sees. With one neighbour it is the point's pixel there.
    """
    times = scene.cameras.times
    depth = render(scene, camera, float(times[frame]), ("depth",), backend)["depth"].astype(np.float64)
    known = np.isfinite(depth)
    depth[~known] = np.median(depth[known]) if known.any() else 1.0
    grid = camera.pixel_grid()
    surface = camera.unproject(grid, depth)
    weights = (1 - fraction, fraction) if len(neighbours) == 2 else (1.0,)
    places = [scene.cameras[other].project(surface)[0] for other in neighbours]
    offset = sum(weight * place for weight, place in zip(weights, places, strict=True)) - grid
    return offset.astype(np.float32)


def _sightings(scene: Scene, clip: Clip, used: int, frame: int, flow: Flow, backend: str) -> Sightings:
    """Return the static points with texture that clip frame `used` sees, and where flow finds them in `frame`."""
    import cv2

    camera, time = scene.cameras[used], float(scene.cameras.times[used])
    dynamic = scene.posed(time).dynamic[:, None].astype(np.float32)
    drawn = render(scene, camera, time, ("depth", "alpha"), backend, values={"dynamic": dynamic})
    allowed = (drawn["alpha"] >= MIN_ALPHA) & _smooth(drawn["depth"]) & ~_near_motion(drawn["dynamic"][..., 0])
    here, there = grey(clip.frames[[used, frame]])
    texture = np.where(allowed, cv2.cornerMinEigenVal(here, 3), 0)
    rows, columns = best_of_cells(texture, max(MIN_CELL, round(clip.width / CELLS)), MIN_TEXTURE)
    forward, backward = flow(here, there), flow(there, here)
    start = np.stack([columns, rows], -1) + 0.5
    end = start + forward[rows, columns]
    returned = length(end + sample(backward, end) - start) < MAX_RETURN_PX
    chosen = returned & inside(end, clip.height, clip.width)
    points = camera.unproject(start, drawn["depth"][rows, columns].astype(np.float64))
    return Sightings(points[chosen], end[chosen])


def _smooth(depth: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: depth is known here and at all neighbours, and takes no step."""
    import cv2

    filled, window = np.nan_to_num(depth), np.ones((3, 3), np.uint8)
    lowest = cv2.erode(filled, window)
    return (lowest > 0) & (cv2.dilate(filled, window) <= MAX_DEPTH_STEP * lowest)


def _near_motion(dynamic: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: a pixel with dynamic alpha is near."""
    import cv2

    margin = 1 + 2 * max(2, round(MOVING_MARGIN * dynamic.shape[1]))
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (margin, margin))
    return cv2.dilate((dynamic >= MOVING_ALPHA).astype(np.uint8), window) > 0


def _spread(pixels: np.ndarray, width: int, height: int) -> bool:
    """Return True if points are many and spread over the picture, so that they hold a whole camera."""
    tiles = np.clip(TILES * pixels / [width, height], 0, TILES - 1).astype(int)
    counts = np.bincount(TILES * tiles[:, 1] + tiles[:, 0], minlength=TILES * TILES)
    return len(pixels) >= MIN_POINTS and int((counts >= MIN_TILE_POINTS).sum()) >= MIN_TILES


def _median_error(camera: Camera, points: np.ndarray, pixels: np.ndarray) -> float:
    return float(np.median(length(camera.project(points)[0] - pixels))) if len(points) else float("nan")
