"""The outline of moving objects, against the background behind it.

Motion tells outlines to within several pixels: flow bleeds over them, shadows move along, and thin legs are lost. Once the
cameras and the depth of the background are known, other frames show what is behind each pixel. What looks like it, up to
a shadow, is not part of the mover; what is close beside the mask and looks otherwise is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..geometry.arrays import evenly_spaced
from ..geometry.camera import Camera, CameraPath
from ..parallel import in_threads
from .flow import look_up
from .moving_people import dilate_masks

LINE, UNSEEN = 1024, 999
"""Pixels are looked up in lines of so many, as OpenCV allows no longer ones than 32,767; level of what is not seen."""
BLUR = 0.7
"""Gaussian (pixels) over which pictures are compared."""
BESIDE = (20, 25)
"""Pixels to the sides and up or down of the mask in which parts of moving objects are looked for."""
COVERED, BETWEEN = 3, 20
"""Pixels around the mask that do not show the background; dents and gaps up to twice as many wide as the second do not either: of a
plain back the mask may show the rim alone."""
VIEWS, MIN_GAP, MAX_GAP = 9, 4, 32
"""Frames that show what is behind, and their least and largest distance: a foot stands still for a few frames."""
ROUNDS, SETTLED = 3, 0.5
"""Steps towards the place in another frame at which its depth agrees, and pixels that the last one may go."""
WINDOW = 5
"""Side in pixels of the window in which background and picture are compared."""
SHADOW = (0.3, 1.15)
"""Factors by which light may change the background."""
PLAIN = (0.9, 1.1)
"""The same where no texture tells: with the light of shadows, the humps of a camel are its fence."""
ALIKE, ALIKE_LEVELS, QUIET = 3.0, 2.5, 2.5
"""Pixels that differ by fewer times the noise, plus so many grey levels, look like the background; noise counts up to `QUIET`.
From twice as much on, as on grass, only texture tells (`CORRELATED`)."""
CORRELATED, TEXTURE = 0.85, 2.0
"""Correlation from which the texture of the background shows, where it has so many times the noise."""
TINTED = 7
"""Side of the window in which pixels that are background times a factor belong to the shadow in it."""
OTHER, OTHER_LEVELS = 4.0, 6.0
"""Pixels that differ by more times the noise, plus so many grey levels, from all that is within a pixel are no background."""
MIN_PIXELS = 30
"""Pieces of a mover with fewer pixels are noise."""
ENDING = 0.8
"""Fraction of the rim of a part that the mask lacks, beside the mask, that must show the background."""
LARGE_PART, LARGE_SHADOWY, SMALL_SHADOWY = 0.1, 0.5, 0.2
"""Such a part is large from this fraction of the mask on; fractions of its pixels that may be the background's times a factor,
where it is large, and where it is small and more likely a shadow."""
SHADED = 0.5
"""Correlation of a part with the background behind it from which it is that background in a shadow."""
MIN_LEFT = 0.4
"""Fraction of a frame's mask that must be left; else the mover itself was taken for the background, and the mask stays."""


@dataclass(frozen=True)
class Background:
    """The static background of one frame, as other frames show it; 0 where it is not `known`."""

    colors: np.ndarray
    """(H, W, 3) float32, the median of the other frames."""
    spread: np.ndarray
    """(H, W) float32, half of what their middle half spans, grey levels."""
    known: np.ndarray
    """(H, W) bool."""


def refine_mask(
    frames: np.ndarray, inverse: np.ndarray, mask: np.ndarray, people: np.ndarray | None, cameras: CameraPath
) -> np.ndarray:
    """Return (F, H, W) bool: the moving `mask (F, H, W)` without shadows and halos, with thin parts beside it.

    frames: (F, H, W, 3) uint8; inverse: (F, H, W) float32 inverse depth of the background; people: (F, H, W) bool, if known, pixels
    that show somebody, who stay in the mask where they do not look like the background. Constants were chosen on
    people-walk, -turn and -cross, fox, orbit, demo, crossing, dog and camel (mean J .807 -> .842); on eleven other rendered clips
    it rises from .801 to .857, on seven other real ones from .764 to .777. Those of parts that masks lack (`_missing_parts`) were
    chosen on walk, fox, demo, dog, camel, parkour and people-walk, -turn and -cross (.834 -> .846); on ten other rendered clips and
    dance-twirl J rises from .891 to .893.
    """
    import cv2

    solid = np.stack(in_threads(ndimage.binary_fill_holes, mask))
    covered = _hiding(solid)
    soft = np.stack(in_threads(lambda picture: cv2.GaussianBlur(picture, (0, 0), BLUR), frames))
    sides = np.ones((2 * BESIDE[1] + 1, 2 * BESIDE[0] + 1), np.uint8)

    def draw(frame: int) -> Background:
        asked = cv2.dilate(solid[frame].astype(np.uint8), sides) > 0
        return draw_background(soft, inverse, covered, cameras, frame, asked)

    drawn = in_threads(draw, range(len(mask)))
    off = [
        abs(soft[frame].astype(np.float32) - one.colors).mean(-1)[one.known & ~covered[frame]]
        for frame, one in enumerate(drawn)
    ]
    every = np.concatenate(off) if off else np.zeros(0)
    if not len(every):
        return mask
    noise = 1.48 * float(np.median(every))

    def refine(frame: int) -> tuple[np.ndarray, bool]:
        shown = None if people is None else people[frame]
        return _refined(soft[frame].astype(np.float32), mask[frame], shown, drawn[frame], noise)

    refined = in_threads(refine, range(len(mask)))
    found = np.stack([one for one, _ in refined])
    # Parts that masks lack are on the background of other frames, too: it is drawn again without them.
    lacking = [frame for frame, (_, lacks) in enumerate(refined) if lacks]
    covered = _hiding(np.stack(in_threads(ndimage.binary_fill_holes, mask | found)))
    for frame, behind in zip(lacking, in_threads(draw, lacking), strict=True):
        drawn[frame] = behind
    for frame, (one, _) in zip(lacking, in_threads(refine, lacking), strict=True):
        found[frame] = one
    return found


