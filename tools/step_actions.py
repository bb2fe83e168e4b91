"""The steps of docs/blender_steps.md inside Blender; `step_pictures.py` asks for them one by one and takes the pictures.

blender --factory-startup -P tools/step_actions.py -- FOLDER

FOLDER holds room.f4x. A step is asked for by FOLDER/order.json (number, name); FOLDER/state.json says how far Blender is.
"""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from bpy_extras import view3d_utils
from mathutils import Vector

sys.path.extend(str(Path(__file__).resolve().parents[1] / name) for name in ("tools", "scripts"))
import door

door.load_extension().register()

from feature4x.addon.jobs import runner  # noqa: E402 - there once the extension is loaded
from feature4x.addon.rig import native_motion  # noqa: E402 - there once the extension is loaded
from feature4x.addon.rig.scaffold import layer_of  # noqa: E402
from feature4x.addon.scene.scene_object import SceneObject  # noqa: E402

INTERVAL = 0.3
FRAME = 12
"""Clip frame in the pictures."""
ORBIT = 25.0
"""Degrees of the other camera's circle."""
MONKEY, LAMP = (-0.02, 0.1, 1.1), (0.7, -0.6, 0.2)
"""Places of a mesh and a lamp, in the scene's axes."""
RAISED = 0.12
"""Distance by which the node is pulled up."""
CRATE = (-0.45, 0.19, 1.09), 0.16
"""Centre of the crate's front in the scene's axes, half its side."""


class View:
    """The maximised viewport and what it shows."""

    def __init__(self, home: Path):
        self.home = home
        self.window = bpy.context.window_manager.windows[0]

    @property
    def area(self):
        """Return the viewport; None while a picture that is being rendered fills the window."""
        return next((area for area in self.window.screen.areas if area.type == "VIEW_3D"), None)

    @property
    def editor(self):
        """Return the largest area of any kind."""
        return max(self.window.screen.areas, key=lambda area: area.width * area.height)

    def region(self, kind: str = "WINDOW"):
        """Return a part of the viewport."""
        return next(region for region in self.area.regions if region.type == kind)

    def call(self, operator: Callable, how: str = "EXEC_DEFAULT", /, **settings) -> None:
        """Call an operator as the viewport's buttons do."""
        with bpy.context.temp_override(window=self.window, area=self.area, region=self.region()):
            operator(how, True, **settings)

    @property
    def scene_object(self) -> SceneObject:
        """Return the imported scene."""
        return SceneObject.among(bpy.context.scene.objects)[0]

    def on_screen(self, points: np.ndarray) -> list[list[float]]:
        """Return pixels of the window, from its upper left corner, of points in the scene's axes."""
        region, look = self.region(), self.area.spaces.active.region_3d
        to_world = self.scene_object.root.matrix_world
        seen = [
            view3d_utils.location_3d_to_region_2d(region, look, to_world @ Vector(point)) for point in points.tolist()
        ]
        return [[region.x + at.x, self.window.height - region.y - at.y] for at in seen]


def maximise(view: View) -> None:
    """Open Blender's default file, its viewport as large as the window."""
    view.call(bpy.ops.screen.screen_full_area)


def drop(view: View) -> None:
    """Drop a scene file, which opens the dialog of the import."""
    view.call(bpy.ops.f4x.import_scene, "INVOKE_DEFAULT", filepath=str(view.home / "room.f4x"))


def look(view: View) -> None:
    """Show the sidebar, and a frame with all objects in view."""
    view.area.spaces.active.show_region_ui = True
    bpy.context.scene.frame_set(FRAME)


def choose_tab(view: View) -> None:
    """Choose the sidebar's tab."""
    view.region("UI").active_panel_category = "Feature4X"


def query(view: View) -> None:
    """Ask for a word."""
    view.scene_object.state.text = "ball"
    view.call(bpy.ops.f4x.query_text, text="ball")


def box(view: View) -> list[list[float]]:
    """Take the tool Box of gestures; return the corners of a box around the crate."""
    view.call(bpy.ops.wm.tool_set_by_id, name="f4x.box_tool")
    (x, y, z), half = CRATE
    return view.on_screen(np.array([(x - 1.2 * half, y - 1.35 * half, z), (x + 1.5 * half, y + 1.1 * half, z)]))


def plan(view: View) -> None:
    """Type a sentence and plan it."""
    view.call(bpy.ops.wm.tool_set_by_id, name="builtin.select_box")
    say(view, "make the ball blue from frame 10")


def say(view: View, sentence: str) -> None:
    """Plan a sentence."""
    view.call(bpy.ops.f4x.plan, sentence=sentence)


def apply(view: View) -> None:
    """Apply the plan."""
    view.call(bpy.ops.f4x.apply_plan)


def play(view: View) -> None:
    """Play the animation slowly, or stop it."""
    bpy.context.scene.render.fps = 1
    view.call(bpy.ops.screen.animation_play)


