"""Asking what is where: by words, by a click, by a box; and everything else that changes what is selected."""

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
from ..f4x_core.progress import Progress
from ..f4x_core.query.labels import spellings, words_of
from ..f4x_core.query.neighbourhood import grown, meeting, shrunk
from ..f4x_core.query.prompts import FollowConfig, select_by_prompts
from ..f4x_core.query.selection import Selection
from . import display, marking, session
from .evaluated import HIDDEN
from .job_operators import look_up
from .panel_operators import SceneOperator
from .preferences import find_interpreter

QUICK = FollowConfig(lifted=0)
"""The prompted frame alone says what is meant."""
LOOK = 0.1
"""Seconds between two looks at a search."""
SMALLEST_BOX = 4
"""Pixels of the window along a side; less is a click that went wrong."""


class F4X_OT_query_text(SceneOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Select what the words mean, by the features of the scene."""

    bl_idname, bl_label = "f4x.query_text", "Query"

    text: StringProperty(name="Text", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    negatives: StringProperty(name="But Not", options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Ask for what the panel says."""
        told = session.root_of(context.object).f4x
        self.text, self.negatives = told.text, told.negatives
        return self.execute(context)

    def act(self, context, root):
        """Words are asked of the base scene: a copy is what its original is. The worker, where there is one, learns new words."""
        if not self.text.strip():
            raise F4xError("Type what to look for, such as dog; several words with commas between them.")
        scene, shown, words = session.asked_scene(root), session.shown(root), words_of(self.text)
        negatives = words_of(self.negatives) if self.negatives.strip() else None
        check_negatives(words, negatives)
        found = by_names(shown.scene, words, root.f4x.threshold)
        called = " and ".join(word if word in found else f"the {word}" for word in words)
        labels = [word for word in words if word not in found]
        known = {label.lower() for label in labels_of(scene)}
        unknown = [word for word in (*labels, *(negatives or ())) if known.isdisjoint(spellings(word))]
        if known and unknown and find_interpreter():
            look_up(root, unknown)
            self.report({"INFO"}, f"The worker looks up {', '.join(unknown)}; query again when the job is done")
            return
        asked = by_labels(scene, labels, negatives, root.f4x.threshold)
        found |= {label: shown.of_base(each) for label, each in asked.items()}
        marking.ask(root, together({word: found[word] for word in words}))
        if root.f4x.mode == "SET":
            root.f4x.called = called
        root.f4x.text, root.f4x.negatives = self.text, self.negatives
        self.report({"INFO"}, f"{root.f4x.selected:,} of {root.f4x.total:,} Gaussians")


class _Search(threading.Thread):
    """A search beside Blender, begun at once: `found`, or `error`, or neither after `stopped` was set."""

    def __init__(self, work: Callable[[Progress], Selection]):
        super().__init__(daemon=True)
        self.work, self.share, self.stopped = work, 0.0, False
        self.found: Selection | None = None
        self.error: str | None = None
        self.start()

    def run(self) -> None:
        """Work until it is done or not wanted any more."""
        try:
            self.found = self.work(self._look)
        except Cancelled:
            pass
        except F4xError as error:
            self.error = str(error)

    def _look(self, stage: str, done: int, total: int, message: str = "") -> None:
        self.share = done / max(total, 1)
        if self.stopped:
            raise Cancelled


class _Prompt(SceneOperator):
    """An operator that points at a thing in a clip frame: with the mouse in a viewport, or by numbers."""

    cursor = "CROSSHAIR"
    hint = ""

    def prompt(self) -> dict:
        """Arguments of the core's mask decoder."""
        raise NotImplementedError

    def act(self, context, root):
        """Ask for the thing, on the present frame alone or followed through the clip."""
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
        """The work itself, which knows nothing of Blender."""
        config = FollowConfig() if root.f4x.follow else QUICK
        prompts = {self.frame: self.prompt()}
        scene, threshold = session.shown(root).scene, root.f4x.threshold
        return lambda progress: select_by_prompts(scene, prompts, threshold=threshold, config=config, progress=progress)

    def _take(self, root: bpy.types.Object, found: Selection) -> None:
        marking.ask(root, found)
        self.report({"INFO"}, f"{root.f4x.selected:,} of {root.f4x.total:,} Gaussians")

    def invoke(self, context, event):
        """Wait for the mouse."""
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"ERROR"}, "Point at something in a 3D viewport.")
            return {"CANCELLED"}
        self.frame = round(session.frame_of(session.root_of(context.object)))
        self._area, self._handle, self._thread = context.area, None, None
        context.window.cursor_modal_set(self.cursor)
        context.workspace.status_text_set(self.hint)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Hand events on until the thing is pointed at; Esc or the right button stops."""
        if self._thread is not None:
            return self._wait(context, event)
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self._finish(context)
            return {"CANCELLED"}
        try:
            done = self.handle(context, event)
        except F4xError as error:
            self._finish(context)
            self.report({"ERROR"}, str(error))
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
        """Look whether the thing was followed; Esc stops it."""
        search = self._thread
        if event.type == "ESC":
            search.stopped = True
        if search.is_alive():
            context.workspace.status_text_set(f"Following through the clip: {search.share:.0%}. Esc: stop")
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
        """Take one event; True when the thing is pointed at."""
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
        raise F4xError("That is outside the viewport; point at something in it.")

    def _pixel(self, context, region: bpy.types.Region, at: np.ndarray) -> np.ndarray:
        """(2,) pixel of the clip's frame that shows what is at `at` in the viewport; F4xError where nothing is."""
        root = session.root_of(context.object)
        view = self._area.spaces.active.region_3d
        to_scene = root.matrix_world.inverted()
        origin = to_scene @ view3d_utils.region_2d_to_origin_3d(region, view, at)
        direction = to_scene.to_3x3() @ view3d_utils.region_2d_to_vector_3d(region, view, at)
        origin, direction = np.array(origin), np.array(direction.normalized())
        scene = session.shown(root).scene
        there = meeting(scene.posed(float(self.frame)), origin, direction)
        if there is None:
            if view.view_perspective != "CAMERA":
                raise F4xError("There is nothing under the mouse; click on the scene.")
            there = origin + direction
        pixel, depth = scene.cameras.at(float(self.frame)).project(there[None])
        if depth[0] <= 0:
            raise F4xError("The clip's camera does not see that place on this frame; choose another frame or place.")
        return pixel[0]


