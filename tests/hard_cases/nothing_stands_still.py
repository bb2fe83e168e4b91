"""Nothing stands still.

Hard: twenty cards that fill the picture drift and sway, each its own way, and the camera moves.

Why: there is no background to find cameras by; whatever is taken for one makes them wrong.

Must hold: it fits with finite arrays, and it is said that the camera's motion is not known from what stands still.
"""

from benchmarks.studies.hard_cases import reported, that

from .common.film import Card, checks, film, np
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def swaying(number: int) -> Card:
    """One of the cards, in its place of a grid of four rows of five."""
    rng = np.random.default_rng(number)
    place = np.array([0.3 * (number % 5 - 2), 0.22 * (number // 5 - 1.5), 0.9 + 0.2 * rng.random()])
    phase, drift = 6 * rng.random(2), 0.006 * rng.normal(size=2)

    def at(time):
        return place + np.array([*(0.04 * np.sin(0.3 * time + phase) + drift * time), 0])

    def turn(time):
        return np.array(
            [0.2 * np.sin(0.2 * time + phase[1]), 0.2 * np.sin(0.2 * time + phase[0]), 0.2 * np.sin(0.2 * time)]
        )

    return Card(checks(0.15 + 0.05 * rng.random(), 6 * rng.random()), (0.2, 0.16), at, turn, moves=True)


def check():
    wall = Card(checks(0.5), at=lambda time: np.array([0.03 * time, 0.02 * np.sin(time), 1.4]), moves=True)
    fitted = fit(film([wall, *map(swaying, range(20))]))
    yield from judge(fitted, "picture counts as moving|from what stands still|too few points stand still")
    yield reported("the cameras are doubted", "How the camera moved is not known", fitted.messages)
    yield that("it is not taken for several shots", not any("shots" in text for text in fitted.messages))
