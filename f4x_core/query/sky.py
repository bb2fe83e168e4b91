"""The blue sky above a scene, found by color and place in the clip's pictures. Needs numpy alone."""

from __future__ import annotations

import re

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import evenly_spaced
from ..scene import Scene
from ..scene.view import render
from .ground import up_of
from .labels import no_teacher_knows
from .marks import Point
from .objects import MOSTLY
from .segmentation import connected_regions, sums_around
from .superpixels import static_part

SKY = "sky"
"""The word for it."""
SKY_WORDS = re.compile(r"(?:the )?(?:(?:blue )?sky|heavens?)", re.IGNORECASE)
"""Names of the sky."""
COLUMNS = 64
"""Width in pixels of the pictures in which it is looked for."""
FRAMES = 5
"""Frames, evenly over the clip, in which it is looked for."""
BLUER, BRIGHT = 0.1, 0.6
"""Least blue less red, and least blue, of sRGB in [0, 1]: a grey wall in the shade is up to .1 bluer than red."""
STILL = 0.3
"""Fraction of a pixel up to which moving Gaussians may cover it."""
WINDOW = 9
"""Pixels of a window of 3 x 3."""
STRIP = 16
"""Columns of a strip of the sky in which a point is taken."""
TOP, AREA = 0.1, 0.01
"""Least fraction of the picture's columns in which it reaches the upper edge, and of the picture that it covers."""


def is_of_sky(scene: Scene, label: str) -> bool:
    """Return True if `label` means the sky, and no teacher of the scene knows that word."""
    return SKY_WORDS.fullmatch(label.strip()) is not None and no_teacher_knows(scene, label)


def sky_scores(scene: Scene) -> np.ndarray:
    """Return (N,) float64: 1 for the static Gaussians of the sky, of what clicks on it mean in the pictures; 0 for all others.

    Raises F4xError where no sky is found.
    """
    fraction, _ = static_part(scene, points_on_sky(scene))
    return ((fraction > MOSTLY) & ~scene.moving).astype(float)


def points_on_sky(scene: Scene) -> list[Point]:
    """Return points on each large piece of blue sky, one in each upright strip of it, on some frames.

    It is blue and bright, above the horizon, static, and reaches the upper edge of the picture. Chosen on horsejump-high, parkour,
    car-shadow, drift-straight and people-walk. Raises F4xError where no frame shows any: a grey sky may be a wall.
    """
    frames = evenly_spaced(len(scene.cameras), FRAMES).tolist()
    pieces = [_pieces(_blue(scene, frame)) for frame in frames]
    if not any(pieces):
        raise F4xError(
            f"In the scene '{scene.name}' no blue sky was found at the upper edge of the pictures; click on it or draw a box around"
            " it."
        )
    return [
        Point(frame, at=_middle(strip, scene.cameras.width))
        for frame, found in zip(frames, pieces, strict=True)
        for piece in found
        for strip in _strips(piece)
    ]


def _blue(scene: Scene, frame: int) -> np.ndarray:
    """Return (h,w) bool: pixels of a small picture of the clip's frame that are blue, bright, static and above the horizon."""
    camera, values = scene.cameras[frame].of_width(COLUMNS), {"moving": scene.moving[:, None].astype(np.float32)}
    drawn = render(scene, camera, float(scene.cameras.times[frame]), ("rgb",), values=values)
    red, green, blue = np.moveaxis(drawn["rgb"], -1, 0)
    rays = camera.unproject(camera.pixel_grid(), np.ones(blue.shape)) - camera.center
    above, still = rays @ up_of(scene.cameras) > 0, drawn["moving"][..., 0] < STILL
    return above & still & (blue > red + BLUER) & (blue > green) & (blue > BRIGHT)


def _pieces(blue: np.ndarray) -> list[np.ndarray]:
    """Return the large connected pieces `(h,w)` bool of `blue (h,w)` that reach the upper edge."""
    number = np.where(blue, connected_regions(blue), -1)
    pieces = (number == one for one in np.unique(number[0]) if one >= 0)
    return [piece for piece in pieces if piece[0].mean() >= TOP and piece.mean() >= AREA]


def _strips(piece: np.ndarray) -> list[np.ndarray]:
    """Return the parts `(h,w)` bool of a piece in upright strips, without small ones: clouds cut the sky into several."""
    strip = np.arange(piece.shape[1]) // STRIP
    parts = [piece & (strip == one) for one in np.unique(strip)]
    return [part for part in parts if part.mean() >= AREA * STRIP / piece.shape[1]]


def _middle(piece: np.ndarray, width: int) -> tuple[float, float]:
    """Return x, y in pixels of a picture `width` pixels wide, in `piece (h,w)` bool as far from its rim as possible.

    It goes on beyond the edges of the picture.
    """
    inside = piece
    while inside.any() and not inside.all():
        piece, inside = inside, sums_around(inside[..., None].astype(int))[..., 0] == WINDOW
    row, column = (np.median(at) for at in np.nonzero(piece))
    nearest = np.argwhere(piece)
    row, column = nearest[np.argmin(abs(nearest - (row, column)).sum(1))] + 0.5
    scale = width / piece.shape[1]
    return float(column * scale), float(row * scale)
