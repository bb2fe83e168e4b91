"""Nothing but sky behind what moves.

Hard: a card glides before a smooth sky without a single feature.

Why: no track holds the camera, and which way the card goes or the camera pans cannot be told.

Must hold: unseen frames are right, and it is said that how the camera moved, or how far things are, is not known.
"""

from benchmarks.studies.hard_cases import reported

from .common.film import LEVEL, Card, film, mover, np, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def sky(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Blue that pales downwards."""
    pale = np.clip(0.5 + v, 0, 1)[..., None]
    return (1 - pale) * np.array([0.35, 0.55, 0.85]) + pale * np.array([0.75, 0.85, 0.95])


def check():
    fitted = fit(film([Card(sky, at=standing(0, 0, 2)), mover()], eye=LEVEL, look=LEVEL))
    yield from judge(fitted, "almost no texture to follow")
    yield reported("what is not known", "almost no texture to follow", fitted.messages)
