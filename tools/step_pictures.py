"""The pictures of docs/blender_steps.md and docs/compositing.md, taken from the window of a real Blender.

python tools/step_pictures.py --root CHROOT [--out FOLDER]

Needs root: CHROOT is a system with Blender, Xvfb and xdotool, as `scripts/real_blender.py` makes it. `step_actions.py` calls what
the buttons call; gestures, keys and the panels' headers are the mouse's and the keyboard's. The scene is that of `step_scene.py`.
Exit code 1 and the step's name where the window does not do what it should.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from PIL import Image, ImageGrab

sys.path.extend(str(Path(__file__).resolve().parents[1] / name) for name in ("tools", "scripts", ""))
from check_window import DRAWN, F12, PATIENCE, Window
from real_blender import clean_profile
from step_scene import step_scene

from f4x_core.scene import write_scene

SIZE = (900, 600)
"""Pixels of the window."""
LARGE = (1152, 908)
"""That of docs/images/sidebar.jpg."""
PANELS = ("Scene", "Select", "Edit", "Edits", "Motion", "Mesh", "Clean and Place", "Tasks")
HEADER, PITCH = (40, 96), 28
"""Of the first panel: pixels from the sidebar's left side, and from the window's top; height of a closed panel."""
PASSES = (808, 39)
"""Pixel of the menu in which a picture's pass is chosen."""
WIDE, QUALITY = 640, 74
"""Pixels across a picture of the page; of its JPEG."""