def reopen(view: View) -> None:
    """Save the .blend and open it again."""
    bpy.ops.wm.save_as_mainfile(filepath=str(view.home / "room.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(view.home / "room.blend"))


def solid(view: View) -> None:
    """Use Blender's own shading."""
    view.area.spaces.active.shading.type = "SOLID"


def add_mesh(view: View) -> None:
    """Add a smooth red monkey between the crate, the ball and the wall, and an area lamp on it."""
    to_world = view.scene_object.root.matrix_world
    view.call(bpy.ops.mesh.primitive_monkey_add, size=0.35, location=to_world @ Vector(MONKEY))
    item = bpy.context.object
    view.call(bpy.ops.object.shade_smooth)
    item.modifiers.new("Subdivision", "SUBSURF").levels = 2
    material = bpy.data.materials.new("Red")
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (0.8, 0.05, 0.03, 1)
    shader.inputs["Roughness"].default_value = 0.25
    item.data.materials.append(material)
    for lamp in [each for each in bpy.data.objects if each.type == "LIGHT"]:
        bpy.data.objects.remove(lamp)
    place = to_world @ Vector(LAMP)
    view.call(bpy.ops.object.light_add, type="AREA", location=place)
    lamp = bpy.context.object
    lamp.data.energy, lamp.data.size = 14, 0.25
    lamp.rotation_euler = (to_world @ Vector(MONKEY) - place).to_track_quat("-Z", "Y").to_euler()
    view.area.spaces.active.overlay.show_extras = False  # the lamp's lines
    select_only(item)


def show_mesh_panel(view: View) -> None:
    """Make the scene's root the active object; no Gaussian is selected."""
    select_only(view.scene_object.root)
    view.call(bpy.ops.f4x.change_selection, how="NONE")


def ball_mesh(view: View) -> None:
    """Start the job that makes a mesh of the ball, which casts shadows."""
    mesh(view)


def composite(view: View) -> None:
    """Let Cycles draw the meshes."""
    view.call(bpy.ops.f4x.composite, engine="CYCLES")
    bpy.context.scene["f4x_meshes"].cycles.samples = 64


def show_nodes_of_compositor(view: View) -> None:
    """Show the compositor in place of the viewport."""
    view.area.type = "NODE_EDITOR"


def choose_nodes(view: View) -> None:
    """Show the compositor's nodes, and nothing beside them."""
    area = view.editor
    area.ui_type = "CompositorNodeTree"
    space = area.spaces.active
    space.node_tree = bpy.context.scene.compositing_node_group
    space.show_region_ui = space.show_region_asset_shelf = False
    for node in space.node_tree.nodes:
        node.select = False


def fit_nodes(view: View) -> None:
    """Bring all nodes into view."""
    area = view.editor
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=view.window, area=area, region=region):
        bpy.ops.node.view_all()


def show_viewport(view: View) -> None:
    """Show the viewport again."""
    view.editor.ui_type = "VIEW_3D"


def targets(view: View) -> list[list[float]]:
    """Select nothing; return the places of the ball at this frame and of the wall where the ball was when it was stored."""
    for item in bpy.context.view_layer.objects.selected:
        item.select_set(False)
    frame = bpy.context.scene.frame_current
    ball = view.scene_object.shown.scene.posed(frame)
    moving = ball.means[-len(view.scene_object.shown.scene.dynamic) :]
    stored = view.scene_object.shown.scene.dynamic.means
    return view.on_screen(np.array([moving.mean(0), stored.mean(0)]))


def select_only(item: bpy.types.Object) -> None:
    """Make one object the selection."""
    for other in bpy.context.view_layer.objects.selected:
        other.select_set(False)
    item.select_set(True)
    bpy.context.view_layer.objects.active = item


def move_node(view: View) -> None:
    """Show the nodes and pull one up."""
    layer_of(view.scene_object.root).hide_viewport = False
    nodes = [item for item in view.scene_object.root.children_recursive if " node " in item.name]
    highest = max(nodes, key=lambda item: item.matrix_world.translation.z)
    select_only(highest)
    view.call(bpy.ops.transform.translate, value=(0, 0, RAISED))


def write_motion(view: View) -> None:
    """Make an edit of the moved node."""
    view.call(bpy.ops.f4x.write_motion)
    layer_of(view.scene_object.root).hide_viewport = True
    select_only(view.scene_object.root)


def mesh(view: View) -> None:
    """Start the job that makes a mesh of the ball."""
    query(view)
    view.call(bpy.ops.f4x.make_mesh, resolution=32, faces=3000)


def show_mesh(view: View) -> None:
    """Use solid shading, without the nodes' lines."""
    view.area.spaces.active.shading.type = "SOLID"


def camera(view: View) -> None:
    """Look through another camera."""
    select_only(view.scene_object.root)
    view.call(bpy.ops.f4x.show_picture)
    view.call(bpy.ops.f4x.add_path_camera, path="ORBIT", degrees=ORBIT)
    bpy.context.scene.frame_set(FRAME)


def plate(view: View) -> None:
    """Look through the clip's camera again, and remove the crate."""
    bpy.context.scene.camera = next(item for item in bpy.data.objects if item.name == "room camera")
    say(view, "delete the crate")
    view.call(bpy.ops.f4x.apply_plan)


def passes(view: View) -> None:
    """Switch passes on."""
    layer = bpy.context.view_layer
    layer.use_pass_vector = layer.use_pass_normal = layer.use_pass_cryptomatte_object = True
    layer.f4x_passes.unseen = True


def save(view: View) -> None:
    """Write the edits into the scene file."""
    view.call(bpy.ops.f4x.save_edits)


def gold(view: View) -> list[list[float]]:
    """Make everything that moves gold; return the place of the crate, which is clicked next."""
    say(view, "make everything that moves look like gold")
    view.call(bpy.ops.f4x.apply_plan)
    view.call(bpy.ops.f4x.query_point, "INVOKE_DEFAULT")
    return view.on_screen(np.array([CRATE[0]]))


def plan_green(view: View) -> None:
    """Plan a sentence about the selection."""
    say(view, "make it green from frame 10")


def name_it(view: View) -> None:
    """Name the selection."""
    view.call(bpy.ops.f4x.drop_plan)
    view.call(bpy.ops.f4x.name_selection, called="my crate")


def fine_mesh(view: View) -> None:
    """Start a job that takes a while."""
    select_only(view.scene_object.root)
    view.call(bpy.ops.f4x.make_mesh, resolution=256, faces=100_000)


STEPS = (
    maximise, drop, look, choose_tab, query, box, plan, apply, move_node, write_motion,
    mesh, show_mesh, camera, plate, passes, save, gold, plan_green, name_it, fine_mesh, play, targets,
    reopen, solid, add_mesh, show_mesh_panel, ball_mesh, composite, show_nodes_of_compositor, choose_nodes, fit_nodes,
    show_viewport,
)  # fmt: skip


class Pilot:
    """Robot that takes one step at a time, from a timer."""

    def __init__(self, home: Path):
        self.home, self.taken, self.beat = home, 0, 0
        self.places: list[list[float]] | None = None
        self.rendered, self.error = "", ""
        bpy.app.handlers.render_complete.append(lambda *_: setattr(self, "rendered", "complete"))

    @property
    def view(self) -> View:
        """Return the window, another one once a file was opened."""
        return View(self.home)

    def tick(self) -> float:
        """Take the step that is asked for, and report the state."""
        order = self.home / "order.json"
        if order.exists() and (self.view.area is not None or self.view.editor.type == "NODE_EDITOR"):
            asked = json.loads(order.read_text())
            if asked["number"] > self.taken:
                self.taken = asked["number"]
                step = next(step for step in STEPS if step.__name__ == asked["name"])
                try:
                    self.places = step(self.view)
                except Exception as error:  # the outside must hear of it
                    self.error = f"{asked['name']}: {error!r}"
        self.tell()
        return INTERVAL

    def tell(self) -> None:
        """Write the state, whole or not at all."""
        self.beat += 1
        found = SceneObject.among(bpy.context.scene.objects)
        state = dict(beat=self.beat, taken=self.taken, places=self.places, rendered=self.rendered, error=self.error)
        state |= dict(screen="view" if self.view.area else "picture", jobs=[job.state for job in runner.all_jobs()])
        state |= dict(stages=[job.stage for job in runner.all_jobs()])
        overlay = None if self.view.area is None else self.view.area.spaces.active.overlay
        state |= dict(
            outlined=overlay is not None and overlay.show_outline_selected,
            carried=any(native_motion.CARRIED in item for item in bpy.data.objects),
            chosen=sorted(item.name for item in bpy.context.view_layer.objects.selected),
            frame=bpy.context.scene.frame_current,
        )
        if self.view.area is not None:
            state["sidebar"] = self.view.region("UI").x
        if found:
            properties = found[0].state
            state |= dict(selected=properties.selected, total=properties.total, answer=properties.answer)
            state |= dict(edits=[row.name for row in properties.history], saved=found[0].is_saved)
            state |= dict(notice=properties.notice, readings=[row.description for row in properties.readings])
            state |= dict(last=[operator.bl_idname for operator in bpy.context.window_manager.operators][-1:])
        new = self.home / "state.new"
        new.write_text(json.dumps(state))
        os.replace(new, self.home / "state.json")


def main() -> None:
    """Start the pilot."""
    view = bpy.context.preferences.view
    view.show_splash = view.show_tooltips = False
    bpy.context.preferences.system.use_region_overlap = False  # the sidebar would hide what is beside it
    view.render_display_type = "SCREEN"  # there is no window manager that would focus a new window
    bpy.app.timers.register(Pilot(Path(door.arguments()[0])).tick, first_interval=1.0, persistent=True)


main()
