"""The selection as point attributes: a query writes scores to the points, and a threshold turns them into a selection."""

from __future__ import annotations

import json

import numpy as np

from ...f4x_core.query.gesture import select_by_sphere
from ...f4x_core.query.selection import Selection
from ..common.axes import Eye
from ..common.point_cloud import read_attribute, write_attribute
from ..scene.scene_object import BEFORE, SCORE, SELECTED, SceneObject
from . import display, listing

MODES = (
    ("SET", "Set", "Replace the selection by the result", "SELECT_SET", 0),
    ("ADD", "Add", "Add the result to the selection", "SELECT_EXTEND", 1),
    ("SUBTRACT", "Subtract", "Remove the result from the selection", "SELECT_SUBTRACT", 2),
    ("INTERSECT", "Intersect", "Keep selected only what is also in the result", "SELECT_INTERSECT", 3),
)
"""Modes of combining a result with the selection, as entries of menus."""
NO_FEATURES = "This scene has no features, so a piece that hangs together was taken; Tasks > Features makes them."
"""The sidebar's sentence where a whole thing was asked for and none is known."""
BARS = 20
"""Number of bars in the histogram of scores."""


def ask(scene_object: SceneObject, found: Selection, mode: str | None = None) -> None:
    """Write the scores of a query to the points, and combine its result with the selection by `mode`, or that of the panel."""
    state = scene_object.state
    scene_object.write(**{BEFORE: ("BOOLEAN", scene_object.read(SELECTED))})
    _write_scores(scene_object, found)
    state.combined, state.live, state.called = mode or state.mode, True, ""
    state.threshold = found.threshold  # selects, by its update


def follow_sphere(scene_object: SceneObject) -> None:
    """Let the Gaussians in the selecting sphere take the place of the last query, combined with the same selection as that."""
    state, scene = scene_object.state, scene_object.shown.scene
    if state.sphere_radius > 0:
        view = scene_object.view(Eye(scene.cameras.at(scene_object.frame), 0.0, np.inf, 0.0))
        _write_scores(scene_object, select_by_sphere(scene, view, tuple(state.sphere), state.sphere_radius))
        apply_threshold(scene_object)


def tell_of_features(scene_object: SceneObject) -> None:
    """Say below the words that a thing may be a fragment where the scene has no features; else take that line down."""
    lacks = scene_object.base.features is None and scene_object.holds_edits
    scene_object.state.found = NO_FEATURES if lacks else ""


def _write_scores(scene_object: SceneObject, found: Selection) -> None:
    """Let points, bars and heat map have the scores of a query; what wins is chosen at any threshold."""
    scores = np.where(found.wins, 1.0, found.scores).astype(np.float32)
    scene_object.write(**{SCORE: ("FLOAT", scores)})
    scene_object.state.histogram = json.dumps(np.histogram(scores, BARS, (0.0, 1.0))[0].tolist())
    if scene_object.state.show_score:
        display.redraw(scene_object)


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
    listing.count(scene_object)


def choose(scene_object: SceneObject, chosen: np.ndarray) -> None:
    """Select exactly the Gaussians `chosen (N,) bool`; scores, threshold, histogram and heat map of the last query are put away."""
    state = scene_object.state
    state.live, state.called, state.histogram = False, "", ""
    if state.show_score:
        state.show_score = False  # draws the colors
    scene_object.write(**{SELECTED: ("BOOLEAN", chosen)})
    listing.count(scene_object)


def combine(scene_object: SceneObject, chosen: np.ndarray, mode: str | None = None) -> None:
    """Select the Gaussians `chosen (N,) bool`, combined with the current selection by `mode`, or that of the panel."""
    choose(scene_object, _combined(scene_object.read(SELECTED), chosen, mode or scene_object.state.mode))


def _combined(before: np.ndarray, new: np.ndarray, mode: str) -> np.ndarray:
    return {"SET": new, "ADD": before | new, "SUBTRACT": before & ~new, "INTERSECT": before & new}[mode]
