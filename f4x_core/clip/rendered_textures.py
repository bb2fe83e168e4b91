"""Patterns of rendered scenes as numpy images that tile: strong at every scale, the same on every machine and version."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SIZE = 256
"""Pixels along a side."""
COLOURS = 6
"""Number of colours of a pattern."""


def texture(seed: int, pattern: str = "", strength: float = 1.0) -> np.ndarray:
    """Return an sRGB image (SIZE,SIZE,3) float32 in 0..1 of one of `PATTERNS` (by the seed without a name), broken up by noise.

    `strength` 0..1 is the contrast of the pattern's colours; that of the noise stays.
    """
    random = np.random.default_rng([seed, 2])
    names = list(PATTERNS)
    colours = _colours(random)
    colours = colours.mean(0) + strength * (colours - colours.mean(0))
    image = colours[PATTERNS[pattern or names[seed % len(names)]](random)]
    for cells, low in ((6, 0.7), (32, 0.6)):
        image = image * (low + (1 - low) * noise(random, cells)[..., None])
    return np.clip(1.15 * image, 0, 1).astype(np.float32)


def noise(random: np.random.Generator, cells: int) -> np.ndarray:
    """Return the value noise (SIZE,SIZE) in 0..1 of `cells` cells a side, which tiles."""
    values = random.random((cells, cells))
    at = np.arange(SIZE) * cells / SIZE
    low, part = at.astype(int), at % 1
    part = part * part * (3 - 2 * part)
    rows = values[low] * (1 - part)[:, None] + values[(low + 1) % cells] * part[:, None]
    return rows[:, low] * (1 - part) + rows[:, (low + 1) % cells] * part


def _colours(random: np.random.Generator) -> np.ndarray:
    """Return different colors (COLOURS,3) of middling saturation, dark and light ones."""
    hue = (random.random() + np.arange(COLOURS) / COLOURS + random.uniform(-0.06, 0.06, COLOURS)) % 1
    wheel = np.clip(np.abs((hue[:, None] * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1, 0, 1)
    saturation, value = random.uniform(0.1, 0.5, COLOURS), random.uniform(0.2, 0.8, COLOURS)
    value = np.where(np.arange(COLOURS) % 2, 0.35 + 0.3 * value, 0.65 + 0.45 * value)
    return np.clip(value[:, None] * (1 - saturation[:, None] * (1 - wheel)), 0, 1)


def _patches(random: np.random.Generator) -> np.ndarray:
    """Return the number of the nearest of random points."""
    points = random.random((48, 2)) * SIZE
    grid = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij"), -1)[..., None, :]
    apart = np.abs(grid - points)
    apart = np.minimum(apart, SIZE - apart)
    return (apart**2).sum(-1).argmin(-1) % COLOURS


def _bricks(random: np.random.Generator) -> np.ndarray:
    """Return the rows of bricks, each of one of four colours, with mortar."""
    row, column = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    high, wide = SIZE // 16, SIZE // 8
    line = row // high
    shifted = (column + line % 2 * (wide // 2)) % SIZE
    kinds = random.integers(0, COLOURS - 2, (16, 8))[line, shifted // wide]
    return np.where((row % high < 2) | (shifted % wide < 2), COLOURS - 1, kinds)


def _checks(random: np.random.Generator) -> np.ndarray:
    """Return the squares of random colours, no two neighbours from the same half of the palette."""
    cells = 10
    at = np.arange(SIZE) * cells // SIZE
    kinds = 2 * random.integers(0, COLOURS // 2, (cells, cells)) + np.indices((cells, cells)).sum(0) % 2
    return kinds[at[:, None], at]


def _clouds(random: np.random.Generator) -> np.ndarray:
    """Return fractal noise in steps."""
    octaves = np.stack([noise(random, 2**k) / 2**k for k in (2, 3, 4)])
    fractal = octaves.sum(0)
    ranks = np.argsort(np.argsort(fractal.ravel())).reshape(fractal.shape)
    return ranks * COLOURS // fractal.size


PATTERNS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "patches": _patches,
    "bricks": _bricks,
    "checks": _checks,
    "clouds": _clouds,
}
"""Name -> numbers of colours (SIZE,SIZE)."""
