"""The selection as point attributes: a query writes scores to the points, and a threshold turns them into a selection."""

from __future__ import annotations

import json

import numpy as np

from ..f4x_core.query.selection import Selection
from . import display
from .point_cloud import read_attribute, write_attribute
from .scene_object import BEFORE, SCORE, SELECTED, SceneObject

BARS = 20
"""Number of bars in the histogram of scores."""


def ask(scene_object: SceneObject, found: Selection) -> None:
    """Write the scores of a query to the points, and combine its result with the selection as the mode says."""
    state = scene_object.state
    scores = np.where(found.wins, 1.0, found.scores).astype(np.float32)  # what wins is chosen at any threshold
    before = scene_object.read(SELECTED)
    scene_object.write(**{BEFORE: ("BOOLEAN", before), SCORE: ("FLOAT", scores)})
    state.histogram = json.dumps(np.histogram(scores, BARS, (0.0, 1.0))[0].tolist())
    state.combined, state.live, state.called = state.mode, True, ""
    state.threshold = found.threshold  # selects, by its update


def apply_threshold(scene_object: SceneObject) -> None:
    """Select by the scores of the points. Does nothing unless the last selection came from a query."""
    state = scene_object.state
    if not state.live:
        return
    for cloud in scene_object.clouds:
        scores, before = read_attribute(cloud.data, SCORE), read_attribute(cloud.data, BEFORE)
        if scores is None or before is None:
            continue
        chosen = _combined(before, scores >= np.float32(state.threshold), state.combined)
        write_attribute(cloud.data, SELECTED, "BOOLEAN", chosen)
        cloud.data.update_tag()
    display.count(scene_object)


def choose(scene_object: SceneObject, chosen: np.ndarray) -> None:
    """Select exactly the Gaussians `chosen (N,) bool`, independent of scores and threshold."""
    scene_object.state.live, scene_object.state.called = False, ""
    scene_object.write(**{SELECTED: ("BOOLEAN", chosen)})
    display.count(scene_object)


def combine(scene_object: SceneObject, chosen: np.ndarray) -> None:
    """Select the Gaussians `chosen (N,) bool`, combined with the current selection by the mode of the panel."""
    choose(scene_object, _combined(scene_object.read(SELECTED), chosen, scene_object.state.mode))


def _combined(before: np.ndarray, new: np.ndarray, mode: str) -> np.ndarray:
    return {"SET": new, "ADD": before | new, "SUBTRACT": before & ~new, "INTERSECT": before & new}[mode]
