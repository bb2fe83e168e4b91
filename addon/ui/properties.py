"""The state of the sidebar for a scene: one property group on its root empty, so that Undo covers it too."""

from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ...f4x_core.errors import F4xError
from ...f4x_core.query.knowledge import known_words
from ...f4x_core.troubles import EXPECTED
from ..common.wording import error_line
from ..edits import display, fields, listing, marking
from ..rig.scaffold import layer_of
from ..scene import clip_time, tints
from ..scene.scene_object import PREVIEW, TIMED, SceneObject
from .submitting import submit

OFFERED = ("what moves", "what stands still", "everything", "nothing")
"""Words that the field offers besides labels of the scene."""


def _complete(self, context, typed: str) -> list[str]:
    """Return the words that are looked for in the scene and contain the last word typed."""
    try:
        labels = known_words(SceneObject.of(context.object).base)
    except F4xError:
        labels = []
    *complete, begun = (word.strip() for word in typed.split(","))
    known = labels if complete else (*OFFERED, *labels)
    return [
        ", ".join([*complete, label]) for label in known if begun.lower() in label.lower() and label not in complete
    ]


def _threshold_moved(self, context) -> None:
    marking.apply_threshold(SceneObject(self.id_data))


def _sphere_moved(self, context) -> None:
    try:
        marking.follow_sphere(SceneObject(self.id_data))
    except EXPECTED as error:
        self.answer = error_line(error)


def _shown_changed(self, context) -> None:
    try:
        display.refresh(SceneObject(self.id_data))
    except EXPECTED as error:
        self.answer = error_line(error)


def _typed(name: str, operator: str, needed: str) -> dict[str, Any]:
    """Return getter and setter of a field of the sidebar that shows the property `name` of the active scene.

    Enter in it calls `f4x.OPERATOR`, where the property `needed` holds anything.
    """

    def get_typed(self) -> str:
        scene_object = SceneObject.of(bpy.context.object)
        return "" if scene_object is None else getattr(scene_object.state, name)

    def set_typed(self, value: str) -> None:
        scene_object = SceneObject.of(bpy.context.object)
        if scene_object is not None:
            setattr(scene_object.state, name, value)
            if getattr(scene_object.state, needed).strip():
                submit(bpy.context, scene_object.root, operator)

    return {"get": get_typed, "set": set_typed}


def _is_previewed(self) -> bool:
    scene_object = SceneObject.of(bpy.context.object)
    return scene_object is not None and PREVIEW in scene_object.root


def _switch_preview(self, on: bool) -> None:
    scene_object = SceneObject.of(bpy.context.object)
    if scene_object is not None and not scene_object.is_linked:
        try:
            display.preview(scene_object, on)
        except EXPECTED as error:
            scene_object.state.answer = error_line(error)


class F4X_PG_typed(bpy.types.PropertyGroup):  # noqa: N801 - Blender wants this form
    """Fields that are no step of undo, on the window manager: Blender makes a step of every field that is a scene's.

    What is typed is kept by the scene, and goes with the step of the operator that it starts.
    """

    text: StringProperty(  # type: ignore[valid-type]
        name="Text",
        description="What to select: words separated by commas, what moves, what stands still, everything or nothing",
        search=_complete,
        **_typed("text", "query_text", needed="text"),
    )
    negatives: StringProperty(  # type: ignore[valid-type]
        name="But Not",
        description="What not to select, separated by commas; empty: common surroundings such as sky and grass",
        search=_complete,
        **_typed("negatives", "query_text", needed="text"),
    )
    sentence: StringProperty(  # type: ignore[valid-type]
        name="Say",
        description="What to change or select, such as: make the dog red from second 2; select what moves",
        **_typed("sentence", "plan", needed="sentence"),
    )
    preview: BoolProperty(  # type: ignore[valid-type]
        name="Preview", description="Show what it would look like", get=_is_previewed, set=_switch_preview
    )


def _words_of_edit(self) -> str:
    """Return the edit of a row in words, along Blender's axes where the scene is placed now; empty for an edit that is gone."""
    scene_object = SceneObject(self.id_data)
    edits = [edit for edit in scene_object.stack.edits if edit.id == self.edit_id]
    return listing.words_of(edits[0].operation, scene_object.axes) if edits else ""


class F4X_PG_edit(bpy.types.PropertyGroup):  # noqa: N801 - Blender wants this form
    """A row of the history."""

    name: StringProperty(get=_words_of_edit)  # type: ignore[valid-type]
    edit_id: IntProperty()  # type: ignore[valid-type]
    enabled: BoolProperty()  # type: ignore[valid-type]


