"""Actions of the random walk of `walk_blender.py`: real operators and properties, as buttons, keys and scripts use them.

An action gets the `Walk`, draws its choices from `walk.random` and does one thing that a person does. `@action(weight, ...)` notes
how often it comes and what it may do to edits: "keeps" none, "grows" adds some at the end, "any".
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import door
import gpu
import numpy as np
from walk_checks import content, require, same
from walk_state import Walk

door.load_extension()

from feature4x.addon.common.point_cloud import read_attribute, write_attribute  # noqa: E402
from feature4x.addon.edits import fields  # noqa: E402 - there once the extension is loaded
from feature4x.addon.jobs import runner  # noqa: E402 - there once the extension is loaded
from feature4x.addon.operators import planning  # noqa: E402 - there once the extension is loaded
from feature4x.addon.render.evaluated import OF  # noqa: E402
from feature4x.addon.rig.scaffold import HANDLE, NODE, layer_of  # noqa: E402
from feature4x.addon.scene.scene_object import APART, HANDLE_OF, SceneObject  # noqa: E402
from feature4x.f4x_core.edit.operations import Opacity  # noqa: E402
from feature4x.f4x_core.edit.selects import All  # noqa: E402
from feature4x.f4x_core.edit.stack import read_stack, write_stack  # noqa: E402
from feature4x.f4x_core.edit.styles import STYLES  # noqa: E402

KEEPS, GROWS, ANY = "keeps", "grows", "any"
MAX_SCENES, MAX_EDITS = 3, 12
"""A walk that has more forgets some, so that steps stay quick."""
ENGINES = ("FEATURE4X", "CYCLES", "BLENDER_WORKBENCH")
SMALL = 48
"""Pixels across a picture that F12 draws."""
SENTENCES = (
    "make the {word} red",
    "make the {word} blue from second 0.05 to 0.15",
    "delete the {word}",
    "copy the {word} to the left",
    "slow the {word} down to half",
    "move it up a little",
    "make it half transparent",
    "freeze the {word}",
    "undo",
    "make the {word} bark",
    "",
)
NAMES = ("a", "dog 00001", "labelled", "ø", "x" * 60, "node 00000", "NODE 3", "static", "1")


@dataclass(frozen=True)
class Action:
    """Action of the walk, and how often it is taken."""

    run: Callable[[Walk], Any]
    weight: float
    edits: str
    """Its effect on pending edits: `keeps`, `grows` or `any`."""
    file: bool
    """True if it may change scene files."""


ACTIONS: dict[str, Action] = {}


def action(weight: float, edits: str = KEEPS, file: bool = False) -> Callable:
    """Register a function as an action of the walk."""

    def register(function: Callable[[Walk], Any]) -> Callable[[Walk], Any]:
        ACTIONS[function.__name__] = Action(function, weight, edits, file)
        return function

    return register


def near_limits(walk: Walk) -> bool:
    """Return True if more scenes or edits would only make the walk slow."""
    return len(walk.scenes()) >= MAX_SCENES


# Coming and going


@action(2)
def import_scene(walk: Walk) -> None:
    """Import one of the scene files, perhaps once more."""
    if not near_limits(walk):
        path = walk.random.choice([*walk.files, walk.folder / "splats.ply"])
        walk.call(bpy.ops.f4x.import_scene, filepath=str(path), set_up_render=walk.random.random() < 0.5)


@action(1)
def import_nothing(walk: Walk) -> None:
    """Import a file that is no scene."""
    walk.call(bpy.ops.f4x.import_scene, filepath=str(walk.folder / "broken.f4x"))


@action(1.5, ANY)
def save_blend(walk: Walk) -> None:
    """Save the .blend, now and then as another."""
    walk.blend = walk.folder / f"shot{walk.random.randrange(2)}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(walk.blend), check_existing=False)


def forget_plans() -> None:
    """Discard the plans of all scenes."""
    for scene_object in SceneObject.among(bpy.data.objects):
        if not scene_object.is_linked and scene_object.state.readings:
            planning.forget_readings(scene_object)


@action(1.5, ANY)
def reopen(walk: Walk) -> None:
    """Save and open again: everything has to be as it was, but for plans, which no file keeps."""
    save_blend(walk)
    forget_plans()
    before = content()
    walk.open(walk.blend)
    same(before, content(), "reopened")


@action(0.5, ANY)
def revert(walk: Walk) -> None:
    """Open the .blend as it was saved last, without saving."""
    if walk.blend is not None:
        walk.open(walk.blend)


@action(0.4, ANY)
def auto_saved(walk: Walk) -> None:
    """Open a copy that Blender writes by itself, as after a crash."""
    copy, handlers = walk.folder / "auto.blend", bpy.app.handlers.save_pre
    asleep = list(handlers)
    handlers.clear()  # it tells nobody
    bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True, check_existing=False)
    handlers.extend(asleep)
    forget_plans()
    before = content()
    walk.open(copy)
    same(before, content(), "recovered")


@action(0.4, ANY)
def link_library(walk: Walk) -> None:
    """Link the scenes of another .blend, or override them."""
    library = walk.folder / "library.blend"
    if not library.exists() or near_limits(walk):
        if not bpy.data.libraries:  # Blender overwrites none that it uses
            bpy.ops.wm.save_as_mainfile(filepath=str(library), copy=True, check_existing=False)
        return
    with bpy.data.libraries.load(str(library), link=True) as (_, into):
        into.collections = walk.collections()
    for collection in filter(None, into.collections):
        if walk.random.random() < 0.5:
            collection.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
        elif collection.name not in bpy.context.scene.collection.children:
            bpy.context.scene.collection.children.link(collection)
    walk.push("link")


@action(0.4)
def make_local(walk: Walk) -> None:
    """Make linked scenes local."""
    walk.call(bpy.ops.object.select_all, action="SELECT")
    walk.call(bpy.ops.object.make_local, type="ALL")


# Asking


@action(3)
def query_text(walk: Walk) -> None:
    """Ask for a word."""
    walk.call(bpy.ops.f4x.query_text, text=walk.word())


@action(1)
def query_point(walk: Walk) -> None:
    """Click on a frame of the clip."""
    walk.call(bpy.ops.f4x.query_point, frame=walk.frame(), at=walk.pixel())


@action(1)
def query_box(walk: Walk) -> None:
    """Draw a box on a frame of the clip."""
    (left, top), (right, bottom) = sorted([walk.pixel(), walk.pixel()])
    walk.call(bpy.ops.f4x.query_box, frame=walk.frame(), box=(left, top, right, bottom))


@action(2)
def gesture(walk: Walk) -> None:
    """Select by a box, a brush, a lasso or a sphere."""
    random, mode = walk.random, walk.random.choice(("SET", "ADD", "SUBTRACT", "INTERSECT"))
    kind = random.choice(("box", "brush", "lasso", "sphere"))
    if kind == "box":
        walk.call(bpy.ops.f4x.select_box, box=(*walk.pixel(), *walk.pixel()), mode=mode)
    elif kind == "sphere":
        centre = [random.uniform(-0.5, 0.5) for _ in range(3)]
        walk.call(bpy.ops.f4x.select_sphere, centre=centre, radius=random.uniform(0, 1), mode=mode)
    else:
        way = [{"name": "", "loc": walk.pixel(), "time": 0.0} for _ in range(random.randrange(1, 5))]
        walk.call(getattr(bpy.ops.f4x, f"select_{kind}"), path=way, mode=mode)


@action(2)
def change_selection(walk: Walk) -> None:
    """Grow, shrink or invert the selection, select all or none."""
    walk.call(
        bpy.ops.f4x.change_selection, how=walk.random.choice(("GROW", "SHRINK", "INVERT", "ALL", "NONE")), reach=0.1
    )


@action(1)
def select_named(walk: Walk) -> None:
    """Select by a name that an edit gave."""
    found = walk.scene()
    if found is not None and len(found.state.names):
        walk.call(bpy.ops.f4x.select_named, called=walk.random.choice([row.name for row in found.state.names]))


@action(1)
def hide(walk: Walk) -> None:
    """Hide or isolate the selection, or show all."""
    walk.call(bpy.ops.f4x.hide, what=walk.random.choice(("SELECTED", "OTHERS", "NOTHING")))


@action(3)
def set_property(walk: Walk) -> None:
    """Move a slider, press a switch of the sidebar."""
    found, random = walk.scene(), walk.random
    if found is None or found.is_linked:
        return
    name, value = random.choice(
        [
            ("threshold", random.random()),
            ("mode", random.choice(("SET", "ADD", "SUBTRACT", "INTERSECT"))),
            ("show_score", random.random() < 0.5),
            ("use_span", random.random() < 0.5),
            ("first", random.randrange(6)),
            ("last", random.randrange(6)),
            ("through", random.random() < 0.5),
            ("whole", random.random() < 0.5),
            ("sphere_radius", random.uniform(0, 0.5)),
        ]
    )
    walk.note(f"  {found.name} {name} {value}")
    setattr(found.state, name, value)
    walk.push(name)


# Editing


@action(3, GROWS)
def recolour(walk: Walk) -> None:
    """Give the selection a colour."""
    rgb = [walk.random.random() for _ in range(3)]
    walk.edit(bpy.ops.f4x.recolour, rgb=rgb, hue=walk.random.random() < 0.3)


@action(1, GROWS)
def style(walk: Walk) -> None:
    """Give the selection a look."""
    walk.edit(bpy.ops.f4x.style, look=walk.random.choice(list(STYLES)), strength=walk.random.random())


@action(1, GROWS)
def opacity(walk: Walk) -> None:
    """Make the selection more transparent."""
    walk.edit(bpy.ops.f4x.opacity, factor=walk.random.uniform(0, 1.5))


@action(1, GROWS)
def remove(walk: Walk) -> None:
    """Remove the selection, or everything else."""
    walk.edit(walk.random.choice((bpy.ops.f4x.remove, bpy.ops.f4x.extract)))


@action(2, GROWS)
def transform(walk: Walk) -> None:
    """Move and turn the selection, at once or over time."""
    move, turn = ([walk.random.uniform(-1, 1) for _ in range(3)] for _ in range(2))
    walk.edit(
        bpy.ops.f4x.transform,
        move=move,
        turn=turn,
        size=walk.random.uniform(0.5, 2),
        over_time=walk.random.random() < 0.5,
        first=walk.random.randrange(4),
        last=walk.random.randrange(6),
    )


@action(1.5, ANY)
def change_field(walk: Walk) -> None:
    """Change a field of an edit, as in the list of edits."""
    found, random = walk.scene(), walk.random
    if found is None or found.is_linked or not len(found.state.history):
        return
    found.state.history_index = random.randrange(len(found.state.history))
    row = fields.Row.picked(found)
    if row is None or row.operation.TAG not in fields.KINDS:
        return
    group = getattr(found.state.fields, row.operation.TAG)
    name = random.choice([shown.name for shown in fields.SHOWN[row.operation.TAG] if shown.visible(row.operation)])
    value = getattr(group, name)
    kind = group.bl_rna.properties[name]
    if kind.type == "BOOLEAN":
        value = not value
    elif kind.type == "ENUM":
        value = random.choice([item.identifier for item in kind.enum_items])
    else:
        value = [random.uniform(0, 2) for _ in value] if kind.is_array else random.uniform(0, 5)
    walk.note(f"  {found.name} {row.operation.TAG} {name} {value}")
    setattr(group, name, value)
    walk.push(name)


@action(1, ANY)
def edit_gizmo(walk: Walk) -> None:
    """Add a handle for the selection or an edit, and move it."""
    found = walk.scene()
    rows = [] if found is None else [row.edit_id for row in found.state.history]
    walk.call(bpy.ops.f4x.edit_gizmo, edit_id=walk.random.choice((0, *rows)))
    handles = [item for item in bpy.context.selected_objects if HANDLE_OF in item]
    if handles:
        handles[0].location.x += 0.1
        bpy.context.view_layer.update()
        walk.push("handle")


@action(1, GROWS)
def duplicate_selection(walk: Walk) -> None:
    """Copy the selection."""
    walk.edit(bpy.ops.f4x.duplicate, count=walk.random.randrange(1, 3), time_shift=walk.random.uniform(-3, 3))


@action(1, ANY)
def clean(walk: Walk) -> None:
    """Remove floaters, or crop by a box."""
    how = walk.random.choice(("floaters", "box", "INSIDE", "OUTSIDE"))
    if how == "floaters":
        walk.edit(bpy.ops.f4x.remove_floaters, strength=walk.random.uniform(0.1, 0.9))
    elif how == "box":
        walk.call(bpy.ops.f4x.add_crop_box)
    else:
        walk.edit(bpy.ops.f4x.crop, keep=how)


@action(1.5, ANY)
def edit_points(walk: Walk) -> None:
    """Delete or move points with Blender's own tools; take that over or put it back."""
    found, how = walk.scene(), walk.random.choice(("delete", "move", "take", "take", "back"))
    # moved points of the separate cloud are drawn anew from the edits, and no edit could hold them
    clouds = [] if found is None or found.is_linked else [cloud for cloud in found.clouds if APART not in cloud]
    if how == "take":
        walk.edit(bpy.ops.f4x.take_over_points)
    elif how == "back":
        walk.call(bpy.ops.f4x.put_back_points)
    elif clouds and bpy.context.mode == "OBJECT":
        cloud = walk.random.choice(clouds)
        chosen = np.random.default_rng(walk.random.randrange(10**6)).random(len(cloud.data.points)) < 0.1
        if how == "move":
            positions = read_attribute(cloud.data, "position")
            positions[chosen] += np.array([0.1, 0, 0.2], np.float32)
            write_attribute(cloud.data, "position", "FLOAT_VECTOR", positions)
            cloud.data.update_tag()
        elif cloud.visible_get() and len(cloud.data.points):
            write_attribute(cloud.data, ".selection", "BOOLEAN", chosen)
            bpy.context.view_layer.objects.active = cloud
            bpy.ops.object.mode_set(mode="EDIT")
            bpy.ops.pointcloud.delete()
            bpy.ops.object.mode_set(mode="OBJECT")
        walk.push("points")


