"""A mirror.

Hard: behind a window in the wall everything is seen a second time, turned over, beyond the wall - the mover too.

Why: what is seen in a mirror has the parallax of a place behind the wall, where depth and masks expect nothing.

Must hold: unseen frames, in which the mover's image is to be seen, are right, the mirrored world being taken for a real one
behind a hole, or the cause is said.
"""

from dataclasses import replace

from benchmarks.studies.hard_cases import that

from .common.film import Card, checks, film, gliding, np, room, standing, trace
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True
GLASS = 1.5
"""Depth of the mirror."""
MIN_PIXELS = 20


def mirrored(card: Card) -> Card:
    """What the mirror shows of a card."""
    return replace(
        card,
        at=lambda time: card.at(time) * [1, 1, -1] + [0, 0, 2 * GLASS],
        turn=lambda time: card.turn(time) * [-1, -1, 1],
    )


def check():
    card = Card(checks(0.2, 4.0), (0.07, 0.07), gliding((0.06, -0.17, 0.8), (-0.01, 0, 0)), moves=True)
    floor = Card(checks(0.43, 1.0), (np.inf, GLASS), standing(0, 0.25, 0), standing(np.pi / 2, 0, 0))
    things = [floor, *room()[2:], Card(checks(0.9, 0.7), at=standing(0, 0, -0.6))]
    frame = [Card(checks(0.57), (0.57, 2), standing(side * 0.97, 0, GLASS)) for side in (-1, 1)]
    still = [*frame, *things, *map(mirrored, things)]
    shot = film([*still, card, mirrored(card)])
    for t in np.flatnonzero(shot.clip.held_out):
        seen = trace([*still, replace(card, moves=False), mirrored(card)], shot.cameras[int(t)], t)[2].sum()
        yield that(
            f"the mover's image has {MIN_PIXELS} pixels or more in frame {t}, which is unseen", seen >= MIN_PIXELS
        )
    known = "what a mirror shows is blurred into what is seen around it, and no sentence names the mirror"
    yield from judge(fit(shot), "can be followed", known, at_most=3)
