"""Nodes that are missing from a rig: which of the others carries what they carried. numpy."""

import numpy as np


def carriers(reference: np.ndarray, place: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return for each (node, reference) pair the pair whose motion it has: `(P,)` int indices.

    A pair whose node is `there (P,)` bool has its own; any other that of the pair nearest to it at `place (P,3)` with the same
    `reference (P,)`, or, where there is none, of the pair with the nearest reference. Without any pair each has its own.
    """
    carrier = np.arange(len(reference))
    left = np.flatnonzero(there)
    for pair in np.flatnonzero(~there) if len(left) else ():
        apart = np.abs(reference[left].astype(np.int64) - reference[pair])
        nearest = left[apart == apart.min()]
        carrier[pair] = nearest[((place[nearest] - place[pair]) ** 2).sum(1).argmin()]
    return carrier
