"""The fields of an edit as Blender properties: the color, amount, span and place of the row that is picked under *Edits*.

The properties are made of the dataclasses of the operations, one group for each, and store nothing: they read and write the
stack of the root, so Undo, scripts and the list always agree. Places and rotations are along Blender's axes.

A change is in the stack at once. The viewport follows at once, too, unless it takes long: then it leaves the window as much
time as it takes, so that a slider can be dragged.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, PointerProperty
from mathutils import Euler, Quaternion
from mathutils import Vector as Vector3

from ...f4x_core.edit.operations import MAX_NUMBER, MAX_SCALE, Operation, Span, Transform, Vector
from ...f4x_core.edit.stack import EditStack
from ...f4x_core.edit.styles import STYLES
from ...f4x_core.errors import F4xError
from ..common.axes import SceneAxes
from ..common.wording import error_line
from ..scene import cache
from ..scene.clip_time import FIRST, LAST, time_of
from ..scene.scene_object import EDITS, SceneObject
from . import display, listing

PLANNED = {
    "select",
    "source",
    "other",
    "beside",
    "unit",
    "axes",
    "count",
    "first_id",
    "name",
    "edit",
    "words",
    "nodes",
    "times",
}
"""Fields that planning settles, or that later edits count on."""
DIGITS = 6
"""Decimals of a number in the stack: Blender's properties are in single precision."""
PAUSE = 0.7
"""Seconds after the last change of a field until the sidebar sums up what the edits uncover."""
RANGES = {
    "factor": (0, 10, 1), "strength": (0, 1, 1), "scale": (1 / MAX_SCALE, MAX_SCALE, 10), "speed": (1 / MAX_SCALE, MAX_SCALE, 10),
    "contrast": (0, 10, 2), "saturation": (0, 10, 2), "warmth": (-1, 1, 1), "radius": (0, MAX_SCALE, 0.2),
}  # fmt: skip
"""Name of a number -> minimum, maximum, maximum of its slider."""
LABELS = {
    "rgb": "Color", "translate": "Move", "keep_luminance": "Keep Shading", "at": "From Frame", "until": "Until Frame",
    "centroid": "Center", "assign": "Replace", "time_shift": "Time Offset",
}  # fmt: skip
"""Titles of fields and words that are not called so."""


@dataclass(frozen=True)
class Row:
    """The edit that a property group shows."""

    scene_object: SceneObject
    id: int
    operation: Operation

    @classmethod
    def of(cls, group: bpy.types.PropertyGroup) -> Row | None:
        """Return the picked edit of the scene that has the group; None where it is of another kind."""
        row = cls.picked(SceneObject(group.id_data))
        return row if row is not None and f"F4X_PG_{row.operation.TAG}" == type(group).__name__ else None

    @classmethod
    def picked(cls, scene_object: SceneObject) -> Row | None:
        """Return the edit that is picked in the list; None where there is none."""
        state = scene_object.state
        if not 0 <= state.history_index < len(state.history):
            return None
        id = state.history[state.history_index].edit_id
        edits = stack_of(scene_object).edits
        return next((cls(scene_object, id, edit.operation) for edit in edits if edit.id == id), None)


def stack_of(scene_object: SceneObject) -> EditStack:
    """Return the pending stack; a panel that draws may not store one where there is none, as `SceneObject.stack` does."""
    return cache.stack_from(scene_object.root.get(EDITS, cache.NO_EDITS), scene_object.name)


def change(scene_object: SceneObject, id: int, *, later: bool = False, **values: Any) -> None:
    """Give fields of the edit `id` other values, and show it; where they do not go together, the sidebar says so instead.

    `later`: it is shown after the handler of Blender that calls this.
    """
    state, stack = scene_object.state, stack_of(scene_object)
    try:
        scene_object.check_file()
        operation = replace(stack.edits[stack.position(id)].operation, **values)
    except F4xError as error:
        state.answer = error_line(error)
        return
    scene_object.root[EDITS] = cache.text_of(stack.replace(id, operation))
    scene_object.show_preview(None)
    show_soon(scene_object, later)


