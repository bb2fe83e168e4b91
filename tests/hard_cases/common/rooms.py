"""Rooms of cards made by chance: a wall, a floor, posts and boxes near the camera, up to two things that move, any walk."""

from __future__ import annotations

import numpy as np

from .film import Card, Film, checks, film, gliding, standing

FRAMES, SIZE = 16, (240, 136)
FOCALS = (0.55, 0.75, 0.9, 1.2)
"""Picture widths."""


def furnished_room(seed: int) -> Film:
    """The room, the walk and the lens of a number."""
    rng = np.random.default_rng(seed)
    cards = [
        Card(
            surface(rng, 0.3, 0.7),
            at=standing(0, 0, 1.4 + 0.8 * rng.random()),
            turn=standing(0, 0.25 * rng.normal(), 0),
        ),
        Card(surface(rng, 0.3, 0.6), at=standing(0, 0.2 + 0.2 * rng.random(), 1), turn=standing(np.pi / 2, 0, 0)),
    ]
    for _ in range(rng.integers(1, 6)):
        depth, half = 0.6 + 0.8 * rng.random(), (0.03 + 0.12 * rng.random(), 0.1 + 0.5 * rng.random())
        cards.append(
            Card(surface(rng, 0.1, 0.25), half, standing(0.4 * rng.normal() * depth, 0.1 * rng.normal(), depth))
        )
    for _ in range(rng.integers(0, 3)):
        start, step = rng.normal((0, 0, 0.9), (0.25, 0.1, 0.15)), rng.normal(0, (0.02, 0.01, 0.01))
        side = 0.05 + 0.1 * rng.random()
        cards.append(Card(surface(rng, 0.08, 0.18), (side, side), gliding(start - FRAMES / 2 * step, step), moves=True))
    return film(cards, *walk(rng), frames=FRAMES, focal=float(rng.choice(FOCALS)), size=SIZE, hold_out=0)


def surface(rng: np.random.Generator, smallest: float, largest: float):
    """Checks of any colour, with a period between two lengths in world units."""
    return checks(rng.uniform(smallest, largest), 6 * rng.random())


def walk(rng: np.random.Generator):
    """Place and look of a camera that goes aside, ahead, both, to and fro, or along a bend, by a hundredth to four a frame."""
    kind, step, phase = rng.integers(5), rng.choice([-1, 1]) * rng.uniform(0.01, 0.04), 6 * rng.random()
    turn, looks_back = rng.choice([-1, 0, 1]) * 0.02 * rng.random(), (0.9, 0.3, 0.3, 0.3, 0.9)[kind]

    def eye(time: float) -> np.ndarray:
        t = time - (FRAMES - 1) / 2
        sway = 0.015 * np.sin(0.7 * time + phase)
        ways = (
            (step * t, sway, 0),
            (0.3 * sway, 0.3 * sway, 0.8 * abs(step) * t),
            (0.5 * step * t, sway, 0.6 * abs(step) * t),
            (3 * step * np.sin(0.4 * time + phase), step * np.cos(0.4 * time), 0),
            (step * t, sway, 0.002 * t**2),
        )
        return np.array(ways[kind])

    def look(time: float) -> np.ndarray:
        t = time - (FRAMES - 1) / 2
        towards = -looks_back * np.arctan(eye(time)[0]) + turn * t
        return np.array([0.03 * np.sin(0.7 * time + phase), towards, 0.01 * np.sin(0.5 * time)])

    return eye, look
