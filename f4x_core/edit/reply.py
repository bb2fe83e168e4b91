"""What a language model may answer: a small closed schema of whole numbers, names and words from the scene.

A model that is held to a grammar loses itself in the digits of a fraction, so there is none here; percentages stand in. Every
field is required and nothing else is allowed. At worst an answer is a wrong edit, which can be undone. The docstrings of
the models are part of the schema that the language model reads, so a change of theirs can change its answers.
Imports pydantic, so only `endpoint` and `judge` import it, and only once somebody asks a model.
"""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar, Union

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, create_model

from ..errors import F4xError
from .operations import (
    MAX_COPIES,
    Blur,
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
    Retime,
    Reverse,
    Span,
    Style,
    Swap,
    Transform,
)
from .selects import All, And, Current, Instance, Moving, Named, Not, Part, SelectKind, Text
from .styles import STYLES

if TYPE_CHECKING:
    from .request import Request

MAX_WORD_LENGTH = 40
"""Letters of a label or a name."""
MAX_WORDS = 8
"""Labels in one target."""
MAX_OPERATIONS = 8
"""Operations in one answer: a sentence holds no more."""
LAST_FRAME = 1_000_000
"""No clip is longer."""

Word = Annotated[str, StringConstraints(min_length=1, max_length=MAX_WORD_LENGTH)]
Words = Annotated[list[Word], Field(max_length=MAX_WORDS)]
Frame = Annotated[int, Field(ge=-1, le=LAST_FRAME)]
"""Clip frame; -1 = none."""
Byte = Annotated[int, Field(ge=0, le=255)]
Percent = Annotated[int, Field(ge=0, le=100)]
Offset = Annotated[int, Field(ge=-1000, le=1000)]
"""Percent of the target's width."""
Which = Literal["any", "left", "right", "top", "bottom", "middle", "nearest", "farthest", "largest", "smallest"]
Half = Literal["whole", "top", "bottom", "left", "right"]


class Strict(BaseModel):
    """Base: nothing unknown, no conversions."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Target(Strict):
    """Who it is about."""

    kind: Literal["words", "everything", "moving", "background", "selected", "named"]
    words: Words
    which: Which
    half: Half
    except_words: Words

    def select(self, request: Request) -> SelectKind:
        """The selection; F4xError for a word that neither scene nor sentence knows."""
        known, sentence = {label.lower() for label in request.labels}, request.sentence.lower()
        for word in (*(self.words if self.kind == "words" else ()), *self.except_words):
            if known and word.lower() not in known and word.lower() not in sentence:
                raise F4xError(f"'{word}' is no label of the scene and not in the request; use the labels")
        chosen = self._kind(request)
        if self.which != "any":
            chosen = Instance(chosen, self.which, round(request.frame))
        if self.half != "whole":
            chosen = Part(chosen, self.half, frame=round(request.frame))
        return And((chosen, Not(Text(tuple(self.except_words))))) if self.except_words else chosen

    def _kind(self, request: Request) -> SelectKind:
        if self.kind == "selected":
            if not request.selected:
                raise F4xError("nothing is selected at present; name the thing by words")
            return Current()
        if self.kind in ("words", "named"):
            if not self.words:
                raise F4xError(f"a target of kind {self.kind} needs words")
            if self.kind == "words":
                return Text(tuple(self.words))
            if self.words[0] not in request.names:
                raise F4xError(f"no selection is named '{self.words[0]}'; use kind words")
            return Named(self.words[0])
        if self.kind == "everything":
            return All()
        return Moving() if self.kind == "moving" else Not(Moving())


class RequestedChange(Strict):
    """One operation; `op` stands first, so that a model under a grammar decides it first."""

    op: str
    target: Target

    def operation(self, request: Request) -> Operation:
        """The typed operation, unresolved."""
        return self.about(self.target.select(request))

    def about(self, select: SelectKind) -> Operation:
        """The typed operation of `select`."""
        raise NotImplementedError


class Timed(RequestedChange):
    """An operation that can be limited in time."""

    first_frame: Frame
    last_frame: Frame

    @property
    def span(self) -> Span | None:
        """None where no frame is given."""
        if self.first_frame < 0 and self.last_frame < 0:
            return None
        return float(max(self.first_frame, 0)), None if self.last_frame < 0 else float(self.last_frame)


class Paint(Timed):
    """Another colour; `paint` keeps light and dark, `flat` does not, `hue` turns the hue alone."""

    op: Literal["paint"]
    red: Byte
    green: Byte
    blue: Byte
    mode: Literal["paint", "flat", "hue"]
    strength: Percent

    def about(self, select: SelectKind) -> Operation:
        """A `Recolour` towards the colour, over the span."""
        rgb = (self.red / 255, self.green / 255, self.blue / 255)
        mode: Literal["hue", "assign"] = "hue" if self.mode == "hue" else "assign"
        return Recolour(select, rgb, mode, self.strength / 100, self.mode == "paint", self.span)


class Brightness(Timed):
    """Brighter or darker: 100 is as before."""

    op: Literal["brightness"]
    percent: Annotated[int, Field(ge=0, le=1000)]

    def about(self, select: SelectKind) -> Operation:
        """A `Recolour` that multiplies all channels by the same factor."""
        factor = self.percent / 100
        return Recolour(select, (factor, factor, factor), "multiply", frames=self.span)


class OpacityChange(Timed):
    """Transparent: 0 hides, 100 is as before."""

    op: Literal["opacity"]
    percent: Percent

    def about(self, select: SelectKind) -> Operation:
        """An `Opacity` of that factor, over the span."""
        return Opacity(select, self.percent / 100, self.span)


class RemovalChange(Timed):
    """Delete it, or leave nothing else."""

    op: Literal["delete", "keep_only"]

    def about(self, select: SelectKind) -> Operation:
        """A `Delete`, or an `Extract` for `keep_only`, over the span."""
        return Delete(select, self.span) if self.op == "delete" else Extract(select, self.span)


class TransformChange(Timed):
    """Move, turn and resize, in one go or over the span; 0, 0, 0, 0, 0, 100 is as before."""

    op: Literal["transform"]
    right: Offset
    up: Offset
    away: Offset
    turn_right_degrees: Annotated[int, Field(ge=-360, le=360)]
    roll_right_degrees: Annotated[int, Field(ge=-360, le=360)]
    size: Annotated[int, Field(ge=1, le=10000)]

    def about(self, select: SelectKind) -> Operation:
        """A `Transform` in units of the target's width and axes of the camera; with a first frame alone it is a jump."""
        jump = self.first_frame >= 0 and self.last_frame < 0
        return Transform(
            select,
            (self.right / 100, -self.up / 100, self.away / 100),
            (0.0, float(self.turn_right_degrees), float(self.roll_right_degrees)),
            self.size / 100,
            "base" if self.size != 100 else "centroid",
            "size",
            "camera",
            (float(self.first_frame),) * 2 if jump else self.span,
            "step" if jump else "smooth",
        )


