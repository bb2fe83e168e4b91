"""Scene files as Blender sees them: what each held when it was last looked at, and the scenes that were read, with edits.

Scenes are known by path and hash of their arrays, edited ones also by their stack, so undo needs no cache update.
"""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Event, Thread
from typing import NamedTuple
from weakref import WeakKeyDictionary

import bpy

from ...f4x_core.edit.apply import edited
from ...f4x_core.edit.display import Display
from ...f4x_core.edit.stack import UNDONE, EditStack, read_stack, with_stack
from ...f4x_core.errors import F4xError
from ...f4x_core.progress import Progress, silent
from ...f4x_core.query.calibration import prepare
from ...f4x_core.query.following import draw_views
from ...f4x_core.query.inventory import words_there
from ...f4x_core.scene import Scene, StaticSet, read_header, read_scene
from ...f4x_core.scene.foreign import open_any
from ...f4x_core.scene.linear import NAMES as LINEAR_ARRAYS
from ...f4x_core.scene.linear import linear_scene
from ...f4x_core.scene.recognise import identify

NO_EDITS = "[]"
"""JSON of the empty stack."""
GROUPS = ("static/", "dynamic/", "scaffold/", "cameras/")
"""Arrays of a scene file whose names begin so and do not end in one of `ADDED` say which Gaussians it holds."""
ADDED = ("/latent", *(f"/{name}" for name in LINEAR_ARRAYS))
"""Ends of the names of arrays that may be added later: features, and the appearance for linear light."""
LOOK = 0.1
"""Seconds between two looks at a preparation that is waited for."""
FIRST = 2.0
"""Seconds after an import in which the window shows the scene before its preparation takes processor time from it."""
KEPT = 8
"""Number of scenes in the cache, including edited ones, so that switching a preview on and off is fast."""


class SceneFile(NamedTuple):
    """Header of a scene file, as every redraw needs it."""

    stamp: tuple[int, int]
    """Time of change in ns, and size in bytes."""
    arrays: str
    """Hash of all arrays."""
    gaussians: str
    """Hash of the arrays that stay the same when features and words are added."""
    edits: str
    """JSON of the edits."""
    holds_edits: bool
    """True for a `.f4x` scene; splats of another program are a scene whose edits stay in the .blend."""


class _Key(NamedTuple):
    """Key of a scene that is kept."""

    path: str
    arrays: str
    """Hash of all arrays of its file."""
    edits: str
    """JSON of its stack."""
    linear: bool = False
    """True with its appearance for linear light."""

    @property
    def unedited(self) -> _Key:
        """The key of the same scene without edits."""
        return self._replace(edits=NO_EDITS)


_files: dict[str, SceneFile] = {}  # path -> what it held when it was looked at last
_preparing: WeakKeyDictionary[StaticSet, Event] = WeakKeyDictionary()
"""Static set of a scene -> set when the neighbourhoods of the scene are known."""
_answers: WeakKeyDictionary[StaticSet, list[str]] = WeakKeyDictionary()
"""Static set of a scene -> words that something in the scene answers to, most first."""
_scenes: OrderedDict[_Key, Display] = OrderedDict()


def look_at(path: Path) -> SceneFile:
    """Return the content of a scene or splat file, from its header; read anew only when the file has changed."""
    try:
        found = path.stat()
    except OSError as error:
        raise F4xError(
            f"{path} cannot be read ({error.strerror}); put the scene file back, or import it again."
        ) from error
    stamp = (found.st_mtime_ns, found.st_size)
    file = _files.get(str(path))
    if file is None or file.stamp != stamp:
        file = _files[str(path)] = _look_at_scene(path, stamp) if _is_scene(path) else _look_at_splats(path, stamp)
    return file


def _is_scene(path: Path) -> bool:
    return identify(path, sequence=False) == "scene"


def _look_at_scene(path: Path, stamp: tuple[int, int]) -> SceneFile:
    arrays = read_header(path)["arrays"]
    same = {name: entry for name, entry in arrays.items() if name.startswith(GROUPS) and not name.endswith(ADDED)}
    return SceneFile(stamp, _hash(arrays), _hash(same), text_of(read_stack(path)), holds_edits=True)


