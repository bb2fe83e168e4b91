"""Ends the process of a Blender without a window: bpy 4.5 hangs at the end of the interpreter while classes are registered."""

import os
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import NoReturn

SESSION = re.compile(r"blender_\w{6}")
"""Name of a folder that Blender made for one session; where it could make none, its temporary folder is one that others share."""


def end_process(code: int = 0) -> NoReturn:
    """End at once with this code; what was printed and Blender's own temporary folder are looked after first."""
    sys.stdout.flush()
    sys.stderr.flush()
    if "bpy" in sys.modules:
        _remove_session(sys.modules["bpy"])
    os._exit(code)


def _remove_session(bpy) -> None:
    folder, chosen = Path(bpy.app.tempdir), bpy.context.preferences.filepaths.temporary_directory
    shared = {Path(tempfile.gettempdir()), Path(chosen or tempfile.gettempdir())}
    if SESSION.fullmatch(folder.name) and folder not in shared:
        shutil.rmtree(folder, ignore_errors=True)


def end_at_errors() -> None:
    """Let an exception that nobody catches be printed and end the process with code 1."""

    def end(*error) -> None:
        sys.__excepthook__(*error)
        end_process(1)

    sys.excepthook = end
