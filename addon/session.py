"""The state of an imported scene: its core `Scene`, its pending edits, its point clouds, and which point is which Gaussian.

The state is stored in the .blend on the scene's root empty, so that Blender's Undo covers it:

    f4x_path     the scene file
    f4x_arrays   hash of the file's Gaussians at import: the file has to hold the same ones
    f4x_edits    JSON of the pending stack
    f4x_saved    JSON of the stack that the file held when this scene last read or wrote it
    f4x_preview  JSON of a stack that is only previewed; absent otherwise

Undo rolls these back, but not the file. So whether edits are saved is read in the file, and `f4x_saved` counts only after a
.blend was opened: until then `_synced` has it, which undo does not touch.

Scenes are cached by path and hash of their arrays, edited scenes also by their stack, so undo needs no cache update.
Gaussians are known by their id, the point attribute `gid`, so points may be deleted, split off and copied in Blender.
"""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import bpy
import numpy as np

from ..f4x_core.edit.apply import EditedScene, edited
from ..f4x_core.edit.display import Display
from ..f4x_core.edit.operations import Operation, read_operation
from ..f4x_core.edit.resolve import EditorState, resolve
from ..f4x_core.edit.selects import MAX_WORDS_LENGTH, Ids
from ..f4x_core.edit.stack import UNDONE, EditStack, merge, read_stack, with_stack, write_stack
from ..f4x_core.errors import F4xError
from ..f4x_core.language.lexicon import plural
from ..f4x_core.query.calibration import prepare
from ..f4x_core.query.selection import Selection
from ..f4x_core.scene import Scene, read_header, read_scene
from . import packing
from .packing import PACKED, pack, unpacked
from .point_cloud import read_attribute, write_attribute

PATH, ARRAYS, EDITS, SAVED, PREVIEW = "f4x_path", "f4x_arrays", "f4x_edits", "f4x_saved", "f4x_preview"
APART = "f4x_apart"
"""Property of the separate cloud for Gaussians whose motion is edited: moved, retimed and copied ones."""
SELECTED, BEFORE, SCORE = ".selection", "f4x_before", "f4x_score"
"""Point attributes: the selection (Blender's own name), the selection before the last query, and the query's scores."""
TIMED = "f4x_timed"
"""Property of a root whose edits change over time, so that its clouds are updated at every frame."""
MOVED = 3
"""Number of folders above a .blend in which a moved scene file is searched."""
NO_EDITS = "[]"
"""JSON of the empty stack."""
GROUPS = ("static/", "dynamic/", "scaffold/", "cameras/")
"""Arrays of a scene file whose names begin so and do not end in `LATENT` say which Gaussians it holds."""
LATENT = "/latent"
"""End of the names of arrays that belong to features, which may be added later."""
KEPT = 4
"""Number of scenes in the cache, including edited ones, so that switching a preview on and off is fast."""


class _File(NamedTuple):
    """What is needed of a scene file at every redraw, from its header."""

    stamp: tuple[int, int]
    """Time of change in ns, and size in bytes."""
    arrays: str
    """Hash of all arrays."""
    gaussians: str
    """Hash of the arrays that stay the same when features and words are added."""
    edits: str
    """JSON of the edits."""


_files: dict[str, _File] = {}  # path -> what it held when it was looked at last
_synced: dict[int, str] = {}  # session_uid of a root -> JSON of the stack that the file held when the root last met it
_preparing: dict[int, Thread] = {}  # id of a scene's static set -> who works out its neighbourhoods
_scenes: OrderedDict[tuple[str, str, str], Display] = OrderedDict()


def root_of(item: bpy.types.Object | None) -> bpy.types.Object | None:
    """The root empty of the scene that `item` is a part of; where it is of none, the only one that there is."""
    while item is not None and PATH not in item:
        item = item.parent
    if item is not None:
        return item
    roots = [other for other in bpy.context.scene.objects if PATH in other]
    return roots[0] if len(roots) == 1 else None


def is_linked(root: bpy.types.Object) -> bool:
    """Whether a scene belongs to another .blend, as a link or a library override: it plays, but cannot be changed here."""
    clouds = (item.data for item in root.children if item.type == "POINTCLOUD")
    return any(item.library or item.override_library for item in (root, *clouds))


