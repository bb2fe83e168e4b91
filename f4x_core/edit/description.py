"""Operations in plain English, for histories, dry runs and panels; where the language has it, as `language.parse` reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import singledispatch

import numpy as np

from ..language.colour_names import COLOURS, Colour, name_of
from ..language.lexicon import PLACES, plural
from .operations import (
    SHOWN,
    STANDING,
    Blur,
    ChangeWithShadow,
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Glow,
    Grade,
    Loop,
    Match,
    Name,
    Opacity,
    Operation,
    Recolour,
    Rekey,
    Retime,
    Reverse,
    Style,
    Swap,
    TakeBack,
    Transform,
    Vector,
)
from .selects import (
    COPY,
    SHARES,
    All,
    And,
    Beside,
    Box,
    Current,
    Ids,
    Instance,
    Moving,
    Named,
    Not,
    Or,
    Part,
    Point,
    SelectKind,
    Text,
)

_WHICH = {"largest": "biggest"}
_AXES = (("to the left", "to the right"), ("up", "down"), ("forward", "back"))
"""Along the camera's axes: what a negative and a positive step is called."""
SCENE_AXES = "the scene's own axes"
_BASIC = ("red", "green", "blue", "yellow", "orange", "purple", "pink", "cyan", "brown", "white", "black")


def describe(operation: Operation) -> str:
    """One line, for example "make the dog red from frame 20 on"."""
    return _sentence(operation)


def describe_in(operation: Operation, to_world: np.ndarray, axes: str) -> str:
    """As `describe`, but a way or turn along the scene's own axes is told along those of another world, called `axes`.

    `to_world (3,3)`: the turn and scale from the scene to that world.
    """
    turn = to_world / np.maximum(np.linalg.norm(to_world, axis=0), 1e-12)

    def told(vector: Vector, matrix: np.ndarray) -> Vector:
        x, y, z = (float(value) for value in matrix @ np.array(vector))
        return x, y, z

    if isinstance(operation, Transform) and operation.axes == "world":
        moved, turned = told(operation.translate, to_world), told(operation.rotate, turn)
        operation = replace(operation, translate=moved, rotate=turned)
    elif isinstance(operation, Duplicate) and operation.axes == "world":
        operation = replace(operation, offset=told(operation.offset, to_world))
    return describe(operation).replace(SCENE_AXES, axes)


def in_words(operations: Sequence[Operation]) -> str:
    """A plan in the words of the language."""
    return "; ".join(map(describe, operations))


@singledispatch
def _sentence(operation: Operation) -> str:
    raise TypeError(f"{type(operation).__name__} is no operation")


@_sentence.register
def _(operation: Recolour) -> str:
    who, rgb = whom(operation.select), operation.rgb
    strong = _strength(operation.strength)
    if operation.mode == "hue":
        sentence = (
            f"make {who} {strong}black and white"
            if set(rgb) == {0.5}
            else f"shift the hue of {who} {strong}to {_colour(rgb)}"
        )
    elif operation.mode == "multiply":
        sentence = (
            f"make {who} {_times(rgb[0], 'bright', 'brighter', 'darker')}"
            if len(set(rgb)) == 1
            else f"multiply the color of {who} by {_numbers(rgb)}"
        )
    elif operation.mode == "add":
        sentence = f"make {who} {more}" if (more := _more(rgb)) else f"add {_numbers(rgb)} to the color of {who}"
    else:
        sentence = f"make {who} {strong}{'' if operation.keep_luminance else 'solid '}{_colour(rgb)}"
    return _coming(operation, sentence)


@_sentence.register
def _(operation: Opacity) -> str:
    who, factor = whom_with(operation), operation.factor
    if factor == SHOWN:
        sentence = f"show {who} again"
    elif factor > 1:
        sentence = f"increase the opacity of {who} by {_percent(factor - 1)}"
    elif operation.ease:
        sentence = (
            f"fade {who} to {_percent(factor)}" if factor else f"fade {'in' if operation.inward else 'out'} {who}"
        )
        return (
            sentence
            + _span(operation.frames, "to the end")
            + ("" if operation.ease == "linear" else f" ({operation.ease})")
        )
    else:
        sentence = f"give {who} {_percent(factor)} opacity" if factor else f"hide {who}"
    return sentence + _span(operation.frames)