@action(0.7)
def place(walk: Walk) -> None:
    """Put the scene onto the ground, scale it, or let the render follow it."""
    how = walk.random.choice(("floor", "points", "length", "render"))
    a, b, c = ([walk.random.uniform(-1, 1) for _ in range(3)] for _ in range(3))
    if how == "points":
        walk.call(bpy.ops.f4x.align_points, a=a, b=b, c=c)
    elif how == "length":
        walk.call(bpy.ops.f4x.scale_length, a=a, b=b, length=walk.random.uniform(0.5, 2))
    else:
        walk.call(bpy.ops.f4x.align_floor if how == "floor" else bpy.ops.f4x.set_up_render)


@action(0.3, ANY)
def export_scene(walk: Walk) -> None:
    """Export the scene as it is shown."""
    walk.call(
        bpy.ops.f4x.export_scene,
        filepath=str(walk.folder / "export.ply"),
        selected_only=walk.random.random() < 0.3,
        with_edits=walk.random.random() < 0.8,
    )


@action(1, GROWS)
def retime(walk: Walk) -> None:
    """Freeze the selection or change its speed."""
    if walk.random.random() < 0.5:
        walk.edit(bpy.ops.f4x.freeze, first=walk.random.randrange(5), goes_on=walk.random.random() < 0.5, last=5)
    else:
        walk.edit(bpy.ops.f4x.retime, speed=walk.random.uniform(0.3, 3), backwards=walk.random.random() < 0.3)


