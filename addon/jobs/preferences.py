"""Preferences of the extension: the worker's Python, setting it up, and whether it works.

The worker is a Python of its own because torch does not belong into Blender's. It runs the extension's own `f4x_core`.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty

from ...f4x_core.errors import F4xError
from ...f4x_core.installation import interpreter_in
from ..common.wording import Reporting
from . import runner
from .worker import Job, core_command

PACKAGE = __package__.removesuffix(".addon.jobs")
"""Name of the extension in Blender, for example `bl_ext.user_default.feature4x`."""
VARIABLE = "F4X_PYTHON"
"""Environment variable with the worker's Python, used if the preferences name none."""
SET_UP, CHECK = "Set up the worker", "Check setup"
"""Titles of the jobs that belong to the preferences."""
NEEDED = ("numpy", "torch", "scipy", "opencv-python-headless", "av")
"""Packages that fitting a clip needs."""


class F4X_AP_preferences(bpy.types.AddonPreferences):  # noqa: N801 - Blender wants this form
    """The worker's Python, options, and the result of the last check."""

    bl_idname = PACKAGE

    interpreter: StringProperty(  # type: ignore[valid-type]
        name="Worker's Python",
        description="Python interpreter with the packages that Feature4X needs; empty: the one that Set Up installed",
        subtype="FILE_PATH",
    )
    save_edits: BoolProperty(  # type: ignore[valid-type]
        name="Save Edits with the .blend",
        description="When the .blend is saved, also save unsaved edits in their scene files",
    )
    show_exactly: BoolProperty(  # type: ignore[valid-type]
        name="Show Imported Scenes with the Feature4X Engine",
        description="Show the exact image in the viewport, and a coarse one during playback. Off: use Material Preview."
        " Without the compiled kernels, Material Preview is always used",
        default=True,
    )
    checked: StringProperty(options={"HIDDEN"})  # type: ignore[valid-type]
    """JSON: [[good, line], …] of the last check."""

    def draw(self, context):
        """Draw the interpreter, the buttons and the result of the check."""
        layout = self.layout
        layout.prop(self, "interpreter")
        found = find_interpreter()
        layout.label(text=f"In use: {found}" if found else "In use: none. Press Set Up, or choose a Python above.")
        row = layout.row()
        row.operator("f4x.set_up_worker", icon="IMPORT")
        row.operator("f4x.check_worker", icon="CHECKMARK")
        layout.prop(self, "save_edits")
        layout.prop(self, "show_exactly")
        for good, line in json.loads(self.checked or "[]"):
            layout.label(text=line, icon="CHECKMARK" if good else "ERROR")
        for job in runner.all_jobs():
            if job.title in (SET_UP, CHECK):
                runner.draw_job(layout, context, job)


def preferences() -> F4X_AP_preferences | None:
    """Return the preferences of this extension; None if it was registered without being enabled."""
    entry = bpy.context.preferences.addons.get(PACKAGE)
    return None if entry is None else entry.preferences


def worker_folder() -> Path:
    """Return the folder in which Set Up creates the worker's environment: in the user's files, outside the extension."""
    try:
        return Path(bpy.utils.extension_path_user(PACKAGE, path="worker"))
    except ValueError:  # not installed as an extension
        return Path(bpy.utils.user_resource("DATAFILES", path=f"{PACKAGE}/worker"))


def find_interpreter() -> str | None:
    """Return the worker's Python: of the preferences, else of F4X_PYTHON, else the one that Set Up made; None without one."""
    settings = preferences()
    named = (bpy.path.abspath(settings.interpreter) if settings else "") or os.environ.get(VARIABLE)
    if named:
        return named
    made = interpreter_in(worker_folder())
    return str(made) if made.is_file() else None


def worker_python() -> str:
    """Like `find_interpreter`; F4xError says what to do without one."""
    found = find_interpreter()
    if found is None:
        raise F4xError(
            "No worker is set up yet; press Set Up in the preferences of the extension, or choose a Python there."
        )
    return found


def show_check(result: dict[str, Any]) -> None:
    """Store the result of `f4x doctor` as lines for the preferences."""
    packages, native = result["packages"], result["native"]
    missing = [name for name in NEEDED if packages[name] == "missing"]
    kernels = ", ".join(f"{name} {native[name]}" for name in ("instruction set", "self-check error") if name in native)
    lines = [
        (
            True,
            f"Feature4X {result['version']} on Python {result['python']}, {result['system']}, {result['cores']} cores",
        ),
        ("torch" not in missing, f"torch {packages['torch']}"),
        ("library" not in native, f"compiled kernels: {kernels or native['library']}"),
    ]
    lines += [(False, f"missing: {', '.join(missing)}; press Set Up, or choose another Python")] if missing else []
    settings = preferences()
    if settings is not None:
        settings.checked = json.dumps(lines)
    if missing:
        raise F4xError(f"{find_interpreter()} has no {', '.join(missing)}; press Set Up, or choose another Python.")


class F4X_OT_set_up_worker(Reporting, bpy.types.Operator):  # noqa: N801
    """Create a Python environment for the worker and install its packages. Asks before downloading anything."""

    bl_idname = "f4x.set_up_worker"
    bl_label = "Set Up"

    python: StringProperty(  # type: ignore[valid-type]
        name="Base Python", description="Python 3.11 or later; empty: the Python of Blender", subtype="FILE_PATH"
    )

    @classmethod
    def poll(cls, context):
        """Return True if Blender may use the network."""
        if not bpy.app.online_access:
            cls.poll_message_set(
                "Allow Online Access in Preferences > System, or choose a Python that has the packages"
            )
        return bpy.app.online_access

    def invoke(self, context, event):
        """Show what will be downloaded and where it goes, before anything happens."""
        self.python = self.python or sys.executable
        return context.window_manager.invoke_props_dialog(self, width=520, confirm_text="Download and Install")

    def draw(self, context):
        """Draw the question."""
        column = self.layout.column(align=True)
        column.label(text="This downloads PyTorch, OpenCV, COLMAP and small models with pip, from PyPI:")
        column.label(text="1 to 3 GB, some minutes. They go to")
        column.label(text=str(worker_folder()))
        column.label(text="and stay there until you remove that folder. Nothing else on this computer changes.")
        self.layout.prop(self, "python")

    def execute(self, context):
        """Start the installation."""
        python = bpy.path.abspath(self.python) or sys.executable
        folder = worker_folder()
        runner.start(Job(SET_UP, [python, "-m", "f4x_core.installation", str(folder)], _use_made))
        return {"FINISHED"}


class F4X_OT_check_worker(Reporting, bpy.types.Operator):  # noqa: N801
    """Check the worker: its version, its packages, and whether its compiled kernels compute correctly."""

    bl_idname = "f4x.check_worker"
    bl_label = "Check Setup"

    def execute(self, context):
        """Start the check."""
        settings = preferences()
        if settings is not None:
            settings.checked = ""
        _start_check()
        return {"FINISHED"}


def _use_made(result: dict[str, Any]) -> None:
    """Use the environment that was just created, and check it."""
    settings = preferences()
    if settings is not None:
        settings.interpreter = ""
    _start_check()


def _start_check() -> None:
    runner.start(Job(CHECK, core_command(worker_python(), "doctor"), show_check))


CLASSES = (F4X_AP_preferences, F4X_OT_set_up_worker, F4X_OT_check_worker)
