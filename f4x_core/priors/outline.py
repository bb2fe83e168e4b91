"""The outline of what moves, against what stands behind it.

Motion tells outlines to within several pixels: flow bleeds over them, shadows move along, and thin legs are lost. Once the
cameras and the depth of what stands are known, other frames show what is behind each pixel. What looks like it, up to
a shadow, is not part of the mover; what is close beside the mask and looks otherwise is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..geometry.arrays import evenly_spaced
from ..geometry.camera import CameraPath
from ..parallel import in_threads
from .flow import look_up
from .moving_people import dilate_masks

BLUR = 0.7
"""Gaussian (pixels) over which pictures are compared."""
BESIDE = (20, 25)
"""Pixels to the sides and up or down of the mask in which parts of what moves are looked for."""
COVERED = 3
"""Pixels around the mask that do not show what stands."""
VIEWS, LEAST_GAP, LARGEST_GAP = 9, 4, 32
"""Frames that show what is behind, and their least and largest distance: a foot stands still for a few frames."""
ROUNDS, SETTLED = 3, 0.5
"""Steps towards the place in another frame at which its depth agrees, and pixels that the last one may go."""
WINDOW = 5
"""Side in pixels of the window in which background and picture are compared."""
SHADOW = (0.3, 1.15)
"""Factors by which light may change what stands."""
PLAIN = (0.9, 1.1)
"""The same where no texture tells: with the light of shadows, the humps of a camel are its fence."""
ALIKE, ALIKE_LEVELS, QUIET = 3.0, 2.5, 2.5
"""What differs by fewer times the noise, plus so many grey levels, looks like what stands; noise counts up to `QUIET` levels.
From twice as much on, as on grass, only texture tells (`CORRELATED`)."""
CORRELATED, TEXTURE = 0.85, 2.0
"""Correlation from which the texture of what stands shows, where it has so many times the noise."""
TINTED = 7
"""Side of the window in which pixels that are background times a factor belong to the shadow in it."""
OTHER, OTHER_LEVELS = 4.0, 6.0
"""What differs by more times the noise, plus so many grey levels, from all that is within a pixel is no background."""
MIN_PIXELS = 30
"""Pieces of a mover with fewer pixels are noise."""
MIN_LEFT = 0.4
"""With less of a frame's mask left, what was taken for the background is the mover itself, and the mask stays."""


@dataclass(frozen=True)
class Background:
    """What stands behind one frame, as other frames show it; 0 where it is not `known`."""

    colors: np.ndarray
    """(H, W, 3) float32, the median of the other frames."""
    spread: np.ndarray
    """(H, W) float32, half of what their middle half spans, grey levels."""
    known: np.ndarray
    """(H, W) bool."""


def refine_mask(
    frames: np.ndarray, inverse: np.ndarray, mask: np.ndarray, people: np.ndarray | None, cameras: CameraPath
) -> np.ndarray:
    """(F, H, W) bool: the moving `mask (F, H, W)` without shadows and halos, with thin parts beside it.

    frames: (F, H, W, 3) uint8; inverse: (F, H, W) float32 inverse depth of what stands; people: (F, H, W) bool, if known, pixels
    that show somebody, who stay in the mask where they do not look like the background. Constants were chosen on
    people-walk, -turn and -cross, fox, orbit, demo, crossing, dog and camel (mean J .807 -> .842); on eleven other rendered clips
    it rises from .801 to .857, on seven other real ones from .764 to .777.
    """
    import cv2

    solid = np.stack(in_threads(ndimage.binary_fill_holes, mask))
    covered = dilate_masks(solid, COVERED)
    soft = np.stack(in_threads(lambda picture: cv2.GaussianBlur(picture, (0, 0), BLUR), frames))
    sides = np.ones((2 * BESIDE[1] + 1, 2 * BESIDE[0] + 1), np.uint8)

    def draw(frame: int) -> Background:
        return draw_background(
            soft, inverse, covered, cameras, frame, cv2.dilate(solid[frame].astype(np.uint8), sides) > 0
        )

    drawn = in_threads(draw, range(len(mask)))
    off = [
        abs(soft[frame].astype(np.float32) - one.colors).mean(-1)[one.known & ~covered[frame]]
        for frame, one in enumerate(drawn)
    ]
    every = np.concatenate(off) if off else np.zeros(0)
    if not len(every):
        return mask
    noise = 1.48 * float(np.median(every))

    def refine(frame: int) -> np.ndarray:
        shown = None if people is None else people[frame]
        return _refined(soft[frame].astype(np.float32), mask[frame], shown, drawn[frame], noise)

    return np.stack(in_threads(refine, range(len(mask))))