@action(1, GROWS)
def name_selection(walk: Walk) -> None:
    """Give the selection a name."""
    walk.edit(bpy.ops.f4x.name_selection, called=walk.random.choice(NAMES))


@action(1, ANY)
def restore(walk: Walk) -> None:
    """Bring back all that was removed."""
    walk.call(bpy.ops.f4x.restore)


@action(3, ANY)
def history(walk: Walk) -> None:
    """Switch, move or delete an edit."""
    found = walk.scene()
    if found is None or not len(found.state.history):
        return
    edit_id = walk.random.choice([row.edit_id for row in found.state.history])
    how = walk.random.choice(("TOGGLE", "REMOVE", "UP", "DOWN", "TOGGLE", "UP"))
    walk.call(bpy.ops.f4x.history, how="CLEAR" if len(found.state.history) > MAX_EDITS else how, edit_id=edit_id)


@action(3)
def plan(walk: Walk) -> None:
    """Plan a sentence."""
    sentence = walk.random.choice(SENTENCES).format(word=walk.word())
    walk.call(bpy.ops.f4x.plan, sentence=sentence, readings=walk.random.choice((1, 1, 4)))
    if walk.random.random() < 0.3:
        bpy.context.window_manager.f4x.preview = walk.random.random() < 0.5


@action(0.3)
def composite(walk: Walk) -> None:
    """Render meshes by Cycles or EEVEE; the engine of the render is Feature4X afterwards."""
    walk.call(bpy.ops.f4x.composite, engine=walk.random.choice(("CYCLES", "EEVEE")))
    bpy.context.scene.render.use_compositing = False  # minutes, where the processor draws


