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