@_sentence.register
def _(operation: Delete) -> str:
    return f"remove {whom_with(operation)}" + _span(operation.frames)


@_sentence.register
def _(operation: Extract) -> str:
    return f"keep only {whom(operation.select)}" + _span(operation.frames)


@_sentence.register
def _(operation: Transform) -> str:
    who, parts = whom_with(operation), []
    if operation.beside is not None:
        parts.append(f"put {who} {_beside(operation.translate)} {whom(operation.beside)}")
    elif any(operation.translate):
        parts.append(f"move {who} {_way(operation.translate, operation.unit, operation.axes)}")
    if any(operation.rotate):
        parts.append(_turn(who, operation.rotate, operation.axes))
    if operation.scale != 1:
        size = _times(operation.scale, "big", "bigger", "smaller") if 0.5 <= operation.scale <= 2 else ""
        parts.append(
            (f"make {who} {size}" if size else f"scale {who} by {operation.scale:g}") + _about(operation.pivot)
        )
    parts = parts or [f"leave {who} where it is"]
    if operation.frames and operation.ease == "step":
        return " and ".join(parts) + f" at frame {operation.frames[0]:g}"
    eased = " evenly" if operation.frames and operation.ease == "linear" else ""
    return " and ".join(parts) + _span(operation.frames, "to the end") + eased


@_sentence.register
def _(operation: Duplicate) -> str:
    sentence = f"copy {whom_with(operation)}" + (f" {operation.count} times" if operation.count > 1 else "")
    if operation.beside is not None:
        sentence += f" {_beside(operation.offset)} {whom(operation.beside)}"
    elif any(operation.offset):
        sentence += f" {_way(operation.offset, operation.unit, operation.axes)}"
    if operation.time_shift:
        sentence += f" {abs(operation.time_shift):g} frames {'later' if operation.time_shift > 0 else 'earlier'}"
    return sentence + (f", called {operation.name}" if operation.name else "")


@_sentence.register
def _(operation: Freeze) -> str:
    until = "" if operation.until is None else f" to frame {operation.until:g}"
    return f"freeze {whom_with(operation)} {'from' if until else 'at'} frame {operation.at:g}{until}"


@_sentence.register
def _(operation: Retime) -> str:
    speeds = {2.0: "twice as fast", 0.5: "at half speed"}
    pace = speeds.get(operation.speed, f"at {_percent(operation.speed)} speed")
    eased = {"soft": " with soft ends"}.get(operation.ease or "", ", gradually" if operation.frames else " gradually")
    return f"play {whom_with(operation)} {pace}" + _span(operation.frames) + (eased if operation.ease else "")


@_sentence.register
def _(operation: Reverse) -> str:
    return f"play {whom_with(operation)} backwards" + _span(operation.frames)


@_sentence.register
def _(operation: Loop) -> str:
    return f"loop {whom_with(operation)}" + _span(operation.frames, "to the end")


@_sentence.register
def _(operation: Style) -> str:
    return _coming(
        operation, f"make {whom(operation.select)} look {_strength(operation.strength)}like {operation.look}"
    )


@_sentence.register
def _(operation: Match) -> str:
    who, source = whom(operation.select), whom(operation.source)
    return _coming(operation, f"match {who} {_strength(operation.strength)}to {source}")


@_sentence.register
def _(operation: Grade) -> str:
    who, parts = whom(operation.select), []
    if operation.contrast != 1:
        parts.append(f"set the contrast of {who} to {_percent(operation.contrast)}")
    if operation.saturation != 1:
        parts.append(f"set the saturation of {who} to {_percent(operation.saturation)}")
    if operation.gamma != 1:
        parts.append(f"set the gamma of {who} to {operation.gamma:g}")
    if operation.warmth or not parts:
        parts.append(f"make {who} {_percent(abs(operation.warmth))} {'cooler' if operation.warmth < 0 else 'warmer'}")
    return _coming(operation, " and ".join(parts))