@action(0.5)
def hold_out(walk: Walk) -> None:
    """Hold an object or a collection out, or no longer."""
    if objects := list(bpy.context.view_layer.objects):
        item = walk.random.choice(objects)
        item.is_holdout = not item.is_holdout
    for child in bpy.context.view_layer.layer_collection.children:
        child.holdout, child.indirect_only = walk.random.random() < 0.2, walk.random.random() < 0.1


@action(2, GROWS)
def apply_plan(walk: Walk) -> None:
    """Apply the plan, or another reading of it."""
    found = walk.scene()
    if found is not None and len(found.state.readings) > 1:
        walk.call(bpy.ops.f4x.pick_reading, number=walk.random.randrange(len(found.state.readings)))
    walk.call(bpy.ops.f4x.apply_plan)


@action(1)
def drop_plan(walk: Walk) -> None:
    """Discard the plan."""
    walk.call(bpy.ops.f4x.drop_plan)


@action(2, ANY, file=True)
def save_edits(walk: Walk) -> None:
    """Save the edits: the file then holds them, and those that others wrote there in between."""
    found = walk.scene()
    if found is None or found.is_linked or not found.path.exists() or not found.holds_edits:
        return
    theirs, met = (stack.edits for stack in (read_stack(found.path), walk.met(found)))
    if walk.call(bpy.ops.f4x.save_edits):
        after = read_stack(found.path).edits
        require(found.is_saved, "edits that were just saved are not in the file")
        lost = [edit for edit in theirs if edit not in met and edit.id not in {each.id for each in after}]
        require(not lost, f"what another program wrote is lost: {lost}")


