"""False colours for what is not a colour: depth and motion; and pictures side by side with labels.

Give one range of colours per clip, or the pictures flicker.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL import Image

SPECTRUM = np.array(
    [
        (0.18, 0.07, 0.28),
        (0.26, 0.42, 0.92),
        (0.12, 0.78, 0.85),
        (0.35, 0.97, 0.42),
        (0.83, 0.92, 0.22),
        (0.99, 0.61, 0.18),
        (0.85, 0.22, 0.04),
        (0.45, 0.02, 0.02),
    ]
)
"""Dark violet over blue, green and yellow to dark red: turbo-like, even in brightness steps."""
WHEEL_AT = np.array([0, 15, 21, 25, 36, 49, 55]) / 55
WHEEL = np.array([(1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1), (1, 0, 1), (1, 0, 0)], float)
"""Hues of directions in the proportions of the Middlebury flow wheel (Baker et al. 2011): right is red, down yellow,
left cyan-blue, up violet."""

CELL_WIDTH, GAP, LABEL_HEIGHT, MARGIN = 320, 4, 26, 44
"""Pixels of a labelled grid: widest cell, gap between cells, height of the labels above, width of those at the left."""
BACKGROUND, INK, MARK = (255, 255, 255), (40, 44, 52), (230, 120, 20)
"""Colours of a labelled grid: paper, letters, and the frame of the marked column."""


def depth_range(depths: Iterable[np.ndarray], outliers: float = 2.0) -> tuple[float, float]:
    """Return (near, far) of a clip's depth maps without the `outliers` percent at either end; NaN is unknown.

    (1, 2) when no depth is known.
    """
    known = [depth[np.isfinite(depth) & (depth > 0)] for depth in depths]
    values = np.concatenate([np.zeros(0), *known])
    if not len(values):
        return 1.0, 2.0
    near, far = np.percentile(values, [outliers, 100 - outliers])
    return float(near), float(far)


def colour_depth(depth: np.ndarray, near: float, far: float) -> np.ndarray:
    """Return (H,W,3) uint8 of `depth (H,W)`: near red, far violet, unknown (NaN) black.

    Colours are even in 1 / depth, which is how far apart two depths look.
    """
    known = np.isfinite(depth) & (depth > 0)
    inverse = 1 / np.where(known, depth, 1)
    position = (inverse - 1 / far) / max(1 / near - 1 / far, 1e-12)
    return _bytes(_ramp(position, np.linspace(0, 1, len(SPECTRUM)), SPECTRUM) * known[..., None])


def colour_motion(motion: np.ndarray, largest: float) -> np.ndarray:
    """Return (H,W,3) uint8 of `motion (H,W,2)` in pixels: hue is the direction, white no motion, full colour `largest`.

    Longer motion is darkened, so that it tells itself apart; unknown (NaN) is black.
    """
    known = np.isfinite(motion).all(axis=-1)
    motion = np.where(known[..., None], motion, 0)
    length = np.linalg.norm(motion, axis=-1) / max(largest, 1e-12)
    turn = np.arctan2(motion[..., 1], motion[..., 0]) / (2 * np.pi) % 1  # (H, W), 0 right, 1/4 down
    hue = _ramp(turn, WHEEL_AT, WHEEL)
    colour = 1 - np.minimum(length, 1)[..., None] * (1 - hue)
    beyond = np.where(length > 1, 0.75, 1.0)
    return _bytes(colour * (beyond * known)[..., None])


def labelled_grid(
    rows: Sequence[Sequence[np.ndarray]], frames: Sequence[str], column_names: Sequence[str], marked: int | None = None
) -> Image.Image:
    """Return the pictures of one size (H,W,3) uint8 in a grid with labels; wide ones are shrunk to `CELL_WIDTH`. Needs Pillow.

    Each row has the number of its clip frame beside it. The column `marked` is framed.
    """
    from PIL import Image, ImageDraw, ImageFont

    height, width = rows[0][0].shape[:2]
    if width > CELL_WIDTH:
        width, height = CELL_WIDTH, max(1, round(height * CELL_WIDTH / width))
    step_x, step_y = width + GAP, height + GAP
    sheet = Image.new("RGB", (MARGIN + len(column_names) * step_x, LABEL_HEIGHT + len(rows) * step_y), BACKGROUND)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    if marked is not None:
        left = MARGIN + marked * step_x - GAP
        draw.rectangle((left, LABEL_HEIGHT - GAP, left + step_x + GAP - 1, sheet.height - 1), MARK)
    draw.text((MARGIN - 2 * GAP, LABEL_HEIGHT / 2), "frame", INK, ImageFont.load_default(12), anchor="rm")
    for column, label in enumerate(column_names):
        draw.text((MARGIN + column * step_x + width / 2, LABEL_HEIGHT / 2), label, INK, font, anchor="mm")
    for row, (cells, name) in enumerate(zip(rows, frames, strict=True)):
        top = LABEL_HEIGHT + row * step_y
        draw.text((MARGIN - 2 * GAP, top + height / 2), name, INK, font, anchor="rm")
        for column, cell in enumerate(cells):
            image = Image.fromarray(cell)
            if image.size != (width, height):
                image = image.resize((width, height), Image.Resampling.BOX)
            sheet.paste(image, (MARGIN + column * step_x, top))
    return sheet


def _ramp(position: np.ndarray, at: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Return the colours (...,3) at `position (...)`, linear between `colours (n,3)` that stand at `at (n,)`, held at the ends."""
    return np.stack([np.interp(position, at, colours[:, channel]) for channel in range(3)], axis=-1)


def _bytes(rgb: np.ndarray) -> np.ndarray:
    return np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
