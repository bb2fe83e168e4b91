"""Running jobs: child processes that a timer polls, so that Blender stays usable. Without a window Blender waits for them.

The .blend stores nothing about jobs. Closing Blender or disabling the extension ends every job and all its child processes.
"""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import bpy

from ...f4x_core.edit.scene_task import SceneTask
from ...f4x_core.errors import F4xError
from ..common.lines import draw_lines
from ..common.waiting import waiting
from ..common.wording import Reporting, panel_words
from . import worker
from .worker import Job, own_command

INTERVAL = 0.2
"""Seconds between two polls."""
MAX_LINE_CHARACTERS = 100
"""Maximum length of a line of the log in the panel."""
LINES_SHOWN = 8
"""Maximum number of lines of a log or a result in the panel."""
_AREAS = {"VIEW_3D", "PREFERENCES"}
_ICONS = {worker.RUNNING: "SORTTIME", worker.DONE: "CHECKMARK", worker.FAILED: "ERROR", worker.CANCELLED: "CANCEL"}

_jobs: list[Job] = []


def all_jobs() -> tuple[Job, ...]:
    """Return the running jobs and the ended ones that were not dismissed, oldest first."""
    return tuple(_jobs)


def in_order() -> tuple[Job, ...]:
    """Return the jobs as the panel lists them: running ones first, then ended ones, the last one first."""
    return tuple(sorted(reversed(_jobs), key=lambda job: job.state != worker.RUNNING))


def clear() -> None:
    """Remove ended jobs from the list."""
    _jobs[:] = [job for job in _jobs if job.state == worker.RUNNING]


def start(job: Job) -> None:
    """Poll `job` until it ends. Blender without a window waits for it, and F4xError has the reason if it fails."""
    _jobs.append(job)
    if bpy.app.background:
        printed = ""

        def look(running: Job) -> None:
            nonlocal printed
            if running.stage != printed:
                printed = running.stage
                print(f"{running.title}: {printed}", flush=True)

        job.wait(look)
        _jobs.remove(job)
        if job.state != worker.DONE:
            raise F4xError(panel_words(job.error) or f"{job.title} was stopped.")
    elif not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=INTERVAL, persistent=True)


def start_task(
    title: str,
    task: SceneTask,
    on_done: Callable[[dict[str, Any]], None] | None = None,
    interpreter: str | None = None,
) -> None:
    """Carry out a task on a scene in a process of its own, of Blender's Python where no `interpreter` is named; see `start`."""
    path = Path(mkdtemp(dir=bpy.app.tempdir, prefix="task-")) / "task.json"
    task.write(path)
    start(Job(title, own_command(task.module(), path, interpreter=interpreter), on_done))


def tick() -> float | None:
    """Poll every job once. Returns the seconds until the next poll, None if no job runs."""
    with waiting() if any(job.arrived and job.state == worker.RUNNING for job in _jobs) else nullcontext():
        running = [job for job in _jobs if job.poll()]
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in _AREAS:
                area.tag_redraw()
    return INTERVAL if running else None


def dismiss(job: Job) -> None:
    """Stop a running job, or remove an ended one from the list."""
    if job.state == worker.RUNNING:
        job.cancel()
    else:
        _jobs.remove(job)


def end_all() -> None:
    """Kill every job and all its child processes."""
    for job in _jobs:
        job.kill()
    _jobs.clear()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)


def draw_job(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    """Draw a job: its progress while it runs; folded, its error or result and the end of its log once it has ended."""
    number = _jobs.index(job)
    box = layout.box()
    if job.state == worker.RUNNING:
        row = box.row(align=True)
        row.label(text=job.title, icon=_ICONS[job.state])
        row.operator("f4x.dismiss_job", text="", icon="X").number = number
        count = f" {job.done} of {job.total}" if job.total else ""
        if job.arrived:
            box.label(text="Showing the result…")
            return
        box.progress(factor=job.fraction, text=f"{job.stage}{count}")
        if job.message:
            box.label(text=job.message)
        return
    # only the last one is open, so that its result is seen; a panel keeps what a person folds by its name
    last = number == len(_jobs) - 1
    header, body = box.panel(f"f4x_job_{job.number}{'_last' * last}", default_closed=not last)
    header.label(text=job.title, icon=_ICONS[job.state])
    header.operator("f4x.dismiss_job", text="", icon="X", emboss=False).number = number
    if body is None:
        return
    text = job.error if job.state == worker.FAILED else job.text
    draw_lines(body, context, panel_words(text), space=(0, LINES_SHOWN))
    if job.instead:
        body.operator_context = "EXEC_DEFAULT"  # the question needs no dialog
        body.operator("f4x.ask_scene", text="Ask It So", icon="CHECKMARK").question = job.instead
    if job.log:
        header, lines = body.panel(f"f4x_log_{job.number}", default_closed=True)
        header.label(text="Log")
        if lines:
            column = lines.column(align=True)
            for line in list(job.log)[-LINES_SHOWN:]:
                column.label(text=line[:MAX_LINE_CHARACTERS])


def draw_running(layout: bpy.types.UILayout, context: bpy.types.Context, title: str) -> None:
    """Draw the running jobs whose titles begin with `title`, where they were started; ended ones stay under Tasks."""
    for job in _jobs:
        if job.title.startswith(title) and job.state == worker.RUNNING:
            draw_job(layout, context, job)


class F4X_OT_dismiss_job(Reporting, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Stop this task and keep what it has done so far. One that has already ended is removed from the list."""

    bl_idname = "f4x.dismiss_job"
    bl_label = "Stop or Dismiss Task"

    number: bpy.props.IntProperty(options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context):
        """Stop or remove the job."""
        if not 0 <= self.number < len(_jobs):
            return {"CANCELLED"}
        dismiss(_jobs[self.number])
        return {"FINISHED"}


class F4X_OT_clear_jobs(Reporting, bpy.types.Operator):  # noqa: N801
    """Remove all tasks that have ended from the list. What they made stays."""

    bl_idname = "f4x.clear_jobs"
    bl_label = "Clear"

    def execute(self, context):
        """Remove ended jobs."""
        clear()
        return {"FINISHED"}


CLASSES = (F4X_OT_dismiss_job, F4X_OT_clear_jobs)
