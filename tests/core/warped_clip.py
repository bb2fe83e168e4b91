"""Made-up clips by warping flat textures: the true flow, mask and tracks are known, no renderer is involved."""

import cv2
import numpy as np

from f4x_core.clip import Clip

HEIGHT, WIDTH = 120, 176
SIDE = 36  # of the moving square, pixels


def texture(height: int, width: int, seed: int) -> np.ndarray:
    """(h,w,3) uint8 noise with detail from 3 to 20 pixels."""
    noise = np.random.default_rng(seed).normal(size=(height, width, 3)).astype(np.float32)
    layers = [cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (1.5, 4, 10)]
    total = sum(layers)
    return np.clip(127 + 55 * total / total.std(), 0, 255).astype(np.uint8)


def shifted(picture: np.ndarray, x: float, y: float) -> np.ndarray:
    """(H,W,3) view of a larger picture whose pixel (x, y) is in its corner."""
    return cv2.warpAffine(picture, np.float32([[1, 0, -x], [0, 1, -y]]), (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)


def square_corner(t: float, speed: tuple[float, float]) -> np.ndarray:
    """(2,) picture position of the square's upper left corner."""
    return np.array([50.0, 40.0]) + t * np.array(speed)


def warped_clip(
    frames: int = 12,
    pan: tuple[float, float] = (1.5, 0.4),
    speed: tuple[float, float] | None = (2.5, 0.7),
    post: float | None = None,
    hold_out: tuple[int, ...] = (),
) -> tuple[Clip, np.ndarray]:
    """A wall seen by a camera that pans by `pan` px per frame, a square that moves by `speed` in the picture (None: no
    square), and, at column `post`, a standing post 14 px wide in front of it. Returns the clip and the mask (T,H,W)."""
    wall, card, wood = texture(3 * HEIGHT, 3 * WIDTH, 0), texture(SIDE, SIDE, 1), texture(HEIGHT, 14, 2)
    pictures, mask = np.empty((frames, HEIGHT, WIDTH, 3), np.uint8), np.zeros((frames, HEIGHT, WIDTH), bool)
    for t in range(frames):
        pictures[t] = shifted(wall, WIDTH + pan[0] * t, HEIGHT + pan[1] * t)
        if speed is not None:
            x, y = square_corner(t, speed)
            move = np.float32([[1, 0, x], [0, 1, y]])
            card_here = cv2.warpAffine(card, move, (WIDTH, HEIGHT))
            mask[t] = cv2.warpAffine(np.full((SIDE, SIDE), 255, np.uint8), move, (WIDTH, HEIGHT)) > 127
            pictures[t][mask[t]] = card_here[mask[t]]
        if post is not None:
            column = int(post)
            pictures[t][:, column : column + 14], mask[t][:, column : column + 14] = wood, False
    held_out = np.isin(np.arange(frames), hold_out)
    return Clip("warped", pictures, np.arange(frames, dtype=float), 24.0, held_out, "warped"), mask


def fast_ball_clip(look: str | None, frames: int = 9) -> tuple[Clip, np.ndarray]:
    """A textured wall, 320 pixels wide, seen by a camera that pans by 3 px per frame, and a ball of 28 px that flies by 14 px per
    frame against it, `textured` or `plain` (None: no ball). Returns the clip and the mask (T,H,W) of the ball."""
    width, height, side = 320, 160, 28
    wall, card = texture(height, 2 * width, 0), texture(side, side, 1)
    disc = np.hypot(*(np.mgrid[:side, :side] - (side - 1) / 2)) <= side / 2
    if look == "plain":
        card[:] = (210, 60, 40)
    pictures, mask = np.empty((frames, height, width, 3), np.uint8), np.zeros((frames, height, width), bool)
    for t in range(frames):
        pictures[t] = wall[:, 3 * t : 3 * t + width]
        if look is not None:
            place = np.s_[60 : 60 + side, 40 + 14 * t : 40 + 14 * t + side]
            pictures[t][place][disc], mask[t][place] = card[disc], disc
    return Clip("ball", pictures, np.arange(frames, dtype=float), 24.0, np.zeros(frames, bool), "ball"), mask


def walk_past_a_wall(frames: int = 20) -> tuple[Clip, np.ndarray, np.ndarray]:
    """A camera that walks past a near, low wall and turns; something flat walks ahead of it. Returns the clip, 240x144, and the
    masks (T,H,W) of what walks and of the wall."""
    height, width = 144, 240
    looks = [texture(512, 512, seed).astype(np.float32) for seed in range(4)]
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([columns - width / 2, rows - height / 2, np.full(columns.shape, 0.9 * width)], -1) / (0.9 * width)
    pictures, label = np.zeros((frames, height, width, 3), np.uint8), np.zeros((frames, height, width), int)
    for t in range(frames):
        angle, away = 0.012 * t - 0.1 + 0.004 * np.sin(1.3 * t), 0.1 * t - 1.6
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        centre, nearest = (
            np.array([0.02 * np.sin(0.9 * t), 0.02 * np.sin(1.7 * t), 0.1 * t]),
            np.full(columns.shape, 1e9),
        )
        lowest, highest = (np.array([0.5, 0.7, -9]), np.array([1.4, 1.5, 9]))  # of the wall
        everywhere = np.full(3, -1e9), np.full(3, 1e9)
        planes = [  # axis and place, bounds, axes of its look and their scale and start, look, label
            (2, 16.0, everywhere, (0, 1), 24, 0.0, 0, 0),
            (1, 1.5, everywhere, (0, 2), 40, 0.0, 1, 0),
            (1, 0.7, (lowest, highest), (0, 2), 120, 0.0, 2, 1),
            (0, 0.5, (lowest, highest), (2, 1), 120, 0.0, 2, 1),
            (2, 7.0, (np.array([away - 0.45, -0.4, -9]), np.array([away + 0.45, 1.5, 9])), (0, 1), 90, away, 3, 2),
        ]
        for axis, place, (low, high), across, scale, start, look, name in planes:
            with np.errstate(divide="ignore", invalid="ignore"):
                distance = (place - centre[axis]) / (rays @ turn.T)[..., axis]
            hit = centre + np.nan_to_num(distance, posinf=1e6, neginf=-1e6)[..., None] * (rays @ turn.T)
            inside = ((hit >= low - 1e-6) & (hit <= high + 1e-6)).all(-1) & (distance > 0.05) & (distance < nearest)
            u, v = (np.mod((hit[..., one] - start * (one == 0)) * scale, 511).astype(np.float32) for one in across)
            pictures[t][inside] = cv2.remap(looks[look], u, v, cv2.INTER_LINEAR)[inside]
            nearest[inside], label[t][inside] = distance[inside], name
    clip = Clip("walk", pictures, np.arange(frames, dtype=float), 24.0, np.zeros(frames, bool), "walk")
    return clip, label == 2, label == 1
