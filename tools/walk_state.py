"""The state of the random walk of `walk_blender.py`, which its actions read and change."""

from __future__ import annotations

import os
import random
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import door
from walk_checks import content, require, same

door.load_extension()

from feature4x.addon.scene import cache  # noqa: E402 - there once the extension is loaded
from feature4x.addon.scene.scene_object import PATH, SceneObject  # noqa: E402
from feature4x.f4x_core.edit.stack import EditStack  # noqa: E402
from feature4x.f4x_core.scene import read_scene  # noqa: E402
from feature4x.f4x_core.scene.formats import export  # noqa: E402

UNDONE = 25
"""Steps of undo that the walk counts on; Blender keeps a few more."""


class Walk:
    """State of a random walk and the calls of its actions: random numbers, files, and what undo has to bring back."""

    def __init__(self, scene: Path, folder: Path, seed: int, words: list[str]):
        self.random, self.source, self.folder, self.words = random.Random(seed), scene, folder, words
        self.files = copies_of(scene, folder)
        self.blend: Path | None = None
        self.steps, self.tally, self.slowest = 0, Counter[str](), dict[str, float]()
        self.memory: list[float] = []
        self._log = open(folder / "steps.txt", "w", buffering=1)  # noqa: SIM115 - it stays open as long as the walk
        self._errors = _catch_errors(folder / "errors.txt")
        self._pushed: list[dict] = []
        self._at = 0

    def word(self) -> str:
        """Return something to ask for, known or not."""
        return self.random.choice([*self.words, "zebra"])

    def frame(self) -> int:
        """Return a frame of the clip."""
        return self.random.randrange(6)

    def pixel(self) -> tuple[float, float]:
        """Return a place in the pictures."""
        render = bpy.context.scene.render
        return self.random.uniform(0, render.resolution_x), self.random.uniform(0, render.resolution_y)

    def scenes(self) -> list[SceneObject]:
        """Return all imported scenes of the current Blender scene."""
        return SceneObject.among(bpy.context.scene.objects)

    def scene(self) -> SceneObject | None:
        """Return the scene that operators work on."""
        return SceneObject.of(bpy.context.object)

    def pickable(self) -> list[bpy.types.Object]:
        """Return the objects that a click can reach."""
        return [item for item in bpy.context.view_layer.objects if item.visible_get()]

    def collections(self) -> list[str]:
        """Return the names of the collections that hold scenes."""
        owners = [item.users_collection for item in bpy.data.objects if PATH in item]
        return [found[0].name for found in owners if found]

    def met(self, scene_object: SceneObject) -> EditStack:
        """Return the stack that the file held when the scene last read or wrote it."""
        return cache.stack_from(scene_object._met, scene_object.name)

    def call(self, operator: Callable, **options: Any) -> bool:
        """Call an operator as a button does; return True if it did something. A refusal in one sentence is an answer."""
        name = operator.idname_py()  # type: ignore[attr-defined]
        self.note(f"  {name} {options}")
        try:
            done = "FINISHED" in operator("EXEC_DEFAULT", True, **options)
        except (RuntimeError, TypeError) as error:
            require("Traceback" not in str(error), f"{name} says {error}")
            self.note(f"    {' '.join(str(error).split())[:200]}")
            done = False
        self.tally[f"{name} {'done' if done else 'refused'}"] += 1
        if done and "UNDO" in operator.bl_options:  # type: ignore[attr-defined]
            self.remember()
        return done

    def edit(self, operator: Callable, **options: Any) -> None:
        """Call an operator that adds an edit; check that a refusal leaves everything as it was."""
        before = content()
        if not self.call(operator, **options):
            same(before, content(), "refused")

    def push(self, name: str) -> None:
        """End a step of undo, as Blender does when a slider was moved; in other modes it undoes no sliders, and counts anew."""
        if bpy.context.mode == "OBJECT":
            bpy.ops.ed.undo_push(message=name)
            self.remember()
        else:
            self.begin_undo()

    def remember(self) -> None:
        """Note the state that undo has to bring back, as Blender has ended a step of undo."""
        self._pushed = [*self._pushed[: self._at + 1], content()][-UNDONE:]
        self._at = len(self._pushed) - 1

    def undo(self) -> None:
        """Undo once, and check that the state before is back."""
        if self._at > 0 and bpy.ops.ed.undo.poll():
            self._at -= 1
            bpy.ops.ed.undo()
            same(self._pushed[self._at], content(), "undone")

    def redo(self) -> None:
        """Redo once."""
        if self._at + 1 < len(self._pushed) and bpy.ops.ed.redo.poll():
            self._at += 1
            bpy.ops.ed.redo()
            same(self._pushed[self._at], content(), "redone")

    def open(self, path: Path) -> None:
        """Open a .blend; undo begins anew."""
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
        with in_viewport():  # there is no current window any more
            self.begin_undo()

    def note(self, line: str) -> None:
        """Write a line into the list of steps."""
        self._log.write(f"{line}\n")

    def begin_undo(self) -> None:
        """Count steps of undo anew: nothing before this is undone."""
        bpy.ops.ed.undo_push(message="begin")
        self._pushed, self._at = [content()], 0


def copies_of(scene: Path, folder: Path) -> list[Path]:
    """Return copies of a scene file in `folder`, which a walk may write to; a broken one lies beside them."""
    (folder / "broken.f4x").write_bytes(b"no scene")
    if not (folder / "splats.ply").exists():
        export(read_scene(scene), folder / "splats.ply", [0.0])
    return [Path(shutil.copy(scene, folder / f"{name}.f4x")) for name in ("one", "two")]


def _catch_errors(path: Path) -> Any:
    """Let standard error, Blender's own too, go to a file; returns a reader of it."""
    sys.stderr.flush()
    with open(path, "w") as file:
        os.dup2(file.fileno(), 2)
    return open(path, errors="replace")


@contextmanager
def in_viewport() -> Iterator[None]:
    """Let operators find a 3D viewport within a `with` block, where there is a window with one."""
    windows = [] if bpy.app.background else bpy.context.window_manager.windows
    for window in windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                region = next(region for region in area.regions if region.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    yield
                return
    yield
