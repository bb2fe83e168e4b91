"""An imported scene in Blender: its core `Scene`, its pending edits, its point clouds, and which point is which Gaussian.

The state is stored in the .blend on the scene's root empty, so that Blender's Undo covers it:

    f4x_path     the scene file, or the splat file of another program, which holds no edits
    f4x_arrays   hash of the file's Gaussians at import: the file has to hold the same ones
    f4x_edits    JSON of the pending stack
    f4x_saved    JSON of the stack that the file held when this scene last read or wrote it
    f4x_preview  JSON of a stack that is only previewed; absent otherwise

Undo rolls these back, but not the file. So whether edits are saved is read in the file, and `f4x_saved` counts only after a
.blend was opened: until then `_synced` has it, which undo does not touch and from which `f4x_saved` is set again.

Gaussians are known by their id, the point attribute `gid`, so points may be deleted, split off and copied in Blender.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np

from ...f4x_core.edit.apply import EditedScene, edited
from ...f4x_core.edit.display import Display
from ...f4x_core.edit.merging import merge_edits
from ...f4x_core.edit.operations import Operation, read_operation
from ...f4x_core.edit.resolve import EditorState, resolve
from ...f4x_core.edit.selects import MAX_WORDS_LENGTH, Ids
from ...f4x_core.edit.stack import EditStack, read_stack, with_stack, write_stack
from ...f4x_core.errors import F4xError
from ...f4x_core.language.lexicon import plural
from ...f4x_core.query.gesture import View
from ...f4x_core.query.selection import Selection
from ...f4x_core.scene import Scene, updating, write_scene
from ..common.axes import Eye, SceneAxes
from ..common.gaussian_attributes import draws_splats
from ..common.point_cloud import read_attribute, write_attribute
from . import cache, clip_time, packing
from .packing import PACKED, pack, unpacked

PATH, ARRAYS, EDITS, SAVED, PREVIEW = "f4x_path", "f4x_arrays", "f4x_edits", "f4x_saved", "f4x_preview"
APART = "f4x_apart"
"""Property of the separate cloud for Gaussians whose motion is edited: moved, retimed and copied ones."""
HANDLE_OF = "f4x_edit"
"""Property of the handle of an edit (`handles`): the edit's id."""
SELECTED, BEFORE, SCORE = ".selection", "f4x_before", "f4x_score"
"""Point attributes: the selection (Blender's own name), the selection before the last query, and the query's scores."""
HIDDEN = "f4x_hidden"
"""Point attribute, BOOLEAN: points that no picture shows."""
IN_METERS = "f4x_in_meters"
"""Property of a root that was scaled to a length that a person knows: Blender's units are meters then."""
TIMED = "f4x_timed"
"""Property of a root whose edits change over time, so that its clouds are updated at every frame."""
PATIENCE = 1.0
"""Seconds that the window waits for another program that is changing the scene file; then it says so."""
MOVED = 3
"""Number of folders above a .blend in which a moved scene file is searched."""

_kept_back: set[str] = set()  # what keeps previews from being shown at present: a render, a save of the .blend
_synced: dict[int, str] = {}  # session_uid of a root -> JSON of the stack that the file held when the root last met it


def keep_back_previews(why: str, on: bool) -> None:
    """Let all scenes show their pending edits alone, without previews, or no longer for this reason."""
    (_kept_back.add if on else _kept_back.discard)(why)


def root_of(item: bpy.types.Object | None) -> bpy.types.Object | None:
    """Return the root of the scene that `item` is a part of; None where it is of none."""
    while item is not None and PATH not in item:
        item = item.parent
    return item


