"""Searches in a thread of their own: the window stays usable, the panel shows progress, and Esc or a button stops them.

Scripts, and Blender without a window, wait for the result.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import bpy

from ...f4x_core.errors import Cancelled, F4xError
from ...f4x_core.progress import Progress
from ...f4x_core.troubles import EXPECTED
from ..common.wording import Reporting
from ..scene.scene_object import EDITS, PREVIEW, SceneObject, object_of
from .base import SceneOperator

LOOK = 0.1
"""Seconds between two checks of a running search."""
Work = Callable[[Progress], Any]
"""A search that does not use Blender."""

_running: Search | None = None


class Search(threading.Thread):
    """A search in its own thread, which starts at once. It sets `found` or `error`; its result is dropped once `stopped` is set."""

    def __init__(self, section: str, title: str, work: Work):
        super().__init__(daemon=True)
        self.section, self.title, self.work = section, title, work
        self.fraction, self.stopped, self._began = 0.0, False, time.monotonic()
        self.found: Any = None
        self.error: Exception | None = None
        self.start()

    def run(self) -> None:
        """Search until the end or until `stopped` is set."""
        try:
            self.found = self.work(self._look)
        except Cancelled:
            pass
        except Exception as error:  # raised again where Blender reports it
            self.error = error

    def _look(self, stage: str, done: int, total: int, message: str = "") -> None:
        self.title, self.fraction = message or self.title, done / max(total, 1)
        if self.stopped:
            raise Cancelled

    @property
    def line(self) -> str:
        """The present stage, and for how long or how far."""
        done = f"{self.fraction:.0%}" if self.fraction else f"{time.monotonic() - self._began:.0f} s"
        return f"{self.title}: {done}"


class SearchOperator(SceneOperator):
    """Base of operators that search in a thread if a person started them, and at once if a script did."""

    section, title = "SELECT", "Searching"
    """The section of the sidebar that shows the progress, and the words beside it."""

    def work(self, scene_object: SceneObject) -> Work:
        """Return the search; what it needs of Blender is read here."""
        raise NotImplementedError

    def take(self, context: bpy.types.Context, scene_object: SceneObject, found: Any) -> None:
        """Show the result of the search. Raises F4xError where there is nothing to show."""
        raise NotImplementedError

    def failed(self, scene_object: SceneObject, error: Exception) -> set[str]:
        """Report the error with which a search ended."""
        raise error

    def act(self, context, scene_object):
        """Search now."""
        try:
            self._search_now(context, scene_object)
        except EXPECTED as error:
            self.failed(scene_object, error)
            raise

    def _search_now(self, context: bpy.types.Context, scene_object: SceneObject) -> None:
        def progress(stage: str, done: int, total: int, message: str = "") -> None:
            context.window_manager.progress_update(100 * done / max(total, 1))

        context.window_manager.progress_begin(0, 100)
        try:
            found = self.work(scene_object)(progress)
        finally:
            context.window_manager.progress_end()
        self.take(context, scene_object, found)

    def search(self, context: bpy.types.Context) -> set[str]:
        """Start the search and wait for it in `modal`; without a window search now."""
        scene_object = SceneObject.of(context.object)
        try:
            if bpy.app.background:
                self._search_now(context, scene_object)
                return {"FINISHED"}
            self.begin(context, scene_object)
        except EXPECTED as error:
            return self.failed(scene_object, error)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def begin(self, context: bpy.types.Context, scene_object: SceneObject) -> None:
        """Start the search in its thread, in place of one that is under way."""
        global _running
        if _running is not None:
            _running.stopped = True
        work = self.work(scene_object)
        self._asked = scene_object.root.session_uid, *_edits_of(scene_object.root)
        self._search = _running = Search(self.section, self.title, work)
        self._timer = context.window_manager.event_timer_add(LOOK, window=context.window)

    def modal(self, context, event):
        """Wait for the search; Esc stops it. All else goes on meanwhile."""
        search = self._search
        if event.type == "ESC":
            search.stopped = True
        if search.is_alive() and not search.stopped:
            context.workspace.status_text_set(f"{search.line}. Press Esc to cancel.")
            _redraw(context)
            return {"PASS_THROUGH"}
        self.let_go(context)
        if search.stopped:
            return {"CANCELLED"}
        uid, *edits = self._asked
        root = object_of(uid)
        if root is None or _edits_of(root) != edits:
            raise F4xError("The scene was changed during the search; start it again.")
        if search.error is not None:
            return self.failed(SceneObject(root), search.error)
        self.take(context, SceneObject(root), search.found)
        return {"FINISHED"}

    def cancel(self, context):
        """Stop the search: Blender opens another file."""
        self.let_go(context)

    def let_go(self, context) -> None:
        """Give back the timer and the status bar."""
        global _running
        if _running is self._search:
            _running = None
        if self._search is not None:
            self._search.stopped |= self._search.is_alive()
            context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        _redraw(context)


def _edits_of(root: bpy.types.Object) -> list[str | None]:
    """Return the JSON of the pending edits and of those that are previewed: Gaussians are counted by them."""
    return [root.get(EDITS), root.get(PREVIEW)]


def _redraw(context: bpy.types.Context) -> None:
    for area in context.window.screen.areas if context.window else ():
        if area.type == "VIEW_3D":
            area.tag_redraw()


def draw_search(layout: bpy.types.UILayout, section: str) -> bool:
    """Draw the progress of a search that was started in this section, and the button that stops it. Return True if there is one."""
    if _running is None or _running.section != section:
        return False
    row = layout.row(align=True)
    row.progress(factor=_running.fraction, text=_running.line)
    row.operator("f4x.stop_search", text="", icon="X")
    return True


class F4X_OT_stop_search(Reporting, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Stop the search that is under way; the scene does not change."""

    bl_idname, bl_label = "f4x.stop_search", "Cancel Search"

    def execute(self, context):
        """Tell its thread; its operator ends at its next look."""
        if _running is not None:
            _running.stopped = True
        return {"FINISHED"}


CLASSES = (F4X_OT_stop_search,)