_costs: dict[
    int, tuple[float, float]
] = {}  # session_uid of a root -> when its edits were shown last, and how long that took


def show_soon(scene_object: SceneObject, later: bool) -> None:
    """Show the pending edits of a scene: at once, or when the window had as much time as showing them takes."""
    ended, took = _costs.get(scene_object.root.session_uid, (0.0, 0.0))
    wait = max(ended + took - time.monotonic(), 0.0)
    if bpy.app.background or not (wait or later):
        _show(scene_object)
    elif not bpy.app.timers.is_registered(show_late):
        bpy.app.timers.register(show_late, first_interval=wait)


def show_after_undo(scene_object: SceneObject) -> None:
    """Show edits that are not shown: after the handlers of undo, in which no datablock may come or go."""
    if bpy.app.background:
        display.redraw(scene_object)
    elif not bpy.app.timers.is_registered(show_late):
        bpy.app.timers.register(show_late, first_interval=0.0)


def show_late() -> None:
    """Show the edits of all scenes that are not shown yet."""
    for scene_object in SceneObject.among(bpy.context.scene.objects):
        if not scene_object.is_linked and not display.is_drawn(scene_object):
            _show(scene_object)


def _show(scene_object: SceneObject) -> None:
    began = time.monotonic()
    try:
        display.refresh(scene_object, summary=bpy.app.background)
    except F4xError as error:
        scene_object.state.answer = error_line(error)
    ended = time.monotonic()
    _costs[scene_object.root.session_uid] = (ended, ended - began)
    if not bpy.app.background:
        if bpy.app.timers.is_registered(_summarize):
            bpy.app.timers.unregister(_summarize)
        bpy.app.timers.register(_summarize, first_interval=PAUSE)


def _summarize() -> None:
    """Sum up what edits uncover, once nobody drags any more."""
    for scene_object in SceneObject.among(bpy.context.scene.objects):
        with contextlib.suppress(F4xError):
            listing.update_panel(scene_object)


def draw_fields(layout: bpy.types.UILayout, scene_object: SceneObject) -> None:
    """Draw the fields of the picked edit."""
    row = Row.picked(scene_object)
    if row is None or row.operation.TAG not in KINDS:
        return
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    group = getattr(scene_object.state.fields, row.operation.TAG)
    for shown in SHOWN[row.operation.TAG]:
        if shown.visible(row.operation):
            column.prop(group, shown.name)
    if isinstance(row.operation, Transform):
        layout.operator("f4x.edit_gizmo", icon="GIZMO").edit_id = row.id


@dataclass(frozen=True)
class Shown:
    """A property of an edit."""

    name: str
    make: Callable[..., Any]
    """A function of `bpy.props`."""
    options: dict[str, Any]
    get: Callable[[Operation, SceneAxes], Any]
    """The property's value, in a scene that is placed so; None leaves its default."""
    put: Callable[[Row, Any], dict[str, Any]]
    """Fields and values of the operation for a value of the property."""
    visible: Callable[[Operation], bool] = lambda operation: True

    @property
    def annotation(self) -> Any:
        """The property as a group declares it."""
        default = self.options.get("default", 0)

        def getter(group):
            row = Row.of(group)
            found = (
                None
                if row is None or not self.visible(row.operation)
                else self.get(row.operation, row.scene_object.axes)
            )
            return default if found is None else found

        def setter(group, value):
            row = Row.of(group)
            if row is not None and value != getter(group):
                change(row.scene_object, row.id, **self.put(row, value))

        return self.make(get=getter, set=setter, **{"options": set(), **self.options})


def _title(name: str) -> str:
    return LABELS.get(name, name.replace("_", " ").title())