@dataclass(frozen=True)
class SceneObject:
    """A scene by its root empty. It keeps nothing itself, so it may be made anew wherever one is needed."""

    root: bpy.types.Object
    """Has the property `f4x_path`."""

    @classmethod
    def of(cls, item: bpy.types.Object | None) -> SceneObject | None:
        """Return the scene that `item` is a part of; where it is of none, the only one that there is, or that is visible."""
        root = root_of(item)
        if root is not None:
            return cls(root)
        scenes = cls.among(bpy.context.scene.objects)
        visible = [each for each in scenes if each.root.visible_get()]
        return next((each[0] for each in (scenes, visible) if len(each) == 1), None)

    @classmethod
    def among(cls, objects: Iterable[bpy.types.Object]) -> list[SceneObject]:
        """Return the scenes whose roots are among `objects`."""
        return [cls(item) for item in objects if PATH in item]

    @property
    def name(self) -> str:
        """Name of the root."""
        return self.root.name

    @property
    def state(self) -> bpy.types.PropertyGroup:
        """Properties of the sidebar; there only while the extension is registered."""
        return self.root.f4x

    @property
    def is_linked(self) -> bool:
        """True if the scene belongs to another .blend, as a link or a library override: it plays, but cannot be changed here."""
        clouds = (item.data for item in self.root.children if item.type == "POINTCLOUD")
        return any(item.library or item.override_library for item in (self.root, *clouds))

    @property
    def why_linked_stays(self) -> str:
        """Sentence for an operator that would have to change a linked scene."""
        return f"{self.name} belongs to another .blend; change it there, or use Object > Relations > Make Local > All first"

    # The file

    @property
    def path(self) -> Path:
        """The scene file, which may be given relative to the .blend.

        Where both were moved, it is looked for near the .blend; where there is none, what was packed into the .blend is
        written out.
        """
        path = Path(bpy.path.abspath(self.root[PATH]))
        if path.exists():
            return path
        above = list(Path(bpy.data.filepath).parents)[:MOVED] if bpy.data.filepath else []
        tails = [Path(*path.parts[-count:]) for count in range(1, len(path.parts))]
        near = next((place for folder in above for tail in tails if (place := folder / tail).is_file()), None)
        return near or unpacked(self.root) or path

    def relink(self, path: Path) -> None:
        """Let the scene file be `path`; F4xError where it holds other Gaussians."""
        before, self.root[PATH] = self.root[PATH], str(path)
        try:
            self._checked_path()
        except F4xError:
            self.root[PATH] = before
            raise

    @property
    def holds_edits(self) -> bool:
        """True if the scene's file is a `.f4x`, in which edits can be saved; true where it is missing."""
        try:
            return cache.look_at(self.path).holds_edits
        except F4xError:
            return True

    def attach(self) -> None:
        """Take over the scene file's edits and remember its arrays: after an import, or when the file was written."""
        path = self.path
        file = cache.look_at(path)
        self.root[ARRAYS], self.root[EDITS] = file.gaussians, file.edits
        self._meet(file.edits)
        if PACKED in self.root:
            pack(self.root, path)
        if not bpy.app.background:
            cache.prepare_soon(self.base)

    # Edits

    @property
    def stack(self) -> EditStack:
        """The pending stack."""
        return cache.stack_from(self._pending, self.name)

    def set_stack(self, stack: EditStack) -> None:
        """Make `stack` the pending one after checking it; F4xError leaves the old one. Callers then use `display.refresh`."""
        text = cache.text_of(stack)
        self._display(text)
        self.root[EDITS] = text
        self.show_preview(None)

    def show_preview(self, stack: EditStack | None) -> None:
        """Preview `stack` in place of the pending one; None ends the preview."""
        if stack is not None:
            self.root[PREVIEW] = cache.text_of(stack)
        elif PREVIEW in self.root:
            del self.root[PREVIEW]

    def append(self, *operations: Operation, sentence: str = "") -> EditStack:
        """Resolve operations as `f4x edit` does and append them to the pending stack; F4xError leaves the stack unchanged."""
        context, stack = self.context, self.stack
        for operation in operations:
            scene = edited(with_stack(self.base, stack))
            stack = stack.append(resolve(scene, operation, context), sentence)
        self.set_stack(stack)
        return stack

    def with_reading(self) -> EditStack:
        """Return the pending stack with the reading of the sentence that is picked in the panel."""
        state, stack = self.state, self.stack
        if 0 <= state.reading_index < len(state.readings):
            for number, data in enumerate(json.loads(state.readings[state.reading_index].operations), 1):
                stack = stack.append(read_operation(data, f"operation {number}"), state.sentence)
        return stack

    @property
    def is_saved(self) -> bool:
        """True if the scene file holds the pending edits; where it is missing, if it did when it was last seen."""
        try:
            return self._pending == cache.look_at(self.path).edits
        except F4xError:
            return self.root.get(EDITS) == self._met

    @property
    def saving(self) -> str:
        """Label of the button that saves the edits."""
        try:
            if self.is_saved:
                return "Edits Saved"
            return _saving(self._pending, self._met, cache.look_at(self.path).edits)
        except F4xError:
            return "Save Edits to Scene"  # and pressing it says what is wrong

    def save(self) -> EditStack:
        """Write the pending edits into the scene file, atomically, merged with what others wrote there in between.

        What the scene once had in the file and has no more, by undo too, is taken out of the file.
        Raises F4xError: the file is missing, holds other Gaussians or is being changed, or both sides changed the same edit.
        """
        path = self._checked_path()
        if not cache.look_at(path).holds_edits:
            raise F4xError(f"{path.name} cannot hold edits; use Save As Scene, which makes a .f4x file of both.")
        with updating(path, PATIENCE):
            self._checked_path()  # again: the file may have been replaced before it was locked
            ours, met, theirs = self.stack, cache.stack_from(self._met, self.name), read_stack(path)
            stack = ours if theirs.edits == met.edits else merge_edits(self.base, met, ours, theirs)
            if stack.edits != theirs.edits:
                write_stack(path, stack)
        if stack.edits != theirs.edits and PACKED in self.root:
            pack(self.root, path)
        self.set_stack(stack)
        self._meet(self.root[EDITS])
        return stack

    def save_as(self, path: Path) -> None:
        """Write the scene with its pending edits into a new `.f4x` file `path`, which is the scene's file from then on."""
        path = path.with_suffix(".f4x")
        if path.exists() and path.samefile(self._checked_path()):
            raise F4xError(f"{path} is the scene file itself; press Save Edits to Scene, or choose another name.")
        write_scene(with_stack(self.base, self.stack), path)
        self.root[PATH] = str(path)
        self.attach()

    def remember(self) -> None:
        """Put into the .blend, which may be saved at any time, what the file held when the scene last met it."""
        self.root[SAVED] = self._met

    # The core's scenes

    @property
    def base(self) -> Scene:
        """The scene without its edits."""
        return self._display(cache.NO_EDITS).scene

    @property
    def pending(self) -> Display:
        """The scene with the pending edits, without a preview."""
        return self._display(self._pending)

    @property
    def edited(self) -> Scene:
        """The scene with the pending edits."""
        return self.pending.scene

    @property
    def shown_edits(self) -> str:
        """JSON of the stack that is shown: the preview's in a viewport that has one, else the pending one."""
        return (not _kept_back and self.root.get(PREVIEW)) or self._pending

    @property
    def shown(self) -> Display:
        """The scene with `shown_edits`."""
        return self._display(self.shown_edits)

    @property
    def shown_linear(self) -> Display | None:
        """`shown` for engines that blend in linear light without a footprint; None where Blender has none or it is the same."""
        if not draws_splats() or self.base.fitted_focal(float(self.base.cameras.times[0])) is None:
            return None
        return cache.displayed_linear(self._checked_path(), self.shown_edits)

    @property
    def frame(self) -> float:
        """The clip frame that is shown, clamped to the clip."""
        return self.shown.time(clip_time.time_of(self.root))

    @property
    def names(self) -> Mapping[str, np.ndarray]:
        """Name -> (n,) rows of the shown scene, for everything that an edit has named."""
        scene = self.shown.scene
        return scene.rows.names if isinstance(scene, EditedScene) else {}

    # Points

    @property
    def below(self) -> list[bpy.types.Object]:
        """All objects below the root, but those of another scene that an artist hung there."""
        below = self.root.children_recursive
        others = {part for item in below if PATH in item for part in (item, *item.children_recursive)}
        return [item for item in below if item not in others]

    @property
    def clouds(self) -> list[bpy.types.Object]:
        """The point clouds of the scene; the separate cloud of edited Gaussians comes last."""
        clouds = [item for item in self.below if item.type == "POINTCLOUD" and "gid" in item.data.attributes]
        return sorted(clouds, key=lambda item: APART in item)

    def points(self) -> Iterator[tuple[bpy.types.Object, np.ndarray, np.ndarray]]:
        """Yield (cloud, points (m,), Gaussians (m,)): which points of a cloud are which rows of the shown scene's `posed`."""
        display = self.shown
        for cloud in self.clouds:
            row, known = display.rows_of(read_attribute(cloud.data, "gid"))
            at = np.flatnonzero(known)
            yield cloud, at, row[at]

    def read(self, name: str) -> np.ndarray:
        """Return (N,) values of a point attribute by Gaussian; 0 without a point. Points of the separate cloud take precedence."""
        values = np.zeros(len(self.shown.scene.ids), np.float32 if name == SCORE else bool)
        for cloud, at, row in self.points():
            found = read_attribute(cloud.data, name)
            values[row] = 0 if found is None else found[at]
        return values

    def write(self, **attributes: tuple[str, np.ndarray]) -> None:
        """Write point attributes, name -> (type, (N,) values by Gaussian), to every point that shows one of them."""
        for cloud, at, row in self.points():
            for name, (kind, values) in attributes.items():
                new = np.zeros(len(cloud.data.points), values.dtype)
                new[at] = values[row]
                write_attribute(cloud.data, name, kind, new)
            cloud.data.update_tag()

    @property
    def marks(self) -> dict[str, tuple[str, np.ndarray]]:
        """The marks of a person, as `write` takes them: the selection, scores and what is hidden."""
        kinds = {SELECTED: "BOOLEAN", SCORE: "FLOAT", HIDDEN: "BOOLEAN"}
        return {name: (kind, self.read(name)) for name, kind in kinds.items()}

    @property
    def selection(self) -> Selection | None:
        """Selection among the shown Gaussians, with the scene's time span; None where nothing is selected."""
        chosen = self.read(SELECTED)
        if not chosen.any():
            return None
        state, ids = self.state, self.shown.scene.ids
        span = (float(state.first), float(state.last)) if state.use_span else None
        return Selection(ids, chosen.astype(float), np.zeros(len(ids), bool), span=span, label=state.text)

    @property
    def context(self) -> EditorState:
        """The selection and the frame that "it" and "now" in a sentence refer to."""
        return EditorState(self.selection, self.frame)

    @property
    def selected_ids(self) -> Ids:
        """The selected Gaussians as a stack holds them; F4xError where there are none."""
        chosen, state = self.selection, self.state
        if chosen is None:
            raise F4xError("Nothing is selected; type words, use Pick or a gesture, or select points in Edit Mode.")
        ids = Ids.of(chosen.chosen_ids)
        # points may have been selected in edit mode since, and then they are not what was asked for
        if chosen.chosen.sum() != state.selected:
            return ids
        return replace(ids, words=state.called[:MAX_WORDS_LENGTH])

    @property
    def axes(self) -> SceneAxes:
        """Blender's axes in the scene where it is placed now."""
        return SceneAxes.of(self.root)

    @property
    def meters(self) -> float | None:
        """Meters of one unit of the scene; None where no length is known."""
        return self.root.matrix_world.median_scale if IN_METERS in self.root else None

    def view(self, seen: Eye) -> View:
        """Return the current view of the scene, for gestures."""
        to_world, hidden = np.array(self.root.matrix_world), self.read(HIDDEN)
        return View(seen.camera, self.frame, seen.near, to_world, perspective=not seen.back, hidden=hidden)

    # How it is stored

    @property
    def _pending(self) -> str:
        if EDITS not in self.root:  # imported by an older version, or by a script that did not attach it
            self.attach()
        return self.root[EDITS]

    @property
    def _met(self) -> str:
        """JSON of the stack that the file held when the scene last read or wrote it."""
        pending = self._pending
        return _synced.get(self.root.session_uid, self.root.get(SAVED, pending))

    def _meet(self, text: str) -> None:
        self.root[SAVED] = _synced[self.root.session_uid] = text

    def _display(self, text: str) -> Display:
        """Return the scene with the stack that `text` describes; F4xError where the file is gone or holds other Gaussians."""
        return cache.displayed(self._checked_path(), text)

    def check_file(self) -> None:
        """Raise F4xError where the scene file is gone or holds other Gaussians."""
        self._checked_path()

    def _checked_path(self) -> Path:
        """Return the scene file; F4xError unless its Gaussians are those that were imported."""
        path = self.path
        file = cache.look_at(path)
        if self.root.get(ARRAYS, file.gaussians) != file.gaussians:
            raise F4xError(f"{path} no longer holds the Gaussians that were imported; import it again.")
        return path