class F4X_PG_name(bpy.types.PropertyGroup):  # noqa: N801
    """A row of the named selections; `name` is the name."""

    count: IntProperty()  # type: ignore[valid-type]


class F4X_PG_reading(bpy.types.PropertyGroup):  # noqa: N801
    """One reading of the sentence; `name` says how it differs from the first one."""

    operations: StringProperty()  # type: ignore[valid-type]
    description: StringProperty()  # type: ignore[valid-type]
    first: FloatProperty()  # type: ignore[valid-type]
    """First clip frame at which it changes anything."""
    last: FloatProperty()  # type: ignore[valid-type]
    """Last clip frame at which it changes anything."""

    def line_at(self, frame: float) -> str:
        """Return a sentence where nothing changes at a clip frame, so that the preview shows nothing; else an empty string."""
        if self.first <= frame <= self.last:
            return ""
        bound = f"from frame {self.first:.0f} on" if frame < self.first else f"until frame {self.last:.0f}"
        return f"Not seen at frame {frame:.0f}: it changes something {bound}."


def _set_start(self, frame: float) -> None:
    clip_time.place(self.id_data, frame, clip_time.timing_of(self.id_data).rate)


def _set_speed(self, rate: float) -> None:
    clip_time.place(self.id_data, clip_time.timing_of(self.id_data).start, rate)


def _show_tints(self, on: bool) -> None:
    scene_object = SceneObject(self.id_data)
    tints.show(scene_object.clouds, on)
    if self.id_data.get(TIMED) and not scene_object.is_linked:
        display.redraw(scene_object)


def _show_nodes(self, on: bool) -> None:
    if (layer := layer_of(self.id_data)) is not None:
        layer.hide_viewport = not on


