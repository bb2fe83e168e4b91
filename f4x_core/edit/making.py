"""What is done to somebody: from the amounts, colours and ways that a sentence names to typed operations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from typing import Any

from ..language.colour_names import Colour
from ..language.colours import GRAY
from ..language.degrees import DEGREES, Amount, Degree, Distance, Steps, Vector, degree_of, displacement, factor
from ..language.lexicon import PLACES
from ..language.refusal import Final, Mismatch, Refusal
from ..language.times import TimeExpression
from .operations import (
    SHOWN,
    STANDING,
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
    Style,
    Swap,
    Transform,
)
from .phrases import Place, SentenceContext, When, Who, refuse_as_name
from .selects import All, Instance, Named, Not, Or, SelectKind, Text

Value = Callable[[SelectKind, When, SentenceContext], Operation]
"""What "red" or "twice as big" does to somebody at some time."""
Making = Callable[[float], Value]
"""A value from a factor."""
Graded = Callable[[Amount | None, bool], Value]
"""A value from how much, and whether more or less; Mismatch where there is no such amount of it."""

BLACK_AND_WHITE = (0.5, 0.5, 0.5)
"""As `hue`: no colour is left, light and dark stay."""
A_BIT = 0.5
"""Strength of a tint."""
MORE_COLOUR = 0.3
"""How far "redder" goes from gray to red."""
WARMER = 0.5
"""Warmth of "warmer", the usual degree of it."""
BLUR, GLOW = 0.02, 0.5
"""Radius of "blur" in world units and strength of "glow", the usual degrees of them."""
COPY_DISTANCE = 1.2
"""Widths to the next copy: beside the thing, with a gap."""
BESIDE = (COPY_DISTANCE, 0.0, 0.0)
"""Where a copy goes when the sentence does not say, in sizes along the camera's axes."""
TILT = 30.0
"""Degrees, where the sentence names none."""


# Values: what follows "make the dog …" --------------------------------------------------------------------------------
UPSIDE_DOWN = (0.0, 0.0, 180.0)
"""Degrees about the camera's axes."""
LEFT, RIGHT, UP, DOWN = (((None, way, None),) for way in ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)))
"""One step in a direction, as `phrases.steps` has it."""


def recoloured(rgb: Colour, mode: Any = "assign", strength: float = 1.0) -> Value:
    """A colour, laid on by `mode`."""
    return lambda who, when, _: Recolour(who, rgb, mode, strength, **when.coming)


def hued(rgb: Colour, strength: float = 1.0) -> Value:
    """The hue of a colour; light and dark stay."""
    return recoloured(rgb, "hue", strength)


GRAYED = hued(BLACK_AND_WHITE)


def assigned(rgb: Colour, strength: float = 1.0) -> Value:
    """A colour with the light and shade of the thing; gray takes its colour away."""
    if rgb == GRAY:
        return recoloured(BLACK_AND_WHITE, "hue", strength)
    return lambda who, when, _: Recolour(who, rgb, strength=strength, keep_luminance=True, **when.coming)


def faintly(rgb: Colour) -> Value:
    """A bit of a colour."""
    return assigned(rgb, A_BIT)


def brightened(by: float) -> Value:
    """So many times as bright."""
    return recoloured((round(by, PLACES),) * 3, "multiply")


def added(times: float, more: tuple[Colour, int]) -> Value:
    """Redder or less blue, `times` as much as usual."""
    rgb, sign = more
    red, green, blue = (round(times * sign * MORE_COLOUR * (c - 0.5), PLACES) for c in rgb)
    return recoloured((red, green, blue), "add")


def refused(reason: str) -> Value:
    """Nothing, for a reason: the words are understood, and what they ask for cannot be."""

    def value(*_: Any) -> Operation:
        raise Final(reason)

    return value


def graded(
    make: Making, of: Callable[[Degree], tuple[float, float]] = attrgetter("factors"), gone: bool = True
) -> Graded:
    """What `make` makes of a factor, where that has a meaning; `of`: as in `factor`; `gone`: there can be nothing left of it."""

    def changed(how: Amount | None, upward: bool) -> Value:
        by = factor(how, upward, of)
        if how is not None and how.kind == "times" and upward and by < 1:
            return refused(f"{by:g} times as much is less, not more; say for example 'twice as much'.")
        if how is not None and by == 1:
            return refused("That changes nothing; say for example 'by 20 %'.")
        if by < 0 or not (by or gone):
            return refused("Nothing would be left of it; say for example 'by 50 %'.")
        return make(by)

    return changed


