"""The lists and the numbers of the sidebar: edits, named selections, selected and existing Gaussians."""

from __future__ import annotations

import contextlib
import re

import numpy as np
from bpy.app.handlers import persistent

from ...f4x_core.edit.description import describe_in
from ...f4x_core.edit.operations import Operation
from ...f4x_core.edit.uncovered import summary_of, uncovered
from ...f4x_core.errors import F4xError
from ...f4x_core.language.colour_names import everyday_name, from_hex
from ..common.axes import SceneAxes
from ..common.point_cloud import read_attribute
from ..common.wording import panel_words
from ..scene.scene_object import PREVIEW, SELECTED, SceneObject
from .drawing import GONE

HEX = re.compile(r"#([0-9a-f]{6})\b")
"""A color in a row of the list of edits that has no name of its own."""
WORLD_AXES = "Blender's X, Y and Z"
"""Axes of the ways and turns in the list of edits."""
_counts: dict[int, tuple[int, int]] = {}  # session_uid of a root -> what `counts` found since anything changed


def update_panel(scene_object: SceneObject, summary: bool = True) -> None:
    """Update the lists and counts of the sidebar from the pending edits, and the `summary` of what they uncover."""
    # a script may import without registering the extension; lists of a linked scene cannot be changed
    if hasattr(scene_object.root, "f4x") and not scene_object.is_linked:
        _fill_lists(scene_object)
        count(scene_object)
        if summary:
            scene_object.state.uncovered = panel_words(summary_of(uncovered(scene_object.edited)))


def _fill_lists(scene_object: SceneObject) -> None:
    """Update the lists of edits and of named selections from the pending edits."""
    state = scene_object.state
    before, picked = len(state.history), state.history_index
    state.history.clear()
    for edit in scene_object.stack.edits:
        row = state.history.add()
        row.edit_id, row.enabled = edit.id, edit.enabled
    state.history_index = picked if before == len(state.history) else len(state.history) - 1
    state.names.clear()
    for name, rows in scene_object.names.items():
        row = state.names.add()
        row.name, row.count = name, len(rows)
    state.name_index = min(max(state.name_index, 0), len(state.names) - 1)


def words_of(operation: Operation, axes: SceneAxes) -> str:
    """Return an edit in the words of its row: numbers of its dialog, along Blender's axes where the scene is, and named colors."""
    words = describe_in(operation, axes.to_world, WORLD_AXES)
    return HEX.sub(lambda found: f"{everyday_name(from_hex(found[1]))} ({found[0]})", words)


def count(scene_object: SceneObject) -> None:
    """Remember the numbers of selected and existing Gaussians after an operator selected."""
    scene_object.state.selected, scene_object.state.total = counts(scene_object)


def counts(scene_object: SceneObject) -> tuple[int, int]:
    """Return the numbers of selected and existing Gaussians, whoever selected or deleted points since; a preview removes none."""
    if PREVIEW in scene_object.root:
        with contextlib.suppress(F4xError):  # the file is gone: the points as they are drawn are all that is known
            return _counts_without_preview(scene_object)
    selected = total = 0
    for cloud in scene_object.clouds:
        chosen, gone = (read_attribute(cloud.data, name) for name in (SELECTED, GONE))
        there = np.ones(len(cloud.data.points), bool) if gone is None else ~gone
        total += int(there.sum())
        selected += 0 if chosen is None else int((chosen & there).sum())
    return selected, total


def _counts_without_preview(scene_object: SceneObject) -> tuple[int, int]:
    pending = scene_object.pending
    there = pending.appearance(scene_object.frame).opacities > 0
    chosen = np.isin(pending.scene.ids, scene_object.shown.scene.ids[scene_object.read(SELECTED)])
    return int((chosen & there).sum()), int(there.sum())


def last_counts(scene_object: SceneObject) -> tuple[int, int]:
    """Return `counts`, worked out only where Blender has seen a change since the last call: panels are drawn often."""
    uid = scene_object.root.session_uid
    if uid not in _counts:
        _counts[uid] = counts(scene_object)
    return _counts[uid]


def forget_counts(scene_object: SceneObject) -> None:
    """Let `last_counts` count anew: other points are drawn."""
    _counts.pop(scene_object.root.session_uid, None)


@persistent
def _changed(*_) -> None:
    _counts.clear()


HANDLERS = dict.fromkeys(("depsgraph_update_post", "undo_post", "redo_post", "load_post"), _changed)
