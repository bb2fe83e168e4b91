"""Scores edits: against true masks, over time, from a sentence to the file, and with a language model that fails."""

from __future__ import annotations

import json
import shutil
import tempfile
import threading
import time as clock
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from f4x_core.edit.apply import open_scene, with_operations
from f4x_core.edit.endpoint import ask_for_operations
from f4x_core.edit.judge import difference, dilate, flicker
from f4x_core.edit.operations import Delete, Recolour
from f4x_core.edit.plan import apply, propose
from f4x_core.edit.request import Request
from f4x_core.edit.resolve import EditorState
from f4x_core.edit.selects import All, Ids, Moving, Not
from f4x_core.errors import F4xError
from f4x_core.geometry.arrays import evenly_spaced
from f4x_core.geometry.camera import Camera
from f4x_core.progress import Progress, silent
from f4x_core.query.chat import MAX_ANSWER_BYTES, ChatServer
from f4x_core.query.engines import Engines
from f4x_core.query.labels import Encode
from f4x_core.query.prompts import SelectOptions, select_by_mask, select_by_points, select_by_text
from f4x_core.query.score import overlap
from f4x_core.query.selection import Selection
from f4x_core.scene import Scene, read_scene
from f4x_core.scene.view import render

TrueView = tuple[Camera, float, np.ndarray, np.ndarray]
"""A camera, its clip time, (H,W) bool where the thing is, (H,W) bool where that is known."""
MARKER = (1.0, 0.0, 1.0)
"""Colour by which changed pixels are found: hardly a filmed thing has it."""
HALF = 0.5
"""A pixel has changed when it has by half of what it would if everything were edited."""
SEEN = 0.06
"""Difference of a colour in [0, 1] from which something is seen to be gone; what is behind may look much the same. With the
true Gaussians of rendered clips the overlap is greatest from 0.05 to 0.08 and the same within 0.01."""
RIM = 0.01
"""Widths of the picture around a true mask in which its outline does not say what is inside: drawn by hand, or blended."""
MEASURED = 10
"""Frames with a true mask that are measured, evenly over the clip."""
WINDOW = 8
"""Frames over which flicker is measured."""
EMPTY = "Every mask is empty; give masks that show the thing."
PATIENCE = 0.5
"""Seconds after which a faulty server is given up."""


