"""A person at the window: types a word, queries, recolours, undoes, redoes and saves, in a real Blender with a display.

python scripts/check_window.py SCENE.f4x --root CHROOT --word dog --out FOLDER

Needs root: CHROOT is a system with Blender, Xvfb and xdotool in which this runs (`docs/blender.md`). Screenshots go to
FOLDER; exit code 1 and the step's name where the window does not do what it should. SCENE is copied, not changed.
"""

import argparse
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
SIZE = (1400, 1000)
"""Pixels of the screen; the places below are read off its screenshots."""
PLACES = {
    "text": (936, 314),
    "query": (1050, 314),
    "recolour": (1050, 526),
    "save": (1002, 156),
    "viewport": (300, 800),
}
PATIENCE, TRIES = 120.0, 4
"""Seconds and attempts for one step: pictures are drawn by the processor, and the machine may be busy."""
STARTUP = """
import json, sys, traceback
sys.path.insert(0, "{home}/feature4x/scripts")
import bpy, door
door.load_extension().register()
bpy.context.preferences.view.show_splash = False  # it would take the first click
begun = False

def tell():
    global begun
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    if not begun:
        begun = True
        for item in list(bpy.data.objects):
            bpy.data.objects.remove(item)
        region = next(region for region in area.regions if region.type == "WINDOW")
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.f4x.import_scene("EXEC_DEFAULT", True, filepath="{home}/scene.f4x")
            bpy.context.scene.frame_set({frame})
            bpy.context.scene.render.engine = "FEATURE4X"
            space = area.spaces.active
            space.shading.type = "{shading}"
            space.show_region_ui = True
            space.overlay.show_relationship_lines = space.overlay.show_extras = False
            bpy.ops.ed.undo_push(message="Import")
        return 0.5
    sidebar = next(region for region in area.regions if region.type == "UI")
    try:
        sidebar.active_panel_category = "Feature4X"  # read-only until the sidebar was drawn once
    except (AttributeError, TypeError):
        return 0.5
    from feature4x.addon import session
    root = session.root_of(bpy.context.object)
    if root is not None:
        told = root.f4x
        state = dict(selected=told.selected, total=told.total, text=told.text)
        state |= dict(edits=len(told.history), saved=session.is_saved(root))
        with open("{home}/state.json", "w") as file:
            json.dump(state, file)
    return 0.3

bpy.app.timers.register(tell, first_interval=1.0, persistent=True)
"""


class Window:
    """Blender's window on a screen of its own."""

    def __init__(self, root: Path, home: Path, display: str, out: Path, pause: float):
        self.root, self.home, self.display, self.out, self.pause = root, home, display, out, pause

    def hand(self, *command: object) -> None:
        """Move the mouse or press keys, as xdotool says."""
        told = ["chroot", str(self.root), "env", f"DISPLAY={self.display}", "xdotool", *map(str, command)]
        subprocess.run(told, check=True, timeout=30)
        time.sleep(self.pause)

    def click(self, place: str) -> None:
        """Click on a place of the window."""
        x, y = PLACES[place]  # no pause before the click: it would only close the tooltip that comes up
        self.hand("mousemove", x - 2, y, "sleep", 0.2, "mousemove", x, y, "sleep", 0.2, "click", 1)

    def state(self) -> dict:
        """What the sidebar says."""
        try:
            return json.loads((self.home / "state.json").read_text())
        except (OSError, ValueError):  # not there yet, or being written
            return dict.fromkeys(("selected", "total", "text", "edits", "saved"))

    def until(self, step: str, reached: Callable[[dict], bool], action: Callable[[], None] | None = None) -> dict:
        """Act until the sidebar says so, and take a picture; SystemExit where it never does.

        A hand may come too early: while a window draws, presses get lost.
        """
        start = time.monotonic()
        for _ in range(TRIES):
            if action is not None:
                action()
            waited = time.monotonic()
            while not reached(state := self.state()) and time.monotonic() - waited < PATIENCE / TRIES:
                time.sleep(0.1)
            if reached(state):
                break
        else:
            self.picture(f"{step}_failed")
            raise SystemExit(f"{step}: not after {TRIES} tries; the sidebar says {state}")
        print(f"{step}: {time.monotonic() - start:.1f} s, {state}", flush=True)
        time.sleep(3 * self.pause)  # until the picture is drawn
        self.picture(step)
        return state

    def picture(self, name: str) -> None:
        """Blender's own screenshots are black without a graphics card: take what the screen shows."""
        from PIL import ImageGrab

        ImageGrab.grab(xdisplay=self.display).save(self.out / f"{name}.png")


