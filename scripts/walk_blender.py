"""A random walk over the extension in Blender: imports, asks, edits, undoes, redoes, renames, deletes, saves, opens, looks on.

python scripts/walk_blender.py SCENE.f4x --out FOLDER --steps 500
blender --factory-startup -P scripts/walk_blender.py -- SCENE.f4x --out FOLDER --seed 1 --minutes 60

In a window the steps come from a timer, between which Blender draws. `walk_actions.py` lists what the walk does. After every step
it asks whether Python printed a traceback, whether the sidebar says what the scene and its file hold, whether an edit was lost,
whether points stand where the core puts them, and whether undo, redo and opening brought back what was there.

FOLDER/steps.txt has the steps, its last line the one that Blender may have died in; FOLDER/errors.txt what went to standard
error. The last line is JSON, also in FOLDER/result.json: steps, minutes, how often what was done and refused, the slowest step of
each kind in seconds, memory in MiB whenever a new file was begun. Exit code 1 and a sentence where something is wrong, or where
memory grows. SCENE is copied, not changed; the same seed takes the same steps.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door
from walk_actions import ACTIONS, ANY, GROWS, copies_of, without_eevee
from walk_checks import WrongError, check_points, check_words, content, draw_panels, own_scenes, pending, require, same

from feature4x.addon.edits import fields  # isort: skip - there once `walk_actions` has loaded the extension
from feature4x.addon.scene import cache  # isort: skip - there once `walk_actions` has loaded the extension
from feature4x.addon.scene.scene_object import PATH, SceneObject  # isort: skip
from feature4x.f4x_core.edit.stack import EditStack, read_stack  # isort: skip

EPISODE = 80
"""Steps after which a new file is begun, so that memory can be compared."""
GROWTH = 1.15
"""Largest ratio of the memory at the last new files to that at the first of the second half, when everything is loaded."""
ONCE = 80
"""MiB that Blender and libraries load with the first step of a kind: Cycles, meshes."""
COMPARED = 4
"""New files of which the median is compared."""
UNDONE = 25
"""Steps of undo that the walk counts on; Blender keeps a few more."""
PAUSE = 0.02
"""Seconds between two steps in a window."""
PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


class Walk:
    """Where the walk is: its random numbers, its files, what undo should bring back."""

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

    # What actions ask and do

    def word(self) -> str:
        """Something to ask for, known or not."""
        return self.random.choice([*self.words, "zebra"])

    def frame(self) -> int:
        """A frame of the clip."""
        return self.random.randrange(6)

    def pixel(self) -> tuple[float, float]:
        """A place in the pictures."""
        render = bpy.context.scene.render
        return self.random.uniform(0, render.resolution_x), self.random.uniform(0, render.resolution_y)

    def scenes(self) -> list[SceneObject]:
        """All imported scenes of the current Blender scene."""
        return SceneObject.among(bpy.context.scene.objects)

    def scene(self) -> SceneObject | None:
        """The scene that operators work on."""
        return SceneObject.of(bpy.context.object)

    def pickable(self) -> list[bpy.types.Object]:
        """What a click could reach."""
        return [item for item in bpy.context.view_layer.objects if item.visible_get()]

    def collections(self) -> list[str]:
        """Names of the collections that hold scenes."""
        owners = [item.users_collection for item in bpy.data.objects if PATH in item]
        return [found[0].name for found in owners if found]

    def met(self, scene_object: SceneObject) -> EditStack:
        """What the file held when the scene met it last."""
        return cache.stack_from(scene_object._met, scene_object.name)

    def call(self, operator: Callable, **options: Any) -> bool:
        """Call an operator as a button does; whether it did something. A refusal in one sentence is an answer."""
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
        """Call an operator that adds an edit; its refusal leaves everything as it was."""
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
        """Blender has ended a step of undo: undo has to bring this back."""
        self._pushed = [*self._pushed[: self._at + 1], content()][-UNDONE:]
        self._at = len(self._pushed) - 1

    def undo(self) -> None:
        """Undo once: what was there before comes back."""
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
        with _in_viewport():  # there is no current window any more
            self.begin_undo()

    def note(self, line: str) -> None:
        """Write a line into the list of steps."""
        self._log.write(f"{line}\n")

    # The walk

    def step(self) -> None:
        """One action, and a look at everything."""
        if self.steps % EPISODE == 0:
            self._begin_file()
        names, weights = zip(*((name, each.weight) for name, each in ACTIONS.items()), strict=True)
        name = self.random.choices(names, weights)[0]
        chosen, edits, files = ACTIONS[name], pending(), self._in_files()
        self.steps += 1
        self.note(f"{self.steps} {name}")
        begin = time.monotonic()
        with _in_viewport():
            chosen.run(self)
        without_eevee()
        self.slowest[name] = max(self.slowest.get(name, 0.0), round(time.monotonic() - begin, 2))
        bpy.context.view_layer.update()
        fields.show_late()  # in a window a timer shows what a drag has changed
        self._check(chosen.edits, edits)
        require(chosen.file or files == self._in_files(), "a scene file has changed without being saved")

    def _check(self, may: str, before: dict[int, list]) -> None:
        for uid, edits in pending().items() if may != ANY else ():
            kept = edits[: len(before.get(uid, edits))] if may == GROWS else edits
            require(before.get(uid, kept) == kept, f"edits were {before.get(uid)} and are {edits}")
        for scene_object in own_scenes():
            check_words(scene_object)
            check_points(scene_object)
        if bpy.app.background:
            draw_panels()
        printed = self._errors.read()
        require("Traceback" not in printed, printed)

    def _begin_file(self) -> None:
        """Begin a new file with both scene files as they were at first, and note how much memory is in use."""
        self.note("new file")
        for path in (*self.folder.glob("*.away"), *self.folder.glob("*.blend*")):
            path.unlink()
        self.files, self.blend = copies_of(self.source, self.folder), None
        bpy.ops.wm.read_homefile(use_empty=True, load_ui=False)
        for path in self.files:
            bpy.ops.f4x.import_scene(filepath=str(path))
        with _in_viewport():
            self.begin_undo()
        gc.collect()
        self.memory.append(resident())

    def begin_undo(self) -> None:
        """Count steps of undo anew: nothing before this is undone."""
        bpy.ops.ed.undo_push(message="begin")
        self._pushed, self._at = [content()], 0

    def _in_files(self) -> list[str]:
        return [cache.text_of(read_stack(path)) if path.exists() else "" for path in self.files]

    def check_memory(self) -> None:
        """Raise `WrongError` where the last new files need more memory than the first warm ones."""
        warm = self.memory[len(self.memory) // 2 :]
        if len(warm) >= 2 * COMPARED:
            first, last = (sorted(part)[COMPARED // 2] for part in (warm[:COMPARED], warm[-COMPARED:]))
            require(last <= GROWTH * first + ONCE, f"memory grew from {first:.0f} to {last:.0f} MiB: {self.memory}")


def resident() -> float:
    """MiB of memory in use by this process, without what the C library keeps free; 0 where the system does not tell."""
    try:
        ctypes.CDLL(None).malloc_trim(0)
        return round(int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 2**20, 1)
    except (OSError, AttributeError, TypeError):  # another system than Linux
        return 0.0


def _catch_errors(path: Path) -> Any:
    """Let standard error, Blender's own too, go to a file; returns a reader of it."""
    sys.stderr.flush()
    with open(path, "w") as file:
        os.dup2(file.fileno(), 2)
    return open(path, errors="replace")


