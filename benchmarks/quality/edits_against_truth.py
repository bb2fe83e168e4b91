"""Scores edits on the scene of a rendered clip: changed pixels against the true object index, in old and new views."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from f4x_core.errors import F4xError
from f4x_core.evaluation.truth import TrueClip
from f4x_core.progress import Progress, silent
from f4x_core.query.blend_weights import lift_masks
from f4x_core.query.labels import Encode
from f4x_core.query.score import THRESHOLD
from f4x_core.query.selection import Selection
from f4x_core.scene import Scene

from .edits import measure_edit, prompted
from .labels import novel_views, original_views

EDITS = ("delete", "recolour")
FIGURES = ("iou", "leakage")


def score_edits(
    scene: Scene,
    truth_folder: Path | str,
    label: str | None = None,
    *,
    encode: Encode | None = None,
    progress: Progress = silent,
) -> dict[str, float]:
    """Delete and recolour the moving subject of the rendered clip that `scene` was made from, and see what changes.

    `PROMPT_EDIT_FIGURE_KIND`. Prompts: `mask` and `point` on the first frame that shows the subject, `text` with `label`,
    `moving` = everything that the scaffold carries, and `truth` = Gaussians with most of their light inside the true
    masks of all frames: as good as whole Gaussians of this scene can do. Figures: those of `edits.measure_edit`,
    means over views. Kinds: `original`, all frames of the clip; `novel`, its extra cameras where the fitted path allows to
    place them.

    Raises:
        F4xError: no truth there, or of another clip; a subject that is never seen; a word that nobody knows.
    """
    clip = TrueClip.read(scene, truth_folder)
    views = {"original": list(original_views(scene, clip)), "novel": list(novel_views(scene, clip))}
    masks = {frame: subject for frame, (_, _, subject, _) in enumerate(views["original"]) if subject.any()}
    if not masks:
        raise F4xError(f"{clip.folder}: what moves is in none of the pictures; render another clip.")
    first = min(masks)
    found = prompted(scene, masks[first], first, label, encode, progress)
    found["moving"] = _whole(scene, scene.moving, "moving")
    found["truth"] = _whole(scene, lift_masks(scene, dict(enumerate(v[2] for v in views["original"])))[0], "truth")
    return {
        f"{name}_{edit}_{figure}_{kind}": scores[figure]
        for name, selection in found.items()
        for edit in EDITS
        for kind, shown in views.items()
        if shown
        for scores in [measure_edit(scene, selection, shown, edit, progress)]
        for figure in FIGURES
    }


def _whole(scene: Scene, scores: np.ndarray, label: str) -> Selection:
    """Return a selection of all times."""
    return Selection(scene.ids, np.asarray(scores, float), np.zeros(len(scene.ids), bool), THRESHOLD, None, label)
