"""Masks to select by that are empty, full, or of another shape.

Hard: a mask without a pixel, one with all pixels, and one of another aspect.

Why: the share of a Gaussian's light in nothing is 0/0; an empty selection is a full one turned over.

Must hold: nothing from nothing or a sentence, nearly all from all, another aspect refused.
"""

import numpy as np

from benchmarks.studies.hard_cases import Check, refused, that
from f4x_core.errors import F4xError
from f4x_core.query.prompts import select_by_mask

from .scene_of_one_and_of_a_thousand_frames import scene_of

STAGE = "query"


def check():
    from dataclasses import replace

    scene = scene_of(3)
    ahead = replace(scene.dynamic, means=scene.dynamic.means * 0.2 + np.float32([0.3, 0.2, 2]))
    lens = np.tile(np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]]), (3, 1, 1))
    scene = replace(scene, dynamic=ahead, cameras=replace(scene.cameras, intrinsics=lens))
    full = select_by_mask(scene, np.ones((40, 64), bool), 1)
    yield that("all from all", full.chosen.mean() >= 0.8)
    try:
        empty = select_by_mask(scene, np.zeros((40, 64), bool), 1)
        yield that("nothing from nothing", not empty.chosen.any())
    except F4xError as reason:
        yield Check("nothing from nothing", "refused", message=str(reason))
    yield refused("another aspect", "in its proportions", lambda: select_by_mask(scene, np.ones((40, 40), bool), 1))