def _look_at_splats(path: Path, stamp: tuple[int, int]) -> SceneFile:
    with path.open("rb") as file:
        content = hashlib.file_digest(file, "sha256").hexdigest()
    return SceneFile(stamp, content, content, NO_EDITS, holds_edits=False)


def displayed(path: Path, text: str) -> Display:
    """Return the scene of a file with the stack that `text` describes in place of its own; F4xError where the file is gone."""
    key = _Key(str(path), look_at(path).arrays, text)
    if key.unedited not in _scenes:
        opened(path)
    return _with_edits(key)


def displayed_linear(path: Path, text: str) -> Display:
    """Return the scene of `displayed` with its appearance for linear light (`f4x_core.scene.linear`)."""
    key = _Key(str(path), look_at(path).arrays, text, linear=True)
    if key.unedited not in _scenes:
        _scenes[key.unedited] = Display(linear_scene(displayed(path, NO_EDITS).scene))
    return _with_edits(key)


def _with_edits(key: _Key) -> Display:
    """Return the scene of `key`, made of the unedited one, which is kept; what was used longest ago is dropped."""
    if key not in _scenes:
        _scenes[key] = Display(edited(with_stack(_scenes[key.unedited].scene, stack_from(key.edits, key.path))))
    for used in (key.unedited, key):
        _scenes.move_to_end(used)
    while len(_scenes) > KEPT:
        _scenes.popitem(last=False)
    return _scenes[key]


def opened(path: Path) -> Scene:
    """Return the scene of a `.f4x` or splat file with the file's edits, which is read here; `displayed` then knows it without them.

    Raises F4xError for a missing, damaged or unsuitable file.
    """
    key = _Key(str(path), look_at(path).arrays, NO_EDITS)
    scene = read_scene(path) if _is_scene(path) else open_any(path, sequence=False)
    assert isinstance(scene, Scene)
    fields = {name: value for name, value in scene.extra_fields.items() if name != UNDONE}
    _scenes[key] = Display(replace(scene, edits=(), extra_fields=fields))
    return scene


def text_of(stack: EditStack) -> str:
    """Return the JSON of a stack."""
    return json.dumps(stack.to_json())


@lru_cache(maxsize=16)
def stack_from(text: str, owner: str) -> EditStack:
    """Return the stack that `text` describes; F4xError, which names the `owner`, if it is damaged. Every row of a list asks."""
    try:
        return EditStack.from_json(json.loads(text), owner)
    except ValueError as error:
        raise F4xError(f"{owner}: its stored edits are not valid JSON ({error}); import the scene again.") from error


def prepare_soon(scene: Scene) -> None:
    """Let `_prepare` begin when the window has shown the scene."""
    bpy.app.timers.register(lambda: _prepare(scene), first_interval=FIRST)


def _prepare(scene: Scene) -> None:
    """Compute in a thread what the first query needs: superpoints, neighbourhoods (seconds), words, then views of the clip."""
    if scene.static in _preparing:
        return
    ready = _preparing[scene.static] = Event()

    def work() -> None:
        try:
            prepare(scene)
        finally:
            ready.set()
        words, sure = words_there(scene)
        _answers[scene.static] = words if sure else []
        draw_views(scene)  # a query meanwhile draws what is not there yet

    Thread(target=work, daemon=True).start()


def answers_of(scene: Scene) -> list[str]:
    """Return words that something in the scene answers to, most first; none until its preparation has found them."""
    return _answers.get(scene.static, [])


def wait_until_prepared(scene: Scene, progress: Progress = silent) -> None:
    """Wait for the superpoints and neighbourhoods that `_prepare` computes, which begins here at the latest.

    `progress` says so meanwhile, and may stop the waiting; the preparation itself goes on for the next question.
    """
    if bpy.app.background:
        return  # the question itself prepares what it needs
    _prepare(scene)
    while not _preparing[scene.static].wait(LOOK):
        progress("prepare", 0, 0, "Preparing the scene once")


def forget() -> None:
    """Empty the caches: another .blend was opened."""
    _files.clear()
    _scenes.clear()
    _preparing.clear()
    _answers.clear()


def _hash(data: Mapping) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