@action(0.5, file=True)
def another_program(walk: Walk) -> None:
    """Let another program add an edit to the scene file."""
    path = walk.random.choice(walk.files)
    if path.exists() and len(read_stack(path)) < MAX_EDITS:
        write_stack(path, read_stack(path).append(Opacity(All(), round(walk.random.uniform(0.5, 1), 3))))


@action(0.5, file=True)
def move_file(walk: Walk) -> None:
    """Move a scene file away, or back."""
    path = walk.random.choice(walk.files)
    away = path.with_suffix(".away")
    shutil.move(*((path, away) if path.exists() else (away, path)))
    bpy.context.scene.frame_set(bpy.context.scene.frame_current)  # edits over time are drawn with the next frame


@action(0.5)
def pack_scene(walk: Walk) -> None:
    """Pack the scene file into the .blend."""
    walk.call(bpy.ops.f4x.pack_scene)


@action(0.5)
def find_scene(walk: Walk) -> None:
    """Choose the scene file again: the right one or another."""
    walk.call(bpy.ops.f4x.find_scene, filepath=str(walk.random.choice([*walk.files, walk.folder / "broken.f4x"])))


# Undo


@action(6, ANY)
def undo(walk: Walk) -> None:
    """Press Ctrl-Z a few times."""
    for _ in range(walk.random.choice((1, 1, 1, 2, 4))):
        walk.undo()


@action(4, ANY)
def redo(walk: Walk) -> None:
    """Press Ctrl-Shift-Z a few times."""
    for _ in range(walk.random.choice((1, 1, 2, 4))):
        walk.redo()


# Objects


@action(2)
def pick_object(walk: Walk) -> None:
    """Click on an object, a few more with Shift."""
    items = walk.pickable()
    if items:
        for item in bpy.context.view_layer.objects:
            item.select_set(False)
        for item in walk.random.sample(items, min(len(items), walk.random.choice((1, 1, 3)))):
            item.select_set(True)
            bpy.context.view_layer.objects.active = item
        walk.push("select")