def _number(name: str) -> Shown:
    low, high, soft = RANGES.get(name, (-MAX_NUMBER, MAX_NUMBER, MAX_NUMBER))
    options = {"name": _title(name), "min": low, "max": high, "soft_max": soft, "precision": 3, "default": 1.0}
    return Shown(
        name, FloatProperty, options, lambda one, _: getattr(one, name), lambda row, value: {name: round(value, DIGITS)}
    )


def _switch(name: str, title: str, put: Callable[[Row, bool], dict[str, Any]]) -> Shown:
    """Return True if an optional field has a value."""
    options = {"name": title, "default": False}
    return Shown(f"use_{name}", BoolProperty, options, lambda one, _: getattr(one, name) is not None, put)


def _bool(name: str) -> Shown:
    options = {"name": _title(name), "default": False}

    def counts(one: Operation) -> bool:
        return name != "inward" or one.ease is not None

    return Shown(
        name, BoolProperty, options, lambda one, _: getattr(one, name), lambda row, value: {name: value}, counts
    )


def _choice(name: str, choices: tuple[str, ...], optional: bool) -> Shown:
    """Return the field of one of several words; the numbers of its enum are their places in `choices`."""
    words: tuple[str | None, ...] = ((None,) if optional else ()) + choices
    items = [(word or "NONE", _title(word or "at once"), "", number) for number, word in enumerate(words)]

    def number_of(one: Operation, _: SceneAxes) -> int:
        return words.index(getattr(one, name))

    def is_word(one: Operation) -> bool:
        return getattr(one, name) in words and (name != "ease" or one.frames is not None)  # only a span has an ease

    options = {"name": _title(name), "items": items}
    return Shown(name, EnumProperty, options, number_of, lambda row, value: {name: words[value]}, is_word)


def _color(name: str) -> Shown:
    options = {"name": _title(name), "subtype": "COLOR_GAMMA", "size": 3, "default": (1.0, 1.0, 1.0)}
    options |= {"min": -1.0, "max": 64.0, "soft_min": 0.0, "soft_max": 1.0}

    def put(row: Row, value: Any) -> dict[str, Any]:
        return {name: tuple(round(part, DIGITS) for part in value)}

    return Shown(name, FloatVectorProperty, options, lambda one, _: getattr(one, name), put)


def _place(name: str) -> Shown:
    options = {"name": _title(name), "subtype": "TRANSLATION", "size": 3, "default": (0.0, 0.0, 0.0)}
    options |= {"soft_min": -10.0, "soft_max": 10.0, "step": 1, "precision": 4}

    def put(row: Row, value: Any) -> dict[str, Any]:
        return {name: row.scene_object.axes.way_in_scene(round(part, DIGITS) for part in value)}

    def get(one: Operation, axes: SceneAxes) -> Any:
        return axes.way_in_world(getattr(one, name) or (0, 0, 0))

    return Shown(name, FloatVectorProperty, options, get, put)


def _rotation(name: str) -> Shown:
    options = {"name": _title(name), "subtype": "EULER", "size": 3, "default": (0.0, 0.0, 0.0), "step": 100}

    def get(one: Operation, axes: SceneAxes) -> Any:
        turn = np.deg2rad(axes.turn_in_world(getattr(one, name)))
        return tuple(Quaternion(Vector3(turn.tolist())).to_euler())

    def put(row: Row, value: Any) -> dict[str, Any]:
        turn = np.rad2deg(Euler(value).to_quaternion().to_exponential_map())
        return {name: row.scene_object.axes.turn_in_scene(np.round(turn, DIGITS))}

    return Shown(name, FloatVectorProperty, options, get, put)


def _optional(shown: Shown, new: Callable[[Row], Any]) -> list[Shown]:
    """Return a field with a switch before it; `new`: its value when it is switched on."""
    name = shown.name
    switch = _switch(name, f"{_title(name)}…", lambda row, on: {name: new(row) if on else None})
    return [switch, replace(shown, visible=lambda one: getattr(one, name) is not None)]


