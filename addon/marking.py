"""The selection as point attributes: a query writes scores to the points, and a threshold turns them into a selection."""

from __future__ import annotations

import json

import bpy
import numpy as np

from ..f4x_core.query.selection import Selection
from . import display, session
from .point_cloud import read_attribute, write_attribute
from .session import BEFORE, SCORE, SELECTED

BARS = 20
"""Number of bars in the histogram of scores."""


def ask(root: bpy.types.Object, found: Selection) -> None:
    """Write the scores of a query to the points, and combine its result with the selection as the mode says."""
    state = root.f4x
    scores = np.where(found.wins, 1.0, found.scores).astype(np.float32)  # what wins is chosen at any threshold
    before = session.read(root, SELECTED)
    session.write(root, **{BEFORE: ("BOOLEAN", before), SCORE: ("FLOAT", scores)})
    state.histogram = json.dumps(np.histogram(scores, BARS, (0.0, 1.0))[0].tolist())
    state.combined, state.live, state.called = state.mode, True, ""
    state.threshold = found.threshold  # selects, by its update


def apply_threshold(root: bpy.types.Object) -> None:
    """Select by the scores of the points. Does nothing unless the last selection came from a query."""
    state = root.f4x
    if not state.live:
        return
    for cloud in session.clouds_of(root):
        scores, before = read_attribute(cloud.data, SCORE), read_attribute(cloud.data, BEFORE)
        if scores is None or before is None:
            continue
        chosen = _combined(before, scores >= np.float32(state.threshold), state.combined)
        write_attribute(cloud.data, SELECTED, "BOOLEAN", chosen)
        cloud.data.update_tag()
    display.count(root)


def choose(root: bpy.types.Object, chosen: np.ndarray) -> None:
    """Select exactly the Gaussians `chosen (N,) bool`, independent of scores and threshold."""
    root.f4x.live, root.f4x.called = False, ""
    session.write(root, **{SELECTED: ("BOOLEAN", chosen)})
    display.count(root)


def combine(root: bpy.types.Object, chosen: np.ndarray) -> None:
    """Select the Gaussians `chosen (N,) bool`, combined with the current selection by the mode of the panel."""
    choose(root, _combined(session.read(root, SELECTED), chosen, root.f4x.mode))


def _combined(before: np.ndarray, new: np.ndarray, mode: str) -> np.ndarray:
    return {"SET": new, "ADD": before | new, "SUBTRACT": before & ~new, "INTERSECT": before & new}[mode]