class Copy(RequestedChange):
    """Copies beside it, or later in time."""

    op: Literal["duplicate"]
    right: Offset
    up: Offset
    away: Offset
    later_frames: Annotated[int, Field(ge=-LAST_FRAME, le=LAST_FRAME)]
    copies: Annotated[int, Field(ge=1, le=MAX_COPIES)]

    def about(self, select: SelectKind) -> Operation:
        """A `Duplicate`, its offset in widths of the target and axes of the camera."""
        offset = (self.right / 100, -self.up / 100, self.away / 100)
        return Duplicate(select, offset, float(self.later_frames), self.copies, "size", "camera")


class Stop(Timed):
    """Stand still from the first frame (-1: the present one) to the last (-1: for good)."""

    op: Literal["freeze"]

    def operation(self, request: Request) -> Operation:
        """A `Freeze`; without a first frame it begins at the present one."""
        at = float(request.frame if self.first_frame < 0 else self.first_frame)
        return Freeze(self.target.select(request), at, None if self.last_frame < 0 else float(self.last_frame))


class Speed(Timed):
    """Faster or slower: 100 is as before."""

    op: Literal["speed"]
    percent: Annotated[int, Field(ge=1, le=10000)]
    ease: Literal["none", "smooth"]

    def about(self, select: SelectKind) -> Operation:
        """A `Retime` over the span, with soft ends where it comes smoothly."""
        return Retime(select, self.percent / 100, self.span, None if self.ease == "none" else "smooth")


class ReverseOrLoop(Timed):
    """Backwards, or again and again."""

    op: Literal["reverse", "loop"]

    def about(self, select: SelectKind) -> Operation:
        """A `Reverse` or a `Loop`; F4xError for a loop without a span."""
        if self.op == "reverse":
            return Reverse(select, self.span)
        if self.span is None:
            raise F4xError("a loop needs first_frame and last_frame")
        return Loop(select, self.span)