def only_more(make: Callable[[Amount | None], Value]) -> Graded:
    """What nothing has by itself, so that there is no less of it."""

    def changed(how: Amount | None, upward: bool) -> Value:
        if not upward:
            raise Mismatch
        return make(how)

    return changed


def gamma(to: float) -> Value:
    """A gamma."""
    return lambda who, when, _: Grade(who, gamma=round(to, PLACES), **when.coming)


def contrasted(by: float) -> Value:
    """So many times the contrast."""
    return lambda who, when, _: Grade(who, contrast=round(by, PLACES), **when.coming)


def saturated(by: float) -> Value:
    """So many times the saturation."""
    return lambda who, when, _: Grade(who, saturation=round(by, PLACES), **when.coming)


def warmed(how: Amount | None, warmer: bool) -> Value:
    """Warmer or cooler, by a part of all the warmth that there can be; twice as warm is by one part more."""
    sign = 1 if warmer else -1
    if how is None or how.kind in DEGREES:
        warmth = sign * _strong(WARMER, how)
    else:
        warmth = sign * (how.value if how.kind == "fraction" else how.value - 1)
    if abs(warmth) > 1 or (how is not None and how.kind == "times" and how.value < 1):
        return refused("Nothing gets warmer or cooler by more than 100 %; say for example '30 % warmer'.")
    return lambda who, when, _: Grade(who, warmth=round(warmth, PLACES), **when.coming)


def _strong(usual: float, how: Amount | None, most: float = 1.0) -> float:
    """The usual strength, a degree of it up to the `most` there is, or so many times as much; Mismatch for other amounts."""
    if degree := degree_of(how):
        return min(usual * degree.share, most)
    if how is None or how.kind not in ("times", "as") or how.value < 1:
        raise Mismatch
    return usual * how.value


def blurred(how: Amount | None = None) -> Value:
    """A blur, a bit of one or much, or one `to` a radius in world units; Mismatch for other amounts."""
    if how is not None and how.kind == "fraction":
        return refused("A blur has no percents; say 'a bit', 'much', or how wide it is, as in 'by 0.03 units'.")
    radius = how.value if how is not None and how.kind == "to" else _strong(BLUR, how)
    return lambda who, when, _: Blur(who, radius, **when.effect)


def glowing(how: Amount | None = None, rgb: Colour | None = None) -> Value:
    """A glow, in its own colours or in `rgb`, a bit, much or a fraction; Mismatch for other amounts."""
    strength = how.value if how is not None and how.kind == "fraction" else _strong(GLOW, how)
    if strength > 1:
        return refused("A glow of 100 % is the strongest; say for example 'make the dog glow by 80 %'.")
    return lambda who, when, _: Glow(who, strength, rgb, **when.effect)


def swapped(other: Who | None = None) -> Value:
    """To change places with `other`, or the two of a pair with each other; Refusal where they are not two."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        pair: tuple[SelectKind, ...] = (who,) if other is None else (who, other(context))
        if other is not None and isinstance(who, Text):
            pair = (replace(who, number="any"), pair[1])
        elif isinstance(who, Text):
            pair = tuple(replace(who, labels=(label,)) for label in who.labels)
        elif other is None and isinstance(who, Or):
            pair = who.of
        if len(pair) == 1 and isinstance(who, Text) and who.number == "both":
            of = replace(who, number="any")
            pair = (Instance(of, "left", context.present), Instance(of, "right", context.present))
        if len(pair) != 2:
            raise Refusal("Two things can change places; say which two, for example 'swap the dog and the cat'.")
        return Swap(*pair, **when.growth)

    return value


def stretched(by: float) -> Value:
    """So many times as long, all of the part that is named; Mismatch for none."""
    if by <= 0:
        raise Mismatch

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        fields = replace(when, soft=True).pace
        start, end = fields.get("frames", (0.0, None))
        if end is not None:
            end = start + by * (end - start)
            fields["frames"] = (start, None if end >= context.frames - 1 else round(end, PLACES))
        return Retime(who, round(1 / by, PLACES), **fields)

    return value


def opacity(by: float) -> Value:
    """So many times as opaque."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        if when.slowly:
            return faded(by)(who, when, context)
        return Opacity(who, round(by, PLACES), **when.effect)

    return value


