"""A made-up clip with exact truth: a textured square that moves in front of a textured wall, seen by a moving camera."""

import numpy as np

from f4x_core.clip import Clip
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors

WIDTH, HEIGHT, FRAMES = 64, 40, 8
FOCAL = 60.0
WALL, SQUARE = 1.2, 0.9  # depths
HALF = 0.14  # half side of the square, world units
SHIFT = 0.03  # world units that the square moves per frame


def texture(x: np.ndarray, y: np.ndarray, phase: float) -> np.ndarray:
    """Smooth colours (..., 3) in [0,1] over a plane."""
    waves = [np.sin(17 * x + phase) * np.cos(13 * y), np.sin(11 * y + 2 * phase), np.cos(19 * x - 7 * y + phase)]
    return 0.5 + 0.4 * np.stack(waves, -1)


def cameras(frames: int) -> CameraPath:
    """Cameras that slide to the right, looking along +z."""
    intrinsics = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    matrices[:, 0, 3] = -0.02 * np.arange(frames)
    return CameraPath(np.tile(intrinsics, (frames, 1, 1)), matrices, np.arange(frames, dtype=float), WIDTH, HEIGHT)


def centre(time: float) -> np.ndarray:
    """World position (2,) of the square's centre."""
    return np.array([-0.1 + SHIFT * time, 0.02 * time])


def clip_and_priors(frames: int = FRAMES, moving: bool = True, hold_out: int = 0) -> tuple[Clip, Priors]:
    """The clip and its true priors."""
    path = cameras(frames)
    rgb = np.zeros((frames, HEIGHT, WIDTH, 3), np.uint8)
    depth = np.full((frames, HEIGHT, WIDTH), WALL, np.float32)
    mask = np.zeros((frames, HEIGHT, WIDTH), bool)
    for t in range(frames):
        grid = path[t].pixel_grid()
        wall = path[t].unproject(grid, np.full(grid.shape[:2], WALL))
        front = path[t].unproject(grid, np.full(grid.shape[:2], SQUARE))
        colour = texture(wall[..., 0], wall[..., 1], 0.0)
        if moving:
            local = front[..., :2] - centre(t)
            mask[t] = (np.abs(local) < HALF).all(-1)
            colour = np.where(mask[t][..., None], texture(local[..., 0], local[..., 1], 2.0), colour)
            depth[t][mask[t]] = SQUARE
        rgb[t] = (255 * colour).round().astype(np.uint8)
    held_out = np.zeros(frames, bool)
    if hold_out:
        held_out = np.arange(frames) % hold_out == hold_out - 1
    clip = Clip("toy", rgb, np.arange(frames, dtype=float), 24.0, held_out, "toy")
    used = clip.supervised
    priors = Priors.empty(clip)
    priors.camera_kind, priors.cameras = "moving", path.at_times(used.astype(float))
    priors.depth, priors.depth_confidence = depth[used], np.ones((len(used), HEIGHT, WIDTH), np.float16)
    priors.mask, priors.motion = mask[used], mask[used].astype(np.float16)
    priors.tracks, priors.tracks_visible, priors.tracks_motion = tracks(path, used, moving)
    flow = np.zeros((len(used) - 1, HEIGHT, WIDTH, 2), np.float16)
    priors.flow_forward, priors.flow_backward = flow, flow.copy()
    priors.flow_forward_mask = priors.flow_backward_mask = np.ones(flow.shape[:3], bool)
    return clip, priors


def tracks(path: CameraPath, used: np.ndarray, moving: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact tracks: a grid on the wall and, when it moves, a grid on the square."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.6, 14), np.linspace(-0.35, 0.35, 9))
    wall = np.stack([x.ravel(), y.ravel(), np.full(x.size, WALL)], -1)
    u, v = np.meshgrid(np.linspace(-0.9, 0.9, 7) * HALF, np.linspace(-0.9, 0.9, 7) * HALF)
    pixels, seen = [], []
    for t in used:
        on_wall, _ = path[t].project(wall)
        local = path[t].unproject(on_wall, np.full(len(on_wall), SQUARE))[:, :2] - centre(t)
        hidden = (np.abs(local) < HALF).all(-1) if moving else np.zeros(len(wall), bool)
        square = np.stack([u.ravel() + centre(t)[0], v.ravel() + centre(t)[1], np.full(u.size, SQUARE)], -1)
        on_square = path[t].project(square)[0] if moving else np.zeros((0, 2))
        both = np.concatenate([on_wall, on_square])
        inside = ((both >= 0) & (both < [WIDTH, HEIGHT])).all(-1)
        inside[: len(wall)] &= ~hidden
        pixels.append(both)
        seen.append(inside)
    motion = np.concatenate([np.zeros(len(wall)), np.ones(u.size if moving else 0)]).astype(np.float32)
    return np.stack(pixels).astype(np.float32), np.stack(seen), motion