@action(2)
def pick_root(walk: Walk) -> None:
    """Click on a scene."""
    found = walk.random.choice([*walk.scenes(), None])
    bpy.context.view_layer.objects.active = None if found is None else found.root
    walk.push("select")


@action(1.5)
def rename(walk: Walk) -> None:
    """Rename an object."""
    items = [item for item in bpy.context.scene.objects if item.library is None]
    if items:
        item, name = walk.random.choice(items), walk.random.choice(NAMES)
        walk.note(f"  {item.name} becomes {name}")
        item.name = name
        walk.push("rename")


@action(1, ANY)
def delete_objects(walk: Walk) -> None:
    """Delete the selected objects, or an object by a script."""
    if walk.random.random() < 0.5:
        walk.call(bpy.ops.object.delete, use_global=walk.random.random() < 0.3)
    elif bpy.context.scene.objects:
        kept = [item for item in bpy.context.scene.objects if item.type == "MESH" and "node_id" in item.data.attributes]
        # without these hidden helpers points stand still, until Ctrl-Z; clicks do not reach them
        item = walk.random.choice([item for item in bpy.context.scene.objects if item not in kept] or kept)
        walk.note(f"  {item.name}")
        bpy.data.objects.remove(item)
        walk.push("remove")


@action(0.3, ANY)
def delete_scene(walk: Walk) -> None:
    """Delete a whole scene with all below it."""
    found = walk.scene()
    if found is not None and found.root.library is None:
        bpy.data.batch_remove([found.root, *found.root.children_recursive])
        walk.push("delete scene")


@action(1, ANY)
def duplicate_objects(walk: Walk) -> None:
    """Press Shift-D or Alt-D on the selected objects, or on a whole scene."""
    found = walk.scene()
    if found is not None and walk.random.random() < 0.6:
        if near_limits(walk):
            return
        for item in (found.root, *found.root.children_recursive):
            item.select_set(True)
    walk.call(bpy.ops.object.duplicate, linked=walk.random.random() < 0.3)


@action(1, ANY)
def transform_object(walk: Walk) -> None:
    """Move, turn or scale an object; the handle of an edit changes that edit."""
    items = [item for item in walk.pickable() if item.library is None]
    if items:
        item = walk.random.choice(items)
        walk.note(f"  {item.name}")
        item.location.x += walk.random.uniform(-0.2, 0.2)
        if walk.random.random() < 0.2:
            item.scale = [walk.random.uniform(0.5, 2)] * 3
        walk.push("transform")


@action(0.5, ANY)
def reparent(walk: Walk) -> None:
    """Hang an object below another, or free it."""
    items = [item for item in bpy.context.scene.objects if item.library is None and item.override_library is None]
    if len(items) > 1:
        item, above = walk.random.sample(items, 2)
        above = None if above in item.children_recursive else walk.random.choice((above, None))
        walk.note(f"  {item.name} below {above.name if above else None}")
        item.parent = above
        walk.push("parent")


@action(0.5, ANY)
def join_objects(walk: Walk) -> None:
    """Join the selected objects by Ctrl-J."""
    walk.call(bpy.ops.object.join)


@action(0.5, ANY)
def purge(walk: Walk) -> None:
    """Purge unused data."""
    bpy.data.orphans_purge(do_recursive=True)
    walk.push("purge")


@action(0.5)
def change_mode(walk: Walk) -> None:
    """Go to Edit Mode and back."""
    if bpy.context.object is not None:
        before = bpy.context.mode
        walk.call(bpy.ops.object.mode_set, mode=walk.random.choice(("EDIT", "OBJECT", "SCULPT")))
        if bpy.context.mode != before:  # some modes have steps of undo of their own, which nobody counts
            walk.begin_undo()


@action(0.3)
def foreign_modifier(walk: Walk) -> None:
    """Add another modifier to a point cloud, or switch one of ours."""
    found = walk.scene()
    clouds = [] if found is None or found.is_linked else found.clouds
    if clouds:
        cloud = walk.random.choice(clouds)
        if cloud.modifiers and walk.random.random() < 0.7:
            modifier = walk.random.choice(list(cloud.modifiers))
            if modifier.name.startswith("Feature4X"):
                modifier.show_render = not modifier.show_render
            else:
                cloud.modifiers.remove(modifier)
        else:
            cloud.modifiers.new("Mine", "NODES")
        walk.push("modifier")