def shown(again: bool = False) -> Value:
    """To be seen, again; Refusal for a time that may be the only one."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        if when.frames is not None and not again:
            raise Refusal(
                "'Show' with a time can be meant in two ways; say for example 'hide the dog until second 2', or 'show the dog again"
                " from second 2'."
            )
        return Opacity(who, SHOWN, **when.effect)

    return value


def faded(by: float = 0.0, inward: bool = False, gone: bool = False) -> Value:
    """To become so many times as opaque little by little, or to come from it (`inward`); `gone`: it ends so."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        when = replace(when, slowly=when.slowly or gone)
        fading = when.fading(context, inward)
        if when.slowly and when.frames is None:
            fading = {"frames": (0.0, None), "ease": "linear"}
        if (when.slowly or inward) and "ease" not in fading:
            raise Refusal("It is not said from when to when it fades; add for example 'from second 1 to 2'.")
        return Opacity(who, round(by, PLACES), **fading, inward=inward)

    return value


def fading_to(rgb: Colour) -> Value:
    """To take a colour little by little; everything without a time: over the last second."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        fields = when.fading(context, inward=False)
        if "ease" not in fields:
            start = max(context.frames - 1 - context.fps, 0.0) if who == All() else 0.0
            fields = {"frames": (start, None), **fields, "ease": "linear"}
        if not any(rgb):
            return Recolour(who, rgb, "multiply", **fields)
        return Recolour(who, rgb, **fields)

    return value


def appearing(who: SelectKind, when: When, context: SentenceContext) -> Operation:
    """To come into view over a while; at a moment: not to be seen until then."""
    if (
        when.kind == "moment"
        and when.frames is not None
        and when.frames[0] > 0
        and when.edge is None
        and not when.slowly
    ):
        return Opacity(who, 0.0, frames=(0.0, when.frames[0]))
    return faded(0.0, inward=True)(who, when, context)


def deleted(who: SelectKind, when: When, _: SentenceContext) -> Operation:
    """To be gone; Refusal for everything."""
    if who == All():
        raise Refusal("Nothing would be left; say what to remove, or 'hide everything' if that is meant.")
    return Delete(who, **when.effect)


def extracted(who: SelectKind, when: When, _: SentenceContext) -> Operation:
    """To be all that is left."""
    return Extract(who, **when.effect)


def rest_grayed(who: SelectKind, when: When, context: SentenceContext) -> Operation:
    """All others lose their colour."""
    return GRAYED(Not(who), when, context)


def scaled(by: float) -> Value:
    """So many times as big."""
    return lambda who, when, _: Transform(who, scale=round(by, PLACES), pivot="base", **when.growth)


def turned(rotate: Vector) -> Value:
    """Degrees about the camera's axes; what goes all around "the whole time" takes that long."""

    def value(who: SelectKind, when: When, _: SentenceContext) -> Operation:
        if when.kind == "always" and max(map(abs, rotate)) >= 360:
            when = replace(when, frames=(0.0, None))
        return Transform(who, rotate=rotate, axes="camera", **when.growth)

    return value


def rotated(angle: float = 90.0, sense: int = 1) -> Value:
    """Degrees about the vertical."""
    return turned((0.0, sense * angle, 0.0))


def spun(who: SelectKind, when: When, context: SentenceContext) -> Operation:
    """To turn by a right angle, or all around where it is said how long that lasts."""
    lasts = when.kind == "always" or (when.kind in ("range", "length", "in") and when.frames is not None)
    return rotated(360.0 if lasts else 90.0)(who, when, context)


def tilted(angle: float = TILT, sense: int = 1) -> Value:
    """Degrees to the side."""
    return turned((0.0, 0.0, sense * angle))


def moved(way: Steps, far: Distance | None = None) -> Value:
    """Steps, the last by `far` where it has no distance of its own."""
    vector, unit = displacement(way, far, 1.0)
    return lambda who, when, _: Transform(who, translate=vector, unit=unit, axes="camera", **when.growth)


