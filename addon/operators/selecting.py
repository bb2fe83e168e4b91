"""Operators that select: by words, a click or a box, and the tools that change the selection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, StringProperty
from bpy_extras import view3d_utils

from ...f4x_core.edit.display import Display
from ...f4x_core.edit.naming import by_labels, by_names, check_negatives, together
from ...f4x_core.edit.resolve import labels_of, nothing_called
from ...f4x_core.errors import F4xError
from ...f4x_core.language.lexicon import spellings
from ...f4x_core.progress import Progress
from ...f4x_core.query.cast import needs_no_teacher
from ...f4x_core.query.inventory import instead
from ...f4x_core.query.knowledge import refuse_unknown
from ...f4x_core.query.labels import words_of
from ...f4x_core.query.neighbourhood import grow_selection, meeting, shrink_selection
from ...f4x_core.query.people import in_ordinals
from ...f4x_core.query.prompts import SelectOptions, select_by_prompts
from ...f4x_core.query.selection import Selection
from ...f4x_core.scene import Scene
from ..common.outline import Outline
from ..common.wording import panel_words
from ..edits import display, marking
from ..jobs.preferences import find_interpreter
from ..scene import cache
from ..scene.scene_object import HIDDEN, SELECTED, SceneObject
from .base import DescribedChoice, SceneOperator, require_viewport
from .searching import SearchOperator
from .tasks import look_up

PHRASES = frozenset(
    (
        *("what moves", "everything that moves", "moving things", "moving objects"),
        *("what stands still", "background", "the background", "everything", "all", "nothing", "none"),
    )
)
"""Words that the field takes besides those of the scene."""
MIN_BOX_PIXELS = 4
"""Minimum side of a box in pixels of the window; a smaller one is an accidental click."""


@dataclass(frozen=True)
class Answer:
    """The selection by words."""

    found: Selection | None = None
    """Scores of a query by labels or names; None where something else answers."""
    chosen: np.ndarray | None = None
    """(N,) bool over the shown scene: the answer to words such as "what moves"."""
    called: str = ""
    """The selection in words."""
    unknown: tuple[str, ...] = ()
    """Words that the worker has to add to the scene first."""
    hint: str = ""
    """The reason why nothing was found, or the words of the scene that are near."""


class F4X_OT_query_text(SearchOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Select objects by words, such as dog, cat. "What moves", "everything" and "nothing" need no features, words do."""

    bl_idname, bl_label = "f4x.query_text", "Select"
    title = "Searching"

    text: StringProperty(name="Text", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    negatives: StringProperty(name="But Not", options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Take the words from the panel."""
        state = SceneObject.of(context.object).state
        self.text, self.negatives = state.text, state.negatives
        return self.search(context)

    def work(self, scene_object):
        """Query the base scene, since copies have the same label as their original."""
        if not self.text.strip():
            raise F4xError("Type what to select, such as dog; separate several words by commas.")
        scene_object.state.found = ""
        base, shown, asker = scene_object.base, scene_object.shown, scene_object.context
        frame = base.cameras.frame_at(asker.frame)  # at which somebody is on the left
        text, names = self.text, tuple(scene_object.names)
        negatives = words_of(self.negatives) if self.negatives.strip() else None
        threshold, has_worker = scene_object.state.threshold, bool(find_interpreter())

        def search(progress: Progress) -> Answer:
            if text.strip().lower() in PHRASES:
                # Not above: Blender starts more often than somebody speaks.
                from ...f4x_core.edit.selecting import read_selecting

                selecting = read_selecting(shown.scene, f"select {text}", asker)
                assert selecting is not None  # as for every phrase
                return Answer(chosen=selecting.chosen, called=selecting.words)
            cache.wait_until_prepared(base, progress)
            words = words_of(in_ordinals(base, text, frame=frame, names=names)[0])
            return _query(base, shown, words, negatives, threshold, has_worker)

        return search

    def take(self, context, scene_object, found):
        """Select what was found. A worker, if any, adds unknown words."""
        state = scene_object.state
        state.text, state.negatives = self.text, self.negatives
        if found.unknown:
            look_up(scene_object, found.unknown)
            line = f"The worker adds {', '.join(found.unknown)} to the scene; select again when the task is done.{found.hint}"
            state.found = line
            self.report({"INFO"}, line)
            return
        if found.chosen is not None:
            marking.combine(scene_object, found.chosen)
        else:
            marking.ask(scene_object, found.found)
        if state.mode == "SET":
            state.called = found.called
        state.found = panel_words(found.hint)
        line = f"{state.selected:,} of {state.total:,} Gaussians selected"
        self.report({"WARNING"} if found.hint else {"INFO"}, f"{line}. {state.found}" if found.hint else line)


def _query(
    scene: Scene,
    shown: Display,
    words: Sequence[str],
    negatives: Sequence[str] | None,
    threshold: float,
    has_worker: bool,
) -> Answer:
    """Return the selection by labels and names in `shown`; where there is a worker, words without a label, for it to add."""
    check_negatives(words, negatives)
    found = by_names(shown.scene, words, threshold)
    called = " and ".join(word if word in found else f"the {word}" for word in words)
    labels = [word for word in words if word not in found]
    for label in labels:
        refuse_unknown(scene, label)
    known = {label.lower() for label in labels_of(scene)}
    unknown = [
        word
        for word in (*labels, *(negatives or ()))
        if known.isdisjoint(spellings(word)) and not needs_no_teacher(scene, word)
    ]
    others = instead(scene, unknown)[1] if known and unknown else ""
    hint = f" {others[0].upper()}{others[1:]}." if others else ""
    if known and unknown and has_worker:
        return Answer(unknown=tuple(unknown), hint=hint)
    try:
        asked = by_labels(scene, labels, negatives, threshold)
    except F4xError as error:
        raise F4xError(f"{error}{hint}") from error
    absent = [label for label, each in asked.items() if not each.chosen.any()]
    best = max((float(asked[label].scores.max(initial=0)) for label in absent), default=0.0)
    found |= {label: shown.of_base(each) for label, each in asked.items()}
    explained = nothing_called(scene, absent, threshold, best) if absent else ""
    asked_for = together({word: found[word] for word in words})
    return Answer(asked_for, called=called, hint=" ".join([*filter(None, [explained]), *asked_for.remarks]))


class _Prompt(SearchOperator):
    """Base of operators that select an object by a prompt on one clip frame, from the mouse or from properties."""

    cursor = "CROSSHAIR"
    hint = ""
    part = False

    def prompt(self) -> dict:
        """Return the prompt as keyword arguments of the core."""
        raise NotImplementedError

    def work(self, scene_object):
        """Search by the prompt; moving objects are followed through the clip."""
        prompts, threshold, part = {self.frame: self.prompt()}, scene_object.state.threshold, self.part
        scene, base = scene_object.shown.scene, scene_object.base

        def search(progress: Progress) -> Selection:
            cache.wait_until_prepared(base, progress)

            def following(stage: str, done: int, total: int, message: str = "") -> None:
                progress(stage, done, total, "Following it through the clip")

            return select_by_prompts(scene, prompts, SelectOptions(threshold, part=part, progress=following))

        return search

    def take(self, context, scene_object, found):
        """Select what was found."""
        marking.ask(scene_object, found)
        marking.tell_of_features(scene_object)
        self.report({"INFO"}, f"{scene_object.state.selected:,} of {scene_object.state.total:,} Gaussians selected")

    def require(self, context) -> None:
        """Raise F4xError where the mouse cannot be followed."""
        require_viewport(context)

    def invoke(self, context, event):
        """Start waiting for the mouse."""
        self.require(context)
        scene_object = SceneObject.of(context.object)
        self.frame = scene_object.shown.scene.cameras.frame_at(scene_object.frame)
        self._area, self._outline, self._search = context.area, None, None
        context.window.cursor_modal_set(self.cursor)
        context.workspace.status_text_set(self.hint)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Pass events on until the prompt is complete; Esc or the right mouse button cancels."""
        if self._search is not None:
            return super().modal(context, event)
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.let_go(context)
            return {"CANCELLED"}
        if self.handle(context, event):  # the window must not stand still while the search runs
            self.begin(context, SceneObject.of(context.object))
            context.window.cursor_modal_restore()
            return {"RUNNING_MODAL"}
        navigates = event.type in {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE"}
        return {"PASS_THROUGH"} if navigates else {"RUNNING_MODAL"}

    def handle(self, context, event) -> bool:
        """Handle one event; returns True when the prompt is complete."""
        raise NotImplementedError

    def let_go(self, context) -> None:
        """Take down what was drawn, and give the cursor back."""
        if self._outline is not None:
            self._outline.end()
            self._outline = None
        context.window.cursor_modal_restore()
        super().let_go(context)

    def _mouse(self, event) -> tuple[bpy.types.Region, np.ndarray]:
        """Return (the viewport's region, (2,) the mouse in it); F4xError outside."""
        for region in self._area.regions:
            at = np.array([event.mouse_x - region.x, event.mouse_y - region.y])
            if region.type == "WINDOW" and (at >= 0).all() and (at < (region.width, region.height)).all():
                return region, at
        raise F4xError("The mouse is outside the viewport; click inside it.")

    def _pixel(self, context, region: bpy.types.Region, at: np.ndarray) -> np.ndarray:
        """Return (2,) pixel of the clip's frame that shows what is at `at` in the viewport; F4xError where nothing is."""
        scene_object = SceneObject.of(context.object)
        view = self._area.spaces.active.region_3d
        to_scene = scene_object.root.matrix_world.inverted()
        origin = to_scene @ view3d_utils.region_2d_to_origin_3d(region, view, at)
        direction = to_scene.to_3x3() @ view3d_utils.region_2d_to_vector_3d(region, view, at)
        origin, direction = np.array(origin), np.array(direction.normalized())
        scene = scene_object.shown.scene
        there = meeting(scene.posed(float(scene.cameras.times[self.frame])), origin, direction)
        if there is None:
            if view.view_perspective != "CAMERA":
                raise F4xError("There is nothing under the mouse; click on an object of the scene.")
            there = origin + direction
        pixel, depth = scene.cameras[self.frame].project(there[None])
        if depth[0] <= 0:
            raise F4xError("The clip's camera does not see this point in this frame; choose another frame or point.")
        return pixel[0]


class F4X_OT_query_point(_Prompt, bpy.types.Operator):  # noqa: N801
    """Click on an object or a person to select it, in any view. Ctrl-click selects a part of the body: a head, an arm."""

    bl_idname, bl_label = "f4x.query_point", "Pick"
    cursor, hint = "EYEDROPPER", "Click on an object or a person; Ctrl: on a part of the body. Press Esc to cancel."

    frame: IntProperty(name="Frame", description="Clip frame", min=0)  # type: ignore[valid-type]
    at: FloatVectorProperty(
        name="Pixel", description="Position in the clip's frame in pixels, from the upper left corner", size=2
    )  # type: ignore[valid-type]
    part: BoolProperty(  # type: ignore[valid-type]
        name="Part of the Body", description="Of a person select the part that is clicked on", options={"SKIP_SAVE"}
    )

    def prompt(self):
        """Return the clicked point as a prompt."""
        return {"points": [tuple(self.at)]}

    def handle(self, context, event):
        """Take a click: its pixel, and whether it means a part of a body. Return True if it was one."""
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return False
        self.at, self.part = self._pixel(context, *self._mouse(event)), event.ctrl
        return True


class F4X_OT_query_box(_Prompt, bpy.types.Operator):  # noqa: N801
    """Drag a box around an object to select it, in the view of the clip's camera."""

    bl_idname, bl_label = "f4x.query_box", "Pick in Box"
    hint = "Drag a box around an object. Press Esc to cancel."

    frame: IntProperty(name="Frame", description="Clip frame", min=0)  # type: ignore[valid-type]
    box: FloatVectorProperty(name="Box", description="Left, top, right, bottom in pixels of the clip", size=4)  # type: ignore[valid-type]

    def prompt(self):
        """Return the drawn box as a prompt."""
        return {"box": tuple(self.box)}

    def require(self, context) -> None:
        """Raise F4xError but in the view of the clip's camera."""
        space = context.space_data
        if getattr(space, "region_3d", None) is None or space.region_3d.view_perspective != "CAMERA":
            raise F4xError("Look through the clip's camera first (View > Cameras > Active Camera, or numpad 0).")
        super().require(context)

    def invoke(self, context, event):
        """Start without corners."""
        self._corners = None
        return super().invoke(context, event)

    def handle(self, context, event):
        """Handle pressing, dragging and releasing the mouse button."""
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            region, at = self._mouse(event)
            self._region, self._corners, self._outline = region, np.stack([at, at]), Outline(region)
        elif self._corners is not None and event.type == "MOUSEMOVE":
            self._corners[1] = event.mouse_x - self._region.x, event.mouse_y - self._region.y
            (left, bottom), (right, top) = self._corners.tolist()
            self._outline.lines = [[(left, bottom), (right, bottom), (right, top), (left, top)]]
            self._area.tag_redraw()
        elif self._corners is not None and event.type == "LEFTMOUSE" and event.value == "RELEASE":
            if np.ptp(self._corners, axis=0).min() < MIN_BOX_PIXELS:
                raise F4xError("The box is too small; hold the left mouse button, drag, and release.")
            # along a side of the frame everything is at one depth or another: the camera's own rays need none
            pixels = np.stack([self._pixel(context, self._region, corner) for corner in self._corners])
            size = SceneObject.of(context.object).shown.scene.cameras
            low = np.maximum(pixels.min(0), 0)
            high = np.minimum(pixels.max(0), (size.width, size.height))
            self.box = (*low, *high)
            return True
        return False


class F4X_OT_change_selection(DescribedChoice, SceneOperator, bpy.types.Operator):  # noqa: N801
    """Change the selection."""

    bl_idname, bl_label = "f4x.change_selection", "Change Selection"

    how: EnumProperty(  # type: ignore[valid-type]
        name="How",
        items=(
            ("GROW", "Grow", "Extend the selection by one step in all directions"),
            ("SHRINK", "Shrink", "Shrink the selection by one step from all directions"),
            ("INVERT", "Invert", "Select everything else"),
            ("ALL", "All", "Select everything"),
            ("NONE", "None", "Select nothing"),
        ),
    )
    reach: FloatProperty(name="Step", description="Distance in world units; 0: the Step of the panel", min=0.0)  # type: ignore[valid-type]

    def act(self, context, scene_object):
        """Use the positions of the Gaussians at the current frame."""
        shown, chosen = scene_object.shown, scene_object.read(SELECTED)
        if self.how in ("GROW", "SHRINK"):
            change = grow_selection if self.how == "GROW" else shrink_selection
            points = shown.scene.posed(scene_object.frame).means
            chosen[shown.there] = change(
                points[shown.there], chosen[shown.there], self.reach or scene_object.state.reach
            )
        else:
            chosen = {"INVERT": ~chosen, "ALL": shown.there, "NONE": np.zeros_like(chosen)}[self.how]
        marking.choose(scene_object, chosen & shown.there)


class F4X_OT_select_named(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Select a named selection. The mode in the panel Select says how it combines with the current selection."""

    bl_idname, bl_label = "f4x.select_named", "Select"

    called: StringProperty(name="Name")  # type: ignore[valid-type]

    def act(self, context, scene_object):
        """Look the name up in the pending edits."""
        chosen = np.zeros(len(scene_object.shown.scene.ids), bool)
        names = scene_object.names
        if self.called not in names:
            raise F4xError(f"There is no selection named '{self.called}'; known names: {', '.join(names) or 'none'}.")
        chosen[names[self.called]] = True
        marking.combine(scene_object, chosen)
        if scene_object.state.mode == "SET":
            scene_object.state.called = self.called


class F4X_OT_hide(DescribedChoice, SceneOperator, bpy.types.Operator):  # noqa: N801
    """Hide points in the viewport and in renders, without an edit."""

    bl_idname, bl_label = "f4x.hide", "Hide"
    choice = "what"

    what: EnumProperty(  # type: ignore[valid-type]
        name="What",
        items=(
            ("SELECTED", "Hide", "Hide the selection, also in renders; the scene file does not change"),
            ("OTHERS", "Isolate", "Hide everything that is not selected"),
            ("NOTHING", "Show All", "Show everything that was hidden"),
        ),
    )

    def act(self, context, scene_object):
        """Hide adds to the hidden points; Isolate replaces them."""
        chosen = scene_object.read(SELECTED)
        if self.what != "NOTHING" and not chosen.any():
            raise F4xError("Nothing is selected; type words, use Pick or a gesture, or select points in Edit Mode.")
        already = scene_object.read(HIDDEN)
        hidden = {"SELECTED": already | chosen, "OTHERS": ~chosen, "NOTHING": np.zeros_like(chosen)}[self.what]
        display.hide(scene_object, hidden)


CLASSES = (
    F4X_OT_query_text,
    F4X_OT_query_point,
    F4X_OT_query_box,
    F4X_OT_change_selection,
    F4X_OT_select_named,
    F4X_OT_hide,
)
