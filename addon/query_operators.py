"""Operators that select: by words, a click or a box, and the tools that change the selection."""

from __future__ import annotations

import threading
from collections.abc import Callable

import bpy
import gpu
import numpy as np
from bpy.props import EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, StringProperty
from bpy_extras import view3d_utils
from gpu_extras.batch import batch_for_shader

from ..f4x_core.edit.naming import by_labels, by_names, check_negatives, together
from ..f4x_core.edit.resolve import labels_of
from ..f4x_core.errors import Cancelled, F4xError
from ..f4x_core.language.lexicon import spellings
from ..f4x_core.progress import Progress
from ..f4x_core.query.inventory import known_instead
from ..f4x_core.query.knowledge import refuse_unknown
from ..f4x_core.query.labels import words_of
from ..f4x_core.query.neighbourhood import grow_selection, meeting, shrink_selection
from ..f4x_core.query.prompts import FollowConfig, select_by_prompts
from ..f4x_core.query.selection import Selection
from ..f4x_core.troubles import with_code
from . import display, marking, session
from .evaluated import HIDDEN
from .job_operators import look_up
from .panel_operators import SceneOperator
from .preferences import find_interpreter

QUICK = FollowConfig(lifted=0)
"""Use the prompted frame only."""
LOOK = 0.1
"""Seconds between two checks of a running search."""
MIN_BOX_PIXELS = 4
"""Minimum side of a box in pixels of the window; a smaller one is an accidental click."""