@contextmanager
def _in_viewport() -> Iterator[None]:
    """A context in which operators find a 3D viewport, where there is a window with one."""
    windows = [] if bpy.app.background else bpy.context.window_manager.windows
    for window in windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                region = next(region for region in area.regions if region.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    yield
                return
    yield


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="walk_blender.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="scene file, name.f4x")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER", help="for copies, the list of steps and the result"
    )
    parser.add_argument("--seed", type=int, default=0, help="another seed takes other steps (default: 0)")
    parser.add_argument("--steps", type=int, default=10**9, help="end after so many steps")
    parser.add_argument("--minutes", type=float, default=10**9, help="end after so much time")
    parser.add_argument("--words", default="square,wall", help="words that the scene knows (default: %(default)s)")
    return parser.parse_args(arguments)


def main() -> None:
    """Walk until the end, in a window between its redraws."""
    options = parse(door.arguments())
    options.out.mkdir(parents=True, exist_ok=True)
    door.load_extension().register()
    bpy.context.preferences.edit.undo_steps = 2 * UNDONE
    bpy.context.preferences.filepaths.save_version = 0
    bpy.context.preferences.filepaths.file_preview_type = "NONE"  # drawn by the processor it takes a minute
    walk = Walk(options.scene.resolve(), options.out.resolve(), options.seed, options.words.split(","))
    begin = time.monotonic()

    def go_on() -> float | None:
        if walk.steps < options.steps and time.monotonic() - begin < 60 * options.minutes:
            try:
                walk.step()
                return PAUSE
            except Exception as error:
                _end(walk, begin, str(error) if isinstance(error, WrongError) else repr(error), error)
        try:
            walk.check_memory()
        except WrongError as error:
            _end(walk, begin, str(error))
        _end(walk, begin)
        return None

    if bpy.app.background:
        while go_on():
            pass
    bpy.app.timers.register(go_on, first_interval=1.0, persistent=True)


def _end(walk: Walk, begin: float, wrong: str = "", error: Exception | None = None) -> None:
    """Say what came of it and leave; Blender 4.5 would hang with classes registered."""
    if error is not None:
        sys.excepthook(type(error), error, error.__traceback__)
    summary = {"steps": walk.steps, "minutes": round((time.monotonic() - begin) / 60, 1), "memory": walk.memory}
    summary |= {"slowest": walk.slowest, "tally": dict(sorted(walk.tally.items())), "wrong": wrong}
    (walk.folder / "result.json").write_text(json.dumps(summary, indent=1))
    print(json.dumps(summary), flush=True)
    door.end(1 if wrong else 0)


if __name__ == "__main__":
    main()