def benchmark(
    path: Path,
    masks: Mapping[int, np.ndarray] | None = None,
    label: str | None = None,
    encode: Encode | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """All figures of the scene file at `path`; `masks` (clip frame -> (H,W) bool) show what `label` names."""
    scene = open_scene(path)
    thing = f"the {label}" if label else "what moves"
    report: dict[str, Any] = {"scene": scene.name} | time_sentence(path, f"make {thing} red", encode)
    report["still_flicker"] = measure_flicker(scene)
    if masks is not None:
        filled = [frame for frame, mask in masks.items() if mask.any()]
        if not filled:
            raise F4xError(EMPTY)
        shown = {filled[i]: masks[filled[i]] for i in evenly_spaced(len(filled), MEASURED)}
        first = filled[0]
        views = [
            (scene.cameras[t], float(scene.cameras.times[t]), mask, np.ones_like(mask)) for t, mask in shown.items()
        ]
        for name, selection in prompted(scene, masks[first], first, label, encode, progress).items():
            rows = measure_edit(scene, selection, views, progress=progress)
            report |= {f"{name}_{figure}": value for figure, value in rows.items()}
    return report


def prompted(
    scene: Scene,
    mask: np.ndarray,
    frame: int,
    label: str | None = None,
    encode: Encode | None = None,
    progress: Progress = silent,
) -> dict[str, Selection]:
    """Selections by each kind of prompt for the object under the bool `mask (H,W)` on clip frame `frame`.

    `mask`: by that mask; `point`: by a click into its middle; `text`: by the word `label`.
    """
    options = SelectOptions(progress=progress)
    found = {
        "mask": select_by_mask(scene, mask, frame, options),
        "point": select_by_points(scene, [innermost(mask)], frame, options=options),
    }
    if label is not None:
        found["text"] = select_by_text(scene, [label], encode=encode)
    return found


def innermost(mask: np.ndarray) -> tuple[float, float]:
    """Return (x, y) in pixels of a place that lies as deep inside bool `mask (H,W)` as any: what a person would click."""
    inside = mask
    while (smaller := ~dilate(~inside)).any():
        inside = smaller
    rows, columns = np.nonzero(inside)
    middle = len(rows) // 2
    return float(columns[middle]) + 0.5, float(rows[middle]) + 0.5


def measure_edit(
    scene: Scene, selection: Selection, views: Iterable[TrueView], edit: str = "recolour", progress: Progress = silent
) -> dict[str, float]:
    """Measure what an edit of `selection` changes in `views`, against the true masks of the thing, where these are known.

    `edit`: `recolour` dyes, and a pixel has changed by `HALF` of what it would if everything were dyed; after `delete` it has
    changed by `SEEN`. `iou`: of changed pixels with the mask, mean over the views whose mask is not empty, and `iou_worst`.
    `coverage`: share of the mask that changed. `leakage`: share of all change beyond the mask and a rim of 1 % of the
    width; `leakage_strict` without the rim.
    """
    who = Ids.of(selection.chosen_ids)
    edited = with_operations(scene, Delete(who) if edit == "delete" else Recolour(who, MARKER))
    dyed = with_operations(scene, Recolour(All(), MARKER))
    rows: list[list[float]] = []
    for camera, time, mask, known in views:
        progress(edit, len(rows), 0)
        if not (mask & known).any():
            continue
        before, after = (render(one, camera, time, ("rgb",))["rgb"] for one in (scene, edited))
        change = difference(before, after)
        needed: float | np.ndarray = SEEN
        if edit == "recolour":
            needed = HALF * np.maximum(difference(before, render(dyed, camera, time, ("rgb",))["rgb"]), 1e-3)
        near = mask
        for _ in range(max(1, round(RIM * camera.width))):
            near = dilate(near)
        changed, mask, near, change = (values[known] for values in (change > needed, mask, near, change))
        total = max(float(change.sum()), 1e-9)
        leaks = [float(change[~inside].sum()) / total for inside in (near, mask)]
        rows.append([overlap(changed, mask), float(changed[mask].mean()), *leaks])
    if not rows:
        raise F4xError(EMPTY)
    names = ("iou", "coverage", "leakage", "leakage_strict")
    return dict(zip(names, map(float, np.mean(rows, 0)), strict=True)) | {"iou_worst": min(row[0] for row in rows)}


def measure_flicker(scene: Scene) -> float:
    """`judge.flicker` of the static Gaussians when they are painted, over `WINDOW` frames in the middle of the clip.

    Seen through the clip's own cameras; only pixels that stand still in all of them count.
    """
    still = Not(Moving())
    after = with_operations(scene, Recolour(still, (1.0, 0.0, 0.0), keep_luminance=True))
    cameras, static = scene.cameras, 1 - scene.moving[:, None].astype(np.float32)
    middle = max(0, (len(cameras) - WINDOW) // 2)
    frames = range(middle, min(middle + WINDOW, len(cameras)))
    old, new, static_weights = [], [], []
    for t in frames:
        time = float(cameras.times[t])
        drawn = render(scene, cameras[t], time, ("rgb",), values={"static": static})
        old.append(drawn["rgb"])
        static_weights.append(drawn["static"][..., 0])
        new.append(render(after, cameras[t], time, ("rgb",))["rgb"])
    return flicker(np.stack(old), np.stack(new), np.min(static_weights, 0) > 0.9)


def time_sentence(path: Path, sentence: str, encode: Encode | None = None) -> dict[str, Any]:
    """Seconds from a sentence to the applied edit in a copy of the scene file at `path`, no model asked."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        shutil.copyfile(path, copy)
        start = clock.perf_counter()
        scene = read_scene(copy)
        opened = clock.perf_counter()
        proposal = propose(scene, sentence, EditorState(), Engines(encode=encode))
        understood = clock.perf_counter()
        apply(copy, proposal.chosen)
        end = clock.perf_counter()
    return {
        "gaussians": len(scene.ids),
        "open_s": opened - start,
        "propose_s": understood - opened,
        "apply_s": end - understood,
        "sentence_s": end - opened,
    }


def try_faults() -> dict[str, str]:
    """Fault of `_FAULTS` -> the error message when a language model's server fails in this way.

    Raises AssertionError where a fault gives operations or another exception than F4xError.
    """
    messages = {}
    for name, reply in _FAULTS.items():
        with _faulty(*reply) as url:
            try:
                operations = ask_for_operations(ChatServer(url, timeout=PATIENCE), Request("make it red", ("dog",)))
            except F4xError as error:
                messages[name] = str(error).replace(url, "URL")
            else:
                raise AssertionError(f"the fault '{name}' became {operations}")
    return messages


def _chat(text: str) -> bytes:
    return json.dumps({"choices": [{"message": {"content": text}}]}).encode()


_FAULTS: dict[str, tuple[int, bytes, float]] = {
    "error 500": (500, b"out of memory", 0),
    "error 400 to every way to ask": (400, b"unsupported", 0),
    "redirect": (307, b"", 0),
    "no JSON": (200, b"<html>", 0),
    "no chat": (200, b"{}", 0),
    "prose": (200, _chat("I would love to!"), 0),
    "another schema": (200, _chat('{"action": "delete"}'), 0),
    "asks for files": (200, _chat('{"operations": [{"op": "read_file", "path": "/etc/passwd"}]}'), 0),
    "larger than any chat": (200, b" " * (MAX_ANSWER_BYTES + 1), 0),
    "silence": (200, _chat("{}"), 2 * PATIENCE),
}
"""Status, body and seconds of silence before them."""


@contextmanager
def _faulty(status: int, body: bytes, wait: float) -> Iterator[str]:
    """The address of a server on this machine that answers every request so."""
    over = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            over.wait(wait)
            try:
                self.send_response(status)
                self.send_header("Location", "http://127.0.0.1:9/")
                self.end_headers()
                self.wfile.write(body)
            except OSError:  # the client has given up, as it should
                pass

        def log_message(self, *args: Any) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/v1"
    finally:
        over.set()
        server.shutdown()
        thread.join()
        server.server_close()