class Guide(Window):
    """Robot that takes the pictures: Blender's window, a mouse and a keyboard, and a camera."""

    def __init__(self, *given):
        super().__init__(*given)
        self.number = 0
        self.opened: Sequence[str] = ()

    def take(self, step: str, reached: Callable[[dict], bool] = lambda state: True) -> dict:
        """Let Blender take a step and wait until the state is as it should be; SystemExit where it never is."""
        self.number += 1
        new = self.home / "order.new"
        new.write_text(json.dumps({"number": self.number, "name": step}))
        os.replace(new, self.home / "order.json")
        return self.expect(step, lambda state: state.get("taken") == self.number and reached(state))

    def expect(self, step: str, reached: Callable[[dict], bool]) -> dict:
        """Wait until the state is as it should be, and drawn."""
        start = time.monotonic()
        while not reached(state := self.state()) or state.get("error") or "failed" in state.get("jobs", ()):
            if time.monotonic() - start > PATIENCE or state.get("error") or "failed" in state.get("jobs", ()):
                self.screenshot(f"failed_{step}")
                raise SystemExit(f"{step}: {state}")
            time.sleep(0.1)
        self.wait(DRAWN)
        print(f"{step}: {time.monotonic() - start:.1f} s; {state}", flush=True)
        return state

    def press(self, key: str | int) -> None:
        """Press a key over the viewport."""
        self.hand("mousemove", SIZE[0] // 3, SIZE[1] // 2)
        self.hand("key", key)

    def drag(self, first: list[float], last: list[float]) -> None:
        """Draw a box, and keep a picture of it."""
        self.hand("mousemove", *map(round, first))
        self.hand("mousedown", 1)
        for part in (0.05, 0.5, 1.0):
            self.hand("mousemove", *(round(a + part * (b - a)) for a, b in zip(first, last, strict=True)))
        self.wait(DRAWN)
        self.picture("05_box")
        self.hand("mouseup", 1)

    def header(self, panel: str) -> None:
        """Move to the header of a panel, all above which are closed."""
        left = self.state()["sidebar"]
        self.hand("mousemove", left + HEADER[0], HEADER[1] + PITCH * PANELS.index(panel))

    def alone(self, panel: str) -> None:
        """Close all panels but the first, which Ctrl does in Blender."""
        self.header(panel)
        self.hand("keydown", "ctrl", "click", 1, "keyup", "ctrl")
        self.opened = [panel]

    def open(self, *panels: str) -> None:
        """Open these panels alone: close from above, open from below, so that each header is where it should be."""
        for panel in (*self.opened, *reversed(panels)):
            self.header(panel)
            self.hand("click", 1)
        self.opened = panels

    def picture(self, name: str) -> None:
        """Keep what the screen shows, smaller."""
        taken = ImageGrab.grab(xdisplay=self.display)
        self.keep(name, taken.resize((WIDE, round(WIDE * taken.height / taken.width)), Image.Resampling.LANCZOS))

    def keep(self, name: str, picture: Image.Image) -> None:
        """Write a picture."""
        picture.convert("RGB").save(self.out / f"{name}.jpg", quality=QUALITY, optimize=True)


@contextmanager
def blender(root: Path, out: Path, size: tuple[int, int]) -> Iterator[Guide]:
    """Run Blender with its default file and the extension, until the block ends."""
    with clean_profile(root) as profile:
        write_scene(step_scene(), profile.folder / "room.f4x")
        script = f"{profile.check_out()}/tools/step_actions.py"
        window = ("--factory-startup", "--window-geometry", 0, 0, *size)
        with profile.screen(size, sys.stderr) as start:
            start("blender", *window, "--python", script, "--", profile.inside)
            yield Guide(profile, profile.display, out)


def begin(guide: Guide, keep: Callable[[str], None]) -> None:
    """Import the scene and open the sidebar's tab."""
    guide.take("maximise")
    guide.take("drop")
    keep("01_drop")
    guide.hand("key", "Return")
    guide.expect("import", lambda state: bool(state.get("total")))
    keep("02_imported")
    guide.take("look")
    guide.take("choose_tab")


def walk(guide: Guide) -> None:
    """Take the steps of the page."""
    begin(guide, guide.picture)
    guide.picture("03_panel")
    guide.alone("Scene")
    guide.open("Select")
    guide.take("query", lambda state: state["selected"])
    guide.picture("04_query")
    corners = guide.take("box")["places"]
    guide.drag(*corners)
    guide.expect("box", lambda state: state["last"] == ["F4X_OT_select_box"])
    guide.open("Edit")
    guide.take("plan", lambda state: state["readings"])
    guide.picture("06_plan")
    guide.open("Edit", "Edits")
    guide.take("apply", lambda state: len(state["edits"]) == 1)
    guide.picture("07_applied")
    guide.press("ctrl+z")
    guide.expect("undo", lambda state: not state["edits"])
    guide.picture("08_undone")
    guide.press("ctrl+shift+z")
    guide.expect("redo", lambda state: len(state["edits"]) == 1)
    guide.open("Motion")
    guide.take("move_node")
    guide.picture("09_node")
    guide.open("Edits")
    guide.take("write_motion")
    guide.picture("10_written")
    guide.open("Mesh")
    guide.take("mesh", lambda state: state["jobs"] == ["done"])
    guide.take("show_mesh")
    guide.picture("11_mesh")
    guide.open("Tasks")
    guide.take("camera")
    guide.picture("12_camera")
    guide.open("Edit", "Edits")
    guide.take("plate", lambda state: len(state["edits"]) >= 2)
    guide.picture("13_plate")
    guide.take("passes")
    guide.press(F12)
    guide.expect("render", lambda state: state["rendered"] == "complete")
    guide.hand("mousemove", *PASSES)
    guide.hand("click", 1)
    guide.wait(DRAWN)
    guide.picture("14_render")
    guide.press("Escape")
    guide.press("Escape")
    guide.expect("back", lambda state: state["screen"] == "view")
    guide.open("Edits")
    guide.take("save", lambda state: state["saved"])
    guide.picture("15_saved")


def panels(guide: Guide) -> None:
    """Take the pictures of docs/blender.md: the sidebar, and its tasks."""
    begin(guide, lambda name: None)
    [place] = guide.take("gold", lambda state: len(state["edits"]) == 1)["places"]
    guide.hand("mousemove", *map(round, place))
    guide.hand("click", 1)
    guide.expect("point", lambda state: state["selected"] and state["last"] == ["F4X_OT_query_point"])
    guide.take("plan_green", lambda state: state["readings"])
    guide.keep("../sidebar", ImageGrab.grab(xdisplay=guide.display))
    guide.alone("Scene")
    guide.open("Select", "Tasks")
    guide.take("name_it", lambda state: len(state["edits"]) == 2)
    guide.take("mesh", lambda state: state["jobs"] == ["done"])
    left = guide.take("fine_mesh", lambda state: state["jobs"] == ["done", "running"] and state["stages"][1] == "mesh")[
        "sidebar"
    ]
    guide.keep(
        "../jobs", ImageGrab.grab(xdisplay=guide.display).crop((left, HEADER[1] - 14, left + 266, LARGE[1] - 20))
    )


def compositing(guide: Guide) -> None:
    """Take the pictures of docs/compositing.md."""
    begin(guide, lambda name: None)
    guide.take("add_mesh")
    guide.picture("../compositing_1_mesh")
    guide.alone("Scene")
    guide.take("show_mesh_panel")
    guide.open("Mesh")
    guide.take("ball_mesh", lambda state: state["jobs"] == ["done"])
    guide.take("show_mesh_panel")
    guide.picture("../compositing_2_panel")
    guide.take("composite")
    guide.take("show_nodes_of_compositor")
    guide.take("choose_nodes")
    guide.take("fit_nodes")
    time.sleep(1)  # the view moves there
    guide.picture("../compositing_3_nodes")
    guide.take("show_viewport")
    guide.press(F12)
    guide.expect("render", lambda state: state["rendered"] == "complete")
    guide.wait(DRAWN)
    guide.picture("../compositing_4_render")


def main() -> None:
    """Take all pictures."""
    parser = argparse.ArgumentParser(prog="step_pictures.py", description=__doc__.splitlines()[0])
    parser.add_argument("--root", type=Path, required=True, help="folder of the system to chroot into")
    parser.add_argument("--page", choices=("blender", "compositing"), help="only the pictures of this page")
    out = Path(__file__).resolve().parents[1] / "docs/images/steps"
    parser.add_argument(
        "--out",
        type=Path,
        default=out,
        help="of the steps; what stands elsewhere goes to its parent (default: docs/images/steps)",
    )
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.page != "compositing":
        with blender(options.root, options.out, SIZE) as guide:
            walk(guide)
        with blender(options.root, options.out, LARGE) as guide:
            panels(guide)
    if options.page != "blender":
        with blender(options.root, options.out, SIZE) as guide:
            compositing(guide)


if __name__ == "__main__":
    main()