# Motion


@action(1)
def show_nodes(walk: Walk) -> None:
    """Show or hide the nodes."""
    found = walk.scene()
    layer = None if found is None else layer_of(found.root)
    if layer is not None:
        layer.hide_viewport = not layer.hide_viewport
        walk.push("nodes")


@action(1.5)
def grab_nodes(walk: Walk) -> None:
    """Move a node softly."""
    found = walk.scene()
    nodes = [] if found is None else [item for item in found.root.children_recursive if NODE in item]
    if nodes:
        for item in walk.random.sample(nodes, 1):
            if item.name in bpy.context.view_layer.objects and item.visible_get():
                item.select_set(True)
        offset = [walk.random.uniform(-0.1, 0.1) for _ in range(3)]
        hold, reach = walk.random.choice(("CLIP", "AROUND")), walk.random.choice((0, 3))
        walk.call(bpy.ops.f4x.grab_nodes, offset=offset, hold=hold, reach=reach)


@action(1.5)
def time_clip(walk: Walk) -> None:
    """Change the start, the speed or the course of time."""
    found, random = walk.scene(), walk.random
    if found is None or found.is_linked:
        return
    what = random.choice(("start_frame", "speed", "animate_time", "key"))
    if what == "key" and found.state.animate_time:
        found.root["f4x_time"] = random.uniform(-1, 6)
        found.root.keyframe_insert('["f4x_time"]', frame=random.randrange(-2, 9))
    elif what != "key":
        values = {"start_frame": random.choice((0, 0, 2, -1.5)), "speed": random.choice((1, 1, 0.5, 1.25))}
        setattr(found.state, what, values.get(what, not found.state.animate_time))
    walk.push(what)


@action(0.7)
def handles(walk: Walk) -> None:
    """Add, move or remove group handles."""
    held = [item for item in bpy.context.scene.objects if HANDLE in item and item.library is None]
    if held and walk.random.random() < 0.4:
        walk.random.choice(held).location.y += 0.05
        walk.push("handle")
    elif held and walk.random.random() < 0.5:
        walk.call(bpy.ops.f4x.remove_handles)
    else:
        walk.call(bpy.ops.f4x.add_handles, count=walk.random.randrange(3))


@action(1, GROWS)
def write_motion(walk: Walk) -> None:
    """Write motion back."""
    walk.call(bpy.ops.f4x.write_motion)


# Meshes


@action(0.7)
def make_mesh(walk: Walk) -> None:
    """Make a mesh of the selection."""
    before = len(bpy.data.objects)
    walk.call(bpy.ops.f4x.make_mesh, resolution=12, faces=100, current=walk.random.random() < 0.5)
    for job in runner.all_jobs():
        job.wait()
        runner.dismiss(job)
    if len(bpy.data.objects) > before:
        walk.remember()


@action(0.7)
def use_mesh(walk: Walk) -> None:
    """Switch, collide or delete a mesh of Gaussians."""
    made = [item for item in bpy.context.scene.objects if OF in item and item.library is None]
    if not made:
        return
    item, what = walk.random.choice(made), walk.random.choice(("f4x_casts", "f4x_holds_out", "collide", "delete"))
    if what == "collide":
        bpy.context.view_layer.objects.active = item
        walk.call(bpy.ops.f4x.collider)
    elif what == "delete":
        bpy.data.objects.remove(item)
        walk.push(what)
    else:
        setattr(item, what, not getattr(item, what))
        walk.push(what)


# Looking


@action(4)
def set_frame(walk: Walk) -> None:
    """Go to another frame, also between frames and outside the clip."""
    scene, frame = bpy.context.scene, walk.random.choice((*range(-1, 8), 2.5))
    scene.frame_set(int(frame), subframe=frame % 1)


@action(1)
def play(walk: Walk) -> None:
    """Start or stop playback, or without a window walk through the frames."""
    if bpy.app.background:
        for frame in range(6):
            bpy.context.scene.frame_set(frame)
    else:
        playing = bpy.context.screen.is_animation_playing
        walk.call(bpy.ops.screen.animation_play)
        if playing:
            walk.remember()  # Blender 5.2 ends playback with a step of undo