def _hiding(solid: np.ndarray) -> np.ndarray:
    """Return (F, H, W) bool: pixels that do not show the background, of `solid (F, H, W)` masks."""
    import cv2

    wide = np.ones((2 * BETWEEN + 1, 2 * BETWEEN + 1), np.uint8)
    closed = [cv2.morphologyEx(one.astype(np.uint8), cv2.MORPH_CLOSE, wide) for one in solid]
    return dilate_masks(np.stack(closed), COVERED)


def draw_background(
    pictures: np.ndarray, inverse: np.ndarray, covered: np.ndarray, cameras: CameraPath, frame: int, asked: np.ndarray
) -> Background:
    """Return the background at the pixels `asked (H, W)` of a frame, from other frames of `pictures (F, H, W, 3)` uint8.

    inverse: (F, H, W) inverse depth of the background; covered: (F, H, W) bool, where it is not seen. Depth behind a mover is
    filled in, so the place in another frame is looked for along the ray until the depth there agrees.
    """
    first, last = max(0, frame - MAX_GAP), min(len(inverse) - 1, frame + MAX_GAP)
    others = [other for other in range(first, last + 1) if abs(other - frame) >= MIN_GAP]
    y, x = np.nonzero(asked)
    drawn = Background(np.zeros((*asked.shape, 3), np.float32), np.zeros(asked.shape, np.float32), np.zeros_like(asked))
    if not (len(x) and others):
        return drawn
    lines = np.arange(-(-len(x) // LINE) * LINE).reshape(-1, LINE) % len(x)
    pixels, start = np.stack([x, y]).astype(np.float32)[:, lines] + np.float32(0.5), inverse[frame][y, x][lines]
    found = np.full((min(VIEWS, len(others)), len(x), 3), UNSEEN, np.int16)
    for row, other in zip(found, (others[i] for i in evenly_spaced(len(others), VIEWS)), strict=True):
        place, seen = _along_rays(cameras[frame], cameras[other], pixels, start, inverse[other])
        seen &= _at(covered[other].astype(np.uint8) * np.uint8(255), place) == 0
        rows = np.flatnonzero(seen.ravel()[: len(x)])
        row[rows] = _at(pictures[other], place).reshape(-1, 3)[rows]
    found.sort(axis=0)
    count = (found[..., 0] < UNSEEN).sum(0)
    some = np.flatnonzero(count)
    count, asked_at = count[some], (y[some], x[some])
    low, middle, high = (found[part * (count - 1) // 4, some].astype(np.float32) for part in (1, 2, 3))
    drawn.colors[asked_at], drawn.known[asked_at] = middle, True
    drawn.spread[asked_at] = (high - low).mean(-1) / 2
    return drawn


def _along_rays(
    here: Camera, there: Camera, pixels: np.ndarray, rho: np.ndarray, inverse: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels `(2, ...)` of the camera `there` for the background at `pixels (2, ...)` of `here`, and True where it sees it.

    rho: (...) first guess of the inverse depth from `here`; inverse: (H, W) inverse depth from `there`. All float32.
    """
    relative = there.world_to_camera @ here.camera_to_world
    turn = (there.intrinsics @ relative[:3, :3] @ np.linalg.inv(here.intrinsics)).astype(np.float32)
    shift = (there.intrinsics @ relative[:3, 3]).astype(np.float32)
    ahead = turn[:, 0, *[None] * rho.ndim] * pixels[0] + turn[:, 1, *[None] * rho.ndim] * pixels[1]
    ahead += turn[:, 2, *[None] * rho.ndim]
    place = pixels
    for _ in range(ROUNDS):
        before = place
        front = np.maximum(ahead[2] + rho * shift[2], np.float32(1e-6))
        place = np.stack([ahead[axis] + rho * shift[axis] for axis in (0, 1)]) / front
        np.clip(place, -LINE, LINE * 8, out=place)
        rho = _at(inverse, place) * front
    height, width = inverse.shape
    seen = (front > 1e-6) & (np.hypot(*(place - before)) < SETTLED)
    return place, seen & (place > 0.5).all(0) & (place[0] < width - 0.5) & (place[1] < height - 0.5)


def _at(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return (h, w[, C]) values of `image (H, W[, C])` at `place (2, h, w)` in pixels, of its dtype."""
    return look_up(image, np.moveaxis(place, 0, -1))


def _refined(
    picture: np.ndarray, mask: np.ndarray, people: np.ndarray | None, behind: Background, noise: float
) -> tuple[np.ndarray, bool]:
    """Return one frame `(H, W)` bool of `refine_mask`, with `picture (H, W, 3)` float32, and if the mask lacked a large part."""
    import cv2

    level = noise + np.minimum(behind.spread, 3 * noise)
    same, tinted = _like_background(picture, behind, noise, np.minimum(level, QUIET))
    square = np.ones((3, 3), np.uint8)
    beyond = np.maximum(picture - cv2.dilate(behind.colors, square), cv2.erode(behind.colors, square) - picture)
    other = behind.known & (np.maximum(beyond, 0).mean(-1) > OTHER * level + OTHER_LEVELS) & ~same & ~tinted
    kept, other = mask & ~same, _opened(other, 3) > 0
    parts = _missing_parts(picture, behind, kept, same, tinted)
    other |= parts
    labels, count = ndimage.label(kept | other, square)
    size, held = (np.bincount(labels[part], minlength=count + 1) for part in (labels > 0, kept))
    pieces = ((held > 0) & (size >= MIN_PIXELS))[labels]
    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    found = cv2.morphologyEx(pieces.astype(np.uint8), cv2.MORPH_CLOSE, ellipse) > 0
    found |= ndimage.binary_fill_holes(found) & mask
    if people is not None:
        found |= people & mask & ~same
    return (found if (found & mask).sum() >= MIN_LEFT * mask.sum() else mask), bool(
        parts.sum() >= LARGE_PART * mask.sum() > 0
    )


def _missing_parts(
    picture: np.ndarray, behind: Background, kept: np.ndarray, same: np.ndarray, tinted: np.ndarray
) -> np.ndarray:
    """Return (H, W) bool: parts of a mover that its mask lacks as a whole: regions of `picture (H, W, 3)` that do not look like the
    background, touch what is `kept (H, W)` of the mask and end where the background shows, `same (H, W)`.

    A ball that rolls moves as the background behind it on one side; no pixel of it need differ from all that is near.
    """
    import cv2

    square = np.ones((3, 3), np.uint8)
    labels, count = ndimage.label(_opened(behind.known & ~same & ~kept, 3), square)
    rim = np.where(labels > 0, 0, cv2.dilate(labels.astype(np.float32), square)).astype(int)

    def added(values: np.ndarray, of: np.ndarray = labels) -> np.ndarray:
        """Return the sum of `values (H, W)` over every part, or over its rim."""
        return np.bincount(of.ravel(), values.ravel(), count + 1)

    size = np.maximum(added(np.ones(labels.shape)), 1)
    own, drawn = picture.mean(-1), behind.colors.mean(-1)
    means = added(own) / size, added(drawn) / size
    own, drawn = own - means[0][labels], drawn - means[1][labels]
    alike = added(own * drawn) / np.sqrt(np.maximum(added(own**2) * added(drawn**2), 1))
    shadow = (added(tinted) > np.where(size >= LARGE_PART * kept.sum(), LARGE_SHADOWY, SMALL_SHADOWY) * size) | (
        alike > SHADED
    )
    ends = added(same & ~kept, rim) >= ENDING * added(~kept, rim)
    found = ends & ~shadow & (added(kept, rim) > 0) & (size >= MIN_PIXELS) & (size <= kept.sum())
    found[0] = False
    return found[labels] & ~(tinted & (cv2.dilate((same & ~kept).astype(np.uint8), square) > 0))


def _like_background(
    picture: np.ndarray, behind: Background, noise: float, level: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W) bool where `picture (H, W, 3)` looks like the background, in full light or in shadow; and scaled by a factor.

    The second mask holds pixels that are the background's times any factor. `level (H, W)`: expected difference, gray levels.
    """
    import cv2

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.blur(values, (WINDOW, WINDOW))

    def explained(sums: list[np.ndarray], light: tuple[float, float]) -> np.ndarray:
        """Return True where a factor within `light` explains the colors, from sums of products: both, picture's, background's."""
        both, own, drawn = sums
        factor = both / np.maximum(drawn, 1)
        left = np.sqrt(np.maximum(own - factor * both, 0) / 3)
        return (left < ALIKE * level + ALIKE_LEVELS) & (factor > light[0]) & (factor < light[1])

    pairs = ((picture, behind.colors), (picture, picture), (behind.colors, behind.colors))
    products = [np.einsum("hwc,hwc->hw", *pair) for pair in pairs]
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
    """Return (H, W) uint8: the `region (H, W)` bool without what is narrower than `side` pixels."""
    import cv2

    return cv2.morphologyEx(region.astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
