"""A person at the window of a real Blender: asks by word, click and box, recolours, undoes, redoes, saves, stops F12 and a job.

python tools/check_window.py SCENE.f4x --root CHROOT --word dog --out FOLDER

Needs root: CHROOT is a system with Blender, Xvfb and xdotool, as `scripts/real_blender.py` makes it. Screenshots go to
FOLDER; the last line is JSON: what the sidebar said after every step, the seconds and the tries it took. Exit code 1 and the
step's name where the window does not do what it should. SCENE is copied, not changed.
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from real_blender import Profile, clean_profile

SIZE = (1400, 1000)
"""Pixels of the screen; the places below are read off its screenshots."""
PLACES = {
    "text": (970, 193),
    "recolor": (1050, 466),
    "save": (1002, 731),
    "point": (1010, 223),
    "box": (1072, 223),
    "stop job": (1095, 778),
    "viewport": (300, 800),
}
SCROLL_DOWN, F12 = 5, 96
"""Button of the mouse; number of the key, whose name xdotool reaches with Alt held."""
RENDERED = 8000
"""Pixels across the picture that F12 draws: large enough to be stopped."""
PATIENCE = 120.0
"""Seconds for one step: pictures are drawn by the processor, and the machine may be busy."""
SEEN, DRAWN, LOST = 2, 5, 12
"""Times that Blender tells its state, 0.3 s apart when it is idle, until it has handled what a hand did, has drawn what came of
it, and would have done what it was told to."""
STARTUP = """
import json, os, sys
sys.path.insert(0, "{home}/feature4x/scripts")
import bpy, door
import numpy as np
from bpy_extras import view3d_utils
from mathutils import Vector
door.load_extension().register()
from feature4x.addon.jobs import runner, worker
from feature4x.addon.render import viewport_gpu
from feature4x.addon.scene.scene_object import SELECTED, SceneObject
viewport_gpu.is_software = lambda: False  # a program plays the graphics card here, and is to be tried
view = bpy.context.preferences.view
view.show_splash = view.show_tooltips = False  # they would take a click
view.render_display_type = "SCREEN"  # there is no window manager that would focus a new window
begun = False
state = dict(beat=0, thing=None, rendered="", screen="")
WAIT = "import json, time; from f4x_core.processes import stop_with_parent; stop_with_parent()\\n"
WAIT += "while True: print(json.dumps(dict(stage='wait', done=0, total=0)), flush=True); time.sleep(1)"

def tell(**more):
    state.update(beat=state["beat"] + 1, **more)
    with open("{home}/state.new", "w") as file:
        json.dump(state, file)
    os.replace("{home}/state.new", "{home}/state.json")

def no_card():
    return None

def note(what):
    return lambda *_: state.update(rendered=what)

bpy.app.handlers.render_pre.append(note("running"))
bpy.app.handlers.render_complete.append(note("complete"))
bpy.app.handlers.render_cancel.append(note("cancelled"))