@action(1)
def switch_engine(walk: Walk) -> None:
    """Choose another render engine."""
    bpy.context.scene.render.engine = walk.random.choice(ENGINES)
    walk.push("engine")


@action(0.7)
def render(walk: Walk) -> None:
    """Render by F12, small, with some passes."""
    scene, layer = bpy.context.scene, bpy.context.view_layer
    if scene.camera is None or scene.render.engine == "BLENDER_WORKBENCH":
        return
    if scene.render.engine == "CYCLES":
        scene.cycles.samples = 1
    scene.render.resolution_percentage = max(1, 100 * SMALL // scene.render.resolution_x)
    for name in ("unseen", "selection", "score", "alpha"):
        setattr(layer.f4x_passes, name, walk.random.random() < 0.3)
    layer.use_pass_vector = layer.use_pass_cryptomatte_object = walk.random.random() < 0.3
    scene.render.use_motion_blur = walk.random.random() < 0.2
    scene.f4x_samples, scene.f4x_shadows.use = 2, walk.random.random() < 0.5
    scene.render.filepath = str(walk.folder / "picture")
    if walk.call(bpy.ops.render.render, write_still=True):
        (walk.folder / "picture.png").unlink()


@action(0.3)
def add_light(walk: Walk) -> None:
    """Add a lamp or a cube, in Object Mode."""
    if bpy.context.mode == "OBJECT" and len(bpy.context.scene.objects) < 60:
        kind = walk.random.choice(("SUN", "POINT", "SPOT", "AREA"))
        walk.call(bpy.ops.object.light_add, type=kind, location=(0, 0, 3))
        walk.call(bpy.ops.mesh.primitive_cube_add, size=0.2, location=(0, 1, 1))


@action(0.3)
def other_scene(walk: Walk) -> None:
    """Add a second scene of Blender, or remove it."""
    if len(bpy.data.scenes) < 2:
        walk.call(bpy.ops.scene.new, type=walk.random.choice(("EMPTY", "LINK_COPY", "FULL_COPY")))
    else:
        walk.call(bpy.ops.scene.delete)


@action(0.3)
def register_anew(walk: Walk) -> None:
    """Disable and enable the extension."""
    door.load_extension().unregister()
    door.load_extension().register()


def by_processor() -> bool:
    """Return True if the processor draws the window."""
    return "llvmpipe" in gpu.platform.renderer_get()


def without_eevee() -> None:
    """Switch viewports that EEVEE would draw to Solid: without a graphics card EEVEE takes minutes and gigabytes."""
    if bpy.app.background or not by_processor():
        return
    for window in bpy.context.window_manager.windows:
        drawn = {"MATERIAL", "RENDERED"} if "EEVEE" in window.scene.render.engine else {"MATERIAL"}
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and area.spaces.active.shading.type in drawn:
                area.spaces.active.shading.type = "SOLID"


@action(1.5)
def change_view(walk: Walk) -> None:
    """Change the shading, the camera's view, the workspace or the sidebar of a window."""
    if bpy.app.background:
        return
    slow = by_processor()  # the buffers of ever more editors are in the memory that is watched
    names = ("shading", "shading", "camera", "quad", "sidebar", "full", "sidebar" if slow else "workspace")
    what = walk.random.choice(names)
    space = bpy.context.space_data
    if what == "workspace":
        bpy.context.window.workspace = walk.random.choice(list(bpy.data.workspaces))
    elif what == "full":
        walk.call(bpy.ops.screen.screen_full_area)
    elif space is None or space.type != "VIEW_3D":
        return
    elif what == "shading":
        kinds = ("SOLID", "RENDERED", "RENDERED", "WIREFRAME")
        space.shading.type = walk.random.choice(kinds if slow else (*kinds, "MATERIAL"))
    elif what == "camera":
        space.region_3d.view_perspective = walk.random.choice(("CAMERA", "PERSP", "ORTHO"))
    elif what == "quad":
        walk.call(bpy.ops.screen.region_quadview)
    else:
        space.show_region_ui = not space.show_region_ui