@contextmanager
def blender(root: Path, scene: Path, out: Path, frame: int, shading: str, pause: float) -> Iterator[Window]:
    """A Blender with the extension and the scene, until the block ends."""
    with tempfile.TemporaryDirectory(dir=root / "tmp") as folder:
        home = Path(folder)
        inside = f"/tmp/{home.name}"
        shutil.copy(scene, home / "scene.f4x")
        for name in ("addon", "f4x_core", "scripts"):
            shutil.copytree(REPOSITORY / name, home / "feature4x" / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(REPOSITORY / "__init__.py", home / "feature4x")
        (home / "startup.py").write_text(STARTUP.format(home=inside, frame=frame, shading=shading))
        display = f":{90 + os.getpid() % 900}"
        size = [str(side) for side in SIZE]
        environment = os.environ | {"DISPLAY": display, "HOME": inside, "BLENDER_USER_RESOURCES": f"{inside}/user"}
        chroot = ["chroot", str(root)]
        screen = [
            *chroot,
            "Xvfb",
            display,
            "-screen",
            "0",
            "x".join([*size, "24"]),
            "-nolisten",
            "tcp",
            "-listen",
            "unix",
        ]
        program = [*chroot, "blender", "--factory-startup", "--window-geometry", "0", "0", *size]
        program += ["--python", f"{inside}/startup.py"]
        with open(out / "blender.log", "w") as log:
            children = [subprocess.Popen(screen, env=environment, stdout=log, stderr=log)]
            time.sleep(2)
            children.append(subprocess.Popen(program, env=environment, stdout=log, stderr=log))
            try:
                yield Window(root, home, display, out, pause)
            finally:
                for child in reversed(children):
                    child.kill()
                    child.wait()


def main() -> None:
    """Run the steps."""
    parser = argparse.ArgumentParser(prog="check_window.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="scene file with features")
    parser.add_argument("--root", type=Path, required=True, help="folder of the system to chroot into")
    parser.add_argument("--word", default="dog", help="what to query")
    parser.add_argument("--frame", type=int, default=0, help="clip frame to look at")
    parser.add_argument("--shading", default="SOLID", help="of the viewport: SOLID, MATERIAL or RENDERED")
    parser.add_argument("--pause", type=float, default=1.0, help="seconds to wait after everything that a hand does")
    parser.add_argument("--out", type=Path, required=True, help="folder for screenshots")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    look = (options.frame, options.shading, options.pause)
    with blender(options.root, options.scene, options.out, *look) as window:

        def type_word() -> None:
            window.click("text")
            window.hand("key", "ctrl+a")
            window.hand("type", "--delay", "100", options.word)
            window.picture("1_typed")
            window.hand("key", "Return")  # takes the suggestion
            window.hand("key", "Return")

        def press(keys: str) -> None:
            window.hand("mousemove", *PLACES["viewport"])
            window.hand("key", keys)

        window.until("0_imported", lambda state: state["total"] and not state["selected"])
        window.until("2_text", lambda state: state["text"] == options.word, type_word)
        asked = window.until("3_queried", lambda state: state["selected"], lambda: window.click("query"))
        window.until("4_recoloured", lambda state: state["edits"] == 1, lambda: window.click("recolour"))
        state = window.until("5_undone", lambda state: state["edits"] == 0, lambda: press("ctrl+z"))
        if state["selected"] != asked["selected"]:
            raise SystemExit(f"5_undone: the selection went as well; the sidebar says {state}")
        window.until("6_redone", lambda state: state["edits"] == 1, lambda: press("ctrl+shift+z"))
        window.until("7_saved", lambda state: state["saved"] and state["edits"] == 1, lambda: window.click("save"))
        shutil.copy(window.home / "scene.f4x", options.out / "saved.f4x")


if __name__ == "__main__":
    main()
