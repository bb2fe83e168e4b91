"""Scores selections by marks on the first frame: DAVIS' own measures J and F of mattes in all frames of the original view.

Perazzi et al., A benchmark dataset and evaluation methodology for video object segmentation, CVPR 2016: J is the intersection
over union of regions, F the harmonic mean of precision and recall of their outlines, of which those count as found that lie
within 0.008 of the picture's diagonal. DAVIS leaves the first and the last frame out of its means; here all frames count.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np

from f4x_core.edit.naming import by_words
from f4x_core.errors import F4xError
from f4x_core.geometry.trajectory import View
from f4x_core.progress import Progress, silent
from f4x_core.query.cast import moving_things
from f4x_core.query.labels import Encode
from f4x_core.query.marks import Lasso, Mask
from f4x_core.query.matte import matte_image, mattes
from f4x_core.query.pixels import SHOWN
from f4x_core.query.prompts import select_by_box, select_by_evidence, select_by_mask, select_by_points
from f4x_core.query.score import overlap
from f4x_core.query.selection import Selection
from f4x_core.scene import Scene

BOUND = 0.008
"""Of the picture's diagonal: how far an outline may be from the true one (DAVIS)."""
MIN_DEPTH = 3.0
"""Pixels from a part's outline to its innermost pixel at least; of what is thinner no hand would hit the rest."""
PUBLISHED = {"OSVOS": (0.798, "Caelles et al., CVPR 2017"), "OFL": (0.680, "Tsai, Yang and Black, CVPR 2016")}
"""Method that is given the first frame's mask -> mean J over DAVIS 2016's 20 validation clips, and where that is said."""


def boundary_f(mask: np.ndarray, truth: np.ndarray) -> float:
    """Return F of bool `mask (H,W)` against `truth (H,W)`, in [0, 1]; 1 where both are empty."""
    reach = int(np.ceil(BOUND * np.hypot(mask.shape[0], mask.shape[1])))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = (x * x + y * y <= reach * reach).astype(np.uint8)
    own, true = outline(mask), outline(truth)
    near_own, near_true = (cv2.dilate(line.astype(np.uint8), disc) > 0 for line in (own, true))
    if not own.any() or not true.any():
        return float(own.any() == true.any())
    precision, recall = (own & near_true).sum() / own.sum(), (true & near_own).sum() / true.sum()
    return float(2 * precision * recall / (precision + recall)) if precision + recall else 0.0