def _span(optional: bool) -> list[Shown]:
    """Return the first and last clip frame, with switches for always and for the end of the clip."""

    def now(row: Row) -> float:
        root = row.scene_object.root
        return float(round(min(max(time_of(root), root.get(FIRST, 0.0)), end(row))))

    def end(row: Row) -> float:
        return float(row.scene_object.root.get(LAST, 0.0))

    def is_set(one: Operation) -> bool:
        return one.frames is not None

    def has_end(one: Operation) -> bool:
        return one.frames is not None and one.frames[1] is not None

    def first(row: Row, value: float) -> dict[str, Any]:
        last = row.operation.frames[1]
        return {"frames": (round(value, 3), last if last is None else max(last, round(value, 3)))}

    def last(row: Row, value: float) -> dict[str, Any]:
        return {"frames": (min(row.operation.frames[0], round(value, 3)), round(value, 3))}

    def until_end(row: Row, on: bool) -> dict[str, Any]:
        return {"frames": (row.operation.frames[0], None if on else max(end(row), row.operation.frames[0]))}

    number = {"precision": 2, "step": 100, "default": 0.0}
    switch = _switch("frames", "Time Span", lambda row, on: {"frames": (now(row), end(row)) if on else None})
    return [
        *([switch] if optional else []),
        Shown("first", FloatProperty, {"name": "First Frame", **number}, lambda one, _: one.frames[0], first, is_set),
        Shown("last", FloatProperty, {"name": "Last Frame", **number}, lambda one, _: one.frames[1], last, has_end),
        Shown(
            "until_end",
            BoolProperty,
            {"name": "To the End", "default": False},
            lambda one, _: not has_end(one),
            until_end,
            is_set,
        ),
    ]


def _properties_of(name: str, hint: Any) -> list[Shown]:
    """Return the properties of a field of an operation; none where it is of a kind that nobody edits."""
    options = (
        [one for one in get_args(hint) if one is not NoneType] if get_origin(hint) in (Union, UnionType) else [hint]
    )
    optional = len(options) < len(get_args(hint)) and get_origin(hint) in (Union, UnionType)
    words = next((one for one in options if get_origin(one) is Literal), None)
    if Span in options:
        return _span(optional)
    if words is not None:
        return [_choice(name, get_args(words), optional)]
    if Vector in options:
        kind = {"rgb": _color, "rotate": _rotation}.get(name, _place)
        return _optional(kind(name), lambda row: (1.0, 1.0, 1.0)) if optional else [kind(name)]
    if float in options:
        return (
            _optional(_number(name), lambda row: float(row.scene_object.root.get(LAST, 0)))
            if optional
            else [_number(name)]
        )
    if bool in options:
        return [_bool(name)]
    return [_choice(name, tuple(STYLES), False)] if name == "look" else []


def _group(kind: type) -> type:
    """Return the property group of a kind of operation."""
    annotations = {shown.name: shown.annotation for shown in SHOWN[kind.TAG]}
    body = {"__annotations__": annotations, "__doc__": f"Fields of an edit of the kind {kind.TAG}."}
    return type(f"F4X_PG_{kind.TAG}", (bpy.types.PropertyGroup,), body)


SHOWN: dict[str, list[Shown]] = {
    kind.TAG: [
        shown
        for field in fields(kind)
        if field.name not in PLANNED
        for shown in _properties_of(field.name, get_type_hints(kind)[field.name])
    ]
    for kind in get_args(Operation)
}
"""Tag of an operation -> its properties, in the order of its fields."""
KINDS = {kind.TAG: _group(kind) for kind in get_args(Operation) if SHOWN[kind.TAG]}
F4X_PG_fields = type(
    "F4X_PG_fields",
    (bpy.types.PropertyGroup,),
    {
        "__annotations__": {tag: PointerProperty(type=group) for tag, group in KINDS.items()},
        "__doc__": "The fields of the picked edit, a group for each kind.",
    },
)
CLASSES = (*KINDS.values(), F4X_PG_fields)