def why_not(item: bpy.types.Object | None) -> str:
    """What an operator on the scene of `item` says where it cannot work; nothing where it can."""
    root = root_of(item)
    if root is None:
        return "Import a Feature4X scene, or select one of its objects"
    if is_linked(root):
        return f"{root.name} belongs to another .blend; change it there, or use Object > Relations > Make Local > All first"
    return ""


def path_of(root: bpy.types.Object) -> Path:
    """The scene file, which may be given relative to the .blend.

    Where both were moved, it is looked for near the .blend; where there is none, what was packed into the .blend is written out.
    """
    path = Path(bpy.path.abspath(root[PATH]))
    if path.exists():
        return path
    above = list(Path(bpy.data.filepath).parents)[:MOVED] if bpy.data.filepath else []
    tails = [Path(*path.parts[-count:]) for count in range(1, len(path.parts))]
    near = next((place for folder in above for tail in tails if (place := folder / tail).is_file()), None)
    return near or unpacked(root) or path


def relink(root: bpy.types.Object, path: Path) -> None:
    """Let the scene file of `root` be `path`; F4xError where it holds other Gaussians."""
    before, root[PATH] = root[PATH], str(path)
    try:
        _check_arrays(root)
    except F4xError:
        root[PATH] = before
        raise


def attach(root: bpy.types.Object) -> None:
    """Take over the scene file's edits and remember its arrays: after an import, or when a job has written the file."""
    path = path_of(root)
    file = _look_at(path)
    root[ARRAYS], root[EDITS] = file.gaussians, file.edits
    _meet(root, file.edits)
    if PACKED in root:
        pack(root, path)
    if not bpy.app.background:
        _prepare(base_scene(root))


def stack_of(root: bpy.types.Object) -> EditStack:
    """The pending stack."""
    return _parsed(root, _pending(root))


def set_stack(root: bpy.types.Object, stack: EditStack) -> None:
    """Make `stack` the pending one after checking it; F4xError leaves the old one. Callers then use `display.refresh`."""
    text = _text(stack)
    _display(root, text)
    root[EDITS] = text
    show_preview(root, None)


def show_preview(root: bpy.types.Object, stack: EditStack | None) -> None:
    """Preview `stack` in place of the pending one; None ends the preview."""
    if stack is not None:
        root[PREVIEW] = _text(stack)
    elif PREVIEW in root:
        del root[PREVIEW]


def is_saved(root: bpy.types.Object) -> bool:
    """Whether the scene file holds the pending edits; where it is missing, whether it did when it was last seen."""
    try:
        return _pending(root) == _look_at(path_of(root)).edits
    except F4xError:
        return root.get(EDITS) == _met(root)


def saving(root: bpy.types.Object) -> str:
    """What saving the edits would do, as the label of its button."""
    try:
        return "Edits Saved" if is_saved(root) else _saving(*_texts(root))
    except F4xError:
        return "Save Edits to Scene"  # and pressing it says what is wrong


def save(root: bpy.types.Object) -> EditStack:
    """Write the pending edits into the scene file, atomically, merged with what others wrote there in between.

    What the scene once had in the file and has no more, by undo too, is taken out of the file.
    Raises F4xError: the file is missing or holds other Gaussians, or both sides changed the same edit.
    """
    path = path_of(root)
    _check_arrays(root)
    ours, met, theirs = stack_of(root), _parsed(root, _met(root)), read_stack(path)
    stack = ours if theirs.edits == met.edits else merge(met, ours, theirs)
    if stack.edits != theirs.edits:
        write_stack(path, stack)
        if PACKED in root:
            pack(root, path)
    set_stack(root, stack)
    _meet(root, root[EDITS])
    return stack


def remember(root: bpy.types.Object) -> None:
    """Put into the .blend, which is about to be saved, what the file held when the scene last met it."""
    root[SAVED] = _met(root)


def base_scene(root: bpy.types.Object) -> Scene:
    """The scene without its edits."""
    return _display(root, NO_EDITS).scene


def asked_scene(root: bpy.types.Object) -> Scene:
    """The scene without its edits, with the caches for text queries filled, so that the first query is fast."""
    scene = base_scene(root)
    if id(scene.static) in _preparing:
        _preparing.pop(id(scene.static)).join()
    return scene


def edited_scene(root: bpy.types.Object) -> Scene:
    """The scene with the pending edits."""
    return _display(root, _pending(root)).scene