def placed(place: Place) -> Value:
    """To stand beside another thing."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        beside = place.other(context)
        if beside == who and isinstance(who, Named) and who.name in context.copies:
            beside = context.copies[who.name]  # "copy the dog and put the copy behind it"
        if beside == who:
            raise Refusal("A thing cannot go beside itself; say beside whom.")
        context.last = who
        return Transform(who, translate=STANDING[place.where], unit="size", axes="camera", beside=beside, **when.growth)

    return value


def copied(
    way: Steps | None = None,
    far: Distance | None = None,
    times: float = 1.0,
    shift: TimeExpression | None = None,
    own: Place | None = None,
    called: str = "",
) -> Value:
    """Copies: where, how far apart, how many, how much later, beside whom, called what; Refusal: half a copy."""
    if times != int(times):
        raise Refusal(f"{times:g} copies cannot be made; say a whole number.")
    arguments: dict[str, Any] = {"count": int(times), "name": called}
    if way or far or own or shift is None:
        offset, unit = displacement(way or RIGHT, far, COPY_DISTANCE)
        arguments |= {"offset": offset, "unit": unit, "axes": "camera"}

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        if called:
            context.names.setdefault(called.lower(), called)
        later = 0.0 if shift is None else shift.resolve(context)
        placing = dict(arguments)
        if own is not None:
            other = own.other(context)
            placing["offset"] = tuple(COPY_DISTANCE * step for step in STANDING[own.where])
            if other != who:
                placing |= {"beside": other, "offset": STANDING[own.where]}
            elif not any(placing["offset"]):
                placing["offset"] = BESIDE
        context.last = who
        return Duplicate(who, time_shift=later, **placing, **when.none("A copy"))

    return value


def frozen(who: SelectKind, when: When, context: SentenceContext) -> Operation:
    """To stand still."""
    return Freeze(who, **when.pause(context))


def retimed(by: float) -> Value:
    """So many times as fast."""
    return lambda who, when, _: Retime(who, round(by, PLACES), **when.pace)


def lasting(to: TimeExpression) -> Value:
    """To take so long, the part of the clip that is named or all of it; Refusal for no time at all."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        if to.resolve(context) <= 0:
            raise Refusal("Nothing can last no time at all; say a longer time.")
        if when.frames and when.frames[1] is None and when.kind not in ("range", "from"):
            raise Refusal("It is not said which part is to last so long; add for example 'from second 1 to 2'.")
        start, end = when.frames or (0, context.frames)
        length = (context.frames - 1 if end is None else end) - start
        if length <= 0:
            raise Refusal("A moment has no length; say from when to when, for example 'from second 1 to 2'.")
        return stretched(to.resolve(context) / length)(who, when, context)

    return value


def noted(context: SentenceContext, who: SelectKind) -> SelectKind:
    """`who`, which "it" means from now on."""
    context.last = who
    return who


def reversed(who: SelectKind, when: When, _: SentenceContext) -> Operation:
    """To run backwards."""
    return Reverse(who, **when.effect)


def looped(who: SelectKind, when: When, _: SentenceContext) -> Operation:
    """To run again and again; Refusal without a time."""
    if when.frames is None:
        raise Refusal("It is not said which part is repeated; add for example 'from second 1 to 2'.")
    return Loop(who, **when.effect)


PICTURE_LOOKS = ("night", "sunset", "sepia", "autumn", "neon")


def is_of_a_clip(operation: Operation) -> bool:
    """Whether "it" may be everything in it where nothing is named or selected: "play it backward", "make it brighter"."""
    return isinstance(operation, Retime | Reverse | Freeze) or is_of_a_picture(operation)


def is_of_a_picture(operation: Operation) -> bool:
    """Whether it may be meant for everything where nobody is named: "black and white, please", "more contrast"."""
    if isinstance(operation, Recolour):
        return operation.mode in ("multiply", "add") or (operation.mode, operation.rgb) == ("hue", BLACK_AND_WHITE)
    return isinstance(operation, Grade) or (isinstance(operation, Style) and operation.look in PICTURE_LOOKS)


def styled(look: str, strength: float = 1.0) -> Value:
    """To look like a material or a light."""
    return lambda who, when, _: Style(who, look, strength, **when.coming)


def matched(source: Who) -> Value:
    """To take over the colours of `source`."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        found = source(context)
        if found == who:
            raise Refusal("A thing cannot be matched to itself; say whose colors it is to have.")
        context.last = who  # what is spoken about is the thing that changes
        return Match(who, found, **when.coming)

    return value


def named(called: str) -> Value:
    """To have a name; Refusal for one that means something else."""
    refuse_as_name(called)

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        return Name(who, context.names.setdefault(called.lower(), called), **when.none("A name"))

    return value
