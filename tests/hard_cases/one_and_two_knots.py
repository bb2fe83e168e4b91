"""Scaffolds of one and of two frames.

Hard: a clip so short that no curve runs through four knots.

Why: interpolation reads the neighbours of neighbours, which are not there.

Must hold: the forms agree with float64 at, between and outside the frames.
"""

from .common.carrying import compare, turning

STAGE = "deformation"


def check():
    for frames in (1, 2, 3):
        for time in (-0.5, 0.0, 0.5, 2.5):
            yield from compare(turning(1.0, frames=frames), time)
