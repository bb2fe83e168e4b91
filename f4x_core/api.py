"""Functions of `import f4x_core`: draw a scene, select in it, ask it, edit it. Needs numpy alone.

Every function sees the scene with its edits, those that `read_scene` found in the file included. Nothing is sent anywhere:
words are read by the grammar and questions are answered by computing, on this machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .edit.apply import edited
from .geometry.camera import Camera
from .query.score import THRESHOLD
from .scene import Scene, view
from .scene.posing import require_time

if TYPE_CHECKING:  # each function imports what it alone needs: who draws needs no grammar
    from .query.questions import Answer
    from .query.selection import Selection

__all__ = ["ask", "edit_scene", "render", "select"]


def render(
    scene: Scene,
    time: float = 0.0,
    camera: Camera | None = None,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    backend: str = "auto",
) -> np.ndarray:
    """Draw the scene at one moment.

    Args:
        scene: the scene; its edits are drawn too.
        time: clip frame, from 0; may lie between two frames.
        camera: where it is seen from, in world units (1 = median depth), and the size of the image. None is the clip's own
            camera at `time`; `scene.cameras.at(12).resized(960, 540)` is that of frame 12 at another size.
        background: red, green and blue in 0..1 behind the Gaussians.
        backend: what draws, see `rasterize`.

    Returns:
        (H, W, 3) float32 sRGB; 0 is black and 1 white, and highlights may exceed 1. Other channels, such as depth:
        `f4x_core.scene.view.render`.

    Raises:
        F4xError: a time outside the clip, an edit that cannot be applied, or a backend that cannot run here.
    """
    require_time(scene, time, f"time T = {time:g}")
    camera = scene.cameras.at(time) if camera is None else camera
    images = view.render(edited(scene), camera, time, ("rgb", "alpha"), backend)
    return view.over_background(images, background)


def select(
    scene: Scene,
    text: str,
    negatives: str | None = None,
    threshold: float = THRESHOLD,
    *,
    span: tuple[float, float] | None = None,
) -> Selection:
    """Select the Gaussians that words mean, as `f4x query --text` does.

    Args:
        scene: a scene with a feature field (`f4x distill`), or with names that edits gave.
        text: a word, or several with commas between them: "dog" or "dog, cat".
        negatives: words that `text` is weighed against, with commas; None is what the field is usually weighed against.
        threshold: smallest score of a chosen Gaussian, 0..1.
        span: first and last clip frame at which the selection holds; None is always.

    Returns:
        The selection: `.chosen (N,) bool`, `.scores (N,)` in 0..1 and `.ids (N,) int64`, in the order of the Gaussians of
        `scene.posed(time)` with its edits. Nothing is chosen where nothing answers to the words.

    Raises:
        F4xError: an empty text, a scene without words, a word that nobody knows, or a threshold outside 0..1.
    """
    from .app.selecting import Wanted
    from .app.selecting import select as select_wanted
    from .query.labels import words_of

    weighed = None if negatives is None else tuple(words_of(negatives))
    return select_wanted(scene, Wanted(tuple(words_of(text)), weighed, threshold=threshold, span=span)).selection


def ask(scene: Scene, question: str, selection: Selection | None = None, *, backend: str = "auto") -> Answer:
    """Answer a question about the clip from the words, places and motion in the scene, as `f4x ask` does.

    Args:
        scene: the scene; without a feature field it knows only motion and the names that edits gave.
        question: plain English, for example "What moves?" or "Where is the dog at second 2?".
        selection: what "it" in the question means.
        backend: what draws the views that are looked at, see `rasterize`.

    Returns:
        The answer: `.text` for people, `.evidence` as JSON values with what was seen where and when, and `.answered_by`.

    Raises:
        F4xError: an empty question, one that cannot be computed, a word that nobody knows, or a time outside the clip.
    """
    from .app.asking import AskOptions
    from .app.asking import ask as ask_scene

    return ask_scene(scene, question, AskOptions(selection), backend)


def edit_scene(scene: Scene, sentence: str, selection: Selection | None = None, *, time: float = 0.0) -> Scene:
    """Edit a scene by a sentence, as `f4x edit --say` does.

    Args:
        scene: the scene, which stays as it is; the sentence is added to the edits that it has.
        sentence: plain English, for example "make the dog red from second 2"; docs/language.md lists what can be said.
        selection: what "it" means in the sentence, for example what `select` returns.
        time: clip frame of "now" and "here", from 0.

    Returns:
        A new scene with the edit applied and recorded. `write_scene` keeps it with its edits, which can be undone later;
        the Gaussians of the fit are written as they are.

    Raises:
        F4xError: a sentence that is not understood (it names the nearest commands), nothing that answers to its words, or
            a time outside the clip.
    """
    from .app.editing import EditRequest, propose_edit
    from .edit.plan import preview
    from .edit.resolve import EditorState

    request = EditRequest(sentence, state=EditorState(selection, time))
    return preview(scene, propose_edit(scene, request).chosen)
