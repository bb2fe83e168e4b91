"""Two squares that move side by side before a wall, each with a shadow below it."""

from dataclasses import replace

import numpy as np
from labelled_scene import HALF
from test_query_objects import scene_with_ripples

from f4x_core.scene import DynamicSet

APART = 3.2 * HALF
"""World units from one square to the other, along x."""


def two_with_shadows():
    """The scene, then (N,) bool of the first square, of its shadow, of the second square and of its shadow."""
    scene, square = scene_with_ripples()
    own = scene.dynamic
    count, still = len(own), len(scene.static)
    more = {
        name: np.concatenate([value, value]) if isinstance(value, np.ndarray) and len(value) == count else value
        for name, value in vars(own).items()
    }
    more["ids"] = np.concatenate([own.ids, own.ids.max() + 1 + np.arange(count)])
    aside = np.float32([APART / 2, 0, 0])
    more["means"] = np.concatenate((own.means - aside, own.means + aside))
    scene = replace(scene, dynamic=DynamicSet(**more), next_id=0)
    rows = np.arange(len(scene.ids))
    squares = np.concatenate([square, square[still:]])
    first = (rows >= still) & (rows < still + count)
    second = rows >= still + count
    return scene, first & squares, first & ~squares, second & squares, second & ~squares