@_sentence.register
def _(operation: Blur) -> str:
    return f"blur {whom(operation.select)} by {operation.radius:g} units" + _span(operation.frames)


@_sentence.register
def _(operation: Glow) -> str:
    colour = f" {_colour(operation.rgb)}" if operation.rgb else ""
    return f"make {whom(operation.select)} glow{colour} by {_percent(operation.strength)}" + _span(operation.frames)


@_sentence.register
def _(operation: Swap) -> str:
    when = f" at frame {operation.frames[0]:g}" if operation.frames and operation.ease == "step" else ""
    return f"swap {whom(operation.select)} with {whom(operation.other)}" + (
        when or _span(operation.frames, "to the end")
    )


@_sentence.register
def _(operation: Name) -> str:
    return f'call {whom(operation.select)} "{operation.name}"'


@_sentence.register
def _(operation: TakeBack) -> str:
    return f"take back '{operation.words}'" if operation.words else f"take back the edit of id {operation.edit}"


@_sentence.register
def _(operation: Rekey) -> str:
    count, first, last = len(operation.nodes), operation.times[0], operation.times[-1]
    return f"move {count} {plural('node', count)} of the scaffold, frames {first:g} to {last:g}"


_STANDING = {
    "near": "next to",
    "left": "to the left of",
    "right": "to the right of",
    "above": "above",
    "below": "below",
    "behind": "behind",
    "front": "in front of",
}


def _beside(way: Vector) -> str:
    """How a thing that goes beside another stands to it, in words."""
    return next(_STANDING[where] for where, standing in STANDING.items() if standing == way)


def whom(select: SelectKind) -> str:
    """A selection in words."""
    if isinstance(select, Text):
        return " and ".join(f"the {label}" for label in select.labels)
    if isinstance(select, Instance):
        kind = whom(select.of).removeprefix("the ")
        if isinstance(select.of, All | Moving | Or):
            kinds = {All: "thing", Moving: "moving thing"}
            kind = kinds.get(type(select.of)) or f"one of {whom(select.of)}"
        return f"the {_WHICH.get(select.which, select.which)} {kind} of frame {select.frame}"
    if isinstance(select, Part):
        side = {"top": "upper", "bottom": "lower"}.get(select.side, select.side)
        share = next((name for name, x in SHARES.items() if x == select.share), "part")
        return f"the {side} {share} of {whom(select.of)}"
    if isinstance(select, Beside):
        return f"{whom(select.of)} {_STANDING[select.where]} {whom(select.other)}"
    if isinstance(select, Point):
        return f"the thing at {select.x:g}, {select.y:g} in frame {select.frame}"
    if isinstance(select, Box):
        return f"the thing in the box {_numbers(select.box)} of frame {select.frame}"
    if isinstance(select, Or):
        return " and ".join(map(whom, select.of))
    if isinstance(select, And):
        return _both(select)
    if isinstance(select, Not):
        return "the background" if isinstance(select.of, Moving) else f"everything except {whom(select.of)}"
    if isinstance(select, Named):
        return f"the {select.name}" if select.name.split()[0] == COPY else select.name
    if isinstance(select, Ids):
        return select.words or f"{len(select.array)} Gaussians"
    return {All: "everything", Moving: "what moves", Current: "the selection"}[type(select)]


def whom_with(operation: ChangeWithShadow) -> str:
    """The selection of an operation in words, with what goes along: "the car with its shadow"."""
    along = operation.along
    return whom(operation.select) + (f" with {along.words}" if isinstance(along, Ids) and along.words else "")


def _both(select: And) -> str:
    background = Not(Moving())
    kept = [whom(part) for part in select.of if not isinstance(part, Not) or part == background]
    left_out = [whom(part.of) for part in select.of if isinstance(part, Not) and part != background]
    if len(kept) == 2 and isinstance(select.of[1], Moving):
        kept = [f"the moving {kept[0].removeprefix('the ')}"]
    return " that is also ".join(kept or ["everything"]) + "".join(f" but not {part}" for part in left_out)