def shown(root: bpy.types.Object) -> Display:
    """The scene that the viewport shows: with the preview if there is one, else with the pending edits."""
    return _display(root, root.get(PREVIEW) or _pending(root))


def frame_of(root: bpy.types.Object) -> float:
    """The current clip frame, clamped to the clip."""
    scene = bpy.context.scene
    return shown(root).time(scene.frame_current + scene.frame_subframe)


def clouds_of(root: bpy.types.Object) -> list[bpy.types.Object]:
    """The point clouds of the scene; the separate cloud of edited Gaussians comes last."""
    clouds = [item for item in root.children_recursive if item.type == "POINTCLOUD" and "gid" in item.data.attributes]
    return sorted(clouds, key=lambda item: APART in item)


def points(root: bpy.types.Object) -> Iterator[tuple[bpy.types.Object, np.ndarray, np.ndarray]]:
    """(cloud, points (m,), Gaussians (m,)): which points of a cloud are which rows of the shown scene's `posed`."""
    display = shown(root)
    for cloud in clouds_of(root):
        row, known = display.rows_of(read_attribute(cloud.data, "gid"))
        at = np.flatnonzero(known)
        yield cloud, at, row[at]


def read(root: bpy.types.Object, name: str) -> np.ndarray:
    """(N,) values of a point attribute by Gaussian; 0 without a point. Points of the separate cloud take precedence."""
    values = np.zeros(len(shown(root).scene.ids), np.float32 if name == SCORE else bool)
    for cloud, at, row in points(root):
        found = read_attribute(cloud.data, name)
        values[row] = 0 if found is None else found[at]
    return values


def write(root: bpy.types.Object, **attributes: tuple[str, np.ndarray]) -> None:
    """Write point attributes, name -> (type, (N,) values by Gaussian), to every point that shows one of them."""
    for cloud, at, row in points(root):
        for name, (kind, values) in attributes.items():
            new = np.zeros(len(cloud.data.points), values.dtype)
            new[at] = values[row]
            write_attribute(cloud.data, name, kind, new)
        cloud.data.update_tag()


def selection(root: bpy.types.Object) -> Selection | None:
    """Selection among the shown Gaussians, with the scene's time span; None where nothing is selected."""
    chosen = read(root, SELECTED)
    if not chosen.any():
        return None
    span = (float(root.f4x.first), float(root.f4x.last)) if root.f4x.use_span else None
    ids = shown(root).scene.ids
    return Selection(ids, chosen.astype(float), np.zeros(len(ids), bool), span=span, label=root.f4x.text)


def context_of(root: bpy.types.Object) -> EditorState:
    """The selection and the frame that "it" and "now" in a sentence refer to."""
    return EditorState(selection(root), frame_of(root))


def selected_ids(root: bpy.types.Object) -> Ids:
    """The selected Gaussians as a stack holds them; F4xError where there are none."""
    chosen = selection(root)
    if chosen is None:
        raise F4xError("Nothing is selected; use Query, Point or Box, or select points in Edit Mode.")
    ids, state = Ids.of(chosen.chosen_ids), root.f4x
    # points may have been selected in edit mode since, and then they are not what was asked for
    return replace(ids, words=state.called[:MAX_WORDS_LENGTH]) if chosen.chosen.sum() == state.selected else ids


def append(root: bpy.types.Object, *operations: Operation, sentence: str = "") -> EditStack:
    """Resolve operations as `f4x edit` does and append them to the pending stack; F4xError leaves the stack unchanged."""
    context = context_of(root)
    stack = stack_of(root)
    for operation in operations:
        scene = edited(with_stack(base_scene(root), stack))
        stack = stack.append(resolve(scene, operation, context), sentence)
    set_stack(root, stack)
    return stack


def names_of(root: bpy.types.Object) -> Mapping[str, np.ndarray]:
    """Name -> (n,) rows of the shown scene, for everything that an edit has named."""
    scene = shown(root).scene
    return scene.rows.names if isinstance(scene, EditedScene) else {}


def with_reading(root: bpy.types.Object) -> EditStack:
    """The pending stack with the reading of the sentence that is picked in the panel."""
    state = root.f4x
    stack = stack_of(root)
    if 0 <= state.reading_index < len(state.readings):
        for number, data in enumerate(json.loads(state.readings[state.reading_index].operations), 1):
            stack = stack.append(read_operation(data, f"operation {number}"), state.sentence)
    return stack