class F4X_OT_query_text(SceneOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Select objects by words, for example dog, cat. Needs a scene with features."""

    bl_idname, bl_label = "f4x.query_text", "Query"

    text: StringProperty(name="Text", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    negatives: StringProperty(name="But Not", options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Take the words from the panel."""
        state = session.root_of(context.object).f4x
        self.text, self.negatives = state.text, state.negatives
        return self.execute(context)

    def act(self, context, root):
        """Query the base scene, since copies have the same label as their original. A worker, if any, adds unknown words."""
        if not self.text.strip():
            raise F4xError("Type what to select, such as dog; separate several words by commas.")
        scene, shown, words = session.asked_scene(root), session.shown(root), words_of(self.text)
        negatives = words_of(self.negatives) if self.negatives.strip() else None
        check_negatives(words, negatives)
        found = by_names(shown.scene, words, root.f4x.threshold)
        called = " and ".join(word if word in found else f"the {word}" for word in words)
        labels = [word for word in words if word not in found]
        for label in labels:
            refuse_unknown(scene, label)
        known = {label.lower() for label in labels_of(scene)}
        unknown = [word for word in (*labels, *(negatives or ())) if known.isdisjoint(spellings(word))]
        near = known_instead(scene, unknown) if known and unknown else []
        hint = f" Nearest labels that it knows: {', '.join(near)}." if near else ""
        if known and unknown and find_interpreter():
            look_up(root, unknown)
            line = f"The worker adds {', '.join(unknown)} to the scene; query again when the job is done.{hint}"
            self.report({"INFO"}, line)
            return
        try:
            asked = by_labels(scene, labels, negatives, root.f4x.threshold)
        except F4xError as error:
            raise F4xError(f"{error}{hint}") from error
        found |= {label: shown.of_base(each) for label, each in asked.items()}
        marking.ask(root, together({word: found[word] for word in words}))
        if root.f4x.mode == "SET":
            root.f4x.called = called
        root.f4x.text, root.f4x.negatives = self.text, self.negatives
        self.report({"INFO"}, f"{root.f4x.selected:,} of {root.f4x.total:,} Gaussians")


class _Search(threading.Thread):
    """A search in its own thread, which starts at once. It sets `found` or `error`, or neither after `stopped` was set."""

    def __init__(self, work: Callable[[Progress], Selection]):
        super().__init__(daemon=True)
        self.work, self.fraction, self.stopped = work, 0.0, False
        self.found: Selection | None = None
        self.error: str | None = None
        self.start()

    def run(self) -> None:
        """Search until the end or until `stopped` is set."""
        try:
            self.found = self.work(self._look)
        except Cancelled:
            pass
        except F4xError as error:
            self.error = str(error)

    def _look(self, stage: str, done: int, total: int, message: str = "") -> None:
        self.fraction = done / max(total, 1)
        if self.stopped:
            raise Cancelled


class _Prompt(SceneOperator):
    """Base of operators that select an object by a prompt on one clip frame, from the mouse or from properties."""

    cursor = "CROSSHAIR"
    hint = ""

    def prompt(self) -> dict:
        """The prompt as keyword arguments of the core."""
        raise NotImplementedError

    def act(self, context, root):
        """Select by the prompt, on its frame only or tracked through the clip."""
        manager = context.window_manager

        def progress(stage: str, done: int, total: int, message: str = "") -> None:
            manager.progress_update(100 * done / max(total, 1))

        manager.progress_begin(0, 100)
        try:
            found = self._search(root)(progress)
        finally:
            manager.progress_end()
        self._take(root, found)

    def _search(self, root: bpy.types.Object) -> Callable[[Progress], Selection]:
        """The search as a function that does not use Blender."""
        config = FollowConfig() if root.f4x.follow else QUICK
        prompts = {self.frame: self.prompt()}
        scene, threshold = session.shown(root).scene, root.f4x.threshold
        return lambda progress: select_by_prompts(scene, prompts, threshold=threshold, config=config, progress=progress)

    def _take(self, root: bpy.types.Object, found: Selection) -> None:
        marking.ask(root, found)
        self.report({"INFO"}, f"{root.f4x.selected:,} of {root.f4x.total:,} Gaussians")

    def invoke(self, context, event):
        """Start waiting for the mouse."""
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"ERROR"}, "Start this tool from a 3D viewport.")
            return {"CANCELLED"}
        root = session.root_of(context.object)
        self.frame = session.shown(root).scene.cameras.frame_at(session.frame_of(root))
        self._area, self._handle, self._thread = context.area, None, None
        context.window.cursor_modal_set(self.cursor)
        context.workspace.status_text_set(self.hint)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Pass events on until the prompt is complete; Esc or the right mouse button cancels."""
        if self._thread is not None:
            return self._wait(context, event)
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self._finish(context)
            return {"CANCELLED"}
        try:
            done = self.handle(context, event)
        except F4xError as error:
            self._finish(context)
            self.report({"ERROR"}, with_code(error))
            return {"CANCELLED"}
        root = session.root_of(context.object)
        if done and root.f4x.follow:  # that takes many seconds: the window must not stand still
            self._thread = _Search(self._search(root))
            self._timer = context.window_manager.event_timer_add(LOOK, window=context.window)
            context.window.cursor_modal_set("WAIT")
            return {"RUNNING_MODAL"}
        if done:
            self._finish(context)
            return self.execute(context)
        navigates = event.type in {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE"}
        return {"PASS_THROUGH"} if navigates else {"RUNNING_MODAL"}

    def _wait(self, context, event):
        """Check whether the search is done; Esc stops it."""
        search = self._thread
        if event.type == "ESC":
            search.stopped = True
        if search.is_alive():
            context.workspace.status_text_set(f"Tracking through the clip: {search.fraction:.0%}. Press Esc to stop.")
            return {"RUNNING_MODAL"}
        context.window_manager.event_timer_remove(self._timer)
        self._finish(context)
        if search.error is not None:
            self.report({"ERROR"}, search.error)
        if search.found is None:
            return {"CANCELLED"}
        self._take(session.root_of(context.object), search.found)
        return {"FINISHED"}

    def handle(self, context, event) -> bool:
        """Handle one event; returns True when the prompt is complete."""
        raise NotImplementedError

    def _finish(self, context) -> None:
        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)
        self._area.tag_redraw()

    def _mouse(self, event) -> tuple[bpy.types.Region, np.ndarray]:
        """(the viewport's region, (2,) the mouse in it); F4xError outside."""
        for region in self._area.regions:
            at = np.array([event.mouse_x - region.x, event.mouse_y - region.y])
            if region.type == "WINDOW" and (at >= 0).all() and (at < (region.width, region.height)).all():
                return region, at
        raise F4xError("The mouse is outside the viewport; click inside it.")

    def _pixel(self, context, region: bpy.types.Region, at: np.ndarray) -> np.ndarray:
        """(2,) pixel of the clip's frame that shows what is at `at` in the viewport; F4xError where nothing is."""
        root = session.root_of(context.object)
        view = self._area.spaces.active.region_3d
        to_scene = root.matrix_world.inverted()
        origin = to_scene @ view3d_utils.region_2d_to_origin_3d(region, view, at)
        direction = to_scene.to_3x3() @ view3d_utils.region_2d_to_vector_3d(region, view, at)
        origin, direction = np.array(origin), np.array(direction.normalized())
        scene = session.shown(root).scene
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
    """Click on an object to select it, in any view."""

    bl_idname, bl_label = "f4x.query_point", "Point"
    cursor, hint = "EYEDROPPER", "Click on an object. Press Esc to cancel."

    frame: IntProperty(name="Frame", description="Clip frame", min=0)  # type: ignore[valid-type]
    at: FloatVectorProperty(
        name="Pixel", description="Position in the clip's frame in pixels, from the upper left corner", size=2
    )  # type: ignore[valid-type]

    def prompt(self):
        """One point."""
        return {"points": [tuple(self.at)]}

    def handle(self, context, event):
        """A click."""
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return False
        self.at = self._pixel(context, *self._mouse(event))
        return True


class F4X_OT_query_box(_Prompt, bpy.types.Operator):  # noqa: N801
    """Drag a box around an object to select it, in the view of the clip's camera."""

    bl_idname, bl_label = "f4x.query_box", "Box"
    hint = "Drag a box around an object. Press Esc to cancel."

    frame: IntProperty(name="Frame", description="Clip frame", min=0)  # type: ignore[valid-type]
    box: FloatVectorProperty(name="Box", description="Left, top, right, bottom in pixels of the clip", size=4)  # type: ignore[valid-type]

    def prompt(self):
        """The box."""
        return {"box": tuple(self.box)}

    def invoke(self, context, event):
        """Start only in the view of the clip's camera."""
        space = context.space_data
        if getattr(space, "region_3d", None) is None or space.region_3d.view_perspective != "CAMERA":
            self.report(
                {"ERROR"}, "Look through the clip's camera first (View > Cameras > Active Camera, or numpad 0)."
            )
            return {"CANCELLED"}
        self._corners = None
        return super().invoke(context, event)

    def handle(self, context, event):
        """Handle pressing, dragging and releasing the mouse button."""
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            region, at = self._mouse(event)
            self._region, self._corners = region, np.stack([at, at])
            draw = bpy.types.SpaceView3D.draw_handler_add
            self._handle = draw(_draw_box, (self._corners, region), "WINDOW", "POST_PIXEL")
        elif self._corners is not None and event.type == "MOUSEMOVE":
            self._corners[1] = event.mouse_x - self._region.x, event.mouse_y - self._region.y
            self._area.tag_redraw()
        elif self._corners is not None and event.type == "LEFTMOUSE" and event.value == "RELEASE":
            if np.ptp(self._corners, axis=0).min() < MIN_BOX_PIXELS:
                raise F4xError("The box is too small; hold the left mouse button, drag, and release.")
            # along a side of the frame everything is at one depth or another: the camera's own rays need none
            pixels = np.stack([self._pixel(context, self._region, corner) for corner in self._corners])
            size = session.shown(session.root_of(context.object)).scene.cameras
            low = np.maximum(pixels.min(0), 0)
            high = np.minimum(pixels.max(0), (size.width, size.height))
            self.box = (*low, *high)
            return True
        return False


def _draw_box(corners: np.ndarray, region: bpy.types.Region) -> None:
    """The outline of a box between two corners (2,2), in its own viewport."""
    if bpy.context.region != region:
        return
    (left, bottom), (right, top) = corners.min(0).tolist(), corners.max(0).tolist()
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    outline = [(left, bottom), (right, bottom), (right, top), (left, top), (left, bottom)]
    batch = batch_for_shader(shader, "LINE_STRIP", {"pos": outline})
    shader.uniform_float("color", (1.0, 0.6, 0.1, 1.0))
    batch.draw(shader)


class F4X_OT_change_selection(SceneOperator, bpy.types.Operator):  # noqa: N801
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

    @classmethod
    def description(cls, context, properties):
        """The tooltip of each button."""
        return cls.bl_rna.properties["how"].enum_items[properties.how].description

    def act(self, context, root):
        """Use the positions of the Gaussians at the current frame."""
        shown, chosen = session.shown(root), session.read(root, session.SELECTED)
        if self.how in ("GROW", "SHRINK"):
            change = grow_selection if self.how == "GROW" else shrink_selection
            points = shown.scene.posed(session.frame_of(root)).means
            chosen[shown.there] = change(points[shown.there], chosen[shown.there], self.reach or root.f4x.reach)
        else:
            chosen = {"INVERT": ~chosen, "ALL": shown.there, "NONE": np.zeros_like(chosen)}[self.how]
        marking.choose(root, chosen & shown.there)


class F4X_OT_select_named(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Select a named selection. The mode in the Ask panel says how it combines with the current selection."""

    bl_idname, bl_label = "f4x.select_named", "Select"

    called: StringProperty(name="Name")  # type: ignore[valid-type]

    def act(self, context, root):
        """Look the name up in the pending edits."""
        chosen = np.zeros(len(session.shown(root).scene.ids), bool)
        names = session.names_of(root)
        if self.called not in names:
            raise F4xError(f"There is no selection named '{self.called}'; known names: {', '.join(names) or 'none'}.")
        chosen[names[self.called]] = True
        marking.combine(root, chosen)
        if root.f4x.mode == "SET":
            root.f4x.called = self.called


class F4X_OT_hide(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Hide points in the viewport and in renders, without an edit."""

    bl_idname, bl_label = "f4x.hide", "Hide"

    what: EnumProperty(  # type: ignore[valid-type]
        name="What",
        items=(
            ("SELECTED", "Hide", "Hide the selection, also in renders; the scene file does not change"),
            ("OTHERS", "Isolate", "Hide everything that is not selected"),
            ("NOTHING", "Show All", "Show everything that was hidden"),
        ),
    )

    @classmethod
    def description(cls, context, properties):
        """The tooltip of each button."""
        return cls.bl_rna.properties["what"].enum_items[properties.what].description

    def act(self, context, root):
        """Hide adds to the hidden points; Isolate replaces them."""
        chosen = session.read(root, session.SELECTED)
        if self.what != "NOTHING" and not chosen.any():
            raise F4xError("Nothing is selected; use Query, Point or Box, or select points in Edit Mode.")
        already = session.read(root, HIDDEN)
        hidden = {"SELECTED": already | chosen, "OTHERS": ~chosen, "NOTHING": np.zeros_like(chosen)}[self.what]
        display.hide(root, hidden)


CLASSES = (
    F4X_OT_query_text,
    F4X_OT_query_point,
    F4X_OT_query_box,
    F4X_OT_change_selection,
    F4X_OT_select_named,
    F4X_OT_hide,
)