def _coming(operation: Recolour | Style | Match | Grade, sentence: str) -> str:
    """The sentence with when it holds and, where it comes little by little, how."""
    if operation.ease is None:
        return sentence + _span(operation.frames)
    how = {"linear": "gradually ", "smooth": "gradually ", "step": ""}[operation.ease]
    eased = f" ({operation.ease})" if operation.ease != "linear" else ""
    return how + sentence + _span(operation.frames, "to the end") + eased


def _span(frames: tuple[float, float | None] | None, open_end: str = "on") -> str:
    if frames is None:
        return ""
    start, end = frames
    return f" from frame {start:g} " + (open_end if end is None else f"to frame {end:g}")


def _colour(rgb: Colour) -> str:
    bytes_ = [round(255 * c) for c in rgb]
    exact = tuple(round(byte / 255, PLACES) for byte in bytes_) == tuple(round(c, PLACES) for c in rgb)
    return name_of(rgb) or ("#" + "".join(f"{byte:02x}" for byte in bytes_) if exact else f"rgb {_numbers(rgb)}")


def _more(rgb: Vector) -> str:
    """ "30 % more red" for what it adds; nothing when it is no basic colour."""
    for word, sign in (("more", 1), ("less", -1)):
        for name in _BASIC:
            pure = [sign * (c - 0.5) for c in COLOURS[name]]
            share = round(max(map(abs, rgb)) / max(map(abs, pure)), PLACES)
            if rgb == tuple(round(share * c, PLACES) for c in pure):
                return f"{_percent(share)} {word} {name}"
    return ""


def _times(factor: float, plain: str, more: str, less: str) -> str:
    if factor in (2, 0.5):
        return f"{'twice' if factor == 2 else 'half'} as {plain}"
    return f"{_percent(factor - 1)} {more}" if factor >= 1 else f"{_percent(1 - factor)} {less}"


def _percent(fraction: float) -> str:
    return f"{round(100 * fraction, PLACES):g} %"


def _strength(share: float) -> str:
    return "" if share == 1 else f"{_percent(share)} "


def _numbers(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _rounded(values: tuple[float, ...]) -> str:
    """Numbers as a person reads them: what is less than a hundredth of the largest is none."""
    largest = max(map(abs, values))
    return ", ".join(f"{value:.3g}" if abs(value) >= largest / 100 else "0" for value in values)


def _way(vector: Vector, unit: str, axes: str) -> str:
    measure = "unit" if unit == "world" else "width"
    if axes == "world":
        return f"by ({_rounded(vector)}) {measure}s along {SCENE_AXES}"
    return " and ".join(f"by {step}" for step in _steps(vector, measure))


def _steps(vector: Vector, measure: str) -> list[str]:
    steps = [(abs(x), _AXES[axis][x > 0]) for axis, x in enumerate(vector) if x]
    return [f"{far:g} {plural(measure, far)} {way}" for far, way in steps]


def steps_in_words(vector: Vector) -> str:
    """A way in widths along the camera's axes: "1.1 widths to the left and 0.2 widths up"."""
    return " and ".join(_steps(vector, "width"))


def _turn(who: str, rotate: Vector, axes: str) -> str:
    x, y, z = rotate
    side = "left" if y < 0 or z < 0 else "right"
    if axes == "camera" and (x, y, z) == (0, 0, 180):
        return f"turn {who} upside down"
    if axes == "camera" and y and not x and not z:
        return f"rotate {who} by {abs(y):g} degrees to the {side}"
    if axes == "camera" and z and not x and not y:
        return f"tilt {who} by {abs(z):g} degrees to the {side}"
    whose = SCENE_AXES if axes == "world" else "the camera's axes"
    return f"rotate {who} by ({_rounded(rotate)}) degrees about {whose}"


def _about(pivot: str | Vector) -> str:
    return (
        {"base": "", "centroid": " about its middle"}.get(pivot, "")
        if isinstance(pivot, str)
        else f" about ({_numbers(pivot)})"
    )