def object_of(uid: int) -> bpy.types.Object | None:
    """Return the object with a session_uid; None where it is gone, as after a job that took long."""
    return next((item for item in bpy.data.objects if item.session_uid == uid), None)


def why_not(item: bpy.types.Object | None) -> str:
    """Return the reason why an operator cannot work on the scene of `item`; empty where it can."""
    found = SceneObject.of(item)
    if found is None:
        return (why_none(item) or "Import a Feature4X scene, or select one of its objects").rstrip(".")
    return found.why_linked_stays if found.is_linked else ""


def why_none(item: bpy.types.Object | None) -> str:
    """Return sentences on what looks like a scene and is none, where `item` is active; empty where nothing does."""
    shown = item and item.instance_collection
    if shown and SceneObject.among(shown.all_objects):
        return (
            f"{item.name} is a link to a scene of another .blend. Change it there, or append it in place of the link."
        )
    parts = [each for each in bpy.context.scene.objects if each.type == "POINTCLOUD" and "gid" in each.data.attributes]
    if any(root_of(each) is None for each in parts):
        return (
            "A scene has lost its root, the empty with its name. Ctrl-Z brings it back;"
            " Delete Hierarchy of its collection in the outliner removes the rest."
        )
    return ""


def forget() -> None:
    """Empty the caches: another .blend was opened."""
    cache.forget()
    packing.forget()
    _synced.clear()
    _kept_back.clear()


@lru_cache(maxsize=cache.KEPT)
def _saving(pending: str, met: str, file: str) -> str:
    """Return the label for three stacks: pending, in the file when the scene met it, in the file now; panels are drawn often."""
    if pending == met:
        return "Load Edits from Scene File"
    ours, theirs = (set(EditStack.from_json(json.loads(text), "edits").edits) for text in (pending, met))
    if met == file and ours < theirs:
        count = len(theirs) - len(ours)
        return f"Remove {count} {plural('Edit', count)} from Scene File"
    return "Save Edits to Scene"