def on_screen(scene_object, area, region):
    # left, top, right, bottom of most of the selected Gaussians, pixels of the screen
    chosen = scene_object.read(SELECTED)
    points = scene_object.shown.scene.posed(scene_object.frame).means[chosen]
    points = [scene_object.root.matrix_world @ Vector(point) for point in points[:: max(1, len(points) // 1000)].tolist()]
    view = area.spaces.active.region_3d
    seen = np.array([view3d_utils.location_3d_to_region_2d(region, view, point) for point in points])
    (left, right), (bottom, top) = np.percentile(seen, (3, 97), axis=0).T
    return [left + region.x, {height} - top - region.y, right + region.x, {height} - bottom - region.y]

def look():
    global begun
    window = bpy.context.window_manager.windows[0]
    area = next((area for area in window.screen.areas if area.type == "VIEW_3D"), None)
    if area is None:  # a picture that is being rendered fills the window
        tell(screen="picture")
        return 0.3
    if not begun:
        begun = True
        for item in list(bpy.data.objects):
            bpy.data.objects.remove(item)
        region = next(region for region in area.regions if region.type == "WINDOW")
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.f4x.import_scene("EXEC_DEFAULT", True, filepath="{home}/scene.f4x")
            bpy.context.scene.frame_set({frame})
            bpy.context.scene.render.engine = "FEATURE4X"
            bpy.context.scene.render.resolution_percentage = 100 * {rendered} // bpy.context.scene.render.resolution_x
            space = area.spaces.active
            space.shading.type = "{shading}"
            space.show_region_ui = True
            space.overlay.show_relationship_lines = space.overlay.show_extras = False
            bpy.ops.ed.undo_push(message="Import")
        return 0.5
    sidebar = next(region for region in area.regions if region.type == "UI")
    if sidebar.active_panel_category != "Feature4X":  # every assignment draws the sidebar anew, and presses get lost
        try:
            sidebar.active_panel_category = "Feature4X"  # read-only until the sidebar was drawn once
        except (AttributeError, TypeError):
            return 0.5
    scene_object = SceneObject.of(bpy.context.object)
    if scene_object is not None:
        properties = scene_object.state
        if properties.selected and state["thing"] is None:
            region = next(region for region in area.regions if region.type == "WINDOW")
            state["thing"] = on_screen(scene_object, area, region)
        if os.path.exists("{home}/tool"):
            with open("{home}/tool") as file:
                name = file.read()
            region = next(region for region in area.regions if region.type == "WINDOW")
            with bpy.context.temp_override(window=window, area=area, region=region):
                if bpy.context.workspace.tools.from_space_view3d_mode("OBJECT").idname != name:
                    bpy.ops.wm.tool_set_by_id(name=name)
        if os.path.exists("{home}/start_job") and not runner.all_jobs():
            runner.start(worker.Job("Wait", [sys.executable, "-c", WAIT]))
        last, camera = bpy.context.window_manager.operators, bpy.context.scene.camera
        if os.path.exists("{home}/cover") and "cover" not in bpy.data.objects:  # the whole picture, half way to the scene
            corners = camera.data.view_frame(scene=bpy.context.scene)
            mesh = bpy.data.meshes.new("cover")
            mesh.from_pydata([camera.matrix_world @ (corner / (-2 * corner.z)) for corner in corners], [], [(0, 1, 2, 3)])
            bpy.context.collection.objects.link(bpy.data.objects.new("cover", mesh))
        space = area.spaces.active
        processor = space.shading.type == "{shading}" and viewport_gpu.picture is no_card
        if os.path.exists("{home}/processor") and not processor:  # a viewport that shows the engine anew asks for a card again
            space.shading.type = "{shading}" if space.shading.type == "WIREFRAME" else "WIREFRAME"
            viewport_gpu.picture = no_card
        region = next(region for region in area.regions if region.type == "WINDOW")
        frame = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=bpy.context.scene)]
        across = [view3d_utils.location_3d_to_region_2d(region, area.spaces.active.region_3d, each).x for each in frame]
        tell(
            room=[min(across), max(across), sidebar.x - region.x],
            screen="view",
            selected=properties.selected,
            total=properties.total,
            text=properties.text,
            edits=len(properties.history),
            saved=scene_object.is_saved,
            last=last[-1].bl_idname if last else "",
            covered="cover" in bpy.data.objects,
            processor=processor,
            job=[job.state for job in runner.all_jobs()],
            stage=[job.stage for job in runner.all_jobs()],
        )
    return 0.3

bpy.app.timers.register(look, first_interval=1.0, persistent=True)
"""


class Window:
    """Blender's window on a screen of its own."""

    def __init__(self, profile: Profile, display: str, out: Path):
        self.profile, self.display, self.out = profile, display, out
        self.home = profile.folder
        self.steps: dict[str, dict] = {}

    def hand(self, *command: object) -> None:
        """Move the mouse or press keys, as xdotool says, and wait until Blender has seen it: what comes in a heap gets lost."""
        environment = self.profile.environment | {"DISPLAY": self.display}
        subprocess.run(self.profile.command("xdotool", *command), env=environment, check=True, timeout=30)
        self.wait(SEEN)

    def click(self, place: str) -> None:
        """Click on a place of the window."""
        self.hand("mousemove", *PLACES[place])
        self.hand("click", 1)

    def press(self, key: str | int) -> None:
        """Press a key over the viewport."""
        self.hand("mousemove", *PLACES["viewport"])
        self.hand("key", key)

    def draw(self, name: str, *places: tuple[float, float]) -> None:
        """Drag the mouse along `places`, and take a picture before its button is let go."""
        self.hand("mousemove", *places[0])
        self.hand("mousedown", 1)
        for place in places[1:]:
            self.hand("mousemove", *place)
        self.screenshot(name)
        self.hand("mouseup", 1)

    def state(self) -> dict:
        """Return the text of the sidebar, and what else Blender tells of itself."""
        nothing = (
            "screen",
            "room",
            "selected",
            "total",
            "text",
            "edits",
            "saved",
            "last",
            "thing",
            "rendered",
            "job",
            "stage",
            "covered",
            "processor",
        )
        state = {"beat": 0} | dict.fromkeys(nothing)
        try:
            return state | json.loads((self.home / "state.json").read_text())
        except OSError:  # not there yet
            return state

    def wait(self, beats: int) -> None:
        """Wait until Blender has reported its state this many times."""
        start, first = time.monotonic(), self.state()["beat"]
        while self.state()["beat"] < first + beats and time.monotonic() - start < PATIENCE:
            time.sleep(0.05)

    def start_job(self) -> None:
        """Let Blender start a job that never ends, and roll the sidebar to it."""
        (self.home / "start_job").touch()
        self.hand("mousemove", *PLACES["recolor"])
        self.hand("click", "--repeat", 40, "--delay", 50, SCROLL_DOWN)

    def until(self, step: str, reached: Callable[[dict], bool], action: Callable[[], None] | None = None) -> dict:
        """Act until the sidebar says so, and take a picture; SystemExit where it never does.

        A hand may come too early: while a window draws, presses get lost. One that may still be answered is not repeated.
        """
        start, tries, lost = time.monotonic(), 0, 0
        while not reached(state := self.state()):
            if time.monotonic() - start > PATIENCE:
                self.screenshot(f"{step}_failed")
                raise SystemExit(f"{step}: not after {PATIENCE:.0f} s and {tries} tries; the sidebar says {state}")
            if action is not None and state["beat"] >= lost:
                action()
                tries, lost = tries + 1, self.state()["beat"] + LOST
            time.sleep(0.1)
        self.steps[step] = {"seconds": round(time.monotonic() - start, 1), "tries": tries} | state
        print(f"{step}: {self.steps[step]}", flush=True)
        self.wait(DRAWN)
        self.screenshot(step)
        return state

    def screenshot(self, name: str) -> None:
        """Save what the screen shows: Blender's own screenshots are black without a graphics card."""
        from PIL import ImageGrab

        ImageGrab.grab(xdisplay=self.display).save(self.out / f"{name}.png")


@contextmanager
def blender(root: Path, scene: Path, out: Path, frame: int, shading: str) -> Iterator[Window]:
    """Run a Blender with the extension and the scene until the `with` block ends."""
    with clean_profile(root) as profile, open(out / "blender.log", "w") as log:
        shutil.copy(scene, profile.folder / "scene.f4x")
        profile.check_out()
        startup = profile.folder / "startup.py"
        home, height = profile.inside, SIZE[1]
        startup.write_text(STARTUP.format(home=home, frame=frame, shading=shading, height=height, rendered=RENDERED))
        window = ("--factory-startup", "--window-geometry", 0, 0, *SIZE)
        with profile.screen(SIZE, log) as start:
            start("blender", *window, "--python", f"{profile.inside}/startup.py")
            yield Window(profile, profile.display, out)


def main() -> None:
    """Run the steps."""
    parser = argparse.ArgumentParser(prog="check_window.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="scene file with features")
    parser.add_argument("--root", type=Path, required=True, help="folder of the system to chroot into")
    parser.add_argument("--word", default="dog", help="what to query")
    parser.add_argument("--frame", type=int, default=0, help="clip frame to look at")
    parser.add_argument("--shading", default="SOLID", help="of the viewport: SOLID, MATERIAL or RENDERED")
    parser.add_argument("--out", type=Path, required=True, help="folder for screenshots")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with blender(options.root, options.scene, options.out, options.frame, options.shading) as window:
        window.until("0_imported", lambda state: state["total"] and not state["selected"])
        box = edit_by_sidebar(window, options.word)
        select_by_mouse(window, box)
        stop_render_and_job(window)
        window.until("15_covered", lambda state: bool(state["covered"]), (window.home / "cover").touch)
        window.until("16_processor", lambda state: bool(state["processor"]), (window.home / "processor").touch)
        print(json.dumps(window.steps))


def edit_by_sidebar(window: Window, word: str) -> list[float]:
    """Ask for a word, recolor what it selects, undo, redo and save; returns the box of what was selected, pixels."""

    def type_word() -> None:
        window.click("text")
        window.hand("key", "ctrl+a")
        window.hand("type", "--delay", "100", word)
        window.screenshot("1_typed")
        window.hand("key", "Return")  # a second one would open the field again

    window.until("2_text", lambda state: state["text"] == word, type_word)
    asked = window.until("3_queried", lambda state: state["selected"])  # Enter asks
    window.until("4_recoloured", lambda state: state["edits"] == 1, lambda: window.click("recolor"))
    undone = window.until("5_undone", lambda state: state["edits"] == 0, lambda: window.press("ctrl+z"))
    if undone["selected"] != asked["selected"]:
        raise SystemExit(f"5_undone: the selection went as well; the sidebar says {undone}")
    window.until("6_redone", lambda state: state["edits"] == 1, lambda: window.press("ctrl+shift+z"))
    window.until("7_saved", lambda state: state["saved"] and state["edits"] == 1, lambda: window.click("save"))
    shutil.copy(window.home / "scene.f4x", window.out / "saved.f4x")
    return asked["thing"]


def select_by_mouse(window: Window, box: list[float]) -> None:
    """Select by a click, a box around it and every gesture."""
    left, top, right, bottom = box
    middle, corner = ((left + right) / 2, (top + bottom) / 2), (right, bottom)

    def selected_by(operator: str) -> Callable[[dict], bool]:
        return lambda state: bool(state["selected"]) and state["last"] == f"F4X_OT_{operator}"

    def point() -> None:
        window.click("point")
        window.hand("mousemove", *map(int, middle))
        window.hand("click", 1)

    def draw_box() -> None:
        window.click("box")
        window.draw("9_drawn", (left, top), corner)

    def gesture(tool: str, *places: tuple[float, float]) -> Callable[[], None]:
        def act() -> None:
            (window.home / "tool").write_text(f"f4x.{tool}_tool")
            window.wait(SEEN)
            window.draw(f"9_{tool}_drawn", *places)

        return act

    ways = {
        "box": [(left, top), (left + 5, top + 5), middle, corner],
        "brush": [(left, middle[1]), (left + 5, middle[1]), middle, (right, middle[1])],
        "lasso": [(left, top), (left + 5, top), (right, top), corner, (left, bottom)],
        "sphere": [middle, (middle[0] + 5, middle[1]), (right, middle[1])],
    }
    window.until("8_pointed", selected_by("query_point"), point)
    window.until("9_boxed", selected_by("query_box"), draw_box)
    for tool, way in ways.items():
        window.until(f"9_{tool}", selected_by(f"select_{tool}"), gesture(tool, *way))


def stop_render_and_job(window: Window) -> None:
    """Begin a picture and a job, and stop both."""
    window.until("10_rendering", lambda state: state["rendered"] == "running", lambda: window.press(F12))
    window.until("11_stopped", lambda state: state["rendered"] == "cancelled", lambda: window.press("Escape"))
    window.until("12_back", lambda state: state["screen"] == "view", lambda: window.press("Escape"))
    window.until("13_working", lambda state: state["stage"] == ["wait"], window.start_job)
    window.until("14_cancelled", lambda state: state["job"] == ["cancelled"], lambda: window.click("stop job"))


if __name__ == "__main__":
    main()
