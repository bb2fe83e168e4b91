"""Jobs under way: child processes that a timer looks at, so that Blender stays usable; without a window they are waited for.

Nothing of a job is in the .blend. Closing Blender, or taking the extension out, ends every job with all that it started.
"""

import bpy

from ..f4x_core.errors import F4xError
from . import worker
from .lines import draw_lines
from .worker import Job

INTERVAL = 0.2
"""Seconds between two looks."""
LONGEST = 100
"""Characters of a line of the log."""
LINES_SHOWN = 8
"""Of a log, and of an answer."""
_AREAS = {"VIEW_3D", "PREFERENCES"}
_ICONS = {worker.RUNNING: "SORTTIME", worker.DONE: "CHECKMARK", worker.FAILED: "ERROR", worker.CANCELLED: "CANCEL"}

_jobs: list[Job] = []


def all_jobs() -> tuple[Job, ...]:
    """Jobs that run and those that ended and were not dismissed, oldest first."""
    return tuple(_jobs)


def start(job: Job) -> None:
    """Look after `job` until it ends. In Blender without a window this waits for it; F4xError tells how it failed."""
    _jobs.append(job)
    if bpy.app.background:
        said = ""

        def look(running: Job) -> None:
            nonlocal said
            if running.stage != said:
                said = running.stage
                print(f"{running.title}: {said}", flush=True)

        job.wait(look)
        _jobs.remove(job)
        if job.state != worker.DONE:
            raise F4xError(job.error or f"{job.title} was stopped.")
    elif not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=INTERVAL, persistent=True)


def tick() -> float | None:
    """Look at every job once; the seconds until the next look, None when nothing runs."""
    running = [job for job in _jobs if job.poll()]
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in _AREAS:
                area.tag_redraw()
    return INTERVAL if running else None


def dismiss(job: Job) -> None:
    """Forget a job that has ended; stop one that runs."""
    if job.state == worker.RUNNING:
        job.cancel()
    else:
        _jobs.remove(job)


def end_all() -> None:
    """End every job at once, with all that it started."""
    for job in _jobs:
        job.kill()
    _jobs.clear()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)


def draw_job(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    """Title, progress, what went wrong or came out, and the end of the log."""
    box = layout.box()
    row = box.row(align=True)
    row.label(text=job.title, icon=_ICONS[job.state])
    button = row.operator("f4x.dismiss_job", text="", icon="X", emboss=job.state == worker.RUNNING)
    button.number = _jobs.index(job)
    if job.state == worker.RUNNING:
        count = f" {job.done} of {job.total}" if job.total else ""
        box.progress(factor=job.share, text=f"{job.stage}{count}")
        if job.message:
            box.label(text=job.message)
    else:
        draw_lines(box, context, job.error if job.state == worker.FAILED else job.text, most=LINES_SHOWN)
    if job.log:
        header, body = box.panel(f"f4x_log_{_jobs.index(job)}", default_closed=True)
        header.label(text="Log")
        if body:
            column = body.column(align=True)
            for line in list(job.log)[-LINES_SHOWN:]:
                column.label(text=line[:LONGEST])


class F4X_OT_dismiss_job(bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Stop this job: what it has done so far is kept. A job that has ended is taken off the list."""

    bl_idname = "f4x.dismiss_job"
    bl_label = "Stop or Dismiss Job"

    number: bpy.props.IntProperty(options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context):
        """Stop, or forget."""
        if not 0 <= self.number < len(_jobs):
            return {"CANCELLED"}
        dismiss(_jobs[self.number])
        return {"FINISHED"}


CLASSES = (F4X_OT_dismiss_job,)