class Look(Timed):
    """A look from the table."""

    op: Literal["style"]
    look: Literal[tuple(STYLES)]  # type: ignore[valid-type]  # the table says which
    strength: Percent

    def about(self, select: SelectKind) -> Operation:
        """A `Style` of that name, over the span."""
        return Style(select, self.look, self.strength / 100, self.span)


class MatchColors(Timed):
    """The colours of something else."""

    op: Literal["match"]
    source: Target

    def operation(self, request: Request) -> Operation:
        """A `Match` of the target with the source, over the span."""
        return Match(self.target.select(request), self.source.select(request), frames=self.span)


class NameSelection(RequestedChange):
    """A name for it."""

    op: Literal["name"]
    name: Word

    def about(self, select: SelectKind) -> Operation:
        """A `Name` for the selection."""
        return Name(select, self.name)


class Derived(Timed):
    """A change whose fields come from an operation's own: see `_derived`."""

    KIND: ClassVar[type[Any]]

    def operation(self, request: Request) -> Operation:
        """The operation of which this is the reply; what is not asked for keeps its default."""
        values: dict[str, Any] = {"select": self.target.select(request), "frames": self.span}
        for entry in fields(self.KIND):
            if entry.name == "other":
                values["other"] = getattr(self, entry.name).select(request)
            elif f"{entry.name}_percent" in type(self).model_fields:
                usual = entry.default if entry.name in _USUAL else 1.0
                values[entry.name] = getattr(self, f"{entry.name}_percent") / 100 * usual
        color = getattr(self, "color", [])  # none: its own
        if len(color) not in (0, 3):
            raise F4xError("color needs red, green and blue, or nothing")
        return self.KIND(**values, **({"rgb": tuple(part / 255 for part in color)} if color else {}))


_USUAL = ("radius",)
"""Fields that are told in percent of their default, because their unit is the scene's own."""
_HIDDEN = ("shift", "first_id", "ease")
"""Fields that are worked out in the scene, or keep their default."""


def _derived(kind: type[Any]) -> type[Derived]:
    """The reply for an operation, from its dataclass: numbers become percentages, a second selection a target, a colour bytes."""
    shape: dict[str, Any] = {"op": (Literal[kind.TAG], ...)}
    for entry in fields(kind):
        if entry.name == "other":
            shape["other"] = (Target, ...)
        elif entry.name == "rgb":
            shape["color"] = (Annotated[list[Byte], Field(max_length=3)], ...)
        elif entry.name not in ("select", "frames", *_HIDDEN):
            low = -100 if entry.default == 0.0 else 0
            shape[f"{entry.name}_percent"] = (Annotated[int, Field(ge=low, le=1000 if low == 0 else 100)], ...)
    doc = (kind.__doc__ or "").splitlines()[0]  # what the model reads
    model = create_model(f"{kind.__name__}Reply", __base__=Derived, __doc__=doc, **shape)
    model.KIND = kind
    return model


DERIVED = tuple(_derived(kind) for kind in (Grade, Blur, Glow, Swap))
"""Replies that need no words of their own."""
_OWN = (
    Paint, Brightness, OpacityChange, RemovalChange, TransformChange, Copy, Stop, Speed, ReverseOrLoop, Look, MatchColors,
    NameSelection,
)  # fmt: skip
AnyChange: Any = Union.__getitem__((*_OWN, *DERIVED))
"""Any of the replies."""


class ChangeList(Strict):
    """What the request comes to; no operation where it asks for what cannot be done."""

    operations: Annotated[list[Annotated[AnyChange, Field(discriminator="op")]], Field(max_length=MAX_OPERATIONS)]


class Choice(Strict):
    """The number of the best picture, from 1."""

    best: Annotated[int, Field(ge=1, le=100)]


Answer = TypeVar("Answer", bound=Strict)


def read_answer(kind: type[Answer], data: Any) -> Answer:
    """Validate the JSON value `data` as an answer of type `kind`; the text of the F4xError tells a model what to correct."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        wrong = [f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors(include_url=False)[:3]]
        raise F4xError(f"{'; '.join(wrong)[:600]}") from error


@cache
def schema_of(kind: type[Strict]) -> dict[str, Any]:
    """JSON schema of an answer as strict servers and grammars take it: alternatives as `anyOf`, no discriminator."""
    return _simple(kind.model_json_schema())


def _simple(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_simple(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        "anyOf" if key == "oneOf" else key: (
            {name: _simple(part) for name, part in value.items()} if key in ("properties", "$defs") else _simple(value)
        )
        for key, value in schema.items()
        if key not in ("title", "discriminator")
    }