class F4X_OT_query_point(_Prompt, bpy.types.Operator):  # noqa: N801
    """Select the thing under a click, in any view."""

    bl_idname, bl_label = "f4x.query_point", "Point"
    cursor, hint = "EYEDROPPER", "Click on a thing. Esc: stop"

    frame: IntProperty(name="Frame", description="Clip frame", min=0)  # type: ignore[valid-type]
    at: FloatVectorProperty(name="Pixel", description="Of the clip's frame, from its upper left", size=2)  # type: ignore[valid-type]

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
    """Select the thing in a box that is drawn in the camera's view."""

    bl_idname, bl_label = "f4x.query_box", "Box"
    hint = "Drag a box around a thing. Esc: stop"

    frame: IntProperty(name="Frame", description="Clip frame", min=0)  # type: ignore[valid-type]
    box: FloatVectorProperty(name="Box", description="Left, top, right, bottom in pixels of the clip", size=4)  # type: ignore[valid-type]

    def prompt(self):
        """The box."""
        return {"box": tuple(self.box)}

    def invoke(self, context, event):
        """Boxes are drawn where the clip's camera looks."""
        space = context.space_data
        if getattr(space, "region_3d", None) is None or space.region_3d.view_perspective != "CAMERA":
            self.report(
                {"ERROR"}, "Look through the clip's camera first (View > Cameras > Active Camera, or numpad 0)."
            )
            return {"CANCELLED"}
        self._corners = None
        return super().invoke(context, event)

    def handle(self, context, event):
        """From pressing the button to letting it go."""
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            region, at = self._mouse(event)
            self._region, self._corners = region, np.stack([at, at])
            draw = bpy.types.SpaceView3D.draw_handler_add
            self._handle = draw(_draw_box, (self._corners, region), "WINDOW", "POST_PIXEL")
        elif self._corners is not None and event.type == "MOUSEMOVE":
            self._corners[1] = event.mouse_x - self._region.x, event.mouse_y - self._region.y
            self._area.tag_redraw()
        elif self._corners is not None and event.type == "LEFTMOUSE" and event.value == "RELEASE":
            if np.ptp(self._corners, axis=0).min() < SMALLEST_BOX:
                raise F4xError("The box is too small; press the button, drag, and let go.")
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
    """Change what is selected."""

    bl_idname, bl_label = "f4x.change_selection", "Change Selection"

    how: EnumProperty(  # type: ignore[valid-type]
        name="How",
        items=(
            ("GROW", "Grow", "Select what lies within a step of the selection too"),
            ("SHRINK", "Shrink", "Take what lies within a step of the outside out of the selection"),
            ("INVERT", "Invert", "Select everything else"),
            ("ALL", "All", "Select everything"),
            ("NONE", "None", "Select nothing"),
        ),
    )
    reach: FloatProperty(name="Step", description="How far, world units; 0: as the panel says", min=0.0)  # type: ignore[valid-type]

    @classmethod
    def description(cls, context, properties):
        """Of each way to do it."""
        return cls.bl_rna.properties["how"].enum_items[properties.how].description

    def act(self, context, root):
        """On the Gaussians as they stand at the present frame."""
        shown, chosen = session.shown(root), session.read(root, session.SELECTED)
        if self.how in ("GROW", "SHRINK"):
            change = grown if self.how == "GROW" else shrunk
            points = shown.scene.posed(session.frame_of(root)).means
            chosen[shown.there] = change(points[shown.there], chosen[shown.there], self.reach or root.f4x.reach)
        else:
            chosen = {"INVERT": ~chosen, "ALL": shown.there, "NONE": np.zeros_like(chosen)}[self.how]
        marking.choose(root, chosen & shown.there)