def draw_background(
    pictures: np.ndarray, inverse: np.ndarray, covered: np.ndarray, cameras: CameraPath, frame: int, asked: np.ndarray
) -> Background:
    """What stands behind the pixels `asked (H, W)` of a frame, from other frames of `pictures (F, H, W, 3)` uint8.

    inverse: (F, H, W) inverse depth of what stands; covered: (F, H, W) bool, where it is not seen. Depth behind a mover is
    filled in, so the place in another frame is looked for along the ray until the depth there agrees.
    """
    first, last = max(0, frame - LARGEST_GAP), min(len(inverse) - 1, frame + LARGEST_GAP)
    others = [other for other in range(first, last + 1) if abs(other - frame) >= LEAST_GAP]
    y, x = np.nonzero(asked)
    drawn = Background(np.zeros((*asked.shape, 3), np.float32), np.zeros(asked.shape, np.float32), np.zeros_like(asked))
    if not (len(x) and others):
        return drawn
    here, pixels = cameras[frame], np.stack([x, y], 1) + 0.5
    rays = np.ones((len(x), 3))
    rays[:, :2] = (pixels - here.intrinsics[:2, 2]) / here.intrinsics[[0, 1], [0, 1]]
    start, found = inverse[frame][y, x].astype(np.float64), []
    for other in (others[i] for i in evenly_spaced(len(others), VIEWS)):
        there = cameras[other]
        relative = there.world_to_camera @ here.camera_to_world
        ahead, shift, rho, place = rays @ relative[:3, :3].T, relative[:3, 3], start, pixels
        for _ in range(ROUNDS):
            before, point = place, ahead + rho[:, None] * shift
            front = np.maximum(point[:, 2], 1e-6)
            place = point[:, :2] / front[:, None] * there.intrinsics[[0, 1], [0, 1]] + there.intrinsics[:2, 2]
            rho = _at(inverse[other], place) * front
        settled = (point[:, 2] > 0) & (np.linalg.norm(place - before, axis=1) < SETTLED)
        size = np.array(asked.shape[::-1])
        settled &= ((place > 0.5) & (place < size - 0.5)).all(1) & (_at(covered[other].astype(np.float32), place) == 0)
        found.append(np.where(settled[:, None], _at(pictures[other], place), np.nan).astype(np.float32))
    seen = np.sort(np.stack(found), axis=0)  # NaN, not seen, comes last
    count = np.isfinite(seen[..., 0]).sum(0)
    some = np.flatnonzero(count)
    seen, count, asked_at = seen[:, some], count[some], (y[some], x[some])
    low, middle, high = (seen[part * (count - 1) // 4, np.arange(len(some))] for part in (1, 2, 3))
    drawn.colors[asked_at], drawn.known[asked_at] = middle, True
    drawn.spread[asked_at] = (high - low).mean(-1) / 2
    return drawn


def _at(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(n[, C]) values of `image (H, W[, C])` at `places (n, 2)` in pixels."""
    width = 1024  # OpenCV allows no longer lines than 32,767
    count = len(places)
    lines = np.zeros((-(-count // width) * width, 2))
    lines[:count] = np.clip(places, -width, 2 * max(image.shape))
    found = look_up(image, lines.reshape(-1, width, 2))
    return found.reshape(len(lines), *image.shape[2:])[:count]


def _refined(
    picture: np.ndarray, mask: np.ndarray, people: np.ndarray | None, behind: Background, noise: float
) -> np.ndarray:
    """(H, W) bool: one frame of `refine_mask`, with `picture (H, W, 3)` float32."""
    import cv2

    level = noise + np.minimum(behind.spread, 3 * noise)
    same, tinted = _like_background(picture, behind, noise, np.minimum(level, QUIET))
    square = np.ones((3, 3), np.uint8)
    beyond = np.maximum(picture - cv2.dilate(behind.colors, square), cv2.erode(behind.colors, square) - picture)
    other = behind.known & (np.maximum(beyond, 0).mean(-1) > OTHER * level + OTHER_LEVELS) & ~same & ~tinted
    kept, other = mask & ~same, cv2.erode(_opened(other, 2), square) > 0
    labels, count = ndimage.label(kept | other, square)
    size, held = (np.bincount(labels[part], minlength=count + 1) for part in (labels > 0, kept))
    pieces = ((held > 0) & (size >= MIN_PIXELS))[labels]
    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    found = cv2.morphologyEx(pieces.astype(np.uint8), cv2.MORPH_CLOSE, ellipse) > 0
    found |= ndimage.binary_fill_holes(found) & mask
    if people is not None:
        found |= people & mask & ~same
    return found if (found & mask).sum() >= MIN_LEFT * mask.sum() else mask


def _like_background(
    picture: np.ndarray, behind: Background, noise: float, level: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool, twice: where `picture (H, W, 3)` looks like the background in full light or in shadow, and the pixels that
    are the background's times a factor. level: (H, W) expected difference, grey levels."""
    import cv2

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.blur(values, (WINDOW, WINDOW))

    def explained(sums: list[np.ndarray], light: tuple[float, float]) -> np.ndarray:
        """Whether a factor within `light` explains the colors, from sums of products: of both, the picture's, the background's."""
        both, own, drawn = sums
        factor = both / np.maximum(drawn, 1)
        left = np.sqrt(np.maximum(own - factor * both, 0) / 3)
        return (left < ALIKE * level + ALIKE_LEVELS) & (factor > light[0]) & (factor < light[1])

    products = [
        (a * b).sum(-1) for a, b in ((picture, behind.colors), (picture, picture), (behind.colors, behind.colors))
    ]
    tinted = explained(products, SHADOW)
    smooth = [mean(product) for product in products]
    same = explained(smooth, PLAIN) & (noise < 2 * QUIET)
    own, drawn = picture.mean(-1), behind.colors.mean(-1)
    cover = mean(own * drawn) - mean(own) * mean(drawn)
    vary, texture = mean(own**2) - mean(own) ** 2, mean(drawn**2) - mean(drawn) ** 2
    factor = smooth[0] / np.maximum(smooth[2], 1)
    shows = (cover > CORRELATED * np.sqrt(np.maximum(vary * texture, 1))) & (texture > (TEXTURE * noise) ** 2)
    same |= shows & (factor > SHADOW[0]) & (factor < SHADOW[1])
    same = (cv2.medianBlur((same & behind.known).astype(np.uint8), WINDOW) > 0) & behind.known
    near = cv2.dilate(same.astype(np.uint8), np.ones((TINTED, TINTED), np.uint8)) > 0
    same |= tinted & behind.known & near
    return _opened(same, 3) > 0, tinted


def _opened(region: np.ndarray, side: int) -> np.ndarray:
    """(H, W) uint8: the `region (H, W)` bool without what is narrower than `side` pixels."""
    import cv2

    return cv2.morphologyEx(region.astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
