"""Tracks that lie on a line, in a plane, or on one point.

Hard: the points around a node do not span space; its rotation is not determined.

Why: the best rotation of flat points may be a mirror image, that of a line any turn about it.

Must hold: every rotation is proper and finite, and what is not determined does not turn.
"""

import numpy as np

from benchmarks.studies.hard_cases import that, within
from f4x_core.geometry import quaternion
from f4x_core.scaffold.rotation import initial_rotations

STAGE = "scaffold"


def check():
    rng = np.random.default_rng(0)
    around = np.tile(np.arange(6), (6, 1))
    turn = quaternion.from_rotation_vector(np.linspace(0, 3.0, 6)[:, None] * np.array([0.0, 0, 1]))
    for name, axes, turns in (("in a plane", 2, True), ("on a line", 1, False), ("on one point", 0, False)):
        points = np.zeros((6, 3))
        points[:, :axes] = rng.normal(size=(6, axes))
        found = initial_rotations(around, np.ones((6, 6), bool), quaternion.rotate(turn[:, None], points[None]))
        expected = turn[:, None] if turns else np.array([1.0, 0, 0, 0])
        apart = abs(abs((found * expected).sum(-1)) - 1).max()
        yield that(f"{name}: unit length", np.allclose(np.linalg.norm(found, axis=-1), 1))
        yield within(f"{name}: {'the true turn' if turns else 'no turn'}", apart, 1e-9)
