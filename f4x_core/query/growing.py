"""From points and a box to the cells of an object, by the looks of the cells on that one frame. Needs numpy alone."""

from __future__ import annotations

import numpy as np

from .decoder_prompt import Prompt
from .score import logistic

BOND = 0.05
"""Cosine step that weakens the bond of two cells by 1/e when a point spreads."""
RANGE = 2
"""Cells are bound to others up to this many rows and columns away."""
RESTART, STEPS = 0.002, 300
"""Fraction of the walkers that start anew in each step, and the number of steps."""
MIN_AREA, MAX_AREA = 0.004, 0.6
"""Bounds of a region grown from points, as fractions of the frame."""
AS_GOOD = 1e-4
"""Of regions whose conductance is this near to the least one, the smallest is meant."""
TYPICAL = 0.4
"""Fraction of a box, least like its outside, that is taken for the object at first."""
LIKENESS, EDGE, PRIOR = 0.05, 0.2, 0.1
"""Difference of cosines that counts as clearly more alike; cosine step that separates neighbours by 1/e; weight of the prior
against one bond."""
VOTERS, ROUNDS = 5, 3
"""Most alike cells whose cosines are averaged; rounds of estimating the object from its last estimate."""


def grow_prompt(cells: np.ndarray, prompt: Prompt, size: tuple[int, int], contrast: float = 1.0) -> np.ndarray:
    """Return the fraction of the object (h,w) float32 in unit features (h,w,C), from points and a box on a picture of `size (H,W)`.

    Positive points spread to the region with the best outline around them (`local_cluster`); a box alone starts with the cells
    least like its outside. `ROUNDS` times, cells then compare themselves to the object so far and to the rest (`random_walk`);
    points, and what is outside the box, stay what they are. `contrast`: how far cosines differ in these features, beside visual
    features alone.
    """
    height, width = cells.shape[:2]
    scale = np.array([width / size[1], height / size[0]])
    fixed = np.full((height, width), np.nan, np.float32)  # NaN = to be found
    if prompt.box is not None:
        fixed[~_inside(prompt.box * np.tile(scale, 2), height, width)] = 0.0
    column, row = np.minimum((prompt.points * scale).astype(int), (width - 1, height - 1)).T
    fixed[row, column] = prompt.labels
    flat = cells.reshape(-1, cells.shape[2])
    alike = flat @ flat.T  # (n,n)
    np.fill_diagonal(alike, -np.inf)
    possible = fixed != 0
    if (fixed == 1).any():
        chosen = local_cluster(cells, fixed == 1, possible, contrast)
        rest = ~chosen
    else:
        if possible.all():
            return possible.astype(np.float32)  # a box around the whole picture
        likeness = _likeness(alike, ~possible)
        chosen = possible & (likeness <= np.quantile(likeness[possible], TYPICAL))
        rest = ~possible
    probability = chosen.astype(np.float32)
    for _ in range(ROUNDS):
        if not chosen.any() or not rest.any():
            break
        difference = _likeness(alike, chosen) - _likeness(alike, rest)
        probability = random_walk(cells, logistic(difference / (contrast * LIKENESS)), fixed, contrast)
        chosen = probability > 0.5
        rest = ~chosen
    return probability


def local_cluster(cells: np.ndarray, seeds: np.ndarray, possible: np.ndarray, contrast: float = 1.0) -> np.ndarray:
    """Return the region (h,w) bool around `seeds` with the fewest bonds across its outline for its bonds (least conductance).

    Personalised PageRank on the graph of bonds `exp((cosine - 1) / (contrast BOND))` orders the cells, a sweep over that order
    finds the cut (Andersen, Chung and Lang 2006). Nothing outside `possible` is reached.
    """
    height, width = seeds.shape
    moves = [(y, x) for y in range(-RANGE, RANGE + 1) for x in range(-RANGE, RANGE + 1) if (y, x) != (0, 0)]

    def pad(values: np.ndarray) -> np.ndarray:
        return np.pad(values, [(RANGE, RANGE)] * 2 + [(0, 0)] * (values.ndim - 2))

    def beside(padded: np.ndarray, y: int, x: int) -> np.ndarray:
        return padded[RANGE + y : RANGE + y + height, RANGE + x : RANGE + x + width]

    def seen(values: np.ndarray, y: int, x: int) -> np.ndarray:
        return beside(pad(values), y, x)

    there = np.ones((height, width))
    fade = contrast * BOND
    bonds = {move: np.exp(((cells * seen(cells, *move)).sum(-1) - 1) / fade) * seen(there, *move) for move in moves}
    degree = sum(bonds.values())
    # A click means its surroundings too: one cell may be an odd one.
    start = possible * (seeds + sum(seen(seeds.astype(float), y, x) for y, x in moves if max(abs(y), abs(x)) == 1) > 0)
    walkers = start
    for _ in range(STEPS):
        moving = pad(walkers / degree)
        arriving = sum(bond * beside(moving, *move) for move, bond in bonds.items())
        walkers = (1 - RESTART) * arriving * possible + RESTART * start
    order = np.argsort(-(walkers / degree).ravel(), kind="stable")
    rank = np.empty(order.size, int)
    rank[order] = np.arange(order.size)
    rank = rank.reshape(height, width)
    change = np.zeros(order.size)  # of the bonds cut when the region takes up a rank: each is cut between two ranks
    for move, bond in bonds.items():
        other = seen(rank, *move)
        np.add.at(change, np.minimum(rank, other).ravel(), bond.ravel() / 2)
        np.add.at(change, np.maximum(rank, other).ravel(), -bond.ravel() / 2)
    cut, volume = np.cumsum(change), np.cumsum(degree.ravel()[order])
    conductance = cut / np.maximum(np.minimum(volume, volume[-1] - volume), 1e-9)
    min_cells = min(max(9, int(MIN_AREA * order.size)), order.size - 1)
    max_cells = max(min_cells + 1, min(int(MAX_AREA * order.size), int(possible.sum())))
    good = conductance[min_cells:max_cells] <= conductance[min_cells:max_cells].min() + AS_GOOD
    return (rank <= min_cells + int(np.argmax(good))) & possible