def outline(mask: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: pixels whose right, lower or lower right neighbour is on the other side (DAVIS' seg2bmap)."""
    padded = np.pad(mask, ((0, 1), (0, 1)), mode="edge")
    return (mask != padded[:-1, 1:]) | (mask != padded[1:, :-1]) | (mask != padded[1:, 1:])


def depths(mask: np.ndarray) -> np.ndarray:
    """Return (H,W) float32: the distance in pixels from the outline of bool `mask (H,W)`, 0 outside of it."""
    deep: np.ndarray = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    return deep


def innermost(mask: np.ndarray) -> tuple[float, float]:
    """Return x, y of the pixel farthest from the outline of bool `mask (H,W)`: where a hand would click."""
    deep = depths(mask)
    y, x = np.unravel_index(deep.argmax(), deep.shape)
    return float(x) + 0.5, float(y) + 0.5


def largest_error(drawn: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, bool] | None:
    """Return the largest connected part (H,W) bool that `drawn (H,W)` bool has wrong, and True where it is missing.

    None where none is `MIN_DEPTH` deep.
    """
    parts = []
    for wrong, missing in ((truth & ~drawn, True), (drawn & ~truth, False)):
        count, label = cv2.connectedComponents(wrong.astype(np.uint8))
        parts += [(label == number, missing) for number in range(1, count)]
    deep = [each for each in parts if depths(each[0]).max() >= MIN_DEPTH]
    return max(deep, key=lambda each: int(each[0].sum()), default=None)


def corrected(scene: Scene, truth: np.ndarray, frame: int, clicks: int, backend: str = "auto") -> Selection:
    """Select by up to so many `clicks` on clip frame `frame`: inside `truth (H,W)` bool, then in the `largest_error` each time."""
    points, on = [innermost(truth)], [True]
    while True:
        found = select_by_points(scene, points, frame, on)
        drawn = matte_image(scene, found, scene.cameras[frame], float(scene.cameras.times[frame]), backend) > SHOWN
        error = largest_error(drawn, truth)
        if error is None or len(points) == clicks:
            return found
        points.append(innermost(error[0]))
        on.append(error[1])


def box_of(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Return left, top, right, bottom around bool `mask (H,W)`."""
    rows, columns = np.nonzero(mask)
    return int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1


def moving_ones(scene: Scene) -> Selection:
    """Select the moving objects without shadows and the like; nothing is marked."""
    return Selection(scene.ids, moving_things(scene).astype(float), np.zeros(len(scene.ids), bool))


def ways(
    scene: Scene, mask: np.ndarray, frame: int, label: str | None, encode: Encode | None
) -> dict[str, Callable[[], Selection]]:
    """Return way to select -> the search, from the true `mask (H,W)` on clip frame `frame`; by `label`, too, where it is a word."""
    found: dict[str, Callable[[], Selection]] = {
        "mask": partial(select_by_mask, scene, mask, frame),
        "mask on the graph": partial(select_by_evidence, scene, [Mask(frame, True, mask)]),
        "click": partial(select_by_points, scene, [innermost(mask)], frame),
        "three clicks": partial(corrected, scene, mask, frame, 3),
        "box": partial(select_by_box, scene, box_of(mask), frame),
        "nothing": partial(moving_ones, scene),
    }
    if label is not None:
        found["word"] = lambda: by_words(scene, [label], encode=encode)[label]
    return found


def score_selecting(
    scene: Scene,
    masks: Mapping[int, np.ndarray],
    label: str | None = None,
    encode: Encode | None = None,
    backend: str = "auto",
    progress: Progress = silent,
) -> dict[str, dict[str, float | str]]:
    """Return way to select -> `J`, `F` (means over bool `masks`, frame -> (H,W)), `worst J`, `seconds`; or `refused`: why not."""
    first = min(frame for frame, mask in masks.items() if mask.any())
    rows: dict[str, dict[str, float | str]] = {}
    selections = {}
    for name, search in ways(scene, masks[first], first, label, encode).items():
        start = perf_counter()
        try:
            selections[name] = search()
            rows[name] = {"seconds": perf_counter() - start}
        except F4xError as error:
            rows[name] = {"refused": str(error)}
    chosen = np.stack([each.chosen for each in selections.values()], 1)
    scores = []
    for done, (frame, mask) in enumerate(masks.items()):
        progress("select", done, len(masks))
        time = float(scene.cameras.times[frame])
        drawn = mattes(scene, chosen, View(scene.cameras[frame], time), backend) > SHOWN
        scores.append([(overlap(one, mask), boundary_f(one, mask)) for one in np.moveaxis(drawn, -1, 0)])
    for name, own in zip(selections, np.moveaxis(np.array(scores), 1, 0), strict=True):
        rows[name] |= {"J": float(own[:, 0].mean()), "F": float(own[:, 1].mean()), "worst J": float(own[:, 0].min())}
    return rows


def score_things(scene: Scene, file: Path, clip: str, backend: str = "auto") -> Iterator[dict[str, Any]]:
    """Yield the IoU, on its own frame, of a click, up to three and a box on each hand-drawn static thing of `clip` in `file`.

    `file`: a JSON list of `clip`, `frame`, `name` and `outline` [[x, y], ...] in pixels of the clip's pictures.
    """
    size = (scene.cameras.height, scene.cameras.width)
    for thing in json.loads(file.read_text(encoding="utf-8")):
        if thing["clip"] != clip:
            continue
        frame, mask = thing["frame"], Lasso(thing["frame"], True, thing["outline"]).pixels(size)
        row: dict[str, Any] = {"thing": thing["name"]}
        for name in ("click", "three clicks", "box"):
            found = ways(scene, mask, frame, None, None)[name]()
            drawn = matte_image(scene, found, scene.cameras[frame], float(scene.cameras.times[frame]), backend) > SHOWN
            row[name] = overlap(drawn, mask)
        yield row
