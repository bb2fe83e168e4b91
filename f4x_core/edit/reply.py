"""The schema of a language model's answers: whole numbers, names and words from the scene.

A model that is held to a grammar loses itself in the digits of a fraction, so there is none here; percentages stand in. Every
field is required and nothing else is allowed. At worst an answer is a wrong edit, which can be undone. The docstrings of
the models are part of the schema that the language model reads, so a change of theirs can change its answers.
Imports pydantic, so only `endpoint` and `judge` import it, and only once somebody asks a model.
"""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar, Union

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, StringConstraints, ValidationError, create_model

from ..errors import F4xError
from .change import Change, Reply, Span
from .operations import kinds
from .selects import All, And, Current, Instance, Moving, Named, Not, Part, SelectKind, Text

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
Which = Literal["any", "left", "right", "top", "bottom", "middle", "nearest", "farthest", "largest", "smallest"]
Half = Literal["whole", "top", "bottom", "left", "right"]


class Strict(BaseModel):
    """Base: nothing unknown, no conversions."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Target(Strict):
    """Its target."""

    kind: Literal["words", "everything", "moving", "background", "selected", "named"]
    words: Words
    which: Which
    half: Half
    except_words: Words

    def select(self, request: Request) -> SelectKind:
        """Return the selection; F4xError for a word that neither scene nor sentence knows."""
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

    REPLY: ClassVar[Reply]
    KIND: ClassVar[type[Any]]
    op: str
    target: Target

    def operation(self, request: Request) -> Change:
        """Return the typed operation, unresolved."""
        self._present = request.frame
        who, make = self.target.select(request), self.REPLY.make
        return self._field_by_field(who, request) if make is None else make(self, who, lambda one: one.select(request))

    @property
    def present(self) -> float:
        """The present frame."""
        return self._present

    _present: float = PrivateAttr(0.0)

    def _field_by_field(self, who: SelectKind, request: Request) -> Change:
        """Return the operation field by field; fields that the reply leaves out keep their defaults."""
        values: dict[str, Any] = {"select": who}
        for entry in fields(self.KIND):
            if "degrees" in entry.metadata:
                values[entry.name] = float(getattr(self, f"{entry.name}_degrees"))
            elif entry.name == "frames":
                values["frames"] = getattr(self, "span", None)
            elif entry.name == "other":
                values["other"] = getattr(self, entry.name).select(request)
            elif f"{entry.name}_percent" in type(self).model_fields:
                usual = entry.default if entry.name in _USUAL else 1.0
                values[entry.name] = getattr(self, f"{entry.name}_percent") / 100 * usual
        color = getattr(self, "color", [])  # none: its own
        if len(color) not in (0, 3):
            raise F4xError("color needs red, green and blue, or nothing")
        return self.KIND(**values, **({"rgb": tuple(part / 255 for part in color)} if color else {}))  # type: ignore[no-any-return]


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


_USUAL = ("radius",)
"""Fields that are told in percent of their default, because their unit is the scene's own."""
_HIDDEN = ("shift", "first_id", "ease", "along")
"""Fields that are worked out in the scene, or keep their default."""


def _model(kind: type[Change], reply: Reply) -> type[RequestedChange]:
    """Return the model of a reply: numbers within their range, or percentages of the operation's own fields."""
    shape: dict[str, Any] = {"op": (Literal[reply.op], ...)}
    if reply.make is None:
        for entry in fields(kind):  # type: ignore[arg-type]  # every operation is a dataclass
            if most := entry.metadata.get("degrees"):
                shape[f"{entry.name}_degrees"] = (_hint(range(-most, most + 1)), ...)
            elif entry.name == "other":
                shape["other"] = (Target, ...)
            elif entry.name == "rgb":
                shape["color"] = (Annotated[list[Byte], Field(max_length=3)], ...)
            elif entry.name not in ("select", "frames", *_HIDDEN):
                low = -100 if entry.default == 0.0 else 0
                shape[f"{entry.name}_percent"] = (Annotated[int, Field(ge=low, le=1000 if low == 0 else 100)], ...)
    for name, values in reply.fields.items():
        shape[name] = (_TYPES[values] if isinstance(values, str | type) else _hint(values), ...)
    base = Timed if reply.timed else RequestedChange
    model = create_model(reply.name or f"{kind.__name__}Reply", __base__=base, __doc__=reply.doc, **shape)
    model.KIND, model.REPLY = kind, reply
    return model


_TYPES: dict[Any, Any] = {str: Word, "target": Target}


def _hint(values: range | tuple[str, ...]) -> Any:
    if isinstance(values, range):
        return Annotated[int, Field(ge=values[0], le=values[-1])]
    return Literal[values]  # type: ignore[valid-type]  # the operation says which


_REPLIES = [(kind, reply) for kind in kinds() for reply in kind.replies()]
AnyChange: Any = Union.__getitem__(
    tuple(
        _model(*one) for one in sorted(_REPLIES, key=lambda one: one[1].make is None)
    )  # those of their own words first
)
"""Any of the replies."""


class ChangeList(Strict):
    """Return the operations of the request; none where it asks for something impossible."""

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
    """Return the JSON schema of an answer as strict servers and grammars take it: alternatives as `anyOf`, no discriminator."""
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