def random_walk(cells: np.ndarray, prior: np.ndarray, fixed: np.ndarray, contrast: float = 1.0) -> np.ndarray:
    """Return the fraction of the object (h,w) float32: a random walker with priors (Grady 2005) between 4-neighbours of (h,w,C).

    `argmin sum w (x_i - x_j)^2 + PRIOR sum (x_i - prior_i)^2`, `w = exp((cosine - 1) / (contrast EDGE))`, by conjugate
    gradients; x is `fixed` where that is not NaN.
    """
    fade = contrast * EDGE
    down = np.exp(((cells[1:] * cells[:-1]).sum(-1) - 1) / fade)  # (h-1,w)
    across = np.exp(((cells[:, 1:] * cells[:, :-1]).sum(-1) - 1) / fade)  # (h,w-1)
    return walk_with_prior((down, across), prior, fixed, PRIOR)


def walk_with_prior(
    bonds: tuple[np.ndarray, np.ndarray], prior: np.ndarray, fixed: np.ndarray, trust: float
) -> np.ndarray:
    """Return (h,w) float32 in [0, 1]: a random walker with `prior (h,w)` (Grady 2005) between 4-neighbours.

    `argmin sum bond (x_i - x_j)^2 + trust sum (x_i - prior_i)^2` with `bonds` (h-1,w) down and (h,w-1) across, by conjugate
    gradients; x is `fixed (h,w)` where that is not NaN.
    """
    down, across = bonds
    free = np.isnan(fixed)

    def apply(x: np.ndarray) -> np.ndarray:
        result = trust * x
        flow = down * np.diff(x, axis=0)
        result[1:] += flow
        result[:-1] -= flow
        flow = across * np.diff(x, axis=1)
        result[:, 1:] += flow
        result[:, :-1] -= flow
        return result

    x = np.where(free, prior, fixed).astype(np.float64)
    residual = (trust * prior - apply(x)) * free
    direction, power = residual.copy(), (residual**2).sum()
    for _ in range(500):
        if power < 1e-10:
            break
        image = apply(direction) * free
        step = power / (direction * image).sum()
        x += step * direction
        residual -= step * image
        before, power = power, (residual**2).sum()
        direction = residual + power / before * direction
    return np.clip(x, 0, 1).astype(np.float32)


def _likeness(alike: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """Return the mean cosine (h,w) of each cell to the `VOTERS` most similar cells of `kind (h,w) bool`; 1 where it is alone.

    A cell is no voter on itself: `alike (n,n)` has -inf there.
    """
    among = alike[:, kind.ravel()]
    voters = min(VOTERS, among.shape[1])
    most = np.partition(among, -voters, axis=1)[:, -voters:]
    others = np.isfinite(most)
    mean = np.where(others, most, 0).sum(1) / np.maximum(others.sum(1), 1)
    return np.where(others.any(1), mean, 1).reshape(kind.shape)


def _inside(box: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return the cells (h,w) bool whose centre is in `box` (left, top, right, bottom in cells); at least the one in its middle."""
    left, top, right, bottom = box
    rows, columns = np.arange(height) + 0.5, np.arange(width) + 0.5
    inside = ((rows >= top) & (rows <= bottom))[:, None] & ((columns >= left) & (columns <= right))
    inside[min(int((top + bottom) / 2), height - 1), min(int((left + right) / 2), width - 1)] = True
    return inside
