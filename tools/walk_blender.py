"""A random walk over the extension in Blender: imports, asks, edits, undoes, redoes, renames, deletes, saves, opens, looks on.

python tools/walk_blender.py SCENE.f4x --out FOLDER --steps 500
blender --factory-startup -P tools/walk_blender.py -- SCENE.f4x --out FOLDER --seed 1 --minutes 60

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
import sys
import time
from pathlib import Path

import bpy

sys.path.extend(str(Path(__file__).resolve().parents[1] / name) for name in ("tools", "scripts"))
import door
from walk_actions import ACTIONS, ANY, GROWS, without_eevee
from walk_checks import WrongError, check_points, check_words, draw_panels, own_scenes, pending, require
from walk_state import UNDONE, Walk, copies_of, in_viewport

from feature4x.addon.edits import fields  # isort: skip - there once `walk_actions` has loaded the extension
from feature4x.addon.scene import cache  # isort: skip - there once `walk_actions` has loaded the extension
from feature4x.f4x_core.edit.stack import read_stack  # isort: skip

EPISODE = 80
"""Steps after which a new file is begun, so that memory can be compared."""
GROWTH = 1.15
"""Largest ratio of the memory at the last new files to that at the first of the second half, when everything is loaded."""
ONCE = 80
"""MiB that Blender and libraries load with the first step of a kind: Cycles, meshes."""
COMPARED = 4
"""New files of which the median is compared."""
PAUSE = 0.02
"""Seconds between two steps in a window."""
PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


class RandomWalk(Walk):
    """A walk that takes random actions, and checks the scene after each."""

    def step(self) -> None:
        """Take one action, and check everything."""
        if self.steps % EPISODE == 0:
            self._begin_file()
        names, weights = zip(*((name, each.weight) for name, each in ACTIONS.items()), strict=True)
        name = self.random.choices(names, weights)[0]
        chosen, edits, files = ACTIONS[name], pending(), self._in_files()
        self.steps += 1
        self.note(f"{self.steps} {name}")
        begin = time.monotonic()
        with in_viewport():
            chosen.run(self)
        without_eevee()
        self.slowest[name] = max(self.slowest.get(name, 0.0), round(time.monotonic() - begin, 2))
        bpy.context.view_layer.update()
        fields.show_late()  # in a window a timer shows what a drag has changed
        self._check(chosen.edits, edits)
        require(chosen.file or files == self._in_files(), "a scene file has changed without being saved")

    def _check(self, may: str, before: dict[int, list]) -> None:
        for uid, edits in pending().items() if may != ANY else ():
            was = before.get(uid, edits)
            kept = edits[: len(was)] if may == GROWS else edits
            undone = {edit["edit"] for edit in edits[len(was) :] if edit["op"] == "take_back"}  # by a sentence
            same = [one == other or other["id"] in undone for one, other in zip(was, kept, strict=False)]
            require(len(was) == len(kept) and all(same), f"edits were {was} and are {edits}")
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
        with in_viewport():
            self.begin_undo()
        gc.collect()
        self.memory.append(resident())

    def _in_files(self) -> list[str]:
        return [cache.text_of(read_stack(path)) if path.exists() else "" for path in self.files]

    def check_memory(self) -> None:
        """Raise `WrongError` where the last new files need more memory than the first warm ones."""
        warm = self.memory[len(self.memory) // 2 :]
        if len(warm) >= 2 * COMPARED:
            first, last = (sorted(part)[COMPARED // 2] for part in (warm[:COMPARED], warm[-COMPARED:]))
            require(last <= GROWTH * first + ONCE, f"memory grew from {first:.0f} to {last:.0f} MiB: {self.memory}")


def resident() -> float:
    """Return the MiB of memory in use by this process, without what the C library keeps free; 0 where the system does not tell."""
    try:
        ctypes.CDLL(None).malloc_trim(0)
        return round(int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 2**20, 1)
    except (OSError, AttributeError, TypeError):  # another system than Linux
        return 0.0


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
    walk = RandomWalk(options.scene.resolve(), options.out.resolve(), options.seed, options.words.split(","))
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


def _end(walk: RandomWalk, begin: float, wrong: str = "", error: Exception | None = None) -> None:
    """Print the result and end the process; Blender 4.5 would hang with classes registered."""
    if error is not None:
        sys.excepthook(type(error), error, error.__traceback__)
    summary = {"steps": walk.steps, "minutes": round((time.monotonic() - begin) / 60, 1), "memory": walk.memory}
    summary |= {"slowest": walk.slowest, "tally": dict(sorted(walk.tally.items())), "wrong": wrong}
    (walk.folder / "result.json").write_text(json.dumps(summary, indent=1))
    print(json.dumps(summary), flush=True)
    door.end(1 if wrong else 0)


if __name__ == "__main__":
    main()