def forget() -> None:
    """Empty the caches: another .blend was opened."""
    _files.clear()
    _scenes.clear()
    _synced.clear()
    packing.forget()


def _prepare(scene: Scene) -> None:
    """Compute in a thread what the first query needs: superpoints and neighbourhoods (seconds)."""
    thread = Thread(target=prepare, args=(scene,), daemon=True)
    _preparing[id(scene.static)] = thread
    thread.start()


def _pending(root: bpy.types.Object) -> str:
    if EDITS not in root:  # imported by an older version, or by a script that did not attach it
        attach(root)
    return root[EDITS]


def _met(root: bpy.types.Object) -> str:
    """JSON of the stack that the file held when `root` last read or wrote it."""
    pending = _pending(root)
    return _synced.get(root.session_uid, root.get(SAVED, pending))


def _meet(root: bpy.types.Object, text: str) -> None:
    root[SAVED] = _synced[root.session_uid] = text


@lru_cache(maxsize=KEPT)
def _saving(pending: str, met: str, file: str) -> str:
    """The label for three stacks, as `_texts` gives them; large ones take long to read, and panels are drawn often."""
    if pending == met:
        return "Load Edits from Scene File"
    ours, theirs = (set(EditStack.from_json(json.loads(text), "edits").edits) for text in (pending, met))
    if met == file and ours < theirs:
        count = len(theirs) - len(ours)
        return f"Remove {count} {plural('Edit', count)} from Scene File"
    return "Save Edits to Scene"


def _texts(root: bpy.types.Object) -> tuple[str, str, str]:
    """JSON of three stacks: pending, in the file when the scene last met it, in the file now."""
    return _pending(root), _met(root), _look_at(path_of(root)).edits


def _parsed(root: bpy.types.Object, text: str) -> EditStack:
    try:
        return EditStack.from_json(json.loads(text), root.name)
    except ValueError as error:
        raise F4xError(
            f"{root.name}: its stored edits are not valid JSON ({error}); import the scene again."
        ) from error


def _text(stack: EditStack) -> str:
    return json.dumps(stack.to_json())


def _display(root: bpy.types.Object, text: str) -> Display:
    """The scene with the stack that `text` describes; F4xError where the file is gone or holds other Gaussians."""
    path = path_of(root)
    arrays = _check_arrays(root)
    base, wanted = (str(path), arrays, NO_EDITS), (str(path), arrays, text)
    if base not in _scenes:
        scene = read_scene(path)
        fields = {name: value for name, value in scene.extra_fields.items() if name != UNDONE}
        _scenes[base] = Display(replace(scene, edits=(), extra_fields=fields))
    if wanted not in _scenes:
        _scenes[wanted] = Display(edited(with_stack(_scenes[base].scene, _parsed(root, text))))
    for key in (base, wanted):
        _scenes.move_to_end(key)
    while len(_scenes) > KEPT:
        _scenes.popitem(last=False)
    return _scenes[wanted]


def _check_arrays(root: bpy.types.Object) -> str:
    """The hash of the file's arrays; F4xError unless its Gaussians are those that were imported."""
    path = path_of(root)
    file = _look_at(path)
    known = (file.gaussians, file.arrays)  # the second is in a .blend of an older version
    if root.get(ARRAYS, file.gaussians) not in known:
        raise F4xError(f"{path} no longer holds the Gaussians that were imported; import it again.")
    return file.arrays


def _look_at(path: Path) -> _File:
    """What a scene file holds, from its header, which is read anew only when the file has changed."""
    try:
        found = path.stat()
    except OSError as error:
        raise F4xError(
            f"{path} cannot be read ({error.strerror}); put the scene file back, or import it again."
        ) from error
    stamp = (found.st_mtime_ns, found.st_size)
    file = _files.get(str(path))
    if file is None or file.stamp != stamp:
        arrays = read_header(path)["arrays"]
        same = {name: entry for name, entry in arrays.items() if name.startswith(GROUPS) and not name.endswith(LATENT)}
        file = _files[str(path)] = _File(stamp, _hash(arrays), _hash(same), _text(read_stack(path)))
    return file


def _hash(data: Mapping) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