class F4X_OT_select_named(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Select what was named, combined with the selection as the mode says."""

    bl_idname, bl_label = "f4x.select_named", "Select"

    called: StringProperty(name="Name")  # type: ignore[valid-type]

    def act(self, context, root):
        """Names are those of the pending edits."""
        chosen = np.zeros(len(session.shown(root).scene.ids), bool)
        names = session.names_of(root)
        if self.called not in names:
            raise F4xError(f"Nothing is named '{self.called}' (there are: {', '.join(names) or 'none'}).")
        chosen[names[self.called]] = True
        marking.combine(root, chosen)
        if root.f4x.mode == "SET":
            root.f4x.called = self.called


class F4X_OT_hide(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Hide points without an edit."""

    bl_idname, bl_label = "f4x.hide", "Hide"

    what: EnumProperty(  # type: ignore[valid-type]
        name="What",
        items=(
            ("SELECTED", "Hide", "Hide what is selected, in renders too; the scene file stays as it is"),
            ("OTHERS", "Isolate", "Hide everything that is not selected"),
            ("NOTHING", "Show All", "Show everything that was hidden"),
        ),
    )

    @classmethod
    def description(cls, context, properties):
        """Of each way to do it."""
        return cls.bl_rna.properties["what"].enum_items[properties.what].description

    def act(self, context, root):
        """Hiding adds to what is hidden already; isolating does not."""
        chosen = session.read(root, session.SELECTED)
        if self.what != "NOTHING" and not chosen.any():
            raise F4xError("Nothing is selected; ask for something, or select points in edit mode.")
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