class F4X_PG_scene(bpy.types.PropertyGroup):  # noqa: N801
    """The sidebar's state."""

    start_frame: FloatProperty(  # type: ignore[valid-type]
        name="Start Frame",
        description="Frame of the timeline at which the clip begins; all that is keyed below the scene's root moves along",
        step=100,
        precision=2,
        options=set(),
        get=lambda self: clip_time.timing_of(self.id_data).start,
        set=_set_start,
    )
    speed: FloatProperty(  # type: ignore[valid-type]
        name="Speed",
        description="Clip frames for each frame of the timeline, the camera's too: 0.5 plays the whole clip half as fast",
        min=0.001,
        max=1000.0,
        soft_min=0.1,
        soft_max=10.0,
        precision=3,
        options=set(),
        get=lambda self: clip_time.timing_of(self.id_data).rate,
        set=_set_speed,
    )
    animate_time: BoolProperty(  # type: ignore[valid-type]
        name="Animate Time",
        description="Key or drive Time - ramps, freezes, reverse - in place of Start Frame and Speed; its keys are kept when off",
        options=set(),
        get=lambda self: not clip_time.follows_timeline(self.id_data),
        set=lambda self, on: clip_time.animate(self.id_data, on),
    )
    text: StringProperty()  # type: ignore[valid-type]  # this one, `negatives` and `sentence`: see `F4X_PG_typed`
    found: StringProperty()  # type: ignore[valid-type]  # why the words found nothing
    negatives: StringProperty()  # type: ignore[valid-type]
    mode: EnumProperty(name="Mode", items=marking.MODES, default="SET")  # type: ignore[valid-type]
    threshold: FloatProperty(  # type: ignore[valid-type]
        name="Threshold",
        description="Minimum probability; the selection follows at once",
        default=0.5,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        update=_threshold_moved,
    )
    live: BoolProperty()  # type: ignore[valid-type]
    called: StringProperty()  # type: ignore[valid-type]  # the selection in words, where words made it
    combined: StringProperty(default="SET")  # type: ignore[valid-type]
    histogram: StringProperty()  # type: ignore[valid-type]
    selected: IntProperty()  # type: ignore[valid-type]
    total: IntProperty()  # type: ignore[valid-type]
    through: BoolProperty(  # type: ignore[valid-type]
        name="Through", description="Gestures in the viewport select also what is hidden behind other Gaussians"
    )
    whole: BoolProperty(  # type: ignore[valid-type]
        name="Whole Thing",
        description="Gestures in the viewport select the thing that they mark, all of it and at all times",
    )
    brush: FloatProperty(  # type: ignore[valid-type]
        name="Radius", description="Radius of the brush in pixels", default=25.0, min=1.0, soft_max=500.0
    )
    sphere: FloatVectorProperty(  # type: ignore[valid-type]
        name="Sphere",
        description="Center of the selecting sphere in Blender's world",
        subtype="XYZ",
        update=_sphere_moved,
    )
    sphere_radius: FloatProperty(  # type: ignore[valid-type]
        name="Sphere Radius",
        description="Radius of the selecting sphere; 0: there is none",
        min=0.0,
        subtype="DISTANCE",
        update=_sphere_moved,
    )
    show_score: BoolProperty(  # type: ignore[valid-type]
        name="Heat Map",
        description="Show the scores of the last query as colors, also in renders",
        update=_shown_changed,
    )
    use_span: BoolProperty(  # type: ignore[valid-type]
        name="Time Span", description="Limit the selection and its edits to a range of clip frames"
    )
    first: IntProperty(name="First", description="First clip frame of the time span", min=0)  # type: ignore[valid-type]
    last: IntProperty(name="Last", description="Last clip frame of the time span", min=0)  # type: ignore[valid-type]
    reach: FloatProperty(  # type: ignore[valid-type]
        name="Step",
        description="Distance by which to grow or shrink the selection",
        default=0.02,
        min=0.001,
        soft_max=0.2,
        step=1,
        precision=3,
    )
    rgb: FloatVectorProperty(  # type: ignore[valid-type]
        name="Color", subtype="COLOR_GAMMA", size=3, default=(0.9, 0.1, 0.1), min=0.0, max=1.0
    )
    opacity: FloatProperty(  # type: ignore[valid-type]
        name="Opacity", description="Opacity is multiplied by it", default=0.5, min=0.0, max=1.0, subtype="FACTOR"
    )
    show_believed: BoolProperty(  # type: ignore[valid-type]
        name="Show How Far to Believe",
        description="Show in viewports how far beside the clip's camera the scene can be believed",
        default=True,
    )
    colors_over_time: BoolProperty(  # type: ignore[valid-type]
        name="Colors over Time",
        description="Show shadows, ripples and other changes of color as in the clip."
        " Off: each Gaussian keeps its mean color, a steady look for a camera that stands elsewhere",
        options=set(),
        get=lambda self: tints.are_shown(SceneObject(self.id_data).clouds),
        set=_show_tints,
    )
    show_nodes: BoolProperty(  # type: ignore[valid-type]
        name="Nodes",
        description="Show the nodes, empties that move the Gaussians near them: move, key or constrain them",
        options=set(),
        get=lambda self: (layer := layer_of(self.id_data)) is not None and not layer.hide_viewport,
        set=_show_nodes,
    )
    notice: StringProperty()  # type: ignore[valid-type]  # what happened to the nodes
    uncovered: StringProperty()  # type: ignore[valid-type]  # what edits bring to light that no frame saw
    names: CollectionProperty(type=F4X_PG_name)  # type: ignore[valid-type]
    name_index: IntProperty()  # type: ignore[valid-type]
    history: CollectionProperty(type=F4X_PG_edit)  # type: ignore[valid-type]
    history_index: IntProperty()  # type: ignore[valid-type]
    fields: PointerProperty(type=fields.F4X_PG_fields)  # type: ignore[valid-type]
    sentence: StringProperty()  # type: ignore[valid-type]
    answer: StringProperty()  # type: ignore[valid-type]
    instead: StringProperty()  # type: ignore[valid-type]  # the sentence that was probably meant, where that is asked
    slower: FloatProperty()  # type: ignore[valid-type]  # speed of a plan that slows everything and so loses its end; else 0
    readings: CollectionProperty(type=F4X_PG_reading)  # type: ignore[valid-type]
    reading_index: IntProperty()  # type: ignore[valid-type]


CLASSES = (*fields.CLASSES, F4X_PG_edit, F4X_PG_name, F4X_PG_reading, F4X_PG_scene, F4X_PG_typed)


def register() -> None:
    """Hang the groups on objects, of which only roots use it, and on the window manager."""
    bpy.types.Object.f4x = PointerProperty(type=F4X_PG_scene)
    bpy.types.WindowManager.f4x = PointerProperty(type=F4X_PG_typed)


def unregister() -> None:
    """Undo `register`."""
    del bpy.types.WindowManager.f4x
    del bpy.types.Object.f4x
